"""The PandaSet reader: whole logs, logs with parts missing, and logs with something wrong in them."""

from __future__ import annotations

import dataclasses
import gzip
import json
import pickle
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from small_log import small_drive, write_small_log

from unisim_blender.core.data.log import Sweep, extras_of
from unisim_blender.core.data.splits import PANDASET, SPLITS
from unisim_blender.core.data.sweep_cells import find_cells, make_grid
from unisim_blender.core.errors import LogError
from unisim_blender.core.formats import readers
from unisim_blender.core.formats.common.file_log import ranges
from unisim_blender.core.formats.pandaset.safe_pickle import read_table
from unisim_blender.core.formats.pandaset.sensors import pandar64
from unisim_blender.core.formats.pandaset.write import write_table
from unisim_blender.core.formats.readers import SEARCHED_FOLDERS, drives_in, open_log
from unisim_blender.core.geometry import Trajectory, quaternion_from_yaw
from unisim_blender.core.prepare.scenario import scenario_at
from unisim_blender.core.sensors.lidar import beam_directions, column_times
from unisim_blender.core.world.box_tracks import passing_times
from unisim_blender.core.world.drive import Lidar, RollingShutter

CUBOIDS, SWEEP, CAMERA = "annotations/cuboids/01.pkl.gz", "lidar/01.pkl.gz", "camera/front_camera"


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "bend"
    write_small_log(path)
    return path


@pytest.fixture
def log_path(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "bend"))


def edit_json(path: Path, change: Callable[[Any], Any]) -> None:
    document = json.loads(path.read_text())
    changed = change(document)
    path.write_text(json.dumps(document if changed is None else changed))


def edit_table(path: Path, column: str, row: int | slice, value: Any) -> None:
    table = {name: values.copy() for name, values in read_table(path).items()}
    table[column][row] = value
    write_table(path, table)


# What is missing


def test_missing_frames_are_known_by_number(log_path: Path) -> None:
    (log_path / CAMERA / "01.jpg").unlink()
    (log_path / "lidar/02.pkl.gz").unlink()
    (log_path / "annotations/cuboids/00.pkl.gz").unlink()
    log = open_log(log_path)
    assert log.image_frames("front_camera") == (0, 2, 3) and log.sweep_frames("pandar64") == (0, 1, 3)
    assert "camera front_camera: no images of 1 of 4 frames: 1" in log.missing
    assert "lidar: no sweeps of 1 of 4 frames: 2" in log.missing
    assert "annotations: no cuboids of 1 of 4 frames: 0" in log.missing
    assert log.drive.actors["car-1"].start_s == pytest.approx(log.drive.time_s[1] - 0.05)
    with pytest.raises(LogError, match="front_camera has no image of frame 1"):
        log.image("front_camera", 1)
    with pytest.raises(LogError, match="pandar64 has no sweep of frame 2"):
        log.sweep("pandar64", 2)


def test_a_missing_camera_is_reported(log_path: Path) -> None:
    shutil.rmtree(log_path / CAMERA)
    log = open_log(log_path)
    assert log.drive.cameras == {} and "camera front_camera is missing" in log.missing
    assert log.image_frames("front_camera") == ()


def test_tables_that_others_unpacked_are_read(log_path: Path) -> None:
    """A copy of the dataset that is much used has lidar/00.pkl in place of lidar/00.pkl.gz."""
    before = open_log(log_path)
    sweep = before.sweep("pandar64", 1)
    for path in [*log_path.rglob("*.pkl.gz")]:
        path.with_suffix("").write_bytes(gzip.decompress(path.read_bytes()))
        path.unlink()
    log = open_log(log_path)
    assert log.missing == before.missing and log.drive.actors.keys() == before.drive.actors.keys()
    assert log.sweep_frames("pandar64") == before.sweep_frames("pandar64")
    np.testing.assert_array_equal(log.sweep("pandar64", 1).points, sweep.points)
    np.testing.assert_array_equal(log.sweep("pandar64", 1).semantic, sweep.semantic)


