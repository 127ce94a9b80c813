"""Weather in images: light attenuated on its way, airlight of the sky's colour at the horizon (Koschmieder 1924; Nayar &
Narasimhan, ICCV 1999), and drops and flakes near the camera, drawn as far as they move while it is exposed (Garg & Nayar
2007). Particles are of the airlight's colour."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb, srgb_from_linear
from ..geometry import BoolArray, FloatArray
from ..sensors.camera import camera_rays, pixel_grid
from ..sensors.frames import CameraFrame
from ..sensors.rays import exposure_window
from ..sensors.silhouettes import view_half_angle
from ..world.drive import Camera
from ..world.weather import Weather
from .atmosphere import extinctions, transmittance
from .particles import ParticleClass, Particles, particle_classes

HORIZON_WIDTH_RAD = 0.15
"""Angle above the horizon over which the sky counts less, by a factor e, for the airlight."""
CLOUDY_SHARE = 0.02
"""Share of an image that what is no sky counts for, so that the airlight does not jump where the last sky vanishes."""
DARKEST_SKY, REDDEST_SKY = 0.4, 0.9
"""Luminance, and blue over red, of the darkest and of the reddest sky, relative to the airlight's."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
NEAREST_M, FURTHEST_M = 0.3, 12.0
"""Distances along the optical axis between which particles are drawn."""
LEAST_WIDTH_PX, LEAST_OPACITY = 0.5, 0.01
"""Width and mean opacity below which a particle is part of the air."""
MAX_RADIUS_PX = 24
MAX_STEPS = 256
"""Largest number of places at which a moving particle is drawn."""


class Air(NamedTuple):
    """What a camera's clear image says of the air: ``light`` (3,), the airlight, linear Rec.709, and ``open_sky`` (h, w),
    where a coarse image of all of it shows sky, 0 to 1: beams would not return from there (`sky_shown`). ``full_sun`` is the
    luminance of ground in the sun, 0 where there is none, or no time of day is asked for."""

    light: FloatArray
    open_sky: NDArray[np.float32]
    full_sun: float = 0.0

    def over(self, colours: NDArray[np.float32], through: NDArray[np.float32]) -> NDArray[np.float32]:
        """Put the airlight over linear colours (..., 3), in place, by the transmittance (...) in front of them."""
        light = self.light.astype(np.float32)
        colours -= light
        colours *= through[..., None]
        colours += light
        return colours

    def sky(
        self, frame: CameraFrame, rows: slice, columns: slice, size: tuple[int, int], least: float = 0.5
    ) -> BoolArray:
        """Return which pixels (h, w) show sky: those without a surface, and those of a surface that for ``least`` of the coarse
        image would not return a beam and is as bright and as blue as the airlight. The frame is of these rows and columns
        of an image of ``size``, height and width."""
        assert frame.depth_m is not None
        sky = np.isinf(frame.depth_m)
        if not self.open_sky.any():
            return sky
        numbers = np.arange(size[0])[rows]
        lowest = (np.flatnonzero(self.open_sky.any(1))[-1] + 1.5) * size[0] / len(self.open_sky)
        count = int(np.searchsorted(numbers, lowest))
        if not count:
            return sky
        rows = slice(int(numbers[0]), int(numbers[count - 1]) + 1, rows.step)
        weights = interpolated(self.open_sky[..., None], rows, columns, size)[..., 0]
        y, x = np.nonzero((weights > least) & ~sky[:count])
        if frame.instance is not None:
            still = frame.instance[y, x] == 0
            y, x = y[still], x[still]
        sky[y, x] = is_sky_coloured(linear_from_srgb(frame.rgb[y, x]), self.light)
        return sky


def interpolated(
    coarse: NDArray[np.float32], rows: slice, columns: slice, size: tuple[int, int]
) -> NDArray[np.float32]:
    """Return the values (H, W, C) of a coarse image (h, w, C) at these rows and columns of an image of ``size``, height and
    width: bilinear."""
    for axis, (part, count) in enumerate(zip((rows, columns), size, strict=True)):
        cells = coarse.shape[axis]
        at = np.clip((np.arange(count)[part] + 0.5) * cells / count - 0.5, 0, cells - 1).astype(np.float32)
        low = np.minimum(at.astype(np.int64), max(cells - 2, 0))
        share = (at - low).reshape((-1, 1, 1) if axis == 0 else (1, -1, 1))
        coarse = coarse.take(low, axis) * (1 - share) + coarse.take(np.minimum(low + 1, cells - 1), axis) * share
    return coarse


