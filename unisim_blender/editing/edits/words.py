"""How the sidebar words an edit: displacements, times and trajectories in a few words."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...core.geometry import BoolArray, FloatArray, Trajectory, invert_pose
from ...core.world.drive import Actor
from ..sampled.clock import Clock
from ..sampled.poses import SAME_M, same
from ..sampled.scene import SampledObject
from ..texts import LOWER, UPPER, Text, cased, series, translatable

RETIMED_FRAMES = 0.02
"""Trajectories whose first or last key is this far from the recorded one are retimed."""


NEAR_M = 0.1
"""A retimed object is no further than this from the recorded path."""
SAME_S = 0.05
"""Delays that differ by less count as one delay."""
SLOW_M_S = 0.5
"""Below this speed a place on the path does not tell the time."""
DIRECTIONS = (
    (translatable("{length} forward"), translatable("{length} back")),
    (translatable("{length} left"), translatable("{length} right")),
    (translatable("{length} up"), translatable("{length} down")),
)
"""Along an object's axes, and against them."""
MOSTLY = 0.95
"""Share of a displacement along one axis from which on that direction is told."""
SMALL = 0.05
"""A share of the largest component of a displacement below which another is not told."""
FINE = 10
"""Samples of the recorded path for each frame."""
BEYOND_S = 3.0
"""How far beyond its ends the recorded path is looked at, in seconds."""


def metres(value: float) -> str:
    """Return a distance with as many digits as it needs: "3.0 m", "0.04 m"."""
    return f"{value:.1f} m" if value >= 0.095 else f"{value:.2f} m" if value >= 0.005 else f"{1000 * value:.1f} mm"


def moved_words(apart: FloatArray) -> str:
    """Return what a displacement (4, 4) in an object's own axes (forward, left, up) does: "3.0 m left, turned 10°
    right"."""
    largest = float(np.abs(apart[:3, 3]).max())
    words: list[str] = []
    for value, (more, less) in zip(apart[:3, 3], DIRECTIONS, strict=True):
        if abs(value) > max(SAME_M, SMALL * largest):
            words.append(Text(more if value > 0 else less, length=metres(abs(float(value)))))
    return series([*words, *turned_words(apart[:3, :3])])


def degrees(value: float) -> str:
    """Return an angle with as many digits as it needs: "20°", "0.4°"."""
    return f"{value:.0f}°" if value >= 9.95 else f"{value:.1f}°"


def turned_words(rotation: FloatArray) -> list[str]:
    """Return what a rotation (3, 3) does, in no more than one phrase."""
    yaw = np.degrees(np.arctan2(rotation[1, 0], rotation[0, 0]))
    whole = np.degrees(np.arccos(np.clip((np.trace(rotation) - 1) / 2, -1, 1)))
    if whole < 0.05:
        return []
    if abs(whole - abs(yaw)) < 0.05 + 0.02 * whole:
        return [Text("turned {angle} left" if yaw > 0 else "turned {angle} right", angle=degrees(abs(yaw)))]
    return [Text("turned by {angle}", angle=degrees(whole))]