def test_missing_classes_are_unknown(log_path: Path) -> None:
    shutil.rmtree(log_path / "annotations/semseg")
    log = open_log(log_path)
    assert "annotations: no semantic classes" in log.missing
    assert (log.sweep("pandar64", 0).semantic == -1).all()


def test_nothing_is_read_before_it_is_asked_for(log_path: Path) -> None:
    for path in [*(log_path / "lidar").glob("*.pkl.gz"), *(log_path / CAMERA).glob("*.jpg")]:
        if path.name != "00.jpg":  # its header tells the camera's size
            path.write_bytes(b"broken")
    log = open_log(log_path)
    with pytest.raises(LogError, match=r"lidar/01\.pkl\.gz: cannot be unpacked"):
        log.sweep("pandar64", 1)
    with pytest.raises(LogError, match=r"front_camera/01\.jpg: is no JPEG"):
        log.image("front_camera", 1)


# What is wrong


@pytest.mark.parametrize(
    ("file", "change", "message"),
    [
        (
            "lidar/timestamps.json",
            lambda t: [t[0], t[2], t[1], t[3]],
            r"frame 2 at 0\.103\S* s is not later than frame 1",
        ),
        ("lidar/timestamps.json", lambda t: [*t[:3], float("nan")], "entry 3 is not finite"),
        ("lidar/timestamps.json", lambda t: {"a": 1}, "no list of timestamps"),
        ("lidar/timestamps.json", lambda t: [], "holds no timestamp"),
        ("lidar/poses.json", lambda p: p[:3], "holds 3 poses for 4 timestamps"),
        ("lidar/poses.json", lambda p: [*p[:3], {"position": {}}], "pose of frame 3 is no position and heading"),
        ("lidar/poses.json", lambda p: p[1]["heading"].update(w=2.0), "heading of frame 1 has length 2"),
        ("lidar/poses.json", lambda p: p[2]["position"].update(y=float("inf")), "pose of frame 2 .* not finite"),
        (f"{CAMERA}/poses.json", lambda p: p[:1], "front_camera/poses.json: holds 1 poses for 4 timestamps"),
        (f"{CAMERA}/timestamps.json", lambda t: t[::-1], "front_camera/timestamps.json: frame 1 at"),
        (f"{CAMERA}/intrinsics.json", lambda k: k.pop("fx"), "does not hold the numbers fx, fy, cx and cy"),
        (f"{CAMERA}/intrinsics.json", lambda k: k.update(fy=0.0), "fy is 0.0"),
        ("meta/unisim.json", lambda m: m.update(version=99), "version: is newer than"),
        ("meta/unisim.json", lambda m: m.update(frames=[0, 7]), "names frame 7, but the lidar has 4 timestamps"),
        (
            "meta/unisim.json",
            lambda m: m["cameras"].update({"../x": m["cameras"]["front_camera"]}),
            "is no sensor's name",
        ),
    ],
)
def test_wrong_values_are_named_with_their_file(
    log_path: Path, file: str, change: Callable[[Any], Any], message: str
) -> None:
    edit_json(log_path / file, change)
    with pytest.raises(LogError, match=message) as caught:
        open_log(log_path)
    assert Path(file).name in str(caught.value) or "names frame" in str(caught.value)


@pytest.mark.parametrize(
    "file", ["lidar/poses.json", "lidar/timestamps.json", f"{CAMERA}/poses.json", f"{CAMERA}/intrinsics.json"]
)
def test_missing_and_broken_files_are_named(log_path: Path, file: str) -> None:
    (log_path / file).write_text("[[[")
    with pytest.raises(LogError, match=f"{file}: is not valid JSON"):
        open_log(log_path)
    (log_path / file).write_text("[" * 100_000)
    with pytest.raises(LogError, match=f"{file}: is not valid JSON"):
        open_log(log_path)
    (log_path / file).unlink()
    with pytest.raises(LogError, match=f"{file}: is missing"):
        open_log(log_path)


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("position.y", np.nan, "cuboid car-1 holds a value that is not finite"),
        ("yaw", np.inf, "cuboid car-1 holds a value that is not finite"),
        ("dimensions.x", 0.0, r"cuboid car-1 has the size \(4\.5, 0\.0, 1\.6\) m"),
        ("dimensions.z", -1.0, r"cuboid car-1 has the size \(4\.5, 1\.9, -1\.0\) m"),
        ("uuid", "van", "cuboid van stands there twice"),
    ],
)
def test_wrong_cuboids_are_refused(log_path: Path, column: str, value: Any, message: str) -> None:
    edit_table(log_path / CUBOIDS, column, 0, value)
    with pytest.raises(LogError, match=rf"cuboids/01\.pkl\.gz: {message}"):
        open_log(log_path)


