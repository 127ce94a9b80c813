"""Rays, and the kinds of ray segments.

A *ray segment* is one ray inside one field (the static field, an actor's box, a copied box of space), or one hit of a
mesh. Those of one field are kept together; each has K samples and K intervals, see `density.logistic_intervals`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal, TypeVar

import torch
from torch import Tensor

from .field_values import FieldValues, LogDensities, SignedDistances

Segments = TypeVar("Segments", bound="RaySegments")


@dataclass(frozen=True)
class RayBatch:
    """Rays as tensors: origins, from the volume's corner (`VolumeFrame.recentred`), and directions (N, 3), both along
    the world's axes, float32; time_s (N,) float64 where the device has it."""

    origins: Tensor
    directions: Tensor
    time_s: Tensor
    starts: Tensor | None = None
    """Distances (N,), metres, before which a ray hits nothing of the static field; None where there is no such
    bound."""

    def __len__(self) -> int:
        return len(self.origins)


@dataclass(frozen=True)
class RaySegments:
    """Ray segments of any kind, with the quantities that compositing reads: ray (P,), samples t (P, K) in metres along
    the ray, features (P, K, F), optical depths tau and stop fractions (P, K)."""

    ray: Tensor
    t: Tensor
    features: Tensor
    tau: Tensor
    stop_fraction: Tensor

    def __len__(self) -> int:
        return len(self.ray)

    def stops(self) -> Tensor:
        """Return the expected place (P, K), metres along the ray, of a stop in each interval."""
        near = torch.cat([self.t[:, :1], self.t[:, :-1]], -1)
        alpha = -torch.expm1(-self.tau)
        inside = torch.where(alpha > 1e-4, self.stop_fraction / alpha.clamp_min(1e-4), torch.full_like(alpha, 0.5))
        return near + inside * (self.t - near)


@dataclass(frozen=True)
class FieldSegments(RaySegments):
    """Ray segments inside a field: its ``values`` (P, K) at the samples, and ``points`` (P, K, 3) in its own
    coordinates (volume, metres; or an actor's unit cube). ``density`` is the kind of its density, ``beta`` () its
    sharpness, 1 / metres."""

    values: FieldValues
    points: Tensor
    density: Literal["logistic", "unisim", "volume"]
    beta: Tensor


@dataclass(frozen=True)
class StaticSegments(FieldSegments):
    """Ray segments through the static field: of all rays where their number is fixed, and then ``there`` (P,) bool says
    which hit an occupied voxel; the others stop nothing."""

    there: Tensor | None = None


@dataclass(frozen=True)
class CopiedBoxSegments(FieldSegments):
    """Ray segments through the static field inside of a copied box, where the copy stands. ``copy_from_source`` (P,
    3, 3) turns directions of the world at the source into those at the copy."""

    copy_from_source: Tensor


@dataclass(frozen=True)
class ActorSegments(FieldSegments):
    """Ray segments through the boxes of one actor set: 0 for the scene's own, from 1 on for foreign ones.

    ``actor`` (P,) is the actor's number among all that are active, meshes last. A ray enters its box at ``t_near``
    and leaves it at ``t_far`` (P,). ``world_from_box`` (P, 3, 3) is the box's rotation after the inverse of its
    scale, so that gradients in the field's metres become directions of the world; ``size_m`` (P, 3) are the box's
    edges in the metres of its field.
    """

    actor_set: int
    actor: Tensor
    t_near: Tensor
    t_far: Tensor
    world_from_box: Tensor
    size_m: Tensor

    def contain(self, depth_m: Tensor) -> Tensor:
        """Return (P,) bool whether depths (P,) along the rays lie in their boxes."""
        return (depth_m > self.t_near) & (depth_m < self.t_far)

    def at(self, depth_m: Tensor) -> Tensor:
        """Return the points (P, 3) at depths (P,) along the rays, unit cubes, in which or not."""
        # they lie on a line: two of them tell where any is
        t0, t1 = self.t[:, :1], self.t[:, -1:]
        p0, p1 = self.points[:, 0], self.points[:, -1]
        return p0 + (depth_m[:, None] - t0) / (t1 - t0).clamp_min(1e-4) * (p1 - p0)


@dataclass(frozen=True)
class MeshSegments(RaySegments):
    """Hits of meshes as ray segments of one sample. Their appearance is not composited: ``features`` (P, 1, 1) are 0.

    ``actor`` (P,) is numbered as in `ActorSegments`; ``normals`` (P, 3) are unit, world frame.
    """

    actor: Tensor
    normals: Tensor


def rows_of(ray_segments: Segments, which: Tensor) -> Segments:
    """Return some of a field's ray segments, by numbers (M,) or by a mask (P,)."""
    chosen: dict[str, Any] = {
        name: value[which] if isinstance(value, Tensor) else value.rows(which)
        for name, value in vars(ray_segments).items()
        if (isinstance(value, Tensor) and value.dim()) or isinstance(value, SignedDistances | LogDensities)
    }
    return replace(ray_segments, **chosen)
