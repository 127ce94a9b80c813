"""Restriction of a state to what one exposure can see: actors and boxes that none of its rays can hit are left out.

The test is conservative. A camera's frustum is dilated by `PAD_PIXELS`, and each box by its movement in the camera's
frame while the shutter is open. A sweep sees all round, as far as the LiDAR's range. Contact shadows, and the ground
that meshes are lit from, matter beside a pixel's own ray: see `Reach`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..geometry import UNIT_BOX_CORNERS, BoolArray, FloatArray, make_pose
from ..sensors.silhouettes import spheres_in_cone, view_half_angle
from ..world.drive import Actor, Box, Camera, CameraModel, Lidar, StaticCopy
from ..world.light import Sun
from ..world.replay import PaddedKeys, WorldState

PAD_PIXELS = 4
"""Margin around an image, in pixels: cells of several pixels may extend beyond its edges."""
EXPOSURE_MOMENTS = 5
"""Number of times in an exposure at which boxes are tested against the frustum."""
BOX_SLACK_M = 0.05
SHADOW_REACH_M, FALLING_M = 20.0, 1.0
"""Largest distance along the ground over which a shadow is followed, and the fall of the ground over it."""
STATIC_SLACK_M = 0.5
"""Margin around removed boxes, metres, within which the static world may have been changed."""


@dataclass(frozen=True)
class Reach:
    """Distances, metres, over which a frame depends on what its own rays do not hit: ``shadow_m`` is the reach of
    contact shadows beside inserted actors, ``changed_m`` of those beside all that an edit has changed, where a state has
    light; ``light_m`` the distance around a mesh's box within which the ground lights it. ``whole``: the frame depends
    on all of its state, wherever the sensor looks."""

    shadow_m: float = 0.0
    light_m: float = 0.0
    changed_m: float = 0.0
    whole: bool = False


def seen_by(state: WorldState, sensor: Camera | Lidar, reach: Reach) -> WorldState:
    """Return the state with only those actors, static copies and removed boxes that the sensor's
    frame can depend on."""
    actors = tuple(actor for actor in state.actors if actor.visible_to(sensor))
    light = None if isinstance(sensor, Lidar) else state.light
    # the road reflects what the sensor does not see, spray drifts into its view, and lamps shine into it
    if reach.whole or (state.weather is not None and state.weather.reaches_far):
        return replace(state, actors=actors, light=light).with_changes_alone()
    boxes = [copy_box(copy) for copy in state.static_copies] + list(state.removed_boxes)
    moments = np.linspace(state.start_s, state.end_s, EXPOSURE_MOMENTS)
    corners = np.concatenate([_actor_corners(actors, moments, reach), _box_corners(boxes, len(moments))])
    if light is not None:
        changed = np.array([actor.uid in light.changed for actor in actors] + [True] * len(boxes))
        sizes = [actor.size_m for actor in actors] + [box.size_m for box in boxes]
        corners = _with_shadows(corners, light.sun, sizes, changed, reach)
    if isinstance(sensor, Lidar):
        visible = _in_range(corners, sensor, moments)
    else:
        poses = sensor.world_from_camera.at(moments)
        visible = _in_frustum(corners, sensor.model, poses)
        lit = [i for i, actor in enumerate(actors) if actor.appearance.mesh and visible[i]]
        visible |= beside_lines_of_sight(corners[:, :, :8], lit, poses[:, :3, 3], reach.light_m)
    seen, copies = visible[: len(actors)], visible[len(actors) : len(actors) + len(state.static_copies)]
    removed = visible[len(actors) + len(state.static_copies) :]
    visible_state = replace(
        state,
        actors=_chosen(actors, seen),
        static_copies=_chosen(state.static_copies, copies),
        removed_boxes=_chosen(state.removed_boxes, removed),
        light=light,
    )
    return visible_state.with_changes_alone()


def shadow_reach_m(sun: Sun, size_m: FloatArray) -> float:
    """Return how far along the sun's rays, metres, the shadow of a box of edges ``size_m`` (3,) is followed: to the
    ground below it, and some further where that falls away, but not over more than `SHADOW_REACH_M` of it."""
    elevation = np.radians(sun.elevation_deg)
    return float(min((size_m[2] + FALLING_M) / np.sin(elevation), SHADOW_REACH_M / max(np.cos(elevation), 1e-3)))


def copy_box(copy: StaticCopy) -> Box:
    """Return the box in which a static copy stands."""
    return Box(copy.world_from_target, copy.source.size_m)


def _chosen(items: Sequence, mask: BoolArray) -> tuple:  # type: ignore[type-arg]
    return tuple(item for item, is_chosen in zip(items, mask, strict=True) if is_chosen)


def _with_shadows(
    corners: FloatArray, sun: Sun, sizes: Sequence[FloatArray], changed: BoolArray, reach: Reach
) -> FloatArray:
    """Return corners (N, T, 16, 3) of boxes with ``corners`` and ``sizes`` and of the ends of their shadows, where they
    are ``changed`` (N,)."""
    cast = np.array([shadow_reach_m(sun, size) for size in sizes])[:, None, None, None] * sun.direction * sun.casts
    middle = corners.mean(2, keepdims=True)
    wider = 1 + 2 * reach.changed_m / np.array([np.min(size) for size in sizes])
    near = middle + (corners - middle) * wider[:, None, None, None]
    return np.where(
        changed[:, None, None, None], np.concatenate([near, near - cast], 2), np.tile(corners, (1, 1, 2, 1))
    )


def _actor_corners(actors: Sequence[Actor], moments: FloatArray, reach: Reach) -> FloatArray:
    """Return corners (A, T, 8, 3) of actors' boxes, world frame, with their contact shadows."""
    sizes = np.array([actor.size_m for actor in actors]).reshape(-1, 3)
    sizes = sizes + 2 * np.where([[actor.inserted] for actor in actors], reach.shadow_m, 0.0).reshape(-1, 1)
    keys = PaddedKeys.of(actors)
    poses = make_pose(keys.positions_at(moments), keys.quaternions_at(moments))
    local = UNIT_BOX_CORNERS * sizes[:, None]
    return np.einsum("atij,akj->atki", poses[..., :3, :3], local) + poses[:, :, None, :3, 3]


