"""Cases of the density: how sharp it is, its intervals, and surfaces that are grazed."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator

import numpy as np
import torch
from analytic_scene import drive_of
from random_scene import PASSES

from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.ops.density import logistic_intervals
from unisim_blender.core.render.tracers.compiled.structs import address
from unisim_blender.core.sensors.frames import RenderStats
from unisim_blender.core.sensors.rays import Rays

from .measures import Bench, Case, Measure, most
from .probe import probed
from .scenes import make_scene, plane
from .truths import changed, not_finite, tracers


def sharpness(beta: float) -> Case:
    """Random fields at one sharpness, 1 / metres."""

    def change(model: SceneModel) -> None:
        model.log_beta.fill_(np.log(beta))

    return changed(change, 3e-3)


def intervals(bench: Bench) -> Iterator[Measure]:
    """Optical depths and shares of intervals between random distances, by torch and by the kernels' headers."""
    rng = np.random.default_rng(0)
    n, k = 200 * bench.full, 24
    t = np.sort(rng.uniform(0.5, 80, (n, k)), 1).astype(np.float32)
    for beta in (1.0, 30.0, 1e3, 1e4):
        s = (rng.normal(0, 1, (n, k)).cumsum(1) * rng.choice([1e-3, 0.1, 3], (n, 1))).astype(np.float32)
        exact = [x.numpy() for x in logistic_intervals(torch.as_tensor(s).double(), beta)]
        rough = [x.numpy() for x in logistic_intervals(torch.as_tensor(s), beta)]
        # what a depth can be known to follows from the distances' own rounding
        least = np.maximum(1, np.abs(exact[0]) + beta * np.abs(s))
        # of a ray that came from outside so much reaches an interval
        reaching = np.exp(-np.logaddexp(0, -beta * np.concatenate([s[:, :1], s[:, :-1]], 1).astype(np.float64)))
        found = {"torch": rough}
        probe = probed()
        if probe is not None:
            found["kernels"] = [np.empty_like(s) for _ in range(2)]
            probe.probe_depths(n, k, address(t), address(s), ctypes.c_float(beta), 0, *map(address, found["kernels"]))
        for name, (tau, share) in found.items():
            yield Measure(
                f"{name}: optical depth at beta {beta:g}, of its size", most(tau / least, exact[0] / least), 1e-6
            )
            yield Measure(f"{name}: weight at beta {beta:g}", most(share * reaching, exact[1] * reaching), 1e-4)
            outside = (share < 0) | (share > -np.expm1(-tau) + 1e-6)
            yield Measure(f"{name}: shares outside 0 to alpha at beta {beta:g}", float(outside.sum()), 0)


def grazed(bench: Bench) -> Iterator[Measure]:
    """A plane grazed at 0.1 degrees: its distance is known in closed form."""
    drive = drive_of([])
    folder = make_scene(bench.folder / "scene", drive, plane(4.0, 3000.0), yaw=0.3)
    slope, n = np.radians(0.1), 64 * bench.full
    heights = np.linspace(0.01, 0.05, n)
    yaw = np.linspace(0, 2 * np.pi, n)
    d = np.stack([np.cos(slope) * np.cos(yaw), np.cos(slope) * np.sin(yaw), np.full(n, -np.sin(slope))], -1)
    origins = np.zeros((n, 3))
    origins[:, 2] = heights
    rays = Rays(origins, d, np.full(n, 0.2))
    # what leaves the volume before it meets the plane, or meets it before anything is looked at, shows nothing
    met = heights / np.sin(slope)
    inside = (met < 17) & (met > 1)
    for name, tracer in tracers(folder, drive, "reference").items():
        found = tracer.trace(rays, PASSES, True, None, RenderStats())
        yield Measure(f"{name}: numbers that are not finite", not_finite(found), 0)
        yield Measure(
            f"{name}: median depth, of the distance",
            most(np.asarray(found.maps["depth"])[inside] / met[inside], 1.0),
            5e-4,
        )
