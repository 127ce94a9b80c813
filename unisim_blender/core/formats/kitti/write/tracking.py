"""Plans a sequence of KITTI's tracking benchmark: sweeps and images one by one, then calibration, poses and labels.

The layout has no times and no beams. They lie beside it, in `training/unisim/0000`, as a raw drive has them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....data.log import Log
from ....files import write_file
from ....geometry import FloatArray, invert_pose
from ...common.writer import WritePlan
from ..layout import beside_tracking
from .files import oxts_lines, projection_matrix
from .labels import ignored_line, label_line, labelled_boxes, plan_labelled
from .recording import KittiRecording, recording_parts, write_all_stamps, write_beside

SPLIT, SEQUENCE = "training", "0000"
SEQUENCES = "evaluate_tracking.seqmap.training"
NUMBERS = ("02", "03")
"""The benchmark has the two colour cameras alone."""
CALIBRATED = ("00", "01", "02", "03")


class KittiTrackingWriter:
    """Plans sequences in the layout of KITTI's tracking benchmark."""

    name = "kitti-tracking"
    about = "KITTI tracking: a training sequence with labels of what its camera sees, one LiDAR"
    version = 2

    def plan(self, log: Log, path: Path) -> WritePlan:
        """Plan the sequence. Raises `OutputError` without a LiDAR that turns and a camera that ride on the vehicle."""
        recording = plan_labelled(log, NUMBERS)
        parts = recording_parts(recording, path, _sweep_file, _image_file)
        return WritePlan(
            tuple(recording.losses), parts, lambda: _finish(recording, path), f"{SPLIT}/calib/{SEQUENCE}.txt"
        )


def _sweep_file(turn: int) -> str:
    return f"{SPLIT}/velodyne/{SEQUENCE}/{turn:06d}.bin"


def _image_file(number: str, turn: int) -> str:
    return f"{SPLIT}/image_{number}/{SEQUENCE}/{turn:06d}.png"


def _finish(recording: KittiRecording, root: Path) -> None:
    split = root / SPLIT
    poses = {
        "Tr_velo_cam": invert_pose(recording.first_mount) @ recording.mount,
        "Tr_imu_velo": invert_pose(recording.mount),
    }
    write_file(split / f"calib/{SEQUENCE}.txt", _calibration(recording, poses).encode())
    records = oxts_lines(recording.drive.world_from_ego, recording.ahead_s)
    write_file(split / f"oxts/{SEQUENCE}.txt", "".join(records).encode())
    write_file(split / f"label_02/{SEQUENCE}.txt", "".join(_labels(recording, root)).encode())
    # what the benchmark's evaluation finds sequences by
    write_file(split / SEQUENCES, f"{SEQUENCE} empty {0:06d} {len(recording.cuts):06d}\n".encode())
    beside = beside_tracking(split, SEQUENCE)
    write_all_stamps(recording, beside)
    write_beside(recording, beside)


def _calibration(recording: KittiRecording, poses: dict[str, FloatArray]) -> str:
    models, shifts = recording.camera_models(CALIBRATED), recording.camera_shifts_m(CALIBRATED)
    lines = [f"P{int(number)}: {_row(projection_matrix(models[number], shifts[number]))}" for number in CALIBRATED]
    lines += [f"R_rect {_row(np.eye(3))}", *(f"{name} {_row(pose[:3])}" for name, pose in poses.items())]
    return "\n".join(lines) + "\n"


def _row(values: FloatArray) -> str:
    return " ".join(f"{value:.12e}" for value in np.ravel(values))


def _labels(recording: KittiRecording, root: Path) -> list[str]:
    lines: list[str] = []
    for turn in range(len(recording.cuts)):
        for box in labelled_boxes(recording, root / _sweep_file(turn), turn):
            if box.occluded is None:
                lines.append(ignored_line(turn, box.seen))
            else:
                size = box.actor.size_m
                lines.append(
                    label_line(turn, box.track, box.actor.label, box.seen, box.occluded, box.camera0_from_box, size)
                )
    return lines
