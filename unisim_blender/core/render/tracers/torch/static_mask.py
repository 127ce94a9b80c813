"""Where the static field is masked: in the boxes of actors, and in removed boxes."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ....model.scene import SceneModel
from ....ops.field_values import FieldValues
from ....ops.ray_segments import ActorSegments, RayBatch
from .actor_tensors import ActiveActorTensors


class StaticMask:
    """Masks values of the static field along a batch of rays, of which ``actors`` are the segments in actors'
    boxes."""

    def __init__(
        self, scene: SceneModel, active: ActiveActorTensors, rays: RayBatch, actors: Sequence[ActorSegments]
    ) -> None:
        self.scene, self.active, self.rays, self.actors = scene, active, rays, actors

    def apply(self, values: FieldValues, ray: Tensor, t: Tensor, points: Tensor) -> FieldValues:
        """Values (P, K) at samples t (P, K), points (P, K, 3), of rays (P,), as a ray may hit them.

        Inside a present actor's box, and in a removed box, nothing stands above the ground: the ground is then all
        that is near. A density is nothing there.
        """
        rows, columns = torch.nonzero(self._inside(ray, t), as_tuple=True)
        if len(rows) == 0:
            return values
        x = points[rows, columns]
        return values.cleared(rows, columns, x[:, 2] - self.scene.ground.height(x))

    @torch.no_grad()
    def _inside(self, ray: Tensor, t: Tensor) -> Tensor:
        """Which samples t (P, K) of rays (P,) lie in the box of an actor that the ray hits, or in a removed one: (P,
        K)."""
        covers = torch.zeros_like(t)
        row_of_ray = torch.full((len(self.rays),), -1, dtype=torch.long, device=t.device)
        row_of_ray[ray] = torch.arange(len(ray), device=t.device)
        for segments in self.actors:
            row = row_of_ray[segments.ray]
            known = row >= 0
            row, near, far = row[known], segments.t_near[known], segments.t_far[known]
            covered = (t[row] >= near[:, None]) & (t[row] <= far[:, None])
            covers.index_put_((row,), covered.to(covers.dtype), accumulate=True)
        inside = covers > 0
        if self.active.removals is not None:
            for pose, size in zip(*self.active.removals, strict=True):
                x = self.rays.origins[ray][:, None] + t[..., None] * self.rays.directions[ray][:, None]
                inside |= ((x @ pose[:3, :3].mT + pose[:3, 3]).abs() <= size / 2).all(-1)
        return inside
