"""Places of samples along rays through occupied voxels, by a kernel of Triton's.

A program walks BLOCK rays through their steps twice, first for the distribution's mass, then for where its quantiles
lie, and writes no step down: torch's operations keep a number for each step of each ray.
"""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from ..constants import DECAY_PER_M
from ..propose import RaySpans, Voxels

BLOCK = 32


@triton.jit
def _step(
    values, nx, ny, nz, low_x, low_y, low_z, per_m, step, decay, ox, oy, oz, dx, dy, dz, near, count, there, i, passed
):  # fmt: skip
    # the value, 0..1, of the voxel in which each ray's i-th step stands, 0 outside, and the step's mass behind
    # values # ``passed``
    at = near + (i + 0.5) * step
    x, y = tl.floor((ox + at * dx - low_x) * per_m), tl.floor((oy + at * dy - low_y) * per_m)
    z = tl.floor((oz + at * dz - low_z) * per_m)
    inside = there & (i < count) & (x >= 0) & (y >= 0) & (z >= 0) & (x < nx) & (y < ny) & (z < nz)
    # what is outside may be too far for an integer
    x, y, z = (
        tl.where(inside, x, 0.0).to(tl.int32),
        tl.where(inside, y, 0.0).to(tl.int32),
        tl.where(inside, z, 0.0).to(tl.int32),
    )
    p = tl.load(values + (x.to(tl.int64) * ny + y) * nz + z, mask=inside, other=0).to(tl.float32) / 255
    return p, p * tl.exp(-decay * step * passed)


# each value of a count would be compiled anew: for a 1, for multiples of 16, for all others
@triton.jit(do_not_specialize=["n"])
def _propose(
    origins, directions, t_near, t_far, n, values, nx, ny, nz, lower, per_m,
    step, decay, u, t, mass, COUNT: tl.constexpr, WIDE: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    ray = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    there = ray < n
    k = tl.arange(0, WIDE)
    mask = there[:, None] & (k < COUNT)[None, :]
    ox, dx = tl.load(origins + ray * 3, mask=there, other=0.0), tl.load(directions + ray * 3, mask=there, other=0.0)
    oy, dy = (
        tl.load(origins + ray * 3 + 1, mask=there, other=0.0),
        tl.load(directions + ray * 3 + 1, mask=there, other=0.0),
    )
    oz, dz = (
        tl.load(origins + ray * 3 + 2, mask=there, other=0.0),
        tl.load(directions + ray * 3 + 2, mask=there, other=0.0),
    )
    low_x, low_y, low_z = tl.load(lower), tl.load(lower + 1), tl.load(lower + 2)
    near, far = tl.load(t_near + ray, mask=there, other=0.0), tl.load(t_far + ray, mask=there, other=0.0)
    span = far - near
    # rays that miss the volume, or are not numbers, take no step
    count = tl.where(span > 0, tl.ceil(span / step), 0.0).to(tl.int32)
    longest = tl.max(count, 0)
    passed, total = tl.zeros_like(near), tl.zeros_like(near)
    for i in range(0, longest):
        p, own = _step(
            values, nx, ny, nz, low_x, low_y, low_z, per_m, step, decay, ox, oy, oz, dx, dy, dz, near, count, there, i,
            passed
        )  # fmt: skip
        total += own
        passed += p
    q = tl.load(u + ray[:, None] * COUNT + k[None, :], mask=mask, other=0.0)
    target = q * total[:, None]
    placed = near[:, None] + q * span[:, None]
    passed, below = tl.zeros_like(near), tl.zeros_like(near)
    for i in range(0, longest):
        p, own = _step(
            values, nx, ny, nz, low_x, low_y, low_z, per_m, step, decay, ox, oy, oz, dx, dy, dz, near, count, there, i,
            passed
        )  # fmt: skip
        # the last occupied step that a quantile reaches has it, so one that rounding sends past the end stands in
        # the # last of all
        share = (target - below[:, None]) / tl.maximum(own, 1e-30)[:, None]
        here = near[:, None] + (i + tl.minimum(share, 1.0)) * step
        placed = tl.where((own > 0)[:, None] & (target >= below[:, None]), here, placed)
        below += own
        passed += p
    tl.store(t + ray[:, None] * COUNT + k[None, :], placed, mask=mask)
    tl.store(mass + ray, total, mask=there)


def _propose_forward(
    values: Tensor,
    lower: Tensor,
    voxel_m: float,
    decay_per_m: float,
    o: Tensor,
    d: Tensor,
    near: Tensor,
    far: Tensor,
    u: Tensor,
) -> tuple[Tensor, Tensor]:
    """Places (N, K) at quantiles u (N, K) of what voxels (X, Y, Z) uint8, from ``lower`` (3,) on, say about rays o, d
    (N, 3) from near to far (N,); the distribution's mass (N,). All contiguous."""
    n, count = u.shape
    t, mass = torch.empty_like(u), torch.empty_like(near)
    if n:
        with torch.cuda.device_of(u):
            _propose[(triton.cdiv(n, BLOCK),)](
                o, d, near, far, n, values, *values.shape, lower, 1.0 / voxel_m, voxel_m / 2, decay_per_m, u, t, mass,
                COUNT=count, WIDE=triton.next_power_of_2(count), BLOCK=BLOCK,
            )  # fmt: skip
    return t, mass


def propose(voxels: Voxels, spans: RaySpans, u: Tensor) -> tuple[Tensor, Tensor]:
    """See `ops.propose.propose`."""
    o, d = spans.origins.contiguous(), spans.directions.contiguous()
    near, far = spans.t_near.contiguous(), spans.t_far.contiguous()
    values, lower = voxels.values.contiguous(), voxels.lower.float()
    return _propose_forward(values, lower, voxels.voxel_m, DECAY_PER_M, o, d, near, far, u.contiguous())
