"""Pixels of an image, or beams of a sweep, that can differ between two frames of a sensor.

The answer is conservative: pixels and beams outside of it have the same bits, if both frames have the same rays and
settings. Two frames at one time have the same rays. Frames at different times have them if the sensor stands and the
backend is steady (`Renderer.is_steady`). What a single frame depends on: `visibility.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ..geometry import BoolArray, FloatArray, Trajectory, box_corners, invert_pose
from ..sensors.rays import Rays
from ..sensors.silhouettes import covered
from ..world.classes import motion_of
from ..world.drive import Actor, Box, Camera, Lidar
from ..world.light import Sun
from ..world.replay import WorldState
from .lattice import Region
from .renderer import Renderer
from .visibility import (
    BOX_SLACK_M,
    EXPOSURE_MOMENTS,
    STATIC_SLACK_M,
    Reach,
    beside_lines_of_sight,
    copy_box,
    shadow_reach_m,
)

ItemT = TypeVar("ItemT")
APPEARANCE_MEMBERS = ("label", "appearance", "is_moving", "inserted", "is_ego_body", "scale", "lamps")
"""Members of an actor that define its look, beside its size."""
MESH_MARGIN_PX = 2
"""Margin in pixels around meshes, which are traced by several rays about a pixel's middle."""
REGION_COST_PX = 1024
"""Cost of one more region, in pixels."""


@dataclass(frozen=True)
class RenderedState:
    """The input of a frame: its state, ``about`` all else but the actors and the static boxes, and the number of pixels
    beside a ray's own that depend on it (`Renderer.margin`; 0 for a sweep)."""

    state: WorldState
    about: tuple[object, ...]
    margin: int = 0

    def comparable(self, other: RenderedState) -> bool:
        """Return whether frames of the two differ by actors and static boxes alone, each where they are. In snow that takes
        one time; wet ground reflects them, and lamps shine, elsewhere; the light of the air depends on neither
        (`Renderer.air`)."""
        weather = self.state.weather
        if self.about != other.about or self.margin != other.margin or weather != other.state.weather:
            return False
        return weather is None or not (weather.reaches_far or (weather.snow_mm_h and not self.at_the_time_of(other)))

    def at_the_time_of(self, other: RenderedState) -> bool:
        """Return whether the states have the same window of time."""
        return (self.state.start_s, self.state.end_s) == (other.state.start_s, other.state.end_s)


@dataclass(frozen=True)
class ChangedActor:
    """An actor as one of two states has it, from ``start_s`` to ``end_s``: it moves, or differs in the other."""

    actor: Actor
    start_s: float
    end_s: float

    def swept(self, reach: Reach, overhang_m: float, keys_s: Sequence[float] | FloatArray = ()) -> SweptBox:
        """Return what the actor covers, with what it shows beside its own box (``overhang_m``) and its contact shadow.
        ``keys_s`` are further times at which its box is wanted."""
        keys = np.concatenate([self.actor.world_from_actor.times_s, keys_s])
        inside = keys[(keys > self.start_s) & (keys < self.end_s)]
        times = np.union1d(inside, np.linspace(self.start_s, self.end_s, EXPOSURE_MOMENTS))
        poses = self.actor.world_from_actor.at(times)
        beside = BOX_SLACK_M + overhang_m + _furthest_step(poses, float(np.linalg.norm(self.actor.size_m)) / 2)
        return SweptBox(
            times, poses, self.actor.size_m + 2 * (beside + (reach.shadow_m if self.actor.inserted else 0.0))
        )


