"""What is written in PandaSet's layout reads back as it was: by our reader, and the tables by pandas too."""

from __future__ import annotations

import dataclasses
import gzip
from pathlib import Path

import numpy as np
import pytest
from small_log import LIDAR, small_drive, small_image, small_sweep, write_small_log

from unisim_blender.core.errors import LogError, OutputError
from unisim_blender.core.formats.pandaset.safe_pickle import read_table
from unisim_blender.core.formats.pandaset.write import PandasetWriter, write_table
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import Trajectory


@pytest.fixture(scope="module")
def log_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "bend"
    write_small_log(path)
    return path


def test_drive_reads_back_as_it_was(log_path: Path) -> None:
    wrote, read = small_drive(), open_log(log_path).drive
    assert read.name == wrote.name and read.frames == wrote.frames and read.time_s == wrote.time_s
    np.testing.assert_array_equal(read.world_origin, wrote.world_origin)
    np.testing.assert_allclose(read.world_from_ego.poses, wrote.world_from_ego.poses, atol=1e-9)
    camera, lidar = read.cameras["front_camera"], read.lidars["pandar64"]
    assert camera.model == wrote.cameras["front_camera"].model
    assert camera.time_s == pytest.approx(wrote.cameras["front_camera"].time_s, abs=1e-12)
    np.testing.assert_allclose(
        camera.world_from_camera.poses, wrote.cameras["front_camera"].world_from_camera.poses, atol=1e-9
    )
    np.testing.assert_allclose(lidar.world_from_lidar.poses, wrote.lidars["pandar64"].world_from_lidar.poses, atol=1e-9)
    for field in dataclasses.fields(LIDAR):
        np.testing.assert_array_equal(getattr(lidar.model, field.name), getattr(LIDAR, field.name))


def test_actors_read_back_as_they_were(log_path: Path) -> None:
    wrote, read = small_drive(), open_log(log_path).drive
    assert set(read.actors) == set(wrote.actors)
    for uid, actor in wrote.actors.items():
        other = read.actors[uid]
        assert (other.label, other.is_moving, other.appearance) == (actor.label, actor.is_moving, actor.appearance)
        np.testing.assert_array_equal(other.size_m, actor.size_m)
        for time_s in wrote.time_s.values():
            assert other.present(time_s) == actor.present(time_s)
            np.testing.assert_allclose(other.world_from_actor.at(time_s), actor.world_from_actor.at(time_s), atol=1e-9)
        assert (other.start_s, other.end_s) == pytest.approx((actor.start_s, actor.end_s))


def test_sweep_reads_back_with_rays_and_cells(log_path: Path) -> None:
    log, drive = open_log(log_path), small_drive()
    for frame in drive.frames:
        wrote, read = small_sweep(drive, frame), log.sweep("pandar64", frame)
        np.testing.assert_allclose(read.points, wrote.points, atol=1e-9)
        np.testing.assert_allclose(read.origins, wrote.origins, atol=1e-9)
        np.testing.assert_allclose(read.intensity, wrote.intensity, atol=1e-7)
        np.testing.assert_array_equal(read.time_s, wrote.time_s)
        for name in ("ring", "column", "semantic"):
            np.testing.assert_array_equal(getattr(read, name), getattr(wrote, name))


def test_grid_has_returns_drops_and_blocked_cells(log_path: Path) -> None:
    log, drive = open_log(log_path), small_drive()
    grid, sweep = log.sweep_grid("pandar64", 2), small_sweep(drive, 2)
    returned = np.zeros((LIDAR.beams, LIDAR.columns), bool)
    returned[sweep.ring, sweep.column] = True
    np.testing.assert_array_equal(grid.returned, returned)
    hits = grid.origins + grid.directions * grid.depth_m[..., None]
    np.testing.assert_allclose(hits[sweep.ring, sweep.column], sweep.points, atol=1e-5)
    assert (grid.depth_m[~returned] == 0).all() and (grid.intensity[~returned] == 0).all()
    np.testing.assert_allclose(np.linalg.norm(grid.directions, axis=-1), 1)
    steep = np.zeros_like(returned)
    steep[3] = True  # the one beam that looks down steeply enough to be blocked
    np.testing.assert_array_equal(grid.blocked, steep & ~returned)


