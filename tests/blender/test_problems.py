"""What a window offers where something fails: wrapped sentences, optional packages, the log's new place."""

from __future__ import annotations

import json
import shutil
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import blf
import bpy
import pytest

from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.window import label_rows
from unisim_blender.core.errors import IN_BLENDER, LogError, install_into, remedy_of
from unisim_blender.editing.sampled import source as sampled_source
from unisim_blender.features.problems import REMEDIES
from unisim_blender.process import interpreters, packages
from unisim_blender.process.background import newest
from unisim_blender.process.tasks import SequenceTask

NAME = "unisim-trial-package"


@pytest.fixture
def package(addon: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[packages.OptionalPackage]:
    """A package that pip finds in a folder of wheels, in place of the package index."""
    wheels = tmp_path / "wheels"
    wheels.mkdir()
    module, about = NAME.replace("-", "_"), f"{NAME.replace('-', '_')}-1.0.dist-info"
    with zipfile.ZipFile(wheels / f"{module}-1.0-py3-none-any.whl", "w") as wheel:
        wheel.writestr(f"{module}.py", "VALUE = 42\n")
        wheel.writestr(f"{about}/METADATA", f"Metadata-Version: 2.1\nName: {NAME}\nVersion: 1.0\n")
        wheel.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        wheel.writestr(f"{about}/RECORD", "".join(f"{name},,\n" for name in wheel.namelist()))
    monkeypatch.setenv("PIP_NO_INDEX", "1")
    monkeypatch.setenv("PIP_FIND_LINKS", str(wheels))
    monkeypatch.setattr(interpreters, "PACKAGES", tmp_path / "own folder")
    optional = packages.OptionalPackage(NAME, module, "Trials", 1, (NAME,))
    monkeypatch.setitem(packages.PACKAGES, NAME, optional)
    bpy.context.preferences.system.use_online_access = True
    yield optional
    bpy.context.preferences.system.use_online_access = False
    sys.modules.pop(module, None)
    monkeypatch.undo()
    packages.look_into_folders()


def test_a_package_is_installed_into_the_own_folder_and_removed(package: packages.OptionalPackage) -> None:
    assert not package.available and not package.installed
    assert bpy.ops.unisim.install_package(package=NAME) == {"FINISHED"}
    assert package.installed and __import__(package.module).VALUE == 42
    assert newest[packages.PackageTask].text() == f"{NAME} is installed"
    assert [path.name for path in interpreters.PACKAGES.iterdir()] == [NAME], "nothing unfinished is left"
    path = interpreters.command(sys.executable, "cli")[3]
    assert str(package.folder) in path, "the renderer looks there, too"
    assert bpy.ops.unisim.remove_package(package=NAME) == {"FINISHED"}
    sys.modules.pop(package.module)
    assert not package.installed and not package.available and not list(interpreters.PACKAGES.iterdir())


def test_an_installation_that_fails_is_one_sentence_and_leaves_nothing(
    package: packages.OptionalPackage, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("PIP_FIND_LINKS", str(tmp_path))
    with pytest.raises(RuntimeError, match=rf"{NAME} could not be installed: .*No matching distribution found") as told:
        bpy.ops.unisim.install_package(package=NAME)
    assert len(str(told.value).strip().splitlines()) == 1
    assert not package.installed and not list(interpreters.PACKAGES.iterdir())


def test_nothing_is_downloaded_without_leave(package: packages.OptionalPackage) -> None:
    bpy.context.preferences.system.use_online_access = False
    with pytest.raises(RuntimeError, match="not allowed to go online"):
        bpy.ops.unisim.install_package(package=NAME)
    assert not package.installed and not interpreters.PACKAGES.exists()


def test_every_package_that_blender_installs_has_a_button(addon: Any) -> None:
    assert set(IN_BLENDER) == set(packages.PACKAGES)
    assert set(REMEDIES) == {*IN_BLENDER, "interpreter", "log"}
    for operator, _, _ in REMEDIES.values():
        assert hasattr(bpy.types, f"UNISIM_OT_{operator.removeprefix('unisim.')}")


@pytest.mark.parametrize(
    ("module", "remedy"),
    [("pyarrow.feather", "pyarrow"), ("zarr", "nvidia-ncore"), ("torch", "interpreter"), ("ray", "")],
)
def test_an_error_names_its_remedy(module: str, remedy: str) -> None:
    error = ModuleNotFoundError(name=module)
    assert remedy_of(error) == "", "outside Blender"
    install_into("/modules", has_window=True)
    try:
        assert remedy_of(error) == remedy
    finally:
        install_into("")


def test_a_task_names_the_remedy_of_its_command(tmp_path: Path) -> None:
    """What the command line prints goes through the pipe of the process."""
    task = SequenceTask([], tmp_path, 1.0)
    program = (
        "import sys; from unisim_blender.core.cli import main; from unisim_blender.core.errors import LogError\n"
        "sys.exit(main._fail('log: this needs pyarrow', 'pyarrow'))"
    )
    task.code = task._execute([sys.executable, "-c", program])
    assert (task.problem, task.remedy) == ("log: this needs pyarrow", "pyarrow")
    assert LogError("a", remedy="b").remedy == "b" and LogError("a").remedy == ""


@pytest.mark.parametrize("width", [120.0, 480.0])
def test_a_sentence_is_wrapped_to_a_width(addon: Any, width: float) -> None:
    path = "/data/" + "a long name without spaces/" * 3 + "x" * 150
    text = f"{path}: this needs pyarrow, which Blender's Python does not have: install it in Preferences > Add-ons > UniSim"
    lines = label_rows(text, width)
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")
    blf.size(0, bpy.context.preferences.ui_styles[0].widget.points)
    assert max(blf.dimensions(0, line)[0] for line in lines) <= width


def test_a_log_that_was_moved_is_chosen_anew(scene: Any, street_log: Path, tmp_path: Path) -> None:
    before, after = tmp_path / "before" / "street", tmp_path / "after" / "street"
    shutil.copytree(street_log, before)
    bpy.ops.unisim.import_log(filepath=str(before))
    after.parent.mkdir()
    before.rename(after)
    sampled_source._newest.clear()
    with pytest.raises(sampled_source.NotImported) as told:
        source_of(scene)
    assert told.value.remedy == "log"
    with pytest.raises(RuntimeError, match="is the log of another drive"):
        bpy.ops.unisim.locate_log(directory=str(other_drive(after, tmp_path / "other")))
    assert scene.unisim.log == str(before)
    assert bpy.ops.unisim.locate_log(directory=str(after.parent)) == {"FINISHED"}
    assert source_of(scene).log_path == after


def other_drive(log: Path, target: Path) -> Path:
    """A copy of a log whose world begins elsewhere."""
    shutil.copytree(log, target)
    file = target / "meta" / "unisim.json"
    about = json.loads(file.read_text())
    about["world_origin"][0] += 1000.0
    file.write_text(json.dumps(about))
    return target
