"""The reader of Waymo Open v2 where files are missing, truncated or wrong: one sentence that names the file."""

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
from pyarrow import parquet  # noqa: E402
from waymo_street import SEGMENT, WaymoStreet  # noqa: E402

from unisim_blender.core.errors import LogError  # noqa: E402
from unisim_blender.core.formats.readers import open_log  # noqa: E402

FILE = f"{SEGMENT}.parquet"
COMPONENTS = (
    "vehicle_pose", "camera_calibration", "camera_image", "lidar_calibration", "lidar", "lidar_pose", "lidar_box",
)  # fmt: skip
FRAME = "key.frame_timestamp_micros"
RANGES, RANGES_POSE = "[LiDARComponent].range_image_return1", "[LiDARPoseComponent].range_image_return1"
POSE = "[VehiclePoseComponent].world_from_vehicle.transform"
BOX, IMAGE, LENS = "[LiDARBoxComponent].", "[CameraImageComponent].", "[CameraCalibrationComponent]."
Columns = dict[str, list[Any]]


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("waymo") / "training"
    WaymoStreet(frames=2).write(folder)
    return folder


@pytest.fixture
def path(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "training"))


def edit(path: Path, component: str, change: Callable[[Columns], Any]) -> None:
    file = path / component / FILE
    table = parquet.read_table(str(file))
    columns = {name: table[name].to_pylist() for name in table.column_names}
    change(columns)
    arrays = {
        name: pyarrow.array(values) if name not in table.column_names else _like(table[name].type, values)
        for name, values in columns.items()
    }
    parquet.write_table(pyarrow.table(arrays), str(file), row_group_size=3)


def _like(kind: Any, values: list[Any]) -> Any:
    try:
        return pyarrow.array(values, kind)
    except (pyarrow.ArrowInvalid, pyarrow.ArrowTypeError):
        return pyarrow.array(values)


def put(column: str, row: int, value: Any) -> Callable[[Columns], Any]:
    def change(columns: Columns) -> None:
        columns[column][row] = value

    return change


def within(column: str, row: int, at: int, value: Any) -> Callable[[Columns], Any]:
    def change(columns: Columns) -> None:
        columns[column][row][at] = value

    return change


def without(column: str) -> Callable[[Columns], Any]:
    return lambda columns: columns.pop(column)