def _box_corners(boxes: Sequence[Box], moments: int) -> FloatArray:
    """Return corners (B, T, 8, 3) of boxes that stand still, world frame."""
    poses = np.array([box.world_from_box for box in boxes]).reshape(-1, 4, 4)
    local = UNIT_BOX_CORNERS * (np.array([box.size_m for box in boxes]).reshape(-1, 1, 3) + 2 * STATIC_SLACK_M)
    corners = np.einsum("bij,bkj->bki", poses[:, :3, :3], local) + poses[:, None, :3, 3]
    return np.repeat(corners[:, None], moments, 1)


def _in_frustum(corners: FloatArray, model: CameraModel, poses: FloatArray) -> BoolArray:
    """Return which boxes, corners (N, T, 8, 3), are not wholly outside one plane of the frustum at some time; poses (T,
    4, 4). Through a lens that bends lines: whose spheres are not wholly outside the cone of the image's rays."""
    local = np.einsum("tji,ntkj->ntki", poses[:, :3, :3], corners - poses[:, None, :3, 3])
    if not model.is_pinhole:
        return _in_cone(local, model)
    left, right = (-PAD_PIXELS - model.cx) / model.fx, (model.width + PAD_PIXELS - model.cx) / model.fx
    top, bottom = (-PAD_PIXELS - model.cy) / model.fy, (model.height + PAD_PIXELS - model.cy) / model.fy
    planes = np.array([[0, 0, 1], [1, 0, -left], [-1, 0, right], [0, 1, -top], [0, -1, bottom]], float)
    planes /= np.linalg.norm(planes, axis=1, keepdims=True)
    # how far a box moves in the camera's frame from one moment to the next
    moved = np.linalg.norm(np.diff(local, axis=1), axis=-1).max((1, 2), initial=0.0)
    inside = (local @ planes.T).max(2) + (moved + BOX_SLACK_M)[:, None, None] >= 0
    return np.asarray(inside.all(-1).any(-1))


def _in_cone(local: FloatArray, model: CameraModel) -> BoolArray:
    """Return which boxes, corners (N, T, 8, 3) in the camera's frame, the cone of an image's rays may touch at some
    time."""
    middle = local.mean(2)
    moved = np.linalg.norm(np.diff(local, axis=1), axis=-1).max((1, 2), initial=0.0)
    radii = np.linalg.norm(local - middle[:, :, None], axis=-1).max(-1) + (moved + BOX_SLACK_M)[:, None]
    return np.asarray(spheres_in_cone(middle, radii, view_half_angle(model, PAD_PIXELS)).any(-1))


def _in_range(corners: FloatArray, lidar: Lidar, moments: FloatArray) -> BoolArray:
    """Return which boxes, corners (N, T, 8, 3), a LiDAR can measure: nearer than its range at some time."""
    origins = lidar.world_from_lidar.at(moments)[:, :3, 3]
    middle = corners.mean(2)
    radius = np.linalg.norm(corners - middle[:, :, None], axis=-1).max(-1)
    return np.asarray((np.linalg.norm(middle - origins, axis=-1) - radius < lidar.model.max_range_m + 1.0).any(-1))


def beside_lines_of_sight(corners: FloatArray, lit: Sequence[int], origins: FloatArray, reach_m: float) -> BoolArray:
    """Return which boxes, corners (N, T, 8, 3), world frame, or (N, 1, 8, 3) where they stand still, lie on the way
    from the camera at ``origins`` (T, 3) to the ground around one of the boxes ``lit``, or behind it: (N,) bool."""
    assert origins.shape == (corners.shape[1], 3) or corners.shape[1] == 1, (corners.shape, origins.shape)
    out = np.zeros(len(corners), bool)
    to = corners.mean(2) - origins
    distance = np.maximum(np.linalg.norm(to, axis=-1), 1e-6)
    radius = np.linalg.norm(corners - corners.mean(2)[:, :, None], axis=-1).max(-1)
    half = np.arcsin(np.clip(radius / distance, 0, 1))
    for i in lit:
        aim = np.arcsin(np.clip((radius[i] + reach_m) / distance[i], 0, 1))
        cosine = np.clip((to * to[i]).sum(-1) / (distance * distance[i]), -1, 1)
        out |= (np.arccos(cosine) <= half + aim).any(-1)
    return out
