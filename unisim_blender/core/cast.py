"""Who is on: a drive's actors, copied and removed boxes of space, as tensors that rays are traced against."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from .devices import module_to
from .drive import FRAME_MARGIN_S, Actor, Box, Drive, Look, StaticCopy
from .errors import SceneError
from .fields.scene import SceneModel
from .fields.tracklets import Tracklets
from .geometry import Trajectory, invert_pose
from .meshes.meeting import Extras


@dataclass
class Troupe:
    """Actors whose looks come from one scene: boxes on their ways, and each one's row of that scene's tables."""

    scene: SceneModel
    tables: Tensor
    tracklets: Tracklets
    rows: Tensor
    uids: tuple[str, ...]


@dataclass
class Cast:
    """``own`` are actors with looks of the scene itself, ``guests`` those of other scenes by their paths, ``extras`` meshes.

    removals: (box_from_world (R, 4, 4), size_m (R, 3)); copies: tracklets of the target boxes, source_from_target (C, 4, 4).
    """

    own: Troupe
    guests: dict[str, Troupe] = field(default_factory=dict)
    removals: tuple[Tensor, Tensor] | None = None
    copies: Tracklets | None = None
    copy_source: Tensor | None = None
    extras: Extras = field(default_factory=lambda: Extras(()))

    def to(self, device: torch.device) -> Cast:
        """The same on another device."""
        for troupe in (self.own, *self.guests.values()):
            module_to(troupe.tracklets, device)
            troupe.rows = troupe.rows.to(device)
        if self.removals is not None:
            self.removals = (self.removals[0].to(device), self.removals[1].to(device))
        if self.copies is not None and self.copy_source is not None:
            self.copies, self.copy_source = module_to(self.copies, device), self.copy_source.to(device)
        return self

    @property
    def uids(self) -> tuple[str, ...]:
        """Every actor's id: own ones, then guests', then meshes'; instance n + 1 is the n-th of them."""
        return self.own.uids + tuple(uid for troupe in self.guests.values() for uid in troupe.uids) + self.extras.uids


def on_stage(drive: Drive, actors: Iterable[Actor]) -> list[Actor]:
    """Actors in the order of their ids, so that overlapping ones composite alike in any list, present in their windows."""
    windows = ((actor, drive.window(actor)) for actor in sorted(actors, key=lambda a: a.uid))
    return [replace(actor, start_s=start, end_s=end) for actor, (start, end) in windows]


def gather_troupe(scene: SceneModel, tables: Tensor, actors: list[Actor]) -> Troupe:
    """Actors, as `on_stage` gives them, with looks of ``scene``."""
    for actor in actors:
        if actor.look.actor not in scene.actor_ids:
            where = f" at {actor.look.scene}" if actor.look.scene else ""
            raise SceneError(
                f"actor {actor.uid!r} has the look of {actor.look.actor!r}, which the trained scene{where} does not hold"
            )
    rows = torch.tensor([scene.actor_ids[a.look.actor] for a in actors], dtype=torch.long)
    return Troupe(scene, tables, Tracklets(actors), rows, tuple(a.uid for a in actors))


def _boxes(boxes: tuple[Box, ...]) -> tuple[Tensor, Tensor]:
    poses = np.stack([invert_pose(b.world_from_box) for b in boxes])
    return torch.as_tensor(poses).float(), torch.as_tensor(np.stack([b.size_m for b in boxes])).float()


def vacated(recorded: Drive, drive: Drive) -> tuple[Box, ...]:
    """Boxes of actors that stood still throughout the recording and are not there any more.

    Whatever stood in such a box was the actor: behind its surface nobody saw anything, so the static field is empty there.
    """
    boxes = []
    for uid, actor in recorded.actors.items():
        now = drive.actors.get(uid)
        stays = now is not None and not now.is_moving and np.array_equal(now.world_from_actor.poses, actor.world_from_actor.poses)
        if not actor.is_moving and not stays:
            boxes.append(Box(actor.world_from_actor.poses[0], actor.size_m))
    return tuple(boxes)


def gather_cast(
    scene: SceneModel, tables: Tensor, drive: Drive, others: dict[str, tuple[SceneModel, Tensor]], recorded: Drive
) -> Cast:
    """The cast of a drive; ``tables`` are the scene's baked actor grids, ``others`` the same of scenes by path, ``recorded`` the
    drive that the scene was trained on."""
    own = [a for a in drive.actors.values() if not a.look.scene and not a.look.mesh]
    guests = {}
    for path in sorted({a.look.scene for a in drive.actors.values() if a.look.scene}):
        if path not in others:
            raise SceneError(f"{path}: this trained scene is needed for an inserted actor and was not loaded")
        guests[path] = gather_troupe(*others[path], on_stage(drive, (a for a in drive.actors.values() if a.look.scene == path)))
    extras = Extras(on_stage(drive, (a for a in drive.actors.values() if a.look.mesh)))
    cast = Cast(gather_troupe(scene, tables, on_stage(drive, own)), guests, extras=extras)
    emptied = drive.static_removals + vacated(recorded, drive)
    if emptied:
        cast.removals = _boxes(emptied)
    if drive.static_copies:
        targets = [_target(drive, copy) for copy in drive.static_copies]
        cast.copies = Tracklets(targets)
        cast.copy_source = torch.as_tensor(np.stack([c.source.world_from_box for c in drive.static_copies])).float()
    return cast


def _target(drive: Drive, copy: StaticCopy) -> Actor:
    """A copy's box as an actor that stands still throughout the drive."""
    way = Trajectory.from_poses(np.zeros(1), copy.world_from_target[None])
    start, end = drive.time_s[drive.frames[0]] - FRAME_MARGIN_S, drive.time_s[drive.frames[-1]] + FRAME_MARGIN_S
    return Actor(copy.uid, "Static", copy.source.size_m, way, start, end, False, Look(copy.uid))
