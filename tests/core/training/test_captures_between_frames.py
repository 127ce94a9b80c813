"""Images and sweeps between frames: training and surfels use those that belong to the frames that they use, and no others."""

from __future__ import annotations

import numpy as np
import pytest
from tiny_drive import TinyLog, log_with_captures_between

from unisim_blender.core.render.tracers.surfels import build
from unisim_blender.core.training.batches.data import CameraData, LidarData, lidar_captures


@pytest.fixture
def log() -> TinyLog:
    return log_with_captures_between()


def test_images(log: TinyLog) -> None:
    for frames, taken in (([1, 3], [1, 3, 6]), ([0, 2, 4], [0, 2, 7, 4])):
        data = CameraData(log, ["front"], frames, None, np.zeros(3))
        assert [frame for _, _, frame in data.views] == taken
        assert build._chosen_images(log, "front", set(frames)) == taken


def test_sweeps(log: TinyLog) -> None:
    for frames, taken in (((1, 3), [1, 6, 3]), ((0, 2, 4), [0, 2, 4])):
        assert [frame for _, frame in lidar_captures(log, ("top",), frames)] == taken
        assert build._captures(log, "top", set(frames)) == taken
        times = LidarData(log, ("top",), frames, np.zeros(3)).time_s
        assert ((times > 0.2) & (times < 0.26)).any() == (6 in taken)
