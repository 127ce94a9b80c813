"""Paths that leave a pose and come to another path: smoothly, in position and heading."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ...geometry import FloatArray, Quaternion, Vector3, quaternion_from_yaw, slerp
from ...world.actor_path import PASSED_M, ActorPath, yaw_of

_SPACING_M = 0.5
_STEEPEST_RAD = 0.6
"""A join starts at this angle to its path at most; what is beyond is turned along the way."""


def joined(
    path: ActorPath, s_m: float, position: Vector3, quaternion_wxyz: Quaternion, length_m: float, left_m: float = 0.0,
    keeps_height: bool = False,
) -> ActorPath:  # fmt: skip
    """Return the path from a pose to ``left_m`` left of ``path``, which it reaches ``length_m`` beyond arc length ``s_m``.

    The distance to the left is a quintic of arc length that starts in the pose's direction and ends along the path, both
    without curvature of its own. ``keeps_height``: the height above the path stays what it is at the start; otherwise it, and
    always what the pose has of roll and pitch, goes over into the path's.
    """
    count = max(int(math.ceil(length_m / _SPACING_M)), 2)
    inner = s_m + np.arange(count + 1) * (length_m / count)
    beyond = path.s_m[path.s_m > inner[-1] + 1e-3]
    at = np.concatenate([inner, beyond])
    positions, quaternions = path.places(at)
    headings, gear = path.headings_at(at), path.gear_at(s_m)

    offset = np.array(position) - positions[0]
    sine, cosine = math.sin(headings[0]), math.cos(headings[0])
    left_0, ahead_0 = cosine * offset[1] - sine * offset[0], cosine * offset[0] + sine * offset[1]
    turn_0 = math.remainder(float(yaw_of(np.array(quaternion_wxyz))) - headings[0], math.tau)
    turn_0 = min(max(turn_0, -_STEEPEST_RAD), _STEEPEST_RAD)

    u = np.clip((at - s_m) / length_m, 0.0, 1.0)
    left, slope = quintic(u, left_0 - left_m, gear * math.tan(turn_0) * length_m)
    fade = quintic(u, 1.0, 0.0)[0]
    sines, cosines = np.sin(headings), np.cos(headings)
    side = (left_m + left)[:, None] * np.stack([-sines, cosines], -1)
    along = (ahead_0 * fade)[:, None] * np.stack([cosines, sines], -1)
    raised = offset[2] if keeps_height else offset[2] * fade
    new = positions + np.concatenate([side + along, np.broadcast_to(raised, len(at))[:, None]], -1)
    turned = product(quaternion_from_yaw(gear * np.arctan(slope / length_m)), quaternions)
    rest = product(np.array(quaternion_wxyz), turned[0] * [1, -1, -1, -1])
    turned = product(
        slerp(np.broadcast_to([1.0, 0, 0, 0], turned.shape), np.broadcast_to(rest, turned.shape), fade), turned
    )
    new[0], turned[0] = position, quaternion_wxyz

    lengths = np.linalg.norm(np.diff(new[:, :2], axis=0), axis=1)
    kept = np.concatenate([[True], lengths > 1e-6])
    s = np.concatenate([[0.0], np.cumsum(lengths)])
    speeds = np.interp(at, path.s_m, path.speeds_m_s)
    stops = tuple(
        replace(stop, s_m=float(np.interp(stop.s_m, at, s))) for stop in path.stops if stop.s_m >= s_m - PASSED_M
    )
    return ActorPath(s[kept], new[kept], turned[kept], speeds[kept], stops, ends=path.ends)


def quintic(u: FloatArray, start: float, slope: float) -> tuple[FloatArray, FloatArray]:
    """Return the quintic Hermite polynomial on [0, 1] and its derivative that start at a value with a slope and without
    curvature, and end at 0 flat and straight."""
    u2, u3 = u * u, u**3
    u4, u5 = u2 * u2, u2 * u3
    value = start * (1 - 10 * u3 + 15 * u4 - 6 * u5) + slope * (u - 6 * u3 + 8 * u4 - 3 * u5)
    derivative = start * (-30 * u2 + 60 * u3 - 30 * u4) + slope * (1 - 18 * u2 + 32 * u3 - 15 * u4)
    return value, derivative


def product(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the products (..., 4) of quaternions (..., 4)."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    product = [
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    ]
    return np.stack(product, -1)