@pytest.mark.parametrize(
    ("component", "change", "message"),
    [
        ("vehicle_pose", within(POSE, 1, 0, 7.0), "row 1 of column .* is no rotation and place"),
        ("vehicle_pose", within(POSE, 1, 3, float("nan")), "row .* of column .* is nan"),
        ("vehicle_pose", within(POSE, 1, 3, 1e12), r"a pose is at \(1000000000000.0"),
        ("vehicle_pose", put(POSE, 0, [1.0, 2.0]), "row 0 of column .* has 2 numbers, not 16"),
        ("vehicle_pose", put(POSE, 0, None), "(column .* has 1 empty cells|is no Parquet file .*size=16)"),
        ("vehicle_pose", without(POSE), "has no column .*transform'"),
        ("vehicle_pose", lambda c: c.update({FRAME: [c[FRAME][0]] * 2}), "the frames .* are less than 1 ms apart"),
        ("vehicle_pose", lambda c: c.update({k: v[:0] for k, v in c.items()}), "holds no frame"),
        ("lidar_box", put(BOX + "box.size.y", 1, 0.0), r"box .* has the size \(.*, 0.0, "),
        ("lidar_box", put(BOX + "type", 1, 9), "box .* has the type 9"),
        ("lidar_box", put(FRAME, 1, 5), "box .* is in the frame 5, which has no pose"),
        ("lidar_box", put(BOX + "box.heading", 1, float("inf")), "row 1 of column .*heading' is inf"),
        ("lidar_box", lambda c: c["key.laser_object_id"].__setitem__(1, c["key.laser_object_id"][0]), "stands twice"),
        ("camera_image", put(IMAGE + "rolling_shutter_params.camera_readout_done_time", 0, 0.0), "row 0 is triggered at"),
        ("camera_image", put(FRAME, 0, 5), "has an image of the frame 5, which has no pose"),
        ("camera_image", lambda c: c.update({FRAME: [c[FRAME][0]] * 4}), "sensor 1 stands twice in the frame"),
        ("camera_calibration", put(LENS + "width", 0, 0), "camera 1 has 0x32 pixels"),
        ("camera_calibration", put("key.camera_name", 0, 9), "camera 9 is none of 1 to 5"),
        ("camera_calibration", put("key.camera_name", 0, 4), "camera 4 stands there twice"),
        ("camera_calibration", put(LENS + "intrinsic.k1", 0, -1e6), "camera 1: opencv_pinhole: the parameters fold"),
        ("lidar_calibration", put("[LiDARCalibrationComponent].beam_inclination.values", 1, [0.1, 0.2]),
         "has 2 beam inclinations, but range images have 24 rows"),
        ("lidar_calibration", within("[LiDARCalibrationComponent].beam_inclination.values", 1, 3, 1.0), "do not rise"),
        ("lidar", put(RANGES + ".shape", 1, [24, 220, 3]), r"is \[24, 220, 3\], not rows, columns and 4"),
        ("lidar", put(RANGES + ".shape", 1, [1 << 20, 1 << 20, 4]), "is .*, not rows, columns and 4"),
    ],
)  # fmt: skip
def test_wrong_values_are_named_with_their_file(
    path: Path, component: str, change: Callable[[Columns], Any], message: str
) -> None:
    edit(path, component, change)
    with pytest.raises(LogError, match=f"{component}/{FILE}: .*{message}") as caught:
        open_log(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("component", "change", "message"),
    [
        ("lidar", put(RANGES + ".values", 1, [1.0, 2.0]), "holds 2 numbers for 24x220x4"),
        ("lidar", put(RANGES + ".values", 1, None), "holds no list of numbers"),
        ("lidar", within(RANGES + ".values", 1, 0, float("nan")), "row 0 of column .* is nan"),
        ("lidar", put("[LiDARComponent].range_image_return2.shape", 1, [24, 110, 4]), "has 24x110 cells"),
        ("lidar_pose", put(RANGES_POSE + ".shape", 1, [24, 220, 4]), "not rows, columns and 6"),
        ("lidar_pose", put(RANGES_POSE + ".values", 1, [0.0]), "holds 1 numbers for 24x220x6"),
        (
            "lidar_pose",
            lambda c: c[RANGES_POSE + ".values"].__setitem__(1, [1e20] * (24 * 220 * 6)),
            "m from the origin",
        ),
    ],
)
def test_wrong_sweeps_are_named_when_they_are_asked_for(
    path: Path, component: str, change: Callable[[Columns], Any], message: str
) -> None:
    edit(path, component, change)
    log = open_log(path)
    with pytest.raises(LogError, match=f"{component}/{FILE}: .*{message}") as caught:
        log.sweep("top", 0)
    assert "\n" not in str(caught.value)


def test_a_wrong_image_is_named_when_it_is_asked_for(path: Path) -> None:
    edit(path, "camera_image", put(IMAGE + "image", 3, b"broken"))
    edit(path, "camera_calibration", put(LENS + "width", 1, 64))
    log = open_log(path)
    with pytest.raises(LogError, match=f"camera_image/{FILE}: the image in row 3: is no image$"):
        log.image("front", 0)
    with pytest.raises(
        LogError, match=f"camera_image/{FILE}: the image in row 0: has 48x22 pixels, .* side_left 64x22"
    ):
        log.image("side_left", 1)
    with pytest.raises(LogError, match="front_left has no image of frame 0"):
        log.image("front_left", 0)
    assert log.image("front", 1).shape == (32, 48, 3)


