"""Cases of places: drives and logs a million metres off, and volumes centred elsewhere."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from analytic_scene import still
from random_scene import CARS, PASSES, edited

from unisim_blender.core.geometry import (
    FloatArray,
    make_pose,
    quaternion_from_yaw,
    transform_points,
)
from unisim_blender.core.model.tracklets import Tracklets
from unisim_blender.core.model.volume import Volume
from unisim_blender.core.sensors.frames import RenderStats
from unisim_blender.core.training.batches.data import LidarData

from .measures import Bench, Case, Measure, most
from .scenes import CORNER, SIZE_M, fan, image_rays, make_scene, moved_drive, moved_rays
from .truths import arrays_of, tracers, truth

FAR_OFF = {
    "a million metres off": (np.array([1e6, -1e6, 1e3]), 0.7),
    "recentred elsewhere": (np.array([1234.5, -678.9, 12.3]), 0.0),
}


def moved(where: str) -> Case:
    """The drive, the volume, the actors and the rays moved: the image stays."""

    def case(bench: Bench) -> Iterator[Measure]:
        offset, yaw = FAR_OFF[where]
        motion = make_pose(offset, quaternion_from_yaw(yaw))
        drive = edited(CARS)
        here, there = make_scene(bench.folder / "here", drive), make_scene(bench.folder / "there", drive, motion=motion)
        rays = image_rays(drive, bench.full)
        exact, _ = truth(here, drive, rays)
        away = tracers(there, moved_drive(drive, motion))
        for name, tracer in tracers(here, drive).items():
            found = arrays_of(tracer.trace(rays, PASSES, True, None, RenderStats()))
            other = arrays_of(away[name].trace(moved_rays(rays, motion), PASSES, True, None, RenderStats()))
            yield Measure(f"{name}: depth beside the origin's, m", most(found["depth_m"], other["depth_m"], 0.98), 3e-3)
            yield Measure(f"{name}: opacity beside the origin's", most(found["opacity"], other["opacity"], 0.98), 1e-4)
            yield Measure(f"{name}: features beside the origin's", most(found["feature"], other["feature"], 0.98), 1e-3)
            yield Measure(f"{name}: depth beside float64, m", most(other["depth_m"], exact.depth_m, 0.98), 3e-3)
            yield Measure(
                f"{name}: other instances, share", float((found["instance"] != other["instance"]).mean()), 0.01
            )
        points = np.random.default_rng(0).uniform([-20, -10, 0], [20, 10, 5], (100, 3))
        here_m = tracers(here, drive)["torch"].heights(points)
        there_m = away["torch"].heights(transform_points(motion, points))
        yield Measure("torch: heights above the ground, m", most(here_m, there_m), 2e-5)

    return case


class FarSweeps:
    """A log of one sweep with everything a million metres off."""

    path = Path("far")

    def __init__(self, origins: FloatArray, directions: FloatArray, depth_m: FloatArray) -> None:
        n = len(origins)
        lidar = SimpleNamespace(time_s={0: 0.0}, model=SimpleNamespace(beams=n))
        self.drive = SimpleNamespace(actors={}, lidars={"top": lidar}, frames=(0,), time_s={0: 0.0})
        self._grid = SimpleNamespace(
            origins=origins, directions=directions, time_s=np.zeros(n), depth_m=depth_m.astype(np.float32),
            intensity=np.ones(n, np.float32), returned=np.ones(n, bool), blocked=np.zeros(n, bool),
        )  # fmt: skip

    def sweep_frames(self, name: str) -> list[int]:
        return [0]

    def sweep_grid(self, name: str, frame: int) -> Any:
        return self._grid


def training_data(bench: Bench) -> Iterator[Measure]:
    """What training draws from a log a million metres off."""
    motion = make_pose(FAR_OFF["a million metres off"][0], quaternion_from_yaw(0.7))
    rays = moved_rays(fan(400 * bench.full, (-20.0, 0, 1.6)), motion)
    depth = np.random.default_rng(1).uniform(1, 60, len(rays.time_s))
    volume = Volume(motion @ make_pose(CORNER, quaternion_from_yaw(0.1)), SIZE_M)
    log: Any = FarSweeps(rays.origins, rays.directions, depth)
    data = LidarData(log, ["top"], [0], volume.corner)
    exact = rays.origins + rays.directions * depth[:, None]
    yield Measure("LiDAR points, m", most(data.points, exact), 2e-5)
    batch = data.sample(np.random.default_rng(2), 200)
    end = batch.rays.origins.double() + batch.rays.directions.double() * batch.depth_m[:, None].double()
    nearest = np.linalg.norm(exact[None] - (end.numpy() + volume.corner)[:, None], axis=-1).min(1)
    yield Measure("ends of LiDAR rays in a batch, m", float(nearest.max()), 2e-5)
    keyed = still("car", motion[:3, 3], (4.0, 2.0, 1.5))
    tracklets = Tracklets([keyed], refine=True, corner=volume.corner)
    positions = tracklets.keys()[0].detach().double().numpy()[0] + tracklets.corner
    yield Measure("positions of tracklets, m", most(positions, motion[None, :3, 3]), 2e-5)
