"""Plans a raw drive of KITTI: turns of the LiDAR and images one by one, then calibration, poses and tracklets."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....data.log import Log
from ....files import write_file
from ....geometry import invert_pose
from ...common.writer import WritePlan
from ..layout import VELODYNE
from .files import DAY, Tracklet, oxts_lines, tracklets_xml, write_calibration
from .recording import KittiRecording, plan_recording, recording_parts, write_all_stamps, write_beside

DRIVE = f"{DAY}/{DAY}_drive_0001_sync"
NUMBERS = ("02", "03", "00", "01")
"""Of cameras, in the order in which they are given: the dataset's colour cameras first."""


class KittiLogWriter:
    """Plans raw drives in KITTI's layout."""

    name = "kitti"
    about = "KITTI raw with tracklets, one LiDAR, cameras that look ahead"
    version = 2

    def plan(self, log: Log, path: Path) -> WritePlan:
        """Plan the drive. Raises `OutputError` without a LiDAR that turns, or for one that does not ride on the vehicle."""
        recording = plan_recording(log, NUMBERS)
        parts = recording_parts(
            recording,
            path,
            lambda turn: f"{DRIVE}/{VELODYNE}/data/{turn:010d}.bin",
            lambda number, turn: f"{DRIVE}/image_{number}/data/{turn:010d}.png",
        )
        return WritePlan(tuple(recording.losses), parts, lambda: _finish(recording, path), DRIVE)


def _finish(recording: KittiRecording, root: Path) -> None:
    path = root / DRIVE
    write_all_stamps(recording, path)
    for number, line in enumerate(oxts_lines(recording.drive.world_from_ego, recording.ahead_s)):
        write_file(path / f"oxts/data/{number:010d}.txt", line.encode())
    write_calibration(
        root / DAY,
        invert_pose(recording.mount),
        invert_pose(recording.first_mount) @ recording.mount,
        recording.camera_models(NUMBERS),
        recording.camera_shifts_m(NUMBERS),
    )
    write_file(path / "tracklet_labels.xml", tracklets_xml(_tracklets(recording)).encode())
    write_beside(recording, path)


def _tracklets(recording: KittiRecording) -> list[Tracklet]:
    """The drive's boxes, each where it was as the beams of a turn passed it."""
    tracklets = []
    for actor in recording.drive.labelled_actors:
        current: Tracklet | None = None
        for turn in range(len(recording.cuts)):
            pose = recording.lidar_from_box(actor, turn)
            if pose is None:
                current = None
                continue
            if current is None:
                current = Tracklet(actor.label, actor.size_m, turn, [])
                tracklets.append(current)
            bottom = pose[:3, 3] - [0, 0, float(actor.size_m[2]) / 2]
            current.boxes.append((bottom, float(np.arctan2(pose[1, 0], pose[0, 0]))))
    return tracklets
