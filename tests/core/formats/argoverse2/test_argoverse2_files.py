"""The reader of Argoverse 2 where files are missing, truncated or wrong: one sentence that names the file."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
pytest.importorskip("scipy", reason="the extra torch is not installed")

import pyarrow  # noqa: E402
from argoverse2_street import Argoverse2Street, write_feather  # noqa: E402
from pyarrow import feather  # noqa: E402

from unisim_blender.core.errors import LogError  # noqa: E402
from unisim_blender.core.formats.readers import open_log  # noqa: E402

POSES, BOXES = "city_SE3_egovehicle.feather", "annotations.feather"
MOUNTS, INTRINSICS = "calibration/egovehicle_SE3_sensor.feather", "calibration/intrinsics.feather"
Table = dict[str, Any]


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("argoverse2") / "log"
    Argoverse2Street(sweeps=2).write(folder)
    return folder


@pytest.fixture
def path(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "log"))


def sweeps(path: Path) -> list[Path]:
    return sorted((path / "sensors/lidar").iterdir())


def edit(path: Path, change: Callable[[Table], Any]) -> None:
    table = feather.read_table(str(path))
    columns = {name: table[name].to_numpy().copy() for name in table.column_names}
    change(columns)
    write_feather(path, columns)


def put(column: str, row: int, value: Any) -> Callable[[Table], Any]:
    def change(table: Table) -> None:
        table[column][row] = value

    return change


def same(column: str, to: int, of: int) -> Callable[[Table], Any]:
    def change(table: Table) -> None:
        table[column][to] = table[column][of]

    return change


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        (POSES, same("timestamp_ns", 3, 2), "row 3 at .* ns is not later than the row before"),
        (POSES, put("qw", 4, 3.0), "quaternion of row 4 has length"),
        (POSES, put("tx_m", 5, np.nan), "row 5 of column 'tx_m' is nan"),
        (POSES, put("ty_m", 5, 1e30), r"row 5 is at \(.* 1e\+30"),
        (POSES, lambda t: t.pop("tz_m"), "has no column 'tz_m', but timestamp_ns, qw"),
        (POSES, lambda t: t.update(tz_m=["a"] * len(t["qw"])), "column 'tz_m' holds string, not numbers"),
        (POSES, lambda t: t.update(timestamp_ns=t["qw"]), "'timestamp_ns' holds double, not whole numbers"),
        (
            POSES,
            lambda t: t.update(timestamp_ns=t["timestamp_ns"] + 10**12),
            "has poses from .* but there is a frame at",
        ),
        (POSES, lambda t: t.update({k: v[:0] for k, v in t.items()}), "holds no pose"),
        (BOXES, put("length_m", 2, 0.0), r"box .* has the size \(0.0, "),
        (BOXES, put("width_m", 2, -1.0), r"box .* has the size \(.*, -1.0, "),
        (BOXES, put("qx", 0, np.inf), "row 0 of column 'qx' is inf"),
        (BOXES, same("track_uuid", 1, 0), "box .* stands twice in the frame at 0.0 s"),
        (MOUNTS, same("sensor_name", 1, 0), "ring_front_center stands there twice"),
        (MOUNTS, put("qw", 0, 0.0), "quaternion of row 0 has length"),
        (INTRINSICS, put("fx_px", 0, 0.0), "ring_front_center has the focal lengths 0.0 and 35.5 pixels"),
        (INTRINSICS, put("width_px", 0, 0), "ring_front_center has images of 0x41 pixels"),
    ],
)
def test_wrong_values_are_named_with_their_file(
    path: Path, file: str, change: Callable[[Table], Any], message: str
) -> None:
    edit(path / file, change)
    with pytest.raises(LogError, match=f"{file}: .*{message}") as caught:
        open_log(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("file", [POSES, BOXES, MOUNTS, INTRINSICS, "sweep"])
@pytest.mark.parametrize("broken", ["truncated", "empty", "text", "garbled"])
def test_broken_files_are_named(path: Path, file: str, broken: str) -> None:
    target = sweeps(path)[0] if file == "sweep" else path / file
    data = bytearray(target.read_bytes())
    if broken == "garbled":
        data[len(data) // 3 : len(data) // 3 + 200] = bytes(range(200))
    changed = {"truncated": bytes(data[: len(data) // 2]), "empty": b"", "text": b"not a table\n" * 99}
    target.write_bytes(changed.get(broken, bytes(data)))
    if broken == "garbled":
        try:  # bytes of a column's numbers may still be numbers
            open_log(path)
        except LogError as error:
            assert target.name in str(error) and "\n" not in str(error)
        return
    with pytest.raises(LogError, match=f"{target.name}: is no Feather file that can be read") as caught:
        open_log(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("file", [MOUNTS, INTRINSICS])
def test_missing_files_are_named(path: Path, file: str) -> None:
    (path / file).unlink()
    with pytest.raises(LogError, match=f"{file}: is missing"):
        open_log(path)


def test_a_folder_without_poses_is_no_log(path: Path) -> None:
    (path / POSES).unlink()
    with pytest.raises(
        LogError, match=r"is no recorded drive .*Argoverse 2: a folder with city_SE3_egovehicle.feather"
    ):
        open_log(path)


def test_a_test_split_has_no_boxes(path: Path) -> None:
    (path / BOXES).unlink()
    log = open_log(path)
    assert "annotations.feather is missing" in log.missing and log.drive.actors == {}
    assert len(log.drive.frames) == 2 and len(log.sweep("up_lidar", 1).points)


def test_the_lidar_dataset_has_neither_images_nor_boxes(path: Path) -> None:
    shutil.rmtree(path / "sensors/cameras")
    for file in (BOXES, INTRINSICS):
        (path / file).unlink()
    log = open_log(path)
    assert log.missing == ("annotations.feather is missing", "sensors/cameras is missing: no images")
    assert log.drive.cameras == {} and len(log.sweep("down_lidar", 0).points)


def test_a_camera_without_intrinsics_is_told(path: Path) -> None:
    """As the stereo pair of some logs."""
    shutil.copytree(path / "sensors/cameras/ring_front_center", path / "sensors/cameras/stereo_front_left")
    log = open_log(path)
    assert "camera stereo_front_left is left out: intrinsics.feather has no row of it" in log.missing
    assert list(log.drive.cameras) == ["ring_front_center"]


def test_missing_sweeps_are_told(path: Path) -> None:
    first, _ = sweeps(path)
    first.unlink()
    log = open_log(path)
    assert "lidar: no sweeps of 1 of 2 frames: 0" in log.missing
    assert log.sweep_frames("down_lidar") == (1,) and len(log.drive.frames) == 2
    with pytest.raises(LogError, match="down_lidar has no sweep of frame 0"):
        log.sweep("down_lidar", 0)
    shutil.rmtree(path / "sensors/lidar")
    log = open_log(path)
    assert "lidar: no sweeps" in log.missing and log.drive.lidars == {} and log.drive.actors
    (path / BOXES).unlink()
    with pytest.raises(LogError, match="holds neither sweeps in sensors/lidar nor boxes in annotations.feather"):
        open_log(path)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put("offset_ns", 7, -5), "row 7 has the offset_ns -5, not one from 0 to 1000000000"),
        (put("x", 7, np.nan), "row 7 of column 'x' is nan"),
        (lambda t: t.update(z=pyarrow.nulls(len(t["x"]), pyarrow.float16())), "column 'z' has [0-9]* empty cells"),
        (lambda t: t.update(z=pyarrow.nulls(len(t["x"]))), "column 'z' has [0-9]* empty cells"),
        (lambda t: t.update(laser_number=t["x"]), "'laser_number' holds halffloat, not whole numbers"),
    ],
)
def test_wrong_returns_are_named(path: Path, change: Callable[[Table], Any], message: str) -> None:
    target = sweeps(path)[1]
    edit(target, change)
    with pytest.raises(LogError, match=f"{target.name}: .*{message}"):
        open_log(path)


def test_sweeps_of_too_few_returns_leave_the_lidar_out(path: Path) -> None:
    for sweep in sweeps(path):
        edit(sweep, lambda table: table.update({name: values[:50] for name, values in table.items()}))
    log = open_log(path)
    assert log.drive.lidars == {}
    for name in ("up_lidar", "down_lidar"):
        assert any(sentence.startswith(f"{name}: its") and ".feather" in sentence for sentence in log.missing)


def test_returns_that_do_not_turn_leave_the_lidar_out(path: Path) -> None:
    for sweep in sweeps(path):
        edit(sweep, lambda table: table["offset_ns"].fill(5_000_000))
    log = open_log(path)
    assert log.drive.lidars == {} and any(sentence.startswith("up_lidar: its returns") for sentence in log.missing)


def test_nothing_is_read_before_it_is_asked_for(path: Path) -> None:
    images = sorted((path / "sensors/cameras/ring_front_center").iterdir())
    images[3].write_bytes(b"broken")
    log = open_log(path)
    number = next(
        n for n in log.image_frames("ring_front_center") if log.image_path("ring_front_center", n) == images[3]
    )
    with pytest.raises(LogError, match=rf"{images[3].name}: is no JPEG"):
        log.image("ring_front_center", number)


def test_an_image_of_another_size_is_named(path: Path) -> None:
    edit(path / INTRINSICS, put("width_px", 0, 32))
    log = open_log(path)
    with pytest.raises(LogError, match=r"\.jpg: has 31x41 pixels, intrinsics.feather gives ring_front_center 32x41"):
        log.image("ring_front_center", 0)


def test_pyarrow_is_asked_for_in_one_sentence(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(LogError, match=r"needs pyarrow, .*pip install '\.\[parquet\]'"):
        open_log(path)
