"""Plans a sequence of KITTI's tracking benchmark: sweeps and images one by one, then calibration, poses and labels.

The layout has no times and no beams. They lie beside it, in `training/unisim/0000`, as a raw drive has them.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...data.kitti.layout import beside_tracking
from ...data.log import Log
from ...errors import OutputError
from ...files import write_file
from ...geometry import FloatArray, invert_pose
from ...world.drive import Actor, CameraModel
from ..hidden import hidden_shares
from ..writer import WritePlan, register
from .files import oxts_lines, projection_matrix
from .labels import Seen, hidden_level, ignored_line, label_line, seen_in
from .recording import Recording, plan_recording, recording_parts, write_all_stamps, write_beside

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
        recording = plan_recording(log, NUMBERS)
        if not recording.cameras:
            raise OutputError(
                f"{log.path}: has no images of a camera that rides on the vehicle, and KITTI's tracking labels are of one"
            )
        parts = recording_parts(recording, path, _sweep_file, _image_file)
        return WritePlan(
            tuple(recording.losses), parts, lambda: _finish(recording, path), f"{SPLIT}/calib/{SEQUENCE}.txt"
        )


def _sweep_file(turn: int) -> str:
    return f"{SPLIT}/velodyne/{SEQUENCE}/{turn:06d}.bin"


def _image_file(number: str, turn: int) -> str:
    return f"{SPLIT}/image_{number}/{SEQUENCE}/{turn:06d}.png"


def _finish(recording: Recording, root: Path) -> None:
    split = root / SPLIT
    poses = {
        "Tr_velo_cam": invert_pose(recording.first_mount) @ recording.mount,
        "Tr_imu_velo": invert_pose(recording.mount),
    }
    write_file(split / f"calib/{SEQUENCE}.txt", _calibration(recording, poses).encode())
    records = oxts_lines(recording.drive.world_from_ego, recording.ahead_s)
    write_file(split / f"oxts/{SEQUENCE}.txt", "".join(records).encode())
    write_file(split / f"label_02/{SEQUENCE}.txt", "".join(_labels(recording, root, poses["Tr_velo_cam"])).encode())
    # what the benchmark's evaluation finds sequences by
    write_file(split / SEQUENCES, f"{SEQUENCE} empty {0:06d} {len(recording.cuts):06d}\n".encode())
    beside = beside_tracking(split, SEQUENCE)
    write_all_stamps(recording, beside)
    write_beside(recording, beside)


def _calibration(recording: Recording, poses: dict[str, FloatArray]) -> str:
    models, shifts = recording.camera_models(CALIBRATED), recording.camera_shifts_m(CALIBRATED)
    lines = [f"P{int(number)}: {_row(projection_matrix(models[number], shifts[number]))}" for number in CALIBRATED]
    lines += [f"R_rect {_row(np.eye(3))}", *(f"{name} {_row(pose[:3])}" for name, pose in poses.items())]
    return "\n".join(lines) + "\n"


def _row(values: FloatArray) -> str:
    return " ".join(f"{value:.12e}" for value in np.ravel(values))


def _labels(recording: Recording, root: Path, camera0_from_lidar: FloatArray) -> list[str]:
    """The lines of all turns: what the first camera's image shows, labelled where a return lies in its box, else a part of the
    image to be ignored."""
    lines: list[str] = []
    actors = recording.drive.labelled_actors
    for turn in range(len(recording.cuts)):
        seen = {at: one for at, actor in enumerate(actors) if (one := _seen(recording, actor, turn)) is not None}
        poses = {at: pose for at in seen if (pose := recording.lidar_from_box(actors[at], turn)) is not None}
        if not poses:
            continue
        points = np.fromfile(root / _sweep_file(turn), "<f4").reshape(-1, 4)[:, :3].astype(np.float64)
        sizes = np.array([actors[at].size_m for at in poses])
        shares, counts = hidden_shares(np.zeros_like(points), points, np.array(list(poses.values())), sizes)
        for (at, pose), share, count in zip(poses.items(), shares, counts, strict=True):
            actor = actors[at]
            if count:
                place = camera0_from_lidar @ pose
                lines.append(label_line(turn, at, actor.label, seen[at], hidden_level(share), place, actor.size_m))
            else:
                lines.append(ignored_line(turn, seen[at]))
    return lines


def _seen(recording: Recording, actor: Actor, turn: int) -> Seen | None:
    """What the first camera's image of a turn shows of an actor."""
    camera = recording.cameras[0]
    time = recording.image_time_s(camera, turn)
    if not actor.present(time):
        return None
    pose = recording.drive.cameras[camera.name].world_from_camera.at(time)
    model: CameraModel = camera.model
    return seen_in(model, invert_pose(pose) @ actor.world_from_actor.at(time), actor.size_m)


register(KittiTrackingWriter())
