"""What several tests of rendering begin with."""

from __future__ import annotations

from pathlib import Path

import pytest

from unisim_blender.core import native
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend

SAMPLE = Path(__file__).parents[3] / "sample" / "scene"


@pytest.fixture(scope="module")
def backend() -> CompiledBackend:
    if native.library() is None:
        pytest.skip("the compiled kernels were not built")
    return CompiledBackend(CompiledScene(SAMPLE))