@pytest.mark.parametrize("component", COMPONENTS)
@pytest.mark.parametrize("broken", ["truncated", "empty", "text", "garbled"])
def test_broken_files_are_named(path: Path, component: str, broken: str) -> None:
    file = path / component / FILE
    data = bytearray(file.read_bytes())
    if broken == "garbled":
        data[20:200] = bytes(range(180))
    changed = {"truncated": bytes(data[: len(data) // 2]), "empty": b"", "text": b"not a table\n" * 99}
    file.write_bytes(changed.get(broken, bytes(data)))
    try:
        log = open_log(path)
        for frame in log.sweep_frames("top"):
            log.sweep("top", frame)
        for camera in log.drive.cameras:
            for frame in log.image_frames(camera):
                log.image(camera, frame)
    except LogError as error:
        assert f"{component}/{FILE}: " in str(error) and "\n" not in str(error)
    else:
        assert broken == "garbled"  # bytes of a column that is not read


def test_components_that_are_not_there_are_told(path: Path) -> None:
    shutil.rmtree(path / "lidar_box")
    log = open_log(path)
    assert log.missing == ("lidar_box: there are no boxes",) and log.drive.actors == {}
    shutil.rmtree(path / "lidar_pose")
    log = open_log(path)
    assert "lidar top: there is no lidar_pose" in log.missing and log.drive.lidars == {}
    shutil.rmtree(path / "camera_calibration")
    log = open_log(path)
    assert "cameras: there is no camera_calibration" in log.missing and log.drive.cameras == {}


def test_without_images_the_vehicle_is_where_the_frames_poses_are(original: Path, path: Path) -> None:
    whole = open_log(original)
    shutil.rmtree(path / "camera_image")
    log = open_log(path)
    assert "cameras: there is no camera_image" in log.missing and log.drive.lidars
    shift = log.drive.world_origin - whole.drive.world_origin
    times = np.linspace(0.0, 0.15, 9)
    own, true = (one.drive.world_from_ego.positions_at(times) for one in (log, whole))
    np.testing.assert_allclose(own + shift, true, atol=0.02)


def test_sweeps_of_one_return(path: Path) -> None:
    """Cells of the second are empty then, its shape's too."""
    second = "[LiDARComponent].range_image_return2"

    def one(columns: Columns) -> None:
        for part in (".values", ".shape"):
            columns[second + part] = [None] * len(columns[second + part])

    before = open_log(path).sweep("top", 0)
    edit(path, "lidar", one)
    sweep = open_log(path).sweep("top", 0)
    assert before.rank is not None and sweep.rank is None and len(sweep.points) < len(before.points)
    assert before.drops is not None and sweep.drops is not None and len(sweep.drops.ring) == len(before.drops.ring)


def test_missing_rows_are_told(path: Path) -> None:
    def shorten(columns: Columns) -> None:
        first = columns[FRAME][0]
        kept = [row for row, stamp in enumerate(columns[FRAME]) if stamp != first]
        for name, values in columns.items():
            columns[name] = [values[row] for row in kept]

    edit(path, "lidar", shorten)
    edit(path, "camera_image", shorten)  # written from the last frame on
    log = open_log(path)
    assert "lidar top: no sweeps of 1 of 2 frames: 0" in log.missing
    assert "camera front: no images of 1 of 2 frames: 1" in log.missing
    with pytest.raises(LogError, match="top has no sweep of frame 0"):
        log.sweep("top", 0)
    assert log.sweep_frames("top") == (1,)


def test_a_folder_of_several_segments_asks_for_one(path: Path) -> None:
    for component in COMPONENTS:
        shutil.copy(path / component / FILE, path / component / "segment-2.parquet")
    with pytest.raises(LogError, match=r"holds 2 segments; name one by its file, as .*vehicle_pose/segment-"):
        open_log(path)
    assert open_log(path / "lidar" / "segment-2.parquet").drive.name == "segment-2"
    (path / "vehicle_pose" / "segment-2.parquet").unlink()
    with pytest.raises(LogError, match="is no recorded drive in a layout that is known"):
        open_log(path / "lidar" / "segment-2.parquet")


def test_even_inclinations_lie_between_their_ends(path: Path) -> None:
    values = "[LiDARCalibrationComponent].beam_inclination."
    edit(path, "lidar_calibration", put(values + "values", 1, None))
    model = open_log(path).drive.lidars["top"].model
    steps = np.diff(model.elevation_rad)
    np.testing.assert_allclose(steps, -0.36 / 24, atol=1e-12)
    assert model.elevation_rad[0] == pytest.approx(0.05 - 0.18 / 24)
    edit(path, "lidar_calibration", put(values + "max", 1, None))
    with pytest.raises(
        LogError, match=f"lidar_calibration/{FILE}: the top LiDAR's beam_inclination is from -0.31 to None"
    ):
        open_log(path)
