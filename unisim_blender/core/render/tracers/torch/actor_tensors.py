"""The active actors as tensors that rays are traced against."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from ....geometry import FloatArray, invert_pose
from ....model.scene import SceneModel
from ....model.shapes import GAIT_BINS
from ....model.tracklets import Tracklets
from ....ops.devices import module_to
from ....world.drive import Actor
from ...tracer import ActiveActors, ActorSet


@dataclass
class ActorSetTensors:
    """Actors whose appearances come from one scene: their tracklets, and each one's row of that scene's tables."""

    scene: SceneModel
    tables: Tensor
    tracklets: Tracklets
    rows: Tensor
    uids: tuple[str, ...]
    keys: tuple[Tensor, Tensor] | None = None
    """The tracklets' keys, where they were computed before; else every trace computes them."""

    def table_rows(self, actor: Tensor, time_s: Tensor) -> Tensor:
        """Return the rows (P,) of the tables of actors (P,) at times (P,) float64, seconds: of one with a gait that of the
        phase which the length of its path gives, in cycles as long as the actor is scaled."""
        gaits, row = self.scene.actors.gaits, self.rows[actor]
        if gaits is None:
            return row
        cycle_m = gaits.cycles_m[row] * self.tracklets.scales[actor, 0]
        turns = self.tracklets.walked_at(actor, time_s, self.keys or self.tracklets.keys()) / cycle_m.clamp_min(1e-3)
        bins = ((turns - turns.floor()) * GAIT_BINS).long().clamp(0, GAIT_BINS - 1)
        return gaits.first[row] + torch.where(cycle_m > 0, bins, 0)


@dataclass
class ActiveActorTensors:
    """``own`` are actors with appearances of the scene itself, ``foreign`` those of other scenes by their paths.

    Places are measured from the corner of the own scene's volume, along the world's axes. removals: (box_from_world
    (R, 4, 4), size_m (R, 3)); copies: tracklets of the target boxes, copy_source: world_from_source (C, 4, 4).
    """

    own: ActorSetTensors
    foreign: dict[str, ActorSetTensors] = field(default_factory=dict)
    removals: tuple[Tensor, Tensor] | None = None
    copies: Tracklets | None = None
    copy_source: Tensor | None = None

    @property
    def sets(self) -> list[ActorSetTensors]:
        """All actor sets: the scene's own first, then the foreign ones."""
        return [self.own, *self.foreign.values()]


def active_actor_tensors(
    active: ActiveActors, scenes: Mapping[str, tuple[SceneModel, Tensor]], device: torch.device | str = "cpu"
) -> ActiveActorTensors:
    """Return the active actors on a device; ``scenes`` are models and their baked actor grids by path, the scene's own
    under ""."""
    corner = scenes[""][0].volume.corner

    def tracklets(actors: Sequence[Actor]) -> Tracklets:
        return module_to(Tracklets(actors, corner=corner), device)

    def recentred(pose: FloatArray) -> FloatArray:
        return np.block([[pose[:3, :3], (pose[:3, 3] - corner)[:, None]], [pose[3:]]])

    def actor_set(path: str, actors: ActorSet) -> ActorSetTensors:
        rows = torch.tensor(actors.rows, dtype=torch.long, device=device)
        return ActorSetTensors(*scenes[path], tracklets(actors.actors), rows, actors.uids)

    def stacked(arrays: list[FloatArray]) -> Tensor:
        return torch.as_tensor(np.stack(arrays)).float().to(device)

    out = ActiveActorTensors(
        actor_set("", active.own), {path: actor_set(path, actors) for path, actors in active.foreign.items()}
    )
    if active.removals:
        poses = [invert_pose(recentred(box.world_from_box)) for box in active.removals]
        out.removals = stacked(poses), stacked([box.size_m for box in active.removals])
    if active.targets:
        out.copies = tracklets(active.targets)
        out.copy_source = stacked([recentred(box.world_from_box) for box in active.sources])
    return out
