"""Every module of the package is imported where there is no Blender, as is the whole of these tests."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import unisim_blender.editing

IMPORTS_ALL = """
import importlib, pkgutil, sys

BLENDER = ("bpy", "bpy_extras", "mathutils", "gpu", "gpu_extras", "bmesh", "blf")

class NoBlender:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in BLENDER:
            raise ImportError(f"{name} was imported")
        return None

sys.meta_path.insert(0, NoBlender())
import unisim_blender.editing as package
names = [found.name for found in pkgutil.walk_packages(package.__path__, package.__name__ + ".")]
for name in names:
    importlib.import_module(name)
assert not [name for name in sys.modules if name.split(".")[0] in BLENDER]
assert "jsonschema" not in sys.modules  # it takes time, and is needed where documents are checked alone
assert not [name for name in sys.modules if name.startswith(("unisim_blender.bridge", "unisim_blender.features"))]
print(len(names))
"""


def test_all_modules_are_imported_without_blender() -> None:
    result = subprocess.run([sys.executable, "-c", IMPORTS_ALL], capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    (folder,) = unisim_blender.editing.__path__
    files = [path for path in Path(folder).rglob("*.py") if path != Path(folder) / "__init__.py"]
    assert int(result.stdout) == len(files) > 40


def test_a_module_that_imports_blender_would_be_found() -> None:
    with_blender = IMPORTS_ALL.replace("for name in names:", "import bpy\nfor name in names:")
    result = subprocess.run([sys.executable, "-c", with_blender], capture_output=True, text=True)
    assert result.returncode == 1 and "bpy was imported" in result.stderr


def test_these_tests_import_nothing_of_blender() -> None:
    for path in Path(__file__).parent.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in names:
                assert name.split(".")[0] not in ("bpy", "mathutils", "gpu"), f"{path.name}: {name}"
                assert not name.startswith("unisim_blender.bridge"), f"{path.name}: {name}"


def test_no_room_has_more_than_a_dozen_files() -> None:
    package = Path(unisim_blender.editing.__path__[0]).parent
    for room in [
        path for folder in ("editing", "bridge", "features") for path in (package / folder).iterdir() if path.is_dir()
    ]:
        files = [path.name for path in room.glob("*.py") if path.name != "__init__.py"]
        assert len(files) <= 12 or room.name == "readers", (
            f"{room.name}: {len(files)} files"
        )  # which has one for each edit
