"""What the actor list and the presence timeline show of each actor, worked out outside of any drawing.

An actor's track is where its keys put it at all frames of the clock, and when they show it. It is worked out again only when the
actor changed; distance and speed at another frame then take one step for all actors together.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ...core.actor_images.names import group_of
from ...core.geometry import BoolArray, FloatArray, make_pose
from ...core.world.drive import Drive
from ...editing.reading.actors import recorded_poses, recorded_there
from ...editing.sampled.clock import Clock
from ...editing.sampled.poses import same
from ..objects.animation import curves_of
from ..objects.imported import things
from ..objects.trajectories import keyed_pose, trajectory_of
from .card import HALF_S


@dataclass(frozen=True)
class Track:
    """One actor at the clock's frames (N,): positions (N, 3) in the world, whether it is there (N,). ``edited`` tells whether it
    differs from what was recorded, ``group`` and ``label`` are its class, ``steps`` (S, 2) the seconds from when to when it is
    there."""

    name: str
    uid: str
    label: str
    group: str
    positions: FloatArray
    there: BoolArray
    steps: FloatArray
    edited: bool


@dataclass(frozen=True)
class Figures:
    """Of A actors at one frame: metres from the ego vehicle (A,), metres a second (A,), whether each is there (A,)."""

    distance_m: FloatArray
    speed_m_s: FloatArray
    there: BoolArray


def track_of(thing: bpy.types.Object, drive: Drive, clock: Clock, original: bool) -> Track:
    """Return an actor's track; ``original`` tells whether the object stands for the recorded actor and is no copy."""
    poses, there = poses_of(thing, clock.frames), there_of(thing, clock.frames)
    recorded = drive.actors.get(thing.unisim.look or thing.unisim.uid)
    label = thing.unisim.label or (recorded.label if recorded is not None else "")
    return Track(
        thing.name, thing.unisim.uid, label, group_of(label), poses[:, :3, 3], there, steps_of(there, clock),
        is_edited(thing, drive, clock, poses, there, original),
    )  # fmt: skip


def is_edited(thing: bpy.types.Object, drive: Drive, clock: Clock, poses: FloatArray, there: BoolArray, original: bool) -> bool:
    """Return whether a scenario would name an actor: it is new, removed, has another appearance, or goes elsewhere or at other
    times than recorded. What constraints, drivers or the NLA do counts as edited unseen."""
    actor = drive.actors.get(thing.unisim.uid)
    if actor is None or not original or thing.unisim.mesh or thing.unisim.look or thing.hide_render:
        return True
    for one in (thing, trajectory_of(thing)):
        data = one.animation_data if one is not None else None
        if one is not None and (one.constraints or (data is not None and (data.drivers or data.nla_tracks))):
            return True
    recorded = recorded_there(actor, drive, clock)
    return bool((there != recorded).any() or not same(poses, recorded_poses(actor, clock))[recorded].all())


def poses_of(thing: bpy.types.Object, frames: FloatArray) -> FloatArray:
    """Return where an object's own keys and its parents' put it at frames (N,), as poses in the world (N, 4, 4)."""
    if thing.rotation_mode != "QUATERNION":
        return np.stack([keyed_pose(thing, float(frame)) for frame in frames])
    found = {(curve.data_path, curve.array_index): curve for curve in curves_of(thing)}

    def values(path: str) -> FloatArray:
        columns = []
        for index, value in enumerate(getattr(thing, path)):
            curve = found.get((path, index))
            columns.append(np.full(len(frames), value) if curve is None else [curve.evaluate(frame) for frame in frames])
        return np.array(columns, float).T

    quaternions = values("rotation_quaternion")
    quaternions /= np.maximum(np.linalg.norm(quaternions, axis=1, keepdims=True), 1e-12)
    own = make_pose(values("location"), quaternions)
    if thing.parent is None:
        return own
    return poses_of(thing.parent, frames) @ np.array(thing.matrix_parent_inverse, float) @ own


def there_of(thing: bpy.types.Object, frames: FloatArray) -> BoolArray:
    """Return whether keys show an object at frames (N,), and it is not removed."""
    hides = [curve for curve in curves_of(thing) if curve.data_path == "hide_viewport"]
    shown = np.full(len(frames), not thing.hide_render)
    for curve in hides:
        shown &= np.array([curve.evaluate(frame) < 0.5 for frame in frames])
    return shown


def steps_of(there: BoolArray, clock: Clock) -> FloatArray:
    """Return the seconds (S, 2) from when to when something is there (N,), for each time that it comes."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(int)))
    return np.stack([clock.times_s[edges[::2]], clock.times_s[edges[1::2] - 1]], -1) if len(edges) else np.zeros((0, 2))


def figures_of(tracks: list[Track], ego: FloatArray, clock: Clock, frame: float) -> Figures:
    """Return the figures of actors at a frame; ``ego`` (N, 3) are the vehicle's positions at the clock's frames."""
    if not tracks:
        return Figures(np.zeros(0), np.zeros(0), np.zeros(0, bool))
    positions = np.stack([track.positions for track in tracks])
    now = float(clock.time_s(np.array(frame)))
    apart = at_time(positions, clock, now) - at_time(ego, clock, now)
    moved = at_time(positions, clock, now + HALF_S) - at_time(positions, clock, now - HALF_S)
    number = int(np.clip(np.searchsorted(clock.frames, frame + 1e-6, side="right") - 1, 0, len(clock.frames) - 1))
    return Figures(
        np.linalg.norm(apart, axis=-1),
        np.linalg.norm(moved, axis=-1) / (2 * HALF_S),
        np.array([track.there[number] for track in tracks]),
    )


def at_time(positions: FloatArray, clock: Clock, time_s: float) -> FloatArray:
    """Return positions (..., 3) at a time, of positions (..., N, 3) at the clock's times; carried on at the ends."""
    last = len(clock.times_s) - 2
    lower = int(np.clip(np.searchsorted(clock.times_s, time_s, side="right") - 1, 0, last))
    share = (time_s - clock.times_s[lower]) / (clock.times_s[lower + 1] - clock.times_s[lower])
    return np.asarray(positions[..., lower, :] * (1 - share) + positions[..., lower + 1, :] * share)


def originals(scene: bpy.types.Scene) -> dict[str, str]:
    """Return the name of the object that stands for each imported actor, by id; as `things.original_of`, for all at once."""
    found: dict[str, str] = {}
    for thing in things(scene, "ACTOR"):
        uid = thing.unisim.uid
        if uid and (uid not in found or thing.name == thing.unisim.home):
            found[uid] = thing.name
    return found
