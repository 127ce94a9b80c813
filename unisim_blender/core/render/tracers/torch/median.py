"""Where a ray stops, by the median: the distance at which half of what stops it has done so.

The mean of what a ray meets moves by a metre when a thousandth of it lies a kilometre behind, and between a car's edge and the
wall behind it lies on neither; a LiDAR reports the one or the other. On a plane both are the distance to it.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ....model.scene import SceneModel
from ....ops.ray_segments import RaySegments, SegmentTrace


@torch.no_grad()
def median_depth(scene: SceneModel, traced: SegmentTrace) -> Tensor:
    """Median distance (N,) in metres of what stopped each ray, the far field included, the sky left out; 0 where nothing did."""
    target = (1 + traced.transmittance_after) / 2
    depth = torch.zeros_like(traced.opacity)
    for ray_segment in traced.ray_segments:
        assert ray_segment.transmittance_before is not None
        wanted = target[ray_segment.ray][:, None]
        after = ray_segment.transmittance_before * torch.exp(-ray_segment.tau)
        row, k = torch.nonzero((ray_segment.transmittance_before > wanted) & (after <= wanted), as_tuple=True)
        near = ray_segment.t[row, (k - 1).clamp_min(0)]
        fraction = _fraction(scene, ray_segment, row, k, wanted[row, 0])
        depth[ray_segment.ray[row]] = near + torch.where(k > 0, fraction, torch.zeros_like(fraction)) * (
            ray_segment.t[row, k] - near
        )
    if traced.far is not None:
        ray, t, tau, before = traced.far
        after = before * torch.exp(-tau)
        row, k = torch.nonzero((before > target[ray][:, None]) & (after <= target[ray][:, None]), as_tuple=True)
        depth[ray[row]] = t[row, k]
    return depth


def _fraction(scene: SceneModel, ray_segment: RaySegments, row: Tensor, k: Tensor, wanted: Tensor) -> Tensor:
    """How far into interval k of each row the transmittance falls to ``wanted``, 0 to 1; the distance is linear in between."""
    if scene.config.density != "logistic":
        return torch.ones_like(wanted)
    assert ray_segment.transmittance_before is not None
    s1, s2 = ray_segment.s[row, (k - 1).clamp_min(0)], ray_segment.s[row, k]
    # -log Phi at the place, then its distance: the inverse of softplus(-beta s)
    y = F.softplus(-ray_segment.beta * s1) + torch.log(ray_segment.transmittance_before[row, k] / wanted)
    at = -(y + torch.log(-torch.expm1(-y.clamp_min(1e-12)))) / ray_segment.beta
    return ((s1 - at) / (s1 - s2).clamp_min(1e-9)).clamp(0, 1)
