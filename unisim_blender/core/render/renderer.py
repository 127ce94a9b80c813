"""Render a state of the world into one sensor's frame.

camera_rays / lidar_rays    which rays, when, from where                   sensors/
Backend.bind                the scene, ready for this state                tracer.py
hit_by_camera, hit_by_rays  where rays hit meshes                         meshes/
Tracer.trace                samples, fields, depth order, passes
Tracer.image, returns       features to pixels, to intensity and returns
_filled                     ground that nobody saw           ground_fill.py
_shaded, fill_passes        shadows, cells to pixels         contact_shadow.py, sun_shadow.py, lattice.py
_finished, finish           weather                                        weather/

Numpy alone: whatever a backend computes with, the renderer is given it. A renderer knows neither drives nor frames:
`captures.py` renders the captures of a drive with one.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb
from ..data.exposures import Exposures
from ..errors import SceneError
from ..geometry import BoolArray, FloatArray
from ..meshes.exposure import PROBE_M, beside, level_of
from ..sensors.bounds import beside_boxes
from ..sensors.camera import along_axis, camera_rays, pixel_grid
from ..sensors.frames import CameraFrame, LidarFrame, RenderStats
from ..sensors.lidar import BeamMeasurements, lidar_rays, sweep_frame
from ..sensors.rays import Rays, exposure_window
from ..sensors.unprojection import has_direction, image_mask, least_pixels_per_rad
from ..weather import camera as camera_weather
from ..weather import lidar as lidar_weather
from ..weather import wet_ground
from ..weather.spray import Puffs, spray
from ..world.drive import Actor, Camera, Lidar
from ..world.replay import WorldState
from .confidence import DepthView, RecordedDepth, ViewEvidence, probability
from .contact_shadow import SHADOW_CUTOFF_M, dimmed, displaced, faded, shaded
from .fixers import ImageToFix, RecordedFixer, weight_of
from .ground_fill import GroundFill
from .lattice import NEAR_BOXES, Region, SparseImage, Tile, aligned, fill_passes, progressive_strides
from .quality import QUALITIES, Quality
from .sun_shadow import FULL_SUN, GroundBeside, SunShadows, around, sun_shadows
from .tracer import NEAR_M, Array, Backend, Maps, Tracer
from .visibility import Reach

MAX_LATTICE_SPACING_PX = 1.5
"""Widest spacing of a lattice, in pixels of the images that the scene was trained on."""
FINISHING_MAPS = {"depth", "instance"}
"""Maps of an image that weather and fixers need."""
WHOLE_IMAGE_PX = 2**20
"""Margin, in pixels, that is the whole of any image."""
MIN_PREVIEW_WIDTH_PX = 16
"""Smallest width of a preview, in pixels."""
SKY_WIDTH_PX = 64
"""Width of the image from which the air is estimated, in pixels."""
MIRROR_WIDTH_PX, MIRROR_LIFT_M = 192, 0.05
"""Width of the coarse image of what the ground reflects, in pixels, and the height, metres, at which mirrored rays start."""
MAX_STORED_AIR = 64
"""Number of images whose air is stored."""


@dataclass
class _Exposure:
    """One image to render: the request, the maps that it needs, and results that its parts share."""

    tracer: Tracer[Any]
    state: WorldState
    camera: Camera
    time_s: float
    passes: Sequence[str] = ()
    needed: set[str] = field(default_factory=set)
    undeciding: set[str] = field(default_factory=set)
    """Those of the maps that an edit needs, and the request does not: a lattice that decided by them would change pixels that
    the edit does not reach."""
    shadowing: list[Actor] = field(default_factory=list)
    """Actors with contact shadows under them."""
    displaced: dict[int, Actor] = field(default_factory=dict)
    """Actors whose ground fades, by instance."""
    shadows: SunShadows | None = None
    """Shadows that edits have moved, where the sun is known."""
    beside: GroundBeside | None = None
    """The ground beside what has changed, once it is needed."""
    begun: float = field(default_factory=time.perf_counter)
    stats: RenderStats = field(default_factory=RenderStats)
    launched: Callable[[RenderStats], Maps | None] | None = None
    """What waits for the whole image, which a GPU has begun."""
    lights: dict[str, FloatArray] = field(default_factory=dict)
    """Brightness of white ground under an actor, by the actor's id."""
    air: camera_weather.Air | None = None
    """The air of the weather; None where the image is to be that of clear air."""
    mirror: wet_ground.Mirror | None = None
    """What wet ground reflects, once it is traced."""
    puffs: Puffs | None = None
    """Spray behind vehicles, once it is looked for."""
    particles: camera_weather.DrawnParticles | None = None
    """Drops and flakes in the image, once they are drawn."""
    fill: GroundFill | None = None
    """What the ground has where nobody saw it; None where that is to stay as the scene has it."""
    fixer: RecordedFixer | None = None
    """What draws anew what no recorded image shows, if anything does."""

    @property
    def is_shaded(self) -> bool:
        """Whether there are shadows to put into the image."""
        return bool(self.shadowing) or self.shadows is not None

    @property
    def needs_rays(self) -> bool:
        """Whether the frame is finished by its rays: for shadows, for filled ground and for confidence."""
        return self.is_drawn_on or "confidence" in self.passes

    @property
    def shown(self) -> set[str]:
        """The maps that the frame has before it is finished: the passes, and what weather and a fixer need."""
        return {*self.passes, *(FINISHING_MAPS if self.air is not None or self.fixer is not None else ())}

    @property
    def is_drawn_on(self) -> bool:
        """Whether the image is changed by what its rays hit."""
        return self.is_shaded or self.fill is not None


