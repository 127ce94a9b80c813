"""Which actors two states of the world differ in, for a sensor that stands: what stands, too, is the same at all times."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...geometry import FloatArray, Trajectory, box_corners, invert_pose
from ...world.drive import Actor, Camera, Lidar
from ...world.state import WorldState
from ..visibility import MOMENTS, SLACK_M, Reach

LOOK = ("label", "appearance", "is_moving", "inserted", "is_ego_body", "scale")
NOWHERE = Trajectory(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]))


@dataclass(frozen=True)
class Changed:
    """An actor as one of two states has it, from ``start_s`` to ``end_s``: it moves then, or the other has it otherwise."""

    actor: Actor
    start_s: float
    end_s: float

    def bounds(self, reach: Reach, overhang_m: float) -> tuple[FloatArray, FloatArray]:
        """Return one box, its pose (4, 4) in the world and its size (3,), that holds all that the actor covers meanwhile."""
        poses, size = self.swept(reach, overhang_m)
        pose = poses[len(poses) // 2].copy()
        corners = np.concatenate([box_corners(one, size) for one in invert_pose(pose) @ poses])
        low, high = corners.min(0), corners.max(0)
        pose[:3, 3] += pose[:3, :3] @ ((low + high) / 2)
        return pose, high - low

    def swept(self, reach: Reach, overhang_m: float) -> tuple[FloatArray, FloatArray]:
        """Return poses (K, 4, 4) of its box in the world, and the size (3,) of a box that at these holds all that it covers
        meanwhile: with what it shows beside its own box, and with its contact shadow."""
        keys = self.actor.world_from_actor.times_s
        inside = keys[(keys > self.start_s) & (keys < self.end_s)]
        times = np.union1d(inside, np.linspace(self.start_s, self.end_s, MOMENTS))
        poses = self.actor.world_from_actor.at(times)
        half = float(np.linalg.norm(self.actor.size_m)) / 2
        # no point of a box moves further than its centre does and its corners turn about that
        steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
        turns = np.linalg.norm(np.diff(poses[:, :3, :3], axis=0), axis=(1, 2)) * half
        beside = SLACK_M + overhang_m + float((steps + turns).max(initial=0.0))
        return poses, self.actor.size_m + 2 * (beside + (reach.shadow_m if self.actor.inserted else 0.0))


def changed_actors(before: WorldState, after: WorldState, sensor: Camera | Lidar) -> list[Changed]:
    """Return the actors that a sensor may see otherwise in the second state, as they are in the first and in the second."""
    old, new = ({actor.uid: actor for actor in state.actors} for state in (before, after))
    found = []
    for uid in sorted({*old, *new}):
        a, b = old.get(uid), new.get(uid)
        if a is not None and b is not None and _look_alike(a, b):
            pose = _pose(a, before)
            if pose is not None and pose == _pose(b, after):
                continue
        found += [
            Changed(actor, state.start_s, state.end_s)
            for actor, state in ((a, before), (b, after))
            if actor is not None and actor.visible_to(sensor)
        ]
    return found


def static_digest(state: WorldState) -> str:
    """Return a digest of all that a state says but for its actors and its time."""
    return replace(state, start_s=0.0, end_s=0.0, world_from_ego=NOWHERE, actors=()).digest


def standing_pose(trajectory: Trajectory, start_s: float, end_s: float) -> bytes | None:
    """Return the pose at which a trajectory stands between two times, to the bit; None where it moves."""
    keys = trajectory.between(start_s, end_s)
    positions, quaternions = keys.positions, keys.quaternions_wxyz
    if len(positions) > 1:
        if positions[0].tolist() != positions[-1].tolist():  # soon known of what moves
            return None
        if not ((positions == positions[0]).all() and (quaternions == quaternions[0]).all()):
            return None
    return positions[0].tobytes() + quaternions[0].tobytes()


def _pose(actor: Actor, state: WorldState) -> bytes | None:
    """Return the pose at which an actor stands throughout a state; None where it moves or is not always there."""
    if actor.start_s > state.start_s or actor.end_s < state.end_s:
        return None
    return standing_pose(actor.world_from_actor, state.start_s, state.end_s)


def _look_alike(a: Actor, b: Actor) -> bool:
    """Return whether two states of an actor have the same look."""
    told = all(getattr(a, name) == getattr(b, name) for name in LOOK)
    return told and (a.size_m is b.size_m or np.array_equal(a.size_m, b.size_m))
