"""How a displacement of an object from its trajectory blends in and out, and which displacements are none."""

from __future__ import annotations

BLEND_S = 2.0
"""How long before and after its key a change with auto-keying begins and ends, in seconds."""
SAME = 1e-5
