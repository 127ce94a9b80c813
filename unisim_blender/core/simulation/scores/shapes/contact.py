"""When a moving box first meets others, between the steps of a rollout too."""

from __future__ import annotations

import numpy as np

from ....geometry import BoolArray, FloatArray
from .boxes import between, directions, meeting_times, overlap, radii, shorter_arc

SUBSTEPS = 10
"""Parts of a step with a heading each. NeuroNCAP checks as many moments between two steps."""


def first_contacts(times_s: FloatArray, ego: FloatArray, others: FloatArray, present: BoolArray) -> FloatArray:
    """When each other box first overlaps the ego's, seconds; inf where it never does: (A,).

    times_s (T,) increasing, ego (T, 5), others (T, A, 5), present (T, A). At the steps boxes are as they are. Between
    two steps positions are linear, and headings are constant over each tenth: nothing is jumped over, and the times
    are exact where nothing turns. Where something turns at w rad/s in steps of d seconds, a corner at r metres from
    the centre is off by w d r / 20 at most: 1 cm for a car at 1 rad/s in steps of 0.1 s.
    """
    out = np.full(others.shape[1], np.inf)
    reach = radii(ego)[:, None] + radii(others)
    apart = np.hypot(*np.moveaxis(others[..., :2] - ego[:, None, :2], -1, 0))
    near = present & (apart <= reach + 1e-6)
    steps, actors = np.nonzero(near)
    met = overlap(ego[steps], others[steps, actors])
    np.minimum.at(out, actors[met], times_s[steps[met]])
    if len(times_s) == 1:
        return out

    moved_ego = np.linalg.norm(np.diff(ego[:, :2], axis=0), axis=-1)
    moved = np.linalg.norm(np.diff(others[..., :2], axis=0), axis=-1)
    near = present[:-1] & present[1:] & (apart[:-1] <= reach[:-1] + moved_ego[:, None] + moved + 1e-6)
    near &= times_s[:-1, None] < out  # what has met already need not be looked at again
    steps, actors = np.nonzero(near)
    duration = times_s[steps + 1] - times_s[steps]
    begins = (ego[steps], others[steps, actors])
    ends = (ego[steps + 1], others[steps + 1, actors])
    velocity = ((ends[1] - begins[1])[:, :2] - (ends[0] - begins[0])[:, :2]) / duration[:, None]
    for part in range(SUBSTEPS):
        now = [between(begin, end, part / SUBSTEPS) for begin, end in zip(begins, ends, strict=True)]
        for box, begin, end in zip(now, begins, ends, strict=True):
            box[:, 4] = begin[:, 4] + (part + 0.5) / SUBSTEPS * shorter_arc(end[:, 4] - begin[:, 4])
        begin_s, end_s = meeting_times(now[0], now[1], velocity)
        met = (begin_s <= duration / SUBSTEPS) & (end_s >= 0)
        at_s = times_s[steps] + part / SUBSTEPS * duration + np.maximum(begin_s, 0.0)
        np.minimum.at(out, actors[met], at_s[met])
    return out


def velocities(headings_rad: FloatArray, speeds_m_s: FloatArray) -> FloatArray:
    """Velocities (..., 2) of what moves along its heading."""
    return directions(headings_rad) * speeds_m_s[..., None]
