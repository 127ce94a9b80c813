"""Tracks of actors as the actor list and the presence timeline show them, and their values at a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.geometry import BoolArray, FloatArray
from ...core.world.drive import Actor, Drive
from ..sampled.clock import Clock
from ..sampled.poses import same
from ..sampled.recorded import recorded_poses, recorded_there
from .card import HALF_S


@dataclass(frozen=True)
class ActorTrack:
    """One actor at the clock's frames (N,): positions (N, 3) in the world, whether it is there (N,). ``edited`` tells
    whether it differs from what was recorded, ``group`` and ``label`` are its class, ``steps`` (S, 2) the seconds from
    when to when it is there."""

    name: str
    uid: str
    label: str
    group: str
    positions: FloatArray
    there: BoolArray
    steps: FloatArray
    edited: bool


@dataclass(frozen=True)
class FrameValues:
    """Of A actors at one frame: metres from the ego vehicle (A,), metres a second (A,), whether each is there (A,)."""

    distance_m: FloatArray
    speed_m_s: FloatArray
    there: BoolArray


def steps_of(there: BoolArray, clock: Clock) -> FloatArray:
    """Return the seconds (S, 2) from when to when something is there (N,), for each time that it comes."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(int)))
    return np.stack([clock.times_s[edges[::2]], clock.times_s[edges[1::2] - 1]], -1) if len(edges) else np.zeros((0, 2))


def values_at(tracks: list[ActorTrack], ego: FloatArray, clock: Clock, frame: float) -> FrameValues:
    """Return the values of actors at a frame; ``ego`` (N, 3) are the vehicle's positions at the clock's frames."""
    if not tracks:
        return FrameValues(np.zeros(0), np.zeros(0), np.zeros(0, bool))
    positions = np.stack([track.positions for track in tracks])
    now = float(clock.time_s(np.array(frame)))
    apart = at_time(positions, clock, now) - at_time(ego, clock, now)
    moved = at_time(positions, clock, now + HALF_S) - at_time(positions, clock, now - HALF_S)
    number = int(np.clip(np.searchsorted(clock.frames, frame + 1e-6, side="right") - 1, 0, len(clock.frames) - 1))
    return FrameValues(
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


def differs(poses: FloatArray, there: BoolArray, actor: Actor, drive: Drive, clock: Clock) -> bool:
    """Return whether an actor at poses (N, 4, 4), present (N,), goes elsewhere or at other times than recorded."""
    recorded = recorded_there(actor, drive, clock)
    return bool((there != recorded).any() or not same(poses, recorded_poses(actor, clock))[recorded].all())
