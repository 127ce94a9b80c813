"""The ground truth of edits on a street, frame by frame: the captures of a scenario's cameras and LiDARs, and edit masks.

A mask holds the pixels that an edit changes, itself or by its shadow, and those that show what the recording never saw.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.data.images import resize_image
from unisim_blender.core.evaluation.ground_truth import TrueImages, Version
from unisim_blender.core.evaluation.metrics import ImageArray
from unisim_blender.core.evaluation.truth import EditRegions
from unisim_blender.core.geometry import BoolArray, FloatArray, invert_pose, transform_points
from unisim_blender.core.prepare.scenario import PreparedScenario
from unisim_blender.core.sensors.camera import camera_rays, line_count, line_times, lines
from unisim_blender.core.sensors.frames import LidarFrame
from unisim_blender.core.world.drive import Camera, Drive

from .drawing.image_setup import lacks_images, true_image
from .drawing.path_tracer import TruthRequest, draw_truths
from .street import RECIPE_FILE, Street, load_street, recipe_document, street_of
from .tracing.surface_hits import Surfaces, look_up
from .tracing.trace import Asset, make_bundles, trace, untile_image
from .truth import (
    StreetWorld,
    TracedView,
    contact,
    lamplight,
    make_world,
    resize,
    strips,
    sun_visibility,
    trace_view,
    truth_camera,
    truth_lidar,
)
from .usual_edits import SCENARIOS_FOLDER, write_scenarios

_SAME_HIT_M = 1e-4
"""Hits of one asset nearer together than this, both on the asset and along the ray, are the same."""
_VISIBILITY_TOLERANCE_M = 0.02
"""A recorded ray aimed at a point sees it where it ends this near to it."""
_MIN_SHADOW_SHARE = 0.01
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
    shaded = ~changed & (np.abs(light[0] - light[1]) > _MIN_SHADOW_SHARE).any(-1)
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
    near = (np.abs(apart) <= _SAME_HIT_M) & (np.abs(local_a - local_b).max(-1) <= _SAME_HIT_M)
    return np.asarray((ids_a == ids_b) & near)


def _light(world: StreetWorld, view: TracedView, samples: int) -> FloatArray:
    """Sun, openness and lamplight (M, 3) of every flat ray's surface."""
    time = view.bundles.time_s.reshape(-1)
    out = np.ones((len(time), 3))
    out[view.surfaces.rays, 0] = sun_visibility(world, view.surfaces, time, view.subsample, samples)
    out[view.surfaces.rays, 1] = contact(world, view.surfaces, time)
    out[view.surfaces.rays, 2] = lamplight(world, view.surfaces, time)
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
    """Targets of a search: placement (M,) in the recorded world, -1 the sky, -2 what the recording does not have; and
    its point (M, 3) in the asset's frame, for the sky a direction."""

    placement: NDArray[np.int64]
    local: FloatArray

    @staticmethod
    def of(view: TracedView, seen_by: NDArray[np.int64]) -> _Targets:
        surfaces: Surfaces = view.surfaces
        placement = np.full(view.hits.t.size, -1)
        local = view.bundles.directions.reshape(-1, 3).copy()
        seen = seen_by[surfaces.placement]
        placement[surfaces.rays] = np.where(seen < 0, -2, seen)
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
    sky[surfaces.rays] = (surfaces.placement == wanted[surfaces.rays]) & (apart <= _VISIBILITY_TOLERANCE_M)
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


