"""Sensors that deliver what a log has recorded."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from unisim_blender.core.data.log import Log
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.geometry import invert_pose, transform_points
from unisim_blender.core.simulation.clock import Exposure
from unisim_blender.core.simulation.drivers.driver import POINT_FIELDS, CameraImage, LidarSweep
from unisim_blender.core.simulation.rollout.sensors import delivered_image
from unisim_blender.core.world.drive import Drive


class RecordedSensors:
    """Delivers the recorded images and sweeps of a log."""

    def __init__(self, log: Log) -> None:
        self.log = log
        self.unsupported: dict[str, float] = {}
        self.confidence: dict[str, float] = {}

    def render(self, drive: Drive, exposures: Sequence[Exposure]) -> tuple[list[CameraImage], list[LidarSweep]]:
        """See `Sensors.render`."""
        images, sweeps = [], []
        for one in exposures:
            name, frame = one.capture.sensor_id, one.capture.frame
            if frame is None:
                raise UnisimError(f"{self.log.path}: nothing was recorded by {name} at {one.capture.time_us} us")
            if name in drive.cameras:
                images.append(delivered_image(one, self.log.image(name, frame)))
                continue
            recorded = self.log.sweep(name, frame)
            points = np.zeros(len(recorded.points), POINT_FIELDS)
            pose = drive.lidars[name].world_from_lidar.at(drive.lidars[name].time_s[frame])
            points["x"], points["y"], points["z"] = transform_points(invert_pose(pose), recorded.points).T
            points["intensity"], points["time"] = recorded.intensity, recorded.time_s
            sweeps.append(LidarSweep(name, one.capture.time_us, one.start_us, one.end_us, points))
        return images, sweeps

    read = render
