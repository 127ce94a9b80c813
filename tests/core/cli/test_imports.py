"""What runs without what: core without Blender, the types and readers without torch, the help without anything heavy.

Each check is a fresh interpreter in which the named packages cannot be imported.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from without_packages import run_without

from unisim_blender.core.native import library

HEAVY = ("torch", "pandas", "scipy", "skimage", "trimesh")

IMPORT_EVERYTHING = """
import importlib, pkgutil
def load(name):
    module = importlib.import_module(name)
    for info in pkgutil.iter_modules(getattr(module, "__path__", ())):
        # the native library lies there too; NVIDIA's API, which NCore's reader imports when it opens a log, needs scipy, and
        # so do AlpaSim's messages
        heavy = name.endswith((".formats.alpasim", ".formats.ncore")) and info.name not in ("layout", "write")
        if not info.name.startswith("_") and not heavy:
            load(f"{name}.{info.name}")
load(%r)
"""


def test_the_block_blocks() -> None:
    result = run_without(("json",), "import json")
    assert "json is blocked" in result.stderr


def test_core_runs_without_blender() -> None:
    result = run_without(("bpy", "bpy_extras", "mathutils"), IMPORT_EVERYTHING % "unisim_blender.core")
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize("name", ["geometry", "world", "sensors", "data", "formats", "scenario", "model.scene_file"])
def test_types_and_readers_need_numpy_alone(name: str) -> None:
    result = run_without(HEAVY, IMPORT_EVERYTHING % f"unisim_blender.core.{name}")
    assert result.returncode == 0, result.stderr


RENDERING = (
    "cli.commands.render", "meshes", "model.config", "model.shapes", "model.volume", "model.scene_file",
    "ops.grid_shape",
    "output", "prepare", "render.bounded", "render.captures", "render.observed_space", "render.tracers.compiled",
    "render.tracers.surfels", "render.tracers.warping", "sensors", "sequence", "worker",
)  # fmt: skip


def test_what_renders_is_imported_without_torch() -> None:
    program = "".join(IMPORT_EVERYTHING % f"unisim_blender.core.{name}" for name in RENDERING)
    result = run_without(("torch", "pandas", "scipy", "skimage", "safetensors"), program)
    assert result.returncode == 0, result.stderr


def test_measuring_imports_no_torch() -> None:
    result = run_without(("torch",), IMPORT_EVERYTHING % "unisim_bench")
    assert result.returncode == 0, result.stderr


def test_a_machine_without_torch_has_a_cpu() -> None:
    result = run_without(
        ("torch",), "from unisim_blender.core.scenes.recipe import pick_device\nprint(pick_device('auto'))"
    )
    assert result.stdout == "cpu\n", result.stderr


def test_help_loads_nothing_heavy() -> None:
    result = run_without(HEAVY, "from unisim_blender.core.cli.main import run\nsys.exit(run(['--help']))")
    assert result.returncode == 0, result.stderr
    assert "Commands:" in result.stdout


RENDER = """
from pathlib import Path
import numpy as np
from unisim_blender.core.sensors.frames import CAMERA_PASSES
from unisim_blender.core.scenes.recipe import load_backend
from unisim_blender.core.scenes.scene import open_scene
from unisim_blender.core.render.captures import render_image, render_sweep, states_of
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.model.scene_file import read_scene_header
from unisim_blender.core.world.captures import Capture

scene = Path({scene!r})
drive = read_scene_header(scene).drive
renderer = Renderer(load_backend(open_scene(scene)), shadows=True)
states, frame = states_of(renderer, drive), drive.frames[1]
image, beams = (Capture.of_frame(next(iter(s.values())), frame) for s in (drive.cameras, drive.lidars))
whole = render_image(renderer, states, image, CAMERA_PASSES, width=64)
part = render_image(renderer, states, image, CAMERA_PASSES, width=64, region=Region(2, 3, 19, 8))
sweep = render_sweep(renderer, states, beams)
assert np.array_equal(part.rgb, whole.rgb[3:8, 2:19]) and np.array_equal(part.normal, whole.normal[3:8, 2:19])
assert np.isfinite(whole.depth_m).mean() > 0.5 and whole.rgb.std() > 0.05 and sweep.returned.mean() > 0.5
"""


@pytest.mark.skipif(library() is None, reason="the compiled kernels were not built")
def test_images_and_sweeps_are_rendered_without_torch() -> None:
    """The sample's scene, and a region of an image has the bits that it has in the whole."""
    program = RENDER.format(scene=str(Path(__file__).parents[3] / "sample" / "scene"))
    result = run_without(("torch", "pandas", "scipy", "skimage", "safetensors"), program)
    assert result.returncode == 0, result.stderr


def test_the_contract_of_blenders_process_has_every_module_of_it() -> None:
    """import-linter's kind "forbidden" has no ``exhaustive``."""
    tomllib = pytest.importorskip("tomllib", reason="Python 3.11 or later")
    root = Path(__file__).parents[3]
    contracts = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    named = next(c for c in contracts if c["name"] == "Blender's process neither renders nor trains")["source_modules"]
    others = {"__init__", "__main__", "api", "bootstrap", "core"}  # for other processes
    package = root / "unisim_blender"
    found = {path.stem for path in package.glob("*.py")} | {path.parent.name for path in package.glob("*/__init__.py")}
    assert {name.removeprefix("unisim_blender.") for name in named} == found - others