def test_wrong_points_are_refused(log_path: Path) -> None:
    edit_table(log_path / SWEEP, "z", 5, np.nan)
    with pytest.raises(LogError, match=r"lidar/01\.pkl\.gz: a point holds a value that is not finite"):
        open_log(log_path).sweep("pandar64", 1)
    edit_table(log_path / SWEEP, "z", 5, 0.0)
    edit_table(log_path / SWEEP, "t", 5, 77.0)
    with pytest.raises(LogError, match=r"lidar/01\.pkl\.gz: a point is 76\.897 s from its sweep's timestamp"):
        open_log(log_path).sweep("pandar64", 1)


def test_classes_of_another_sweep_are_refused(log_path: Path) -> None:
    write_table(log_path / "annotations/semseg/01.pkl.gz", {"class": np.arange(3)})
    with pytest.raises(LogError, match=r"semseg/01\.pkl\.gz: holds 3 classes for the sweep's \d+ points"):
        open_log(log_path).sweep("pandar64", 1)


def test_images_of_the_wrong_size_are_refused(log_path: Path) -> None:
    Image.new("RGB", (20, 10)).save(log_path / CAMERA / "02.jpg")
    with pytest.raises(LogError, match=r"02\.jpg: has 20x10 pixels, the camera's first image has 48x32"):
        open_log(log_path).image("front_camera", 2)


def test_a_truncated_image_is_refused(log_path: Path) -> None:
    path = log_path / CAMERA / "02.jpg"
    path.write_bytes(path.read_bytes()[:-300])
    with pytest.raises(LogError, match=r"02\.jpg: cannot be decoded"):
        open_log(log_path).image("front_camera", 2)


def test_files_beyond_the_timestamps_are_refused(log_path: Path) -> None:
    shutil.copy(log_path / SWEEP, log_path / "lidar/04.pkl.gz")
    with pytest.raises(LogError, match=r"04\.pkl\.gz: is frame 4, but there are 4 timestamps only"):
        open_log(log_path)
    (log_path / "lidar/04.pkl.gz").rename(log_path / "lidar/1.pkl.gz")
    with pytest.raises(LogError, match=r"1\.pkl\.gz: is frame 1, and so is"):
        open_log(log_path)


def test_files_of_frames_that_a_log_does_not_name_are_not_its_own(log_path: Path) -> None:
    document = json.loads((log_path / "meta/unisim.json").read_text())
    document["frames"] = document["frames"][1:3]
    (log_path / "meta/unisim.json").write_text(json.dumps(document))
    log = open_log(log_path)
    assert log.drive.frames == (1, 2) and not log.missing
    assert all(log.image_frames(camera) == (1, 2) for camera in log.drive.cameras)
    for lidar in log.drive.lidars:
        assert log.sweep_frames(lidar) == (1, 2) and len(log.sweep(lidar, 1).time_s)
        with pytest.raises(LogError, match="has no sweep of frame 0"):
            log.sweep(lidar, 0)


def test_a_hostile_cuboid_file_does_not_run(log_path: Path, tmp_path: Path) -> None:
    class Evil:
        def __reduce__(self) -> tuple[Any, ...]:
            return (open, (str(tmp_path / "ran"), "w"))

    (log_path / CUBOIDS).write_bytes(gzip.compress(pickle.dumps(Evil())))
    with pytest.raises(LogError, match=r"cuboids/01\.pkl\.gz: refused"):
        open_log(log_path)
    assert not (tmp_path / "ran").exists()