@dataclass(frozen=True)
class StreetTruth:
    """A scenario on the street at ``path``: the drive as it was recorded and edited, with the log's own poses; the
    frames and cameras that count as seen; the images' width."""

    path: Path
    street: Street
    recorded: Drive
    edited: Drive
    trained_frames: tuple[int, ...]
    trained_cameras: tuple[str, ...]
    width: int | None

    def draw(self, scenario: Path, frames: tuple[int, ...], cameras: tuple[str, ...]) -> None:
        """Have the images drawn that only a path tracer can draw, and that are not there. Raises `UnisimError`."""
        if lacks_images(self.path, self.street, (self.edited, self.recorded), cameras, frames, self._drawn_width):
            draw_truths(self.path, (TruthRequest(scenario, frames, cameras),), self._drawn_width, progress=True)

    def images(self, camera: str, frame: int) -> TrueImages:
        """Return the true images of a camera at a frame, and the regions of the edits. Raises `UnisimError`."""
        masks = edit_masks(
            self.street,
            self.recorded,
            self.edited,
            camera,
            frame,
            self.trained_frames,
            self.trained_cameras or None,
            self.width,
        )
        return TrueImages(
            self.image("edit", camera, frame),
            self.image("replay", camera, frame) if camera in self.recorded.cameras else None,
            EditRegions(masks.edited, masks.shadow, masks.seen),
        )

    def image(self, version: Version, camera: str, frame: int) -> ImageArray:
        """Return the image (H, W, 3) of a camera of the drive, drawn now, or by Cycles before. Raises `UnisimError`."""
        drive = self.drive(version)
        if self.street.recipe.engine == "exact":
            return truth_camera(self.street, drive, camera, frame, self.width).rgb
        drawn = true_image(self.path, self.street, drive, camera, frame, self._drawn_width)
        return resize_image(drawn, resize(drive.cameras[camera], self.width).model).astype(np.float32) / np.float32(255)

    def sweep(self, version: Version, lidar: str, frame: int) -> LidarFrame | None:
        """Return the sweep of a LiDAR, with exact ranges; None for a recorded drive that has no such LiDAR."""
        drive = self.drive(version)
        return truth_lidar(self.street, drive, lidar, frame) if lidar in drive.lidars else None

    def drive(self, version: Version) -> Drive:
        """The drive, as edited or as recorded."""
        return self.edited if version == "edit" else self.recorded

    @property
    def _drawn_width(self) -> int | None:
        """The width at which Cycles draws: the cameras' own, and smaller images are made of those as of recorded ones,
        so they are as sharp and need not be drawn again; only what is wider is drawn wider."""
        own = min((camera.model.width for camera in self.edited.cameras.values()), default=0)
        return None if self.width is None or self.width <= own else self.width


@dataclass(frozen=True)
class KnownStreet:
    """The street whose log is at ``path``; see `KnownLog`."""

    path: Path
    street: Street

    @property
    def name(self) -> str:
        """See `KnownLog.name`."""
        return self.street.drive.name

    @property
    def recipe(self) -> dict[str, Any]:
        """See `KnownLog.recipe`."""
        document: dict[str, Any] = json.loads(json.dumps(recipe_document(self.street.recipe)))
        return document

    def truth(
        self, prepared: PreparedScenario, frames: tuple[int, ...], cameras: tuple[str, ...], width: int | None
    ) -> StreetTruth:
        """See `KnownLog.truth`."""
        seen = tuple(name for name in cameras if name in prepared.recorded.cameras)
        street = street_of(self.street, prepared.scenes.others(prepared.edited))
        return StreetTruth(self.path, street, prepared.recorded, prepared.edited, frames, seen, width)

    def usual_edits(self, out: Path) -> tuple[Path, ...]:
        """See `KnownLog.usual_edits`."""
        return tuple(sorted((self.path / SCENARIOS_FOLDER).glob("*.json"))) or write_scenarios(
            self.street, out, self.path
        )


class KnownStreets:
    """Logs of procedural streets; see `KnownLogs`."""

    name: ClassVar[str] = "street"

    @staticmethod
    def recognises(path: Path) -> bool:
        """See `KnownLogs.recognises`."""
        return (path / RECIPE_FILE).is_file()

    @staticmethod
    def open(path: Path) -> KnownStreet:
        """See `KnownLogs.open`."""
        return KnownStreet(path, load_street(path))
