"""The polynomials of least jerk between states (Takahashi et al., 1989; Werling et al., ICRA 2010). Coefficients (..., 6) are
of rising powers; a state is a value and its first two derivatives."""

from __future__ import annotations

import numpy as np

from unisim_blender.core.geometry import FloatArray

State = tuple[float, float, float]


def quintic(start: State, end: FloatArray, length: FloatArray) -> FloatArray:
    """Return the quintics (..., 6) from a state at 0 to states ``end`` (..., 3) at ``length`` (...)."""
    a, b, c = start
    t = np.asarray(length, np.float64)
    value, rate, second = np.moveaxis(np.asarray(end, np.float64), -1, 0)
    p = value - (a + b * t + c / 2 * t**2)
    v = rate - (b + c * t)
    w = second - c
    return np.stack(
        [
            np.full_like(p, a),
            np.full_like(p, b),
            np.full_like(p, c / 2),
            (10 * p - 4 * v * t + w * t**2 / 2) / t**3,
            (-15 * p + 7 * v * t - w * t**2) / t**4,
            (6 * p - 3 * v * t + w * t**2 / 2) / t**5,
        ],
        -1,
    )


def quartic(start: State, end_rate: FloatArray, length: FloatArray) -> FloatArray:
    """Return the quartics (..., 6), the last coefficient 0, from a state at 0 to rates ``end_rate`` (...) that do not change at
    ``length`` (...), wherever that is."""
    a, b, c = start
    t = np.asarray(length, np.float64)
    v = np.asarray(end_rate, np.float64) - (b + c * t)
    w = np.zeros_like(v) - c
    return np.stack(
        [
            np.full_like(v, a),
            np.full_like(v, b),
            np.full_like(v, c / 2),
            (3 * v - w * t) / (3 * t**2),
            (w * t - 2 * v) / (4 * t**3),
            np.zeros_like(v),
        ],
        -1,
    )


def values(coefficients: FloatArray, at: FloatArray, derivative: int = 0) -> FloatArray:
    """Return the values (..., T) of polynomials (..., 6), or of their derivatives, at ``at`` (..., T)."""
    c = coefficients
    for _ in range(derivative):
        c = c[..., 1:] * np.arange(1, c.shape[-1])
    out = np.zeros(np.broadcast_shapes(c.shape[:-1] + (1,), np.shape(at)))
    for power in range(c.shape[-1] - 1, -1, -1):
        out = out * at + c[..., power : power + 1]
    return out