def test_what_is_no_log_is_said_so(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="nowhere: there is no such log"):
        open_log(tmp_path / "nowhere")
    (tmp_path / "file").write_text("x")
    for path in (tmp_path, tmp_path / "file"):
        with pytest.raises(LogError, match="is no recorded drive"):
            open_log(path)


def test_the_one_drive_in_a_folder_is_opened(original: Path, tmp_path: Path) -> None:
    """Up to two levels above it, beside folders that are none, hidden ones and rendered frames."""
    for name in ("bend", ".trash", "frames"):
        shutil.copytree(original, tmp_path / "day" / name)
    (tmp_path / "day" / "frames" / "drive.json").write_text("{}")
    (tmp_path / "notes").mkdir()
    for path in (tmp_path / "day", tmp_path):
        assert open_log(path).path == scenario_at(path).log_path == tmp_path / "day" / "bend"


def test_a_folder_of_several_drives_names_some(original: Path, tmp_path: Path) -> None:
    """A dataset's own folder, or a day's."""
    for name in ("bend", *(f"day/{number:03d}" for number in range(4))):
        shutil.copytree(original, tmp_path / name)
    with pytest.raises(LogError, match=r"several recorded drives; choose one: bend, day/000, day/001 and 2 more$"):
        open_log(tmp_path)


def test_the_search_for_drives_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Path] = []
    monkeypatch.setattr(readers, "reader_of", asked.append)
    for number in range(30):
        for inner in range(30):
            (tmp_path / f"{number:02d}" / f"{inner:02d}" / "deep").mkdir(parents=True)
    assert drives_in(tmp_path) == [] and len(asked) == 1 + SEARCHED_FOLDERS
    assert all(len(path.relative_to(tmp_path).parts) <= 2 for path in asked)


def test_reading_needs_numpy_alone(original: Path) -> None:
    """In a process where nothing but numpy and the standard library can be imported."""
    program = (
        "import sys\n"
        "class Wall:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name.partition('.')[0] in ('pandas', 'scipy', 'torch', 'PIL', 'imageio', 'skimage', 'bpy', 'trimesh'):\n"
        "            raise ImportError(name)\n"
        "sys.meta_path.insert(0, Wall())\n"
        "from unisim_blender.core.formats.readers import open_log\n"
        f"log = open_log({str(original)!r})\n"
        "print(len(log.sweep_grid('pandar64', 1).depth_m), len(log.drive.actors))\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, cwd=Path(__file__).parents[4]
    )
    assert done.stdout.split() == ["4", "3"], done.stderr


# PandaSet's own conventions, without the setup that the writer leaves


def as_pandaset(log_path: Path) -> Path:
    (log_path / "meta/unisim.json").unlink()
    return log_path


def test_ego_frame_is_turned_to_x_forward(log_path: Path) -> None:
    drive = open_log(as_pandaset(log_path)).drive
    pose = json.loads((log_path / "lidar/poses.json").read_text())[2]["heading"]
    yaw = 2 * np.arctan2(pose["z"], pose["w"])
    forward = np.array([-np.sin(yaw), np.cos(yaw), 0])  # PandaSet's y axis
    np.testing.assert_allclose(drive.world_from_ego.poses[2][:3, 0], forward, atol=1e-12)
    np.testing.assert_array_equal(drive.world_from_ego.positions[0], 0)
    np.testing.assert_allclose(drive.world_origin, small_drive().world_origin)
    assert drive.cameras["front_camera"].model.shutter == RollingShutter(0.03, 1.0)


@pytest.mark.parametrize("content", [None, {}, [{"lat": 1.0}], [{"lat": 37.8, "long": -122.4}], [{"lat": "x"}] * 4])
def test_positions_on_the_earth_that_tell_nothing_leave_the_sun_open(log_path: Path, content: object) -> None:
    as_pandaset(log_path)
    if content is not None:
        (log_path / "meta/gps.json").write_text(json.dumps(content))
    assert extras_of(open_log(log_path)).sun is None


