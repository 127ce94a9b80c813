"""KITTI's labels, 17 columns a box in the tracking benchmark and 15 in the object benchmark: what the image shows of a box, how
much is cut off and hidden, and where it is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....data.log import Log
from ....errors import OutputError
from ....geometry import FloatArray, invert_pose, transform_points
from ....sensors.silhouettes import box_bounds
from ....world.drive import Actor, CameraModel
from ...common.box_tracks import hidden_shares
from .recording import KittiRecording, plan_recording

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
    seen = {at: one for at, actor in enumerate(actors) if (one := _seen(recording, actor, turn)) is not None}
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
    found = box_bounds(model, camera_from_box, size_m)
    if found is None:
        return None
    left, right = np.clip((found.left - 0.5, found.right - 0.5), 0.0, model.width - 1.0).tolist()
    top, bottom = np.clip((found.top - 0.5, found.bottom - 0.5), 0.0, model.height - 1.0).tolist()
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


def label_line(
    frame: int, track: int, label: str, seen: ImageBox, occluded: int, camera0_from_box: FloatArray, size_m: FloatArray
) -> str:
    """Return a box's line in tracking labels."""
    return f"{frame} {track} {label} {seen.truncated} {occluded} {_numbers(seen, camera0_from_box, size_m)}\n"


def object_line(label: str, seen: ImageBox, occluded: int, camera0_from_box: FloatArray, size_m: FloatArray) -> str:
    """Return a box's line in object labels."""
    return f"{label} {seen.cut_off:.2f} {occluded} {_numbers(seen, camera0_from_box, size_m)}\n"


def _numbers(seen: ImageBox, camera0_from_box: FloatArray, size_m: FloatArray) -> str:
    """A line's numbers from alpha on: the heading alone is kept of how a box is turned; its place is the centre of its bottom, y
    down."""
    length, width, height = np.asarray(size_m).tolist()
    x, y, z = (camera0_from_box[:3, 3] + [0, height / 2, 0]).tolist()
    turned = float(np.arctan2(-camera0_from_box[2, 0], camera0_from_box[0, 0]))
    alpha = float(np.angle(np.exp(1j * (turned - np.arctan2(x, z)))))
    numbers = (alpha, *seen.bounds, height, width, length, x, y, z, turned)
    return " ".join(f"{value:.6f}" for value in numbers)


def ignored_line(frame: int, seen: ImageBox) -> str:
    """Return the line of a part of the image that holds something that no beam met."""
    bounds = " ".join(f"{value:.6f}" for value in seen.bounds)
    return f"{frame} -1 DontCare -1 -1 -10 {bounds} -1000 -1000 -1000 -10 -1 -1 -1\n"


def ignored_object_line(seen: ImageBox) -> str:
    """Return `ignored_line` in object labels."""
    bounds = " ".join(f"{value:.6f}" for value in seen.bounds)
    return f"DontCare -1 -1 -10 {bounds} -1 -1 -1 -1000 -1000 -1000 -10\n"


def _level(share: float, limits: tuple[float, float]) -> int:
    return int(share > limits[0]) + int(share > limits[1])
