"""Composite ray segments of many fields in one order of depth along each ray: transmittances, weights, features,
depths.

Densities of overlapping fields add and their features mix by weight, so the order in which ray segments come does not
matter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from .gather import gather
from .ray_segments import ActorSegments, MeshSegments, RaySegments
from .transmittances import transmittances, transmittances_padded


@dataclass(frozen=True)
class SegmentWeights:
    """Result of compositing for one field's ray segments, each (P, K): transmittances before the intervals, weights of
    the intervals and of the samples."""

    transmittance_before: Tensor
    intervals: Tensor
    samples: Tensor


@dataclass(frozen=True)
class Composite:
    """Result of compositing in the volume: the weights of each field's ray segments, in their order, and sums along the
    rays.

    feature (N, F) is for the scene's own decoder; foreign_features (N, F') and foreign_opacity (N,) are those of each
    foreign actor set, mesh_opacity (N,) is that of meshes. depth_m (N,) is the mean distance, metres along the ray, of
    what stops it, 0 where nothing does; opacity (N,) is the fraction of the ray that is stopped, transmittance_after
    (N,) the rest.
    """

    weights: tuple[SegmentWeights, ...]
    feature: Tensor
    foreign_features: tuple[Tensor, ...]
    foreign_opacity: tuple[Tensor, ...]
    mesh_opacity: Tensor
    depth_m: Tensor
    opacity: Tensor
    transmittance_after: Tensor


def composite(
    rays: int, ray_segments: Sequence[RaySegments], widths: Sequence[int], like: Tensor, padded: bool = False
) -> Composite:
    """Composite the segments of rays numbered 0 to ``rays`` - 1, on each ray in order of depth.

    ``widths`` are the lengths of the actor sets' features, the scene's own first. Tensors have the type and device of
    ``like``. ``padded`` says that segments may be of no ray and stop nothing.
    """
    features, opacities = [like.new_zeros(rays, width) for width in widths], [like.new_zeros(rays) for _ in widths]
    mesh_opacity, sums = like.new_zeros(rays), like.new_zeros(rays, 3)
    weights = []
    for segments, before in zip(
        ray_segments, (transmittances_padded if padded else transmittances)(rays, ray_segments), strict=True
    ):
        of_intervals, of_samples, given = gather(segments, before)
        weights.append(SegmentWeights(before, of_intervals, of_samples))
        part, rest = given.split((segments.features.shape[-1], 3), 1)
        if isinstance(segments, MeshSegments):
            mesh_opacity = mesh_opacity.index_add(0, segments.ray, rest[:, 0])
        else:
            number = segments.actor_set if isinstance(segments, ActorSegments) else 0
            features[number] = features[number].index_add(0, segments.ray, part)
            if number > 0:
                opacities[number] = opacities[number].index_add(0, segments.ray, rest[:, 0])
        sums = sums.index_add(0, segments.ray, rest)
    total, depth, tau = sums.unbind(1)
    return Composite(
        weights=tuple(weights), feature=features[0], foreign_features=tuple(features[1:]),
        foreign_opacity=tuple(opacities[1:]),
        mesh_opacity=mesh_opacity, depth_m=depth / total.clamp_min(1e-6), opacity=-torch.expm1(-tau),
        transmittance_after=torch.exp(-tau),
    )  # fmt: skip
