"""Conversions that are interrupted, resumed, refused: no byte differs from one that ran through, and nothing is half written."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner
from small_log import small_drive, write_small_log

from unisim_blender.core.cli.main import run, unisim
from unisim_blender.core.convert import STATE_NAME, convert, open_source, unfinished_folder
from unisim_blender.core.errors import OutputError, UnisimError, what_is_missing
from unisim_blender.core.formats.common.writer import WRITERS, register
from unisim_blender.core.formats.kitti.write.recording import KittiLogWriter
from unisim_blender.core.formats.writers import writer_named
from unisim_blender.core.lenses.mei import Mei

LAYOUTS = ("pandaset", "ncore", "nuscenes", "kitti", "kitti-tracking", "kitti-object", "argoverse2")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("small") / "log"
    write_small_log(path)
    return path


def files(folder: Path) -> dict[str, bytes]:
    """Every file's bytes by its name."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def converted(log: Path, layout: str, out: Path, stop_after: int | None = None) -> list[int]:
    """Convert, interrupted after so many captures; gives the captures that were kept."""
    kept: list[int] = []
    count = 0

    def after() -> None:
        nonlocal count
        count += 1
        if count == stop_after:
            raise KeyboardInterrupt

    try:
        convert(open_source(log), writer_named(layout), out, on_reused=kept.append, on_capture=after)
    except ModuleNotFoundError as error:
        pytest.skip(what_is_missing(error))
    return kept


@pytest.mark.parametrize("layout", LAYOUTS)
def test_an_interrupted_conversion_goes_on_and_gives_the_same_bytes(layout: str, log: Path, tmp_path: Path) -> None:
    converted(log, layout, tmp_path / "whole")
    out = tmp_path / "out"
    for stop in (1, 2, 3):
        with pytest.raises(KeyboardInterrupt):
            converted(log, layout, out, stop)
        assert not out.exists() and unfinished_folder(out).is_dir()
    kept = converted(log, layout, out)
    # NCore's parts are whole sensors
    assert sum(kept) >= (0 if layout == "ncore" else 3)
    assert not unfinished_folder(out).exists() and sorted(os.listdir(tmp_path)) == ["out", "whole"]
    assert files(out) == files(tmp_path / "whole")
    state = json.loads((out / STATE_NAME).read_text())
    assert state["to"] == layout and not any(str(log.parent) in str(value) for value in state.values())


