"""Which of a log's sensors are trained on where none is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tiny_drive import TinyLog, tiny_drive

from unisim_blender.core.geometry import make_pose
from unisim_blender.core.prepare.selection import beam_lidars, camera_ahead, training_lidars
from unisim_blender.core.world.drive import LidarModel


def test_lidars_without_a_beam_table_are_trained_on_where_there_is_no_other() -> None:
    """As of a sequence that NVIDIA's own converter of KITTI writes: returns with directions and times, no table."""
    log = TinyLog()
    top = log.drive.lidars["top"]
    plain = replace(top, sensor_id="plain", model=LidarModel(np.zeros(0), np.zeros(0), columns=1))
    log.drive = replace(log.drive, lidars={"plain": plain, "top": top})
    assert beam_lidars(log) == training_lidars(log) == ("top",)
    log.drive = replace(log.drive, lidars={"plain": plain})
    assert beam_lidars(log) == () and training_lidars(log) == ("plain",)
    log.sweep_frames = lambda lidar: ()  # type: ignore[method-assign]
    assert training_lidars(log) == ()


def looking(log: TinyLog, **turned_deg: float) -> TinyLog:
    """The log with cameras that look so far to the left."""
    front, cameras = tiny_drive().cameras["front"], {}
    for name, turned in turned_deg.items():
        mount = make_pose(
            np.zeros(3), np.array([np.cos(np.radians(turned) / 2), 0, -np.sin(np.radians(turned) / 2), 0])
        )
        track = front.world_from_camera.transformed(right=mount)
        cameras[name] = replace(front, sensor_id=name, world_from_camera=track)
    log.drive = replace(log.drive, cameras=cameras)
    return log


def test_without_a_name_the_camera_that_looks_ahead_is_trained_on() -> None:
    """As each dataset calls it; of stereo cameras those in colour come first."""
    log = TinyLog()
    assert camera_ahead(looking(log, CAM_LEFT=60.0, CAM_FRONT=-1.0, CAM_BACK=180.0)) == "CAM_FRONT"
    assert camera_ahead(looking(log, front_camera=30.0, other=0.0)) == "front_camera"
    grey = log.image
    looking(log, image_00=0.0, image_02=0.4, image_03=0.4)
    assert camera_ahead(log) == "image_00"
    colour = {"image_02": np.array([1, 1, 0], np.uint8)}
    log.image = lambda name, frame: grey(name, frame) * colour.get(name, np.uint8(1))  # type: ignore[method-assign, assignment]
    assert camera_ahead(log) == "image_02"
    log.image_frames = lambda camera: ()  # type: ignore[method-assign]
    assert camera_ahead(log) is None
