"""Weather in sweeps: targets attenuated and lost, and returns of what is in the air in front of them.

Powers are those of a diffuse target of reflectivity 1 at 1 m. A target has the power rho exp(-2 a R) xi(R) / R². What is
in the air returns the pulse's shape over its own backscatter (Rasshofer et al. 2011; Hahner et al., ICCV 2021):

    P(R) = pi b (c/2) integral of sin²(pi t / 2T) exp(-2 a r) xi(r) / r² dt from 0 to 2T, r = R - c t / 2 below the target

with extinction a, backscatter b, half-power width T, and xi(r) = min(1, (r / overlap)²), the part of the light that the
receiver sees. In each range cell of a pulse's length it fluctuates with an exponential distribution of this mean, as
speckle does; the strongest of all is the beam's return.

Drops and flakes of `particles.py` are targets that fill a part of a beam (LISA, Kilic et al. 2021; Hahner et al., CVPR
2022): of diameter D, in a beam of divergence B, the power is rho min(1, (D / B R)²) exp(-2 a R) xi(R) / R².
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import BoolArray, FloatArray
from ..sensors.frames import LidarFrame
from ..sensors.lidar import column_azimuths, column_times
from ..sensors.rays import Rays
from ..world.captures import Capture, microseconds
from ..world.drive import Lidar
from ..world.weather import Receiver, Weather
from .atmosphere import LIDAR_RATIO_SR, backscatter, extinctions
from .particles import ParticleClass, Particles, particle_classes
from .spray import Puffs
from .wet_ground import beam_gain

LIGHT_M_NS = 0.299792458
PULSE_STEPS = 32
"""Number of steps of the integral over a pulse."""
MAX_FLUCTUATION = 12.0
"""Largest factor of an exponential distribution that is looked for: one draw in 160 000 is larger."""
MAX_SOFT_M = 100.0
"""Largest range from which air is measured, metres."""
MAX_PARTICLE_M, MAX_PARTICLES = 20.0, 200_000
"""Largest range from which single particles are measured, metres, and number of a class within it all round the sensor: small
particles are many, and are measured only near by."""
SEAM_RAD = 0.05
"""Angle before a sweep's first column within which it, too, is looked for."""


def cell_length_m(receiver: Receiver) -> float:
    """Return the length of a range cell, metres."""
    return receiver.pulse_ns * LIGHT_M_NS / 2


def overlap(range_m: FloatArray, receiver: Receiver) -> FloatArray:
    """Return the part (...) of the light from ranges (...) that a receiver sees: nearer than ``overlap_m`` its blurred
    image is larger than the detector."""
    return np.minimum(1.0, (range_m / receiver.overlap_m) ** 2)


def soft_power(range_m: FloatArray, extinction: float, scattered: float, receiver: Receiver) -> FloatArray:
    """Return the mean power (...) from air with a backscatter ``scattered``, 1/(m sr), at ranges (...), metres."""
    step = 2 * receiver.pulse_ns / PULSE_STEPS
    t = (np.arange(PULSE_STEPS) + 0.5) * step
    r = np.asarray(range_m)[..., None] - LIGHT_M_NS * t / 2
    near = np.maximum(r, 1e-3)
    shape = np.sin(np.pi * t / (2 * receiver.pulse_ns)) ** 2
    power = np.where(r > 0, shape * np.exp(-2 * extinction * near) * overlap(near, receiver) / near**2, 0.0)
    return np.asarray(math.pi * scattered * LIGHT_M_NS / 2 * step * power.sum(-1))


def detectable(receiver: Receiver, max_range_m: float) -> float:
    """Return the least power that a receiver measures: that of its darkest target at its largest range."""
    return receiver.threshold / max_range_m**2


def is_lost(
    intensity: NDArray[np.float32], depth_m: FloatArray, extinction: float, receiver: Receiver, max_range_m: float,
    gain: FloatArray | float = 1.0,
) -> BoolArray:  # fmt: skip
    """Return whether targets (...) that return in clear air, dry, are below the threshold: their reserve there is 1 plus
    their power over the threshold's, so that none is lost without weather. ``gain`` (...) is that of wet ground."""
    reserve = 1 + intensity / receiver.threshold * (max_range_m / np.maximum(depth_m, 1e-3)) ** 2
    return np.asarray(reserve * gain * np.exp(-2 * extinction * depth_m) < 1)


def soft_cells(
    extinction: float, scattered: float, receiver: Receiver, least: float, min_range_m: float, max_range_m: float
) -> tuple[FloatArray, FloatArray]:
    """Return where range cells begin, metres, and the mean powers from them (K,), of cells that may return ``least``. A
    pulse's middle comes back from a cell's middle."""
    length = cell_length_m(receiver)
    starts = np.arange(min_range_m, min(max_range_m, MAX_SOFT_M), length)
    means = soft_power(starts + 1.5 * length, extinction, scattered, receiver)
    some = means * MAX_FLUCTUATION >= least
    return starts[some], means[some]


