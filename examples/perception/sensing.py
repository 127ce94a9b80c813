"""From what sensors deliver to detections in the world, by the trained detectors of `benchmarks.detection`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.detection.samples import IMAGE_WIDTH, near_points, resized, unlabelled
from benchmarks.detection.testing import detect_in
from benchmarks.detection.training import Trained, load_detector
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.geometry import FloatArray, transform_points
from unisim_blender.core.simulation.drivers.driver import CameraImage, DriverSetup, LidarSweep, SensorSetup
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.world.drive import CameraModel, LidarModel

from .from_image import from_image, not_hidden
from .objects import Detection

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
