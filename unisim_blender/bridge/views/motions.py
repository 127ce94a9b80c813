"""The motion of actors and of the ego vehicle, as edited and as recorded, and where the edit exceeds the limits.

Check Edits and the speed graph both ask here, so they agree.
"""

from __future__ import annotations

import bpy
import numpy as np

from ...core.world.drive import Drive
from ...editing.motion.kinematics import Compared, Limits, ObjectTrack, cached_comparison, label_of
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import rigid
from ..objects.animation import shown_by_keys
from .trails import trajectory_poses


def track_of(obj: bpy.types.Object, drive: Drive, clock: Clock) -> ObjectTrack:
    """Return where keys put an actor or the ego vehicle at the clock's frames, without leaving the
    frame that is shown."""
    poses = trajectory_poses(obj, clock)
    if poses is None:
        poses = np.tile(rigid(np.array(obj.matrix_world, float)), (len(clock.frames), 1, 1))
    kind, uid = obj.unisim.kind, obj.unisim.uid
    label = label_of(kind, obj.unisim.look or uid, obj.unisim.label, drive)
    return ObjectTrack(obj.name, kind, uid, label, poses, shown_by_keys(obj, clock.frames))


def compared_now(obj: bpy.types.Object, drive: Drive, clock: Clock, limits: Limits) -> Compared:
    """Return an object's motion beside the recorded one. It is computed again only when the motion or
    a limit changes."""
    return cached_comparison(track_of(obj, drive, clock), drive, clock, limits)
