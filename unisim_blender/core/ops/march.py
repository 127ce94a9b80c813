"""Where along a ray samples are placed.

First the occupied voxels along the ray give a distribution, and a few samples of it the signed distance; where the distance
says that the surface is, the rest follow. Both sets are drawn in the distribution's own quantiles, so free space between
occupied voxels never takes a sample.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from .. import native
from .constants import DECAY_PER_M, QUANTILE_FLOOR
from .devices import kernel_threads
from .kernel_choice import kernels_for


@dataclass(frozen=True)
class Voxels:
    """A grid of values 0..255 (X, Y, Z) uint8 from ``lower`` (3,) on, in cells of ``voxel_m``; 0 is free space."""

    values: Tensor
    lower: Tensor
    voxel_m: float


@dataclass(frozen=True)
class Segment:
    """Rays through the voxels: origins, directions (N, 3) in the voxels' frame, t_near, t_far (N,)."""

    origins: Tensor
    directions: Tensor
    t_near: Tensor
    t_far: Tensor


def stratified(rays: int, count: int, jitter: bool, like: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Quantiles (rays, count), one in each of ``count`` equal parts of [0, 1]: its middle, or anywhere in it."""
    offset = (
        torch.rand(rays, count, generator=generator, device=like.device)
        if jitter
        else torch.full((rays, count), 0.5, device=like.device)
    )
    return ((torch.arange(count, device=like.device) + offset) / count).to(like.dtype)


def propose_reference(voxels: Voxels, segment: Segment, u: Tensor) -> tuple[Tensor, Tensor]:
    """Places t (N, K) at quantiles u (N, K), rising along each row, of the occupied voxels' distribution; its mass (N,).

    A ray is cut into steps of half a voxel; a step's mass is its voxel's value p times exp(-DECAY_PER_M * metres of p before).
    A mass of 0 says that the ray meets nothing.
    """
    step = voxels.voxel_m / 2
    span = segment.t_far - segment.t_near
    steps = int(torch.ceil(span / step).max().clamp_min(1)) if len(span) else 1
    i = torch.arange(steps, device=span.device)
    t = segment.t_near[:, None] + (i + 0.5) * step
    points = segment.origins[:, None] + t[..., None] * segment.directions[:, None]
    cell = torch.floor((points - voxels.lower) * (1.0 / voxels.voxel_m)).long()
    shape = torch.tensor(voxels.values.shape, device=span.device)
    inside = ((cell >= 0) & (cell < shape)).all(-1) & (i < torch.ceil(span / step)[:, None])
    cell = torch.minimum(cell.clamp_min(0), shape - 1)
    p = voxels.values[cell[..., 0], cell[..., 1], cell[..., 2]].to(t.dtype) * inside / 255
    mass = p * torch.exp(-DECAY_PER_M * step * (p.cumsum(-1) - p))
    cdf = mass.cumsum(-1)
    total = cdf[:, -1]
    target = u * total[:, None]
    j = torch.searchsorted(cdf, target.contiguous(), right=True).clamp_max(steps - 1)
    # quantiles that rounding sends past the last occupied step stand in it
    last = steps - 1 - (mass > 0).flip(-1).to(torch.uint8).argmax(-1)
    j = torch.minimum(j, last[:, None])
    here = cdf.gather(1, j)
    weight = mass.gather(1, j)
    fraction = ((target - (here - weight)) / weight.clamp_min(1e-30)).clamp(0, 1)
    placed = segment.t_near[:, None] + (j + fraction) * step
    evenly = segment.t_near[:, None] + u * span[:, None]
    return torch.where(total[:, None] > 0, placed, evenly), total


def propose(voxels: Voxels, segment: Segment, u: Tensor) -> tuple[Tensor, Tensor]:
    """`propose_reference`, by the compiled kernels or Triton's where they apply."""
    kernels = kernels_for(u)
    if kernels is None:
        return propose_reference(voxels, segment, u)
    n, count = u.shape
    o, d = segment.origins.contiguous(), segment.directions.contiguous()
    t_near, t_far = segment.t_near.contiguous(), segment.t_far.contiguous()
    values, u = voxels.values.contiguous(), u.contiguous()
    if kernels == "triton":
        from .triton.propose import propose as propose_on_gpu

        return propose_on_gpu(values, voxels.lower.float(), voxels.voxel_m, DECAY_PER_M, o, d, t_near, t_far, u)
    lib = native.library()
    assert lib is not None
    shape = np.array(voxels.values.shape, np.int32)
    lower = voxels.lower.numpy().astype(np.float32)
    voxel = np.float32(voxels.voxel_m).reshape(1)
    t, mass = torch.empty(n, count), torch.empty(n)
    lib.unisim_propose(
        o.data_ptr(), d.data_ptr(), t_near.data_ptr(), t_far.data_ptr(), n, values.data_ptr(), shape.ctypes.data,
        lower.ctypes.data, voxel.ctypes.data, voxels.voxel_m / 2, DECAY_PER_M, u.data_ptr(), count, t.data_ptr(),
        mass.data_ptr(), kernel_threads(),
    )  # fmt: skip
    return t, mass


def refine_quantiles(u: Tensor, t: Tensor, s: Tensor, beta: float, count: int, jitter: Tensor) -> Tensor:
    """Quantiles (N, count) near the surface that signed distances s (N, K) at places t (N, K), quantiles u (N, K), point to.

    The weights are the logistic density's with a beta that an interval's length bounds: a sample that passes near a thin thing
    draws others to it. `QUANTILE_FLOOR` of them are spread evenly over the quantiles. ``jitter`` (N, count) rises in [0, 1].
    """
    gap = (t[:, 1:] - t[:, :-1]).clamp_min(1e-4)
    sharp = (4.0 / gap).clamp_max(beta)
    rise = F.softplus(-sharp * s[:, 1:]) - F.softplus(-sharp * s[:, :-1])
    tau = rise.clamp_min(0)
    before = F.softplus(-beta * s[:, :1])
    total = tau.cumsum(-1)
    weight = torch.exp(-(total - tau) - before) * -torch.expm1(-tau)
    # the ends of [0, 1] belong to the first and last interval
    first = -torch.expm1(-before)
    weight = torch.cat([first, weight, torch.zeros_like(first)], -1)
    return _drawn(torch.cat([torch.zeros_like(u[:, :1]), u, torch.ones_like(u[:, :1])], -1), weight, jitter)


def refine_by_density(u: Tensor, tau: Tensor, jitter: Tensor) -> Tensor:
    """`refine_quantiles` for densities: tau (N, K) are the optical depths of the parts of [0, 1] about each of the quantiles
    u (N, K), as NeRF's second pass has it (Mildenhall et al., 2020, section 5.2)."""
    middle = (u[:, 1:] + u[:, :-1]) / 2
    edges = torch.cat([torch.zeros_like(u[:, :1]), middle, torch.ones_like(u[:, :1])], -1)
    total = tau.cumsum(-1)
    return _drawn(edges, torch.exp(-(total - tau)) * -torch.expm1(-tau), jitter)


def _drawn(edges: Tensor, weight: Tensor, jitter: Tensor) -> Tensor:
    """Where between edges (N, M + 1) a distribution of weights (N, M), with its floor, reaches jitter (N, count)."""
    weight, widths = weight + 1e-5, torch.diff(edges, dim=-1)
    pdf = (1 - QUANTILE_FLOOR) * weight / weight.sum(-1, keepdim=True) + QUANTILE_FLOOR * widths
    cdf = F.pad(pdf.cumsum(-1), (1, 0))
    cdf = cdf / cdf[:, -1:]
    j = torch.searchsorted(cdf, jitter.contiguous(), right=True).clamp(1, cdf.shape[1] - 1)
    c0, c1 = cdf.gather(1, j - 1), cdf.gather(1, j)
    e0, e1 = edges.gather(1, j - 1), edges.gather(1, j)
    return e0 + (jitter - c0) / (c1 - c0).clamp_min(1e-12) * (e1 - e0)
