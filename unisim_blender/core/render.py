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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from .blocks import CROWDED, Picture
from .bounds import beside_boxes
from .contact_shadow import shaded
from .drive import Actor, Camera, CameraModel, Drive, Lidar
from .errors import SceneError
from .frames import CameraFrame, LidarFrame, RenderStats
from .geometry import FloatArray
from .lattice import aligned, grown
from .meshes.exposure import PROBE_M, beside, level_of
from .passes import fill_passes
from .sensors.camera import along_axis, camera_rays, pixel_grid
from .sensors.lidar import lidar_rays
from .sensors.rays import Rays
from .tracer import NEAR_M, Array, Maps, Tracer

LATTICE_PIXELS = 1.5
"""A lattice is at most as wide as so many pixels of the images that the scene learnt from."""
LEAST_WIDTH = 16
"""Of a coarse picture, in pixels."""


class Region(NamedTuple):
    """Part of an image, in pixels from its top left corner; ``right`` and ``bottom`` are the first that do not belong to it."""

    left: int
    top: int
    right: int
    bottom: int

    def within_image(self, model: CameraModel) -> Region:
        """What of it lies in an image."""
        spans = (self.left, model.width), (self.top, model.height), (self.right, model.width), (self.bottom, model.height)
        return Region(*(min(max(at, 0), end) for at, end in spans))

    def cells(self, size: int, reach: int, whole: Region) -> tuple[slice, slice]:
        """Rows and columns of the cells of ``size`` pixels that the region touches, and ``reach`` more on every side."""
        spans = ((self.top, self.bottom, whole.bottom), (self.left, self.right, whole.right))
        return tuple(slice(max(0, a // size - reach), min(-(-end // size), -(-b // size) + reach)) for a, b, end in spans)  # type: ignore[return-value]

    def within(self, cells: tuple[slice, slice], size: int) -> tuple[slice, slice]:
        """Where the region lies in the pixels of such cells."""
        rows, columns = (c.start * size for c in cells)
        return slice(self.top - rows, self.bottom - rows), slice(self.left - columns, self.right - columns)


class Part(NamedTuple):
    """A part of a picture: its pixel (i, j) is that of the image's row and column ``origin + (i, j) * stride``, and stands for
    the ones about it; together they cover ``region``."""

    frame: CameraFrame
    region: Region
    stride: tuple[float, float] = (1, 1)
    first: tuple[float, float] | None = None

    @property
    def origin(self) -> tuple[float, float]:
        """Row and column of its first pixel."""
        return (self.region.top, self.region.left) if self.first is None else self.first


@dataclass
class _Shot:
    """One image of a camera: what was asked for, what is needed for that, and what was found out on the way."""

    camera: Camera
    frame: int
    passes: Sequence[str]
    needed: set[str]
    begun: float
    shaders: list[Actor] = field(default_factory=list)
    """Actors with contact shadows under them."""
    stats: RenderStats = field(default_factory=RenderStats)
    lights: dict[str, FloatArray] = field(default_factory=dict)
    """How bright white ground under an actor would be, by its id."""


class Renderer:
    """Renders a drive by a tracer of a trained scene and this drive. ``draw`` seeds the draw of the beams that return, which
    without it are those whose probability is half or more. ``shadows`` puts contact shadows under actors that the recording does
    not have. ``own_width`` is how wide the camera's own images are, where the drive has the camera at another size. ``lighting``
    traces the ground that meshes are lit like, where ``tracer`` leaves some of it out."""

    def __init__(
        self,
        tracer: Tracer,
        drive: Drive,
        draw: int | None = None,
        shadows: bool = False,
        own_width: int | None = None,
        lighting: Tracer | None = None,
    ) -> None:
        self.tracer, self.drive, self.draw, self.own_width = tracer, drive, draw, own_width
        self.lighting = tracer if lighting is None else lighting
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
        (part,) = self.grow(camera_id, frame, passes, width, region)
        return part.frame

    def grow(
        self,
        camera_id: str,
        frame: int,
        passes: Sequence[str] = ("rgb",),
        width: int | None = None,
        region: Region | None = None,
        coarse: Sequence[int] = (),
        band: int | None = None,
    ) -> Iterator[Part]:
        """The same in parts: colours of it all, and what is unsupported where that was asked for, coarse by the strides in
        ``coarse``; then finished bands of about ``band`` rows from the top, which together are the bits of the whole. Pixels of
        coarse parts are pixels of the finished ones, where a pixel's colour hangs on its own ray alone."""
        begun = time.perf_counter()
        camera = self.sized(camera_id, width)
        model = camera.model
        shaders = self._shaders(camera)
        shot = _Shot(camera, frame, passes, _needed(passes, bool(shaders)), begun, shaders)
        whole = Region(0, 0, model.width, model.height)
        region = whole if region is None else region
        if self.tracer.reach == 0 and self.tracer.upsample == 1:
            own = self.own_width or self.drive.cameras[camera_id].model.width
            size = self._lattice(model.width / (self.tracer.trained_width or own))
            yield from self._grow_lattice(shot, region, size, coarse, band)
            return
        for stride in coarse if region == whole else ():
            early = ("rgb", "support") if "support" in passes else ("rgb",)
            picture = self.camera(camera_id, frame, early, max(LEAST_WIDTH, model.width // stride))
            height, across = picture.rgb.shape[:2]
            y, x = model.height / height, model.width / across
            yield Part(picture, whole, (y, x), (y / 2 - 0.5, x / 2 - 0.5))
        step = region.bottom - region.top if band is None else band
        for top in range(region.top, region.bottom, step):
            part = region._replace(top=top, bottom=min(top + step, region.bottom))
            yield Part(self._block(shot, part, whole), part)

    def widened(self, region: Region) -> Region:
        """What of an image can change where rays of the region see something else: the decoder carries it on, and a lattice's
        blocks hang on their corners."""
        margin = self.tracer.upsample * (self.tracer.reach + 1) + 2 * self.tracer.quality.lattice
        return Region(region.left - margin, region.top - margin, region.right + margin, region.bottom + margin)

    def sized(self, camera_id: str, width: int | None) -> Camera:
        """A camera of the drive, its images ``width`` pixels wide."""
        camera: Camera = _pick(self.drive.cameras, camera_id, "camera")
        return replace(camera, model=camera.model.resized(width)) if width else camera

    def alone(self, camera: Camera) -> bool:
        """Whether a pixel's colour hangs on its own ray and on nothing else."""
        single = self.tracer.reach == 0 and self.tracer.upsample == 1
        return single and not self.tracer.cast.extras.seen_by(camera).actors and not self._shaders(camera)

    def _shaders(self, camera: Camera) -> list[Actor]:
        """The actors under which a camera sees contact shadows."""
        return [actor for actor in self.shaders if actor.visible_to(camera)]

    def _lattice(self, scale: float) -> int:
        """How many pixels apart a picture is traced at first, that is ``scale`` times as wide as those the scene learnt from: it
        shows little that is smaller than their pixels."""
        return min(self.tracer.quality.lattice, 2 ** int(np.log2(max(LATTICE_PIXELS * scale, 1.0))))

    def _block(self, shot: _Shot, region: Region, whole: Region) -> CameraFrame:
        """A part of the picture whose every cell is traced, and those beside it at which the decoder looks."""
        up, camera = self.tracer.upsample, shot.camera
        cells = region.cells(up, self.tracer.reach, whole)
        u, v = (x[cells] for x in pixel_grid(camera.model, up))
        rays = camera_rays(camera, shot.frame, u, v)
        image, maps = self._seen(shot, (u, v), rays, up)
        axis = camera.world_from_camera.at(camera.time_s[shot.frame])[:3, 2]
        along = rays.directions @ axis if "depth" in maps else None
        return self._frame(shot, image, maps, rays, along, region.within(cells, up))

    def _grow_lattice(self, shot: _Shot, region: Region, size: int, coarse: Sequence[int], band: int | None) -> Iterator[Part]:
        """Parts of the picture, traced where `lattice.grown` wants them."""
        camera, model = shot.camera, shot.camera.model
        rows, columns = aligned(
            (slice(region.top, region.bottom), slice(region.left, region.right)), size, (model.height, model.width)
        )
        # centres of columns (1, W) and of rows (H, 1)
        u, v = np.arange(columns.start, columns.stop)[None] + 0.5, np.arange(rows.start, rows.stop)[:, None] + 0.5
        shape = v.shape[0], u.shape[1]
        cast = self.tracer.cast
        crowd = [*cast.extras.seen_by(camera).actors, *(a for troupe in cast.guests.values() for a in troupe.actors)]

        def trace(numbers: NDArray[np.int64]) -> tuple[NDArray[np.float32], Maps]:
            y, x = np.divmod(numbers, shape[1])
            cells = u[:, x], v[y].T
            rays = camera_rays(camera, shot.frame, *cells).flat()
            image, maps = self._seen(shot, cells, rays, 1)
            if crowd and size > 1:
                # meshes are sharper than what the scene learnt, and so may be what others learnt
                maps[CROWDED] = beside_boxes(crowd, rays, size / model.fx)
            return image[0], maps

        picture = Picture(shape)
        for stride, done in grown(picture, size, self.tracer.quality.spread, trace, coarse, band):
            values = {name: x.reshape(*shape, *x.shape[1:]) for name, x in picture.values.items() if name != CROWDED}
            if stride > 1:
                pose = camera.world_from_camera.at(camera.time_s[shot.frame])
                few = {name: values[name][::stride, ::stride] for name in ("rgb", "support") if name in values}
                image = CameraFrame(model, pose, few["rgb"], unsupported=few.get("support"))
                yield Part(image, region, (stride, stride), (rows.start, columns.start))
                continue
            part = region._replace(
                top=max(region.top, rows.start + done.start), bottom=min(region.bottom, rows.start + done.stop)
            )
            if part.top >= part.bottom:
                continue
            inner = part.within((rows, columns), 1)
            maps = {name: x[inner].reshape(-1, *x.shape[2:]) for name, x in values.items()}
            across, down = u[:, inner[1]], v[inner[0]]
            rays = camera_rays(camera, shot.frame, *np.broadcast_arrays(across, down)) if shot.shaders else None
            along = along_axis(camera, shot.frame, across, down) if "depth" in maps else None
            del maps["rgb"]
            yield Part(self._frame(shot, values["rgb"][inner], maps, rays, along, (slice(None), slice(None))), part)

    def _seen(self, shot: _Shot, cells: tuple[FloatArray, FloatArray], rays: Rays, up: int) -> tuple[NDArray[np.float32], Maps]:
        """The image, and a map for each pass that is needed, of cells with centres (u, v) (h, w) and rays through these, flat
        where neighbours are together already."""
        (u, v), flat = cells, rays.flat()

        def light(actor: Actor) -> FloatArray:
            if actor.uid not in shot.lights:
                shot.lights[actor.uid] = self._light(shot.camera, shot.frame, actor)
            return shot.lights[actor.uid]

        seen = self.tracer.cast.extras.seen_by(shot.camera)
        met = seen.met_by_camera(shot.camera, shot.frame, (u, v), flat, up, NEAR_M, light)
        found = self.tracer.trace(rays, shot.needed, True, met, shot.stats)
        image = self.tracer.image(found, flat.directions, shot.camera.sensor_id, u.shape)
        if met is not None and found.mesh_opacity is not None:
            image = met.over(image, found.mesh_opacity, u.shape)
        return image, found.maps

    def _frame(
        self,
        shot: _Shot,
        image: NDArray[np.float32],
        maps: Maps,
        rays: Rays | None,
        along: FloatArray | None,
        inner: tuple[slice, slice],
    ) -> CameraFrame:
        """A frame of an image and its maps, of which ``inner`` pixels count. ``rays`` are for contact shadows, ``along`` is for
        depths (`fill_passes`)."""
        camera, time_s = shot.camera, shot.camera.time_s[shot.frame]
        up = self.tracer.upsample
        if shot.shaders:
            assert rays is not None
            image = self._shaded(image, rays, maps, shot.shaders, time_s)
        shot.stats.seconds["picture"] = time.perf_counter() - shot.begun
        pose = camera.world_from_camera.at(time_s)
        out = CameraFrame(camera.model, pose, image[inner], instances=self.tracer.cast.uids, stats=shot.stats)
        shape = -(-image.shape[0] // up), -(-image.shape[1] // up)
        fill_passes(out, {name: x for name, x in maps.items() if name in shot.passes}, along, shape, up, inner)
        return out

    def pixels(self, camera: Camera, frame: int, u: FloatArray, v: FloatArray) -> NDArray[np.float32]:
        """Colours (N, 3) of pixels (N,) that are `alone`."""
        cells = u[None], v[None]
        shot = _Shot(camera, frame, (), set(), time.perf_counter())
        return self._seen(shot, cells, camera_rays(camera, frame, *cells).flat(), 1)[0][0]

    def _light(self, camera: Camera, frame: int, actor: Actor) -> FloatArray:
        """How bright white ground under an actor would be (3,), linear: by the ground beside it, as the camera shows that."""
        time_s = camera.time_s[frame]
        points = beside(actor, time_s)
        points[:, 2] -= self.tracer.heights(points)
        to = points - camera.world_from_camera.at(time_s)[:3, 3]
        distance = np.linalg.norm(to, axis=1, keepdims=True)
        directions = to / distance
        rays = Rays(points - directions * np.minimum(distance, PROBE_M), directions, np.full(len(points), time_s))
        found = self.lighting.trace(rays, {"instance", "depth"}, True, None, RenderStats())
        # one row of cells: a decoder that looks aside sees ground on both sides
        rgb = self.lighting.image(found, directions, camera.sensor_id, (1, len(points)))[0, :: self.tracer.upsample]
        return level_of(rgb[(found.maps["instance"] == 0) & (found.maps["depth"] < 2 * PROBE_M)])

    def _shaded(
        self, image: NDArray[np.float32], rays: Rays, maps: Maps, shaders: Sequence[Actor], time_s: float
    ) -> NDArray[np.float32]:
        """The image of rays (h, w) with contact shadows where they show the ground."""
        up = self.tracer.upsample
        depth = maps["depth"].reshape(rays.time_s.shape).astype(np.float64)
        points = rays.origins + rays.directions * np.where(np.isfinite(depth), depth, 1e6)[..., None]
        ground = (maps["instance"].reshape(rays.time_s.shape) == 0) & np.isfinite(depth)
        points, ground = (np.repeat(np.repeat(x, up, 0), up, 1)[: image.shape[0], : image.shape[1]] for x in (points, ground))
        return shaded(image, points, ground, shaders, time_s)

    def lidar(self, lidar_id: str, frame: int) -> LidarFrame:
        """One sweep."""
        begun = time.perf_counter()
        lidar, rays = self.beams(lidar_id, frame)
        shape = rays.time_s.shape
        stats = RenderStats()
        # as beams and columns: neighbours are traced together
        measured = self.rays_lidar(rays.origins, rays.directions, rays.time_s, stats, lidar)
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

    def beams(self, lidar_id: str, frame: int) -> tuple[Lidar, Rays]:
        """A LiDAR of the drive, and its sweep's rays (beams, columns)."""
        lidar: Lidar = _pick(self.drive.lidars, lidar_id, "LiDAR")
        if not lidar.model.beams:
            raise SceneError(f"LiDAR {lidar_id!r} has no beam table: the log has plain points of it")
        return lidar, lidar_rays(lidar, frame)

    def _thresholds(self, lidar_id: str, frame: int, shape: tuple[int, ...]) -> FloatArray | float:
        """What a beam's probability must reach: half, or a number in (0, 1] that depends on the seed and the sweep alone."""
        if self.draw is None:
            return 0.5
        return 1.0 - np.random.default_rng([self.draw, frame, *lidar_id.encode()]).random(shape)

    def rays_lidar(
        self,
        origins: FloatArray,
        directions: FloatArray,
        time_s: FloatArray,
        stats: RenderStats | None = None,
        lidar: Lidar | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
        """Depth in metres, intensity in 0..1, probability of a return, instance (N,) of any LiDAR rays (N, 3), world frame, or of
        beams and columns (B, C, 3), N = B C. ``lidar`` is whose they are: of a body of the ego vehicle that one sees what it may;
        without it, all is seen."""
        stats = RenderStats() if stats is None else stats
        rays = Rays(origins, directions, time_s)
        flat = rays.flat()
        extras = self.tracer.cast.extras
        met = (extras if lidar is None else extras.seen_by(lidar)).met_by_rays(flat, NEAR_M)
        found = self.tracer.trace(rays, {"instance", "depth"}, False, met, stats)
        intensity, probability = self.tracer.returns(found, flat.directions)
        if met is not None and found.mesh_opacity is not None:
            bright = np.zeros_like(intensity)
            bright[met.ray] = met.intensity
            intensity = _laid_over(intensity, bright, found.mesh_opacity)
            probability = _laid_over(probability, 1.0, found.mesh_opacity)
        depth = np.nan_to_num(found.maps["depth"], posinf=0.0)
        return depth, intensity, probability, found.maps["instance"].astype(np.int32)


def _needed(passes: Sequence[str], shades: bool) -> set[str]:
    """The maps that a picture with these passes is made of: a lattice knows by the depths where a normal ends, and a contact
    shadow lies on the ground."""
    return {*passes, *(("depth",) if "normal" in passes else ()), *(("depth", "instance") if shades else ())} - {"rgb"}


Sensor = TypeVar("Sensor")


def _pick(sensors: dict[str, Sensor], sensor_id: str, kind: str) -> Sensor:
    if sensor_id not in sensors:
        raise SceneError(f"no {kind} {sensor_id!r} in the drive: there are {', '.join(sensors) or 'none'}")
    return sensors[sensor_id]


def _laid_over(below: Array, above: Array | float, share: Array) -> Array:
    """``above`` over ``below`` as far as ``share`` says (N,)."""
    return np.asarray(below + share.astype(np.float64) * (above - below), np.float32)
