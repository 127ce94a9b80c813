"""Poses that training corrects.

Actors' recorded trajectories without the noise of their labels, estimated from the labels alone (`fitted`); a small
correction of each camera's pose, learned with the scene (`CameraPoses`), for calibrations are off by a pixel or so, and
recorded poses waver by as much from frame to frame, as the vehicle pitches; and noise on the boxes of a drive, to
measure how much of it training takes back (`disturbed`).
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor, nn

from ..data.log import Log
from ..geometry import (
    FloatArray,
    Trajectory,
    matrix_from_quaternion,
    quaternion_from_matrix,
    quaternion_from_yaw,
    quaternion_product,
)
from ..ops.ray_segments import RayBatch
from ..world.drive import Actor, Camera, Drive


def disturbed(drive: Drive, metres: float, degrees: float, seed: int) -> Drive:
    """The drive with Gaussian noise on the boxes of its moving actors, each key's its own: a shift along the world's x
    and y and a turn about its z, with standard deviations of so many metres along each axis, and degrees."""
    rng = np.random.default_rng([seed, 0xB0])
    actors = {uid: _disturbed(drive.actors[uid], metres, degrees, rng) for uid in sorted(drive.actors)}
    return replace(drive, actors={uid: actors[uid] for uid in drive.actors})


def _disturbed(actor: Actor, metres: float, degrees: float, rng: np.random.Generator) -> Actor:
    if not actor.is_moving:
        return actor
    trajectory = actor.world_from_actor
    shift = np.pad(rng.normal(0, metres, (len(trajectory.times_s), 2)), ((0, 0), (0, 1)))
    turn = quaternion_from_yaw(rng.normal(0, np.radians(degrees), len(trajectory.times_s)))
    moved = Trajectory(
        trajectory.times_s, trajectory.positions + shift, quaternion_product(turn, trajectory.quaternions_wxyz)
    )
    return replace(actor, world_from_actor=moved)


def with_drive(log: Log, drive: Drive) -> Log:
    """The log with another drive; images and sweeps are what they were."""
    changed = copy.copy(log)
    changed.drive = drive
    return changed


SMOOTH_S = 0.1
"""Corrections change as slowly as this: what two frames teach holds for the one between."""


class CameraPoses(nn.Module):
    """For each camera, at the times of the images it learns from, a shift in metres and a small turn in
    radians, along its axes.

    ``times_s``: each camera's times (K,), increasing.
    """

    def __init__(self, times_s: Sequence[FloatArray]) -> None:
        super().__init__()
        keys = max(len(t) for t in times_s)
        padded = np.full((len(times_s), keys), np.inf)
        for row, times in zip(padded, times_s, strict=True):
            row[: len(times)] = times
        self.register_buffer("times_s", torch.as_tensor(padded), persistent=False)
        self.shift_m = nn.Parameter(torch.zeros(len(times_s), keys, 3))
        self.turn_rad = nn.Parameter(torch.zeros(len(times_s), keys, 3))

    times_s: Tensor

    def at(self, camera: Tensor, time_s: Tensor) -> tuple[Tensor, Tensor]:
        """Shifts and turns (B, 3) of cameras (B,) at times (B,): means of the keys' by a Gaussian of SMOOTH_S."""
        away = ((self.times_s[camera] - time_s[:, None]) / SMOOTH_S) ** 2 / 2
        share = torch.softmax(-away, -1).to(self.shift_m)[:, None]
        return (share @ self.shift_m[camera])[:, 0], (share @ self.turn_rad[camera])[:, 0]

    def forward(self, rays: RayBatch, camera: Tensor, world_from_camera: Tensor, learn: bool) -> RayBatch:
        """Corrected rays (B * n); camera (B,) and world_from_camera (B, 3, 3) of each patch. ``learn`` lets
        gradients through."""
        n = len(rays) // len(camera)
        rotation = world_from_camera.to(self.shift_m)
        with torch.set_grad_enabled(learn and torch.is_grad_enabled()):
            shift, turn = self.at(camera, rays.time_s[::n])
            shift = torch.einsum("bij,bj->bi", rotation, shift)
            turn = torch.einsum("bij,bj->bi", rotation, turn).repeat_interleave(n, 0)
        directions = rays.directions + torch.linalg.cross(turn, rays.directions)
        directions = directions / directions.norm(dim=-1, keepdim=True)
        return RayBatch(rays.origins + shift.repeat_interleave(n, 0), directions, rays.time_s)

    def corrected(self, camera: Camera, number: int) -> Camera:
        """The camera with its corrected trajectory: every pose is moved in its own axes."""
        from scipy.spatial.transform import Rotation  # a tenth of what a training imports, and needed at its end

        trajectory = camera.world_from_camera
        with torch.no_grad():
            times = torch.as_tensor(trajectory.times_s, device=self.times_s.device)
            at = self.at(torch.full_like(times, number, dtype=torch.long), times)
        shift, turn = (value.cpu().double().numpy() for value in at)
        rotation = matrix_from_quaternion(trajectory.quaternions_wxyz)
        positions = trajectory.positions + np.einsum("kij,kj->ki", rotation, shift)
        quaternions = quaternion_from_matrix(rotation @ Rotation.from_rotvec(turn).as_matrix())
        return dataclasses.replace(camera, world_from_camera=Trajectory(trajectory.times_s, positions, quaternions))


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
    """Return the corrections (T, C) to add to values (T, C) at increasing times (T,), T >= 3, to remove the noise that
    each key has by itself. ``basis_of_times``: the eigenvalues and vectors of the times' roughness, where they are
    known.

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
