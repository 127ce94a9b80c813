"""Actors' poses as tensors, and rays' intersections with their boxes at each ray's own time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from ..geometry import FloatArray, matrix_from_quaternion
from ..ops.devices import zeros_on_demand
from ..ops.near_spheres import near_spheres
from ..ops.padding import Padding
from ..sensors.bounds import BIN_S, Bounds
from ..world.drive import Actor
from ..world.replay import PaddedKeys

SMOOTH_S = 0.2
"""Time scale, seconds, over which corrections of poses change: those of some frames hold for the frames between."""
NEAR_BOXES = 4
"""Number of boxes that padded rays are near, for one that they hit."""
DENSE_KEYS, REACH_S = 256, 8 * SMOOTH_S
"""Number of keys of an actor up to which all are averaged with all, and else the distance in time of those that are."""


def rotation_from_6d(r: Tensor) -> Tensor:
    """Return rotation matrices (..., 3, 3) of 6D rotations (..., 6): Gram-Schmidt of two columns (Zhou et al.,
    2019)."""
    a, b = r[..., :3], r[..., 3:]
    x = a / a.norm(dim=-1, keepdim=True).clamp_min(1e-8)
    b = b - (x * b).sum(-1, keepdim=True) * x
    y = b / b.norm(dim=-1, keepdim=True).clamp_min(1e-8)
    return torch.stack([x, y, torch.linalg.cross(x, y)], -1)


def quaternion_from_rotation(r: Tensor) -> Tensor:
    """Return unit quaternions wxyz (..., 4) of rotations (..., 3, 3), without a division by a small number;
    differentiable."""
    m = [[r[..., i, j] for j in range(3)] for i in range(3)]
    xx, yy, zz = m[0][0], m[1][1], m[2][2]
    wx, wy, wz = m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1]
    xy, xz, yz = m[1][0] + m[0][1], m[0][2] + m[2][0], m[2][1] + m[1][2]
    squares = torch.stack([1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz], -1)
    rows = torch.stack(
        [
            torch.stack([squares[..., 0], wx, wy, wz], -1),
            torch.stack([wx, squares[..., 1], xy, xz], -1),
            torch.stack([wy, xy, squares[..., 2], yz], -1),
            torch.stack([wz, xz, yz, squares[..., 3]], -1),
        ],
        -2,
    )
    largest = squares.argmax(-1)
    q = torch.take_along_dim(rows, largest[..., None, None], -2)[..., 0, :]
    return q / q.norm(dim=-1, keepdim=True)


def rotation_from_quaternion(q: Tensor) -> Tensor:
    """Return rotation matrices (..., 3, 3) of unit quaternions wxyz (..., 4)."""
    w, x, y, z = q.unbind(-1)
    return torch.stack(
        [
            torch.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)], -1),
            torch.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)], -1),
            torch.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)], -1),
        ],
        -2,
    )


def slerp(a: Tensor, b: Tensor, u: Tensor) -> Tensor:
    """Spherical interpolation of quaternions (N, 4) at u (N,), along the shorter arc; between equal ones ``a``,
    whatever u."""
    same = (a == b).all(-1, keepdim=True)
    dot = (a * b).sum(-1, keepdim=True)
    b = torch.where(dot < 0, -b, b)
    # the angle from the chord: acos loses half its digits near 1
    angle = 2 * torch.asin(((a - b).norm(dim=-1, keepdim=True) / 2).clamp_max(0.7071067811865476))
    sine = torch.sin(angle)
    near = sine < 1e-4
    safe = torch.where(near, torch.ones_like(sine), sine)
    wa = torch.where(near, 1 - u[:, None], torch.sin((1 - u[:, None]) * angle) / safe)
    wb = torch.where(near, u[:, None], torch.sin(u[:, None] * angle) / safe)
    q = torch.where(same, a, wa * a + wb * b)
    return q / q.norm(dim=-1, keepdim=True)


def interpolated(
    times_s: Tensor, lengths: Tensor, keys: tuple[Tensor, Tensor], row: Tensor, time_s: Tensor
) -> tuple[Tensor, Tensor]:
    """Return positions (P, 3) and rotations (P, 3, 3) of trajectories ``row`` (P,) at times (P,) float64, seconds.

    The trajectories have keys at ``times_s`` (A, K), ``lengths`` (A,) of them each: positions (A, K, 3) and quaternions
    (A, K, 4).
    """
    positions, quaternions = keys
    times = times_s[row]
    upper = torch.searchsorted(times, time_s[:, None].contiguous(), right=True)[:, 0]
    upper = torch.minimum(upper, lengths[row] - 1).clamp_min(1)
    single = lengths[row] == 1
    upper = torch.where(single, torch.zeros_like(upper), upper)
    lower = (upper - 1).clamp_min(0)
    t0 = times.gather(1, lower[:, None])[:, 0]
    t1 = times.gather(1, upper[:, None])[:, 0]
    u = torch.where(single, torch.zeros_like(t0), (time_s - t0) / torch.where(single, torch.ones_like(t0), t1 - t0)).to(
        positions.dtype
    )
    p0, p1 = positions[row, lower], positions[row, upper]
    q = slerp(quaternions[row, lower], quaternions[row, upper], u)
    return p0 + u[:, None] * (p1 - p0), rotation_from_quaternion(q)


class Smoothing(nn.Module):
    """Means of keys' neighbours in time, by a Gaussian of `SMOOTH_S`; ``times_s`` (A, K), seconds, inf for padding.

    Of few keys each actor has a matrix. Of a long drive's, whose matrices would fill memory, only neighbours within
    `REACH_S` are kept, beyond which a weight is 1e-14.
    """

    def __init__(self, times_s: Tensor) -> None:
        super().__init__()
        self.dense = times_s.shape[1] <= DENSE_KEYS
        if self.dense:
            self.register_buffer("matrix", _smoothing(times_s), persistent=False)
            return
        real = torch.isfinite(times_s)
        row = real.nonzero()[:, 0]
        times, first = times_s[real], torch.cumsum(real.sum(1), 0) - real.sum(1)
        # one axis of time for all actors, on which each has a span of its own
        span = float(times.max() - times.min()) + 3 * REACH_S if len(times) else 1.0
        along = times - times.min() + row * span if len(times) else times
        low = torch.searchsorted(along, along - REACH_S)
        high = torch.searchsorted(along, along + REACH_S, right=True)
        near = low[:, None] + torch.arange(int((high - low).max()) if len(times) else 0)
        inside = near < high[:, None]
        near = torch.where(inside, near, low[:, None])
        weight = torch.exp(-(((times[near] - times[:, None]) / SMOOTH_S) ** 2) / 2) * inside
        place = row * times_s.shape[1] + torch.arange(len(row)) - first[row]
        self.register_buffer("place", place, persistent=False)
        self.register_buffer("near", place[near], persistent=False)
        self.register_buffer("weight", (weight / weight.sum(-1, keepdim=True)).float(), persistent=False)

    matrix: Tensor
    place: Tensor
    near: Tensor
    weight: Tensor

    def forward(self, values: Tensor) -> Tensor:
        """Return the means (A, K, C) of values (A, K, C) of keys."""
        if self.dense:
            return self.matrix @ values
        flat = values.flatten(0, 1)
        means = (self.weight[:, :, None] * flat[self.near]).sum(1)
        return torch.zeros_like(flat).index_copy(0, self.place, means).view(values.shape)


def _smoothing(times_s: Tensor) -> Tensor:
    """Return the weights (A, K, K) of keys' neighbours in time (A, K), by a Gaussian of `SMOOTH_S`; padding has no
    weight."""
    real = torch.isfinite(times_s)
    t = torch.where(real, times_s, torch.zeros_like(times_s))
    w = torch.exp(-(((t[:, :, None] - t[:, None]) / SMOOTH_S) ** 2) / 2) * real[:, None]
    return (w / w.sum(-1, keepdim=True).clamp_min(1e-12)).float()


@dataclass(frozen=True)
class BoxHits:
    """Pairs of a ray and a box that it hits: ray, actor (P,); t_near, t_far (P,) metres along the ray in the world.

    origins, directions (P, 3) are along the box's axes in the metres of the actor's own field: the box's scale is
    divided out, so that directions of a scaled actor's hits are not unit. ``stretch`` (P,) is their length, field
    metres for each metre along the ray; None where no actor is scaled. ``world_from_box`` (P, 3, 3) takes gradients
    there to the world: the box's rotation, after the inverse of its scale.
    """

    ray: Tensor
    actor: Tensor
    t_near: Tensor
    t_far: Tensor
    origins: Tensor
    directions: Tensor
    world_from_box: Tensor
    stretch: Tensor | None = None
    there: Tensor | None = None
    """Which pairs (P,) hit, where their number is fixed; the others' ``t_far`` is below ``t_near``."""


