"""Actors shifted sideways, along their trajectory and in time."""

from __future__ import annotations

import bpy

from ...editing.motion.keys import is_path, shifted_keys
from ...editing.motion.retiming import later_or_earlier
from ...editing.sampled.clock import Clock
from ...editing.texts import Text, series
from ..objects.animation import curves_of, keys_of, write_keys
from ..objects.trajectories import own_trajectory, trajectory_of
from .motion import displaced_along, retimed

SAME = 1e-6
"""Smaller shifts, in metres or seconds, are none."""


def shift(obj: bpy.types.Object, left_m: float, ahead_m: float, later_s: float, clock: Clock) -> str:
    """Shift an actor, alike at every time, and return what was done as a sentence.

    ``left_m`` is along its own y axis. ``ahead_m`` is an arc length along the path of its trajectory, straight on
    beyond the path's ends; an actor that goes nowhere is shifted along its own x axis. ``later_s`` is in seconds of the
    log and takes its presence along.
    """
    done: list[str] = []
    if abs(left_m) > SAME:
        displaced_along(obj, (0.0, left_m, 0.0))
        done.append(
            Text("{length:.2f} m to the left" if left_m > 0 else "{length:.2f} m to the right", length=abs(left_m))
        )
    if abs(ahead_m) > SAME:
        shift = Text("{length:.2f} m forward" if ahead_m > 0 else "{length:.2f} m backward", length=abs(ahead_m))
        if _along_path(obj, ahead_m, clock):
            done.append(Text("{shift} along its path", shift=shift))
        else:
            displaced_along(obj, (ahead_m, 0.0, 0.0))
            done.append(Text("{shift} along its own axis, as it stands still", shift=shift))
    if abs(later_s) > SAME:
        if trajectory_of(obj) is None and not len(curves_of(obj)):
            done.append(Text("at the same times, as it stands there throughout"))
        else:
            retimed(obj, lambda frames: clock.frame(clock.time_s(frames) + later_s))
            done.append(later_or_earlier(later_s, clock))
    return series([obj.name, series(done)], ": ") if done else ""


def _along_path(obj: bpy.types.Object, ahead_m: float, clock: Clock) -> bool:
    """Shift the keys of an actor's trajectory along their path; return whether there is one."""
    above = trajectory_of(obj) or obj
    keys = keys_of(above)
    if keys is None or not is_path(keys[1]):
        return False
    above = own_trajectory(obj) or obj
    write_keys(above, *shifted_keys(*keys, clock.frames, ahead_m))
    return True
