"""Weather in sweeps: targets attenuated and lost, and returns of what is in the air in front of them.

Powers are those of a diffuse target of reflectivity 1 at 1 m. A target has the power rho exp(-2 a R) xi(R) / R². What is
in the air returns the pulse's shape over its own backscatter (Rasshofer et al. 2011; Hahner et al., ICCV 2021):

    P(R) = pi b (c/2) integral of sin²(pi t / 2T) exp(-2 a r) xi(r) / r² dt from 0 to 2T, r = R - c t / 2 below the target

with extinction a, backscatter b, half-power width T, and xi(r) = min(1, (r / overlap)²), the part of the light that the
receiver sees. In each range cell of a pulse's length it fluctuates with an exponential distribution of this mean, as
speckle does; the strongest of all is the beam's return.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..geometry import BoolArray, FloatArray
from ..sensors.frames import LidarFrame
from ..world.captures import Capture, microseconds
from ..world.drive import Lidar
from ..world.weather import Receiver, Weather
from .atmosphere import backscatter, extinctions

LIGHT_M_NS = 0.299792458
PULSE_STEPS = 32
"""Number of steps of the integral over a pulse."""
MAX_FLUCTUATION = 12.0
"""Largest factor of an exponential distribution that is looked for: one draw in 160 000 is larger."""
MAX_SOFT_M = 100.0
"""Largest range from which air is measured, metres."""


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
    intensity: NDArray[np.float32], depth_m: FloatArray, extinction: float, receiver: Receiver, max_range_m: float
) -> BoolArray:
    """Return whether targets (...) that return in clear air are below the threshold: their reserve there is 1 plus their
    power over the threshold's, so that none is lost without weather."""
    reserve = 1 + intensity / receiver.threshold * (max_range_m / np.maximum(depth_m, 1e-3)) ** 2
    return np.asarray(reserve * np.exp(-2 * extinction * depth_m) < 1)


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


def weathered(frame: LidarFrame, lidar: Lidar, weather: Weather, time_s: float) -> LidarFrame:
    """Return the sweep at ``time_s`` in weather, given the clear one. Beams that return what is in the air belong to no
    actor, and have the intensity of a diffuse target with their power. Random draws depend on the weather's seed, the
    LiDAR and the time alone."""
    receiver, model = weather.receiver, frame.model
    extinction, least = sum(extinctions(weather).values()), detectable(receiver, model.max_range_m)
    target_m = np.maximum(frame.depth_m.astype(np.float64), 1e-3)
    passed = np.exp(-2 * extinction * target_m)
    lost = frame.returned & is_lost(frame.intensity, target_m, extinction, receiver, model.max_range_m)
    seen = frame.returned & ~lost
    power = np.where(seen, frame.intensity * passed * overlap(target_m, receiver) / target_m**2, 0.0)
    strongest = np.maximum(power, least)
    limit_m = np.where(frame.depth_m > 0, target_m, model.max_range_m)
    if lidar.blocked is not None:
        limit_m[lidar.blocked] = 0.0
    rng = np.random.default_rng(Capture(lidar.sensor_id, microseconds(time_s)).seed(weather.seed))
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
    range_m = start_m + rng.random(len(start_m)) * np.minimum(length, limit_m[in_air] - start_m)
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
