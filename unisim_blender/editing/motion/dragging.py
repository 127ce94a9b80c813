"""Dragging in a view: where a dragged point is, and the times at which a trajectory has handles to be dragged by."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.geometry import FloatArray


def on_plane(origin: FloatArray, direction: FloatArray, point: FloatArray, normal: FloatArray) -> FloatArray | None:
    """Return where a ray hits the plane through a point; None where it runs along it or away from it."""
    along = float(direction @ normal)
    if abs(along) < 1e-6:
        return None
    away = float((point - origin) @ normal) / along
    return None if away <= 0 else np.asarray(origin + away * direction)


def along_axis(origin: FloatArray, direction: FloatArray, point: FloatArray, line: FloatArray) -> float:
    """Return how far from a point along a unit ``line`` (3,) that line is nearest to a ray."""
    unit = direction / np.linalg.norm(direction)
    across = float(unit @ line)
    apart = origin - point
    return float((apart @ line - across * (apart @ unit)) / max(1 - across**2, 1e-9))


def stepped(value: float, step: float, in_steps: bool) -> float:
    """Return a value, in steps where that is asked for."""
    return round(value / step) * step if in_steps else value


MOST = 24
"""Handles of one trajectory: of a long drive every second, fifth, or tenth whole second has one."""
STEPS_S = (1.0, 2.0, 5.0, 10.0, 20.0, 60.0)
NEAR = 0.3
"""Whole seconds nearer than this share of a step to a key have no handle of their own."""


@dataclass(frozen=True)
class Handle:
    """A time on a trajectory, in seconds of the log, the place (3,) in the world there, and whether a key
    displaces it there."""

    time_s: float
    place: FloatArray
    is_key: bool


def handle_times(key_times_s: FloatArray, span_s: tuple[float, float]) -> list[tuple[float, bool]]:
    """Return the times of handles in order, and whether a key is there.

    There is one at each key (K,) within the span from when to when the actor is present, and at whole seconds, in a
    long span at each second, fifth or tenth one, so that there are at most about `MOST`.
    """
    start, end = span_s
    keyed = sorted({round(float(time), 4) for time in key_times_s if start <= time <= end})[:MOST]
    step = next((s for s in STEPS_S if (end - start) / s + len(keyed) <= MOST), STEPS_S[-1])
    whole = np.arange(np.ceil(start / step - 1e-6), np.floor(end / step + 1e-6) + 1) * step
    free = [float(time) for time in whole if all(abs(time - key) > NEAR * step for key in keyed)]
    return sorted([(time, True) for time in keyed] + [(time, False) for time in free])
