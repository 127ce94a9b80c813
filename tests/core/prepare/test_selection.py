"""Which of a log's LiDARs are simulated, and which are trained on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from tiny_drive import TinyLog

from unisim_blender.core.prepare.selection import beam_lidars, training_lidars
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
