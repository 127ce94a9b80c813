"""The registry of readers: other packages' readers beside the package's own, and what happens where one
of them is broken."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner
from other_package import install, write_zipped

from unisim_blender.core.cli.main import unisim
from unisim_blender.core.errors import LogError
from unisim_blender.core.formats import readers
from unisim_blender.core.formats.readers import READERS, open_log
from unisim_blender.core.prepare.scenario import prepare_scenario

ROOT = Path(__file__).parents[3]


@pytest.fixture
def site(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder on the path to install into. The registry is read anew, before and after."""
    folder = tmp_path / "site"
    folder.mkdir()
    monkeypatch.syspath_prepend(folder)
    READERS.forget_plugins()
    yield folder
    READERS.forget_plugins()
    sys.modules.pop("zipped_pandaset", None)


@pytest.fixture
def zipped(tmp_path: Path) -> Path:
    """The small log in one file."""
    return write_zipped(tmp_path)


def test_another_package_ships_a_reader(site: Path, zipped: Path) -> None:
    install(site, "zipped = zipped_pandaset:ZippedPandaset")
    assert [reader.name for reader in READERS.with_plugins().values()] == [*READERS, "zipped"]
    assert set(READERS) >= {"argoverse2", "kitti", "ncore", "pandaset", "waymo"}
    assert readers.suffixes()[-1] == ".zip" and set(readers.suffixes()) >= {".feather", ".itar", ".json", ".parquet"}
    log = open_log(zipped)
    assert log.path == zipped and set(log.drive.cameras) == {"front_camera"}
    assert prepare_scenario(zipped).edited.frames == log.drive.frames
    told = CliRunner().invoke(unisim, ["info", str(zipped)])
    assert told.exit_code == 0 and "front_camera" in told.output


def test_every_command_takes_a_log_of_another_packages_reader(site: Path, zipped: Path, tmp_path: Path) -> None:
    install(site, "zipped = zipped_pandaset:ZippedPandaset")

    def told(*arguments: object) -> str:
        result = CliRunner().invoke(unisim, [str(one) for one in arguments], catch_exceptions=False)
        assert result.exit_code == 0, result.output
        return result.output

    scene, measured, frames = tmp_path / "scene", tmp_path / "measured", tmp_path / "frames"
    lean = ("--preset", "tiny", "--rays", 512, "--iterations", 2, "--quiet")
    assert "2 steps" in told("train", zipped, "--out", scene, *lean)
    told("eval", scene, zipped, "--out", measured, "--frames", 1, "--quality", "fast")
    assert json.loads((measured / "metrics.json").read_text())
    told(
        "render", zipped, "--out", frames, "--frames", 1, "--sensors", "front_camera", "--quality", "fast", "--jobs", 1
    )
    assert list(frames.rglob("*.png")) and zipped.name in told("info", scene)


def test_another_package_ships_a_reader_to_blender(tmp_path: Path, zipped: Path) -> None:
    """There this package has another name, and what the reader imports by the usual one is no second copy."""
    site = tmp_path / "site"
    site.mkdir()
    install(site, "zipped = zipped_pandaset:ZippedPandaset")
    script = f"""
import importlib.util, sys, types
sys.path[:] = [{str(site)!r}, *(place for place in sys.path if place not in ("", {str(ROOT)!r}))]
sys.modules["house"] = types.ModuleType("house")
package = {str(ROOT / "unisim_blender")!r}
spec = importlib.util.spec_from_file_location(
    "house.unisim_blender", package + "/__init__.py", submodule_search_locations=[package]
)
sys.modules[spec.name] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(sys.modules[spec.name])
from house.unisim_blender.core.formats.readers import open_log
from house.unisim_blender.core.formats.pandaset import read
log = open_log(__import__("pathlib").Path({str(zipped)!r}))
assert isinstance(log, read.PandasetLog) and list(log.drive.cameras) == ["front_camera"]
import unisim_blender.core.formats.pandaset.read as by_its_name
assert by_its_name is read and read.__spec__.name == "house.unisim_blender.core.formats.pandaset.read"
try:
    import unisim_blender.core.no_such_module
except ModuleNotFoundError as error:
    print(error)
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "No module named 'unisim_blender.core.no_such_module'"


def test_a_log_that_nobody_recognises_names_all_readers(site: Path, tmp_path: Path) -> None:
    install(site, "zipped = zipped_pandaset:ZippedPandaset")
    with pytest.raises(LogError, match=r"is no recorded drive .*\(.*PandaSet: .*; zipped PandaSet: .*\)$"):
        open_log(tmp_path)


@pytest.mark.parametrize(
    ("entry", "sentence"),
    [
        (
            "gone = no_such_module:Reader",
            "the reader 'gone' of zipped-pandaset is left out: ModuleNotFoundError: No module named",
        ),
        ("gone = zipped_pandaset:NoSuch", "the reader 'gone' of zipped-pandaset is left out: AttributeError"),
        (
            "path = zipped_pandaset:Path",
            "the reader 'path' of zipped-pandaset is left out: TypeError: .* has no 'layout'",
        ),
        (
            "text = zipped_pandaset:Unsuffixed",
            "the reader 'text' of zipped-pandaset is left out: TypeError: its suffixes are 'zip', not texts such as",
        ),
        (
            "bare = zipped_pandaset:Bare",
            "the reader 'bare' of zipped-pandaset is left out: TypeError: its suffixes are .'zip',., not texts such as",
        ),
        (
            "taken = zipped_pandaset:Taken",
            "the reader 'taken' of zipped-pandaset is left out: .* there is a reader 'pandaset'",
        ),
    ],
)
def test_a_broken_reader_is_one_sentence_and_the_others_work(
    entry: str, sentence: str, site: Path, zipped: Path, tmp_path: Path
) -> None:
    install(site, f"{entry}\nzipped = zipped_pandaset:ZippedPandaset")
    with pytest.warns(UserWarning, match=sentence) as told:
        assert open_log(zipped).drive.frames
    assert len(told) == 1
    assert open_log(tmp_path / "unpacked").drive.frames


def test_a_reader_that_fails_at_a_folder_is_one_sentence(site: Path, zipped: Path) -> None:
    install(site, "failing = zipped_pandaset:Failing\nzipped = zipped_pandaset:ZippedPandaset")
    with pytest.warns(
        UserWarning, match="the reader 'failing' fails at .*log.zip: RuntimeError: this reader is broken"
    ):
        assert open_log(zipped).drive.frames
