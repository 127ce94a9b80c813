"""Plans samples of KITTI's object benchmark: a sweep and an image each, then calibration, labels and lists of samples.

The layout has no times, no poses and no tracks. Its readers take calibration by the number of its line.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ....data.log import Log
from ....files import write_file
from ....geometry import FloatArray, invert_pose
from ...common.writer import WritePlan
from .files import projection_matrix
from .labels import ignored_object_line, labelled_boxes, object_line, plan_labelled
from .recording import KittiRecording, recording_parts

NUMBERS = ("02", "03")
"""The benchmark has the two colour cameras alone."""
CALIBRATED = ("00", "01", "02", "03")
VALIDATION = 4
"""One of so many samples, the drive's last, is for validation: samples side by side in time are all but the same."""


class KittiObjectWriter:
    """Plans samples in the layout of KITTI's object benchmark."""

    name = "kitti-object"
    about = "KITTI object: training samples with label_2 of what the camera sees, for detectors; it is not read back"
    version = 1

    def plan(self, log: Log, path: Path) -> WritePlan:
        """Plan the samples. Raises `OutputError` without a LiDAR that turns and a camera that ride on the vehicle."""
        recording = plan_labelled(log, NUMBERS)
        turns = sorted(recording.cameras[0].frames)
        parts = recording_parts(recording, path, _sweep_file, _image_file, turns)
        alone = len(recording.cuts) - len(turns)
        said = [*recording.losses, *([f"{alone} sweeps have no image and are left out"] if alone else [])]
        said.append("times, poses and track ids are lost: the object benchmark has none")
        return WritePlan(tuple(said), parts, lambda: _finish(recording, path, turns))


def _sweep_file(turn: int) -> str:
    return f"training/velodyne/{turn:06d}.bin"


def _image_file(number: str, turn: int) -> str:
    return f"training/image_{int(number)}/{turn:06d}.png"


def _finish(recording: KittiRecording, root: Path, turns: list[int]) -> None:
    calibration = _calibration(recording).encode()
    for turn in turns:
        lines = []
        for box in labelled_boxes(recording, root / _sweep_file(turn), turn):
            if box.occluded is None:
                lines.append(ignored_object_line(box.seen))
            else:
                lines.append(
                    object_line(box.actor.label, box.seen, box.occluded, box.camera0_from_box, box.actor.size_m)
                )
        write_file(root / f"training/label_2/{turn:06d}.txt", "".join(lines).encode())
        write_file(root / f"training/calib/{turn:06d}.txt", calibration)
    # of one sample both
    first = len(turns) - max(len(turns) // VALIDATION, 1) or 1
    lists = {"train": turns[:first], "val": turns[first:] or turns, "trainval": turns, "test": []}
    for name, samples in lists.items():
        write_file(root / f"ImageSets/{name}.txt", "".join(f"{turn:06d}\n" for turn in samples).encode())


def _calibration(recording: KittiRecording) -> str:
    models, shifts = recording.camera_models(CALIBRATED), recording.camera_shifts_m(CALIBRATED)
    rows: dict[str, FloatArray] = {
        f"P{int(number)}": projection_matrix(models[number], shifts[number]) for number in CALIBRATED
    }
    rows["R0_rect"] = np.eye(3)
    rows["Tr_velo_to_cam"] = (invert_pose(recording.first_mount) @ recording.mount)[:3]
    rows["Tr_imu_to_velo"] = invert_pose(recording.mount)[:3]
    return "".join(f"{name}: {' '.join(f'{value:.12e}' for value in np.ravel(row))}\n" for name, row in rows.items())