def is_sky_coloured(colours: NDArray[np.float32], light: FloatArray) -> BoolArray:
    """Return which colours (..., 3), linear, may be a sky's whose light near the horizon is ``light`` (3,)."""
    bright = colours @ LUMINANCE >= DARKEST_SKY * float(light @ LUMINANCE)
    return np.asarray(bright & (colours[..., 2] * light[0] >= REDDEST_SKY * colours[..., 0] * light[2]))


def air_of(frame: CameraFrame, camera: Camera, time_s: float, probability: NDArray[np.float32]) -> Air:
    """Return the air that a whole clear image of a camera with depths shows, given the probabilities (h, w) that beams
    through its pixels return. The airlight is the colour of the sky near the horizon, with a little of the grey of the
    image's brightest tenth, which is all where no sky is seen. Above the horizon, what returns no beam may be sky."""
    assert frame.depth_m is not None
    colours = linear_from_srgb(frame.rgb).reshape(-1, 3)
    up = camera_rays(camera, time_s, *pixel_grid(frame.model)).directions[..., 2].reshape(-1)
    sky = np.isinf(frame.depth_m.reshape(-1)) & (np.abs(up) <= 1)
    weights = np.where(sky, np.exp(-np.abs(np.where(sky, up, 0.0)) / HORIZON_WIDTH_RAD), 0.0)
    grey = float(np.quantile(colours @ LUMINANCE, 0.9))
    rest = CLOUDY_SHARE * len(colours)
    light = np.asarray((weights @ colours + rest * grey) / (weights.sum() + rest))
    return Air(light, ((up.reshape(probability.shape) > 0) & (probability < 0.5)).astype(np.float32))


class Covered(NamedTuple):
    """Pixels (N,) by their flat numbers, each covered by a particle at a distance along the ray, metres, for a part
    ``opacity`` of its area and of the exposure. Parts add up to 1 at most, which is exact for a single particle."""

    pixels: NDArray[np.int64]
    range_m: NDArray[np.float32]
    opacity: NDArray[np.float32]


class DrawnParticles(NamedTuple):
    """What particles cover of an image. The air's own drops and flakes begin at ``bulk_from_m``, on average."""

    covered: Covered
    bulk_from_m: float

    def coverage(self, frame: CameraFrame, rows: slice, columns: slice, width: int) -> NDArray[np.float32]:
        """Return the opacity (h, w) of what is in front of a frame's surfaces; the frame is of these rows and
        columns of an image of this width."""
        assert frame.depth_m is not None
        pixels, ranges, opacities = self.covered
        y, x = np.divmod(pixels, width)
        some = (y >= rows.start) & (y < rows.stop) & (x >= columns.start) & (x < columns.stop)
        shape = frame.depth_m.shape
        at = (y[some] - rows.start) * shape[1] + x[some] - columns.start
        front = ranges[some] < frame.depth_m.reshape(-1)[at]
        sums = np.bincount(at[front], opacities[some][front], shape[0] * shape[1])
        return np.minimum(sums, 1).astype(np.float32).reshape(shape)


def drawn_particles(camera: Camera, time_s: float, weather: Weather) -> DrawnParticles:
    """Return what the drops and flakes near a camera cover of its image at ``time_s``."""
    parts = [Covered(np.zeros(0, np.int64), np.zeros(0, np.float32), np.zeros(0, np.float32))]
    drawn = 0.0
    for group in particle_classes(weather):
        moving = _Moving(camera, time_s, group, weather.receiver.exposure_s)
        parts += moving.drawn()
        drawn += group.extinction * moving.far_m
    falling = sum(value for name, value in extinctions(weather).items() if name != "fog")
    covered = Covered(*(np.concatenate(values) for values in zip(*parts, strict=True)))
    return DrawnParticles(covered, drawn / falling if falling else 0.0)


