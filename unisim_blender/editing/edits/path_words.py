"""How the edits list words where an object goes, beside how it was recorded."""

from __future__ import annotations

import numpy as np

from ...core.geometry import BoolArray, FloatArray, Trajectory, invert_pose
from ...core.world.drive import Actor
from ..sampled.clock import Clock
from ..sampled.scene import SampledObject
from .words import displaced_words, joined, presence_words, trajectory_words

RETIMED_FRAMES = 0.02
"""Trajectories whose first or last key is this far from the recorded one are retimed."""


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
