"""Trajectories of actors and of the ego vehicle, as edited and as recorded: as lines for the view with speed as colour and
ticks at whole seconds, and as motion that is compared with limits. Where moved sensors were recorded, as lines.

Check Edits and the speed graph both ask `compared_now`, so they agree."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.geometry import FloatArray, transform_points
from ...core.world.drive import Camera, Drive
from ...editing.layout.shapes import pyramid, ring
from ...editing.layout.trails import RECORDED, TrailSegments, joined, own_lines, recorded_lines
from ...editing.motion.kinematics import Limits, MotionComparison, ObjectTrack, cached_comparison
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import UNIT, rigid, same, same_place
from ...editing.sensors.mounts import recorded_pose
from ..objects.animation import curves_of, shown_by_keys
from ..objects.imported import class_of, is_copy
from ..objects.meshes import scale_of
from ..objects.trajectories import keyed_poses, trajectory_of
from .sensor_facts import recorded_sensor

MOVING = ("location", "rotation_quaternion", "rotation_euler")


def trail(obj: bpy.types.Object, drive: Drive, clock: Clock, frame: float) -> TrailSegments:
    """Return an actor's or the vehicle's trajectory as lines: its own, and beside it the recorded one with the box
    there, where it is another."""
    recorded, size = _recorded(obj, drive, clock)
    here = rigid(np.array(obj.matrix_world, float))
    parts = [own_lines(trajectory_poses(obj, clock), shown_by_keys(obj, clock.frames), clock)]
    if recorded is not None:
        at = int(np.clip(np.searchsorted(clock.frames, frame), 0, len(clock.frames) - 1))
        if not same_place(here, recorded[at]) or scale_of(obj) != UNIT:
            parts.append(recorded_lines(recorded, at, size))
    return joined(parts)


def trajectory_poses(obj: bpy.types.Object, clock: Clock) -> FloatArray | None:
    """Return where keys put an object at the clock's frames (N, 4, 4); None where no key moves its trajectory, or itself
    where it has none."""
    curves = [curve for curve in curves_of(trajectory_of(obj) or obj) if curve.data_path in MOVING]
    ends = [frame for curve in curves for frame in curve.range()]
    return keyed_poses(obj, clock.frames) if ends and min(ends) < max(ends) else None


def _recorded(obj: bpy.types.Object, drive: Drive, clock: Clock) -> tuple[FloatArray | None, FloatArray | None]:
    if obj.unisim.kind == "EGO":
        return drive.world_from_ego.at(clock.times_s), None
    actor = drive.actors.get(obj.unisim.uid)
    if actor is None or not obj.users_scene or is_copy(obj.users_scene[0], obj):
        return None, None
    start, end = drive.window(actor)
    return actor.world_from_actor.at(np.clip(clock.times_s, start, end)), actor.size_m


def outline(scene: bpy.types.Scene, obj: bpy.types.Object, drive: Drive, frame: float) -> TrailSegments:
    """Return the outline of a recorded sensor, a camera's pyramid or a LiDAR's ring, where it was recorded at a frame,
    and a line from there to where it is now. Empty for a sensor that stands there still, and for one
    that no log has."""
    sensor = recorded_sensor(scene, obj, drive)
    here = rigid(np.array(obj.matrix_world, float))
    pose = None if sensor is None else recorded_pose(sensor, drive, frame)
    if sensor is None or pose is None or same(here, pose).all():
        return TrailSegments(np.zeros((0, 3)), np.zeros((0, 4)))
    shape = pyramid(sensor) if isinstance(sensor, Camera) else ring()
    points = np.concatenate([transform_points(pose, shape), [pose[:3, 3], here[:3, 3]]])
    return TrailSegments(points, np.tile(RECORDED, (len(points), 1)))


def track_of(obj: bpy.types.Object, drive: Drive, clock: Clock) -> ObjectTrack:
    """Return where keys put an actor or the ego vehicle at the clock's frames, without leaving the
    frame that is shown."""
    poses = trajectory_poses(obj, clock)
    if poses is None:
        poses = np.tile(rigid(np.array(obj.matrix_world, float)), (len(clock.frames), 1, 1))
    kind, uid = obj.unisim.kind, obj.unisim.uid
    if obj.unisim.look and obj.users_scene and is_copy(obj.users_scene[0], obj):
        uid = ""  # an inserted actor was recorded nowhere
    label = class_of(obj, drive)
    return ObjectTrack(obj.name, kind, uid, label, poses, shown_by_keys(obj, clock.frames))


def compared_now(obj: bpy.types.Object, drive: Drive, clock: Clock, limits: Limits) -> MotionComparison:
    """Return an object's motion beside the recorded one. It is computed again only when the motion or
    a limit changes."""
    return cached_comparison(track_of(obj, drive, clock), drive, clock, limits)
