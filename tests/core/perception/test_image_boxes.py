"""Boxes in images put on the ground, and what the example stack makes of sensors' data."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[3]))

from benchmarks.detection.camera import CameraDetector
from benchmarks.detection.lidar import LidarDetector
from benchmarks.detection.training import Trained
from examples.perception.driver import Perception, perception
from examples.perception.from_image import LENGTH_M, from_image, not_hidden
from examples.perception.sensing import Detectors, Sensing, in_world
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.simulation.drivers.driver import (
    POINT_FIELDS,
    CameraImage,
    DriverSetup,
    EgoMotion,
    LidarSweep,
    Observation,
    SensorSetup,
)
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.simulation.vehicle.parameters import Vehicle
from unisim_blender.core.world.drive import CameraModel, LidarModel

CAMERA = CameraModel(320, 180, 328.0, 328.0, 160.0, 90.0)
MOUNT = np.array([[0, 0, 1, 0.85], [-1, 0, 0, 0.1], [0, -1, 0, 1.8], [0, 0, 0, 1]], float)
"""x right, y down, z ahead of a camera that looks along the vehicle's x axis."""


def rectangle(x: float, y: float, width: float = 1.9, height: float = 1.5) -> FloatArray:
    """The rectangle in the image of a box on the ground whose middle is at x, y in the rear axle's frame."""
    corners = np.array(
        [(x + a * LENGTH_M / 2, y + b * width / 2, c * height) for a in (-1, 1) for b in (-1, 1) for c in (0, 1)]
    )
    seen = (np.linalg.inv(MOUNT) @ np.column_stack([corners, np.ones(8)]).T)[:3]
    u, v = 328 * seen[0] / seen[2] + 160, 328 * seen[1] / seen[2] + 90
    return np.array([u.min(), v.min(), u.max(), v.max()])


@pytest.mark.parametrize(("x", "y"), [(30.0, 0.0), (20.0, 3.4), (25.0, -4.6), (50.0, -1.0)])
def test_a_box_on_the_ground_is_found_again(x: float, y: float) -> None:
    (found,) = from_image(rectangle(x, y)[None], np.array([0.8]), CAMERA, MOUNT)
    assert found.box[:2] == pytest.approx((x, y), abs=1e-6) and found.box[3] == pytest.approx(1.9)
    assert found.score == 0.8


def test_farther_boxes_are_less_certain_and_along_the_ray() -> None:
    near, far = (from_image(rectangle(x, 0.1)[None], np.ones(1), CAMERA, MOUNT)[0] for x in (15.0, 45.0))
    assert far.covariance[0, 0] > 4 * near.covariance[0, 0] and far.covariance[0, 0] > 4 * far.covariance[1, 1]
    (aside,) = from_image(rectangle(20.0, 15.0)[None], np.ones(1), CAMERA, MOUNT)
    assert aside.covariance[0, 1] > 0


def test_boxes_at_the_horizon_are_left_out_and_cut_ones_have_the_usual_width() -> None:
    assert from_image(np.array([[100.0, 60, 140, 90]]), np.ones(1), CAMERA, MOUNT) == []
    box = rectangle(14.0, -5.5)
    assert box[2] > 320
    box[2] = 320
    (found,) = from_image(box[None], np.ones(1), CAMERA, MOUNT)
    assert found.box[1] == pytest.approx(-5.5, abs=0.05)


@pytest.mark.parametrize("near", [6.0, 4.5])
def test_the_width_tells_the_distance_where_the_lower_edge_is_cut_off(near: float) -> None:
    """A vehicle right ahead, near end to bumper 3 m and 1.5 m."""
    box = rectangle(near + MOUNT[0, 3] + LENGTH_M / 2, 0.2)
    assert box[3] > 180
    box[3] = 180
    (found,) = from_image(box[None], np.ones(1), CAMERA, MOUNT)
    assert found.box[0] == pytest.approx(near + MOUNT[0, 3] + LENGTH_M / 2, abs=1e-6)


def test_boxes_behind_a_nearer_one_of_a_higher_score_are_left_out() -> None:
    near, behind, beside = [100.0, 60, 160, 120], [110.0, 65, 150, 100], [150.0, 65, 190, 100]
    boxes = np.array([near, behind, beside])
    assert not_hidden(boxes, np.array([0.9, 0.7, 0.7])).tolist() == [True, False, True]
    assert not_hidden(boxes, np.array([0.6, 0.7, 0.7])).all()


def test_detections_are_turned_into_the_world() -> None:
    (found,) = from_image(rectangle(30.0, 2.0)[None], np.ones(1), CAMERA, MOUNT)
    moved = in_world(found, EgoState(100.0, 50.0, np.pi / 2, 8.0))
    assert moved.box[:2] == pytest.approx((98.0, 80.0)) and moved.box[4] == pytest.approx(np.pi / 2)
    assert moved.covariance[1, 1] == pytest.approx(found.covariance[0, 0])


def a_setup(**more: SensorSetup) -> DriverSetup:
    sensors = {"front": SensorSetup(CAMERA, MOUNT), **more}
    route = np.stack([np.arange(100.0), np.zeros(100)], -1)
    return DriverSetup(Vehicle(rear_axle_m=(0.5, 0.0, 0.0)), sensors, route, 100_000, 0, 0)


def untrained() -> Detectors:
    import torch

    torch.manual_seed(0)
    return Detectors(
        *(Trained(one, one.network().eval(), {}) for one in (LidarDetector((-8.0, 8.0)), CameraDetector()))
    )


def test_sensors_data_goes_through_the_detectors() -> None:
    """Untrained, they find nothing; the planner then drives on."""
    mount = np.eye(4)
    mount[2, 3] = 1.8
    model = LidarModel(np.zeros(1), np.zeros(1), 10)
    driver = Perception(a_setup(roof=SensorSetup(model, mount)), untrained())
    points = np.zeros(50, POINT_FIELDS)
    points["x"] = np.linspace(5, 60, 50)
    ego = EgoState(3.0, 0.0, 0.0, 7.0)
    image = CameraImage("front", 90_000, 60_000, 90_000, np.full((90, 160, 3), 80, np.uint8))
    sweep = LidarSweep("roof", 100_000, 0, 100_000, points)
    plan = driver.drive(Observation(100_000, (image,), (sweep,), (EgoMotion(0, ego), EgoMotion(100_000, ego))))
    assert plan.times_us[0] == 100_000 and plan.speed_m_s == pytest.approx(7.0)
    assert driver.tracks == [] and driver.planned is not None and driver.planned.is_free


def test_other_cameras_are_not_looked_at_and_other_lenses_refused() -> None:
    back = MOUNT.copy()
    back[:3, :3] = np.array([[0, 0, -1], [1, 0, 0], [0, -1, 0]])
    assert list(Sensing(a_setup(back=SensorSetup(CAMERA, back)), untrained()).cameras) == ["front"]


def test_weights_that_are_not_named_or_not_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("PERCEPTION_WEIGHTS", raising=False)
    with pytest.raises(UnisimError, match="PERCEPTION_WEIGHTS: must name the folder"):
        perception(a_setup())
    monkeypatch.setenv("PERCEPTION_WEIGHTS", str(tmp_path))
    with pytest.raises(UnisimError, match="detector.json"):
        perception(a_setup())
