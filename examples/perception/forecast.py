"""Forecasts of tracks: on at constant velocity, and along the route at constant speed and distance from it."""

from __future__ import annotations

import math

import numpy as np

from unisim_blender.core.geometry import FloatArray

from .objects import Mode, Track
from .route import Route
from .tracker import half_turn

STANDING_M_S, CERTAIN = 0.7, 2.0
"""A vehicle that is slower, or whose velocity is less than so many of its standard deviations, stands."""
ASIDE_M, TURN_RAD = 6.0, math.radians(30.0)
"""A vehicle within this distance of the route and this angle of its direction, or the opposite one, goes along it."""
ALONG = 0.7
"""Probability that it does."""
STRAIGHT_S = 2.0
"""Beside a forecast along the route, constant velocity is planned by for so long: bends come."""


def forecast(track: Track, route: Route, after_s: FloatArray) -> tuple[Mode, ...]:
    """Return the forecasts of a track at times (T,) after its own, the most probable first."""
    boxes = np.tile(track.box, (len(after_s), 1))
    if track.speed_m_s < max(STANDING_M_S, CERTAIN * track.speed_deviation_m_s):
        return (Mode(boxes, 1.0, len(after_s)),)
    straight = boxes.copy()
    straight[:, :2] += after_s[:, None] * track.state[2:]
    s, d = route.project(*track.state[:2].tolist())
    _, _, heading, curvature = (float(one) for one in route.at(np.array(s)))
    turned = math.remainder(math.atan2(track.state[3], track.state[2]) - heading, math.tau)
    if abs(d) > ASIDE_M or abs(half_turn(turned)) > TURN_RAD:
        return (Mode(straight, 1.0, len(after_s)),)
    rate = track.speed_m_s * math.cos(turned) / max(1.0 - curvature * d, 0.2)
    places = s + rate * after_s
    boxes[:, 0], boxes[:, 1] = route.place(places, np.full(len(places), d))
    boxes[:, 4] += route.at(places)[2] - heading
    return (
        Mode(boxes, ALONG, len(after_s)),
        Mode(straight, 1.0 - ALONG, int((after_s <= STRAIGHT_S).sum())),
    )