def weathered(
    frame: LidarFrame, lidar: Lidar, weather: Weather, time_s: float, ground: BoolArray | None = None,
    puffs: Puffs | None = None,
) -> LidarFrame:  # fmt: skip
    """Return the sweep at ``time_s`` in weather, given the clear one, of which ``ground`` (B, C) may be wet, and the spray of
    vehicles. Beams that return what is in the air belong to no actor, and have the intensity of a diffuse target with
    their power. Random draws depend on the weather's seed, the LiDAR and the time alone."""
    receiver, model = weather.receiver, frame.model
    extinction, least = sum(extinctions(weather).values()), detectable(receiver, model.max_range_m)
    target_m = np.maximum(frame.depth_m.astype(np.float64), 1e-3)
    passed = np.exp(-2 * extinction * target_m)
    gain = np.ones(target_m.shape)
    if ground is not None:
        gain[ground] = beam_gain(frame.intensity[ground], -frame.directions[ground][:, 2], weather.wet)
    limit_m = np.where(frame.depth_m > 0, target_m, model.max_range_m)
    if lidar.blocked is not None:
        limit_m[lidar.blocked] = 0.0
    rng = np.random.default_rng(Capture(lidar.sensor_id, microseconds(time_s)).seed(weather.seed))
    sprayed = None if puffs is None else _spray_returns(puffs, frame, lidar, time_s, limit_m, extinction, receiver, rng)
    if sprayed is not None:
        gain *= sprayed.through.reshape(gain.shape)
    lost = frame.returned & is_lost(frame.intensity, target_m, extinction, receiver, model.max_range_m, gain)
    passed *= gain
    seen = frame.returned & ~lost
    power = np.where(seen, frame.intensity * passed * overlap(target_m, receiver) / target_m**2, 0.0)
    strongest = np.maximum(power, least)
    length, cell_m = cell_length_m(receiver), np.full(limit_m.shape, np.inf)
    cells = soft_cells(extinction, backscatter(weather), receiver, least, model.min_range_m, model.max_range_m)
    for start_m, mean in zip(*cells, strict=True):
        power = rng.standard_exponential(limit_m.shape, np.float32) * np.clip(
            (limit_m - start_m) * mean / length, 0, mean
        )
        wins = power > strongest
        strongest[wins], cell_m[wins] = power[wins], start_m
    in_air = np.isfinite(cell_m)
    start_m = cell_m[in_air]
    cell_m[in_air] += rng.random(len(start_m)) * np.minimum(length, limit_m[in_air] - start_m)
    for group in particle_classes(weather):
        beams, range_m, power = particle_returns(group, lidar, time_s, receiver, least, extinction)
        _strongest(beams, range_m, power, limit_m, model.min_range_m, strongest, cell_m)
    if sprayed is not None:
        _strongest(sprayed.beams, sprayed.range_m, sprayed.power, limit_m, model.min_range_m, strongest, cell_m)
    in_air = np.isfinite(cell_m)
    range_m = cell_m[in_air]
    depth_m, intensity = frame.depth_m.copy(), (frame.intensity * passed).astype(np.float32)
    depth_m[in_air] = range_m
    intensity[in_air] = np.minimum(strongest[in_air] * range_m**2 / overlap(range_m, receiver), 1.0)
    probability = np.where(in_air, 1, np.where(lost, 0, frame.return_probability)).astype(np.float32)
    instance = np.where(in_air, 0, frame.instance).astype(np.int32)
    return replace(
        frame,
        depth_m=depth_m,
        intensity=intensity,
        return_probability=probability,
        returned=seen | in_air,
        instance=instance,
    )


def _strongest(
    beams: NDArray[np.int64], range_m: FloatArray, power: FloatArray, limit_m: FloatArray, min_range_m: float,
    strongest: FloatArray, at_m: FloatArray,
) -> None:  # fmt: skip
    """Let returns (N,) of beams, by flat numbers, in front of ``limit_m`` (B, C) replace weaker ones, with powers
    ``strongest`` (B, C), at ``at_m`` (B, C)."""
    inside = (range_m > min_range_m) & (range_m < limit_m.reshape(-1)[beams])
    order = np.flatnonzero(inside & (power > strongest.reshape(-1)[beams]))
    order = order[np.lexsort((range_m[order], power[order]))]
    # of equal indices the last one, the strongest, stays
    strongest.reshape(-1)[beams[order]] = power[order]
    at_m.reshape(-1)[beams[order]] = range_m[order]