class _Binding:
    """A backend and its tracer of the last state."""

    def __init__(self, backend: Backend) -> None:
        self.backend = backend
        self._last: tuple[WorldState, Tracer[Any]] | None = None

    def tracer(self, state: WorldState, quality: Quality) -> Tracer[Any]:
        """Return the backend's tracer of this state."""
        if self._last is None or (self._last[0] is not state and self._last[0] != state):
            self._last = state, self.backend.bind(state)
        tracer = self._last[1]
        tracer.quality = quality
        return tracer

    def exposed(self, image: NDArray[np.float32], camera_id: str, time_s: float) -> NDArray[np.float32]:
        """Return a camera's image, or its colours (..., 3), exposed as a trained scene's images around its time are."""
        gain = self.gain(camera_id, time_s)
        return image if gain is None else np.minimum(image * gain, np.float32(1))

    def gain(self, camera_id: str, time_s: float) -> NDArray[np.float32] | None:
        """Return the gain (3,) of a trained scene's images around a time; None where there is none."""
        exposures: Exposures | None = getattr(self.backend, "exposures", None)
        if exposures is None or camera_id not in exposures.by_camera:
            return None
        return exposures.at(camera_id, np.array([time_s]))[0].astype(np.float32)

    def is_steady(self, sensor_id: str, start_s: float, end_s: float) -> bool:
        """See `tracer.Backend`."""
        exposures: Exposures | None = getattr(self.backend, "exposures", None)
        exposed_alike = exposures is None or exposures.is_constant(sensor_id, start_s, end_s)
        return exposed_alike and self.backend.is_steady(sensor_id, start_s, end_s)


