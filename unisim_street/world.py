"""A drive's actors and static items placed in its street: what a ray of that drive can hit, in the street's frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.geometry import FloatArray, Trajectory, invert_pose
from unisim_blender.core.world.drive import Actor, Box, Drive, StaticCopy
from unisim_blender.core.world.replay import with_windows
from unisim_blender.core.world.state import WorldState

from .street import Street, street_origin
from .tracing.trace import Asset, AssetPlacement

GROUND = 0
"""Number of the ground's placement; static objects, copies of them and the actors follow."""


@dataclass(frozen=True, eq=False)
class StreetWorld:
    """Placements, street frame: ground, static objects, static copies, actors. instances: the actors' uids, in order.

    footprints: for the contact shadow of each actor, its placement and its box's edges (3,).
    """

    placements: list[AssetPlacement]
    instances: tuple[str, ...]
    sizes_m: list[FloatArray]
    street_from_world: FloatArray

    @property
    def first_actor(self) -> int:
        """Number of the first actor's placement."""
        return len(self.placements) - len(self.instances)


def make_world(street: Street, drive: Drive) -> StreetWorld:
    """The world of a recorded or edited drive of that street. Raises `ScenarioError` where the street
    lacks an appearance."""
    actors = with_windows(drive, drive.labelled_actors)  # less an ego body that no sensor sees
    return _placed(street, street_origin(drive.world_origin), actors, drive.static_removals, drive.static_copies)


def world_of_state(street: Street, street_from_world: FloatArray, state: WorldState) -> StreetWorld:
    """The world of one exposure. Raises `ScenarioError` where the street lacks an appearance."""
    return _placed(street, street_from_world, state.actors, state.removed_boxes, state.static_copies)


def _placed(
    street: Street,
    street_from_world: FloatArray,
    actors: Sequence[Actor],
    removals: Sequence[Box],
    copies: Sequence[StaticCopy],
) -> StreetWorld:
    """The world of actors in the order of their ids, with finite presence."""
    holes = tuple(_moved(street_from_world, box) for box in removals)
    placements = [AssetPlacement("ground", street.ground), AssetPlacement("static", street.static, holes=holes)]
    for copy in copies:
        source = _moved(street_from_world, copy.source)
        street_from_asset = street_from_world @ copy.world_from_target @ invert_pose(source.world_from_box)
        motion = Trajectory.from_poses(np.zeros(1), street_from_asset[None])
        placements.append(AssetPlacement(copy.uid, street.static, motion, clip=source))
    for actor in actors:
        motion = actor.world_from_actor.transformed(left=street_from_world)
        scale = np.array(actor.scale) if actor.is_scaled else None
        window = actor.start_s, actor.end_s
        placements.append(AssetPlacement(actor.uid, asset_of(street, actor), motion, window, scale=scale))
    uids = tuple(actor.uid for actor in actors)
    return StreetWorld(placements, uids, [actor.size_m for actor in actors], street_from_world)


def asset_of(street: Street, actor: Actor) -> Asset:
    """What an actor looks like."""
    appearance = actor.appearance
    source = street
    if appearance.mesh:
        raise ScenarioError(
            f"actor {actor.uid!r} is the mesh {appearance.mesh}, which a street's own renderer does not draw"
        )
    if appearance.scene:
        if appearance.scene not in street.others:
            raise ScenarioError(
                f"actor {actor.uid!r} looks like {appearance.actor!r} of {appearance.scene!r}, a scene whose street is not known"
            )
        source = street.others[appearance.scene]
    if appearance.actor not in source.assets:
        raise ScenarioError(
            f"actor {actor.uid!r} looks like {appearance.actor!r}, which street {source.recipe.seed} does not have"
        )
    return source.assets[appearance.actor]


def _moved(pose: FloatArray, box: Box) -> Box:
    return Box(pose @ box.world_from_box, np.asarray(box.size_m, np.float64))
