"""How what fields say along rays stops them, and where that asks for more samples."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from ....model.scene import SceneModel
from ....ops.density import logistic_intervals, unisim_intervals, volume_density, volume_intervals
from ....ops.field_values import FieldValues, LogDensities
from ....ops.quantiles import refine_by_density, refine_quantiles

_LOOKUPS = 3
"""Places between two samples at which the voxels are looked up: how much of the way is free."""

Lengths = Callable[[], Tensor]
"""Works out the metres (N, K) that intervals count by, which only densities need."""


def intervals(
    scene: SceneModel, values: FieldValues, t: Tensor, lengths: Lengths, step_m: float
) -> tuple[Tensor, Tensor]:
    """Optical depths and stop fractions (N, K) of intervals between samples at t (N, K) with these values (N, K), t
    in the metres of the field; ``step_m`` is the one of UniSim's density."""
    if isinstance(values, LogDensities):
        with torch.no_grad():
            length_m = lengths()
        return volume_intervals(values.logs, length_m)
    if scene.config.density == "unisim":
        return unisim_intervals(values.metres, t, scene.beta(), step_m)
    return logistic_intervals(values.metres, scene.beta())


@torch.no_grad()
def refined(scene: SceneModel, values: FieldValues, u: Tensor, t: Tensor, lengths: Lengths, jitter: Tensor) -> Tensor:
    """Quantiles like ``jitter`` (N, K'), where values (N, K) at places t (N, K), quantiles u (N, K), say that rays
    stop."""
    if isinstance(values, LogDensities):
        return refine_by_density(u, volume_density(values.logs) * lengths(), jitter)
    return refine_quantiles(u, t, values.metres, float(scene.beta()), jitter.shape[1], jitter)


@torch.no_grad()
def occupied_lengths(scene: SceneModel, o: Tensor, d: Tensor, t: Tensor) -> Tensor:
    """Metres (N, K) of occupied voxels between each sample t (N, K) of rays o, d (N, 3) and the one before: a density
    has none where a voxel is free, and samples lie on both sides of much free space."""
    least = scene.config.voxel_m / 2
    gap = torch.diff(t, dim=1, prepend=t[:, :1] - least)
    part = (torch.arange(_LOOKUPS, device=t.device) + 0.5) / _LOOKUPS
    x = o[:, None, None] + (t[..., None] - gap[..., None] * part)[..., None] * d[:, None, None]
    occupied = scene.occupancy.values.view(-1)[scene.occupancy.cells(x.reshape(-1, 3))] > 0
    # a sample that was placed behind free space stands in a voxel that is occupied
    return torch.maximum(gap * occupied.view(x.shape[:3]).to(gap.dtype).mean(-1), gap.clamp_max(least))


def along(o: Tensor, d: Tensor, t: Tensor) -> Tensor:
    """Points (N, K, 3) at distances t (N, K) along rays o, d (N, 3)."""
    # a sum after a product of shapes that spread would take four times as long
    return torch.addcmul(o[:, None], t[..., None], d[:, None])
