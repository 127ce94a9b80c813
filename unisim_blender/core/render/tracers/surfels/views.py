"""Recorded images as sources of colour: projection of places into them, and whether the camera saw the places."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ....data.images import resize_image, shown_pixels
from ....data.log import Log
from ....data.own_vehicle import Outline, find_outline, given_outline, joined, moved_frames, shows_scene
from ....geometry import BoolArray, FloatArray, bilinear, box_corners, intersect_boxes, invert_pose, transform_points
from ....sensors.camera import camera_rays, line_count, line_times, lines, pixel_grid
from ....sensors.rays import Rays
from ....sensors.silhouettes import box_silhouette
from ....world.drive import Actor, Camera
from ...tracer import NEAR_M
from .placed import PlacedSurfels

OCCLUSION_SHARE, OCCLUSION_M = 0.02, 0.2
"""Distance behind the first surface, relative and in metres, beyond which a place is hidden."""
BOX_MARGIN_M, MAX_BOX_DISTANCE_M, SHUTTER_POSES = 0.3, 120.0, 6
OUTLINE_IMAGES, OUTLINE_WIDTH_PX = 24, 480
"""Number of images, and their width in pixels, from which the outline of the recording vehicle itself is derived."""
DEPTH_EDGE_FACTOR = 1.35
"""Factor between neighbouring depths at which an image's pixels may show either, and are not used."""