def test_box_axes_and_yaw_by_hand(log_path: Path) -> None:
    """A cuboid 2 m wide and 5 m long at yaw 0 has its length along the world's +y."""
    for frame in range(4):
        path = log_path / f"annotations/cuboids/{frame:02d}.pkl.gz"
        for column, value in {"yaw": 0.0, "dimensions.x": 2.0, "dimensions.y": 5.0, "dimensions.z": 1.5}.items():
            edit_table(path, column, -1, value)
    actor = open_log(as_pandaset(log_path)).drive.actors["van"]
    np.testing.assert_array_equal(actor.size_m, [5.0, 2.0, 1.5])
    np.testing.assert_allclose(actor.world_from_actor.poses[0][:3, 0], [0, 1, 0], atol=1e-12)


def test_twins_of_the_second_lidar_are_dropped(log_path: Path) -> None:
    for frame in range(4):
        edit_table(log_path / f"annotations/cuboids/{frame:02d}.pkl.gz", "cuboids.sensor_id", 0, 1)
    assert "car-1" not in open_log(as_pandaset(log_path)).drive.actors


def test_points_of_the_second_lidar_are_a_sweep_of_their_own(log_path: Path) -> None:
    edit_table(log_path / SWEEP, "d", slice(0, 20), 1)
    path = log_path / SWEEP
    path.write_bytes(path.read_bytes() + bytes(10_000))  # zero padding after a gzip member is allowed, and ignored
    log = open_log(as_pandaset(log_path))
    assert log.sweep_frames("pandar_gt") == (1,)
    sweep = log.sweep("pandar_gt", 1)
    assert len(sweep.points) == 20 and (sweep.ring == -1).all()
    assert not set(map(tuple, sweep.points)) & set(map(tuple, log.sweep("pandar64", 1).points))
    with pytest.raises(LogError, match="pandar_gt does not scan beams x columns"):
        log.sweep_grid("pandar_gt", 1)


def test_returns_of_the_vehicle_itself_are_left_out(log_path: Path) -> None:
    log = open_log(as_pandaset(log_path))
    before = len(log.sweep("pandar64", 1).points)
    roof = log.drive.world_from_ego.poses[1][:3, 3] + log.drive.world_origin + [0, 0, 1.4]
    for axis, value in zip("xyz", roof, strict=True):
        edit_table(log_path / SWEEP, axis, 7, value)
    assert len(open_log(log_path).sweep("pandar64", 1).points) == before - 1


def test_a_cuboid_is_keyed_when_the_beams_pass_it() -> None:
    """The Pandar64 starts at the rear and turns clockwise: the left comes first, the front after half a turn."""
    still = Lidar(
        "l", pandar64(), Trajectory(np.zeros(1), np.zeros((1, 3)), quaternion_from_yaw(np.zeros(1))), {0: 0.0}
    )
    points = np.array([[-20.0, 2.0, 0], [0, 20.0, 0], [20.0, 0, 0], [0, -20.0, 0], [-20.0, -2.0, 0]])
    times = passing_times(still, points, np.full(5, 7.0))
    np.testing.assert_allclose(times, [6.902, 6.925, 6.950, 6.975, 6.999], atol=2e-3)


def test_a_moving_car_is_keyed_before_the_timestamp_and_a_log_of_ours_at_it(log_path: Path) -> None:
    own = open_log(log_path).drive
    np.testing.assert_allclose(own.actors["car-1"].world_from_actor.times_s, list(own.time_s.values()), atol=1e-12)
    early = open_log(as_pandaset(log_path)).drive
    late_s = np.array(list(early.time_s.values())) - early.actors["car-1"].world_from_actor.times_s
    assert ((late_s > 0) & (late_s < 0.1)).all()
    np.testing.assert_allclose(
        early.actors["car-1"].world_from_actor.positions, own.actors["car-1"].world_from_actor.positions, atol=1e-12
    )