class _Moving:
    """Particles of a class in front of a camera while an image is exposed."""

    def __init__(self, camera: Camera, time_s: float, group: ParticleClass, exposure_s: float) -> None:
        self.model, self.group, self.exposure_s = camera.model_at(time_s), group, exposure_s
        shutter = self.model.shutter
        lines = self.model.width if shutter.axis == "columns" else self.model.height
        self.along_u = shutter.axis == "columns"
        self.times_s = time_s + shutter.duration_s * ((np.arange(lines) + 0.5) / lines - shutter.reference)
        trajectory = camera.world_from_camera
        self.poses = trajectory.at(self.times_s)
        start, end = exposure_window(camera, time_s)
        start, end = min(start, time_s - exposure_s), max(end, time_s + exposure_s)
        ends = trajectory.at(np.array([start, end]))[:, :3, 3]
        self.velocity = np.array([0.0, 0.0, -group.speed_m_s]) - (ends[1] - ends[0]) / (end - start)
        self.middle_s, self.middle = time_s, trajectory.at(time_s)
        focal, size = self.model.pixels_per_rad, group.largest_m
        streak = max(float(np.linalg.norm(self.velocity)) * exposure_s, size)
        far = min(size**2 * focal / (LEAST_OPACITY * streak), size * focal / LEAST_WIDTH_PX, FURTHEST_M)
        self.far_m = max(far, NEAREST_M)
        self.half_angle = view_half_angle(self.model, 8)

    def _near(self, points: FloatArray, radius: float) -> BoolArray:
        """Return whether spheres (N,) may be in view."""
        to = points - self.middle[:3, 3]
        distance = np.sqrt(np.einsum("ij,ij->i", to, to))
        ahead = to @ self.middle[:3, 2]
        beside = np.sqrt(np.maximum(distance**2 - ahead**2, 0))
        slack = radius + float(np.linalg.norm(self.velocity)) * float(np.abs(self.times_s - self.middle_s).max()) + 0.05
        inside = ahead * np.sin(self.half_angle) - beside * np.cos(self.half_angle) > -slack
        return np.asarray(inside & (ahead < self.far_m + slack))

    def _box(self) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and highest coordinates (3,), world frame, of what is in view and near."""
        u, v = np.meshgrid([0, self.model.width / 2, self.model.width], [0, self.model.height / 2, self.model.height])
        rays = self.model.unproject(u.reshape(-1), v.reshape(-1))
        if np.isfinite(rays).all() and rays[:, 2].min() > 0.2:
            corners = self.far_m * rays / rays[:, 2:] @ self.middle[:3, :3].T
        else:
            corners = self.far_m * np.array([[-2.0, -2, -2], [2, 2, 2]])
        return self.middle[:3, 3] + np.minimum(corners.min(0), 0) - 0.5, self.middle[:3, 3] + np.maximum(
            corners.max(0), 0
        ) + 0.5

    def _local(self, points: FloatArray, line: NDArray[np.int64]) -> FloatArray:
        poses = self.poses[line]
        return np.einsum("nji,nj->ni", poses[:, :3, :3], points - poses[:, :3, 3])

    def _line(self, u: FloatArray, v: FloatArray) -> NDArray[np.int64]:
        at = np.nan_to_num(u if self.along_u else v)
        return np.clip(np.floor(at), 0, len(self.times_s) - 1).astype(np.int64)

    def drawn(self) -> Iterator[Covered]:
        """Yield what the particles cover."""
        for particles in self.group.inside(*self._box(), self.middle_s, self._near):
            yield from self._streaks(particles)

    def _streaks(self, particles: Particles) -> Iterator[Covered]:
        falling = np.array([0.0, 0.0, -self.group.speed_m_s])
        line = np.full(len(particles.positions), len(self.times_s) // 2)
        for _ in range(2):
            # when a line is exposed that shows a particle depends on where it is then
            points = particles.positions + (self.times_s[line] - self.middle_s)[:, None] * falling
            local = self._local(points, line)
            u, v, valid = self.model.project(local)
            line = self._line(u, v)
        some = np.flatnonzero(valid & (local[:, 2] > NEAREST_M) & (local[:, 2] < self.far_m))
        half = (self.poses[line[some], :3, :3] * self.velocity[:, None]).sum(1) * self.exposure_s / 2
        local, diameters = local[some], particles.diameters_m[some]
        (u0, v0, ok0), (u1, v1, ok1) = self.model.project(local - half), self.model.project(local + half)
        width = diameters * self.model.pixels_per_rad / local[:, 2]
        size = self.model.width, self.model.height
        margin = width / 2 + 1
        inside = ok0 & ok1 & (np.maximum(u0, u1) > -margin) & (np.maximum(v0, v1) > -margin)
        inside &= (np.minimum(u0, u1) < size[0] + margin) & (np.minimum(v0, v1) < size[1] + margin)
        distance = np.linalg.norm(local, axis=1)
        u0, v0, u1, v1 = (x[inside] for x in (u0, v0, u1, v1))
        yield from covered_by(u0, v0, u1, v1, width[inside], distance[inside], *size)


def covered_by(
    u0: FloatArray, v0: FloatArray, u1: FloatArray, v1: FloatArray, width: FloatArray, distance: FloatArray,
    image_width: int, image_height: int,
) -> Iterator[Covered]:  # fmt: skip
    """Yield what discs of a width (N,), pixels, cover that move from u0, v0 to u1, v1. At each of a number of places along
    its way a disc covers pixels for its part of the exposure; one smaller than a pixel covers parts of the nearest four."""
    steps = np.clip(np.ceil(np.hypot(u1 - u0, v1 - v0) / np.maximum(1.0, width / 2)), 1, MAX_STEPS).astype(np.int64)
    disc = np.repeat(np.arange(len(steps)), steps)
    place = np.arange(len(disc)) - np.repeat(np.cumsum(steps) - steps, steps)
    fraction = (place + 0.5) / steps[disc]
    u, v = u0[disc] + fraction * (u1 - u0)[disc], v0[disc] + fraction * (v1 - v0)[disc]
    radius = np.where(width <= 1, 0, np.clip(np.ceil(width / 2 + 0.5), 1, MAX_RADIUS_PX)).astype(np.int64)[disc]
    for r in np.flatnonzero(np.bincount(radius, minlength=1)).tolist():
        chosen = np.flatnonzero(radius == r)
        which, at_u, at_v = disc[chosen], u[chosen][:, None], v[chosen][:, None]
        # pixels about the nearest corner, or about the pixel
        dy, dx = (d.reshape(-1) for d in (np.mgrid[-1:1, -1:1] if r == 0 else np.mgrid[-r : r + 1, -r : r + 1]))
        x, y = (np.floor(at + (0.5 if r == 0 else 0.0)).astype(np.int64) + d for at, d in ((at_u, dx), (at_v, dy)))
        off_u, off_v = np.abs(x + 0.5 - at_u), np.abs(y + 0.5 - at_v)
        size = width[which][:, None]
        if r == 0:
            covered = np.pi / 4 * size**2 * (1 - off_u) * (1 - off_v)
        else:
            # the edge's slope adds a twelfth of a pixel's area to the square of the radius
            covered = np.clip(np.sqrt(size**2 / 4 - 1 / 12) + 0.5 - np.hypot(off_u, off_v), 0, 1)
        some = (covered > 1e-3) & (x >= 0) & (x < image_width) & (y >= 0) & (y < image_height)
        opacity = (covered / steps[which][:, None])[some]
        ranges = np.broadcast_to(distance[which][:, None], x.shape)[some]
        yield Covered((y * image_width + x)[some], ranges.astype(np.float32), opacity.astype(np.float32))


def weathered(
    frame: CameraFrame, weather: Weather, air: Air, drawn: DrawnParticles | None = None,
    rows: slice = slice(None), columns: slice = slice(None), size: tuple[int, int] | None = None,
    sprayed: NDArray[np.float32] | None = None,
) -> NDArray[np.float32]:  # fmt: skip
    """Return the colours (H, W, 3), sRGB, of a clear frame with depths in weather. The frame is of these rows and columns of
    an image of ``size``, height and width, in which particles are drawn, if any are. ``sprayed`` (H, W) is the optical
    depth of spray."""
    assert frame.depth_m is not None
    parts = extinctions(weather)
    size = size or (frame.depth_m.shape[0], frame.depth_m.shape[1])
    fog, falling = parts["fog"], parts["rain"] + parts["snow"]
    if not fog + falling and sprayed is None:
        return frame.rgb
    through = np.ones(frame.depth_m.shape, np.float32)
    if fog + falling:
        depth_m = np.where(air.sky(frame, rows, columns, size), np.float32(np.inf), frame.depth_m)
        through = transmittance(fog + falling, depth_m)
        if drawn is not None:
            through *= 1 - drawn.coverage(frame, rows, columns, size[1])
            # what is drawn is not in the air a second time
            through *= np.exp(np.float32(falling) * np.minimum(depth_m, np.float32(drawn.bulk_from_m)))
    if sprayed is not None:
        through *= np.exp(-sprayed)
    return srgb_from_linear(air.over(linear_from_srgb(frame.rgb), through))


def air_through(weather: Weather, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the transmittance (...) of the air over depths (...), metres, inf for the sky, without drawn particles."""
    return transmittance(sum(extinctions(weather).values()), depth_m)
