"""Render a state of the world into one sensor's frame.

camera_rays / lidar_rays    which rays, when, from where                   sensors/
Backend.bind                the scene, ready for this state                tracer.py
hit_by_camera, hit_by_rays  where rays hit meshes                         meshes/
Tracer.trace                samples, fields, depth order, passes
Tracer.image, returns       features to pixels, to intensity and returns
filled_image                planes that nobody saw        frame_fill.py
FrameShadows, fill_passes   shadows, cells to pixels      frame_shadows.py, lattice.py
RecordedFixer.fix           what no recorded image shows         fixers.py
put_in_weather              weather                       frame_weather.py

Numpy alone: whatever a backend computes with, the renderer is given it. A renderer knows neither drives nor frames:
`captures.py` renders the captures of a drive with one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from ..errors import SceneError
from ..geometry import FloatArray
from ..meshes.exposure import PROBE_M, beside, level_of
from ..sensors.bounds import beside_boxes
from ..sensors.camera import along_axis, camera_rays, pixel_grid
from ..sensors.frames import CameraFrame, LidarFrame, RenderStats
from ..sensors.lidar import BeamMeasurements, lidar_rays, sweep_frame
from ..sensors.rays import Rays
from ..sensors.unprojection import has_direction, image_mask, least_pixels_per_rad
from ..world.drive import Actor, Camera, Lidar
from ..world.replay import WorldState
from .confidence import RecordedDepth, ViewEvidence, probability
from .contact_shadow import SHADOW_CUTOFF_M, dimmed, displaced, faded
from .fixers import RecordedFixer
from .frame_fill import filled_image, filled_sweep, seen_through
from .frame_lamps import with_lamps
from .frame_shadows import FrameShadows
from .frame_weather import FrameWeather, put_in_weather, sweep_in_weather
from .lattice import NEAR_BOXES, Region, SparseImage, Tile, aligned, fill_passes, progressive_strides
from .pending_image import FINISHING_MAPS, Binding, PendingImage, colours_at, ground_of, per_pixel
from .plane_fill import PlaneFill
from .recorded_detail import RecordedDetail
from .sun_shadow import sun_shadows
from .tracer import NEAR_M, Array, Backend, Maps, Tracer
from .visibility import Reach

MAX_LATTICE_SPACING_PX = 1.5
"""Widest spacing of a lattice, in pixels of the images that the scene was trained on."""
WHOLE_IMAGE_PX = 2**20
"""Margin, in pixels, that is the whole of any image."""
MIN_PREVIEW_WIDTH_PX = 16
"""Smallest width of a preview, in pixels."""


class Renderer:
    """Renders states of the world with a backend, which holds the loaded scenes and traces rays through them.

    ``shadows`` adds contact shadows under inserted actors. ``lighting`` is the backend that traces the ground around
    meshes, from which they are lit, where ``backend`` shows only part of it. ``recorded_depth`` is what confidence is
    computed from, where it is at hand. ``fill`` is what ground and façades have where nobody saw them, ``fixer`` what draws anew
    what no recorded image shows.
    """

    def __init__(
        self,
        backend: Backend,
        shadows: bool = False,
        lighting: Backend | None = None,
        recorded_depth: RecordedDepth | None = None,
        fill: PlaneFill | None = None,
        fixer: RecordedFixer | None = None,
        detail: RecordedDetail | None = None,
    ) -> None:
        self.backend, self.shadows, self._recorded_depth, self.fill = backend, shadows, recorded_depth, fill
        self.fixer, self.detail = fixer, detail
        self._bound = Binding(backend)
        self._behind, self._standing = Binding(backend), Binding(backend)
        self._frame_shadows = FrameShadows(backend)
        self._frame_weather = FrameWeather(backend)
        self._lighting = self._bound if lighting is None or lighting is backend else Binding(lighting)
        self.quality = backend.quality
        """Settings of speed and accuracy; they may be changed between two frames."""

    @overload
    def render(
        self, state: WorldState, sensor: Camera, time_s: float, passes: Sequence[str] = ..., region: Region | None = ...
    ) -> CameraFrame: ...

    @overload
    def render(
        self, state: WorldState, sensor: Lidar, time_s: float, *, seed: Sequence[int] | None = ...
    ) -> LidarFrame: ...

    def render(
        self,
        state: WorldState,
        sensor: Camera | Lidar,
        time_s: float,
        passes: Sequence[str] = ("rgb",),
        region: Region | None = None,
        seed: Sequence[int] | None = None,
    ) -> CameraFrame | LidarFrame:
        """Render what a sensor measures at ``time_s``, in seconds. The state must cover the exposure
        (`sensors.exposure`).

        Cameras: ``passes`` are rendered, of the ``region`` only if one is given. LiDARs: which beams return is drawn by
        their probability with ``seed``; without a seed, beams return whose probability is 0.5 or more.
        """
        if isinstance(sensor, Lidar):
            return self._started_sweep(state, sensor, time_s, seed)()
        (tile,) = self.progressive(state, sensor, time_s, passes, region)
        return tile.frame

    def progressive(
        self,
        state: WorldState,
        camera: Camera,
        time_s: float,
        passes: Sequence[str] = ("rgb",),
        region: Region | None = None,
        coarse: Sequence[int] = (),
        band: int | None = None,
    ) -> Iterator[Tile]:
        """Render an image progressively: optional low-resolution previews (strides in ``coarse``; rgb, and
        ``unsupported`` if it is one of the passes), then finished bands of about ``band`` rows, top to bottom.

        Concatenated bands are bit-identical to `render`. Where a pixel's colour depends on its own ray alone, the
        pixels of previews are pixels of the finished image.
        """
        pending = self._expose(state, camera, time_s, passes)
        yield from self._tiles(pending, Region.of_image(camera.model) if region is None else region, coarse, band)

    def start(
        self,
        state: WorldState,
        sensor: Camera | Lidar,
        time_s: float,
        passes: Sequence[str] = ("rgb",),
        seed: Sequence[int] | None = None,
    ) -> Callable[[], CameraFrame | LidarFrame]:
        """Have a GPU begin a frame; return what waits for it and returns it, that of `render`. A CPU begins then."""
        if isinstance(sensor, Lidar):
            if not getattr(self.backend, "launches", False):
                return partial(self.render, state, sensor, time_s, seed=seed)
            return self._started_sweep(state, sensor, time_s, seed)
        if not getattr(self.backend, "launches", False):
            return partial(self.render, state, sensor, time_s, passes)
        pending, whole = self._expose(state, sensor, time_s, passes), Region.of_image(sensor.model)
        pending.launched = self._launched(pending, *self._cells(pending, whole))

        def finish() -> CameraFrame:
            (tile,) = self._tiles(pending, whole)
            return tile.frame

        return finish

    def _tiles(
        self, pending: PendingImage, region: Region, coarse: Sequence[int] = (), band: int | None = None
    ) -> Iterator[Tile]:
        camera, passes = pending.camera, pending.passes
        whole, model = Region.of_image(camera.model), camera.model
        if pending.is_fixed and (region != whole or coarse or band is not None):
            (tile,) = self._tiles(pending, whole)
            yield Tile(tile.frame.cropped(*region), region)
            return
        if _alone(pending.tracer):
            yield from self._on_lattice(pending, region, coarse, band)
            return
        for stride in coarse if region == whole else ():
            early = ("rgb", "unsupported") if "unsupported" in passes else ("rgb",)
            small = camera.resized(max(MIN_PREVIEW_WIDTH_PX, model.width // stride))
            preview = self.render(pending.state, small, pending.time_s, early)
            height, across = preview.rgb.shape[:2]
            y, x = model.height / height, model.width / across
            yield Tile(preview, whole, (y, x), (y / 2 - 0.5, x / 2 - 0.5))
        step = region.bottom - region.top if band is None else band
        for top in range(region.top, region.bottom, step):
            part = region._replace(top=top, bottom=min(top + step, region.bottom))
            yield Tile(self._block(pending, part), part)

    def tracer(self, state: WorldState) -> Tracer[Any]:
        """Return the backend's tracer for a state; the one of the last state is kept."""
        return self._bound.tracer(state, self.quality)

    @property
    def reach(self) -> Reach:
        return reach_of(self.shadows or self.fill is not None)

    def margin(self, state: WorldState) -> int:
        """Return the number of pixels beside a ray's own that depend on it: the reach of the decoder, and the lattice's
        blocks; all of them for a fixer."""
        tracer = self.tracer(state)
        beside = tracer.upsample * (tracer.reach + 1) + 2 * self.quality.lattice
        return beside if self.fixer is None else WHOLE_IMAGE_PX

    def is_steady(self, sensor_id: str, start_s: float, end_s: float) -> bool:
        """Return whether what stands is rendered with the same bits at all times between two; see `tracer.Backend`."""
        return all(bound.is_steady(sensor_id, start_s, end_s) for bound in (self._bound, self._lighting))

    def alone(self, state: WorldState, camera: Camera) -> bool:
        """Return whether a pixel's colour depends on its own ray alone."""
        tracer = self.tracer(state)
        return (
            state.weather is None
            and state.light is None
            and self.fill is None
            and self.fixer is None
            and self.detail is None
            and _alone(tracer)
            and not tracer.active.mesh_actors.seen_by(camera).actors
            and not self._shadowing(state, camera)
            and not self._lit(state)
        )

    def pixels(
        self, state: WorldState, camera: Camera, time_s: float, u: FloatArray, v: FloatArray
    ) -> NDArray[np.float32]:
        """Render single pixels at u, v (N,): colours (N, 3). They must not depend on others (`alone`)."""
        cells = u[None], v[None]
        pending = self._expose(state, camera, time_s, ())
        colours = self._seen(pending, cells, camera_rays(camera, time_s, *cells).flat(), 1)[0][0]
        if camera.model.is_pinhole:
            return colours
        return np.where(has_direction(camera.model, u, v)[:, None], colours, np.float32(0))

    def _expose(self, state: WorldState, camera: Camera, time_s: float, passes: Sequence[str]) -> PendingImage:
        shadowing, tracer = self._shadowing(state, camera), self.tracer(state)
        recorded = getattr(self.backend, "recorded_actors", None)  # trained scenes have it
        shadows = sun_shadows(state, camera, recorded, self.backend.parked)
        if shadows is not None:
            shadowing = list({actor.uid: actor for actor in (*shadowing, *shadows.actors)}.values())
        moved = {
            tracer.active.uids.index(actor.uid) + 1: actor
            for actor in displaced(state, recorded)
            if actor.uid in tracer.active.uids
        }
        lit = {tracer.active.uids.index(actor.uid) + 1: actor for actor in self._lit(state)}
        drawn_on = bool(shadowing or moved or shadows or lit or self.fill is not None or self.detail is not None)
        needed = _needed(self._with_evidence(passes), drawn_on)
        needed |= FINISHING_MAPS if state.weather is not None or self.fixer is not None else set()
        undeciding = needed - _needed(set(passes) - {"confidence"}, False)
        pending = PendingImage(tracer, state, camera, time_s, passes, needed, undeciding, shadowing, moved, shadows)
        pending.fill, pending.is_fixed, pending.lit = self.fill, self.fixer is not None, lit
        pending.is_detailed = self.detail is not None
        if state.weather is not None:
            pending.air = self._frame_weather.air(state, camera, time_s, self.quality, self._clear_frame)
        return pending

    def _clear_frame(self, pending: PendingImage) -> CameraFrame:
        """Render a whole image that has no weather."""
        (tile,) = self._tiles(pending, Region.of_image(pending.camera.model))
        return tile.frame

    def _finished(self, pending: PendingImage, frame: CameraFrame, region: Region) -> CameraFrame:
        """Return the frame of a region, fixed, in the state's weather, blank where its lens shows nothing."""
        rows, columns = slice(region.top, region.bottom), slice(region.left, region.right)
        if pending.is_fixed and self.fixer is not None and self.recorded_depth is not None:
            confidence = partial(self._confidence, pending)
            self.fixer.fix(pending, self._bound, frame, self.recorded_depth, self._own(pending.state), confidence)
        put_in_weather(pending, self._bound, frame, rows, columns)
        if "depth" not in pending.passes:
            frame.depth_m = frame.z_depth_m = None
        if "instance" not in pending.passes:
            frame.instance = None
        return _blanked(frame, region)

    def _lit(self, state: WorldState) -> list[Actor]:
        """Return the actors whose lamps edits switch, and that are there."""
        return [actor for actor in state.actors if actor.lamps and actor.uid in self.tracer(state).active.uids]

    def _shadowing(self, state: WorldState, camera: Camera) -> list[Actor]:
        """Return the actors under which a camera sees contact shadows."""
        inserted = (actor for actor in state.actors if actor.inserted) if self.shadows else ()
        return [actor for actor in inserted if actor.visible_to(camera)]

    def _lattice(self, tracer: Tracer[Any], camera: Camera) -> tuple[int, float]:
        """Return the spacing of the lattice in pixels, and the largest difference of colours in a block. An image wider
        than those that the scene was trained on shows little detail that is smaller than their pixels."""
        quality = tracer.quality
        scale = camera.model.width / (tracer.trained_width or camera.full_width or camera.model.width)
        size = min(quality.lattice, 2 ** int(np.log2(max(MAX_LATTICE_SPACING_PX * scale, 1.0))))
        if size == 1 and scale >= 1 and quality.lattice > 1 and quality.native_spread and tracer.trained_width != 0:
            return 2, quality.native_spread
        return size, quality.spread

    def _cells(self, pending: PendingImage, region: Region) -> tuple[tuple[slice, slice], int, float]:
        """Return the rows and columns of cells that a region needs, and what `_lattice` returns for them."""
        tracer, model = pending.tracer, pending.camera.model
        if not _alone(tracer):
            return region.cells(tracer.upsample, tracer.reach, Region.of_image(model)), 1, 0.0
        size, spread = self._lattice(tracer, pending.camera)
        spans = slice(region.top, region.bottom), slice(region.left, region.right)
        return aligned(spans, size, (model.height, model.width)), size, spread

    def _block(self, pending: PendingImage, region: Region) -> CameraFrame:
        """Render a region by tracing all of its cells, and those around it that the decoder reads."""
        up, camera, time_s = pending.tracer.upsample, pending.camera, pending.time_s
        cells, size, spread = self._cells(pending, region)
        finished = self._on_device(pending, cells, size, spread)
        u, v = (x[cells] for x in pixel_grid(camera.model, up))
        rays = camera_rays(camera, time_s, u, v) if finished is None or pending.needs_rays else None
        along: FloatArray | Array | None
        if finished is not None:
            image, along, maps = finished.pop("rgb"), finished.pop("along", None), finished
            image = image.reshape(u.shape[0] * up, u.shape[1] * up, 3)
        else:
            assert rays is not None
            image, maps = self._seen(pending, (u, v), rays, up)
            along = rays.directions @ camera.world_from_camera.at(time_s)[:3, 2] if "depth" in maps else None
        return self._finished(pending, self._frame(pending, image, maps, rays, along, region.within(cells, up)), region)

    def _on_lattice(
        self, pending: PendingImage, region: Region, coarse: Sequence[int], band: int | None
    ) -> Iterator[Tile]:
        """Render tiles of the image by tracing the pixels that `progressive_strides` asks for."""
        camera, model, time_s, tracer = pending.camera, pending.camera.model, pending.time_s, pending.tracer
        (rows, columns), size, spread = self._cells(pending, region)
        # centres of columns (1, W) and of rows (H, 1)
        u, v = np.arange(columns.start, columns.stop)[None] + 0.5, np.arange(rows.start, rows.stop)[:, None] + 0.5
        shape = v.shape[0], u.shape[1]
        active = tracer.active
        in_view = [
            *active.mesh_actors.seen_by(camera).actors,
            *(a for actor_set in active.foreign.values() for a in actor_set.actors),
        ]

        def trace(numbers: NDArray[np.int64]) -> tuple[NDArray[np.float32], Maps]:
            y, x = np.divmod(numbers, shape[1])
            cells = u[:, x], v[y].T
            rays = camera_rays(camera, time_s, *cells).flat()
            image, maps = self._seen(pending, cells, rays, 1)
            if "confidence" in pending.passes:
                maps["confidence"] = self._confidence(pending, rays, maps)
            if in_view and size > 1:
                # meshes are sharper than the trained scene, and foreign actors may be
                maps[NEAR_BOXES] = beside_boxes(in_view, rays, size / least_pixels_per_rad(model))
            return image[0], maps

        sparse = SparseImage(shape, pending.undeciding)
        steps: Iterable[tuple[int, slice]]
        along_all = None
        finished = self._on_device(pending, (rows, columns), size, spread)
        if finished is not None:
            along_all, sparse.values = finished.pop("along", None), finished
            tops = range(0, shape[0], band or shape[0])
            steps = [(1, slice(top, min(top + tops.step, shape[0]))) for top in tops]
        else:
            steps = progressive_strides(sparse, size, spread, trace, coarse, band)
        for stride, done in steps:
            values = {name: x.reshape(*shape, *x.shape[1:]) for name, x in sparse.values.items() if name != NEAR_BOXES}
            if stride > 1:
                names = ("rgb", "unsupported", *(FINISHING_MAPS if pending.air is not None else ()))
                few = {name: values[name][::stride, ::stride] for name in names if name in values}
                preview = CameraFrame(
                    model,
                    camera.world_from_camera.at(time_s),
                    few["rgb"],
                    few.get("depth"),
                    instance=few.get("instance"),
                    unsupported=few.get("unsupported"),
                )
                few_rows, few_columns = (slice(part.start, part.stop, stride) for part in (rows, columns))
                put_in_weather(pending, self._bound, preview, few_rows, few_columns, preview=True)
                preview.depth_m = preview.instance = None
                yield Tile(preview, region, (stride, stride), (rows.start, columns.start))
                continue
            part = region._replace(
                top=max(region.top, rows.start + done.start), bottom=min(region.bottom, rows.start + done.stop)
            )
            if part.top >= part.bottom:
                continue
            inner = part.within((rows, columns), 1)
            maps = {name: x[inner].reshape(-1, *x.shape[2:]) for name, x in values.items()}
            across, down = u[:, inner[1]], v[inner[0]]
            finishes = pending.needs_rays if finished is not None else pending.is_drawn_on
            rays = camera_rays(camera, time_s, *np.broadcast_arrays(across, down)) if finishes else None
            along: FloatArray | Array | None = None
            if "depth" in maps:
                along = (
                    along_axis(camera, time_s, across, down) if along_all is None else along_all.reshape(shape)[inner]
                )
            del maps["rgb"]
            frame = self._frame(pending, values["rgb"][inner], maps, rays, along, (slice(None), slice(None)))
            yield Tile(self._finished(pending, frame, part), part)

    def _launched(
        self, pending: PendingImage, cells: tuple[slice, slice], size: int, spread: float
    ) -> Callable[[RenderStats], Maps | None] | None:
        """Launch `lattice_image` of a tracer on a GPU; None where the host has to finish an image."""
        lattice_image = getattr(pending.tracer, "lattice_image", None)
        seen = pending.tracer.active.mesh_actors.seen_by(pending.camera).actors
        if lattice_image is None or pending.displaced or seen:
            return None
        waits: Callable[[RenderStats], Maps | None] | None = lattice_image(
            pending.camera, pending.time_s, cells, size, spread, pending.needed, pending.undeciding
        )
        return waits

    def _on_device(self, pending: PendingImage, cells: tuple[slice, slice], size: int, spread: float) -> Maps | None:
        """Return the maps of cells from a GPU; None where the host has to trace or finish them."""
        waits, pending.launched = pending.launched or self._launched(pending, cells, size, spread), None
        values = None if waits is None else waits(pending.stats)
        if values is not None:
            values["rgb"] = self._bound.exposed(values["rgb"], pending.camera.sensor_id, pending.time_s)
        return values

    def _seen(
        self, pending: PendingImage, cells: tuple[FloatArray, FloatArray], rays: Rays, up: int
    ) -> tuple[NDArray[np.float32], Maps]:
        """Return the image and the needed maps of cells with centres u, v (h, w) and rays through these. Rays are flat
        if neighbours are in sequence already."""
        (u, v), flat, tracer = cells, rays.flat(), pending.tracer

        def light(actor: Actor) -> FloatArray:
            if actor.uid not in pending.lights:
                pending.lights[actor.uid] = self._light(pending, actor)
            return pending.lights[actor.uid]

        seen = tracer.active.mesh_actors.seen_by(pending.camera)
        mesh_hits = seen.hit_by_camera(pending.camera, pending.time_s, (u, v), flat, up, NEAR_M, light)
        traced = tracer.trace(rays, pending.needed, True, mesh_hits, pending.stats)
        image = tracer.image(traced, flat.directions, pending.camera.sensor_id, u.shape)
        image = self._bound.exposed(image, pending.camera.sensor_id, pending.time_s)
        if mesh_hits is not None and traced.mesh_opacity is not None:
            image = mesh_hits.over(image, traced.mesh_opacity, u.shape)
        if pending.shadows is not None and pending.shadows.relit and _alone(tracer):
            image = self._frame_shadows.relit(pending, flat, image, traced.maps)
        if pending.displaced:
            self._fade(pending, cells, flat, up, image, traced.maps)
        return image, traced.maps

    def _fade(
        self,
        pending: PendingImage,
        cells: tuple[FloatArray, FloatArray],
        rays: Rays,
        up: int,
        image: NDArray[np.float32],
        maps: Maps,
    ) -> None:
        """Let what is behind the ground of displaced actors show through in the image of cells with centres u, v
        (h, w) and flat rays."""
        depth = np.where(np.isfinite(maps["depth"]), maps["depth"], 0.0).astype(np.float64)
        points = rays.origins + rays.directions * depth[:, None]
        recorded = getattr(self.backend, "recorded_actors", None) or {}
        share = faded(points, rays.time_s, maps["instance"], pending.displaced, recorded, pending.tracer.heights)
        some = np.flatnonzero(share)
        if not len(some):
            return
        moved = {actor.uid for actor in pending.displaced.values()}
        state = pending.state.restricted([a.uid for a in pending.state.actors if a.uid not in moved])
        tracer = self._behind.tracer(state, self.quality)
        without = replace(pending, tracer=tracer, state=state, needed=set(), shadowing=[], displaced={}, shadows=None)
        shape = cells[0].shape
        if up == 1 and tracer.reach == 0:
            few = rays.part(some)
            u, v = (np.broadcast_to(x, shape).reshape(-1)[some][None] for x in cells)
            colours = self._seen(without, (u, v), few, up)[0].reshape(1, -1, 3)
            if pending.shadows is not None:
                on_ground = np.zeros(len(some), np.int32)
                colours = dimmed(
                    colours, self._frame_shadows.sunlight(pending, few, depth[some], on_ground, colours[0])[None]
                )
            colours = colours[0]
            flat = image.reshape(-1, 3)
            flat[some] += share[some, None] * (colours - flat[some])
            return
        # a decoder that reads neighbours needs them all
        behind = self._seen(without, cells, rays, up)[0]
        wide = np.repeat(np.repeat(share.reshape(shape), up, 0), up, 1)[..., None]
        image += np.where(wide > 0, wide * (behind - image), np.float32(0))

    def _frame(
        self,
        pending: PendingImage,
        image: NDArray[np.float32],
        maps: Maps,
        rays: Rays | None,
        along: FloatArray | Array | None,
        inner: tuple[slice, slice],
    ) -> CameraFrame:
        """Return the frame of an image and its maps, cropped to ``inner``. ``rays`` are for contact shadows, ``along``
        is for depths (`fill_passes`)."""
        camera, time_s = pending.camera, pending.time_s
        up = pending.tracer.upsample
        if pending.is_drawn_on:
            assert rays is not None
            state, own = pending.state, self._own(pending.state)
            points, ground = ground_of(pending, image.shape, rays, maps)
            if self.detail is not None:
                times_s, instance = (
                    per_pixel(x.reshape(rays.time_s.shape), up, image.shape) for x in (rays.time_s, maps["instance"])
                )
                image = self.detail.added(pending, self._bound, image, points, times_s, instance, own)
            if pending.fill is not None:
                standing, recorded = self._behind_boxes(state)
                through, maps = seen_through(pending.fill, Camera, standing, recorded, state, own, rays.flat(), maps)
                if len(through.rays):
                    points, ground = ground_of(pending, image.shape, rays, maps)
                image, maps, filled = filled_image(
                    pending, pending.fill, self._bound, image, points, ground, maps, through
                )
                pending.filled = filled[inner]
            if pending.is_shaded:
                image = self._frame_shadows.shaded(pending, image, points, ground, rays, maps)
            if pending.lit:
                image = with_lamps(pending, self._bound, image, rays, maps)
        pending.stats.seconds["image"] = time.perf_counter() - pending.begun
        pose = camera.world_from_camera.at(time_s)
        model = camera.model_at(time_s)
        out = CameraFrame(model, pose, image[inner], instances=pending.tracer.active.uids, stats=pending.stats)
        shape = -(-image.shape[0] // up), -(-image.shape[1] // up)
        if "confidence" in pending.passes and "confidence" not in maps:
            assert rays is not None
            maps = {**maps, "confidence": self._confidence(pending, rays.flat(), maps)}
        fill_passes(out, {name: x for name, x in maps.items() if name in pending.shown}, along, shape, up, inner)
        return out

    def _confidence(self, pending: PendingImage, rays: Rays, maps: Maps) -> Array:
        """Return the confidence (N,) of flat rays (N,) of an image."""
        return self.confidence(pending.state, pending.camera.world_from_camera.at(pending.time_s), rays, maps)

    def _with_evidence(self, passes: Sequence[str]) -> set[str]:
        """Return the maps that passes need, with those that confidence is computed from in its place."""
        if "confidence" not in passes:
            return set(passes)
        evidence = {"depth", "instance"} if hasattr(self.backend, "recorded_depth") else {"unsupported"}
        return set(passes) - {"confidence"} | evidence

    @property
    def recorded_depth(self) -> RecordedDepth | None:
        """Distances of the recorded images and sweeps, traced when they are first needed; None without a trained scene."""
        if self._recorded_depth is None and hasattr(self.backend, "recorded_depth"):
            self._recorded_depth = self.backend.recorded_depth()
        return self._recorded_depth

    def evidence(
        self, state: WorldState, pose: FloatArray, rays: Rays, maps: Maps, of_beam: bool = False
    ) -> ViewEvidence | None:
        """Return what the recording shows of the ends of flat rays (N,) from a sensor's pose, see `confidence`; None
        without a trained scene."""
        if self.recorded_depth is None:
            return None
        near = self.recorded_depth.near(pose, of_beam)
        return near.evidence(rays, maps["depth"], maps["instance"], self._own(state))

    def _own(self, state: WorldState) -> list[Actor | None]:
        """Return the active actors of a state in the order of their numbers, None for those of other scenes and meshes."""
        actors, active = {actor.uid: actor for actor in state.actors}, self.tracer(state).active
        return [actors[uid] if uid in active.own.uids else None for uid in active.uids]

    def confidence(self, state: WorldState, pose: FloatArray, rays: Rays, maps: Maps, of_beam: bool = False) -> Array:
        """Return the probability (N,) that what flat rays (N,) from a sensor's pose show is right, by their maps: of a
        camera's rays, or of a LiDAR's beams. Meshes are as they are drawn: 1. Without a trained scene 0 and 1, by what is
        unsupported."""
        evidence = self.evidence(state, pose, rays, maps, of_beam)
        if evidence is None:
            return 1 - maps["unsupported"].astype(np.float32)
        right = probability(evidence, maps["depth"], maps["instance"], of_beam)
        active = self.tracer(state).active
        right[maps["instance"] > len(active.uids) - len(active.mesh_actors.uids)] = 1
        return right

    def sweep_confidence(self, state: WorldState, sweep: LidarFrame) -> Array | None:
        """Return the confidence (B, C) of a sweep's beams; None without a trained scene."""
        if self.recorded_depth is None:
            return None
        rays = Rays(sweep.origins, sweep.directions, sweep.time_s).flat()
        maps = {"depth": sweep.depth_m.reshape(-1), "instance": sweep.instance.reshape(-1)}
        return self.confidence(state, sweep.world_from_lidar, rays, maps, True).reshape(sweep.depth_m.shape)

    def _light(self, pending: PendingImage, actor: Actor) -> FloatArray:
        """Return the brightness (3,), linear, of white ground under an actor, estimated from the ground beside it in
        the camera's colours."""
        points = beside(actor, pending.time_s)
        points[:, 2] -= pending.tracer.heights(points)
        tracer = self._lighting.tracer(pending.state, self.quality)
        rgb, depth = colours_at(pending, points, self._lighting, tracer)
        return level_of(rgb[depth < 2 * PROBE_M])

    def _started_sweep(
        self, state: WorldState, lidar: Lidar, time_s: float, seed: Sequence[int] | None
    ) -> Callable[[], LidarFrame]:
        """Begin a sweep on a GPU; return what waits for it, and what is not begun renders it then."""
        begun = time.perf_counter()
        if not lidar.model.beams:
            raise SceneError(f"LiDAR {lidar.sensor_id!r} has no beam table: the log has plain points of it")
        tracer = self.tracer(state)
        sweep = None if tracer.active.mesh_actors.seen_by(lidar).actors else getattr(tracer, "sweep", None)
        waits: Callable[[RenderStats], Maps | None] | None = None if sweep is None else sweep(lidar, time_s)

        def finish() -> LidarFrame:
            stats = RenderStats()
            values = None if waits is None else waits(stats)
            if values is not None:
                rays = Rays(values["origins"], values["directions"], values["times"])
                depth, intensity, probability = (values[name] for name in ("depth", "intensity", "probability"))
                instance = values["instance"]
            else:
                rays = lidar_rays(lidar, time_s)
                # as beams and columns: neighbours are traced together
                depth, intensity, probability, instance = self.beams(state, rays, lidar, stats)
            shape = rays.time_s.shape
            if values is not None:
                depth, intensity = self._filled_sweep(
                    state, rays.flat(), *(x.reshape(-1) for x in (depth, intensity, instance))
                )
            measured = BeamMeasurements(
                depth.reshape(shape), intensity.reshape(shape), probability.reshape(shape), instance.reshape(shape)
            )
            stats.seconds = {"trace": time.perf_counter() - begun}
            frame = sweep_frame(lidar, time_s, rays, measured, tracer.active.uids, seed, stats)
            return self.sweep_in_weather(frame, state, lidar, time_s)

        return finish

    def sweep_in_weather(self, frame: LidarFrame, state: WorldState, lidar: Lidar, time_s: float) -> LidarFrame:
        """Return the sweep of clear air at ``time_s`` in the state's weather."""
        return sweep_in_weather(frame, state, lidar, time_s, lambda points: self.tracer(state).heights(points))

    def beams(
        self, state: WorldState, rays: Rays, lidar: Lidar | None = None, stats: RenderStats | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
        """Render LiDAR rays, flat (N,) or by beams and columns (B, C) with N = B C: depth in metres, intensity in 0..1,
        probability of a return, and instance, each (N,).

        ``lidar`` decides whether the ego vehicle's body is visible; without it, it is.
        """
        stats = RenderStats() if stats is None else stats
        flat, tracer = rays.flat(), self.tracer(state)
        mesh_actors = tracer.active.mesh_actors
        mesh_hits = (mesh_actors if lidar is None else mesh_actors.seen_by(lidar)).hit_by_rays(flat, NEAR_M)
        traced = tracer.trace(rays, {"instance", "depth"}, False, mesh_hits, stats)
        intensity, probability = tracer.returns(traced, flat.directions)
        if mesh_hits is not None and traced.mesh_opacity is not None:
            bright = np.zeros_like(intensity)
            bright[mesh_hits.ray] = mesh_hits.intensity
            intensity = _laid_over(intensity, bright, traced.mesh_opacity)
            probability = _laid_over(probability, 1.0, traced.mesh_opacity)
        depth, instance = np.nan_to_num(traced.maps["depth"], posinf=0.0), traced.maps["instance"].astype(np.int32)
        depth, intensity = self._filled_sweep(state, flat, depth, intensity, instance)
        return depth, intensity, probability, instance

    def _filled_sweep(
        self, state: WorldState, rays: Rays, depth: Array, intensity: Array, instance: NDArray[np.int32]
    ) -> tuple[Array, Array]:
        """Return the distances and intensities (N,) of flat beams (N,), filled where nobody saw them."""
        if self.fill is None:
            return depth, intensity
        own = self._own(state)
        standing, recorded = self._behind_boxes(state)
        return filled_sweep(self.fill, standing, recorded, state, own, rays, depth, intensity, instance)

    def _behind_boxes(self, state: WorldState) -> tuple[Tracer[Any], RecordedDepth | None]:
        """Return the tracer of a state without its actors and the recorded depth, where the state has emptied boxes; else its own
        tracer and None."""
        if not state.removed_boxes:
            return self.tracer(state), None
        return self._standing.tracer(state.restricted([]), self.quality), self.recorded_depth


def _alone(tracer: Tracer[Any]) -> bool:
    """Return whether a decoder makes a pixel of one ray."""
    return tracer.reach == 0 and tracer.upsample == 1


def _needed(passes: Collection[str], shades: bool) -> set[str]:
    """Return the maps that an image with these passes needs: a lattice finds edges of normals by depth, and contact
    shadows need the ground."""
    return {*passes, *(("depth",) if "normal" in passes else ()), *(("depth", "instance") if shades else ())} - {"rgb"}


def reach_of(shadows: bool) -> Reach:
    """Return the distances over which a frame depends on what its own rays do not hit, with contact shadows or
    without."""
    contact = SHADOW_CUTOFF_M if shadows else 0.0
    return Reach(shadow_m=contact, light_m=PROBE_M + 1.0, changed_m=SHADOW_CUTOFF_M)


def _laid_over(below: Array, above: Array | float, opacity: Array) -> Array:
    """Return ``above`` blended over ``below`` by ``opacity`` (N,)."""
    return np.asarray(below + opacity.astype(np.float64) * (above - below), np.float32)


def _blanked(frame: CameraFrame, region: Region) -> CameraFrame:
    """Return the frame of a region, blank where its lens shows nothing."""
    shown = image_mask(frame.model)
    if shown is not None:
        frame.blank(shown[region.top : region.bottom, region.left : region.right])
    return frame