def test_a_car_that_crosses_the_seam_has_no_two_keys_in_a_moment(log_path: Path) -> None:
    """Behind the vehicle, from its right, where the turn ends, to its left, where the next one begins."""
    times = [0.1 * frame for frame in range(4)]
    still = [{"position": dict.fromkeys("xyz", 0.0), "heading": {"w": 1.0, "x": 0.0, "y": 0.0, "z": 0.0}}] * 4
    edit_json(log_path / "lidar/timestamps.json", lambda _: times)
    edit_json(log_path / "lidar/poses.json", lambda _: still)
    for frame, side in enumerate([1.5, 0.5, -0.5, -1.5]):  # x is to the right
        for column, value in {"position.x": side, "position.y": -15.0, "position.z": 1.0}.items():
            edit_table(log_path / f"annotations/cuboids/{frame:02d}.pkl.gz", column, 0, value)
    track = open_log(as_pandaset(log_path)).drive.actors["car-1"].world_from_actor
    assert len(track.times_s) == 3 and (np.diff(track.times_s) > 0.03).all()
    assert np.abs(np.diff(track.positions[:, 0]) / np.diff(track.times_s)).max() < 25


def test_jitter_of_a_parked_car_is_evened_out(log_path: Path) -> None:
    path = log_path / "annotations/cuboids/02.pkl.gz"
    row = list(read_table(path)["uuid"]).index("van")
    edit_table(path, "position.x", row, read_table(path)["position.x"][row] + 0.2)
    van = open_log(log_path).drive.actors["van"]
    assert not van.is_moving and len(van.world_from_actor.times_s) == 1
    edit_table(path, "position.x", row, read_table(path)["position.x"][row] + 2.0)
    assert open_log(log_path).drive.actors["van"].is_moving


# Cells


def test_every_cell_of_the_beam_table_is_found_again() -> None:
    model = pandar64()
    directions = beam_directions(model)
    ring, column = find_cells((directions * 7.0).reshape(-1, 3), model)
    expected = np.indices(directions.shape[:2])
    np.testing.assert_array_equal(ring.reshape(64, 1800), expected[0])
    np.testing.assert_array_equal(column.reshape(64, 1800), expected[1])


def test_a_point_far_from_every_beam_has_no_cell() -> None:
    ring, column = find_cells(np.array([[1.0, 0, 1.0], [5.0, 0, 0]]), pandar64())
    assert ring.tolist()[0] == column.tolist()[0] == -1 and ring[1] == 17


def test_of_two_returns_in_a_cell_the_nearer_stays_and_drops_near_the_seam_take_their_turns_time() -> None:
    model = dataclasses.replace(pandar64(), columns=36)
    pose = Trajectory(np.array([0.0, 1.0]), np.array([[0.0, 0, 0], [10, 0, 0]]), quaternion_from_yaw(np.zeros(2)))
    lidar = Lidar("l", model, pose, {0: 0.5})
    times = column_times(lidar, lidar.time_s[0])
    local = beam_directions(model)[10, [1, 3, 3]] * np.array([[10.0], [9.0], [4.0]])
    at = np.array([times[1] + model.sweep_s, times[3], times[3]])  # the first belongs to the end of the turn
    origins = pose.at(at)[:, :3, 3]
    ring, column = find_cells(local, model)
    sweep = Sweep(local + origins, origins, at, np.array([0.1, 0.2, 0.3], np.float32), ring, column, ring)
    grid = make_grid(sweep, lidar, 0, np.ones((64, 36), bool))
    assert (
        grid.returned.sum() == 2
        and grid.depth_m[10, 3] == pytest.approx(4.0)
        and grid.intensity[10, 3] == np.float32(0.3)
    )
    assert not grid.blocked[10, 1] and grid.blocked[10, 0]
    assert grid.time_s[10, 0] == pytest.approx(times[0] + 0.1)
    np.testing.assert_allclose(grid.origins[10, 0], pose.at(times[0] + 0.1)[:3, 3])
    np.testing.assert_allclose(grid.directions[10, 0], beam_directions(model)[10, 0])
    assert grid.time_s[10, 4] == pytest.approx(times[4]) and grid.time_s[9, 0] == pytest.approx(times[0])


