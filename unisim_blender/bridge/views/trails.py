"""Ways of things as lines for the view: speed as colour, ticks at whole seconds, where it was recorded."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ...core.geometry import BoolArray, FloatArray, box_corners, make_pose
from ...core.world.drive import Drive
from ...editing.sampled.clock import Clock
from ...editing.sampled.poses import rigid, same_place
from ...editing.sampled.scaling import UNIT
from ..objects.animation import curves_of
from ..objects.imported import is_copy
from ..objects.meshes import scale_of
from ..objects.trajectories import trajectory_of

SLOW, FAST = np.array([0.1, 0.35, 1.0]), np.array([1.0, 0.25, 0.1])
RECORDED = np.array([0.7, 0.7, 0.7])
FASTEST_M_S = 15.0
TICK_M = 0.4
EDGES = [(0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7)]
"""Of a box, by the numbers of `box_corners`."""


@dataclass(frozen=True)
class Lines:
    """Segments: ends (2 S, 3) and their linear colours (2 S, 4)."""

    points: FloatArray
    colours: FloatArray


def trail(thing: bpy.types.Object, drive: Drive, clock: Clock, frame: float) -> Lines:
    """An actor's or the vehicle's way: its own, and beside it the recorded one with the box there, where it is another."""
    parts: list[tuple[FloatArray, FloatArray]] = []
    own, there = way_of(thing, clock), there_of(thing, clock)
    if own is not None and there.any():
        parts += [_line(own[there], speed_colours(own, clock)[there]), _ticks(own, clock, there)]
    recorded, size = _recorded(thing, drive, clock)
    here = rigid(np.array(thing.matrix_world, float))
    if recorded is not None:
        at = int(np.clip(np.searchsorted(clock.frames, frame), 0, len(clock.frames) - 1))
        if not same_place(here, recorded[at]) or scale_of(thing) != UNIT:
            grey = np.tile(RECORDED, (len(recorded), 1))
            parts.append(_line(recorded, grey))
            if size is not None:
                corners = box_corners(recorded[at], size)
                parts.append((corners[np.array(EDGES).ravel()], np.tile(RECORDED, (2 * len(EDGES), 1))))
    if not parts:
        return Lines(np.zeros((0, 3)), np.zeros((0, 4)))
    colours = np.concatenate([colour for _, colour in parts])
    return Lines(np.concatenate([points for points, _ in parts]), np.concatenate([colours, np.ones((len(colours), 1))], -1))


def way_of(thing: bpy.types.Object, clock: Clock) -> FloatArray | None:
    """Return poses (N, 4, 4) at the clock's frames by a thing's trajectory and its own keys; None where nothing is keyed.

    What moves the parents of both counts as it is now.
    """
    above = trajectory_of(thing)
    if above is None:
        return _keyed(thing, clock, np.array(thing.matrix_world @ thing.matrix_basis.inverted(), float))
    base = above.parent
    world = np.eye(4) if base is None else np.array(base.matrix_world @ above.matrix_parent_inverse, float)
    poses = _keyed(above, clock, world)
    if poses is None:
        return None
    inverse = np.array(thing.matrix_parent_inverse, float)
    on = _keyed(thing, clock, np.eye(4))
    return np.asarray(poses @ inverse @ (np.array(thing.matrix_basis, float) if on is None else on))


def there_of(thing: bpy.types.Object, clock: Clock) -> BoolArray:
    """Return at which of the clock's frames (N,) keys let a thing be present."""
    hides = [curve for curve in curves_of(thing) if curve.data_path == "hide_viewport"]
    return np.array([all(curve.evaluate(frame) < 0.5 for curve in hides) for frame in clock.frames], bool)


def _keyed(thing: bpy.types.Object, clock: Clock, above: FloatArray) -> FloatArray | None:
    """Poses (N, 4, 4) by a thing's own keys, as Blender interpolates them, and goes on beyond the first and the last."""
    found = {(c.data_path, c.array_index): c for c in curves_of(thing) if c.data_path in ("location", "rotation_quaternion")}
    ends = [frame for curve in found.values() for frame in curve.range()]
    if not ends or min(ends) == max(ends):
        return None
    frames = clock.frames.tolist()

    def values(path: str) -> FloatArray:
        now = getattr(thing, path)
        columns = [
            [found[path, i].evaluate(f) for f in frames] if (path, i) in found else [v] * len(frames) for i, v in enumerate(now)
        ]
        return np.array(columns, float).T

    quaternions = values("rotation_quaternion")
    return np.asarray(above @ make_pose(values("location"), quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)))


def speed_colours(poses: FloatArray, clock: Clock) -> FloatArray:
    """Colours (N, 3) of the speeds (N,) along a way."""
    speed = np.linalg.norm(np.gradient(poses[:, :3, 3], clock.times_s, axis=0), axis=1)
    share = np.clip(speed / FASTEST_M_S, 0, 1)[:, None]
    return np.asarray(SLOW * (1 - share) + FAST * share)


def _recorded(thing: bpy.types.Object, drive: Drive, clock: Clock) -> tuple[FloatArray | None, FloatArray | None]:
    if thing.unisim.kind == "EGO":
        return drive.world_from_ego.at(clock.times_s), None
    actor = drive.actors.get(thing.unisim.uid)
    if actor is None or not thing.users_scene or is_copy(thing.users_scene[0], thing):
        return None, None
    start, end = drive.window(actor)
    return actor.world_from_actor.at(np.clip(clock.times_s, start, end)), actor.size_m


def _line(poses: FloatArray, colours: FloatArray) -> tuple[FloatArray, FloatArray]:
    points = poses[:, :3, 3]
    return np.stack([points[:-1], points[1:]], 1).reshape(-1, 3), np.stack([colours[:-1], colours[1:]], 1).reshape(-1, 3)


def _ticks(poses: FloatArray, clock: Clock, there: BoolArray) -> tuple[FloatArray, FloatArray]:
    seconds = np.arange(np.ceil(clock.times_s[0]), clock.times_s[-1])
    at = np.searchsorted(clock.times_s, seconds)
    at = at[there[at]]
    middle, side = poses[at, :3, 3], poses[at, :3, 1] * TICK_M
    return np.stack([middle - side, middle + side], 1).reshape(-1, 3), np.ones((2 * len(at), 3))
