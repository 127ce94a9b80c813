"""Data that training draws batches from: patches of recorded images, and rays of recorded sweeps, in memory as
float32."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from torch import Tensor

from ...actor_images.best_views import actors_in_images
from ...data.images import resize_image, shown_pixels
from ...data.log import Log
from ...data.own_vehicle import Outline, find_outline, given_outline, joined, moved_frames
from ...data.sweep_cells import known_rays
from ...errors import LogError
from ...geometry import BoolArray, FloatArray, spread_indices
from ...ops.ray_segments import RayBatch
from ...sensors.camera import camera_rays, rays_at_times
from ...sensors.unprojection import has_direction
from ...world.drive import Actor, Camera, CameraModel
from ...world.own_rates import captures_of
from ..seeding import VoxelEvidence
from .images import ImageStore, ImageView, ImageWindow, LoadedImages, PixelBuffer, PixelDraw, all_images_fit
from .sweeps import ACTOR_RETURNS, LidarBatch, SweepRef, boxes_of, drawn_of_actors, lidar_batch, ray_batch, some_of_each

LEAST_SHOWN = 0.5
"""Least share of a patch's pixels that the lens shows."""
FIRST_IMAGES = 16
"""Images of each camera read before the first step, where not all are: enough to find the recording vehicle's outline."""


@dataclass(frozen=True)
class PatchBatch:
    """Camera rays of B patches of n x n feature cells: rays (B * n * n), camera (B,) and view (B,), the image's, numbers, target
    (B, 3, n * up, n * up); world_from_camera (B, 3, 3) each patch's rotation; shown (B, 1, n * up, n * up), 1 where the lens
    shows something and 0 where not, None where it does everywhere."""

    rays: RayBatch
    camera: Tensor
    view: Tensor
    target: Tensor
    world_from_camera: Tensor
    cells: int
    shown: Tensor | None = None


