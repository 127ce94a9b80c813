"""Tracks of actors as the actor list and the presence timeline show them, their values at a frame, their cards in the
sidebar and their names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...core.actor_images.kept import kept_images
from ...core.actor_images.names import full_name, plain_names
from ...core.geometry import BoolArray, FloatArray
from ...core.world.drive import Actor, Drive
from ..sampled.clock import Clock, recorded_poses, recorded_there
from ..sampled.poses import same
from ..sampled.scene import UNIT, Factors, scale_text, size_text
from ..sampled.source import DriveSource
from ..texts import Text

HALF_S = 0.1
"""Speed is that between so many seconds before and after the frame."""


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


@dataclass(frozen=True)
class ActorCard:
    """An actor's name and class, what became of it, its speed, how far it is from the ego vehicle, from when to when it
    is there, in seconds of the log, and how large it is, in words."""

    name: str
    label: str
    role: str
    speed_m_s: float
    distance_m: float
    present_s: tuple[float, float] | None
    size: str = ""


def present_span(there: BoolArray, clock: Clock) -> tuple[float, float] | None:
    """Return the times in seconds of the first and the last frame at which an actor is present (N,); None for none."""
    shown = clock.times_s[there]
    return (float(shown[0]), float(shown[-1])) if len(shown) else None


def size_words(size_m: Sequence[float], factors: Factors) -> str:
    """Return how large an actor is drawn (3,), and by what it is scaled, in words."""
    # as long as the sidebar shows at its first width
    return size_text(size_m, digits=2) if factors == UNIT else f"{size_text(size_m, digits=1)} ×{scale_text(factors)}"


def role_words(is_mesh: bool, is_recorded: bool, is_copy: bool, other_appearance: bool) -> str:
    """Return what an actor is in one or two words."""
    if is_mesh:
        return Text("mesh")
    if not is_recorded:
        return Text("inserted")
    if is_copy:
        return Text("copy")
    return Text("recorded, other appearance" if other_appearance else "recorded")


def names_at_import(source: DriveSource) -> dict[str, str]:
    """Return the names of a source's actors by id, with the words for their colours where these are kept already."""
    kept = kept_images(source.log_path) or {}
    words = {uid: one.word for uid, one in kept.items()}
    return {uid: full_name(plain, words.get(uid, "")) for uid, plain in plain_names(named_actors(source)).items()}


def named_actors(source: DriveSource) -> dict[str, Actor]:
    """Return the actors that are counted: all of the log's, so that a scene trained on it has the same names."""
    return {**source.drive.actors, **(source.log.drive.actors if source.log is not None else {})}


def is_plain(name: str, plain: str) -> bool:
    """Return whether a name is the plain one, with the number that Blender adds where another scene
    has that name too."""
    return re.fullmatch(re.escape(plain) + r"(\.\d{3,})?", name) is not None
