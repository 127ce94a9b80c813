"""The trajectory that an object of the drive rides on: a hidden, locked parent that carries the keys.

The object itself keeps a free local transform. Moving or turning it with Blender's own tools therefore displaces it
from its trajectory by the same amount, in the trajectory's own axes, at every frame. Objects that never move
have no trajectory.
"""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np
from mathutils import Euler

from ...core.geometry import FloatArray, make_pose
from .animation import curves_of, keyed_values, keys_of, move_curves, remove_curves, write_keys
from .imported import collection_of, stand_at

TRAJECTORY_KIND = "TRAJECTORY"
DISPLACEMENT_PATHS = ("location", "rotation_quaternion", "rotation_euler")
"""Data paths of the animation that moves an object on its trajectory."""


def trajectory_of(obj: bpy.types.Object) -> bpy.types.Object | None:
    """Return the parent that carries the keys of ``obj``; None where it has none."""
    above = obj.parent
    return above if above is not None and above.unisim.kind == TRAJECTORY_KIND else None


def span_of(obj: bpy.types.Object) -> tuple[float, float] | None:
    """Return the frames of the first and last key of an object's trajectory; None where it has none."""
    above = trajectory_of(obj)
    curves = [] if above is None else [curve for curve in curves_of(above) if curve.data_path == "location"]
    curve = next((curve for curve in curves if len(curve.keyframe_points)), None)
    return None if curve is None else (float(curve.keyframe_points[0].co[0]), float(curve.keyframe_points[-1].co[0]))


def ride(obj: bpy.types.Object, on: bpy.types.Object | None = None) -> bpy.types.Object:
    """Put ``obj``, undisplaced, onto a new trajectory that is parented to ``on``. Return the trajectory."""
    free(obj, on)
    above = _new(obj, obj.name)
    above.parent = on
    above.matrix_parent_inverse.identity()
    _attach(obj, above)
    settle_on(obj)
    return above


def free(obj: bpy.types.Object, on: bpy.types.Object | None = None) -> None:
    """Take ``obj`` off its trajectory and parent it to ``on``. A trajectory that nothing rides on is deleted."""
    above = trajectory_of(obj)
    obj.parent = on
    obj.matrix_parent_inverse.identity()
    if above is not None:
        _drop(above)


def own_trajectory(obj: bpy.types.Object) -> bpy.types.Object | None:
    """Return the trajectory of ``obj`` after giving it one of its own where copies ride on the same; None
    where it has none."""
    above = trajectory_of(obj)
    if above is None or len(above.children) == 1:
        return above
    copy = _new(obj, obj.name)
    copy.parent = above.parent
    copy.matrix_parent_inverse = above.matrix_parent_inverse
    copy.location, copy.rotation_quaternion = above.location, above.rotation_quaternion
    keys = keys_of(above)
    if keys is not None:
        write_keys(copy, *keys)
    _attach(obj, copy)
    return copy


def remove(obj: bpy.types.Object) -> None:
    """Delete an object, and its trajectory where nothing else rides on that."""
    above = trajectory_of(obj)
    bpy.data.objects.remove(obj)
    if above is not None:
        _drop(above)


def settle_on(obj: bpy.types.Object) -> None:
    """Put ``obj`` onto its trajectory without any displacement."""
    remove_curves(obj, *DISPLACEMENT_PATHS)
    obj.location = (0.0, 0.0, 0.0)
    obj.rotation_quaternion = (1.0, 0.0, 0.0, 0.0)
    obj.rotation_euler = (0.0, 0.0, 0.0)
    obj.unisim.rest_location, obj.unisim.rest_rotation = (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)


def set_on_trajectory(obj: bpy.types.Object, pose: FloatArray) -> None:
    """Put ``obj`` at a pose (4, 4) in the axes of its trajectory; that counts as undisplaced."""
    stand_at(obj, pose)
    obj.unisim.rest_location, obj.unisim.rest_rotation = obj.location, obj.rotation_quaternion


def convert(obj: bpy.types.Object) -> bool:
    """Move keys that earlier versions kept on the object itself onto a trajectory; return whether there were any.

    Objects that constraints, drivers or the NLA move stay as they are.
    """
    data = obj.animation_data
    moving = any(curve.data_path == "location" and len(curve.keyframe_points) > 1 for curve in curves_of(obj))
    if not moving or trajectory_of(obj) is not None or obj.rotation_mode != "QUATERNION":
        return False
    if obj.constraints or data.drivers or any(track.strips for track in data.nla_tracks):
        return False
    above = _new(obj, obj.name)
    above.parent, above.matrix_parent_inverse = obj.parent, obj.matrix_parent_inverse
    above.location, above.rotation_quaternion = obj.location, obj.rotation_quaternion
    move_curves(obj, above, "location", "rotation_quaternion")
    _attach(obj, above)
    settle_on(obj)
    return True


def local_poses(obj: bpy.types.Object, frames: Iterable[float]) -> FloatArray:
    """Return where keys put an object in its parent's axes at frames (N,), without its scale (N, 4, 4); properties
    without keys count as they are."""
    frames = list(frames)
    places = keyed_values(obj, "location", frames)
    if obj.rotation_mode == "QUATERNION":
        turns = keyed_values(obj, "rotation_quaternion", frames)
        return make_pose(places, turns / np.maximum(np.linalg.norm(turns, axis=1, keepdims=True), 1e-12))
    poses = np.tile(np.eye(4), (len(frames), 1, 1))
    if obj.rotation_mode == "AXIS_ANGLE":
        poses[:, :3, :3] = np.array(obj.matrix_basis.to_quaternion().to_matrix(), float)
    else:
        angles = keyed_values(obj, "rotation_euler", frames).tolist()
        poses[:, :3, :3] = [np.array(Euler(row, obj.rotation_mode).to_matrix(), float) for row in angles]
    poses[:, :3, 3] = places
    return poses


def keyed_poses(obj: bpy.types.Object, frames: Iterable[float]) -> FloatArray:
    """Return where an object's own keys and its parents' put it at frames (N,), as poses in the world (N, 4, 4)."""
    frames = list(frames)
    own = local_poses(obj, frames)
    if obj.parent is None:
        return own
    return keyed_poses(obj.parent, frames) @ np.array(obj.matrix_parent_inverse, float) @ own


def keyed_pose(obj: bpy.types.Object, frame: float) -> FloatArray:
    """Return the pose (4, 4) of `keyed_poses` at one frame."""
    return keyed_poses(obj, [frame])[0]


def _new(obj: bpy.types.Object, name: str) -> bpy.types.Object:
    """A trajectory that nothing rides on yet."""
    above = bpy.data.objects.new(f"{name} trajectory", None)
    collection_of(obj.users_scene[0], TRAJECTORY_KIND).objects.link(above)
    above.unisim.kind, above.unisim.uid = TRAJECTORY_KIND, obj.unisim.uid
    above.rotation_mode = "QUATERNION"
    above.empty_display_size = 0.01
    above.hide_viewport = above.hide_select = above.hide_render = True
    above.lock_location = above.lock_rotation = above.lock_scale = (True, True, True)
    return above


def _attach(obj: bpy.types.Object, above: bpy.types.Object) -> None:
    obj.parent = above
    obj.matrix_parent_inverse.identity()
    obj.rotation_mode = "QUATERNION"


def _drop(above: bpy.types.Object) -> None:
    if above.children:
        return
    action = above.animation_data.action if above.animation_data is not None else None
    bpy.data.objects.remove(above)
    if action is not None and action.users == 0:
        bpy.data.actions.remove(action)
