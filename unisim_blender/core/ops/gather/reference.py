"""Weights and sums of ray segments, in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor

from ..ray_segments import RaySegments


def gather(ray_segment: RaySegments, before: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Weights of the intervals and of the samples (P, K) of ray segments with transmittances ``before`` (P, K), and
    what they give (P, F + 3): features by weight, the weight, distance by weight, optical depth."""
    interval = before * -torch.expm1(-ray_segment.tau)
    far_part = before * ray_segment.stop_fraction
    near_part = interval - far_part
    # an interval's weight goes to the samples at its two ends; interval 0 has only its own
    weight = far_part + torch.cat([near_part[:, 1:], torch.zeros_like(near_part[:, :1])], -1)
    weight = torch.cat([weight[:, :1] + interval[:, :1], weight[:, 1:]], -1)
    sums = [weight.sum(1), (weight * ray_segment.t).sum(1), ray_segment.tau.sum(1)]
    return interval, weight, torch.cat([(weight[..., None] * ray_segment.features).sum(1), torch.stack(sums, 1)], 1)
