"""From what sensors deliver to detections in the world, by the trained detectors of `benchmarks.detection`."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.detection.samples import IMAGE_WIDTH, VEHICLES, near_points, resized, unlabelled
from benchmarks.detection.testing import CLASS, detect_in
from benchmarks.detection.training import Trained, load_detector
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.geometry import FloatArray, transform_points
from unisim_blender.core.simulation.drivers.driver import CameraImage, DriverSetup, LidarSweep, SensorSetup
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.world.drive import CameraModel, LidarModel

from .from_image import from_image, not_hidden
from .objects import Detection

WEIGHTS = "PERCEPTION_WEIGHTS"
"""The environment's variable that names the folder of the trained detectors."""
LIDAR_M = 0.3
"""Standard deviation of the place of a vehicle found in a sweep."""
LEAST_SCORE, LEAST_IMAGE_SCORE = 0.2, 0.4
"""Detections of a lower score are left out."""
FORWARD = 0.9
"""Cosine of the angle to the vehicle's x axis of the cameras that are looked at: the detector knows no other view."""


@dataclass(frozen=True, eq=False)
class Detectors:
    """The trained detectors of sweeps and of images; None is not used."""

    lidar: Trained | None
    camera: Trained | None

    @staticmethod
    def load(folder: Path) -> Detectors:
        """Return those below a folder that `examples.perception.train` wrote. Raises `UnisimError`."""
        return Detectors(load_detector(folder / "lidar"), load_detector(folder / "camera"))

    @staticmethod
    def from_environment() -> Detectors:
        """Return those of the folder that ``PERCEPTION_WEIGHTS`` names. Raises `UnisimError`."""
        folder = os.environ.get(WEIGHTS)
        if not folder:
            raise UnisimError(f"{WEIGHTS}: must name the folder of the detectors that examples.perception.train wrote")
        return Detectors.load(Path(folder))


class BothDetectors:
    """The trained detectors as `unisim eval --shifts` takes them."""

    classes = {CLASS: VEHICLES}

    def __init__(self, detectors: Detectors) -> None:
        self.detectors = detectors

    def in_image(self, rgb: NDArray[np.uint8]) -> tuple[FloatArray, FloatArray, list[str]]:
        """Return boxes (N, 4), scores (N,) and classes of vehicles in an image (H, W, 3), sRGB."""
        assert self.detectors.camera is not None
        height, width = rgb.shape[:2]
        small = resized(rgb, IMAGE_WIDTH, round(height * IMAGE_WIDTH / width))
        boxes, scores = detect_in(self.detectors.camera, unlabelled(image=small))
        return boxes * (width / IMAGE_WIDTH), scores, [CLASS] * len(scores)

    def in_sweep(self, points: FloatArray) -> tuple[FloatArray, FloatArray, list[str]]:
        """Return boxes (N, 5), scores (N,) and classes of vehicles in returns (N, 4), ego frame."""
        assert self.detectors.lidar is not None
        near = near_points(points[:, :3], points[:, 3].astype(np.float32))
        boxes, scores = detect_in(self.detectors.lidar, unlabelled(points=near))
        return boxes, scores, [CLASS] * len(scores)


def detectors() -> BothDetectors:
    """Return the detectors of the folder that ``PERCEPTION_WEIGHTS`` names. Raises `UnisimError`."""
    return BothDetectors(Detectors.from_environment())


class Sensing:
    """Detects vehicles in the images and sweeps of one vehicle's sensors."""

    def __init__(self, setup: DriverSetup, detectors: Detectors) -> None:
        self.setup, self.detectors = setup, detectors
        self.cameras = {
            name: sensor
            for name, sensor in setup.sensors.items()
            if isinstance(sensor.model, CameraModel) and sensor.rear_axle_from_sensor[0, 2] >= FORWARD
        }
        for name, sensor in self.cameras.items():
            assert isinstance(sensor.model, CameraModel)
            if detectors.camera is not None and not sensor.model.is_pinhole:
                raise UnisimError(f"{name}: the camera detector takes pinholes")

    def of_sweep(self, sweep: LidarSweep, ego: EgoState) -> list[Detection]:
        """Return the vehicles in a sweep, world frame, of a vehicle that is at ``ego`` at the sweep's time."""
        trained = self.detectors.lidar
        sensor = self.setup.sensors[sweep.sensor_id]
        if trained is None or not isinstance(sensor.model, LidarModel):
            return []
        ego_from_sensor = self.setup.vehicle.ego_from_axle @ sensor.rear_axle_from_sensor
        local = np.stack([sweep.points[axis] for axis in "xyz"], -1).astype(np.float64)
        points = near_points(transform_points(ego_from_sensor, local), sweep.points["intensity"])
        boxes, scores = detect_in(trained, unlabelled(points=points))
        boxes[:, :2] -= np.array(self.setup.vehicle.rear_axle_m[:2])
        covariance = np.eye(2) * LIDAR_M**2
        found = [Detection(box, covariance, score) for box, score in zip(boxes, scores.tolist(), strict=True)]
        return [in_world(one, ego) for one in found if one.score >= LEAST_SCORE]

    def of_image(self, image: CameraImage, ego: EgoState) -> list[Detection]:
        """Return the vehicles in an image, world frame, of a vehicle that is at ``ego`` at the image's time."""
        trained, sensor = self.detectors.camera, self.cameras.get(image.sensor_id)
        if trained is None or sensor is None:
            return []
        model = _small(sensor)
        boxes, scores = detect_in(trained, unlabelled(image=resized(image.rgb, model.width, model.height)))
        kept = (scores >= LEAST_IMAGE_SCORE) & not_hidden(boxes, scores)
        found = from_image(boxes[kept], scores[kept], model, sensor.rear_axle_from_sensor)
        return [in_world(one, ego) for one in found]


def in_world(detection: Detection, ego: EgoState) -> Detection:
    """Return a detection in the rear axle's frame as one in the world's."""
    c, s = np.cos(ego.heading_rad), np.sin(ego.heading_rad)
    turn = np.array([[c, -s], [s, c]])
    box: FloatArray = detection.box.copy()
    box[:2] = turn @ box[:2] + [ego.x_m, ego.y_m]
    box[4] += ego.heading_rad
    seen_from = None if detection.seen_from is None else turn @ detection.seen_from + [ego.x_m, ego.y_m]
    return replace(detection, box=box, covariance=turn @ detection.covariance @ turn.T, seen_from=seen_from)


def _small(sensor: SensorSetup) -> CameraModel:
    assert isinstance(sensor.model, CameraModel)
    return sensor.model.resized(IMAGE_WIDTH)
