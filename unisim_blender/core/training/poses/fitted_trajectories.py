"""Actors' recorded trajectories without the noise of their labels, estimated from the labels alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...geometry import FloatArray, Trajectory, matrix_from_quaternion, quaternion_from_yaw
from ...scenario.motion.trajectories import quaternion_product
from ...world.drive import Actor, Drive

FEWEST_KEYS = 8
"""With fewer keys, noise and trajectory cannot be told apart."""
MOST_KEYS, OVERLAP_KEYS = 384, 96
"""A trajectory with more keys is smoothed in pieces of so many, which overlap and fade into each other: the cost of a piece grows
as the cube of its keys, and keys so far apart tell nothing of each other."""
_LAMBDA_S3 = 10.0 ** np.linspace(-9, 7, 161)
"""Strengths of smoothing that are tried: the noise's variance, m^2, by the acceleration's spectral
density, m^2 / s^3."""


def fitted(drive: Drive) -> Drive:
    """The drive with the trajectories of its moving actors fitted as by `fitted_trajectory`."""
    actors = {uid: _fitted(actor) for uid, actor in drive.actors.items()}
    return replace(drive, actors=actors)


def _fitted(actor: Actor) -> Actor:
    if not actor.is_moving or len(actor.world_from_actor.times_s) < FEWEST_KEYS:
        return actor
    return replace(actor, world_from_actor=fitted_trajectory(actor.world_from_actor))


def fitted_trajectory(trajectory: Trajectory) -> Trajectory:
    """A trajectory of T >= 3 keys with its x and y smoothed together, and its heading about the world's z; times, heights,
    pitch and roll stay. A trajectory without noise stays where it is."""
    forward = matrix_from_quaternion(trajectory.quaternions_wxyz)[:, :, 0]
    yaw = np.unwrap(np.arctan2(forward[:, 1], forward[:, 0]))
    shift, turned = np.zeros((len(yaw), 2)), np.zeros(len(yaw))
    for piece, share in _pieces(len(yaw)):
        times = trajectory.times_s[piece]
        # the one costly thing serves both
        basis = np.linalg.eigh(_roughness(times))
        shift[piece] += share[:, None] * smoothing(times, trajectory.positions[piece, :2], basis)
        turned[piece] += share * smoothing(times, yaw[piece, None], basis)[:, 0]
    positions = trajectory.positions.copy()
    positions[:, :2] += shift
    turn = quaternion_from_yaw(turned)
    return Trajectory(trajectory.times_s, positions, quaternion_product(turn, trajectory.quaternions_wxyz))


def _pieces(keys: int) -> list[tuple[slice, FloatArray]]:
    """The pieces that so many keys are smoothed in, and how much each counts at each of its keys: 1 in all."""
    if keys <= MOST_KEYS:
        return [(slice(0, keys), np.ones(keys))]
    begins = np.append(np.arange(0, keys - MOST_KEYS, MOST_KEYS - OVERLAP_KEYS), keys - MOST_KEYS)
    heights = np.zeros((len(begins), keys))
    fade = np.minimum(np.arange(1, MOST_KEYS + 1), np.arange(MOST_KEYS, 0, -1)).clip(max=OVERLAP_KEYS // 2)
    for height, begin in zip(heights, begins, strict=True):
        height[begin : begin + MOST_KEYS] = fade
    heights /= heights.sum(0)
    return [
        (slice(begin, begin + MOST_KEYS), height[begin : begin + MOST_KEYS])
        for begin, height in zip(begins.tolist(), heights, strict=True)
    ]


def smoothing(
    times_s: FloatArray, values: FloatArray, basis_of_times: tuple[FloatArray, FloatArray] | None = None
) -> FloatArray:
    """What to add to values (T, C) at increasing times (T,), T >= 3, to take off the noise that each key has
    by itself: (T, C). ``basis_of_times``: the eigenvalues and vectors of the times' roughness, where they are known.

    The means of a trajectory whose velocity is a Wiener process, seen with white noise: a cubic smoothing spline (Green
    and Silverman, "Nonparametric regression and generalized linear models", 1994, section 2.3.3). How strongly it
    smooths, one strength for all columns, is what makes the values likeliest, their straight line and scale apart
    (Wahba, "A comparison of GCV and GML for choosing the smoothing parameter", Annals of Statistics 13, 1985). Curves,
    brakes and swerves that neighbouring keys agree about stay where they are.
    """
    line = np.stack([np.ones_like(times_s), times_s - times_s.mean()], -1)
    values = values - line @ np.linalg.lstsq(line, values, rcond=None)[0]
    penalty, basis = basis_of_times or np.linalg.eigh(_roughness(times_s))
    # the first two are straight lines
    penalty, basis = penalty[2:], basis[:, 2:]
    parts = basis.T @ values
    removed = _LAMBDA_S3[:, None] * penalty / (1 + _LAMBDA_S3[:, None] * penalty)
    variance = (removed @ parts**2).mean(1) / len(penalty)
    # straight to the last digit: there is nothing to take off
    if variance.max() < 1e-18:
        return np.zeros_like(values)
    surprise = np.log(variance) - np.log(removed).mean(1)
    return np.asarray(-basis @ (removed[surprise.argmin()][:, None] * parts))


def _roughness(times_s: FloatArray) -> FloatArray:
    """(T, T): the integral of the squared second derivative of the natural cubic spline through values y is y' K y
    (Green and Silverman, section 2.1.2)."""
    step = np.diff(times_s)
    inner = np.arange(len(step) - 1)
    second = np.zeros((len(times_s), len(inner)))
    second[inner, inner], second[inner + 2, inner] = 1 / step[:-1], 1 / step[1:]
    second[inner + 1, inner] = -1 / step[:-1] - 1 / step[1:]
    gram = np.diag((step[:-1] + step[1:]) / 3) + np.diag(step[1:-1] / 6, 1) + np.diag(step[1:-1] / 6, -1)
    return np.asarray(second @ np.linalg.solve(gram, second.T))
