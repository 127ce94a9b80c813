"""An object's motion beside the recorded one of its id: speed, accelerations, curvature, and where
limits are exceeded."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.geometry import BoolArray, FloatArray
from ...core.world.drive import Drive
from ..sampled.clock import Clock
from ..sampled.poses import same
from ..sampled.recorded import recorded_poses, recorded_there
from .kinematics import Compared, Limits, exceeded, is_limited, motion_of

EGO_LABEL = "Ego vehicle (car)"


@dataclass(frozen=True)
class ObjectTrack:
    """An object at the clock's frames: poses (N, 4, 4), whether it is present (N,), and what it is."""

    name: str
    kind: str
    uid: str
    label: str
    poses: FloatArray
    there: BoolArray


def compared(track: ObjectTrack, drive: Drive, clock: Clock, limits: Limits) -> Compared:
    """Return an object's motion beside the recorded one of its id."""
    now = motion_of(track.poses[:, :3, 3], clock.times_s, track.there)
    found = recorded_track(track, drive, clock)
    before = None if found is None else motion_of(found[0][:, :3, 3], clock.times_s, found[1])
    is_edited = found is None or not (
        (found[1] == track.there).all() and same(track.poses, found[0])[track.there & found[1]].all()
    )
    over = exceeded(now, limits, before)
    if not is_edited or not is_limited(track.label):
        over = {name: np.zeros(len(where), bool) for name, where in over.items()}
    return Compared(track.name, clock.frames, now, before, is_edited, over)


def recorded_track(track: ObjectTrack, drive: Drive, clock: Clock) -> tuple[FloatArray, BoolArray] | None:
    """Return the recorded poses (N, 4, 4) and presence (N,) of an object's id; None where nobody recorded it."""
    if track.kind == "EGO":
        return drive.world_from_ego.at(clock.times_s), np.ones(len(clock.frames), bool)
    actor = drive.actors.get(track.uid)
    return None if actor is None else (recorded_poses(actor, clock), recorded_there(actor, drive, clock))


def label_of(kind: str, uid: str, own: str, drive: Drive) -> str:
    """Return the class of an object: that of a mesh is its ``own``."""
    if kind == "EGO":
        return EGO_LABEL
    actor = drive.actors.get(uid)
    return own or (actor.label if actor is not None else "")


_newest: dict[str, tuple[tuple[object, ...], Compared]] = {}
"""The newest comparison of each object, and what it was made of."""
MOST = 8
"""Comparisons that are kept."""


def kept_comparison(track: ObjectTrack, drive: Drive, clock: Clock, limits: Limits) -> Compared:
    """Return what `compared` does; the newest of each object is kept until its motion or a limit changes."""
    key = (id(drive), limits, track.kind, track.uid, track.label, track.poses.tobytes(), track.there.tobytes())
    kept = _newest.pop(track.name, None)
    if kept is None or kept[0] != key:
        kept = key, compared(track, drive, clock, limits)
    _newest[track.name] = kept
    while len(_newest) > MOST:
        del _newest[next(iter(_newest))]
    return kept[1]
