"""Sensors without Blender: lenses, mounts, recorded poses, directions, outlines, facts and names."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from imported_scene import imported, one_of

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.rigs import Rig
from unisim_blender.core.world.drive import CameraModel, RollingShutter
from unisim_blender.editing.layout.shapes import DISPLAY_M, pyramid, ring
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import optical, same
from unisim_blender.editing.sampled.source import DriveSource
from unisim_blender.editing.sensors.lenses import BlenderLens, lens_of, model_of_lens
from unisim_blender.editing.sensors.mounts import (
    AHEAD,
    STEEPEST_RAD,
    angles,
    from_frame,
    lag,
    level_axes,
    lidar_json,
    lidar_model,
    recorded_camera_pose,
    recorded_mount,
    recorded_pose,
    sees_the_same,
    turned_to,
)
from unisim_blender.editing.sensors.names import LONGEST_NAME, beams_of, preset_name, rate_of, rig_contents

MODEL = CameraModel(1920, 1080, 1970.0, 1955.0, 970.0, 483.0, RollingShutter(0.03, 0.5))


def test_a_lens_keeps_all_but_the_second_focal_length() -> None:
    lens = lens_of(MODEL)
    back = model_of_lens(lens, (1920, 1080))
    assert (back.fx, back.cx, back.cy) == pytest.approx((MODEL.fx, MODEL.cx, MODEL.cy)) and back.fy == back.fx
    exact = model_of_lens(lens, exact=MODEL)
    assert (exact.fx, exact.fy, exact.cx, exact.cy) == pytest.approx((1970.0, 1955.0, 970.0, 483.0))
    assert exact.shutter == MODEL.shutter and (exact.width, exact.height) == (1920, 1080)


def test_a_changed_lens_keeps_the_shape_of_pixels() -> None:
    zoomed = model_of_lens(replace(lens_of(MODEL), focal_mm=2 * lens_of(MODEL).focal_mm), exact=MODEL)
    assert zoomed.fx == pytest.approx(2 * MODEL.fx) and zoomed.fy / zoomed.fx == pytest.approx(MODEL.fy / MODEL.fx)


@pytest.mark.parametrize(
    ("fit", "focal"), [("HORIZONTAL", 400.0 * 50 / 36), ("VERTICAL", 800.0 * 50 / 24), ("AUTO", 800.0 * 50 / 36)]
)
def test_which_edge_a_sensors_size_is_of(fit: str, focal: float) -> None:
    """An image that is higher than wide."""
    model = model_of_lens(BlenderLens(50.0, 0.1, -0.05, 36.0, 24.0, fit), (400, 800))
    along = 400 if fit == "HORIZONTAL" else 800
    assert (model.fx, model.cx, model.cy) == pytest.approx((focal, 200 - 0.1 * along, 400 - 0.05 * along))


def test_sensors_stand_where_they_recorded(source: DriveSource) -> None:
    drive, sampled = source.drive, imported(source.drive)
    for frame in (0, 7, 19):
        camera = recorded_pose(drive.cameras["front_camera"], drive, float(frame))
        assert np.allclose(camera, optical(drive.cameras["front_camera"].world_from_camera.at(
            drive.cameras["front_camera"].time_s[frame])))  # fmt: skip
        assert same(one_of(sampled, "front_camera").poses[frame], camera)
        lidar = drive.lidars["pandar64"]
        assert np.allclose(recorded_pose(lidar, drive, float(frame)), lidar.world_from_lidar.at(lidar.time_s[frame]))
        assert np.array_equal(recorded_camera_pose(drive, "front_camera", float(frame)), camera)
    assert recorded_camera_pose(drive, "front_camera", 7.0) is recorded_camera_pose(drive, "front_camera", 7.0), "kept"


def test_which_poses_see_the_recorded_image() -> None:
    here = np.eye(4)
    beside, turned = np.eye(4), np.eye(4)
    beside[0, 3], turned[:3, :3] = 0.06, level_axes(0.006, 0.0)
    assert sees_the_same(here, here) and not sees_the_same(beside, here) and not sees_the_same(turned, here)


def test_a_sensors_own_times_and_its_mount(source: DriveSource) -> None:
    drive = source.drive
    clock, camera = Clock.of(drive), drive.cameras["front_camera"]
    times = clock.of_sensor(camera).times_s
    assert times == pytest.approx([camera.time_s[int(frame)] for frame in clock.frames])
    few = {frame: time for frame, time in camera.time_s.items() if frame < 5}
    delay = np.median([few[frame] - drive.time_s[frame] for frame in few])
    assert clock.of_sensor(replace(camera, time_s=few)).times_s[10] == pytest.approx(drive.time_s[10] + delay), (
        "the usual delay where it has no time"
    )
    assert (lag(None, drive, clock) == np.eye(4)).all()
    mount = lag(camera, drive, clock) @ recorded_mount(camera, drive, clock)
    assert np.abs(mount - mount[:1]).max() < 0.02, (
        "fixed to the vehicle at its own times, but for what training corrects"
    )
    assert from_frame(drive, 3.0).frames.tolist() == [3.0, 4.0]


def test_beam_tables_survive_as_text(source: DriveSource) -> None:
    model = source.drive.lidars["pandar64"].model
    text = lidar_json(model)
    assert lidar_json(lidar_model(text)) == text
    assert np.array_equal(lidar_model(text).elevation_rad, model.elevation_rad)
    assert beams_of(text) == (model.beams, model.max_range_m)
    assert rate_of(source.drive) == "10 Hz" and rate_of(None) == ""


def test_directions() -> None:
    assert angles(np.array([0.0, 2.0, 0.0])) == pytest.approx((np.pi / 2, 0.0))
    assert angles(np.array([3.0, 0.0, 3.0])) == pytest.approx((0.0, np.pi / 4))
    assert angles(level_axes(0.7, -0.3)[:, 0]) == pytest.approx((0.7, -0.3))


@pytest.mark.parametrize("kind", ["CAMERA", "LIDAR"])
def test_a_sensor_is_turned_and_keeps_its_roll(kind: str) -> None:
    base = level_axes(0.4, 0.05)
    if kind == "CAMERA":
        axes = base @ np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    else:
        axes = base @ level_axes(0.2, 0.1)
    roll = level_axes(0.0, 0.0)
    c, s = np.cos(0.3), np.sin(0.3)
    roll[1:, 1:] = [[c, -s], [s, c]]
    before = angles(base.T @ axes @ np.array(AHEAD[kind]))
    rolled = base @ level_axes(*before) @ roll @ level_axes(*before).T @ base.T @ axes
    found = turned_to(rolled, base, kind, 0.9, -0.4)
    assert angles(base.T @ found @ np.array(AHEAD[kind])) == pytest.approx((0.9, -0.4))
    again = turned_to(found, base, kind, *before)
    assert again == pytest.approx(rolled, abs=1e-9)
    steep = turned_to(axes, base, kind, 0.0, np.pi / 2)
    assert angles(base.T @ steep @ np.array(AHEAD[kind]))[1] == pytest.approx(STEEPEST_RAD)


def test_outlines(source: DriveSource) -> None:
    camera = source.drive.cameras["front_camera"]
    found = pyramid(camera).reshape(-1, 2, 3)
    assert len(found) == 10 and found[..., 2].min() == pytest.approx(-DISPLAY_M * camera.model.fx / camera.model.width)
    corner = found[0, 0]
    assert abs(corner[0] / corner[2]) == pytest.approx(camera.model.width / 2 / camera.model.fx), (
        "along the picture's edge"
    )
    circle = ring().reshape(-1, 2, 3)
    assert np.linalg.norm(circle[:-1], axis=-1) == pytest.approx(np.full((len(circle) - 1, 2), DISPLAY_M / 2))
    assert circle[-1, 1] == pytest.approx([DISPLAY_M, 0.0, 0.0])


def test_names() -> None:
    assert preset_name("  Roof bar (2.0) ") == "Roof bar (2.0)"
    for wrong in ("", "   ", ".hidden", "a/b", "a:b", "x" * (LONGEST_NAME + 1)):
        with pytest.raises(ScenarioError, match="a preset's name has 1 to 60 letters"):
            preset_name(wrong)


def test_a_rig_is_counted() -> None:
    assert rig_contents(Rig(cameras=(), lidars=())) == "0 cameras, 0 LiDARs"