class Renderer:
    """Renders states of the world with a backend, which holds the loaded scenes and traces rays through them.

    ``shadows`` adds contact shadows under inserted actors. ``lighting`` is the backend that traces the ground around
    meshes, from which they are lit, where ``backend`` shows only part of it. ``recorded_depth`` is what confidence is
    computed from, where it is at hand. ``fill`` is what the ground has where nobody saw it, ``fixer`` what draws anew
    what no recorded image shows.
    """

    def __init__(
        self,
        backend: Backend,
        shadows: bool = False,
        lighting: Backend | None = None,
        recorded_depth: RecordedDepth | None = None,
        fill: GroundFill | None = None,
        fixer: RecordedFixer | None = None,
    ) -> None:
        self.backend, self.shadows, self._recorded_depth, self.fill = backend, shadows, recorded_depth, fill
        self.fixer = fixer
        self._bound = _Binding(backend)
        self._blockers = {name: _Binding(backend) for name in ("edited", "recorded", "bare")}
        self._behind, self._empty = _Binding(backend), _Binding(backend)
        self._air: dict[tuple[object, ...], camera_weather.Air] = {}
        self._lighting = self._bound if lighting is None or lighting is backend else _Binding(lighting)
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
        exposure = self._expose(state, camera, time_s, passes)
        yield from self._tiles(exposure, Region.of_image(camera.model) if region is None else region, coarse, band)

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
        exposure, whole = self._expose(state, sensor, time_s, passes), Region.of_image(sensor.model)
        exposure.launched = self._launched(exposure, *self._cells(exposure, whole))

        def finish() -> CameraFrame:
            (tile,) = self._tiles(exposure, whole)
            return tile.frame

        return finish

    def _tiles(
        self, exposure: _Exposure, region: Region, coarse: Sequence[int] = (), band: int | None = None
    ) -> Iterator[Tile]:
        camera, passes = exposure.camera, exposure.passes
        whole, model = Region.of_image(camera.model), camera.model
        if exposure.fixer is not None and (region != whole or coarse or band is not None):
            (tile,) = self._tiles(exposure, whole)
            yield Tile(tile.frame.cropped(*region), region)
            return
        if _alone(exposure.tracer):
            yield from self._on_lattice(exposure, region, coarse, band)
            return
        for stride in coarse if region == whole else ():
            early = ("rgb", "unsupported") if "unsupported" in passes else ("rgb",)
            small = camera.resized(max(MIN_PREVIEW_WIDTH_PX, model.width // stride))
            preview = self.render(exposure.state, small, exposure.time_s, early)
            height, across = preview.rgb.shape[:2]
            y, x = model.height / height, model.width / across
            yield Tile(preview, whole, (y, x), (y / 2 - 0.5, x / 2 - 0.5))
        step = region.bottom - region.top if band is None else band
        for top in range(region.top, region.bottom, step):
            part = region._replace(top=top, bottom=min(top + step, region.bottom))
            yield Tile(self._block(exposure, part), part)

    def tracer(self, state: WorldState) -> Tracer[Any]:
        """Return the backend's tracer for a state; the one of the last state is kept."""
        return self._bound.tracer(state, self.quality)

    @property
    def reach(self) -> Reach:
        return reach_of(self.shadows or self.fill is not None)

    def margin(self, state: WorldState) -> int:
        """Return the number of pixels beside a ray's own that depend on it: the reach of the decoder, and the lattice's
        blocks."""
        tracer = self.tracer(state)
        fixed = 0 if self.fixer is None else WHOLE_IMAGE_PX
        return tracer.upsample * (tracer.reach + 1) + 2 * self.quality.lattice + fixed

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
            and _alone(tracer)
            and not tracer.active.mesh_actors.seen_by(camera).actors
            and not self._shadowing(state, camera)
        )

    def pixels(
        self, state: WorldState, camera: Camera, time_s: float, u: FloatArray, v: FloatArray
    ) -> NDArray[np.float32]:
        """Render single pixels at u, v (N,): colours (N, 3). They must not depend on others (`alone`)."""
        cells = u[None], v[None]
        exposure = self._expose(state, camera, time_s, ())
        colours = self._seen(exposure, cells, camera_rays(camera, time_s, *cells).flat(), 1)[0][0]
        if camera.model.is_pinhole:
            return colours
        return np.where(has_direction(camera.model, u, v)[:, None], colours, np.float32(0))

    def _expose(self, state: WorldState, camera: Camera, time_s: float, passes: Sequence[str]) -> _Exposure:
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
        drawn_on = bool(shadowing or moved or shadows or self.fill is not None)
        needed = _needed(self._with_evidence(passes), drawn_on)
        needed |= FINISHING_MAPS if state.weather is not None or self.fixer is not None else set()
        undeciding = needed - _needed(set(passes) - {"confidence"}, False)
        exposure = _Exposure(tracer, state, camera, time_s, passes, needed, undeciding, shadowing, moved, shadows)
        exposure.fill, exposure.fixer = self.fill, self.fixer
        if state.weather is not None:
            exposure.air = self.air(state, camera, time_s)
        return exposure

    def air(self, state: WorldState, camera: Camera, time_s: float) -> camera_weather.Air:
        """Return the air in a camera's images of a state: that of the recorded world without actors, so that no edit
        changes it. It is estimated once for an exposure."""
        small = camera.resized(min(SKY_WIDTH_PX, camera.model.width))
        path = camera.world_from_camera.between(*exposure_window(camera, time_s))
        key = (small.sensor_id, small.model_at(time_s), small.full_width, path.content(), time_s, self.quality)
        if key not in self._air:
            empty = replace(state, actors=(), static_copies=(), removed_boxes=(), weather=None, light=None)
            tracer = self._empty.tracer(empty, self.quality)
            clear = _Exposure(tracer, empty, small, time_s, ("rgb", "depth"), {"depth"})
            (tile,) = self._tiles(clear, Region.of_image(small.model))
            rays = camera_rays(small, time_s, *pixel_grid(small.model))
            up = np.flatnonzero((rays.directions[..., 2] > 0).reshape(-1))
            flat, probability = rays.flat(), np.ones(rays.time_s.shape, np.float32)
            above = Rays(flat.origins[up], flat.directions[up], flat.time_s[up])
            traced = tracer.trace(above, {"depth"}, False, None, RenderStats())
            probability.reshape(-1)[up] = tracer.returns(traced, above.directions)[1]
            if len(self._air) >= MAX_STORED_AIR:
                del self._air[next(iter(self._air))]
            self._air[key] = camera_weather.air_of(tile.frame, small, time_s, probability)
        return self._air[key]

    def _finished(self, exposure: _Exposure, frame: CameraFrame, region: Region) -> CameraFrame:
        """Return the frame of a region, fixed, in the state's weather, blank where its lens shows nothing."""
        rows, columns = slice(region.top, region.bottom), slice(region.left, region.right)
        if exposure.fixer is not None:
            self._fix(exposure, exposure.fixer, frame)
        self._put_in_weather(exposure, frame, rows, columns)
        _leave_out(frame, exposure.passes)
        return _blanked(frame, region)

    def _put_in_weather(
        self, exposure: _Exposure, frame: CameraFrame, rows: slice, columns: slice, preview: bool = False
    ) -> None:
        """Change a frame's colours by the state's weather, a preview's without particles, and leave out maps that only the
        weather needs. The frame is of these rows and columns of the image."""
        weather, air = exposure.state.weather, exposure.air
        if air is None or weather is None:
            return
        if exposure.particles is None and not preview:
            exposure.particles = camera_weather.drawn_particles(exposure.camera, exposure.time_s, weather)
        size = exposure.camera.model.height, exposure.camera.model.width
        sprayed = None
        if weather.wet:
            if exposure.mirror is None:
                exposure.mirror = self._mirror(exposure)
            frame.rgb = exposure.mirror.wetted(frame, weather.wet, air, rows, columns, size)
            assert frame.depth_m is not None
            if exposure.puffs is None:
                exposure.puffs = spray(exposure.state.actors, weather, exposure.time_s)
            if len(exposure.puffs.radii_m):
                sprayed = exposure.puffs.image_depth(exposure.camera, exposure.time_s, frame.depth_m, rows, columns)
        drawn = None if preview else exposure.particles
        frame.rgb = camera_weather.weathered(frame, weather, air, drawn, rows, columns, size, sprayed)

    def _fix(self, exposure: _Exposure, fixer: RecordedFixer, frame: CameraFrame) -> None:
        """Let the fixer draw anew what no recorded image shows in the frame of a whole image, and mark that as unsupported."""
        camera, time_s, recorded = exposure.camera, exposure.time_s, self.recorded_depth
        assert recorded is not None and frame.depth_m is not None and frame.instance is not None
        rays, shape, pose = (
            camera_rays(camera, time_s, *pixel_grid(camera.model)),
            frame.depth_m.shape,
            frame.world_from_camera,
        )
        maps = {"depth": frame.depth_m.reshape(-1), "instance": frame.instance.reshape(-1)}
        unseen = recorded.unseen(rays.flat(), maps["depth"], maps["instance"], self._own(exposure.state)).reshape(shape)
        weight = weight_of(unseen)
        if not weight.any():
            return
        known = np.isfinite(frame.depth_m)
        points = rays.origins + rays.directions * np.where(known, frame.depth_m, 0.0)[..., None]

        def exposed(image: Array, view: DepthView) -> Array:
            gain = self._bound.gain(view.sensor_id, view.time_s)
            return self._bound.exposed(image if gain is None else image / gain, camera.sensor_id, time_s)

        confidence = self._confidence(exposure, rays.flat(), maps).reshape(shape)
        references = fixer.references(recorded, pose, points, known & (frame.instance == 0), exposed)
        frame.rgb = fixer.fixed(
            ImageToFix(
                frame.rgb,
                frame.depth_m.copy(),
                frame.instance.copy(),
                confidence,
                weight,
                references,
                frame.model,
                pose,
            )
        )
        if frame.unsupported is not None:
            frame.unsupported = frame.unsupported | (weight > 0.5)

    def _mirror(self, exposure: _Exposure) -> wet_ground.Mirror:
        """Return what the ground reflects in an image, by a coarse one of which rays go on from the ground."""
        camera, time_s, tracer, weather = exposure.camera, exposure.time_s, exposure.tracer, exposure.state.weather
        assert weather is not None and exposure.air is not None
        small = camera.resized(min(MIRROR_WIDTH_PX, camera.model.width))
        rays = camera_rays(small, time_s, *pixel_grid(small.model))
        shape, flat, quality = rays.time_s.shape, rays.flat(), tracer.quality
        tracer.quality = QUALITIES["fast"]
        down = np.flatnonzero(flat.directions[:, 2] < 0)
        rays = Rays(flat.origins[down], flat.directions[down], flat.time_s[down])
        depth = tracer.trace(rays, {"depth"}, False, None, RenderStats()).maps["depth"]
        points = rays.origins + rays.directions * np.where(np.isfinite(depth), depth, 0.0)[:, None]
        some = np.flatnonzero(wet_ground.is_ground(tracer.heights(points), -rays.directions[:, 2]) & np.isfinite(depth))
        cosine = -rays.directions[some, 2]
        up = rays.directions[some] * [1, 1, -1]
        rays = Rays(points[some] + [0, 0, MIRROR_LIFT_M], up, rays.time_s[some])
        rgb, maps = self._row(exposure, rays, self._bound, tracer, {"depth"})
        tracer.quality = quality
        light = exposure.air.over(linear_from_srgb(rgb), camera_weather.air_through(weather, maps["depth"]))
        shown = np.zeros((shape[0] * shape[1], 6), np.float32)
        shown[down[some], 0], shown[down[some], 1], shown[down[some], 2] = 1, depth[some], cosine
        shown[down[some], 3:] = light
        shown = shown.reshape(*shape, 6)
        mirror = wet_ground.Mirror(shown[..., 0], shown[..., 1], shown[..., 2], shown[..., 3:])
        return mirror.drawn_out(small.model.pixels_per_rad)

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

    def _cells(self, exposure: _Exposure, region: Region) -> tuple[tuple[slice, slice], int, float]:
        """Return the rows and columns of cells that a region needs, and what `_lattice` returns for them."""
        tracer, model = exposure.tracer, exposure.camera.model
        if not _alone(tracer):
            return region.cells(tracer.upsample, tracer.reach, Region.of_image(model)), 1, 0.0
        size, spread = self._lattice(tracer, exposure.camera)
        spans = slice(region.top, region.bottom), slice(region.left, region.right)
        return aligned(spans, size, (model.height, model.width)), size, spread

    def _block(self, exposure: _Exposure, region: Region) -> CameraFrame:
        """Render a region by tracing all of its cells, and those around it that the decoder reads."""
        up, camera, time_s = exposure.tracer.upsample, exposure.camera, exposure.time_s
        cells, size, spread = self._cells(exposure, region)
        finished = self._on_device(exposure, cells, size, spread)
        u, v = (x[cells] for x in pixel_grid(camera.model, up))
        rays = camera_rays(camera, time_s, u, v) if finished is None or exposure.needs_rays else None
        along: FloatArray | Array | None
        if finished is not None:
            image, along, maps = finished.pop("rgb"), finished.pop("along", None), finished
            image = image.reshape(u.shape[0] * up, u.shape[1] * up, 3)
        else:
            assert rays is not None
            image, maps = self._seen(exposure, (u, v), rays, up)
            along = rays.directions @ camera.world_from_camera.at(time_s)[:3, 2] if "depth" in maps else None
        return self._finished(
            exposure, self._frame(exposure, image, maps, rays, along, region.within(cells, up)), region
        )

    def _on_lattice(
        self, exposure: _Exposure, region: Region, coarse: Sequence[int], band: int | None
    ) -> Iterator[Tile]:
        """Render tiles of the image by tracing the pixels that `progressive_strides` asks for."""
        camera, model, time_s, tracer = exposure.camera, exposure.camera.model, exposure.time_s, exposure.tracer
        (rows, columns), size, spread = self._cells(exposure, region)
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
            image, maps = self._seen(exposure, cells, rays, 1)
            if "confidence" in exposure.passes:
                maps["confidence"] = self._confidence(exposure, rays, maps)
            if in_view and size > 1:
                # meshes are sharper than the trained scene, and foreign actors may be
                maps[NEAR_BOXES] = beside_boxes(in_view, rays, size / least_pixels_per_rad(model))
            return image[0], maps

        sparse = SparseImage(shape, exposure.undeciding)
        steps: Iterable[tuple[int, slice]]
        along_all = None
        finished = self._on_device(exposure, (rows, columns), size, spread)
        if finished is not None:
            along_all, sparse.values = finished.pop("along", None), finished
            tops = range(0, shape[0], band or shape[0])
            steps = [(1, slice(top, min(top + tops.step, shape[0]))) for top in tops]
        else:
            steps = progressive_strides(sparse, size, spread, trace, coarse, band)
        for stride, done in steps:
            values = {name: x.reshape(*shape, *x.shape[1:]) for name, x in sparse.values.items() if name != NEAR_BOXES}
            if stride > 1:
                names = ("rgb", "unsupported", *(FINISHING_MAPS if exposure.air is not None else ()))
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
                self._put_in_weather(exposure, preview, few_rows, few_columns, preview=True)
                _leave_out(preview, ())
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
            finishes = exposure.needs_rays if finished is not None else exposure.is_drawn_on
            rays = camera_rays(camera, time_s, *np.broadcast_arrays(across, down)) if finishes else None
            along: FloatArray | Array | None = None
            if "depth" in maps:
                along = (
                    along_axis(camera, time_s, across, down) if along_all is None else along_all.reshape(shape)[inner]
                )
            del maps["rgb"]
            frame = self._frame(exposure, values["rgb"][inner], maps, rays, along, (slice(None), slice(None)))
            yield Tile(self._finished(exposure, frame, part), part)

    def _launched(
        self, exposure: _Exposure, cells: tuple[slice, slice], size: int, spread: float
    ) -> Callable[[RenderStats], Maps | None] | None:
        """Launch `lattice_image` of a tracer on a GPU; None where the host has to finish an image."""
        lattice_image = getattr(exposure.tracer, "lattice_image", None)
        seen = exposure.tracer.active.mesh_actors.seen_by(exposure.camera).actors
        if lattice_image is None or exposure.displaced or seen:
            return None
        waits: Callable[[RenderStats], Maps | None] | None = lattice_image(
            exposure.camera, exposure.time_s, cells, size, spread, exposure.needed, exposure.undeciding
        )
        return waits

    def _on_device(self, exposure: _Exposure, cells: tuple[slice, slice], size: int, spread: float) -> Maps | None:
        """Return the maps of cells from a GPU; None where the host has to trace or finish them."""
        waits, exposure.launched = exposure.launched or self._launched(exposure, cells, size, spread), None
        values = None if waits is None else waits(exposure.stats)
        if values is not None:
            values["rgb"] = self._bound.exposed(values["rgb"], exposure.camera.sensor_id, exposure.time_s)
        return values

    def _seen(
        self, exposure: _Exposure, cells: tuple[FloatArray, FloatArray], rays: Rays, up: int
    ) -> tuple[NDArray[np.float32], Maps]:
        """Return the image and the needed maps of cells with centres u, v (h, w) and rays through these. Rays are flat
        if neighbours are in sequence already."""
        (u, v), flat, tracer = cells, rays.flat(), exposure.tracer

        def light(actor: Actor) -> FloatArray:
            if actor.uid not in exposure.lights:
                exposure.lights[actor.uid] = self._light(exposure, actor)
            return exposure.lights[actor.uid]

        seen = tracer.active.mesh_actors.seen_by(exposure.camera)
        mesh_hits = seen.hit_by_camera(exposure.camera, exposure.time_s, (u, v), flat, up, NEAR_M, light)
        traced = tracer.trace(rays, exposure.needed, True, mesh_hits, exposure.stats)
        image = tracer.image(traced, flat.directions, exposure.camera.sensor_id, u.shape)
        image = self._bound.exposed(image, exposure.camera.sensor_id, exposure.time_s)
        if mesh_hits is not None and traced.mesh_opacity is not None:
            image = mesh_hits.over(image, traced.mesh_opacity, u.shape)
        if exposure.displaced:
            self._fade(exposure, cells, flat, up, image, traced.maps)
        return image, traced.maps

    def _fade(
        self,
        exposure: _Exposure,
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
        share = faded(points, rays.time_s, maps["instance"], exposure.displaced, recorded, exposure.tracer.heights)
        some = np.flatnonzero(share)
        if not len(some):
            return
        moved = {actor.uid for actor in exposure.displaced.values()}
        state = exposure.state.restricted([a.uid for a in exposure.state.actors if a.uid not in moved])
        tracer = self._behind.tracer(state, self.quality)
        without = replace(exposure, tracer=tracer, state=state, needed=set(), shadowing=[], displaced={}, shadows=None)
        shape = cells[0].shape
        if up == 1 and tracer.reach == 0:
            few = Rays(rays.origins[some], rays.directions[some], rays.time_s[some])
            u, v = (np.broadcast_to(x, shape).reshape(-1)[some][None] for x in cells)
            colours = self._seen(without, (u, v), few, up)[0].reshape(1, -1, 3)
            if exposure.shadows is not None:
                on_ground = np.zeros(len(some), np.int32)
                colours = dimmed(colours, self._sunlight(exposure, few, depth[some], on_ground, colours[0])[None])
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
        exposure: _Exposure,
        image: NDArray[np.float32],
        maps: Maps,
        rays: Rays | None,
        along: FloatArray | Array | None,
        inner: tuple[slice, slice],
    ) -> CameraFrame:
        """Return the frame of an image and its maps, cropped to ``inner``. ``rays`` are for contact shadows, ``along``
        is for depths (`fill_passes`)."""
        camera, time_s = exposure.camera, exposure.time_s
        up = exposure.tracer.upsample
        if exposure.is_drawn_on:
            assert rays is not None
            points, ground = _ground(exposure, image.shape, rays, maps)
            if exposure.fill is not None:
                image, maps = self._filled(exposure, exposure.fill, image, points, ground, maps)
            if exposure.is_shaded:
                image = self._shaded(exposure, image, points, ground, rays, maps)
        exposure.stats.seconds["image"] = time.perf_counter() - exposure.begun
        pose = camera.world_from_camera.at(time_s)
        model = camera.model_at(time_s)
        out = CameraFrame(model, pose, image[inner], instances=exposure.tracer.active.uids, stats=exposure.stats)
        shape = -(-image.shape[0] // up), -(-image.shape[1] // up)
        if "confidence" in exposure.passes and "confidence" not in maps:
            assert rays is not None
            maps = {**maps, "confidence": self._confidence(exposure, rays.flat(), maps)}
        fill_passes(out, {name: x for name, x in maps.items() if name in exposure.shown}, along, shape, up, inner)
        return out

    def _confidence(self, exposure: _Exposure, rays: Rays, maps: Maps) -> Array:
        """Return the confidence (N,) of flat rays (N,) of an image."""
        return self.confidence(exposure.state, exposure.camera.world_from_camera.at(exposure.time_s), rays, maps)

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
        return self.recorded_depth.near(pose, of_beam).evidence(rays, maps["depth"], maps["instance"], self._own(state))

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

    def _light(self, exposure: _Exposure, actor: Actor) -> FloatArray:
        """Return the brightness (3,), linear, of white ground under an actor, estimated from the ground beside it in
        the camera's colours."""
        points = beside(actor, exposure.time_s)
        points[:, 2] -= exposure.tracer.heights(points)
        tracer = self._lighting.tracer(exposure.state, self.quality)
        rgb, depth = self._probed(exposure, points, self._lighting, tracer)
        return level_of(rgb[depth < 2 * PROBE_M])

    def _filled(
        self,
        exposure: _Exposure,
        fill: GroundFill,
        image: NDArray[np.float32],
        points: FloatArray,
        ground: BoolArray,
        maps: Maps,
    ) -> tuple[NDArray[np.float32], Maps]:
        """Return the image, and its maps, with the ground filled that nobody saw, which no recorded ray supports, with contact
        shadows of recorded actors: others' are added later. Pixels show ``points`` (H, W, 3), ``ground`` (H, W) where those
        are of no actor."""
        up, flat = exposure.tracer.upsample, points.reshape(-1, 3)
        some = np.flatnonzero(ground)
        colours, share = fill.of_image(flat[some], np.ones(len(some), bool))
        there = np.flatnonzero(share[:, 0] > 0)
        there = there[np.abs(exposure.tracer.heights(flat[some[there]])) < wet_ground.GROUND_M]
        some, colours, share = some[there], colours[there], share[there]
        below = np.ones(len(some), bool)
        recorded = [a for a in exposure.state.actors if not a.inserted and a.visible_to(exposure.camera)]
        colours = shaded(colours[None], flat[some][None], below[None], recorded, exposure.time_s)[0]
        colours = self._bound.exposed(colours, exposure.camera.sensor_id, exposure.time_s)
        image = image.copy()
        shown = image.reshape(-1, 3)
        shown[some] += share * (colours - shown[some])
        if "unsupported" in maps:
            marked = np.zeros(ground.shape, bool)
            marked.reshape(-1)[some] = share[:, 0] > 0.5
            maps = {**maps, "unsupported": maps["unsupported"] | marked[up // 2 :: up, up // 2 :: up].reshape(-1)}
        return image, maps

    def _shaded(
        self,
        exposure: _Exposure,
        image: NDArray[np.float32],
        points: FloatArray,
        ground: BoolArray,
        rays: Rays,
        maps: Maps,
    ) -> NDArray[np.float32]:
        """Return the image of rays (h, w) with contact shadows on the ground, and the sun's shadows that edits move. Pixels show
        ``points`` (H, W, 3), ``ground`` (H, W) where those are of no actor."""
        up, depth = exposure.tracer.upsample, maps["depth"].reshape(rays.time_s.shape).astype(np.float64)
        shape = *rays.time_s.shape, 3
        rgb = image[up // 2 :: up, up // 2 :: up].reshape(-1, 3)
        image = shaded(image, points, ground, exposure.shadowing, exposure.time_s)
        if exposure.shadows is None:
            return image
        light = self._sunlight(exposure, rays.flat(), depth.reshape(-1), maps["instance"], rgb).reshape(shape)
        light = np.repeat(np.repeat(light, up, 0), up, 1)[: image.shape[0], : image.shape[1]]
        return dimmed(image, light)

    def _sunlight(
        self, exposure: _Exposure, rays: Rays, depth: FloatArray, instance: NDArray[np.int32], rgb: NDArray[np.float32]
    ) -> FloatArray:
        """Return the factors (N, 3) by which edits change the light of what flat rays hit at depths (N,) and show as
        ``rgb`` (N, 3)."""
        shadows, out = exposure.shadows, np.ones((len(depth), 3))
        assert shadows is not None
        solid = np.flatnonzero(np.isfinite(depth))
        rays = Rays(rays.origins[solid], rays.directions[solid], rays.time_s[solid])
        states = {"edited": shadows.edited, "recorded": shadows.recorded}

        def facing(some: NDArray[np.bool_]) -> FloatArray:
            part = Rays(rays.origins[some], rays.directions[some], rays.time_s[some])
            hits = exposure.tracer.active.mesh_actors.seen_by(exposure.camera).hit_by_rays(part, NEAR_M)
            normals = exposure.tracer.trace(part, {"normal"}, False, hits, RenderStats()).maps["normal"]
            return np.asarray(normals, np.float64)

        points = rays.origins + rays.directions * depth[solid, None]
        tracers = {name: self._blockers[name].tracer(state, self.quality) for name, state in states.items()}
        uids = exposure.tracer.active.uids

        def beside() -> GroundBeside:
            if exposure.beside is None:
                exposure.beside = self._ground_beside(exposure, shadows, tracers["recorded"])
            return exposure.beside

        brightness = linear_from_srgb(rgb[solid]).mean(1).astype(np.float64)
        out[solid] = shadows.factors(
            points, rays.time_s, uids, instance[solid], facing, tracers, brightness, beside
        )  # fmt: skip
        return out

    def _ground_beside(self, exposure: _Exposure, shadows: SunShadows, recorded: Tracer[Any]) -> GroundBeside:
        """Return the ground beside what has changed, in the camera's colours."""
        tracer = self._blockers["bare"].tracer(shadows.bare, self.quality)
        ring, wide = shadows.ring, around(exposure.camera.world_from_camera.at(exposure.time_s)[:3, 3])
        points = np.concatenate([ring, wide])
        points[:, 2] -= tracer.heights(points)
        rgb, depth = self._probed(exposure, points, self._blockers["bare"], tracer)
        known = depth < 2 * PROBE_M
        brightness = linear_from_srgb(rgb).mean(1).astype(np.float64)
        of_wide = brightness[len(ring) :][known[len(ring) :]]
        full_sun = float(np.quantile(of_wide, FULL_SUN)) if len(of_wide) else 0.0
        known[len(ring) :] = False
        known[known] = shadows.in_recorded_sun(points[known], exposure.time_s, recorded)
        return GroundBeside(points[known], shadows.ring_owner[known[: len(ring)]], brightness[known], full_sun)

    def _probed(
        self, exposure: _Exposure, points: FloatArray, binding: _Binding, tracer: Tracer[Any]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return colours (N, 3), in a camera's image, of what is at points (N, 3) and no actor, and its distances (N,)
        from `PROBE_M` before them."""
        camera, time_s = exposure.camera, exposure.time_s
        to = points - camera.world_from_camera.at(time_s)[:3, 3]
        distance = np.linalg.norm(to, axis=1, keepdims=True)
        directions = to / distance
        rays = Rays(points - directions * np.minimum(distance, PROBE_M), directions, np.full(len(points), time_s))
        rgb, maps = self._row(exposure, rays, binding, tracer, {"instance", "depth"})
        return rgb, np.where(maps["instance"] == 0, maps["depth"], np.inf)

    @staticmethod
    def _row(
        exposure: _Exposure, rays: Rays, binding: _Binding, tracer: Tracer[Any], needed: set[str]
    ) -> tuple[NDArray[np.float32], Maps]:
        """Return colours (N, 3), as in a camera's image, and the needed maps of flat rays (N,) that see no mesh. They are a row
        of cells: a decoder that reads neighbours sees ground on both sides."""
        sensor_id = exposure.camera.sensor_id
        traced = tracer.trace(rays, needed, True, None, RenderStats())
        rgb = tracer.image(traced, rays.directions, sensor_id, (1, len(rays.time_s)))[0, :: tracer.upsample]
        return binding.exposed(rgb, sensor_id, exposure.time_s), traced.maps

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
                intensity = self._filled_intensity(
                    state, rays.flat(), depth.reshape(-1), intensity.reshape(-1), instance
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
        if state.weather is None:
            return frame
        ground = puffs = None
        if state.weather.wet:
            puffs = spray(state.actors, state.weather, time_s)
            points = frame.origins + frame.directions * frame.depth_m[..., None]
            heights = self.tracer(state).heights(points.reshape(-1, 3)).reshape(frame.depth_m.shape)
            ground = frame.returned & wet_ground.is_ground(heights, -frame.directions[..., 2])
        return lidar_weather.weathered(frame, lidar, state.weather, time_s, ground, puffs)

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
        return depth, self._filled_intensity(state, flat, depth, intensity, instance), probability, instance

    def _filled_intensity(
        self, state: WorldState, rays: Rays, depth: Array, intensity: Array, instance: NDArray[np.int32]
    ) -> Array:
        """Return the intensities (N,) of flat beams (N,), those on ground that no sweep saw as it is filled."""
        if self.fill is None:
            return intensity
        points = rays.origins + rays.directions * depth[:, None]
        low = np.abs(self.tracer(state).heights(points)) < wet_ground.GROUND_M
        ground = (instance.reshape(-1) == 0) & (depth > 0) & low
        filled, share = self.fill.of_beams(points, ground)
        return np.where(share[:, 0] > 0, intensity + share[:, 0] * (filled[:, 0] - intensity), intensity)


def _ground(exposure: _Exposure, shape: tuple[int, ...], rays: Rays, maps: Maps) -> tuple[FloatArray, BoolArray]:
    """Return the places (H, W, 3) that the pixels of an image of ``shape`` show by rays (h, w), and where those are of no actor
    (H, W)."""
    up, depth = exposure.tracer.upsample, maps["depth"].reshape(rays.time_s.shape).astype(np.float64)
    points = rays.origins + rays.directions * np.where(np.isfinite(depth), depth, 1e6)[..., None]
    ground = (maps["instance"].reshape(rays.time_s.shape) == 0) & np.isfinite(depth)
    points, ground = (np.repeat(np.repeat(x, up, 0), up, 1)[: shape[0], : shape[1]] for x in (points, ground))
    return points, ground


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


def _leave_out(frame: CameraFrame, passes: Sequence[str]) -> None:
    """Leave out maps that are none of the passes and only finished the frame."""
    if "depth" not in passes:
        frame.depth_m = frame.z_depth_m = None
    if "instance" not in passes:
        frame.instance = None


def _blanked(frame: CameraFrame, region: Region) -> CameraFrame:
    """Return the frame of a region, blank where its lens shows nothing."""
    shown = image_mask(frame.model)
    if shown is not None:
        frame.blank(shown[region.top : region.bottom, region.left : region.right])
    return frame
