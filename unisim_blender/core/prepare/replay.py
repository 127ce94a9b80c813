"""A log's drive as a scene trained on it replays it: refined tracklets and sensor poses, all of the log's
frames and sensors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import SceneError
from ..geometry import FloatArray
from ..model.files.scene_file import SceneHeader
from ..world.drive import Drive

ORIGIN_TOLERANCE_M = 1e-6
SAME_DRIVE_M = 1.0
"""Refinement moves poses by centimetres; another drive is metres away."""


def replayed_drive(header: SceneHeader, log: Drive, log_path: Path) -> Drive:
    """The scene's drive, and from the log the frames and sensors that the scene was not trained on.

    Raises `SceneError` where the scene was trained on another drive, or has its origin elsewhere.
    """
    shared = [frame for frame in header.drive.frames if frame in log.time_s]
    apart = np.linalg.norm(_ego_in_log_world(header.drive, shared) - _ego_in_log_world(log, shared), axis=1)
    if not shared or apart.max() > SAME_DRIVE_M:
        by = f", whose vehicle is {apart.max():.1f} m away at frame {shared[int(apart.argmax())]}" if shared else ""
        raise SceneError(f"{header.path}: was trained on another drive than {log_path}{by}")
    if np.abs(header.drive.world_origin - log.world_origin).max() > ORIGIN_TOLERANCE_M:
        own, logs = header.drive.world_origin.tolist(), log.world_origin.tolist()
        raise SceneError(f"{header.path}: has its origin at {own}, {log_path} at {logs}")
    return replace(
        header.drive,
        frames=log.frames,
        time_s=log.time_s,
        cameras={**log.cameras, **header.drive.cameras},
        lidars={**log.lidars, **header.drive.lidars},
    )


def _ego_in_log_world(drive: Drive, frames: list[int]) -> FloatArray:
    """Positions (F, 3) of the vehicle at frames, in the log's own coordinates."""
    times = np.array([drive.time_s[frame] for frame in frames])
    return np.asarray(drive.world_from_ego.at(times)[:, :3, 3] + drive.world_origin)
