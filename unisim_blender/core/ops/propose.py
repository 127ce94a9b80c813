"""Places of samples along rays: quantiles of the distribution of the occupied voxels along a ray."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from .. import native
from . import gpu
from .constants import DECAY_PER_M
from .devices import kernel_threads
from .dispatch import Operation, on_cpu_or_gpu


@dataclass(frozen=True)
class Voxels:
    """A grid of values 0..255 (X, Y, Z) uint8 from ``lower`` (3,) on, in cells of ``voxel_m``; 0 is free space."""

    values: Tensor
    lower: Tensor
    voxel_m: float


@dataclass(frozen=True)
class RaySpans:
    """Rays through the voxels, and the part of each in which samples are placed: origins, directions (N, 3) in the
    voxels' frame, from t_near to t_far (N,), metres."""

    origins: Tensor
    directions: Tensor
    t_near: Tensor
    t_far: Tensor
    longest_m: float | None = None
    """No span is longer; where that is not given, torch's operations ask the spans."""


def propose(voxels: Voxels, spans: RaySpans, u: Tensor) -> tuple[Tensor, Tensor]:
    """Return places t (N, K), metres, at quantiles u (N, K), ascending in each row, of the occupied voxels'
    distribution, and its mass (N,), which is 0 where a ray hits nothing.

    A ray is cut into steps of half a voxel; a step's mass is its voxel's value p times exp(-DECAY_PER_M * metres of p
    before).
    """
    shapes = spans.origins.shape, spans.directions.shape, spans.t_near.shape, spans.t_far.shape, u.shape[:1]
    assert shapes == ((len(u), 3), (len(u), 3), (len(u),), (len(u),), (len(u),)), shapes
    return OPERATION(voxels, spans, u)


def propose_reference(voxels: Voxels, spans: RaySpans, u: Tensor) -> tuple[Tensor, Tensor]:
    """`propose` in plain torch, with memory for a number for each half voxel of each ray."""
    step = voxels.voxel_m / 2
    span = spans.t_far - spans.t_near
    if spans.longest_m is not None:
        steps = math.ceil(spans.longest_m / step) + 1
    else:
        steps = int(torch.ceil(span / step).max().clamp_min(1)) if len(span) else 1
    i = torch.arange(steps, device=span.device)
    t = spans.t_near[:, None] + (i + 0.5) * step
    points = spans.origins[:, None] + t[..., None] * spans.directions[:, None]
    cell = torch.floor((points - voxels.lower) * (1.0 / voxels.voxel_m)).long()
    at = [cell[..., axis].clamp(0, size - 1) for axis, size in enumerate(voxels.values.shape)]
    inside = (torch.stack(at, -1) == cell).all(-1) & (i < torch.ceil(span / step)[:, None])
    p = voxels.values[at[0], at[1], at[2]].to(t.dtype) * inside / 255
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
    placed = spans.t_near[:, None] + (j + fraction) * step
    evenly = spans.t_near[:, None] + u * span[:, None]
    return torch.where(total[:, None] > 0, placed, evenly), total


def propose_compiled(voxels: Voxels, spans: RaySpans, u: Tensor) -> tuple[Tensor, Tensor]:
    """`propose` by the compiled kernel."""
    n, count = u.shape
    o, d = spans.origins.contiguous(), spans.directions.contiguous()
    t_near, t_far = spans.t_near.contiguous(), spans.t_far.contiguous()
    values, u = voxels.values.contiguous(), u.contiguous()
    t, mass = u.new_empty(n, count), u.new_empty(n)
    if gpu.serves(u):
        lower_m = voxels.lower.float().contiguous()
        rays = gpu.VoxelRaysStruct(
            *(gpu.pointer(x) for x in (o, d, t_near, t_far, lower_m, values)), (ctypes.c_int32 * 3)(*values.shape),
            1 / voxels.voxel_m, voxels.voxel_m / 2, DECAY_PER_M,
        )  # fmt: skip
        gpu.launch("propose_places", u, n, rays, n, u, ctypes.c_int32(count), t, mass)
        return t, mass
    lib = native.library()
    assert lib is not None
    shape = np.array(voxels.values.shape, np.int32)
    lower = voxels.lower.numpy().astype(np.float32)
    voxel = np.float32(voxels.voxel_m).reshape(1)
    lib.unisim_propose(
        o.data_ptr(), d.data_ptr(), t_near.data_ptr(), t_far.data_ptr(), n, values.data_ptr(), shape.ctypes.data,
        lower.ctypes.data, voxel.ctypes.data, voxels.voxel_m / 2, DECAY_PER_M, u.data_ptr(), count, t.data_ptr(),
        mass.data_ptr(), kernel_threads(),
    )  # fmt: skip
    return t, mass


OPERATION = Operation(propose_reference, lambda voxels, spans, u: (u,), compiled=propose_compiled, takes=on_cpu_or_gpu)
