"""The reader of Argoverse 2 on the procedural street, written in the dataset's layout by the test's own code."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
pytest.importorskip("scipy", reason="the extra torch is not installed")

from argoverse2_street import (  # noqa: E402
    CYCLE_NS,
    LABELS,
    START_NS,
    SWEEPS,
    Argoverse2Street,
    Device,
    Returned,
)

from unisim_blender.core.formats.argoverse2.read import Argoverse2Log  # noqa: E402
from unisim_blender.core.formats.readers import open_log  # noqa: E402
from unisim_blender.core.geometry import invert_pose  # noqa: E402

FLOAT16 = 2.0**-11
"""Largest rounding error of a float16, relative."""


@pytest.fixture(scope="module")
def made() -> Argoverse2Street:
    return Argoverse2Street()


@pytest.fixture(scope="module")
def path(made: Argoverse2Street, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("argoverse2") / "log"
    made.write(folder)
    return folder


@pytest.fixture(scope="module")
def log(path: Path) -> Argoverse2Log:
    read = open_log(path)
    assert isinstance(read, Argoverse2Log)
    return read


def measured(made: Argoverse2Street, log: Argoverse2Log, name: str, sweep: int) -> tuple[Device, Returned]:
    """What a device truly measured, world of the log that was read."""
    device = next(device for device in made.devices if device.name == name)
    true = made.measure(device, sweep)
    shift = log.drive.world_origin - made.city
    return device, replace(true, points=true.points - shift, origins=true.origins - shift)


def test_poses_keep_city_coordinates(made: Argoverse2Street, log: Argoverse2Log) -> None:
    assert log.drive.frames == tuple(range(SWEEPS))
    for frame, stamp in enumerate(made.stamps_ns):
        assert log.drive.time_s[frame] == (stamp - START_NS) / 1e9
    times = np.arange(START_NS, made.stamps_ns[-1], 1_234_567)
    turned, place = made.ego(times)
    poses = log.drive.world_from_ego.at((times - START_NS) / 1e9)
    np.testing.assert_allclose(poses[:, :3, 3] + log.drive.world_origin, place + made.city, atol=1e-6)
    np.testing.assert_allclose(poses[:, :3, :3], turned.as_matrix(), atol=1e-6)
    np.testing.assert_allclose(log.drive.world_from_ego.at(0.0)[:3, 3], 0, atol=1e-9)


def test_far_from_the_citys_origin_nothing_is_lost(made: Argoverse2Street, tmp_path: Path) -> None:
    far = Argoverse2Street(city=np.array([1.2e6, -3.4e6, 900.0]), sweeps=2)
    far.write(tmp_path / "log")
    log = Argoverse2Log(tmp_path / "log")
    turned, place = far.ego(np.array(far.stamps_ns))
    poses = log.drive.world_from_ego.at((np.array(far.stamps_ns) - START_NS) / 1e9)
    np.testing.assert_allclose(poses[:, :3, 3] + log.drive.world_origin, place + far.city, atol=1e-6)
    np.testing.assert_allclose(poses[:, :3, 3], place - place[0], atol=1e-6)
    _, true = measured(far, log, "up_lidar", 1)
    sweep = log.sweep("up_lidar", 1)
    np.testing.assert_allclose(sweep.origins, true.origins, atol=1e-6)


@pytest.mark.parametrize("name", ["up_lidar", "down_lidar"])
@pytest.mark.parametrize("sweep", [0, 3])
def test_rays_are_those_that_were_fired(made: Argoverse2Street, log: Argoverse2Log, name: str, sweep: int) -> None:
    device, true = measured(made, log, name, sweep)
    read = log.sweep(name, sweep)
    assert len(read.points) == len(true.points) > 5000
    np.testing.assert_allclose(read.time_s, true.time_s, atol=1e-9)
    np.testing.assert_allclose(read.origins, true.origins, atol=1e-6)
    pose = log.drive.world_from_ego.at(log.drive.time_s[sweep])
    in_file = np.abs((true.points - pose[:3, 3]) @ pose[:3, :3])
    error = np.abs((read.points - true.points) @ pose[:3, :3])
    assert (error <= FLOAT16 * in_file + 1e-6).all()
    assert 0.001 < np.median(np.linalg.norm(error, axis=1)) < 0.02
    np.testing.assert_allclose(read.intensity, made.laser_number(device, true.laser) * 3 / 255, atol=1e-6)


@pytest.mark.parametrize("name", ["up_lidar", "down_lidar"])
def test_the_beam_table_is_found(made: Argoverse2Street, log: Argoverse2Log, name: str) -> None:
    device = next(device for device in made.devices if device.name == name)
    model = log.drive.lidars[name].model
    down = np.argsort(-device.elevation)
    np.testing.assert_allclose(np.degrees(model.elevation_rad), np.degrees(device.elevation[down]), atol=0.01)
    offsets = device.offset[down] + device.spin * 2 * np.pi * device.delay_ns[down] / 1e9 / 0.0998
    np.testing.assert_allclose(np.degrees(model.azimuth_offset_rad), np.degrees(offsets - offsets.mean()), atol=0.02)
    assert model.direction == device.spin and model.beam_time_s is not None
    np.testing.assert_allclose(model.beam_time_s, device.delay_ns[down] / 1e9, atol=1e-7)
    assert model.columns == round(0.0998e9 / CYCLE_NS)
    assert model.sweep_s == pytest.approx(model.columns * CYCLE_NS / 1e9, rel=1e-6)


@pytest.mark.parametrize("name", ["up_lidar", "down_lidar"])
def test_cells_are_beams_and_firings(made: Argoverse2Street, log: Argoverse2Log, name: str) -> None:
    device, true = measured(made, log, name, 2)
    sweep = log.sweep(name, 2)
    rank = np.argsort(np.argsort(-device.elevation))
    np.testing.assert_array_equal(sweep.ring, rank[true.laser])
    fired = (true.offset_ns - device.delay_ns[true.laser]) // CYCLE_NS
    columns = log.drive.lidars[name].model.columns
    shift = (sweep.column - fired) % columns
    assert (shift == shift[0]).all()


@pytest.mark.parametrize("name", ["up_lidar", "down_lidar"])
def test_drops_are_the_rays_that_did_not_return(made: Argoverse2Street, log: Argoverse2Log, name: str) -> None:
    device, true = measured(made, log, name, 3)
    grid, sweep = log.sweep_grid(name, 3), log.sweep(name, 3)
    rank = np.argsort(np.argsort(-device.elevation))
    columns = grid.model.columns
    fired = (true.offset_ns - device.delay_ns[true.laser]) // CYCLE_NS
    shift = (sweep.column[0] - fired[0]) % columns
    ring = rank[true.drop_laser]
    dropped = (true.drop_offset_ns - device.delay_ns[true.drop_laser]) // CYCLE_NS
    column = (dropped + shift) % columns
    # a sweep is a little longer than a turn: some cells are fired at twice
    once = ~grid.returned[ring, column]
    assert once.mean() > 0.98 and len(once) > 200
    ring, column = ring[once], column[once]
    assert not grid.returned[ring, column].any()
    cosine = (grid.directions[ring, column] * true.drop_directions[once]).sum(-1)
    step = 360 / columns
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 0.6 * step
    late = grid.time_s[ring, column] - (made.stamps_ns[3] + true.drop_offset_ns[once] - START_NS) / 1e9
    late -= grid.model.sweep_s * np.rint(late / grid.model.sweep_s)
    assert np.abs(late).max() < CYCLE_NS / 1e9
    assert grid.returned.sum() + grid.blocked.sum() <= grid.returned.size and not (grid.returned & grid.blocked).any()


def test_the_phase_of_every_sweep_is_known(made: Argoverse2Street, log: Argoverse2Log) -> None:
    for device in made.devices:
        lidar = log.drive.lidars[device.name]
        assert lidar.phase is not None
        for frame, stamp in enumerate(made.stamps_ns):
            turned = device.spin * 2 * np.pi * (stamp - START_NS) / 1e9 / 0.0998
            beside = lidar.phase.at(log.drive.time_s[frame]) - lidar.phase.at(0.0) - turned
            assert abs(np.degrees(np.angle(np.exp(1j * beside)))) < 1.0  # a firing is 0.8 degrees


def test_which_lasers_are_which_lidars_is_told_from_the_points(tmp_path: Path) -> None:
    swapped = Argoverse2Street(swapped=True, sweeps=2)
    swapped.write(tmp_path / "log")
    log = Argoverse2Log(tmp_path / "log")
    for name in ("up_lidar", "down_lidar"):
        _, true = measured(swapped, log, name, 1)
        sweep = log.sweep(name, 1)
        assert len(sweep.points) == len(true.points)
        np.testing.assert_allclose(sweep.origins, true.origins, atol=1e-6)


def test_boxes_are_where_things_were_when_the_beams_passed(made: Argoverse2Street, log: Argoverse2Log) -> None:
    shift = log.drive.world_origin - made.city
    assert set(log.drive.actors) == set(made.street.drive.actors)
    moving = 0
    for uid, true in made.street.drive.actors.items():
        read = log.drive.actors[uid]
        assert read.label == LABELS[true.label]
        np.testing.assert_allclose(read.size_m, true.size_m, atol=1e-9)
        track = true.world_from_actor
        far = float(np.linalg.norm(track.positions_at(0.3) - track.positions_at(0.0)))
        if far > 2:  # a log of 0.3 s tells no slower motion from a box that wanders
            moving += 1
            assert read.is_moving
            keys = read.world_from_actor.times_s
            assert len(keys) >= SWEEPS - 1
            np.testing.assert_allclose(read.world_from_actor.positions + shift, track.positions_at(keys), atol=0.01)
            between = np.linspace(keys[0], keys[-1], 40)
            error = invert_pose(track.at(between)) @ read.world_from_actor.at(between)
            assert np.abs(error[:, :3, :3] - np.eye(3)).max() < 1e-3
        elif far == 0:
            assert not read.is_moving
            np.testing.assert_allclose(read.world_from_actor.at(0.1)[:3, 3] + shift, track.at(0.1)[:3, 3], atol=1e-6)
    assert moving >= 1


def test_images_are_undistorted_pinholes_at_their_own_times(made: Argoverse2Street, log: Argoverse2Log) -> None:
    assert set(log.drive.cameras) == {"ring_front_center"}
    assert "camera ring_side_left has no images" in log.missing
    camera = log.drive.cameras["ring_front_center"]
    model = camera.model
    assert (model.width, model.height, model.fx, model.fy) == (31, 41, 35.0, 35.5)
    assert (model.cx, model.cy, model.is_pinhole, model.shutter.duration_s) == (15.2, 20.9, True, 0.0)
    stamps = made.image_ns["ring_front_center"]
    numbers = log.image_frames("ring_front_center")
    assert len(numbers) == len(stamps) == 8 and set(range(SWEEPS)) < set(numbers)
    for number in numbers:
        image = log.image("ring_front_center", number)
        assert image.shape == (41, 31, 3)
        which = round(image[20, 15, 0] / 20)
        assert camera.time_s[number] == (stamps[which] - START_NS) / 1e9
        assert log.image_path("ring_front_center", number).name == f"{stamps[which]}.jpg"  # type: ignore[union-attr]
    turned, place = made.ego(np.array(stamps[:1]))
    pose = camera.world_from_camera.at(camera.time_s[0])
    ahead = turned.apply(np.array([[1.0, 0.0, 0.0]]))[0]
    np.testing.assert_allclose(pose[:3, 2], ahead, atol=1e-6)
    centre = place[0] + turned.apply(np.array([[1.63, 0.0, 1.4]]))[0] + made.city - log.drive.world_origin
    np.testing.assert_allclose(pose[:3, 3], centre, atol=1e-6)