class _SprayReturns(NamedTuple):
    """Returns (N,) of spray by beams' flat numbers, and the transmittances (B C,) to targets and back."""

    beams: NDArray[np.int64]
    range_m: FloatArray
    power: FloatArray
    through: FloatArray


def _spray_returns(
    puffs: Puffs, frame: LidarFrame, lidar: Lidar, time_s: float, limit_m: FloatArray, extinction: float,
    receiver: Receiver, rng: np.random.Generator,
) -> _SprayReturns | None:  # fmt: skip
    """Return what beams that end at ``limit_m`` (B, C) return of spray; None where none meets any. A puff that is shorter
    than a pulse has the power pi (optical depth / lidar ratio) exp(-2 ...) xi / R², which fluctuates as that of air does."""
    if not len(puffs.radii_m):
        return None
    around = Particles(puffs.middles, 4 * puffs.radii_m)
    beams, which, _ = _BeamFinder(lidar, time_s, 0.0).hits(around, 0.0)
    if not len(beams):
        return None
    origins, directions = (x.reshape(-1, 3)[beams] for x in (frame.origins, frame.directions))
    rays = Rays(origins, directions, frame.time_s.reshape(-1)[beams])
    depth, at_m = puffs.depth_of(which, rays, limit_m.reshape(-1)[beams])
    order = np.lexsort((which, at_m, beams))
    beams, which, depth, at_m = (x[order] for x in (beams, which, depth, at_m))
    total = np.cumsum(depth)
    begins = np.searchsorted(beams, beams)
    before = total - depth - (total[begins] - depth[begins])
    at_m = np.maximum(at_m + rng.standard_normal(len(at_m)) * puffs.radii_m[which], 0.05)
    mean = math.pi * depth / LIDAR_RATIO_SR["rain"] * overlap(at_m, receiver) / at_m**2
    power = rng.standard_exponential(len(at_m)) * mean * np.exp(-2 * (before + extinction * at_m))
    through = np.exp(-2 * np.bincount(beams, depth, limit_m.size))
    return _SprayReturns(beams, at_m, power, through)


