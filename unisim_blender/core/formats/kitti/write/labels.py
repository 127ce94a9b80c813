"""Writers of KITTI's object and tracking benchmarks: samples or a sequence with calibration and labels.

A label has 15 columns in the object benchmark and 17 in the tracking benchmark: what the image shows of a box, how much is cut
off and hidden, and where it is.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....data.log import Log
from ....errors import OutputError
from ....files import write_file
from ....geometry import FloatArray, invert_pose, transform_points
from ....sensors.silhouettes import box_bounds
from ....world.box_tracks import hidden_shares
from ....world.drive import Actor, CameraModel
from ...common.writer import WritePlan
from .. import beside_tracking
from .files import oxts_lines, projection_matrix, text_row
from .recording import KittiRecording, plan_recording, recording_parts, write_all_stamps, write_beside

UPRIGHT_DEG = 1.0
"""A camera that is tilted by more against the vehicle is told of: labels have boxes upright in its frame."""


@dataclass(frozen=True)
class KittiLabel:
    """A box of a label file. ``track``: the actor's number; ``occluded``: the level of occlusion, None where no return lies in
    the box, and the labels have a part of the image to be ignored; ``camera0_from_box`` (4, 4)."""

    track: int
    actor: Actor
    seen: ImageBox
    occluded: int | None
    camera0_from_box: FloatArray


def plan_labelled(log: Log, numbers: Sequence[str]) -> KittiRecording:
    """Return `plan_recording` of a log whose labels are of a camera. Raises `OutputError` where none rides on the vehicle."""
    recording = plan_recording(log, numbers)
    if not recording.cameras:
        raise OutputError(
            f"{log.path}: has no images of a camera that rides on the vehicle, and KITTI's labels are of one"
        )
    tilt = np.degrees(np.arccos(np.clip(-recording.first_mount[2, 1], -1, 1)))
    if tilt > UPRIGHT_DEG:
        recording.losses.append(
            f"{recording.cameras[0].name}: is tilted by {tilt:.1f} degrees against the vehicle, and KITTI's labels have "
            "boxes upright in the camera's frame"
        )
    return recording


def labelled_boxes(recording: KittiRecording, sweep: Path, turn: int) -> Iterator[KittiLabel]:
    """Yield the boxes of which the first camera's image of a turn shows a pixel or more; ``sweep`` is the turn's file."""
    actors = recording.drive.labelled_actors
    seen = {at: box for at, actor in enumerate(actors) if (box := _seen(recording, actor, turn)) is not None}
    poses = {at: pose for at in seen if (pose := recording.lidar_from_box(actors[at], turn)) is not None}
    if not poses:
        return
    points = np.fromfile(sweep, "<f4").reshape(-1, 4)[:, :3].astype(np.float64)
    sizes = np.array([actors[at].size_m for at in poses])
    shares, counts = hidden_shares(np.zeros_like(points), points, np.array(list(poses.values())), sizes)
    camera0_from_lidar = invert_pose(recording.first_mount) @ recording.mount
    for (at, pose), share, count in zip(poses.items(), shares, counts, strict=True):
        yield KittiLabel(at, actors[at], seen[at], hidden_level(share) if count else None, camera0_from_lidar @ pose)


def _seen(recording: KittiRecording, actor: Actor, turn: int) -> ImageBox | None:
    """Return the box of an actor in the first camera's image of a turn."""
    camera = recording.cameras[0]
    time = recording.image_time_s(camera, turn)
    if not actor.present(time):
        return None
    pose = recording.drive.cameras[camera.name].world_from_camera.at(time)
    return seen_in(camera.model, invert_pose(pose) @ actor.world_from_actor.at(time), actor.size_m)


LEAST_PX = 1.0
"""Boxes of which less is in the image, across or down, are left out."""
LATTICE = 9
"""Points along a box's edges by which its share in the image is told."""
CUT_SHARES = (0.02, 0.5)
HIDDEN_SHARES = (0.1, 0.5)
"""Above the first of these shares a box is partly cut off or hidden, above the second largely."""
UNKNOWN = 3


@dataclass(frozen=True)
class ImageBox:
    """A box in an image: left, top, right, bottom in pixels, the first one's centre at 0, within the image; and the level of its
    truncation: 0 none, 1 partly, 2 largely; ``cut_off``: the share of it that lies outside of the image."""

    bounds: tuple[float, float, float, float]
    truncated: int
    cut_off: float