class CameraData:
    """The images of some cameras and frames, at one width; rays are measured from ``corner`` (3,), world frame.

    So many that they would fill memory are read as steps need them (`images.ImageWindow`), in an order that ``seed`` fixes.
    Pixels that a lens has no direction for are drawn in patches alone, and marked there (`PatchBatch.shown`).
    """

    def __init__(
        self, log: Log, cameras: list[str], frames: list[int], width: int | None, corner: FloatArray, seed: int = 0
    ) -> None:
        self.corner = corner
        self.views: list[ImageView] = []
        self.cameras: dict[str, Camera] = {}
        self.shown: dict[str, BoolArray | None] = {}
        """Pixels (H, W) that a camera's lens shows; None for all."""
        self._log = log
        self._places: dict[tuple[int, int], NDArray[np.int64]] = {}
        self._first_view: list[int] = []
        for number, name in enumerate(cameras):
            recorded = log.drive.cameras[name]
            model = recorded.model.resized(width) if width else recorded.model
            camera = Camera(name, model, recorded.world_from_camera, recorded.time_s, readouts=recorded.readouts)
            self.cameras[name] = camera
            self.shown[name] = shown_pixels(recorded.model, model)
            self._first_view.append(len(self.views))
            taken = captures_of(recorded.time_s, log.drive, frames, log.image_frames(name))
            self.views += [(number, camera, f) for f in taken]
        if not self.views:
            raise LogError(f"{log.path}: no image of {', '.join(cameras)} in the frames asked for")
        self._time_s = np.array([camera.time_s[frame] for _, camera, frame in self.views])
        self._between = [self._moved(number) for number in range(len(cameras))]

        def decode(camera: Camera, frame: int) -> NDArray[np.uint8]:
            return resize_image(log.image(camera.sensor_id, frame), camera.model)

        self.images: ImageStore
        if all_images_fit(self.views):
            self.images = LoadedImages(self.views, decode)
        else:
            self._between = [_spread(views, FIRST_IMAGES) for views in self._between]
            begin = [view for views in self._between for view in views] or list(
                range(min(len(self.views), FIRST_IMAGES))
            )
            self.images = ImageWindow(self.views, decode, begin, seed)

        # by a thread of its own: one camera's while the first images of the next are decoded
        finder = ThreadPoolExecutor(1, "outlines")
        self._outlines = finder.submit(self._find_outlines)
        finder.shutdown(wait=False)

    @property
    def outlines(self) -> dict[str, tuple[Outline, int]]:
        """Each camera's outline of the recording vehicle and the height of the images that it is of, where they show it."""
        return self._outlines.result()

    def _find_outlines(self) -> dict[str, tuple[Outline, int]]:
        outlines = {}
        ready = set(self.images.first)
        for (name, camera), views in zip(self.cameras.items(), self._between, strict=True):
            seen = find_outline([self.images.image(view) for view in views if view in ready], self.shown[name])
            outline = joined(seen, given_outline(self._log, name, camera.model))
            if outline is not None:
                outlines[name] = outline, camera.model.height
        return outlines

    def _moved(self, number: int) -> list[int]:
        """Views of a camera between which the vehicle moves."""
        own = {frame: view for view, (n, _, frame) in enumerate(self.views) if n == number}
        return [own[frame] for frame in moved_frames(self._log.drive, list(own))]

    def advance(self, step: int) -> None:
        """Let draws be of the images that a step draws from."""
        self._outlines.result()  # they are of the first step's
        self.images.advance(step)

    def times_s(self) -> list[FloatArray]:
        """Each camera's times (K,) of the images that are there, increasing."""
        return [np.array([c.time_s[f] for n, c, f in self.views if n == k] or [0.0]) for k in range(len(self.cameras))]

    def patches(self, rng: np.random.Generator, count: int, cells: int, up: int) -> PatchBatch:
        """``count`` patches of cells x cells feature cells from random places of random images, those of
        an image together."""
        origins, directions, times, targets, numbers, rotations = [], [], [], [], [], []
        edge, shown = cells * up, []
        drawable = self.images.drawable
        chosen = rng.integers(len(self.views) if drawable is None else len(drawable), size=count)
        drawn, counts = np.unique(chosen if drawable is None else drawable[chosen], return_counts=True)
        for index, n in zip(drawn, counts, strict=True):
            number, camera, frame = self.views[index]
            image = self.images.image(int(index))
            if image.shape[0] < edge or image.shape[1] < edge:
                raise LogError(
                    f"images of {camera.sensor_id} are {image.shape[1]}x{image.shape[0]}, smaller than a patch of {edge}"
                )
            x, y = (at[:, None, None] for at in self._corners(rng, number, camera, edge, n))
            centre, pixel = (np.arange(cells) + 0.5) * up, np.arange(edge)
            v, u = np.broadcast_arrays(y + centre[:, None], x + centre)
            rays = camera_rays(camera, camera.time_s[frame], u.ravel(), v.ravel())
            origins.append(rays.origins - self.corner)
            directions.append(rays.directions)
            times.append(rays.time_s)
            targets.append(image[y + pixel[:, None], x + pixel])
            shown.append(_shown(camera.model, self.shown[camera.sensor_id], y + pixel[:, None], x + pixel, u, v, up))
            numbers.append(np.full((n, 2), (number, index)))
            rotations.append(np.broadcast_to(camera.world_from_camera.at(camera.time_s[frame])[:3, :3], (n, 3, 3)))
        return _patch_batch(origins, directions, times, targets, numbers, rotations, cells, shown)

    def pixels(self, draw: PixelDraw, up: int) -> PatchBatch:
        """Single feature cells, with their upper left corners where a draw says."""
        origins, directions, times, targets, numbers, rotations = [], [], [], [], [], []
        edge = np.arange(up)
        starts = np.searchsorted(draw.view, [*self._first_view, len(self.views)])
        for number, (name, begin, end) in enumerate(zip(self.cameras, starts, starts[1:], strict=False)):
            camera, view = self.cameras[name], draw.view[begin:end]
            x, y = draw.x[begin:end], draw.y[begin:end]
            rays = rays_at_times(camera, self._time_s[view], x + 0.5 * up, y + 0.5 * up)
            origins.append(rays.origins - self.corner)
            directions.append(rays.directions)
            times.append(rays.time_s)
            rows, columns = y[:, None, None] + edge[:, None], x[:, None, None] + edge
            if len(view):
                targets.append(self.images.pixels(number, view[:, None, None], rows, columns))
            numbers.append(np.stack([np.full(len(view), number), view], -1))
            moments, which = np.unique(self._time_s[view], return_inverse=True)
            rotations.append(camera.world_from_camera.at(moments)[which, :3, :3])
        return _patch_batch(origins, directions, times, targets, numbers, rotations, 1)

    def rooms(self, edge: int) -> list[PixelBuffer]:
        """For each view where upper left corners of squares of ``edge`` pixels may lie that the lens shows all of and that show
        nothing of the vehicle itself."""
        by_camera = {name: self._room(camera, edge, 1.0) for name, camera in self.cameras.items()}
        return [by_camera[camera.sensor_id] for _, camera, _ in self.views]

    def actors(self) -> list[FloatArray]:
        """For each view the rectangles (A, 4), pixels, of the actors' boxes in the image."""
        actors, rectangles = list(self._log.drive.actors.values()), list[FloatArray]()
        for number, camera in enumerate(self.cameras.values()):
            frames = tuple(frame for n, _, frame in self.views if n == number)
            seen = actors_in_images(actors, camera, frames)
            rectangles += [seen.cut[seen.there[:, view], view] for view in range(len(frames))]
        return rectangles

    def _room(self, camera: Camera, edge: int, least_shown: float) -> PixelBuffer:
        columns, rows = max(0, camera.model.width - edge + 1), max(0, camera.model.height - edge + 1)
        room = np.full(columns, rows)
        if camera.sensor_id in self.outlines:
            outline, _ = self.outlines[camera.sensor_id]
            highest = sliding_window_view(outline, edge).min(-1) if columns else np.zeros(0, np.int64)
            room = np.asarray(np.clip(highest - edge + 1, 0, rows))
        shown = self.shown[camera.sensor_id]
        if shown is None:
            return room
        sums = np.pad(shown.cumsum(0, dtype=np.int64).cumsum(1), ((1, 0), (1, 0)))
        counts = sums[edge:, edge:] - sums[:-edge, edge:] - sums[edge:, :-edge] + sums[:-edge, :-edge]
        return (counts >= least_shown * edge * edge) & (np.arange(rows)[:, None] < room)

    def corners(self, name: str, edge: int) -> NDArray[np.int32]:
        """Return where upper left corners of patches of a camera may lie, row * (width - edge + 1) + column: those that
        `patches` draws. Raises `LogError` where there is none."""
        camera = self.cameras[name]
        room, rows = self._room(camera, edge, LEAST_SHOWN), max(0, camera.model.height - edge + 1)
        corners = np.flatnonzero(np.arange(rows)[:, None] < room if room.ndim == 1 else room)
        if not len(corners):
            raise LogError(f"{self._log.path}: no patch of {edge} pixels of camera {name} shows the scene")
        return corners.astype(np.int32)

    def _corners(
        self, rng: np.random.Generator, number: int, camera: Camera, edge: int, count: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Columns and rows (count,) of the upper left corners of random patches that show nothing of
        the vehicle itself, and of which the lens shows `LEAST_SHOWN`."""
        columns, rows = camera.model.width - edge + 1, camera.model.height - edge + 1
        if camera.sensor_id not in self.outlines and self.shown[camera.sensor_id] is None:
            y = rng.integers(rows, size=count)
            return rng.integers(columns, size=count), y
        if (number, edge) not in self._places:
            room = self._room(camera, edge, LEAST_SHOWN)
            places = np.concatenate([[0], np.cumsum(room)]) if room.ndim == 1 else np.flatnonzero(room.T)
            if len(places) == 0 or (room.ndim == 1 and places[-1] == 0):
                raise LogError(
                    f"{self._log.path}: no patch of {edge} pixels of camera {camera.sensor_id} shows the scene"
                )
            self._places[number, edge] = places
        places = self._places[number, edge]
        if self.shown[camera.sensor_id] is not None:
            return np.divmod(places[rng.integers(len(places), size=count)], rows)
        place = rng.integers(places[-1], size=count)
        x = np.searchsorted(places, place, side="right") - 1
        return x, place - places[x]


def _shown(
    model: CameraModel,
    mask: BoolArray | None,
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
    u: FloatArray,
    v: FloatArray,
    up: int,
) -> BoolArray | None:
    """Pixels (n, edge, edge) of a mask, of cells with middles u, v (n, cells, cells) that the lens shows; None for all."""
    if mask is None:
        return None
    cells = has_direction(model, u, v)
    return np.asarray(mask[rows, columns] & cells.repeat(up, 1).repeat(up, 2))


def _spread(views: list[int], count: int) -> list[int]:
    """At most ``count`` of the views, evenly."""
    return [views[i] for i in spread_indices(len(views), count)]


def _patch_batch(
    origins: list[FloatArray],
    directions: list[FloatArray],
    times: list[FloatArray],
    targets: list[NDArray[np.uint8]],
    numbers: list[NDArray[np.int64]],
    rotations: list[FloatArray],
    cells: int,
    shown: Sequence[BoolArray | None] = (),
) -> PatchBatch:
    target = torch.as_tensor(np.concatenate(targets)).permute(0, 3, 1, 2).float() / 255
    batch = ray_batch(np.concatenate(origins), np.concatenate(directions), np.concatenate(times))
    turned = torch.as_tensor(np.concatenate(rotations)).float()
    marks = None
    if any(mask is not None for mask in shown):
        every = [np.ones(t.shape[:3], bool) if m is None else m for m, t in zip(shown, targets, strict=True)]
        marks = torch.as_tensor(np.concatenate(every))[:, None].float()
    camera, view = torch.as_tensor(np.concatenate(numbers)).unbind(1)
    return PatchBatch(batch, camera, view, target, turned, cells, marks)


def lidar_captures(log: Log, lidars: Sequence[str], frames: Sequence[int]) -> list[SweepRef]:
    """The sweeps of some LiDARs that belong to frames. LogError where there are LiDARs and no sweep."""
    captures = [
        (name, frame)
        for name in lidars
        for frame in captures_of(log.drive.lidars[name].time_s, log.drive, frames, log.sweep_frames(name))
    ]
    if lidars and not captures:
        raise LogError(f"{log.path}: no sweep in the frames asked for")
    return captures


class LidarData:
    """All rays of some sweeps, drops included, the ego vehicle's own cells left out; origins are measured from
    ``corner`` (3,), world frame. Returns in the boxes of ``actors`` are drawn more often. Without ``lidars`` there is none;
    with them LogError where the frames have no sweep."""

    def __init__(
        self,
        log: Log,
        lidars: Sequence[str],
        frames: Sequence[int],
        corner: FloatArray,
        actors: Iterable[Actor] = (),
    ) -> None:
        self.corner = corner
        names = ("o", "d", "t", "depth", "intensity", "returned", "static", "own")
        parts: dict[str, list[NDArray[Any]]] = {k: [] for k in names}
        actors = list(actors)
        for capture in lidar_captures(log, lidars, frames):
            rays = known_rays(log, *capture)
            parts["o"].append((rays.origins - corner).astype(np.float32))
            parts["d"].append(rays.directions.astype(np.float32))
            parts["t"].append(rays.time_s)
            parts["depth"].append(rays.depth_m)
            parts["intensity"].append(rays.intensity)
            parts["returned"].append(rays.returned)
            hits = rays.returned
            points = rays.origins[hits] + rays.directions[hits] * rays.depth_m[hits, None]
            owner = boxes_of(points, rays.time_s[hits], actors)
            own = np.zeros(len(owner), bool)
            own[some_of_each(owner, ACTOR_RETURNS)] = True
            parts["static"].append(owner < 0)
            parts["own"].append(own)
        whole = {k: np.concatenate(v) if v else np.zeros((0, 3) if k in "od" else 0) for k, v in parts.items()}
        whole["returned"] = whole["returned"].astype(bool)
        self.origins, self.directions, self.time_s = whole["o"], whole["d"], whole["t"]
        self.depth_m, self.intensity, self.returned = whole["depth"], whole["intensity"], whole["returned"]
        self._hits, self._drops = np.flatnonzero(self.returned), np.flatnonzero(~self.returned)
        self._static, self.of_actors = whole["static"].astype(bool), self._hits[whole["own"].astype(bool)]

    @property
    def points(self) -> FloatArray:
        """Every return (N, 3), world frame."""
        h = self._hits
        return np.asarray(self.corner + self.origins[h] + self.directions[h] * self.depth_m[h, None].astype(np.float64))

    def points_by_sweep(self) -> Iterator[FloatArray]:
        """Every return, in one part."""
        yield self.points

    def advance(self, step: int) -> list[VoxelEvidence]:
        """Nothing changes from step to step."""
        return []

    def static_returns(self) -> tuple[FloatArray, FloatArray]:
        """Origins and points (N, 3) of the returns that lie in none of the actors' boxes."""
        return self.corner + self.origins[self._hits[self._static]], self.points[self._static]

    def sample(self, rng: np.random.Generator, count: int, drops: float = 0.15) -> LidarBatch:
        """``count`` random rays, a share of them drops."""
        n_drops = int(count * drops) if len(self._drops) else 0
        n_own = int((count - n_drops) * drawn_of_actors(len(self.of_actors), len(self._hits)))
        index = np.concatenate([
            self._hits[rng.integers(len(self._hits), size=count - n_drops - n_own)],
            self.of_actors[rng.integers(len(self.of_actors), size=n_own)] if n_own else np.zeros(0, np.int64),
            self._drops[rng.integers(len(self._drops), size=n_drops)] if n_drops else np.zeros(0, np.int64),
        ])  # fmt: skip
        share = len(self._drops) / (len(self._drops) + len(self._hits))
        return lidar_batch(
            self.origins[index], self.directions[index], self.time_s[index], self.depth_m[index], self.intensity[index],
            self.returned[index], share, n_drops / count,
        )  # fmt: skip