def displaced_words(apart: FloatArray) -> str:
    """Return what displacements (N, 4, 4) do, one for each frame: the same phrase for all, or how large they get."""
    if len(apart) == 0 or same(apart, np.eye(4)).all():
        return ""
    spread = np.ptp(apart[:, :3, 3], axis=0).max()
    turns = np.abs(apart[:, :3, :3] - apart[:1, :3, :3]).max()
    if spread <= 4 * SAME_M and turns < 1e-4:
        by = moved_words(apart[len(apart) // 2])
        return cased(by, UPPER) if by.startswith("turned") else moved(by)
    far = apart[np.linalg.norm(apart[:, :3, 3], axis=1).argmax(), :3, 3]
    axis, length = int(np.abs(far).argmax()), float(np.linalg.norm(far))
    if length < SAME_M:
        return Text("Turned")
    away = metres(length)
    if abs(far[axis]) > MOSTLY * length:
        away = Text(DIRECTIONS[axis][int(far[axis] < 0)], length=away)
    return moved(Text("by up to {away}", away=away))


def moved(by: str) -> Text:
    """Return that an object is moved, and how far."""
    return Text("Moved {by}", by=by)


def unmoved(phrase: str) -> str:
    """Return how far a phrase of `moved` says that an object is moved; another phrase as it is."""
    by = phrase.values.get("by") if isinstance(phrase, Text) else None
    return by if isinstance(by, str) else phrase


def retimed_words(times_s: FloatArray, places: FloatArray, recorded: Trajectory) -> str:
    """Return how much later or earlier an object at ``places`` (N, 3) is on the recorded path; "" where it is not on
    the path."""
    first, last = float(recorded.times_s[0]) - BEYOND_S, float(recorded.times_s[-1]) + BEYOND_S
    step = max((last - first) / 4000, float(np.median(np.diff(times_s))) / FINE if len(times_s) > 1 else 0.01)
    then = np.arange(first, last, step)
    path = recorded.at(then)[:, :3, 3]
    speed = np.linalg.norm(np.gradient(path, then, axis=0), axis=1)
    away = np.linalg.norm(places[:, None] - path[None], axis=-1)
    nearest = away.argmin(1)
    if away.min(1).max() > NEAR_M:
        return ""
    delays = (times_s - then[nearest])[speed[nearest] > SLOW_M_S]
    if len(delays) == 0:
        return ""
    low, high = float(delays.min()), float(delays.max())
    if high - low < SAME_S:
        middle = float(np.median(delays))
        if abs(middle) < SAME_S / 4:
            return ""
        return Text("Retimed: {time} later" if middle > 0 else "Retimed: {time} earlier", time=seconds(abs(middle)))
    if low > -SAME_S:
        return Text("Retimed: up to {time} later", time=seconds(high))
    if high < SAME_S:
        return Text("Retimed: up to {time} earlier", time=seconds(-low))
    return Text("Retimed: {before} earlier to {after} later", before=seconds(-low), after=seconds(high))


def seconds(value: float) -> str:
    """Return a duration: "0.6 s"."""
    return f"{value:.1f} s" if value >= 0.095 else f"{value:.2f} s"


def trajectory_words(
    clock: Clock, poses: FloatArray, base: FloatArray, recorded: Trajectory | None, retimed: bool
) -> str:
    """Return how a trajectory's poses (N, 4, 4) differ from the recorded ones, ``base`` (N, 4, 4); "" where they do
    not.

    ``retimed``: whether its keys lie at other times than the recorded ones.
    """
    if len(poses) == 0 or same(poses, base).all():
        return ""
    if retimed and recorded is not None and (words := retimed_words(clock.times_s, poses[:, :3, 3], recorded)):
        return words
    apart = (poses - base)[:, :3, 3]
    if np.ptp(apart, axis=0).max() <= 4 * SAME_M and np.abs((poses - base)[:, :3, :3]).max() < 1e-4:
        return displaced_words((invert_pose(base) @ poses)[:1])
    words = displaced_words(invert_pose(base) @ poses)
    if same(poses, poses[:1]).all() and not same(base, base[:1]).all():
        return Text("Stands still")
    if "up to" not in words:
        return words
    return Text("New trajectory, up to {length} away", length=metres(float(np.linalg.norm(apart, axis=1).max())))


def presence_words(clock: Clock, there: BoolArray) -> str:
    """Return from when to when an object is there."""
    at = clock.times_s[there]
    return Text("Present from {start:.1f} to {end:.1f} s", start=float(at[0]), end=float(at[-1]))


def joined(parts: Iterable[str]) -> str:
    """Return phrases as one: the first as it is, the others beginning small."""
    found = [part for part in parts if part]
    return series([*found[:1], *(cased(part, LOWER) for part in found[1:])], "; ") if found else ""


def path_words(
    obj: SampledObject, base: FloatArray, lifted: FloatArray, there: BoolArray, actor: Actor | None, clock: Clock
) -> str:
    """Return how an object moves otherwise than ``base`` (N, 4, 4), which lies ``lifted`` for an object with
    another appearance or scale."""
    return joined(path_phrases(obj, base, lifted, there, actor, clock))


def path_phrases(
    obj: SampledObject, base: FloatArray, lifted: FloatArray, there: BoolArray, actor: Actor | None, clock: Clock
) -> list[str]:
    """Return the phrases of `path_words`."""
    at = obj.there & there if (obj.there & there).any() else obj.there
    few = Clock(clock.frames[at], clock.times_s[at])
    parts = []
    if obj.ridden is not None and actor is not None:
        recorded = actor.world_from_actor
        parts.append(trajectory_words(few, obj.ridden[at], base[at], recorded, is_retimed(obj, recorded, clock)))
        rise = invert_pose(base[at]) @ lifted[at]
        parts.append(displaced_words(invert_pose(obj.ridden[at] @ rise) @ obj.poses[at]))
    else:
        parts.append(trajectory_words(few, obj.poses[at], lifted[at], None, False))
    if (obj.there != there).any() and not any(part.startswith("Retimed") for part in parts):
        parts.append(presence_words(clock, obj.there))
    return [part for part in parts if part]


def is_retimed(obj: SampledObject, recorded: Trajectory, clock: Clock) -> bool:
    """Return whether the keys of an object's trajectory lie at other times than the recorded ones."""
    keys = clock.frame(recorded.times_s[[0, -1]])
    return obj.span is not None and bool(np.abs(np.array(obj.span) - keys).max() > RETIMED_FRAMES)
