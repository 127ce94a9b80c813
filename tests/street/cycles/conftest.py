"""These tests need Blender's module."""

from __future__ import annotations

import pytest

pytest.importorskip("bpy", reason="Blender's module is not installed: pip install '.[blender]'")
