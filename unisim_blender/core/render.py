"""The render path: rays → trace → decode → a frame.

camera_rays / lidar_rays    which rays, when, from where                   sensors/
met_by_camera, met_by_rays  where rays meet meshes                         meshes/
Tracer.trace                samples, fields, depth order, passes           tracer.py: torch_tracer.py
Tracer.image, returns       features to pixels, to intensity and returns
shaded, fill_passes         contact shadows, cells to pixels               contact_shadow.py, passes.py

Numpy alone: whatever a tracer computes with, it is given one.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from .contact_shadow import shaded
from .drive import Actor, Camera, Drive, Lidar
from .errors import SceneError
from .frames import CameraFrame, LidarFrame, RenderStats
from .geometry import FloatArray
from .lattice import aligned, traced
from .meshes.exposure import PROBE_M, beside, level_of
from .passes import fill_passes
from .sensors.camera import camera_rays, pixel_grid
from .sensors.lidar import lidar_rays
from .sensors.rays import Rays
from .tracer import NEAR_M, Array, Maps, Tracer, tiled

LATTICE_PIXELS = 1.5
"""A lattice is at most as wide as so many pixels of the images that the scene learnt from."""


class Region(NamedTuple):
    """Part of an image, in pixels from its top left corner; ``right`` and ``bottom`` are the first that do not belong to it."""

    left: int
    top: int
    right: int
    bottom: int

    def cells(self, size: int, reach: int, whole: Region) -> tuple[slice, slice]:
        """Rows and columns of the cells of ``size`` pixels that the region touches, and ``reach`` more on every side."""
        spans = ((self.top, self.bottom, whole.bottom), (self.left, self.right, whole.right))
        return tuple(slice(max(0, a // size - reach), min(-(-end // size), -(-b // size) + reach)) for a, b, end in spans)  # type: ignore[return-value]

    def within(self, cells: tuple[slice, slice], size: int) -> tuple[slice, slice]:
        """Where the region lies in the pixels of such cells."""
        rows, columns = (c.start * size for c in cells)
        return slice(self.top - rows, self.bottom - rows), slice(self.left - columns, self.right - columns)


class Renderer:
    """Renders a drive by a tracer of a trained scene and this drive. ``draw`` seeds the draw of the beams that return, which
    without it are those whose probability is half or more. ``shadows`` puts contact shadows under actors that the recording does
    not have."""

    def __init__(self, tracer: Tracer, drive: Drive, draw: int | None = None, shadows: bool = False) -> None:
        self.tracer, self.drive, self.draw = tracer, drive, draw
        self.shaders = [actor for actor in drive.actors.values() if actor.inserted] if shadows else []

    def camera(
        self,
        camera_id: str,
        frame: int,
        passes: Sequence[str] = ("rgb",),
        width: int | None = None,
        region: Region | None = None,
    ) -> CameraFrame:
        """One image with the passes asked for, or the ``region`` of it: the frame's arrays are then as large as that."""
        begun = time.perf_counter()
        recorded = _pick(self.drive.cameras, camera_id, "camera")
        model = recorded.model.resized(width) if width else recorded.model
        camera = Camera(camera_id, model, recorded.world_from_camera, recorded.time_s)
        up = self.tracer.upsample
        whole = Region(0, 0, model.width, model.height)
        region = whole if region is None else region
        # what the decoder looks at beside the region is traced with it
        cells = region.cells(up, self.tracer.reach, whole)
        needed = {*passes, "depth", "instance"} if self.shaders else set(passes)
        stats = RenderStats()
        size = self._lattice(model.width / (self.tracer.trained_width or recorded.model.width))
        if size > 1:
            cells = aligned(cells, size, (model.height, model.width))
            u, v = (x[cells] for x in pixel_grid(model))
            image, maps = self._from_lattice(camera, frame, (u, v), size, needed, stats)
            rays = camera_rays(camera, frame, u, v) if needed & {"depth"} else None
        else:
            u, v = (x[cells] for x in pixel_grid(model, up))
            rays = camera_rays(camera, frame, u, v)
            image, maps = self._whole(camera, frame, (u, v), rays, needed, stats)
        if self.shaders:
            assert rays is not None
            image = self._shaded(image, rays, maps, camera.time_s[frame])
            maps = {name: values for name, values in maps.items() if name in passes or (name == "depth" and "normal" in passes)}
        stats.seconds["picture"] = time.perf_counter() - begun
        pose = camera.world_from_camera.at(camera.time_s[frame])
        inner = region.within(cells, up)
        out = CameraFrame(model, pose, image[inner], instances=self.tracer.cast.uids, stats=stats)
        fill_passes(out, maps, rays, u.shape, up, inner)
        return out

    def _lattice(self, scale: float) -> int:
        """How many pixels apart a picture is traced at first, that is ``scale`` times as wide as those the scene learnt from: it
        shows little that is smaller than their pixels. 1 where a pixel's colour hangs on more than its own ray."""
        alone = self.tracer.reach == 0 and self.tracer.upsample == 1 and not self.tracer.cast.extras.actors
        finest = 2 ** int(np.log2(max(LATTICE_PIXELS * scale, 1.0)))
        return min(self.tracer.quality.lattice, finest) if alone else 1

    def _whole(
        self, camera: Camera, frame: int, cells: tuple[FloatArray, FloatArray], rays: Rays, needed: set[str], stats: RenderStats
    ) -> tuple[NDArray[np.float32], Maps]:
        """The image, and a map for each pass that is needed, of cells with centres (u, v) (h, w), each traced."""
        u, v = cells
        up, flat, light = self.tracer.upsample, rays.flat(), partial(self._light, camera, frame)
        met = self.tracer.cast.extras.met_by_camera(camera, frame, (u, v), flat, up, NEAR_M, light)
        found = self.tracer.trace(rays, needed, True, met, stats)
        image = self.tracer.image(found, flat.directions, camera.sensor_id, u.shape)
        if met is not None and found.mesh_opacity is not None:
            image = met.over(image, found.mesh_opacity, u.shape)
        return image, found.maps

    def _from_lattice(
        self, camera: Camera, frame: int, cells: tuple[FloatArray, FloatArray], size: int, needed: set[str], stats: RenderStats
    ) -> tuple[NDArray[np.float32], Maps]:
        """The same of pixels, traced where `lattice.traced` wants them."""
        u, v = (x.reshape(-1) for x in cells)

        def trace(numbers: NDArray[np.int64]) -> tuple[NDArray[np.float32], Maps]:
            rays = camera_rays(camera, frame, u[numbers], v[numbers])
            found = self.tracer.trace(rays, needed, True, None, stats)
            return self.tracer.image(found, rays.directions, camera.sensor_id, (1, len(numbers)))[0], found.maps

        h, w = cells[0].shape
        rgb, maps = traced((h, w), size, self.tracer.quality.spread, tiled((h, w)), trace)
        return rgb.reshape(h, w, 3), maps

    def _light(self, camera: Camera, frame: int, actor: Actor) -> FloatArray:
        """How bright white ground under an actor would be (3,), linear: by the ground beside it, as the camera shows that."""
        time_s = camera.time_s[frame]
        points = beside(actor, time_s)
        points[:, 2] -= self.tracer.heights(points)
        to = points - camera.world_from_camera.at(time_s)[:3, 3]
        distance = np.linalg.norm(to, axis=1, keepdims=True)
        directions = to / distance
        rays = Rays(points - directions * np.minimum(distance, PROBE_M), directions, np.full(len(points), time_s))
        found = self.tracer.trace(rays, {"instance", "depth"}, True, None, RenderStats())
        # one row of cells: a decoder that looks aside sees ground on both sides
        rgb = self.tracer.image(found, directions, camera.sensor_id, (1, len(points)))[0, :: self.tracer.upsample]
        return level_of(rgb[(found.maps["instance"] == 0) & (found.maps["depth"] < 2 * PROBE_M)])

    def _shaded(self, image: NDArray[np.float32], rays: Rays, maps: Maps, time_s: float) -> NDArray[np.float32]:
        """The image of rays (h, w) with contact shadows where they show the ground."""
        up = self.tracer.upsample
        depth = maps["depth"].reshape(rays.time_s.shape).astype(np.float64)
        points = rays.origins + rays.directions * np.where(np.isfinite(depth), depth, 1e6)[..., None]
        ground = (maps["instance"].reshape(rays.time_s.shape) == 0) & np.isfinite(depth)
        points, ground = (np.repeat(np.repeat(x, up, 0), up, 1)[: image.shape[0], : image.shape[1]] for x in (points, ground))
        return shaded(image, points, ground, self.shaders, time_s)

    def lidar(self, lidar_id: str, frame: int) -> LidarFrame:
        """One sweep."""
        begun = time.perf_counter()
        lidar: Lidar = _pick(self.drive.lidars, lidar_id, "LiDAR")
        if not lidar.model.beams:
            raise SceneError(f"LiDAR {lidar_id!r} has no beam table: the log has plain points of it")
        rays = lidar_rays(lidar, frame)
        shape = rays.time_s.shape
        stats = RenderStats()
        # as beams and columns: neighbours are traced together
        measured = self.rays_lidar(rays.origins, rays.directions, rays.time_s, stats=stats)
        depth, intensity, probability = (x.reshape(shape) for x in measured[:3])
        instance = measured[3].reshape(shape)
        returned = (
            (probability >= self._thresholds(lidar_id, frame, shape))
            & (depth >= lidar.model.min_range_m)
            & (depth <= lidar.model.max_range_m)
        )
        if lidar.blocked is not None:
            returned &= ~lidar.blocked
        stats.seconds = {"trace": time.perf_counter() - begun}
        return LidarFrame(
            lidar.model, lidar.world_from_lidar.at(lidar.time_s[frame]), rays.origins, rays.directions, rays.time_s,
            depth, intensity, probability, returned, instance, self.tracer.cast.uids, stats,
        )  # fmt: skip

    def _thresholds(self, lidar_id: str, frame: int, shape: tuple[int, ...]) -> FloatArray | float:
        """What a beam's probability must reach: half, or a number in (0, 1] that depends on the seed and the sweep alone."""
        if self.draw is None:
            return 0.5
        return 1.0 - np.random.default_rng([self.draw, frame, *lidar_id.encode()]).random(shape)

    def rays_lidar(
        self, origins: FloatArray, directions: FloatArray, time_s: FloatArray, stats: RenderStats | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
        """Depth in metres, intensity in 0..1, probability of a return, instance (N,) of any LiDAR rays (N, 3), world frame, or of
        beams and columns (B, C, 3), N = B C."""
        stats = RenderStats() if stats is None else stats
        rays = Rays(origins, directions, time_s)
        flat = rays.flat()
        met = self.tracer.cast.extras.met_by_rays(flat, NEAR_M)
        found = self.tracer.trace(rays, {"instance", "depth"}, False, met, stats)
        intensity, probability = self.tracer.returns(found, flat.directions)
        if met is not None and found.mesh_opacity is not None:
            bright = np.zeros_like(intensity)
            bright[met.ray] = met.intensity
            intensity = _laid_over(intensity, bright, found.mesh_opacity)
            probability = _laid_over(probability, 1.0, found.mesh_opacity)
        depth = np.nan_to_num(found.maps["depth"], posinf=0.0)
        return depth, intensity, probability, found.maps["instance"].astype(np.int32)


Sensor = TypeVar("Sensor")


def _pick(sensors: dict[str, Sensor], sensor_id: str, kind: str) -> Sensor:
    if sensor_id not in sensors:
        raise SceneError(f"no {kind} {sensor_id!r} in the drive: there are {', '.join(sensors) or 'none'}")
    return sensors[sensor_id]


def _laid_over(below: Array, above: Array | float, share: Array) -> Array:
    """``above`` over ``below`` as far as ``share`` says (N,)."""
    return np.asarray(below + share.astype(np.float64) * (above - below), np.float32)