def particle_returns(
    group: ParticleClass, lidar: Lidar, time_s: float, receiver: Receiver, least: float, extinction: float
) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Return which beams (N,) of the sweep at ``time_s``, by flat numbers, hit which particles of a class that return
    ``least``: their ranges (N,), metres, and powers (N,)."""
    finder = _BeamFinder(lidar, time_s, group.speed_m_s)
    reflectivity = 2 * math.pi / LIDAR_RATIO_SR[group.kind]

    def received(diameter_m: FloatArray | float, range_m: FloatArray) -> FloatArray:
        return particle_power(diameter_m, range_m, reflectivity, receiver) * np.exp(-2 * extinction * range_m)

    ranges = np.linspace(0.05, MAX_PARTICLE_M, 400)
    far_m = float(ranges[received(group.largest_m, ranges) >= least].max(initial=0.1))
    per_m3 = group.layers / group.cell_m**3
    far_m = min(far_m, (MAX_PARTICLES / (4 / 3 * math.pi * per_m3)) ** (1 / 3))
    divergence = receiver.divergence_mrad * 1e-3
    parts = [(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))]
    for particles in group.inside(*finder.box(far_m), finder.middle_s, finder.near(far_m, divergence)):
        # none returns more than where it is nearest to the sensor
        to = particles.positions - finder.origin
        nearest = np.maximum(np.sqrt(np.einsum("ij,ij->i", to, to)) - finder.moved_m, 1e-3)
        some = (nearest <= far_m) & (received(particles.diameters_m, nearest) >= least)
        particles = Particles(particles.positions[some], particles.diameters_m[some])
        beams, which, distance = finder.hits(particles, divergence)
        power = received(particles.diameters_m[which], distance)
        strong = (power >= least) & (distance <= far_m)
        parts.append((beams[strong], distance[strong], power[strong]))
    beams, distances, powers = (np.concatenate(values) for values in zip(*parts, strict=True))
    return beams, distances, powers


class _BeamFinder:
    """The beams of a sweep that hit particles which fall at ``speed_m_s``."""

    def __init__(self, lidar: Lidar, time_s: float, speed_m_s: float) -> None:
        self.model = lidar.model_at(time_s)
        self.times_s = column_times(lidar, time_s)
        poses = lidar.world_from_lidar.at(self.times_s)
        middle = len(poses) // 2
        self.middle_s, self.rotations, self.places = float(self.times_s[middle]), poses[:, :3, :3], poses[:, :3, 3]
        # particles stand still in a frame that falls with them, in which the sensor rises
        self.places = self.places + np.outer(self.times_s - self.middle_s, [0.0, 0.0, speed_m_s])
        self.up, self.origin = self.rotations[middle][:, 2], self.places[middle]
        self.moved_m = float(np.linalg.norm(self.places - self.origin, axis=1).max())
        self.step_m = float(np.linalg.norm(np.diff(self.places, axis=0), axis=1).max(initial=0.0))
        self.azimuths = column_azimuths(self.model)
        self.turned = self.model.direction * (self.azimuths - self.azimuths[0])
        self.order = np.argsort(self.model.elevation_rad, kind="stable")
        self.rising = self.model.elevation_rad[self.order]

    def box(self, far_m: float) -> tuple[FloatArray, FloatArray]:
        """Return the lowest and highest coordinates (3,) of what is near."""
        reach = far_m + self.moved_m + 0.1
        return self.origin - reach, self.origin + reach

    def near(self, far_m: float, divergence: float) -> Callable[[FloatArray, float], BoolArray]:
        """Return whether spheres (N, 3) of a radius may be hit: see `ParticleClass.inside`."""
        low, high = math.sin(self.rising[0]), math.sin(self.rising[-1])

        def near(points: FloatArray, radius: float) -> BoolArray:
            to = points - self.origin
            distance = np.sqrt(np.einsum("ij,ij->i", to, to))
            height, slack = to @ self.up, radius + self.moved_m + distance * divergence
            inside = (height > distance * low - slack) & (height < distance * high + slack)
            return np.asarray(inside & (distance < far_m + slack))

        return near

    def _turned(self, angle: FloatArray) -> FloatArray:
        """Return how far (N,) the columns have turned that look along azimuths; just before the first one is below 0."""
        return (self.model.direction * (angle - self.azimuths[0]) + SEAM_RAD) % (2 * np.pi) - SEAM_RAD

    def hits(self, particles: Particles, divergence: float) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
        """Return beams (M,) by flat numbers, which particles they hit, and the distances, metres: those whose middle is in
        a beam, or that have a beam's axis in them."""
        local = particles.positions - self.origin
        local = local @ self.rotations[len(self.rotations) // 2]
        for _ in range(2):
            # which column sees a particle depends on where it is then
            turned = self._turned(np.arctan2(local[:, 1], local[:, 0]))
            column = np.clip(np.searchsorted(self.turned, turned), 0, len(self.times_s) - 1)
            local = np.einsum("nji,nj->ni", self.rotations[column], particles.positions - self.places[column])
        distance = np.maximum(np.linalg.norm(local, axis=1), 1e-3)
        half = np.maximum(divergence, particles.diameters_m / distance) / 2 + self.step_m / distance
        elevation = np.arcsin(np.clip(local[:, 2] / distance, -1, 1))
        azimuth = np.arctan2(local[:, 1], local[:, 0])
        first = np.searchsorted(self.rising, elevation - half)
        which, beam = _spans(first, np.searchsorted(self.rising, elevation + half, "right"))
        beam = self.order[beam]
        turned = self._turned(azimuth[which] - self.model.azimuth_offset_rad[beam])
        wide = half[which] / np.maximum(np.cos(elevation[which]), 0.05)
        first = np.searchsorted(self.turned, turned - wide)
        pair, column = _spans(first, np.searchsorted(self.turned, turned + wide, "right"))
        which, beam = which[pair], beam[pair]
        up, along = self.model.elevation_rad[beam], self.azimuths[column] + self.model.azimuth_offset_rad[beam]
        axes = np.stack([np.cos(up) * np.cos(along), np.cos(up) * np.sin(along), np.sin(up)], -1)
        local = np.einsum("nji,nj->ni", self.rotations[column], particles.positions[which] - self.places[column])
        distance = np.maximum(np.linalg.norm(local, axis=1), 1e-3)
        half = np.maximum(divergence, particles.diameters_m[which] / distance) / 2
        hit = np.linalg.norm(axes - local / distance[:, None], axis=1) <= 2 * np.sin(half / 2)
        return beam[hit] * len(self.times_s) + column[hit], which[hit], distance[hit]


def particle_power(
    diameter_m: FloatArray | float, range_m: FloatArray, reflectivity: float, receiver: Receiver
) -> FloatArray:
    """Return the power (...) of particles of diameters (...) at ranges (...), without extinction."""
    share = np.minimum(1.0, (diameter_m / (receiver.divergence_mrad * 1e-3 * range_m)) ** 2)
    return np.asarray(reflectivity * share * overlap(range_m, receiver) / range_m**2)


def _spans(first: NDArray[np.int64], last: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the indices of spans (N,) and the numbers in them, from ``first`` up to but without ``last``: (M,), (M,)."""
    counts = np.maximum(last - first, 0)
    which = np.repeat(np.arange(len(first)), counts)
    return which, np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts) + first[which]
