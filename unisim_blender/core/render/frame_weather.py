"""Rendered frames of clear air, put into the weather of their states."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..colour import linear_from_srgb
from ..geometry import FloatArray
from ..sensors.camera import camera_rays, pixel_grid
from ..sensors.frames import CameraFrame, LidarFrame, RenderStats
from ..sensors.rays import Rays, exposure_window
from ..weather import camera as camera_weather
from ..weather import lidar as lidar_weather
from ..weather import time_of_day, wet_ground
from ..weather.spray import spray
from ..world.drive import Camera, Lidar
from ..world.replay import WorldState
from ..world.weather import AS_RECORDED_DEG
from .pending_image import Binding, PendingImage, row_of_colours
from .quality import QUALITIES, Quality
from .sun_shadow import FULL_SUN
from .tracer import Backend

SKY_WIDTH_PX = 64
"""Width of the image from which the air is estimated, in pixels."""
MIRROR_WIDTH_PX, MIRROR_LIFT_M = 192, 0.05
"""Width of the coarse image of what the ground reflects, in pixels, and the height, metres, at which mirrored rays start."""
OPEN_SKY = 0.05
"""Part of the coarse image's sky about a pixel from which it may be sky at another time of day: a bright rest would show."""
MAX_STORED_AIR = 64
"""Number of images whose air is stored."""


class FrameWeather:
    """The weather of frames that a backend traces."""

    def __init__(self, backend: Backend) -> None:
        self._empty = Binding(backend)
        self._air: dict[tuple[object, ...], camera_weather.Air] = {}

    def air(
        self,
        state: WorldState,
        camera: Camera,
        time_s: float,
        quality: Quality,
        clear_frame: Callable[[PendingImage], CameraFrame],
    ) -> camera_weather.Air:
        """Return the air in a camera's images of a state: that of the recorded world without actors, so that no edit
        changes it. It is estimated once for an exposure. ``clear_frame`` renders a whole image that has no weather."""
        small = camera.resized(min(SKY_WIDTH_PX, camera.model.width))
        path = camera.world_from_camera.between(*exposure_window(camera, time_s))
        assert state.weather is not None
        of_day = state.weather.sun_elevation_deg < AS_RECORDED_DEG
        key = (small.sensor_id, small.model_at(time_s), small.full_width, path.content(), time_s, quality, of_day)
        if key not in self._air:
            empty = replace(state, actors=(), static_copies=(), removed_boxes=(), weather=None, light=None)
            tracer = self._empty.tracer(empty, quality)
            clear = PendingImage(tracer, empty, small, time_s, ("rgb", "depth"), {"depth"})
            rays = camera_rays(small, time_s, *pixel_grid(small.model))
            up = np.flatnonzero((rays.directions[..., 2] > 0).reshape(-1))
            flat, probability = rays.flat(), np.ones(rays.time_s.shape, np.float32)
            above = flat.part(up)
            traced = tracer.trace(above, {"depth"}, False, None, RenderStats())
            probability.reshape(-1)[up] = tracer.returns(traced, above.directions)[1]
            if len(self._air) >= MAX_STORED_AIR:
                del self._air[next(iter(self._air))]
            frame = clear_frame(clear)
            self._air[key] = camera_weather.air_of(frame, small, time_s, probability)
            if of_day:
                assert frame.depth_m is not None
                shown = np.isfinite(frame.depth_m) & np.isfinite(rays.directions).all(-1)
                points = rays.origins[shown] + rays.directions[shown] * frame.depth_m[shown, None]
                low = np.abs(tracer.heights(points)) < wet_ground.GROUND_M
                ground = linear_from_srgb(frame.rgb[shown][low]) @ camera_weather.LUMINANCE
                full_sun = float(np.quantile(ground, FULL_SUN)) if len(ground) else 0.0
                self._air[key] = self._air[key]._replace(full_sun=full_sun)
        return self._air[key]