@dataclass(frozen=True, eq=False)
class RecordedView:
    """One recorded image at some width, and the depths of what its camera sees.

    image (H, W, 3) uint8; depth_m (h, w) to the first surfel in a coarser grid of its own, inf for none; clear (h, w),
    the least of the depths about each; boxes_m (h, w) to the first actor's box; own (h, w), where it shows the
    recording vehicle itself. ``camera`` has the image's model.
    """

    camera: Camera
    frame: int
    image: NDArray[np.uint8]
    depth_m: NDArray[np.float32]
    clear_m: NDArray[np.float32]
    boxes_m: NDArray[np.float32]
    own: BoolArray
    gain: FloatArray = field(default_factory=lambda: np.ones(3))
    """Exposure (3,) relative to the other images', where it is known."""

    def place(self, first: FloatArray, last: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return the image points of places: u, v (N,), pixels, z (N,), metres along the axis, distance (N,), metres.
        ``first`` and ``last`` (N, 3) are where they are in the camera's frame as its first and its last line is
        exposed. Through a lens that bends lines, z is the distance, or 0 where the lens does not show the place; u and
        v are NaN there."""
        model, f = self.camera.model, np.full(len(first), 0.5)
        if not model.is_pinhole or model.shutter.axis == "columns":
            return self._place_by_lens(first, last)
        for _ in range(3):  # a row's time depends on the row
            at = first + f[:, None] * (last - first)
            z = np.maximum(at[:, 2], 1e-6)
            f = np.clip((model.fy * at[:, 1] / z + model.cy) / model.height, 0, 1)
        at = first + f[:, None] * (last - first)
        z = np.maximum(at[:, 2], 1e-6)
        u, v = model.fx * at[:, 0] / z + model.cx, model.fy * at[:, 1] / z + model.cy
        return u, v, at[:, 2], np.linalg.norm(at, axis=1)

    def _place_by_lens(
        self, first: FloatArray, last: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        model, f = self.camera.model, np.full(len(first), 0.5)
        for _ in range(3):
            u, v, valid = model.project(first + f[:, None] * (last - first))
            f = np.clip(np.where(valid, lines(model, u, v), 0.0) / line_count(model), 0, 1)
        at = first + f[:, None] * (last - first)
        u, v, valid = model.project(at)
        distance = np.linalg.norm(at, axis=1)
        return u, v, np.where(valid, distance, 0.0), distance

    def ends(self) -> tuple[float, float]:
        """Times, seconds, at which the first and the last line are exposed."""
        model = self.camera.model
        times = line_times(self.camera, self.camera.time_s[self.frame], np.array([0.0, line_count(model)]))
        return float(times[0]), float(times[1])

    def of_static(self, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return `place` of static points (N, 3), world frame."""
        first, last = (
            transform_points(invert_pose(self.camera.world_from_camera.at(time)), points) for time in self.ends()
        )
        return self.place(first, last)

    def of_actor(self, trajectory: object, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return `place` of points (N, 3) in the box of an actor with a trajectory."""
        first, last = (
            transform_points(invert_pose(self.camera.world_from_camera.at(time)) @ trajectory.at(time), points)  # type: ignore[attr-defined]
            for time in self.ends()
        )
        return self.place(first, last)

    @cached_property
    def beyond(self) -> BoolArray:
        """Cells (h, w) bool in which the camera sees neither a surfel nor an actor's box, nor its own vehicle."""
        return np.isinf(self.depth_m) & np.isinf(self.boxes_m) & ~self.own

    def far_points(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the image points u, v (M,) of the coarser grid that are `beyond`, and their rays' directions (M, 3),
        world frame."""
        h, w = self.depth_m.shape
        rows, columns = np.nonzero(self.beyond)
        model = self.camera.model
        u, v = (columns + 0.5) * model.width / w, (rows + 0.5) * model.height / h
        return u, v, camera_rays(self.camera, self.camera.time_s[self.frame], u, v).directions

    def inside(self, u: FloatArray, v: FloatArray, z: FloatArray, margin: float = 1.0) -> BoolArray:
        """Return which image points u, v (N,) at depths z (N,) lie in the image, ``margin`` pixels from its edge: (N,)
        bool."""
        model = self.camera.model
        return (z > NEAR_M) & (u > margin) & (u < model.width - margin) & (v > margin) & (v < model.height - margin)

    def cells(self, u: FloatArray, v: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return rows and columns (N,) of the coarser grid of image points u, v (N,)."""
        h, w = self.depth_m.shape
        model = self.camera.model
        return (
            np.clip(v * h / model.height, 0, h - 1).astype(np.int64),
            np.clip(u * w / model.width, 0, w - 1).astype(np.int64),
        )

    def sees(self, u: FloatArray, v: FloatArray, distance: FloatArray, static: bool) -> BoolArray:
        """Return which places at image points u, v (N,), at ``distance`` (N,), metres, from the camera, are not hidden:
        (N,) bool. ``static`` places are hidden by actors' boxes, too: an actor's own surfels have gaps."""
        cell = self.cells(u, v)
        if static:
            distance = np.where(distance > self.boxes_m[cell], np.inf, distance)
        depth, clear = self.depth_m[cell], self.clear_m[cell]
        near = (distance <= depth * (1 + OCCLUSION_SHARE) + OCCLUSION_M) & (
            distance <= clear * DEPTH_EDGE_FACTOR + OCCLUSION_M
        )
        return np.asarray(near & ~self.own[cell])

    def sample(self, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """Return colours (N, 3) at image points u, v (N,), bilinear, beyond the edge as at it; in 0..255 divided by the
        exposure."""
        return np.asarray(bilinear(self.image, u, v) / self.gain, np.float32)


def resized(camera: Camera, width: int) -> Camera:
    """Return the camera with images at most ``width`` pixels wide."""
    return replace(camera, model=camera.model.resized(min(width, camera.model.width)))


def outline_in(log: Log, camera_id: str, frames: Collection[int]) -> dict[str, tuple[Outline, int]]:
    """Return, by the camera, the recording vehicle's outline in its images of some frames, and these images' height;
    nothing for a camera that does not see the vehicle or has too few images. Raises `LogError`."""
    there = moved_frames(log.drive, [frame for frame in log.image_frames(camera_id) if frame in frames])
    chosen = [there[i] for i in np.unique(np.linspace(0, len(there) - 1, min(len(there), OUTLINE_IMAGES)).astype(int))]
    model = resized(log.drive.cameras[camera_id], OUTLINE_WIDTH_PX).model
    images = [resize_image(log.image(camera_id, frame), model) for frame in chosen]
    outline = find_outline(images, shown_pixels(log.drive.cameras[camera_id].model, model))
    outline = joined(outline, given_outline(log, camera_id, model))
    return {} if outline is None else {camera_id: (outline, model.height)}


def open_view(
    log: Log,
    camera_id: str,
    frame: int,
    width: int,
    depth_width: int,
    surfels: PlacedSurfels,
    boxed: Iterable[Actor],
    outlines: Mapping[str, tuple[Outline, int]],
) -> RecordedView:
    """Return a recorded image at most ``width`` pixels wide, with depths of the placed surfels, and of the boxes of
    ``boxed`` actors, on a grid ``depth_width`` wide; ``outlines`` are the recording vehicle's. Raises `LogError`."""
    camera = resized(log.drive.cameras[camera_id], width)
    coarse = resized(camera, depth_width)
    u, v = pixel_grid(coarse.model)
    rays = camera_rays(coarse, coarse.time_s[frame], u, v).flat()
    depth = surfels.first(rays, NEAR_M).t.reshape(u.shape).astype(np.float32)
    padded = np.pad(depth, 1, mode="edge")
    clear = sliding_window_view(padded, (3, 3)).min((2, 3))
    image = resize_image(log.image(camera_id, frame), camera.model)
    own = np.zeros(u.shape, bool)
    if camera_id in outlines:
        # a cell's lower edge: what shows the vehicle in part shows it
        own = ~shows_scene(*outlines[camera_id], u, v + 0.5, (coarse.model.width, coarse.model.height))
    shown = shown_pixels(log.drive.cameras[camera_id].model, coarse.model)
    if shown is not None:
        own |= ~shown
    return RecordedView(camera, frame, image, depth, clear, _boxes(boxed, coarse, frame, rays, u.shape), own)


def _boxes(
    actors: Iterable[Actor], camera: Camera, frame: int, rays: Rays, shape: tuple[int, ...]
) -> NDArray[np.float32]:
    """Return the distances (h, w), metres, at which rays (h w,) of a camera's image enter the first actor's box; inf
    where they enter none."""
    time, model = camera.time_s[frame], camera.model
    depth = np.full(shape, np.inf, np.float32)
    numbers = np.arange(depth.size).reshape(shape)
    camera_from_world = invert_pose(camera.world_from_camera.at(time))
    for actor in (actor for actor in actors if actor.start_s <= time <= actor.end_s):
        pose, size = actor.world_from_actor.at(time), actor.size_m + BOX_MARGIN_M
        if not model.is_pinhole:
            silhouette = box_silhouette(model, camera_from_world @ pose, size)
            if silhouette is None:
                continue
            left, top, right, bottom = silhouette
            part = numbers[_span(np.array([top, bottom]), shape[0]), _span(np.array([left, right]), shape[1])]
            _meet(depth, part, rays, pose, size)
            continue
        x, y, z = transform_points(camera_from_world, box_corners(pose, size)).T
        if z.max() < NEAR_M or z.min() > MAX_BOX_DISTANCE_M:
            continue
        part = numbers
        if z.min() > NEAR_M:
            u, v = model.fx * x / z + model.cx, model.fy * y / z + model.cy
            part = numbers[_span(v, shape[0]), _span(u, shape[1])]
        _meet(depth, part, rays, pose, size)
    return depth


def _meet(depth: NDArray[np.float32], part: NDArray[np.int64], rays: Rays, pose: FloatArray, size: FloatArray) -> None:
    """Set ``depth`` to the distances at which the rays of some cells enter a box, where that is nearer."""
    if part.size == 0:
        return
    flat = part.reshape(-1)
    enter, leave = intersect_boxes(rays.origins[flat], rays.directions[flat], invert_pose(pose)[None], size[None])
    at = np.where((enter <= leave) & (leave > 0), np.maximum(enter, 0), np.inf)[:, 0]
    depth.reshape(-1)[flat] = np.minimum(depth.reshape(-1)[flat], at)


def _span(values: FloatArray, size: int) -> slice:
    """Return the cells between the least and the largest of values; an exposure of rows moves things by a few."""
    low, high = np.clip(
        [np.floor(values.min()) - SHUTTER_POSES, np.ceil(values.max()) + SHUTTER_POSES], 0, size
    ).astype(int)
    return slice(low, high)
