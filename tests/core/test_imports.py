"""What runs without what: core without Blender, the types and readers without torch, the help without anything heavy.

Each check is a fresh interpreter in which the named packages cannot be imported.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = ("torch", "pandas", "scipy", "skimage", "trimesh")

BLOCKED = """
import sys
class Blocked:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {names!r}:
            raise ModuleNotFoundError(f"{{name}} is blocked", name=name)
sys.meta_path.insert(0, Blocked())
"""

IMPORT_EVERYTHING = """
import importlib, pkgutil
def load(name):
    module = importlib.import_module(name)
    for info in pkgutil.iter_modules(getattr(module, "__path__", ())):
        if not info.name.startswith("_"):  # the native library lies there too
            load(f"{name}.{info.name}")
load(%r)
"""


def run_without(blocked: tuple[str, ...], program: str) -> subprocess.CompletedProcess[str]:
    """Run a program in a Python that has none of the blocked packages."""
    return subprocess.run(
        [sys.executable, "-c", BLOCKED.format(names=blocked) + program], capture_output=True, text=True, timeout=120, check=False
    )


def test_the_block_blocks() -> None:
    result = run_without(("json",), "import json")
    assert "json is blocked" in result.stderr


def test_core_runs_without_blender() -> None:
    result = run_without(("bpy", "bpy_extras", "mathutils"), IMPORT_EVERYTHING % "unisim_blender.core")
    assert result.returncode == 0, result.stderr


@pytest.mark.parametrize("name", ["geometry", "drive", "log", "frames", "sensors", "logs", "scenario", "scene_file"])
def test_types_and_readers_need_numpy_alone(name: str) -> None:
    result = run_without(HEAVY, IMPORT_EVERYTHING % f"unisim_blender.core.{name}")
    assert result.returncode == 0, result.stderr


RENDERING = (
    "bounds", "cast", "contact_shadow", "fields.config", "fields.config_check", "fields.grid_shape", "fields.volume", "frames",
    "meshes", "output", "passes", "prepare", "render", "sequence", "tracer", "weights", "worker", "commands.render",
)  # fmt: skip


def test_what_renders_is_imported_without_torch() -> None:
    program = "".join(IMPORT_EVERYTHING % f"unisim_blender.core.{name}" for name in RENDERING)
    result = run_without(("torch", "pandas", "scipy", "skimage", "safetensors"), program)
    assert result.returncode == 0, result.stderr


def test_a_machine_without_torch_has_a_cpu() -> None:
    result = run_without(("torch",), "from unisim_blender.core.prepare.renderers import pick_device\nprint(pick_device('auto'))")
    assert result.stdout == "cpu\n", result.stderr


def test_help_loads_nothing_heavy() -> None:
    result = run_without(HEAVY, "from unisim_blender.core.cli import run\nsys.exit(run(['--help']))")
    assert result.returncode == 0, result.stderr
    assert "Commands:" in result.stdout


RENDER_A_PLANE = """
sys.path.insert(0, {tests!r})
import numpy as np
from tiny_drive import tiny_drive
from unisim_blender.core.cast import gather_cast
from unisim_blender.core.frames import CAMERA_PASSES
from unisim_blender.core.render import Region, Renderer
from unisim_blender.core.tracer import Found

class Plane:
    upsample, reach = 2, 1
    def __init__(self, drive):
        self.cast = gather_cast(drive, drive, {{"": sorted(drive.actors)}})
    def trace(self, rays, passes, sky, met, stats):
        n, down = len(rays.time_s), rays.directions[:, 2]
        depth = np.where(down < 0, -rays.origins[:, 2] / np.minimum(down, -1e-9), np.inf).astype(np.float32)
        maps = {{"depth": depth, "instance": np.zeros(n, np.int64), "opacity": np.isfinite(depth).astype(np.float32),
                "normal": np.tile(np.float32([0, 0, 1]), (n, 1)), "support": np.zeros(n, bool)}}
        return Found(depth, depth, maps["opacity"], maps)
    def image(self, found, directions, camera_id, shape):
        return np.repeat(np.repeat(np.isfinite(found.depth_m).reshape(*shape, 1), 2, 0), 2, 1) * np.ones(3, np.float32)
    def returns(self, found, directions):
        return np.full(len(directions), 0.5, np.float32), found.opacity
    def heights(self, points):
        return points[:, 2]

drive = tiny_drive()
drive.actors.update({{uid: __import__("dataclasses").replace(a, inserted=True) for uid, a in drive.actors.items()}})
renderer = Renderer(Plane(drive), drive, shadows=True)
camera, lidar = next(iter(drive.cameras)), next(iter(drive.lidars))
whole = renderer.camera(camera, 0, CAMERA_PASSES)
part = renderer.camera(camera, 0, CAMERA_PASSES, region=Region(2, 3, 9, 8))
sweep = renderer.lidar(lidar, 0)
assert np.array_equal(part.depth_m, whole.depth_m[3:8, 2:9]) and np.isfinite(whole.depth_m).any()
hit = sweep.origins + sweep.directions * sweep.depth_m[..., None]
assert sweep.returned.any() and np.abs(hit[sweep.returned][:, 2]).max() < 1e-4
"""


def test_pictures_and_sweeps_are_rendered_without_torch() -> None:
    """By a tracer of a plane: all that is no tracer runs on numpy alone."""
    program = RENDER_A_PLANE.format(tests=str(Path(__file__).parent))
    result = run_without(("torch", "pandas", "scipy", "skimage", "safetensors"), program)
    assert result.returncode == 0, result.stderr
