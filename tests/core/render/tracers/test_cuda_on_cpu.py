"""The GPU's tracer, compiled by the C++ compiler: beside torch's, and beside the compiled tracer that marches alike."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from instruction_sets import GPU_ON_CPU, run_with
from numpy.typing import NDArray
from random_scene import CONFIGS, PASSES, edited, image_rays, saved
from render.tracers.test_compiled_tracer import FEW, bits, needs_library, sweep_rays
from whole_drive import bound_to

from unisim_blender.core.render.quality import QUALITIES
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.sensors.frames import RenderStats

BESIDE_TORCH = """
from pathlib import Path
from render.tracers import test_compiled_tracer as t
t.test_everything_that_is_recorded(Path(sys.argv[1]) / "image", sys.argv[2], True)
t.test_everything_that_is_recorded(Path(sys.argv[1]) / "sweep", sys.argv[2], False)
"""
FOREIGN = """
from pathlib import Path
from render.tracers import test_compiled_tracer as t
for meshes in (False, True):
    t.test_foreign_actors_and_meshes(Path(sys.argv[1]) / str(meshes), meshes)
for n in (0, 1, 300):
    t.test_any_number_of_rays(Path(sys.argv[1]) / f"rays-{n}", n)
"""
MARCHED = """
from pathlib import Path
import numpy as np
from render.tracers.test_cuda_on_cpu import marched
np.savez(sys.argv[1], **marched(Path(sys.argv[2])))
"""


def marched(folder: Path) -> dict[str, NDArray[Any]]:
    """All passes of an image and a sweep at the qualities that march, and the numbers of evaluated samples."""
    results: dict[str, NDArray[Any]] = {}
    drive = edited()
    for name in ("fast", "balanced", "fine"):
        tracer = bound_to(CompiledBackend(CompiledScene(folder), QUALITIES[name]), drive)
        for rays, sky in ((image_rays(drive), True), (sweep_rays(drive), False)):
            stats = RenderStats()
            traced = bits(tracer.trace(rays, PASSES, sky, None, stats))
            results |= {f"{name} {sky} {key}": np.asarray(values, float) for key, values in traced.items()}
            results[f"{name} {sky} samples"] = np.array([stats.samples_spent])
    return results


@needs_library
@pytest.mark.parametrize("name", CONFIGS)
def test_beside_torch(tmp_path: Path, name: str) -> None:
    run_with(GPU_ON_CPU, BESIDE_TORCH, tmp_path, name)


@needs_library
def test_foreign_actors_meshes_and_any_number_of_rays(tmp_path: Path) -> None:
    run_with(GPU_ON_CPU, FOREIGN, tmp_path)


@needs_library
@pytest.mark.parametrize("name", ("tiny", "dark", "sample"))
def test_marches_as_the_compiled_tracer_does(tmp_path: Path, name: str) -> None:
    folder = saved(tmp_path / "scene", CONFIGS[name])
    run_with(GPU_ON_CPU, MARCHED, tmp_path / "gpu.npz", folder)
    expected, traced = marched(folder), np.load(tmp_path / "gpu.npz")
    assert expected.keys() == set(traced.files)
    for key, values in expected.items():
        if key.endswith("samples"):
            assert abs(int(traced[key][0]) - int(values[0])) <= 1e-3 * values[0], key
            continue
        same = np.isclose(traced[key], values, rtol=1e-3, atol=1e-3) | (traced[key] == values)
        assert (~same.reshape(len(values), -1).all(1)).sum() <= FEW, key
