"""Blender as a Python module, empty and with the add-on registered, for each test."""

from __future__ import annotations

import sys
import venv
from collections.abc import Iterator
from functools import cache
from importlib.metadata import distribution
from pathlib import Path
from shutil import copytree
from typing import Any

import pytest
from written_street import write_recipe

sys.path.insert(0, str(Path(__file__).parent))

bpy = pytest.importorskip("bpy", reason="Blender's module is not installed: pip install '.[blender]'")


@pytest.fixture(scope="session", autouse=True)
def _asked_once() -> Iterator[None]:
    """What this interpreter has is asked once, not by each task that starts it: that takes seconds."""
    from unisim_blender.process import interpreters

    ask = interpreters.probe
    own = cache(lambda: ask(sys.executable))
    interpreters.probe = lambda path: own() if path == sys.executable else ask(path)
    yield
    interpreters.probe = ask


@pytest.fixture(scope="session")
def addon() -> Iterator[Any]:
    """The add-on, registered."""
    import unisim_blender

    unisim_blender.register()
    yield unisim_blender
    unisim_blender.unregister()


@pytest.fixture
def scene(addon: Any) -> Any:
    """An empty scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


@pytest.fixture
def street(scene: Any) -> Any:
    """A scene with the sample's trained street imported."""
    from helpers import SAMPLE

    assert bpy.ops.unisim.import_scene(filepath=str(SAMPLE / "scene" / "scene.json")) == {"FINISHED"}
    return scene


@pytest.fixture(scope="session")
def sample_with_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample's scene beside the log it was trained on."""
    from helpers import SAMPLE

    root = tmp_path_factory.mktemp("sample")
    write_recipe(root / "out" / "street", seed=0, frames=20, width=160, height=90)
    copytree(SAMPLE / "scene", root / "sample" / "scene")
    return root / "sample" / "scene"


@pytest.fixture
def logged_street(scene: Any, sample_with_log: Path) -> Any:
    """A scene with the sample's trained street imported, its log at hand."""
    assert bpy.ops.unisim.import_scene(filepath=str(sample_with_log / "scene.json")) == {"FINISHED"}
    return scene


@pytest.fixture(scope="session")
def street_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A street of a few frames."""
    return write_recipe(tmp_path_factory.mktemp("log") / "street", frames=3, width=96, height=54)


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """An interpreter as Blender brings one: numpy and nothing else."""
    venv.create(tmp_path / "bare", symlinks=True)
    (packages,) = (tmp_path / "bare").glob("lib/python*/site-packages")
    for name in {file.parts[0] for file in distribution("numpy").files or () if file.parts[0] != ".."}:
        (packages / name).symlink_to(Path(str(distribution("numpy").locate_file(name))))
    return tmp_path / "bare" / "bin" / "python"
