"""Surfels of a real log; skipped where the log is absent (UNISIM_PANDASET names its folder)."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drive_frames import DriveFrames

from unisim_blender.core import native
from unisim_blender.core.formats.pandaset.read import PandasetLog
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.surfels.build import build_surfels, finished
from unisim_blender.core.render.tracers.surfels.model import LIDARSIM
from unisim_blender.core.render.tracers.surfels.tracer import SurfelBackend

ROOT = Path(os.environ.get("UNISIM_PANDASET", Path(__file__).parents[5] / "shared/data/pandaset/002"))
pytestmark = [
    pytest.mark.skipif(not ROOT.is_dir(), reason=f"no real log at {ROOT}; set UNISIM_PANDASET to a PandaSet sequence"),
    pytest.mark.skipif(native.library() is None, reason="surfels are made by the compiled kernels"),
]
HELD_OUT = 41


def test_a_held_out_sweep_is_that_which_was_recorded() -> None:
    log = PandasetLog(ROOT)
    log.drive = replace(log.drive, cameras={"front_camera": log.drive.cameras["front_camera"]})
    scene = finished(build_surfels(log, LIDARSIM, (HELD_OUT - 3, HELD_OUT - 1, HELD_OUT + 1, HELD_OUT + 3)))
    renderer = DriveFrames(Renderer(SurfelBackend(scene, log.drive)), log.drive)
    grid = log.sweep_grid("pandar64", HELD_OUT)
    at = grid.returned
    depth, intensity, probability, _ = renderer.rays_lidar(grid.origins[at], grid.directions[at], grid.time_s[at])
    back = probability >= 0.5
    assert back.mean() > 0.8
    assert np.median(np.abs(depth - grid.depth_m[at])[back]) < 0.06
    assert np.corrcoef(intensity[back], grid.intensity[at][back])[0, 1] > 0.5
    image = renderer.camera("front_camera", HELD_OUT, width=320)
    assert image.rgb.std() > 0.1