def test_ncore_goes_on_with_the_first_sensor_that_is_not_complete(log: Path, tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        converted(log, "ncore", tmp_path / "out", 5)  # the camera's four images, a sweep
    assert converted(log, "ncore", tmp_path / "out") == [0, 4]


def test_a_finished_conversion_is_left_as_it_is(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ["convert", str(log), "--to", "nuscenes", "--out", str(out)]
    first = CliRunner().invoke(unisim, arguments)
    assert first.exit_code == 0 and "8 images and sweeps written" in first.output, first.output
    assert "Warning: classes are renamed: Car to vehicle.car" in first.output
    before = {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    again = CliRunner().invoke(unisim, arguments)
    assert again.exit_code == 0 and "Nothing to do" in again.output
    assert before == {path: path.stat().st_mtime_ns for path in out.rglob("*")}
    state = json.loads((out / STATE_NAME).read_text())
    (out / STATE_NAME).write_text(json.dumps({**state, "losses": 3}))
    broken = CliRunner().invoke(unisim, arguments)
    assert broken.exit_code != 0 and isinstance(broken.exception, OutputError)
    assert str(broken.exception).endswith("conversion.json: losses: must be an array, not 3")


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL])
def test_a_stopped_process_leaves_a_state_that_goes_on(how: signal.Signals, log: Path, tmp_path: Path) -> None:
    """Ctrl+C, and a process that is killed, which cannot tidy up. It writes for long: it waits a while before each image."""
    out = tmp_path / "out"
    # a shell that runs tests in the background has its children ignore an interrupt
    slow = (
        "import signal, time\nsignal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from unisim_blender.core.cli import main\nfrom unisim_blender.core.formats.pandaset import write as pandaset\n"
        "taken = pandaset.image_file\n"
        "pandaset.image_file = lambda *given: (time.sleep(0.5), taken(*given))[1]\n"
        f"raise SystemExit(main.run(['convert', {str(log)!r}, '--to', 'pandaset', '--out', {str(out)!r}]))\n"
    )
    process = subprocess.Popen([sys.executable, "-c", slow], stderr=subprocess.PIPE, text=True)
    image = unfinished_folder(out) / "camera/front_camera/00.jpg"
    until = time.monotonic() + 120
    while not image.exists() and time.monotonic() < until and process.poll() is None:
        time.sleep(0.02)
    process.send_signal(how)
    _, said = process.communicate(timeout=120)
    if how == signal.SIGINT:
        assert process.returncode == 130 and "Traceback" not in said and "Interrupted." in said
    else:
        assert process.returncode == -how
        (image.parent / ".01.jpg.0.partial").write_bytes(b"cut off")  # as if it had been writing just then
    assert not out.exists() and image.exists()
    assert sum(converted(log, "pandaset", out)) >= 1
    converted(log, "pandaset", tmp_path / "whole")
    assert files(out) == files(tmp_path / "whole")


def test_another_conversion_and_anything_else_are_refused(log: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    converted(log, "pandaset", out)
    with pytest.raises(OutputError, match=r"holds another conversion, of 'bend' to 'pandaset'"):
        converted(log, "nuscenes", out)
    other = tmp_path / "other"
    write_small_log(other)
    (other / "annotations/cuboids/00.pkl.gz").unlink()
    with pytest.raises(OutputError, match="holds another conversion"):
        converted(other, "pandaset", out)
    with pytest.raises(KeyboardInterrupt):
        converted(log, "kitti", tmp_path / "half", 1)
    with pytest.raises(OutputError, match="half.unfinished: holds another conversion, of 'bend' to 'kitti'"):
        converted(log, "pandaset", tmp_path / "half")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/thing.txt").write_text("precious")
    with pytest.raises(OutputError, match="mine: is not empty, and holds no conversion"):
        converted(log, "pandaset", tmp_path / "mine")
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file: is no folder"):
        converted(log, "pandaset", tmp_path / "file")
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["thing.txt"]


@pytest.mark.parametrize(
    ("layout", "sentence"),
    [
        ("nothing", "--to nothing: must be one of argoverse2, kitti-object, kitti-tracking, kitti, "),
        ("kitti", "no sweeps of a LiDAR that turns all round, and KITTI"),
        ("kitti-tracking", "no sweeps of a LiDAR that turns all round, and KITTI"),
        ("nuscenes", "no sweeps of a LiDAR that turns all round, and nuScenes"),
    ],
)
def test_what_cannot_be_converted_is_one_sentence(
    layout: str, sentence: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blind = tmp_path / "blind"
    write_small_log(blind)
    for sweep in (blind / "lidar").glob("*.pkl.gz"):
        sweep.unlink()
    assert run(["convert", str(blind), "--to", layout, "--out", str(tmp_path / "out")]) == 1
    said = capsys.readouterr().err
    assert sentence in said and len(said.strip().splitlines()) == 1
    assert os.listdir(tmp_path) == ["blind"]


def test_a_lens_that_ncore_lacks_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    drive = small_drive()
    camera = drive.cameras["front_camera"]
    drive = replace(drive, cameras={"front_camera": replace(camera, model=replace(camera.model, lens=Mei(0.5)))})
    write_small_log(tmp_path / "log", drive)
    with pytest.raises(OutputError, match="front_camera: .*mei"):
        converted(tmp_path / "log", "ncore", tmp_path / "out")
    assert os.listdir(tmp_path) == ["log"]


def test_a_broken_log_is_one_sentence_and_what_was_written_stays(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / "broken"
    write_small_log(broken)
    sweep = broken / "lidar/02.pkl.gz"
    whole = sweep.read_bytes()
    sweep.write_bytes(whole[:-1])
    with pytest.raises(UnisimError, match=r"02\.pkl\.gz"):
        converted(broken, "nuscenes", tmp_path / "out")
    assert not (tmp_path / "out").exists() and not list(tmp_path.rglob("*.partial"))
    for path, about in (
        (tmp_path / "none", "there is no such log"),
        (tmp_path / "broken/meta", "is no recorded drive"),
    ):
        assert run(["convert", str(path), "--to", "kitti", "--out", str(tmp_path / "other")]) == 1
        assert about in capsys.readouterr().err
    image = broken / "camera/front_camera/01.jpg"
    sweep.write_bytes(whole)
    image.write_bytes(image.read_bytes()[:50])
    with pytest.raises(UnisimError, match=r"front_camera"):
        converted(broken, "kitti", tmp_path / "kitti")
    assert not (tmp_path / "kitti").exists()


MODULE = """
from unisim_blender.core.formats.common.writer import WritePlan, WriterPart
from unisim_blender.core.files import write_file


class Names:
    name, about, version = "names", "the frames' numbers, a file each", 1

    @staticmethod
    def plan(log, path):
        def part(frame):
            def write(tick):
                write_file(path / f"{frame}.txt", str(log.drive.time_s[frame]).encode())
                tick()
            return WriterPart((f"{frame}.txt",), write)

        return WritePlan((), [part(frame) for frame in log.drive.frames], lambda: None)
"""


def test_another_package_ships_a_writer(log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    site = tmp_path / "site"
    about = site / "frame_names-1.0.dist-info"
    about.mkdir(parents=True)
    (site / "frame_names.py").write_text(MODULE)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: frame-names\nVersion: 1.0\n")
    entries = "names = frame_names:Names\ngone = no_such_module:Writer\npath = pathlib:Path\n"
    (about / "entry_points.txt").write_text(f"[{WRITERS.group}]\n{entries}")
    monkeypatch.syspath_prepend(site)
    WRITERS.forget_plugins()
    try:
        with pytest.warns(UserWarning) as told:
            assert list(WRITERS.with_plugins()) == [*WRITERS, "names"]
        sentences = sorted(str(one.message) for one in told)
        assert [sentence.partition(":")[0] for sentence in sentences] == [
            "the writer 'gone' of frame-names is left out",
            "the writer 'path' of frame-names is left out",
        ]
        converted(log, "names", tmp_path / "out")
        assert float((tmp_path / "out/3.txt").read_text()) == pytest.approx(0.327)
    finally:
        WRITERS.forget_plugins()
        sys.modules.pop("frame_names", None)
    assert set(WRITERS) == set(LAYOUTS)
    with pytest.raises(ValueError, match="there is a writer 'kitti' already"):
        register(KittiLogWriter())