class Tracklets(nn.Module):
    """The keys of many actors, padded to one length, with a learnable correction to each key where ``refine`` is set.

    Positions, and the rays that are to hit them, are measured from ``corner`` (3,), along the world's axes.
    """

    def __init__(self, actors: Sequence[Actor], refine: bool = False, corner: FloatArray | None = None) -> None:
        super().__init__()
        self.corner = np.zeros(3) if corner is None else corner
        n, keys = len(actors), PaddedKeys.of(actors)
        self.count = n
        self.register_buffer("times", torch.as_tensor(keys.times_s), persistent=False)
        self.register_buffer("lengths", torch.as_tensor(keys.lengths).long(), persistent=False)
        self.register_buffer("positions", torch.as_tensor(keys.positions - self.corner).float(), persistent=False)
        self.register_buffer("quaternions", torch.as_tensor(keys.quaternions_wxyz).float(), persistent=False)
        self.register_buffer(
            "sizes_m",
            torch.as_tensor(np.array([a.appearance_size_m for a in actors]).reshape(-1, 3)).float(),
            persistent=False,
        )
        self.scaled = any(a.is_scaled for a in actors)
        self.register_buffer(
            "scales", torch.as_tensor(np.array([a.scale for a in actors]).reshape(-1, 3)).float(), persistent=False
        )
        self.register_buffer(
            "start_s", torch.tensor([a.start_s for a in actors], dtype=torch.float64), persistent=False
        )
        self.register_buffer("end_s", torch.tensor([a.end_s for a in actors], dtype=torch.float64), persistent=False)
        bounds = Bounds(actors, keys)
        self.first_bin_s = bounds.first_s
        self.register_buffer("bound_centres", torch.as_tensor(bounds.centres - self.corner).float(), persistent=False)
        self.register_buffer("bound_radii", torch.as_tensor(bounds.radii).float(), persistent=False)
        self.refine = refine
        if refine:
            length = keys.times_s.shape[1]
            # of a long drive's keys most only pad, and are not turned
            real = np.arange(length) < keys.lengths[:, None]
            rotations = matrix_from_quaternion(keys.quaternions_wxyz[real])
            rot6 = torch.tensor([1.0, 0, 0, 0, 1, 0]).repeat(n, length, 1)
            rot6[torch.as_tensor(real)] = torch.as_tensor(rotations[:, :, :2].swapaxes(1, 2).reshape(-1, 6)).float()
            self.register_buffer("rotation_6d", rot6, persistent=False)
            self.shift_m = nn.Parameter(zeros_on_demand((n, length, 3)))
            self.turn_6d = nn.Parameter(zeros_on_demand((n, length, 6)))
            still = torch.tensor([not a.is_moving for a in actors], dtype=torch.bool)
            self.register_buffer("still", still, persistent=False)
            self.smoothing = Smoothing(torch.as_tensor(keys.times_s))

    times: Tensor
    lengths: Tensor
    positions: Tensor
    quaternions: Tensor
    sizes_m: Tensor
    """Edges (A, 3) of the boxes in the metres of the actors' fields: without their scales."""
    scales: Tensor
    start_s: Tensor
    end_s: Tensor
    rotation_6d: Tensor
    still: Tensor
    bound_centres: Tensor
    bound_radii: Tensor

    def keys(self) -> tuple[Tensor, Tensor]:
        """Return positions (A, K, 3), from the corner, and quaternions (A, K, 4), corrected where they are refined; an
        actor that stands still has one correction."""
        if not self.refine:
            return self.positions, self.quaternions
        still = self.still[:, None, None]
        shift = torch.where(still, self.shift_m.mean(1, keepdim=True), self.smoothing(self.shift_m))
        turn = torch.where(still, self.turn_6d.mean(1, keepdim=True), self.smoothing(self.turn_6d))
        turned = self.rotation_6d + turn
        if self.smoothing.dense:
            return self.positions + shift, quaternion_from_rotation(rotation_from_6d(turned))
        # of a long drive's keys most only pad
        real = quaternion_from_rotation(rotation_from_6d(turned.flatten(0, 1)[self.smoothing.place]))
        quaternions = self.quaternions.flatten(0, 1).index_copy(0, self.smoothing.place, real)
        return self.positions + shift, quaternions.view(self.quaternions.shape)

    def poses_at(self, actor: Tensor, time_s: Tensor, keys: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
        """Return positions (P, 3), from the corner, and rotations (P, 3, 3), world from actor, of ``actor`` (P,) at
        times (P,) float64, seconds."""
        return interpolated(self.times, self.lengths, keys, actor, time_s)

    def hits(
        self,
        origins: Tensor,
        directions: Tensor,
        time_s: Tensor,
        near_m: float,
        among: Tensor | None = None,
        keys: tuple[Tensor, Tensor] | None = None,
        padding: Padding | None = None,
    ) -> BoxHits:
        """Return the hits of rays (N, 3), from the corner along the world's axes, at times (N,), on boxes beyond
        ``near_m``. ``among`` (A',) are the numbers of the actors to test, ``keys`` an earlier result of `keys`,
        ``padding`` fixes the number of pairs."""
        bins = ((time_s - self.first_bin_s) / BIN_S).floor().long()
        bins = torch.where(bins < len(self.bound_radii), bins.clamp_min(-1), -1)
        centres, radii = self.bound_centres, self.bound_radii
        if among is not None:
            centres, radii = centres[:, among], radii[:, among]
        near = near_spheres(origins, directions, bins, centres, radii)
        there: Tensor | None = None
        if padding is not None:
            near &= (time_s[:, None] >= self.start_s) & (time_s[:, None] <= self.end_s)
            place, there = padding.rows(near.flatten(), NEAR_BOXES * len(near))
            ray, actor = place // near.shape[1], place % near.shape[1]
        else:
            ray, actor = torch.nonzero(near, as_tuple=True)
            if among is not None:
                actor = among[actor]
            present = (time_s[ray] >= self.start_s[actor]) & (time_s[ray] <= self.end_s[actor])
            ray, actor = ray[present], actor[present]
        if len(ray) == 0:
            empty = origins.new_zeros(0)
            return BoxHits(
                ray, actor, empty, empty, origins.new_zeros(0, 3), origins.new_zeros(0, 3), origins.new_zeros(0, 3, 3)
            )
        position, rotation = self.poses_at(actor, time_s[ray], keys or self.keys())
        o = torch.einsum("pji,pj->pi", rotation, origins[ray] - position)
        d = torch.einsum("pji,pj->pi", rotation, directions[ray])
        stretch = None
        if self.scaled:
            scale = self.scales[actor]
            o, d, rotation = o / scale, d / scale, rotation / scale[:, None]
            # exactly 1 for actors that are not scaled: their results stay what they are without the scaled ones
            stretch = torch.where((scale == 1).all(-1), torch.ones_like(scale[:, 0]), d.norm(dim=-1))
        with torch.no_grad():
            half = self.sizes_m[actor] / 2
            safe = torch.where(d.abs() < 1e-9, torch.full_like(d, 1e-9), d)
            a, b = (-half - o) / safe, (half - o) / safe
            t_near = torch.minimum(a, b).amax(-1).clamp_min(near_m)
            t_far = torch.maximum(a, b).amin(-1)
            keep = t_far > t_near
        if padding is not None and there is not None:
            keep, there = padding.rows(there & keep, len(near))
            t_far = torch.where(there, t_far[keep], t_near[keep] - 1)
            # no number may leave what floats can hold where it will count nothing
            o, d = torch.where(there[:, None], o[keep], 0.0), torch.where(there[:, None], d[keep], 0.0)
            stretch = None if stretch is None else stretch[keep]
            return BoxHits(ray[keep], actor[keep], t_near[keep], t_far, o, d, rotation[keep], stretch, there)
        stretch = None if stretch is None else stretch[keep]
        return BoxHits(ray[keep], actor[keep], t_near[keep], t_far[keep], o[keep], d[keep], rotation[keep], stretch)