@dataclass(frozen=True)
class SweptBox:
    """A box of ``size_m`` (3,), with poses (K, 4, 4) in the world at ``times_s`` (K,): there it holds all that
    something covers from the first time to the last."""

    times_s: FloatArray
    poses: FloatArray
    size_m: FloatArray

    def shadow(self, sun: Sun, beside_m: float) -> SweptBox:
        """Return what the shadow of the box covers on its way, and what is within ``beside_m`` of it."""
        cast = shadow_reach_m(sun, self.size_m) * sun.direction * sun.casts
        poses = self.poses.copy()
        poses[:, :3, 3] -= cast / 2
        return SweptBox(self.times_s, poses, self.size_m + np.abs(cast @ poses[:, :3, :3]).max(0) + 2 * beside_m)

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return one box that holds all of it: pose (4, 4) in the world, size (3,)."""
        pose = self.poses[len(self.poses) // 2].copy()
        corners = np.concatenate([box_corners(at, self.size_m) for at in invert_pose(pose) @ self.poses])
        low, high = corners.min(0), corners.max(0)
        pose[:3, 3] += pose[:3, :3] @ ((low + high) / 2)
        return pose, high - low

    def region(self, camera: Camera, start_s: float, end_s: float, margin: int) -> Region:
        """Return the region of a camera's image, exposed from ``start_s`` to ``end_s``, whose pixels may show it;
        ``margin`` as of `RenderedState`."""
        times = np.clip(self.times_s - self.times_s[0] + start_s, start_s, end_s)
        cameras = camera.world_from_camera.at(times)
        local = invert_pose(cameras) @ self.poses
        far = float(np.linalg.norm(local[:, :3, 3], axis=1).max()) + float(np.linalg.norm(self.size_m)) / 2
        size = self.size_m + 2 * _furthest_step(cameras, far)
        silhouette = covered(camera.model, local[:1] if (local == local[0]).all() else local, size)
        if silhouette is None:
            return Region(0, 0, 0, 0)
        low = np.floor(silhouette[:2]) - MESH_MARGIN_PX - margin
        high = np.ceil(silhouette[2:]) + MESH_MARGIN_PX + margin
        # far outside of an image there are no integers
        low, high = np.clip(low, -1, 1 << 30), np.clip(high, -1, 1 << 30)
        return Region(int(low[0]), int(low[1]), int(high[0]), int(high[1])).within_image(camera.model)


def changed_regions(
    renderer: Renderer, before: RenderedState, after: RenderedState, camera: Camera
) -> list[Region] | None:
    """Return the regions outside of which a camera's images of two states have the same bits; None where all pixels may
    differ. ``camera`` is that of the second image."""
    state = after.state
    if not before.comparable(after) or renderer.backend.sees_all:
        return None
    trajectory = camera.world_from_camera
    if standing_pose(trajectory, state.start_s, state.end_s) is None and not before.at_the_time_of(after):
        return None
    actors, static = changed_actors(before.state, state, camera), changed_static(before.state, state)
    if static is None:
        return None
    swept = _swept(renderer, actors, static, state, trajectory.times_s)
    suns = {each.light.sun for each in (before.state, state) if each.light is not None}
    if len(suns) > 1:
        return None
    swept += [box.shadow(sun, renderer.reach.changed_m) for sun in suns for box in swept]
    swept += _relit(renderer, state, camera, actors, swept)
    regions = [box.region(camera, state.start_s, state.end_s, after.margin) for box in swept]
    return joined_where_cheaper([region for region in regions if region.area])


def changed_beams(
    renderer: Renderer, before: RenderedState, after: RenderedState, lidar: Lidar, rays: Rays
) -> BoolArray | None:
    """Return which rays (B, C) of a LiDAR that stands can measure something else in the second state than in the first:
    (B, C) bool; None where all may."""
    if not before.comparable(after) or renderer.backend.sees_all:
        return None
    static = changed_static(before.state, after.state)
    if static is None:
        return None
    swept = _swept(renderer, changed_actors(before.state, after.state, lidar), static, after.state)
    changed = np.zeros(rays.time_s.shape, bool)
    origin, directions, flat = rays.origins[0, 0], rays.directions.reshape(-1, 3), changed.reshape(-1)
    for pose, size in (box.bounds() for box in swept):
        to = pose[:3, 3] - origin
        distance, radius = float(np.linalg.norm(to)), float(np.linalg.norm(size)) / 2
        near = np.arange(len(flat))
        if distance > radius:  # most rays are beside the cone about its sphere
            near = np.flatnonzero(directions @ (to / distance) >= np.sqrt(1 - (radius / distance) ** 2) - 1e-9)
        near = near[~flat[near]]
        inward, start = directions[near] @ pose[:3, :3], -to @ pose[:3, :3]
        safe = np.where(np.abs(inward) < 1e-12, 1e-12, inward)
        a, b = (-size / 2 - start) / safe, (size / 2 - start) / safe
        enter, leave = np.minimum(a, b).max(1), np.maximum(a, b).min(1)
        flat[near] = (enter <= leave) & (leave > 0)
    return changed


def changed_actors(before: WorldState, after: WorldState, sensor: Camera | Lidar) -> list[ChangedActor]:
    """Return the actors that a sensor may see otherwise in the second state, as they are in the first and in the
    second."""
    old, new = ({actor.uid: actor for actor in state.actors} for state in (before, after))
    return [
        ChangedActor(actor, state.start_s, state.end_s)
        for uid in sorted({*old, *new})
        if not (uid in old and uid in new and _is_unchanged(old[uid], new[uid], before, after))
        for actor, state in ((old.get(uid), before), (new.get(uid), after))
        if actor is not None and actor.visible_to(sensor)
    ]


def changed_static(before: WorldState, after: WorldState) -> list[Box] | None:
    """Return the boxes in which the static world differs between two states: those of copies, and removed ones. None
    where it may differ elsewhere, too."""
    removed, copies = (
        [{item.content(): item for item in getattr(state, name)} for state in (before, after)]
        for name in ("removed_boxes", "static_copies")
    )
    for old, new in (removed, copies):
        # those that overlap depend on their order
        if [key for key in old if key in new] != [key for key in new if key in old]:
            return None
    boxes = _only_in_either(*removed)
    # a copy may be of what was removed
    changed = [*copies[0].values(), *copies[1].values()] if boxes else _only_in_either(*copies)
    return boxes + [copy_box(copy) for copy in changed]


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


def joined_where_cheaper(regions: Sequence[Region]) -> list[Region]:
    """Return regions that cover others, joined as long as that saves pixels."""
    joined: list[Region] = []
    for region in regions:
        grown = True
        while grown:
            grown = False
            for other in joined:
                both = region.joined(other)
                if both.area <= region.area + other.area + REGION_COST_PX:
                    joined.remove(other)
                    region, grown = both, True
                    break
        joined.append(region)
    return joined


def _swept(
    renderer: Renderer, actors: Sequence[ChangedActor], static: Sequence[Box], state: WorldState,
    keys_s: Sequence[float] | FloatArray = (),
) -> list[SweptBox]:  # fmt: skip
    """Return what actors and boxes of the static world cover."""
    reach, overhang_m = renderer.reach, renderer.backend.overhang_m
    times = np.linspace(state.start_s, state.end_s, EXPOSURE_MOMENTS)
    return [changed.swept(reach, overhang_m(changed.actor), keys_s) for changed in actors] + [
        SweptBox(times, np.repeat(box.world_from_box[None], EXPOSURE_MOMENTS, 0), box.size_m + 2 * STATIC_SLACK_M)
        for box in static
    ]


def _relit(
    renderer: Renderer, state: WorldState, camera: Camera, changed: Sequence[ChangedActor], swept: Sequence[SweptBox]
) -> list[SweptBox]:
    """Return the unchanged meshes whose light may differ: it is that of the ground about them, on which others may
    stand."""
    uids = {change.actor.uid for change in changed}
    meshes = [
        ChangedActor(actor, state.start_s, state.end_s).swept(Reach(), 0.0)  # contact shadows stay
        for actor in state.actors
        if actor.appearance.mesh and actor.visible_to(camera) and actor.uid not in uids
    ]
    if not meshes or not swept:
        return []
    origins = camera.world_from_camera.at(np.linspace(state.start_s, state.end_s, EXPOSURE_MOMENTS))[:, :3, 3]
    corners = np.stack([box_corners(*box.bounds()) for box in (*meshes, *swept)])[:, None]
    return [
        mesh
        for i, mesh in enumerate(meshes)
        if beside_lines_of_sight(corners, [i], origins, renderer.reach.light_m)[len(meshes) :].any()
    ]


def _only_in_either(old: dict[bytes, ItemT], new: dict[bytes, ItemT]) -> list[ItemT]:
    return [old[key] for key in old if key not in new] + [new[key] for key in new if key not in old]


def _is_unchanged(a: Actor, b: Actor, before: WorldState, after: WorldState) -> bool:
    """Return whether two states show the same of an actor."""
    if any(getattr(a, name) != getattr(b, name) for name in APPEARANCE_MEMBERS):
        return False
    if a.size_m is not b.size_m and not np.array_equal(a.size_m, b.size_m):
        return False
    ways_m = a.world_from_actor.start_walked_m, b.world_from_actor.start_walked_m
    if abs(ways_m[0] - ways_m[1]) > 1e-6 and motion_of(a.label) == "deforming":
        return False  # limbs follow the length of the path
    same_window = (before.start_s, before.end_s, a.start_s, a.end_s) == (after.start_s, after.end_s, b.start_s, b.end_s)
    if same_window and a.world_from_actor.content() == b.world_from_actor.content():
        return True
    pose = _standing(a, before)
    return pose is not None and pose == _standing(b, after)


def _standing(actor: Actor, state: WorldState) -> bytes | None:
    """Return the pose at which an actor stands throughout a state; None where it moves or is not always there."""
    if actor.start_s > state.start_s or actor.end_s < state.end_s:
        return None
    return standing_pose(actor.world_from_actor, state.start_s, state.end_s)


def _furthest_step(poses: FloatArray, radius_m: float) -> float:
    """Return the largest distance, metres, that a point within ``radius_m`` of the origin moves from one of poses (K,
    4, 4) to the next: at most the origin's distance plus the rotation's."""
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    turns = np.linalg.norm(np.diff(poses[:, :3, :3], axis=0), axis=(1, 2)) * radius_m
    return float((steps + turns).max(initial=0.0))
