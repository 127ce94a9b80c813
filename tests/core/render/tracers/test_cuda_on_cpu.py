"""The GPU's tracer, compiled by the C++ compiler: beside torch's, and beside the compiled tracer that marches alike."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from instruction_sets import GPU_ON_CPU, run_with
from numpy.typing import NDArray
from random_scene import CONFIGS, PASSES, edited, image_rays, saved
from render.tracers.test_compiled_tracer import FEW, bits, needs_library, sweep_rays
from whole_drive import bound_to

from unisim_blender.core import cuda_driver
from unisim_blender.core.render.quality import QUALITIES
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.sensors.frames import RenderStats

MOST_SPILLED = {"unisim_trace_rays": 4, "unisim_judge_blocks": 12, "unisim_fill_pixels": 12}
"""Bytes that a thread of a kernel may spill."""
MOST_SPILLED_ON = {("unisim_trace_rays", "sm_120"): 28}
"""The same, where one capability's differ."""
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


@pytest.mark.slow
def test_registers_and_spills_of_the_kernels(tmp_path: Path) -> None:
    path = Path(__file__).parents[4] / "tools" / "compile_cuda.py"
    spec = importlib.util.spec_from_file_location("compile_cuda", path)
    assert spec is not None and spec.loader is not None
    tool = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tool)
    try:
        tool.compiler()
    except SystemExit as error:
        pytest.skip(str(error))
    uses = {(use.kernel, use.capability): use for use in tool.compiled(tmp_path / "kernels.fatbin")}
    assert len(uses) == len(tool.CAPABILITIES) * len({kernel for kernel, _ in uses}) >= 90
    for (kernel, capability), use in uses.items():
        most = MOST_SPILLED_ON.get((kernel, capability), MOST_SPILLED.get(kernel, 0))
        assert use.spilled + use.spilled_by_functions <= most, (kernel, capability)
    for capability in tool.CAPABILITIES:
        trace = uses["unisim_trace_rays", f"sm_{capability}"]
        assert trace.registers <= 168 and trace.occupancy >= 0.18


@pytest.mark.slow
def test_nvrtc_compiles_the_source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if cuda_driver.nvrtc() is None:
        pytest.skip("NVRTC is not installed")
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path))
    code = cuda_driver.compiled("90")
    assert code.startswith(b"\x7fELF") and b"unisim_trace_rays" in code and b"unisim_fill_pixels" in code
    monkeypatch.setattr(cuda_driver, "nvrtc", lambda: object())
    assert cuda_driver.compiled("90") == code


def test_nvrtc_is_given_one_source_without_headers_of_others() -> None:
    assert cuda_driver.SOURCE is not None
    text = cuda_driver._with_includes(cuda_driver.SOURCE / "cuda" / "kernels.cu", set())
    assert "#include" not in text and text.count("struct unisim_scene {") == 1 and "unisim_trace_rays" in text
    # what the header before it declares is all that it takes of std
    names = set(re.findall(r"std::(\w+)", text))
    declared = set(re.findall(r"using ::(\w+)|constexpr const T &(\w+)", cuda_driver.NVRTC_HEADER))
    assert names <= {name for pair in declared for name in pair}