def seen_in(model: CameraModel, camera_from_box: FloatArray, size_m: FloatArray) -> ImageBox | None:
    """Return what an image shows of a box, whatever stands before it; None where that is less than a pixel across or down."""
    bounds = box_bounds(model, camera_from_box, size_m)
    if bounds is None:
        return None
    left, right = np.clip((bounds.left - 0.5, bounds.right - 0.5), 0.0, model.width - 1.0).tolist()
    top, bottom = np.clip((bounds.top - 0.5, bounds.bottom - 0.5), 0.0, model.height - 1.0).tolist()
    if right - left < LEAST_PX or bottom - top < LEAST_PX:
        return None
    part = np.linspace(-0.5, 0.5, LATTICE)
    lattice = np.stack(np.meshgrid(part, part, part, indexing="ij"), -1).reshape(-1, 3) * np.asarray(size_m)
    u, v, valid = model.project(transform_points(camera_from_box, lattice))
    inside = valid & (u >= 0) & (u <= model.width) & (v >= 0) & (v <= model.height)
    if not inside.any():
        return None
    cut_off = 1 - float(inside.mean())
    return ImageBox((left, top, right, bottom), _level(cut_off, CUT_SHARES), cut_off)


def hidden_level(share: float) -> int:
    """Return the level of occlusion of a box that hides from that share of the beams towards it: 0 none, 1 partly, 2 largely, 3
    for NaN, not known."""
    return UNKNOWN if np.isnan(share) else _level(share, HIDDEN_SHARES)


def _numbers(seen: ImageBox, camera0_from_box: FloatArray, size_m: FloatArray) -> str:
    """A line's numbers from alpha on: the heading alone is kept of how a box is turned; its place is the centre of its bottom, y
    down."""
    length, width, height = np.asarray(size_m).tolist()
    x, y, z = (camera0_from_box[:3, 3] + [0, height / 2, 0]).tolist()
    turned = float(np.arctan2(-camera0_from_box[2, 0], camera0_from_box[0, 0]))
    alpha = float(np.angle(np.exp(1j * (turned - np.arctan2(x, z)))))
    return _fixed(alpha, *seen.bounds, height, width, length, x, y, z, turned)


def _fixed(*values: float) -> str:
    return " ".join(f"{value:.6f}" for value in values)


def _level(share: float, limits: tuple[float, float]) -> int:
    return int(share > limits[0]) + int(share > limits[1])


NUMBERS = ("02", "03")
"""The benchmarks have the two colour cameras alone."""
CALIBRATED = ("00", "01", "02", "03")
VALIDATION = 4
"""One of this many samples, the drive's last, is for validation: samples side by side in time are all but the same."""


class KittiObjectWriter:
    """Plans samples in the layout of KITTI's object benchmark: a sweep and an image each.

    The layout has no times, no poses and no tracks. Its readers take calibration by the number of its line.
    """

    name = "kitti-object"
    about = "KITTI object: training samples with label_2 of what the camera sees, for detectors; it is not read back"
    version = 1

    def plan(self, log: Log, path: Path) -> WritePlan:
        """Plan the samples. Raises `OutputError` without a LiDAR that turns and a camera that ride on the vehicle."""
        recording = plan_labelled(log, NUMBERS)
        turns = sorted(recording.cameras[0].frames)
        parts = recording_parts(
            recording, path, _sample_file, lambda number, turn: f"training/image_{int(number)}/{turn:06d}.png", turns
        )
        alone = len(recording.cuts) - len(turns)
        said = [*recording.losses, *([f"{alone} sweeps have no image and are left out"] if alone else [])]
        said.append("times, poses and track ids are lost: the object benchmark has none")
        return WritePlan(tuple(said), parts, lambda: _finish_samples(recording, path, turns))


def _sample_file(turn: int) -> str:
    return f"training/velodyne/{turn:06d}.bin"