def test_image_reads_back(log_path: Path) -> None:
    log = open_log(log_path)
    assert log.image_frames("front_camera") == (0, 1, 2, 3)
    difference = log.image("front_camera", 3).astype(int) - small_image(3)
    assert np.abs(difference).mean() < 2


def test_equal_drives_give_equal_bytes(log_path: Path, tmp_path: Path) -> None:
    write_small_log(tmp_path / "again")
    files = sorted(path.relative_to(log_path) for path in log_path.rglob("*") if path.is_file())
    assert len(files) > 12
    for file in files:
        assert (tmp_path / "again" / file).read_bytes() == (log_path / file).read_bytes(), file


def test_pandas_reads_the_tables(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    table = {
        "uuid": np.array(["a", "b\n'", "ä"], object),
        "yaw": np.array([0.1, -np.pi, np.nan]),
        "flag": np.array([True, False, True]),
        "count": np.array([1, -2, 2**40]),
        "small": np.array([1.5, 2.5, 3.5], np.float32),
    }
    write_table(tmp_path / "t.pkl.gz", table)
    frame = pandas.read_pickle(tmp_path / "t.pkl.gz")
    assert list(frame.columns) == list(table) and list(frame.index) == [0, 1, 2]
    for name, column in table.items():
        assert frame[name].dtype == column.dtype, name
        np.testing.assert_array_equal(frame[name].to_numpy(), column)
        np.testing.assert_array_equal(read_table(tmp_path / "t.pkl.gz")[name], column)
    assert frame[frame["count"] > 0]["uuid"].tolist() == ["a", "ä"]


def test_an_empty_frame_has_a_table_without_rows(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    drive = dataclasses.replace(small_drive(), actors={})
    write_small_log(tmp_path / "empty", drive)
    assert len(pandas.read_pickle(tmp_path / "empty" / "annotations" / "cuboids" / "00.pkl.gz")) == 0
    assert open_log(tmp_path / "empty").drive.actors == {}


def test_some_frames_of_a_drive_keep_their_numbers_and_times(tmp_path: Path) -> None:
    whole = small_drive()
    part = dataclasses.replace(whole, frames=(1, 3))
    write_small_log(tmp_path / "part", part)
    read = open_log(tmp_path / "part")
    assert read.drive.frames == (1, 3) and read.sweep_frames("pandar64") == (1, 3)
    assert read.drive.time_s == {frame: whole.time_s[frame] for frame in (1, 3)}
    np.testing.assert_allclose(read.sweep("pandar64", 3).points, small_sweep(whole, 3).points, atol=1e-9)


def test_an_unfinished_log_is_no_log(tmp_path: Path) -> None:
    drive = small_drive()
    writer = PandasetWriter(tmp_path / "half", drive)
    writer.write_sweep(0, {"pandar64": small_sweep(drive, 0)})
    writer.write_cuboids(0)
    with pytest.raises(LogError, match=r"half/lidar/timestamps\.json: is missing"):
        open_log(tmp_path / "half")


def test_a_lidar_that_does_not_ride_on_the_vehicle_is_refused(tmp_path: Path) -> None:
    drive = small_drive()
    lidar = drive.lidars["pandar64"]
    pole = Trajectory(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]))
    drive = dataclasses.replace(
        drive, lidars={"pole": dataclasses.replace(lidar, sensor_id="pole", world_from_lidar=pole)}
    )
    with pytest.raises(OutputError, match="pole does not ride on the vehicle"):
        PandasetWriter(tmp_path, drive)


def test_an_image_of_another_size_is_not_written(tmp_path: Path) -> None:
    writer = PandasetWriter(tmp_path, small_drive())
    with pytest.raises(OutputError, match="48x32"):
        writer.write_image("front_camera", 0, np.zeros((31, 48, 3), np.uint8))
    assert not (tmp_path / "camera").exists()


def test_gzip_holds_no_time(log_path: Path) -> None:
    data = (log_path / "lidar" / "00.pkl.gz").read_bytes()
    assert data[4:8] == b"\0\0\0\0" and gzip.decompress(data).startswith(b"\x80\x03")
