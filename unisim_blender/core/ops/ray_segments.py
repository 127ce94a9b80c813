"""Rays, what they run through, and what they met: the types that tracing, compositing and the passes share.

A *ray segment* is one ray inside one field (the static field, one actor's box, one copied box of space); it has K samples and K
intervals, see `density.logistic_intervals`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class RayBatch:
    """Rays as tensors: origins, from the volume's corner (`VolumeFrame.recentred`), and directions (N, 3), both along the world's
    axes, float32; time_s (N,) float64 where the device has it."""

    origins: Tensor
    directions: Tensor
    time_s: Tensor
    starts: Tensor | None = None
    """Metres (N,) before which a ray meets nothing of the static field; None where there is no such bound."""

    def __len__(self) -> int:
        return len(self.origins)


@dataclass
class RaySegments:
    """Ray segments of one field: ray (P,), samples t (P, K), signed distances s, features (P, K, F), optical depths tau
    and stop fractions (P, K).

    ``points`` (P, K, 3) in the field's own coordinates (volume, metres; or an actor's unit cube); ``field`` (P,) is -1 for the
    static field, else the actor's number among the active ones.
    """

    ray: Tensor
    t: Tensor
    s: Tensor
    features: Tensor
    tau: Tensor
    stop_fraction: Tensor
    points: Tensor
    field: Tensor
    foreign: int = -1
    """Which foreign actor set's features these are; -1 for the scene's own; meshes, which have none, come after the foreign
    actors."""
    bounds: tuple[Tensor, Tensor] | None = None
    """Where the ray segment enters and leaves its box (P,), (P,)."""
    world_from_box: Tensor | None = None
    """Rotation of the segment's box (P, 3, 3), for an actor after the inverse of its scale, so that gradients in the field's
    metres become directions of the world; for a copied box the one from the source to the copy."""
    size_m: Tensor | None = None
    """Edges of the segment's box (P, 3) in the metres of its field, for an actor."""
    beta: float = 0.0
    """The density's sharpness in this field, 1 / metres."""
    transmittance_before: Tensor | None = None
    """Transmittance before the intervals (P, K), once composited."""
    weight: Tensor | None = None
    """Weights of the samples (P, K), once composited."""
    interval_weight: Tensor | None = None
    """Weights of the intervals (P, K), once composited."""
    normals: Tensor | None = None
    """Unit normals (P, 3), world frame, of ray segments that are surfaces and no field."""

    def stops(self) -> Tensor:
        """Where a ray that stops in an interval is expected to (P, K), metres along the ray."""
        near = torch.cat([self.t[:, :1], self.t[:, :-1]], -1)
        alpha = -torch.expm1(-self.tau)
        inside = torch.where(alpha > 1e-4, self.stop_fraction / alpha.clamp_min(1e-4), torch.full_like(alpha, 0.5))
        return near + inside * (self.t - near)


@dataclass
class SegmentTrace:
    """What the rays met. feature (N, F) composited, the far field and the sky included where they were asked for; depth_m (N,)
    mean distance of what stopped the ray, 0 where nothing did; opacity (N,) and transmittance_after (N,), 1 - opacity, without
    the sky."""

    feature: Tensor
    depth_m: Tensor
    opacity: Tensor
    transmittance_after: Tensor
    ray_segments: list[RaySegments]
    samples: int
    foreign_features: list[Tensor]
    foreign_opacity: list[Tensor]
    near_depth_m: Tensor
    """Mean distance (N,) of what stopped the ray inside the volume, the far field left out."""
    near_opacity: Tensor
    far: tuple[Tensor, Tensor, Tensor, Tensor] | None = None
    """What the far field gave: ray (R,), t, tau, and the transmittance before each place (R, K)."""
    without_foreign: Tensor | None = None
    """``feature`` as if no foreign actor were there; None where none is."""
    mesh_opacity: Tensor | None = None
    """How much of each ray (N,) meshes stop; None where there are none."""

    @property
    def static(self) -> RaySegments | None:
        """The ray segments through the static field; None where no ray met it."""
        return next((ray_segment for ray_segment in self.ray_segments if ray_segment.bounds is None), None)
