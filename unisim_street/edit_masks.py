"""Which pixels an edit changes, itself or by its shadow, and which show what the recording never saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.geometry import BoolArray, FloatArray, invert_pose, transform_points
from unisim_blender.core.sensors.camera import camera_rays, line_count, line_times, lines
from unisim_blender.core.world.drive import Camera, Drive

from .street import Street
from .tracing.bundles import make_bundles, untile_image
from .tracing.surface_hits import Surfaces, look_up
from .tracing.trace import Asset, trace
from .truth import TracedView, contact, resize, strips, sun_visibility, trace_view
from .world import StreetWorld, make_world

_SAME_M = 1e-4
"""Hits of one asset nearer together than this, both on the asset and along the ray, are the same."""
_VISIBLE_M = 0.02
"""A recorded ray aimed at a point sees it where it ends this near to it."""
_SHADE = 0.01
"""Least change of the sky's share that counts as a shadow's."""
_FAR_M = 1e6


@dataclass(frozen=True)
class EditMasks:
    """Masks (H, W) of an image of the edited drive, beside the unedited world seen from the same camera.

    edited: another thing, or another point of it, is seen. shadow: not edited, but the sun's or the sky's light
    differs. seen: the pixel's surface point was seen in some image of the training frames, an actor's point wherever
    the actor was then.
    """

    edited: BoolArray
    shadow: BoolArray
    seen: BoolArray


def edit_masks(
    street: Street,
    recorded: Drive,
    edited: Drive,
    camera_id: str,
    frame: int,
    train_frames: Sequence[int],
    train_cameras: Sequence[str] | None = None,
    width: int | None = None,
    samples: int = 2,
) -> EditMasks:
    """Masks of one image of ``edited``; a pixel is edited or shadowed where one of its samples x samples rays is.

    The training images are those of ``train_cameras`` (None: all that ``recorded`` has) at ``train_frames``; for an
    actor of another street those of its own drive's cameras at the same frame numbers.
    """
    camera = resize(edited.cameras[camera_id], width)
    worlds = [make_world(street, drive) for drive in (recorded, edited)]
    recordings = [_Recording(worlds[0], [recorded.cameras[name] for name in (train_cameras or recorded.cameras)])]
    recordings += [
        _Recording(make_world(other, other.drive), list(other.drive.cameras.values()))
        for other in street.others.values()
    ]
    near_first = sorted(train_frames, key=lambda other: (abs(other - frame), other))
    parts = []
    for rows in strips(camera, samples):
        view = trace_view(worlds[1], camera, camera.time_s[frame], 1, rows, painted=False)
        parts.append((*_changes(worlds, camera, frame, samples, rows), _seen(recordings, worlds[1], view, near_first)))
    return EditMasks(*(np.concatenate(mask) for mask in zip(*parts, strict=True)))


def _changes(
    worlds: list[StreetWorld], camera: Camera, frame: int, samples: int, rows: tuple[int, int]
) -> tuple[BoolArray, BoolArray]:
    """Which pixels of rows differ between two worlds, and which in their light alone."""
    before, after = (trace_view(world, camera, camera.time_s[frame], samples, rows, painted=False) for world in worlds)
    changed = ~_same(worlds[0], before, worlds[1], after)
    light = [_light(world, view, samples) for world, view in zip(worlds, (before, after), strict=True)]
    shaded = ~changed & (np.abs(light[0] - light[1]) > _SHADE).any(-1)
    edited, shadow = (_any_sample(mask, after, samples) for mask in (changed, shaded))
    return edited, shadow & ~edited


@dataclass(frozen=True)
class _Recording:
    """A recorded world and the cameras that recorded it: the drive's own, or the one an inserted actor comes from."""

    world: StreetWorld
    cameras: list[Camera]