def _finish_samples(recording: KittiRecording, root: Path, turns: list[int]) -> None:
    poses = {
        "R0_rect": np.eye(3),
        "Tr_velo_to_cam": (invert_pose(recording.first_mount) @ recording.mount)[:3],
        "Tr_imu_to_velo": invert_pose(recording.mount)[:3],
    }
    lines = [*_projections(recording), *(f"{name}: {text_row(pose)}" for name, pose in poses.items())]
    calibration = "".join(f"{line}\n" for line in lines).encode()
    for turn in turns:
        boxes = labelled_boxes(recording, root / _sample_file(turn), turn)
        write_file(root / f"training/label_2/{turn:06d}.txt", "".join(map(object_line, boxes)).encode())
        write_file(root / f"training/calib/{turn:06d}.txt", calibration)
    # of one sample both
    first = len(turns) - max(len(turns) // VALIDATION, 1) or 1
    lists = {"train": turns[:first], "val": turns[first:] or turns, "trainval": turns, "test": []}
    for name, samples in lists.items():
        write_file(root / f"ImageSets/{name}.txt", "".join(f"{turn:06d}\n" for turn in samples).encode())


def object_line(box: KittiLabel) -> str:
    """Return a box's line in object labels; a part of the image to be ignored where no beam met what is in the box."""
    if box.occluded is None:
        return f"DontCare -1 -1 -10 {_fixed(*box.seen.bounds)} -1 -1 -1 -1000 -1000 -1000 -10\n"
    numbers = _numbers(box.seen, box.camera0_from_box, box.actor.size_m)
    return f"{box.actor.label} {box.seen.cut_off:.2f} {box.occluded} {numbers}\n"


def _projections(recording: KittiRecording) -> list[str]:
    """Return the lines of the four cameras' projections."""
    models, shifts = recording.camera_models(CALIBRATED), recording.camera_shifts_m(CALIBRATED)
    return [f"P{int(number)}: {text_row(projection_matrix(models[number], shifts[number]))}" for number in CALIBRATED]


SPLIT, SEQUENCE = "training", "0000"
SEQUENCES = "evaluate_tracking.seqmap.training"


class KittiTrackingWriter:
    """Plans sequences in the layout of KITTI's tracking benchmark."""

    name = "kitti-tracking"
    about = "KITTI tracking: a training sequence with labels of what its camera sees, one LiDAR"
    version = 2

    def plan(self, log: Log, path: Path) -> WritePlan:
        """Plan the sequence. Raises `OutputError` without a LiDAR that turns and a camera that ride on the vehicle."""
        recording = plan_labelled(log, NUMBERS)
        parts = recording_parts(
            recording, path, _sequence_file, lambda number, turn: f"{SPLIT}/image_{number}/{SEQUENCE}/{turn:06d}.png"
        )
        opens = f"{SPLIT}/calib/{SEQUENCE}.txt"
        return WritePlan(tuple(recording.losses), parts, lambda: _finish_sequence(recording, path), opens)


def _sequence_file(turn: int) -> str:
    return f"{SPLIT}/velodyne/{SEQUENCE}/{turn:06d}.bin"


def _finish_sequence(recording: KittiRecording, root: Path) -> None:
    split, turns = root / SPLIT, range(len(recording.cuts))
    poses = {
        "R_rect": np.eye(3),
        "Tr_velo_cam": (invert_pose(recording.first_mount) @ recording.mount)[:3],
        "Tr_imu_velo": invert_pose(recording.mount)[:3],
    }
    lines = [*_projections(recording), *(f"{name} {text_row(pose)}" for name, pose in poses.items())]
    write_file(split / f"calib/{SEQUENCE}.txt", "".join(f"{line}\n" for line in lines).encode())
    records = oxts_lines(recording.drive.world_from_ego, recording.ahead_s)
    write_file(split / f"oxts/{SEQUENCE}.txt", "".join(records).encode())
    labels = [
        tracking_line(turn, box)
        for turn in turns
        for box in labelled_boxes(recording, root / _sequence_file(turn), turn)
    ]
    write_file(split / f"label_02/{SEQUENCE}.txt", "".join(labels).encode())
    # what the benchmark's evaluation finds sequences by
    write_file(split / SEQUENCES, f"{SEQUENCE} empty {0:06d} {len(turns):06d}\n".encode())
    beside = beside_tracking(split, SEQUENCE)
    write_all_stamps(recording, beside)
    write_beside(recording, beside)


def tracking_line(turn: int, box: KittiLabel) -> str:
    """Return a box's line in tracking labels; a part of the image to be ignored where no beam met what is in the box."""
    if box.occluded is None:
        return f"{turn} -1 DontCare -1 -1 -10 {_fixed(*box.seen.bounds)} -1000 -1000 -1000 -10 -1 -1 -1\n"
    numbers = _numbers(box.seen, box.camera0_from_box, box.actor.size_m)
    return f"{turn} {box.track} {box.actor.label} {box.seen.truncated} {box.occluded} {numbers}\n"
