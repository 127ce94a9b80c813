"""A drive with copies of an actor before a camera, or behind it, to see what actors cost that are seen and that are
not; and with copies of all its actors on tracks like theirs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from unisim_blender.core.errors import SceneError
from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_yaw
from unisim_blender.core.world.drive import Actor, CameraModel, Drive

FIRST_M, ALONG_M, ACROSS_M = 8.0, 6.0, 3.0
"""Where the first row stands, and how far rows and columns are apart."""
WITHIN = 0.8
"""Of half the field of view: no copy stands at its edge."""
WIDEST_DEG = 75.0
LABEL = "Car"
APART_M = 3.0
"""How far along x a copy's track is from the one of the copy before it."""


def grid(count: int, slope: float) -> FloatArray:
    """Places (count, 2) ahead and to the left, metres, the nearest row first and its middle first, within ``slope``
    metres to either side a metre ahead."""
    places: list[tuple[float, float]] = []
    ahead = FIRST_M
    while len(places) < count:
        columns = int(slope * ahead / ACROSS_M)
        places += [(ahead, ACROSS_M * column) for column in sorted(range(-columns, columns + 1), key=abs)]
        ahead += ALONG_M
    return np.array(places[:count], float).reshape(-1, 2)


def slope_aside(model: CameraModel) -> float:
    """How many metres to either side of the optical axis a camera sees a metre ahead, at most `WIDEST_DEG` from it: a fisheye
    sees beside itself, too."""
    if model.is_pinhole:
        return model.width / 2 / model.fx
    ends = model.unproject(np.linspace(0.5, model.width - 0.5, 129), np.full(129, model.height / 2))
    angle = np.arctan2(np.abs(ends[:, 0]), ends[:, 2])
    widest = float(angle[np.isfinite(angle)].max(initial=0.0))
    return float(np.tan(min(widest, np.radians(WIDEST_DEG))))


def model_actor(drive: Drive) -> Actor:
    """The actor that is copied: the car, or whatever there is, of the middle size. Raises `SceneError`."""
    actors = [actor for actor in drive.actors.values() if not actor.appearance.mesh]
    actors = [actor for actor in actors if actor.label == LABEL] or actors
    if not actors:
        raise SceneError(f"the drive {drive.name} has no actor that could be copied")
    return sorted(actors, key=lambda actor: (float(np.prod(actor.size_m)), actor.uid))[len(actors) // 2]


def with_copies(
    drive: Drive, heights: Callable[[FloatArray], FloatArray], view: str, frame: int, count: int, behind: bool
) -> Drive:
    """The drive with ``count`` copies on the ground, on a grid before the camera ``view`` at ``frame``, or ``behind``
    it as far. ``heights`` tells how high points (N, 3) are above the ground (N,)."""
    camera = drive.cameras[view]
    pose = camera.world_from_camera.at(camera.time_s[frame])
    yaw = float(np.arctan2(pose[1, 2], pose[0, 2]))
    places = grid(count, WITHIN * slope_aside(camera.model)) * (-1 if behind else 1)
    points = np.tile(pose[:3, 3], (count, 1))
    points[:, :2] += places @ np.array([[np.cos(yaw), np.sin(yaw)], [-np.sin(yaw), np.cos(yaw)]])
    points[:, 2] -= heights(points)
    source = model_actor(drive)
    points[:, 2] += source.size_m[2] / 2
    first, last = drive.time_s[drive.frames[0]], drive.time_s[drive.frames[-1]]
    copies = {}
    for number, point in enumerate(points):
        uid = f"copy {number}"
        trajectory = Trajectory.from_poses(np.zeros(1), make_pose(point, quaternion_from_yaw(yaw))[None])
        copies[uid] = replace(
            source, uid=uid, world_from_actor=trajectory, start_s=first, end_s=last, is_moving=False, inserted=True
        )
    return replace(drive, actors={**drive.actors, **copies})


def with_tracks(drive: Drive, count: int) -> Drive:
    """The drive with ``count`` copies of its actors, one of each in turn, present throughout; each copy's track is that
    of its actor, shifted. Raises `SceneError` where there is no actor that could be copied."""
    sources = sorted(
        (actor for actor in drive.actors.values() if not actor.appearance.mesh), key=lambda actor: actor.uid
    )
    if count and not sources:
        raise SceneError(f"the drive {drive.name} has no actor that could be copied")
    first, last = drive.time_s[drive.frames[0]], drive.time_s[drive.frames[-1]]
    copies = {}
    for number in range(count):
        source = sources[number % len(sources)]
        track = source.world_from_actor
        shift = np.array([APART_M * (1 + number // len(sources)), 0.0, 0.0])
        shifted = Trajectory(track.times_s, track.positions + shift, track.quaternions_wxyz)
        uid = f"copy {number}"
        copies[uid] = replace(source, uid=uid, world_from_actor=shifted, start_s=first, end_s=last, inserted=True)
    return replace(drive, actors={**drive.actors, **copies})
