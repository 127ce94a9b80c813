"""Where a ray stops, by the median: the distance at which half of what stops it has done so.

The mean of what a ray hits moves by a metre when a thousandth of it lies a kilometre behind, and between a car's
edge and the wall behind it lies on neither; a LiDAR reports the one or the other. On a plane both are the distance to
it.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ....ops.field_values import SignedDistances
from ....ops.ray_segments import FieldSegments, RaySegments
from ....ops.segment_trace import SegmentTrace


@torch.no_grad()
def median_depth(traced: SegmentTrace) -> Tensor:
    """Median distance (N,) in metres of what stopped each ray, the background model included, the sky left out; 0
    where nothing did."""
    target = (1 + traced.transmittance_after) / 2
    depth = torch.zeros_like(traced.opacity)
    for segments, weights in traced.weighted():
        wanted, before = target[segments.ray][:, None], weights.transmittance_before
        row, k = _crossed(before, segments.tau, wanted)
        near = segments.t[row, (k - 1).clamp_min(0)]
        fraction = _fraction(segments, before, row, k, wanted[row, 0])
        depth[segments.ray[row]] = near + torch.where(k > 0, fraction, torch.zeros_like(fraction)) * (
            segments.t[row, k] - near
        )
    if traced.background is not None:
        behind = traced.background
        row, k = _crossed(behind.transmittance_before, behind.tau, target[behind.ray][:, None])
        depth[behind.ray[row]] = behind.t[row, k]
    return depth


def _crossed(before: Tensor, tau: Tensor, wanted: Tensor) -> tuple[Tensor, Tensor]:
    """Rows and intervals (M,), (M,) in which transmittances, ``before`` (P, K) the intervals, fall to ``wanted`` (P,
    1)."""
    row, k = torch.nonzero((before > wanted) & (before * torch.exp(-tau) <= wanted), as_tuple=True)
    return row, k


def _fraction(segments: RaySegments, before: Tensor, row: Tensor, k: Tensor, wanted: Tensor) -> Tensor:
    """How far into interval k of each row the transmittance falls to ``wanted``, 0 to 1. Between samples signed
    distances of the logistic density are linear; others stop rays at the far sample, as meshes do."""
    if not isinstance(segments, FieldSegments) or segments.density != "logistic":
        return torch.ones_like(wanted)
    assert isinstance(segments.values, SignedDistances)
    s, beta = segments.values.metres, segments.beta
    s1, s2 = s[row, (k - 1).clamp_min(0)], s[row, k]
    # -log Phi at the place, then its distance: the inverse of softplus(-beta s)
    y = F.softplus(-beta * s1) + torch.log(before[row, k] / wanted)
    at = -(y + torch.log(-torch.expm1(-y.clamp_min(1e-12)))) / beta
    return ((s1 - at) / (s1 - s2).clamp_min(1e-9)).clamp(0, 1)