def test_a_cell_that_returns_in_another_frame_is_a_drop_and_not_blocked(log_path: Path) -> None:
    table = read_table(log_path / SWEEP)
    classes = read_table(log_path / "annotations/semseg/01.pkl.gz")
    sweep = open_log(log_path).sweep("pandar64", 1)
    gone = (sweep.ring == 3) & (sweep.column == 8)
    assert gone.sum() == 1
    write_table(log_path / SWEEP, {name: column[~gone] for name, column in table.items()})
    write_table(log_path / "annotations/semseg/01.pkl.gz", {"class": classes["class"][~gone]})
    grid = open_log(log_path).sweep_grid("pandar64", 1)
    assert not grid.returned[3, 8] and not grid.blocked[3, 8]
    assert not grid.returned[3, 7] and grid.blocked[3, 7]


# Words and names


def test_ranges_in_words() -> None:
    assert ranges([7, 3, 8, 9, 11, 12]) == "3, 7-9, 11-12" and ranges([5]) == "5" and ranges([]) == ""


def test_splits() -> None:
    assert len(PANDASET) == len(set(PANDASET)) == 103 and list(PANDASET) == sorted(PANDASET)
    sizes = {name: len(sequences) for name, sequences in SPLITS.items()}
    assert sizes == {"pandaset": 103, "seed10": 10, "seed24-validation": 24, "seed24-training": 79}
    assert set(SPLITS["seed10"]) <= set(SPLITS["seed24-validation"]) <= set(PANDASET)


def test_a_pose_beyond_numbers_is_refused_by_file_and_value(log_path: Path) -> None:
    edit_json(log_path / CAMERA / "poses.json", lambda poses: poses[1]["position"].update(x=1.5e308))
    edit_json(log_path / "meta" / "unisim.json", lambda setup: setup.update(world_origin=[-1.5e308, 0, 0]))
    with pytest.raises(
        LogError, match=r"bend: the trajectory of the vehicle goes 1\.5e\+308 m from the drive's origin"
    ):
        open_log(log_path)


def test_a_class_that_is_no_number_and_a_broken_image_are_refused(log_path: Path) -> None:
    file = log_path / "annotations" / "semseg" / "01.pkl.gz"
    classes = {name: values.astype(object) for name, values in read_table(file).items()}
    classes["class"][0] = "tree"
    write_table(file, classes)
    with pytest.raises(LogError, match=r"semseg/01\.pkl\.gz: a class is no number"):
        open_log(log_path).sweep("pandar64", 1)
    file.unlink()
    points = {name: values.astype(object) for name, values in read_table(log_path / SWEEP).items()}
    points["x"][0] = "far"
    write_table(log_path / SWEEP, points)
    with pytest.raises(LogError, match=r"lidar/01\.pkl\.gz: a point's numbers are none"):
        open_log(log_path).sweep("pandar64", 1)
    image = log_path / CAMERA / "00.jpg"
    image.write_bytes(b"\xff\xd8\xff\xe0\x00\x00" + image.read_bytes()[6:])
    with pytest.raises(LogError, match=r"00\.jpg: is a broken JPEG image"):
        open_log(log_path)


@pytest.mark.parametrize("row", (0, 3))
def test_a_mount_that_is_no_pose_is_refused(log_path: Path, row: int) -> None:
    def change(setup: Any) -> None:
        setup["lidars"]["pandar64"]["ego_from_lidar"][row] = [0.0, 0.0, 0.0, 0.0]

    edit_json(log_path / "meta" / "unisim.json", change)
    with pytest.raises(LogError, match=r"unisim\.json: lidars\.pandar64\.ego_from_lidar: is no pose"):
        open_log(log_path)


def test_a_long_text_does_not_flood_a_sentence(log_path: Path) -> None:
    edit = {name: values.astype(object) for name, values in read_table(log_path / CUBOIDS).items()}
    edit["yaw"][0] = "y" * 5000
    write_table(log_path / CUBOIDS, edit)
    with pytest.raises(LogError, match=r"01\.pkl\.gz: a cuboid's numbers are none") as caught:
        open_log(log_path)
    assert len(str(caught.value)) < 600


def test_frames_that_are_no_time_apart_are_refused(log_path: Path) -> None:
    edit_json(log_path / "lidar" / "timestamps.json", lambda times: times.__setitem__(1, times[0] + 1e-7))
    with pytest.raises(LogError, match=r"lidar/timestamps\.json: frame 1 at .* s is not later than frame 0"):
        open_log(log_path)