def put_in_weather(
    pending: PendingImage, bound: Binding, frame: CameraFrame, rows: slice, columns: slice, preview: bool = False
) -> None:
    """Change a frame's colours by the state's weather, a preview's without particles. The frame is
    of these rows and columns of the image."""
    weather, air = pending.state.weather, pending.air
    if air is None or weather is None:
        return
    if pending.particles is None and not preview:
        pending.particles = camera_weather.drawn_particles(pending.camera, pending.time_s, weather)
    size = pending.camera.model.height, pending.camera.model.width
    sprayed = None
    if weather.sun_elevation_deg < AS_RECORDED_DEG:
        grid = (x[rows, columns] for x in pixel_grid(pending.camera.model))
        rays = camera_rays(pending.camera, pending.time_s, *grid)
        sky, tracer = air.sky(frame, rows, columns, size, OPEN_SKY), pending.tracer
        frame.rgb = time_of_day.shown(
            frame, pending.state, tracer.active.uids, weather, sky, rays, tracer.heights, air.full_sun
        )
        air = air._replace(light=air.light * time_of_day.light_of(weather.sun_elevation_deg).sky)
    if weather.wet:
        if pending.mirror is None:
            pending.mirror = mirrored(pending, bound, air)
        frame.rgb = pending.mirror.wetted(frame, weather.wet, air, rows, columns, size)
        assert frame.depth_m is not None
        if pending.puffs is None:
            pending.puffs = spray(pending.state.actors, weather, pending.time_s)
        if len(pending.puffs.radii_m):
            sprayed = pending.puffs.image_depth(pending.camera, pending.time_s, frame.depth_m, rows, columns)
    drawn = None if preview else pending.particles
    frame.rgb = camera_weather.weathered(frame, weather, air, drawn, rows, columns, size, sprayed)


def mirrored(pending: PendingImage, bound: Binding, air: camera_weather.Air) -> wet_ground.Mirror:
    """Return what the ground reflects in an image, by a coarse one of which rays go on from the ground, through ``air``."""
    camera, time_s, tracer, weather = pending.camera, pending.time_s, pending.tracer, pending.state.weather
    assert weather is not None
    small = camera.resized(min(MIRROR_WIDTH_PX, camera.model.width))
    rays = camera_rays(small, time_s, *pixel_grid(small.model))
    shape, flat, quality = rays.time_s.shape, rays.flat(), tracer.quality
    tracer.quality = QUALITIES["fast"]
    down = np.flatnonzero(flat.directions[:, 2] < 0)
    rays = flat.part(down)
    depth = tracer.trace(rays, {"depth"}, False, None, RenderStats()).maps["depth"]
    points = rays.origins + rays.directions * np.where(np.isfinite(depth), depth, 0.0)[:, None]
    some = np.flatnonzero(wet_ground.is_ground(tracer.heights(points), -rays.directions[:, 2]) & np.isfinite(depth))
    cosine = -rays.directions[some, 2]
    up = rays.directions[some] * [1, 1, -1]
    rays = Rays(points[some] + [0, 0, MIRROR_LIFT_M], up, rays.time_s[some])
    rgb, maps = row_of_colours(pending, rays, bound, tracer, {"depth"})
    tracer.quality = quality
    colours = linear_from_srgb(rgb)
    if weather.sun_elevation_deg < AS_RECORDED_DEG:
        of_day = time_of_day.light_of(weather.sun_elevation_deg)
        colours *= np.where(np.isinf(maps["depth"])[:, None], of_day.sky, of_day.ground).astype(np.float32)
    light = air.over(colours, camera_weather.air_through(weather, maps["depth"]))
    shown = np.zeros((shape[0] * shape[1], 6), np.float32)
    shown[down[some], 0], shown[down[some], 1], shown[down[some], 2] = 1, depth[some], cosine
    shown[down[some], 3:] = light
    shown = shown.reshape(*shape, 6)
    mirror = wet_ground.Mirror(shown[..., 0], shown[..., 1], shown[..., 2], shown[..., 3:])
    return mirror.drawn_out(small.model.pixels_per_rad)


def sweep_in_weather(
    frame: LidarFrame, state: WorldState, lidar: Lidar, time_s: float, heights: Callable[[FloatArray], FloatArray]
) -> LidarFrame:
    """Return the sweep of clear air at ``time_s`` in the state's weather."""
    if state.weather is None or state.weather.is_clear_of_water:
        return frame
    ground = puffs = None
    if state.weather.wet:
        puffs = spray(state.actors, state.weather, time_s)
        points = frame.origins + frame.directions * frame.depth_m[..., None]
        above = heights(points.reshape(-1, 3)).reshape(frame.depth_m.shape)
        ground = frame.returned & wet_ground.is_ground(above, -frame.directions[..., 2])
    return lidar_weather.weathered(frame, lidar, state.weather, time_s, ground, puffs)
