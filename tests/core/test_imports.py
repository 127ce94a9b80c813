"""What runs without what: core without Blender, the types and readers without torch, the help without anything heavy.

Each check is a fresh interpreter in which the named packages cannot be imported.
"""

from __future__ import annotations

import subprocess
import sys

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


def test_help_loads_nothing_heavy() -> None:
    result = run_without(HEAVY, "from unisim_blender.core.cli import run\nsys.exit(run(['--help']))")
    assert result.returncode == 0, result.stderr
    assert "Commands:" in result.stdout
