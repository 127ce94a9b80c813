"""Whether two frames are the same to the bit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.sensors.frames import CameraFrame, LidarFrame

OF_IMAGE = ("rgb", "depth_m", "z_depth_m", "normal", "opacity", "unsupported", "world_from_camera")
OF_SWEEP = (
    "origins",
    "directions",
    "time_s",
    "depth_m",
    "intensity",
    "return_probability",
    "returned",
    "world_from_lidar",
)


def named(frame: CameraFrame | LidarFrame) -> NDArray[Any]:
    """The ids of what each pixel or beam shows, "" for no actor: numbers depend on who else is there."""
    assert frame.instance is not None
    return np.array(["", *frame.instances])[frame.instance]


def assert_same(a: CameraFrame | LidarFrame, b: CameraFrame | LidarFrame) -> None:
    """Compare all that was rendered."""
    for name in OF_IMAGE if isinstance(a, CameraFrame) else OF_SWEEP:
        mine, other = getattr(a, name), getattr(b, name)
        assert mine is not None and mine.dtype == other.dtype and mine.tobytes() == other.tobytes(), name
    np.testing.assert_array_equal(named(a), named(b))
