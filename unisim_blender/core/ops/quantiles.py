"""Quantiles at which samples are taken: even ones first, then more where the first set shows that rays stop.

Both sets are drawn in the quantiles of the occupied voxels' distribution (`propose`), so free space between occupied
voxels never takes a sample.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from .. import native
from .constants import QUANTILE_FLOOR
from .devices import kernel_threads
from .dispatch import Operation


def stratified(rays: int, count: int, jitter: bool, like: Tensor, generator: torch.Generator | None = None) -> Tensor:
    """Return quantiles (rays, count), one in each of ``count`` equal parts of [0, 1]: its middle, or with ``jitter`` a
    random point of it."""
    offset = (
        torch.rand(rays, count, generator=generator, device=like.device)
        if jitter
        else torch.full((rays, count), 0.5, device=like.device)
    )
    return ((torch.arange(count, device=like.device) + offset) / count).to(like.dtype)


def refine_quantiles(u: Tensor, t: Tensor, s: Tensor, beta: Tensor | float, jitter: Tensor) -> Tensor:
    """Return quantiles (N, count) near the surface of signed distances s (N, K), metres, at places t (N, K), metres,
    and quantiles u (N, K).

    The weights are the logistic density's with a beta bounded by an interval's length, so that a sample near a thin
    object attracts others. `QUANTILE_FLOOR` of them are spread evenly over the quantiles. ``jitter`` (N, count) ascends
    in [0, 1]. No gradient passes.
    """
    assert u.shape == t.shape == s.shape, (u.shape, t.shape, s.shape)
    assert jitter.shape[:1] == u.shape[:1], (u.shape, jitter.shape)
    return OPERATION(u, t, s, beta, jitter)


def refine_quantiles_reference(u: Tensor, t: Tensor, s: Tensor, beta: Tensor | float, jitter: Tensor) -> Tensor:
    """`refine_quantiles` in plain torch."""
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


def refine_quantiles_compiled(u: Tensor, t: Tensor, s: Tensor, beta: Tensor | float, jitter: Tensor) -> Tensor:
    """`refine_quantiles` by the compiled kernel, without gradients: samples' places take none."""
    lib = native.library()
    assert lib is not None
    u, t, s, jitter = (x.detach().contiguous() for x in (u, t, s, jitter))
    out = torch.empty_like(jitter)
    lib.unisim_refine(
        u.data_ptr(), t.data_ptr(), s.data_ptr(), *u.shape, float(beta), QUANTILE_FLOOR, jitter.data_ptr(),
        jitter.shape[1], out.data_ptr(), kernel_threads(),
    )  # fmt: skip
    return out


OPERATION = Operation(
    refine_quantiles_reference, lambda u, t, s, beta, jitter: (u, t, s, jitter), compiled=refine_quantiles_compiled
)


def refine_by_density(u: Tensor, tau: Tensor, jitter: Tensor) -> Tensor:
    """`refine_quantiles` for densities: tau (N, K) are the optical depths of the parts of [0, 1] about each of the
    quantiles u (N, K), as NeRF's second pass has it (Mildenhall et al., 2020, section 5.2)."""
    assert u.shape == tau.shape, (u.shape, tau.shape)
    middle = (u[:, 1:] + u[:, :-1]) / 2
    edges = torch.cat([torch.zeros_like(u[:, :1]), middle, torch.ones_like(u[:, :1])], -1)
    total = tau.cumsum(-1)
    return _drawn(edges, torch.exp(-(total - tau)) * -torch.expm1(-tau), jitter)


def _drawn(edges: Tensor, weight: Tensor, jitter: Tensor) -> Tensor:
    """Return the places (N, count) between edges (N, M + 1) at which the cumulative distribution of weights (N, M),
    with its floor, reaches jitter (N, count)."""
    weight, widths = weight + 1e-5, torch.diff(edges, dim=-1)
    pdf = (1 - QUANTILE_FLOOR) * weight / weight.sum(-1, keepdim=True) + QUANTILE_FLOOR * widths
    cdf = F.pad(pdf.cumsum(-1), (1, 0))
    cdf = cdf / cdf[:, -1:]
    j = torch.searchsorted(cdf, jitter.contiguous(), right=True).clamp(1, cdf.shape[1] - 1)
    c0, c1 = cdf.gather(1, j - 1), cdf.gather(1, j)
    e0, e1 = edges.gather(1, j - 1), edges.gather(1, j)
    return e0 + (jitter - c0) / (c1 - c0).clamp_min(1e-12) * (e1 - e0)
