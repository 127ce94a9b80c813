"""What the first camera's image of a turn shows of the drive's boxes: what the benchmarks' labels say."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ....data.log import Log
from ....errors import OutputError
from ....geometry import FloatArray, invert_pose
from ....world.drive import Actor
from ...common.hidden import hidden_shares
from .labels import ImageBox, hidden_level, seen_in
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
    """What the first camera's image of a turn shows of an actor."""
    camera = recording.cameras[0]
    time = recording.image_time_s(camera, turn)
    if not actor.present(time):
        return None
    pose = recording.drive.cameras[camera.name].world_from_camera.at(time)
    return seen_in(camera.model, invert_pose(pose) @ actor.world_from_actor.at(time), actor.size_m)
