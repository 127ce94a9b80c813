"""Result of tracing rays through a scene: the type that tracing gives to training and to the passes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from torch import Tensor

from .composite import SegmentWeights
from .ray_segments import RaySegments, StaticSegments


@dataclass(frozen=True)
class BackgroundTrace:
    """Samples of the background model: ray (R,), places t in metres, optical depths tau, and the transmittances before
    the places (R, K)."""

    ray: Tensor
    t: Tensor
    tau: Tensor
    transmittance_before: Tensor


@dataclass(frozen=True)
class SegmentTrace:
    """Result of tracing rays through a scene.

    feature (N, F) is composited, the background model and the sky included where they were asked for; depth_m (N,) is
    the mean distance of what stopped the ray, 0 where nothing did; opacity (N,) and transmittance_after (N,), 1 -
    opacity, are without the sky.
    """

    feature: Tensor
    depth_m: Tensor
    opacity: Tensor
    transmittance_after: Tensor
    volume_depth_m: Tensor
    """Mean distance (N,) of what stopped the ray inside the volume, the background model left out."""
    volume_opacity: Tensor
    ray_segments: tuple[RaySegments, ...]
    weights: tuple[SegmentWeights, ...]
    """Weights of each field's ray segments, in their order."""
    samples: int
    foreign_features: tuple[Tensor, ...] = ()
    foreign_opacity: tuple[Tensor, ...] = ()
    background: BackgroundTrace | None = None
    """None where the background model was not asked for, or no ray came through to it."""
    without_foreign: Tensor | None = None
    """``feature`` as if no foreign actor and no mesh were there; None where none is."""
    mesh_opacity: Tensor | None = None
    """Opacity (N,) of meshes; None where there are none."""

    def weighted(self) -> Iterator[tuple[RaySegments, SegmentWeights]]:
        """Each field's ray segments and their weights."""
        return zip(self.ray_segments, self.weights, strict=True)

    @property
    def static(self) -> tuple[StaticSegments, SegmentWeights] | None:
        """The ray segments through the static field and their weights; None where no ray hit it."""
        for segments, weights in self.weighted():
            if isinstance(segments, StaticSegments):
                return segments, weights
        return None