def _any_sample(mask: BoolArray, view: TracedView, samples: int) -> BoolArray:
    image = untile_image(mask.reshape(view.bundles.shape), view.height, view.width)
    return np.asarray(image.reshape(view.height // samples, samples, view.width // samples, samples).any((1, 3)))


def _keys(world: StreetWorld, view: TracedView) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """For every flat ray: its asset's id or 0, the point in the asset's frame, and t."""
    seen = view.surfaces
    count = view.hits.t.size
    ids, local = np.zeros(count, np.int64), np.zeros((count, 3))
    ids[seen.rays] = _asset_ids(world)[seen.placement]
    local[seen.rays] = seen.local
    return ids, local, view.hits.t.reshape(-1)


def _asset_ids(world: StreetWorld) -> NDArray[np.int64]:
    return np.array([id(placement.asset) for placement in world.placements])


def _same(world_a: StreetWorld, a: TracedView, world_b: StreetWorld, b: TracedView) -> BoolArray:
    """Whether flat rays (M,) end on the same point of the same asset, or both in the sky."""
    ids_a, local_a, t_a = _keys(world_a, a)
    ids_b, local_b, t_b = _keys(world_b, b)
    hit = np.isfinite(t_a) & np.isfinite(t_b)
    apart = np.where(hit, t_a, 0) - np.where(hit, t_b, 0)
    near = (np.abs(apart) <= _SAME_M) & (np.abs(local_a - local_b).max(-1) <= _SAME_M)
    return np.asarray((ids_a == ids_b) & near)


def _light(world: StreetWorld, view: TracedView, samples: int) -> FloatArray:
    """Sun and openness (M, 2) of every flat ray's surface."""
    time = view.bundles.time_s.reshape(-1)
    out = np.ones((len(time), 2))
    out[view.surfaces.rays, 0] = sun_visibility(world, view.surfaces, time, view.subsample, samples)
    out[view.surfaces.rays, 1] = contact(world, view.surfaces, time)
    return out


def _seen(
    recordings: list[_Recording], edited: StreetWorld, view: TracedView, train_frames: Sequence[int]
) -> BoolArray:
    """Which of a view's pixels, one ray each, some training image shows."""
    done = np.zeros(view.hits.t.size, bool)
    for recording in recordings:
        places: dict[Asset, int] = {
            placement.asset: number for number, placement in enumerate(recording.world.placements)
        }
        targets = _Targets.of(view, np.array([places.get(placement.asset, -1) for placement in edited.placements]))
        for frame in train_frames:
            for source in recording.cameras:
                if frame in source.time_s:
                    open_rays = np.flatnonzero(~done & (targets.placement >= -1))
                    done[open_rays] = _visible(recording.world, source, frame, targets, open_rays)
    return np.asarray(untile_image(done.reshape(view.bundles.shape), view.height, view.width))


@dataclass(frozen=True)
class _Targets:
    """What is looked for: placement (M,) in the recorded world, -1 the sky, -2 what the recording does not have; and
    its point (M, 3) in the asset's frame, for the sky a direction."""

    placement: NDArray[np.int64]
    local: FloatArray

    @staticmethod
    def of(view: TracedView, seen_by: NDArray[np.int64]) -> _Targets:
        surfaces: Surfaces = view.surfaces
        placement = np.full(view.hits.t.size, -1)
        local = view.bundles.directions.reshape(-1, 3).copy()
        found = seen_by[surfaces.placement]
        placement[surfaces.rays] = np.where(found < 0, -2, found)
        local[surfaces.rays] = surfaces.local
        return _Targets(placement, local)


def _visible(world: StreetWorld, camera: Camera, frame: int, targets: _Targets, chosen: NDArray[np.int64]) -> BoolArray:
    """Whether the recorded image shows the chosen targets: (C,)."""
    out = np.zeros(len(chosen), bool)
    time = np.full(len(chosen), camera.time_s[frame])
    for _ in range(3):  # a line's time depends on the line: with 30 ms a frame this ends far below a pixel
        points = _where(world, targets, chosen, time)
        u, v, ahead = _project(world, camera, points, time)
        v = np.where(ahead, v, -1.0)
        line = np.where(ahead, lines(camera.model, u, v), -1.0)
        time = line_times(camera, camera.time_s[frame], np.clip(line, 0, line_count(camera.model)))
    model = camera.model
    inside = np.flatnonzero(ahead & (u >= 0) & (u < model.width) & (v >= 0) & (v < model.height))
    if not len(inside):
        return out
    k = 256
    order = np.concatenate([inside, np.full(-len(inside) % k, inside[-1])])
    rays = camera_rays(camera, camera.time_s[frame], u[order], v[order])
    o = transform_points(world.street_from_world, rays.origins)
    bundles = make_bundles(*(a.reshape(-1, k, *a.shape[1:]) for a in (o, rays.directions, rays.time_s)))
    hits = trace(world.placements, bundles)
    wanted = targets.placement[chosen[order]]
    sky = ~np.isfinite(hits.t).reshape(-1) & (wanted == -1)
    surfaces = look_up(world.placements, hits, o, rays.directions, rays.time_s, 0.0, painted=False)
    apart = np.linalg.norm(surfaces.local - targets.local[chosen[order]][surfaces.rays], axis=1)
    sky[surfaces.rays] = (surfaces.placement == wanted[surfaces.rays]) & (apart <= _VISIBLE_M)
    out[order] = sky
    return out


def _where(world: StreetWorld, targets: _Targets, chosen: NDArray[np.int64], time_s: FloatArray) -> FloatArray:
    """Where the targets (C,) are at times (C,), street frame (C, 3)."""
    placement, out = targets.placement[chosen], targets.local[chosen].copy()
    out[placement == -1] *= _FAR_M
    for number in np.unique(placement[placement >= 0]):
        motion, scale = world.placements[number].motion, world.placements[number].scale
        if motion is not None:
            rows = np.flatnonzero(placement == number)
            if scale is not None:
                out[rows] *= scale
            poses = motion.at(time_s[rows])
            out[rows] = np.einsum("nij,nj->ni", poses[:, :3, :3], out[rows]) + poses[:, :3, 3]
    return out


def _project(
    world: StreetWorld, camera: Camera, points: FloatArray, time_s: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """u, v (C,) of street points (C, 3) at times (C,), and whether they lie ahead of the camera, in its lens's valid domain."""
    camera_from_street = invert_pose(world.street_from_world @ camera.world_from_camera.at(time_s))
    local = np.einsum("nij,nj->ni", camera_from_street[:, :3, :3], points) + camera_from_street[:, :3, 3]
    if not camera.model.is_pinhole:
        return camera.model.project(local)
    ahead = local[:, 2] > 0.05
    z = np.where(ahead, local[:, 2], 1.0)
    model = camera.model
    return model.fx * local[:, 0] / z + model.cx, model.fy * local[:, 1] / z + model.cy, ahead
