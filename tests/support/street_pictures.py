"""Images of the procedural street through any camera, for tests that write it in other layouts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from unisim_blender.core.colour import bytes_from_srgb
from unisim_blender.core.geometry import FloatArray, Trajectory
from unisim_blender.core.world.drive import Camera, CameraModel
from unisim_street.street import Street
from unisim_street.truth import truth_camera

LOOKS = Rotation.from_matrix([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
"""A camera's axes (x right, y down, z forward) in those of what it looks ahead from (x forward, y left, z up)."""


def street_picture(street: Street, camera: Camera, frame: int) -> NDArray[np.uint8]:
    """The image (H, W, 3) of a camera of the drive's world."""
    drive = replace(street.drive, cameras={camera.sensor_id: camera})
    return bytes_from_srgb(truth_camera(street, drive, camera.sensor_id, frame).rgb)


def camera_on(
    name: str,
    model: CameraModel,
    times_s: FloatArray,
    turned: Rotation,
    place: FloatArray,
    time_s: Mapping[int, float],
) -> Camera:
    """A camera whose own axes (x right, y down, z forward) were turned and placed (N) like that at times (N,)."""
    poses = np.tile(np.eye(4), (len(times_s), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = turned.as_matrix(), place
    return Camera(name, model, Trajectory.from_poses(times_s, poses), dict(time_s))
