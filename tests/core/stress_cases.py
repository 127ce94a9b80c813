"""What numerical stability is held to: cases at the ends of what numbers can be, each with its error against float64 and a bound.

`test_stress.py` runs them small, `benchmarks/stability.py` at full size. The truth is torch's own modules in float64, or plain
numpy; never the code under test.
"""

from __future__ import annotations

import ctypes
import dataclasses
import functools
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from analytic_scene import drive_of, still
from numpy.typing import NDArray
from random_scene import CARS, rough
from torch import Tensor

from unisim_blender.core import native
from unisim_blender.core.cast import gather_cast
from unisim_blender.core.cast_tensors import CastTensors, cast_tensors
from unisim_blender.core.compiled.scene import CompiledScene
from unisim_blender.core.compiled.structs import address
from unisim_blender.core.compiled.tracer import CompiledTracer
from unisim_blender.core.composite import composite
from unisim_blender.core.density import logistic_intervals, weights_from_tau
from unisim_blender.core.drive import Actor, Box, Drive, StaticCopy
from unisim_blender.core.fields.checkpoint import load_scene, save_scene
from unisim_blender.core.fields.config import ModelConfig, preset
from unisim_blender.core.fields.scene import SceneModel
from unisim_blender.core.fields.tracklets import Tracklets, quaternion_from_rotation, rotation_from_6d
from unisim_blender.core.fields.volume import Volume
from unisim_blender.core.frames import RenderStats
from unisim_blender.core.geometry import (
    FloatArray,
    invert_pose,
    make_pose,
    quaternion_from_yaw,
    rotate_vectors,
    transform_points,
)
from unisim_blender.core.median import median_depth
from unisim_blender.core.quality import QUALITY, quality_named
from unisim_blender.core.scene_file import SceneHeader
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.strands import RayBatch, Strands, Traced
from unisim_blender.core.torch_tracer import TorchTracer
from unisim_blender.core.trace import Sampling, trace
from unisim_blender.core.tracer import Found
from unisim_blender.core.training.data import LidarData

TINY = preset("tiny")
PASSES = {"depth", "instance", "normal", "opacity", "support"}
SIZE_M = np.array([60.0, 40.0, 16.0])
CORNER = np.array([-30.0, -20.0, -4.0])
LEAST_NORMAL, HUGE = 1.1754944e-38, float(np.finfo(np.float32).max)
Array = NDArray[np.float32]
Change = Callable[[SceneModel], None]


@dataclass(frozen=True)
class Measure:
    """An error, and the bound that it must keep; the ``most`` or a quantile of it, as ``what`` says."""

    what: str
    error: float
    bound: float

    @property
    def kept(self) -> bool:
        """Whether the bound holds; NaN never does."""
        return bool(self.error <= self.bound)


@dataclass(frozen=True)
class Bench:
    """Where cases leave their scenes, and how large they are: ``full`` 1 for a test, more for a benchmark."""

    folder: Path
    full: int = 1


Case = Callable[[Bench], Iterator[Measure]]


# ---- scenes


def edited(cars: list[Actor] = CARS) -> Drive:
    """Actors, a box emptied, a place copied."""
    source = Box(make_pose(np.array([-5.0, 4, 1]), quaternion_from_yaw(0.2)), np.full(3, 3.0))
    copies = (StaticCopy("copy", source, make_pose(np.array([-13.0, 3, 1.2]), quaternion_from_yaw(1.1))),)
    return drive_of(cars, copies, (Box(make_pose(np.array([-11.0, 1, 1]), quaternion_from_yaw(0.5)), np.array([3.0, 2, 2])),))


def plane(height_m: float, beta: float) -> Change:
    """A level plane, known exactly: the distance is the height above it, for the coarsest level's vertices hold their z."""

    def change(model: SceneModel) -> None:
        scene: Any = model
        table, grid = scene.static.grid.table, scene.static.grid.grid
        assert grid.stride_y[0] > 0, "the coarsest level has a row for every vertex"
        table.zero_()
        z = torch.arange(int(grid.size[0])) // int(grid.stride_z[0])
        table[: int(grid.size[0]), 0] = z / 8
        first, last = scene.static.network[0], scene.static.network[-1]
        for parameter in (first.weight, last.weight, last.bias):
            parameter.zero_()
        first.weight[0, 0] = 1
        last.weight[0, 0] = 8 * float(SIZE_M[2] / grid.scale[0, 2])
        last.bias[0] = -height_m
        scene.log_beta.fill_(np.log(beta))
        scene.occupancy.values.fill_(255)
        scene.far.network[-1].bias[0] = -30.0
        scene.ground.heights.fill_(height_m)

    return change


def moved_drive(drive: Drive, motion: FloatArray) -> Drive:
    """A drive, and all that is in it, moved by a rigid motion (4, 4)."""

    def box(pose: FloatArray) -> FloatArray:
        return motion @ pose

    actors = {u: dataclasses.replace(a, world_from_actor=a.world_from_actor.transformed(motion)) for u, a in drive.actors.items()}
    return dataclasses.replace(
        drive,
        actors=actors,
        cameras={
            n: dataclasses.replace(c, world_from_camera=c.world_from_camera.transformed(motion)) for n, c in drive.cameras.items()
        },
        static_copies=tuple(
            StaticCopy(c.uid, Box(box(c.source.world_from_box), c.source.size_m), box(c.world_from_target))
            for c in drive.static_copies
        ),
        static_removals=tuple(Box(box(r.world_from_box), r.size_m) for r in drive.static_removals),
    )


def make_scene(
    folder: Path,
    drive: Drive,
    change: Change | None = None,
    config: ModelConfig = TINY,
    yaw: float = 0.1,
    motion: FloatArray | None = None,
    seed: int = 0,
) -> Path:
    """A scene of random weights, then changed; ``motion`` (4, 4) moves its volume, and the drive in its header."""
    torch.manual_seed(seed)
    motion = np.eye(4) if motion is None else motion
    volume = Volume(motion @ make_pose(CORNER, quaternion_from_yaw(yaw)), SIZE_M)
    model = SceneModel(config, volume, tuple(sorted(drive.actors)), ("front",))
    with torch.no_grad():
        rough(model)
        if change is not None:
            change(model)
    training = {"frames": [0, 2], "cameras": ["front"], "lidars": ["top"], "width": None}
    recorded = moved_drive(drive, motion)
    header = SceneHeader(folder, "stress", "none", "../none", np.zeros(3), config.to_dict(), volume.to_dict(), recorded, training)
    save_scene(folder, header, model)
    return folder


def picture_rays(drive: Drive, full: int = 1) -> Rays:
    """The front camera's, a ray for every two pixels of 48 x 32, or more."""
    recorded = drive.cameras["front"]
    camera = dataclasses.replace(recorded, model=recorded.model.resized(recorded.model.width * full))
    return camera_rays(camera, 2, *pixel_grid(camera.model, 2)).flat()


def moved_rays(rays: Rays, motion: FloatArray) -> Rays:
    """Rays moved by a rigid motion (4, 4)."""
    return Rays(transform_points(motion, rays.origins), rotate_vectors(motion, rays.directions), rays.time_s)


def fan(n: int, origin: Any, spread: float = 0.3, seed: int = 0) -> Rays:
    """Rays about +x from one place, at times from 0 to 0.5 s."""
    rng = np.random.default_rng(seed)
    d = rng.normal([1, 0, 0], [0, spread, spread / 2], (n, 3))
    return Rays(np.tile(np.asarray(origin, float), (n, 1)), d / np.linalg.norm(d, axis=1, keepdims=True), rng.uniform(0, 0.5, n))


# ---- the truth


def exactly(tracklets: Tracklets, actors: tuple[Actor, ...]) -> None:
    """Tracklets in float64, of what was never rounded."""
    tracklets.double()
    for i, actor in enumerate(actors):
        way = actor.world_from_actor
        k = len(way.times_s)
        tracklets.positions[i, :k] = torch.as_tensor(way.positions - tracklets.corner)
        tracklets.quaternions[i, :k] = torch.as_tensor(way.quaternions_wxyz)
        tracklets.sizes_m[i] = torch.as_tensor(actor.size_m).float()


def truth(folder: Path, drive: Drive, rays: Rays, quality: str = "balanced", sky: bool = True) -> tuple[Traced, FloatArray]:
    """What flat rays meet, and their median depths (N,), by torch in float64 throughout."""
    scene = load_scene(folder)
    model, tables = scene.model.double(), scene.actor_tables.double()
    model.frame.rotation.copy_(torch.as_tensor(model.volume.world_from_volume[:3, :3].T))
    cast = gather_cast(drive, scene.header.drive, {"": tuple(model.actor_ids)})
    tensors: CastTensors = cast_tensors(cast, {"": (model, tables)})
    exactly(tensors.own.tracklets, cast.own.actors)
    corner = model.volume.corner

    def recentred(pose: FloatArray) -> FloatArray:
        return np.vstack([np.c_[pose[:3, :3], pose[:3, 3] - corner], pose[3:]])

    if tensors.copies is not None:
        exactly(tensors.copies, cast.targets)
        tensors.copy_source = torch.as_tensor(np.stack([recentred(box.world_from_box) for box in cast.sources]))
    if tensors.removals is not None:
        poses = np.stack([invert_pose(recentred(box.world_from_box)) for box in cast.removals])
        tensors.removals = torch.as_tensor(poses), tensors.removals[1].double()
    batch = RayBatch(model.frame.recentred(rays.origins), torch.as_tensor(rays.directions), torch.as_tensor(rays.time_s))
    assert batch.origins.dtype == torch.float64
    with torch.no_grad():
        traced = trace(model, tensors, batch, Sampling(fine=quality_named(quality).samples, sky=sky))
        return traced, median_depth(model, traced).numpy()


Tracers = dict[str, CompiledTracer | TorchTracer]


def tracers(folder: Path, drive: Drive, quality: str = "balanced") -> Tracers:
    """The compiled tracer, where it was built, and torch's."""
    out: Tracers = {"torch": TorchTracer(load_scene(folder), drive, quality)}
    if native.library() is not None:
        compiled = CompiledTracer(CompiledScene(folder), drive)
        # torch's very samples: a march has others
        compiled.quality = dataclasses.replace(QUALITY["reference"], samples=quality_named(quality).samples)
        out["compiled"] = compiled
    return out


def arrays_of(found: Found) -> dict[str, NDArray[Any]]:
    """All that was found, in numpy."""
    named = {"feature": found.feature, "depth_m": found.depth_m, "opacity": found.opacity, **found.maps}
    return {name: np.asarray(values) for name, values in named.items()}


def not_finite(found: Found) -> float:
    """How many numbers are not finite; the depth pass is infinite where nothing solid is."""
    arrays = arrays_of(found)
    if "depth" in arrays:
        arrays["depth"] = arrays["depth"][arrays["opacity"] > 0.5]
    return float(sum((~np.isfinite(values)).sum() for values in arrays.values()))


def most(a: Any, b: Any, quantile: float = 1.0) -> float:
    """The largest difference of a row, or a quantile of them; NaN counts as infinite."""
    difference = np.abs(np.asarray(a, np.float64) - np.asarray(b, np.float64))
    if difference.size == 0:
        return 0.0
    rows = np.nan_to_num(difference, nan=np.inf).reshape(len(difference), -1).max(1)
    return float(np.quantile(rows, quantile, method="higher"))


def beside_truth(
    folder: Path, drive: Drive, rays: Rays, depth: float, opacity: float, feature: float, quality: str = "balanced"
) -> Iterator[Measure]:
    """Both tracers against float64. Errors are those of 98 in 100 rays: where a place of a sample is rounded into the next voxel,
    as many other samples are as good."""
    exact, median = truth(folder, drive, rays, quality)
    scale = float(exact.feature.square().mean().sqrt()) + 1e-30
    for name, tracer in tracers(folder, drive, quality).items():
        found = tracer.trace(rays, PASSES, True, None, RenderStats())
        got = arrays_of(found)
        solid = (got["opacity"] > 0.5) & (exact.opacity.numpy() > 0.5)
        yield Measure(f"{name}: numbers that are not finite", not_finite(found), 0)
        yield Measure(f"{name}: depth, m", most(got["depth_m"], exact.depth_m, 0.98), depth)
        yield Measure(f"{name}: median depth, m", most(got["depth"][solid], median[solid], 0.98), depth)
        yield Measure(f"{name}: opacity", most(got["opacity"], exact.opacity, 0.98), opacity)
        yield Measure(f"{name}: features, of their mean size", most(got["feature"], exact.feature, 0.98) / scale, feature)


# ---- cases: places


FAR_OFF = {
    "a million metres off": (np.array([1e6, -1e6, 1e3]), 0.7),
    "recentred elsewhere": (np.array([1234.5, -678.9, 12.3]), 0.0),
}


def moved(where: str) -> Case:
    """The drive, the volume, the actors and the rays moved: the picture stays."""

    def case(bench: Bench) -> Iterator[Measure]:
        offset, yaw = FAR_OFF[where]
        motion = make_pose(offset, quaternion_from_yaw(yaw))
        drive = edited()
        here, there = make_scene(bench.folder / "here", drive), make_scene(bench.folder / "there", drive, motion=motion)
        rays = picture_rays(drive, bench.full)
        exact, _ = truth(here, drive, rays)
        away = tracers(there, moved_drive(drive, motion))
        for name, tracer in tracers(here, drive).items():
            found = arrays_of(tracer.trace(rays, PASSES, True, None, RenderStats()))
            other = arrays_of(away[name].trace(moved_rays(rays, motion), PASSES, True, None, RenderStats()))
            yield Measure(f"{name}: depth beside the origin's, m", most(found["depth_m"], other["depth_m"], 0.98), 3e-3)
            yield Measure(f"{name}: opacity beside the origin's", most(found["opacity"], other["opacity"], 0.98), 1e-4)
            yield Measure(f"{name}: features beside the origin's", most(found["feature"], other["feature"], 0.98), 1e-3)
            yield Measure(f"{name}: depth beside float64, m", most(other["depth_m"], exact.depth_m, 0.98), 3e-3)
            yield Measure(f"{name}: other instances, share", float((found["instance"] != other["instance"]).mean()), 0.01)
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
        self.drive = SimpleNamespace(actors={})
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


# ---- cases: the density


def sharpness(beta: float) -> Case:
    """Random fields at one sharpness, 1 / metres."""

    def change(model: SceneModel) -> None:
        model.log_beta.fill_(np.log(beta))

    def case(bench: Bench) -> Iterator[Measure]:
        drive = edited()
        folder = make_scene(bench.folder / "scene", drive, change)
        yield from beside_truth(folder, drive, picture_rays(drive, bench.full), 3e-3, 1e-4, 2e-3)

    return case


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
            yield Measure(f"{name}: optical depth at beta {beta:g}, of its size", most(tau / least, exact[0] / least), 1e-6)
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
            f"{name}: median depth, of the distance", most(np.asarray(found.maps["depth"])[inside] / met[inside], 1.0), 5e-4
        )


def inside(bench: Bench) -> Iterator[Measure]:
    """Rays that start under the ground, and in the bodies of actors."""
    drive = edited([still("car", (-8, 1, 0.8), (4.0, 1.8, 1.6)), still("block", (-20, 0, 1.6), (3.0, 3.0, 3.0))])
    n = 100 * bench.full

    def solid(model: SceneModel) -> None:
        plane(4.0, 200.0)(model)
        scene: Any = model
        scene.actors.network[-1].bias[0] = -2.0

    folder = make_scene(bench.folder / "scene", drive, solid)
    under, within = fan(n, (-5.0, 0, -1.0)), fan(n, (-20.0, 0, 1.6))
    for where, rays in (("under the ground", under), ("in an actor", within)):
        for measure in beside_truth(folder, drive, rays, 1e-4, 1e-6, 1e-3):
            yield dataclasses.replace(measure, what=f"{where}, {measure.what}")


def axes(bench: Bench) -> Iterator[Measure]:
    """Rays exactly along axes of the volume and of boxes, zeros of both signs among their directions."""
    drive = edited([still("car", (-8, 1, 0.8), (4.0, 1.8, 1.6)), still("cone", (-12, -2, 0.4), (0.6, 0.6, 0.8))])
    folder = make_scene(bench.folder / "scene", drive, yaw=0.0)
    rng = np.random.default_rng(0)
    n = 120 * bench.full
    origins = rng.uniform([-15, -8, 0], [10, 8, 3], (n, 3))
    directions = np.where(rng.random((n, 3)) < 0.5, -0.0, 0.0)
    directions[np.arange(n), np.arange(n) % 3] = rng.choice([-1.0, 1.0], n)
    yield from beside_truth(folder, drive, Rays(origins, directions, np.full(n, 0.2)), 2e-3, 1e-4, 1e-3)


def faces(bench: Bench) -> Iterator[Measure]:
    """Rays in the very planes of a box's faces, along them, and along its edges: in or out, but something."""
    car = still("car", (-8, 1, 1), (4.0, 2.0, 2.0))
    drive = edited([car])
    folder = make_scene(bench.folder / "scene", drive, yaw=0.0)
    origins, directions = [], []
    for axis in range(3):
        for side in (-1.0, 1.0):
            for along in {0, 1, 2} - {axis}:
                start = np.array([-8.0, 1.0, 1.0])
                start[axis] += side * car.size_m[axis] / 2
                start[along] -= 5
                d = np.zeros(3)
                d[along] = 1
                origins += [start, start + 10 * d]
                directions += [d, -d]
    rays = Rays(np.array(origins), np.array(directions), np.full(len(origins), 0.2))
    exact, _ = truth(folder, drive, rays)
    for name, tracer in tracers(folder, drive).items():
        found = tracer.trace(rays, PASSES, True, None, RenderStats())
        yield Measure(f"{name}: numbers that are not finite", not_finite(found), 0)
        # a face belongs to the box or does not: for both there is a truth, a little inside and a little outside
        centre = np.array([-8.0, 1.0, 1.0])
        others = [
            truth(folder, drive, Rays(centre + (rays.origins - centre) * (1 + e), rays.directions, rays.time_s))[0]
            for e in (-1e-6, 1e-6)
        ]
        errors = [np.abs(np.asarray(found.opacity) - t.opacity.numpy()) for t in (exact, *others)]
        yield Measure(f"{name}: opacity beside one of the truths", most(np.minimum.reduce(errors), 0.0), 1e-4)


BROKEN = (np.nan, np.inf, -np.inf, 1e300)


def unsound(bench: Bench) -> Iterator[Measure]:
    """Rays with numbers that are none, and of no direction, among others: those keep their bits."""
    drive = edited()
    folder = make_scene(bench.folder / "scene", drive)
    rays = picture_rays(drive, bench.full)
    for name, tracer in tracers(folder, drive).items():
        whole = tracer.trace(rays, PASSES, True, None, RenderStats())
        expected = arrays_of(whole)
        shape = (16 * bench.full, 24 * bench.full)
        picture = tracer.image(whole, rays.directions, "front", shape).reshape(*shape, tracer.upsample, -1)
        places = [(array, value) for array in ("origins", "directions", "time_s") for value in BROKEN]
        broken = {7 + 13 * i: place for i, place in enumerate([*places, ("directions", 0.0), ("directions", 1e-200)])}
        other = Rays(rays.origins.copy(), rays.directions.copy(), rays.time_s.copy())
        for row, (array, value) in broken.items():
            getattr(other, array)[row] = value
        found = tracer.trace(other, PASSES, True, None, RenderStats())
        got, sound = arrays_of(found), np.ones(len(rays.time_s), bool)
        sound[list(broken)] = False
        yield Measure(f"{name}: numbers that are not finite", not_finite(found), 0)
        # torch multiplies other rows together, and rounds them as these are many
        allowed = 0.0 if name == "compiled" else 1e-4
        changed = max(most(got[key][sound], expected[key][sound]) for key in got if key != "depth")
        yield Measure(f"{name}: other rays, changed by", changed, allowed)
        yield Measure(f"{name}: rays that are none and meet an actor", float((got["instance"][~sound] != 0).sum()), 0)
        again = tracer.image(found, other.directions, "front", shape).reshape(picture.shape)
        yield Measure(f"{name}: pixels that are not finite", float((~np.isfinite(again)).sum()), 0)
        returns = tracer.returns(found, other.directions)
        yield Measure(f"{name}: returns that are not finite", float(sum((~np.isfinite(x)).sum() for x in returns)), 0)
        for row, (array, value) in broken.items():
            # one at a time: none may hide behind another
            alone = Rays(rays.origins.copy(), rays.directions.copy(), rays.time_s.copy())
            getattr(alone, array)[row] = value
            got = arrays_of(tracer.trace(alone, {"instance"}, True, None, RenderStats()))
            rest = np.arange(len(sound)) != row
            changed = max(most(got[key][rest], expected[key][rest]) for key in got)
            yield Measure(f"{name}: others changed where {array} are {value:g}, by", changed, allowed)


def boxes(bench: Bench) -> Iterator[Measure]:
    """Actors of a centimetre and of 50 m, in each other, and across the volume's edge."""
    cars = [
        still("dot", (-19.0, 0, 1.6), (0.01, 0.01, 0.01)),
        still("dots", (-19.0, 0.003, 1.6), (0.01, 0.01, 0.01), yaw=0.5),
        still("hall", (12.0, 0, 5), (50.0, 50.0, 20.0), yaw=0.2),
        still("car", (-8, 1, 0.8), (4.0, 1.8, 1.6), yaw=0.4),
        still("edge", (29.0, 3, 1), (6.0, 6.0, 3.0), yaw=0.3),
    ]
    drive = edited(cars)
    folder = make_scene(bench.folder / "scene", drive)
    n = 100 * bench.full
    to = np.random.default_rng(3).uniform(-0.005, 0.005, (n, 3)) + [1.0, 0, 0]
    aimed = Rays(np.tile([-20.0, 0, 1.6], (n, 1)), to / np.linalg.norm(to, axis=1, keepdims=True), np.full(n, 0.2))
    # a millionth of a metre is a ten thousandth of the smallest box
    for where, rays, feature in (("all", picture_rays(drive, bench.full), 2e-3), ("a centimetre", aimed, 0.2)):
        for measure in beside_truth(folder, drive, rays, 5e-3, 1e-4, feature):
            yield dataclasses.replace(measure, what=f"{where}, {measure.what}")


def rotations(bench: Bench) -> Iterator[Measure]:
    """6D rotations whose columns are nearly parallel, nearly nothing, or huge; values against float64, and gradients."""
    rng = np.random.default_rng(0)
    base = rng.normal(size=(200 * bench.full, 6)).astype(np.float32)
    for name, six, bound in (
        ("parallel", np.concatenate([base[:, :3], 2 * base[:, :3]], 1), np.inf),
        ("nearly parallel", np.concatenate([base[:, :3], base[:, :3] + 1e-2 * base[:, 3:]], 1), 1e-3),
        ("nothing", 0 * base, np.inf),
        ("one nothing", base * np.array([1, 1, 1, 0, 0, 0], np.float32), np.inf),
        ("tiny", base * np.float32(1e-6), 1e-5),
        ("least", base * np.float32(1e-30), np.inf),
        ("huge", base * np.float32(1e15), 1e-5),
    ):
        exact = rotation_from_6d(torch.as_tensor(six).double())
        learnt = torch.as_tensor(six).requires_grad_()
        rotation = rotation_from_6d(learnt)
        quaternion = quaternion_from_rotation(rotation)
        (quaternion * torch.as_tensor(rng.normal(size=(len(six), 4))).float()).sum().backward()
        assert learnt.grad is not None
        if np.isfinite(bound):
            yield Measure(f"{name}: rotation", most(rotation.detach(), exact), bound)
        yield Measure(f"{name}: quaternions' lengths", most(quaternion.detach().norm(dim=-1), 1.0), 1e-6)
        yield Measure(f"{name}: gradients that are not finite", float((~torch.isfinite(learnt.grad)).sum()), 0)


# ---- cases: what weights can be


def opaque_and_empty(bench: Bench) -> Iterator[Measure]:
    """Scenes that are solid throughout, and that hold nothing."""

    def opaque(model: SceneModel) -> None:
        scene: Any = model
        scene.occupancy.values.fill_(255)
        scene.static.network[-1].bias[0] = -50.0
        scene.actors.network[-1].bias[0] = -50.0

    def empty(model: SceneModel) -> None:
        scene: Any = model
        scene.occupancy.values.zero_()
        scene.actors.network[-1].bias[0] = 50.0
        scene.far.network[-1].bias[0] = -60.0
        scene.far.network[-1].weight[0].zero_()

    for name, change, wanted, drive in (("opaque", opaque, 1.0, edited()), ("empty", empty, 0.0, drive_of(CARS))):
        folder = make_scene(bench.folder / name, drive, change)
        rays = picture_rays(drive, bench.full)
        for measure in beside_truth(folder, drive, rays, 1e-5, 1e-6, 5e-4):
            yield dataclasses.replace(measure, what=f"{name}, {measure.what}")
        for which, tracer in tracers(folder, drive).items():
            found = tracer.trace(rays, set(), True, None, RenderStats())
            yield Measure(f"{name}, {which}: opacity", most(np.asarray(found.opacity), wanted), 1e-6)


def largest_halves(model: SceneModel) -> None:
    """Tables of the largest halves, of both signs."""
    scene: Any = model
    for field in (scene.static, scene.far):
        field.grid.table.copy_(torch.where(torch.rand_like(field.grid.table) < 0.5, -65504.0, 65504.0))
    last = scene.actors.hypernetwork[-1]
    last.weight.zero_()
    last.bias.copy_(torch.where(torch.rand_like(last.bias) < 0.5, -65504.0, 65504.0))


def largest_weights(model: SceneModel) -> None:
    """Networks with weights of a thousand."""
    scene: Any = model
    for field in (scene.static, scene.far, scene.actors):
        for layer in (field.network[0], field.network[-1]):
            layer.weight.copy_(1000 * torch.sign(torch.randn_like(layer.weight)))


def weights(change: Change) -> Case:
    """Weights at the ends of what a file can hold."""

    def case(bench: Bench) -> Iterator[Measure]:
        drive = edited()
        folder = make_scene(bench.folder / "scene", drive, change)
        yield from beside_truth(folder, drive, picture_rays(drive, bench.full), 1e-3, 1e-4, 2e-3)

    return case


def not_numbers(bench: Bench) -> Iterator[Measure]:
    """Tables and networks of NaN and infinity, which no file may hold, given to the kernels directly: nothing is read beyond."""
    if native.library() is None:
        return
    drive = edited()
    folder = make_scene(bench.folder / "scene", drive)
    rays = picture_rays(drive, bench.full)
    for bits in (0x7E00, 0x7C00, 0xFC00, 0xFFFF):
        tracer = CompiledTracer(CompiledScene(folder), drive)
        kept = []
        struct = tracer.scene.struct
        for field, grids in ((struct.fixed, 1), (struct.far, 1), (struct.actors, len(tracer.scene.looks))):
            assert field.half
            rows = int(field.grid.grid_stride) * grids
            table = np.full(rows * field.grid.features, bits, np.uint16)
            kept.append(table)
            field.table = address(table)
        found = tracer.trace(rays, PASSES, True, None, RenderStats())
        yield Measure(
            f"halves of {bits:#06x}: opacities not in 0 to 1", float((~((found.opacity >= 0) & (found.opacity <= 1))).sum()), 0
        )
        del kept


# ---- cases: numbers of rays, sizes of images


def counts(bench: Bench) -> Iterator[Measure]:
    """One ray and many: the same bits alone as in company."""
    drive = edited()
    folder = make_scene(bench.folder / "scene", drive)
    rays = fan(2000 if bench.full == 1 else 16384, (-20.0, 0, 1.6))
    for name, tracer in tracers(folder, drive).items():
        if name == "torch" and bench.full == 1:
            continue
        whole = tracer.trace(rays, PASSES, True, None, RenderStats())
        yield Measure(f"{name}: numbers that are not finite", not_finite(whole), 0)
        errors = []
        for row in np.linspace(0, len(rays.time_s) - 1, 12).astype(int):
            part = slice(row, row + 1)
            alone = arrays_of(
                tracer.trace(
                    Rays(rays.origins[part], rays.directions[part], rays.time_s[part]), PASSES, True, None, RenderStats()
                )
            )
            errors += [
                most(alone[key], value[part]) for key, value in arrays_of(whole).items() if key not in ("depth", "support")
            ]
        yield Measure(f"{name}: one ray alone beside itself among all", max(errors), 0.0 if name == "compiled" else 1e-4)


def odd_images(bench: Bench) -> Iterator[Measure]:
    """Pictures whose sizes nothing divides."""
    drive = edited()
    folder = make_scene(bench.folder / "scene", drive)
    camera = drive.cameras["front"]
    for width, height in ((1, 1), (1, 7), (13, 1), (47, 31)):
        model = dataclasses.replace(camera.model, width=width, height=height)
        u, v = pixel_grid(model, TINY.upsample)
        rays = camera_rays(dataclasses.replace(camera, model=model), 2, u, v)
        pictures = {}
        for name, tracer in tracers(folder, drive).items():
            found = tracer.trace(rays, set(), True, None, RenderStats())
            pictures[name] = tracer.image(found, rays.flat().directions, "front", u.shape)
            yield Measure(
                f"{width} x {height}, {name}: pixels that are not finite", float((~np.isfinite(pictures[name])).sum()), 0
            )
        if len(pictures) == 2:
            yield Measure(f"{width} x {height}: compiled beside torch", most(pictures["compiled"], pictures["torch"], 0.98), 1e-4)


# ---- cases: sums and functions


def strands_of(tau: Tensor, t: Tensor, ray: Tensor) -> Strands:
    zero = torch.zeros_like(tau)
    points = torch.zeros(*tau.shape, 3, dtype=tau.dtype)
    return Strands(ray, t, zero, zero[..., None] + 1, tau, tau * 0, points, torch.full_like(ray, -1))


def accumulated(bench: Bench) -> Iterator[Measure]:
    """A hundred thousand intervals on one ray, even and uneven, by torch in float32 and by the kernels' headers."""
    n = 100_000
    rng = np.random.default_rng(0)
    t = np.linspace(0.5, 100, n).astype(np.float32)
    for name, tau in (
        ("even", np.full(n, 2e-5, np.float32)),
        ("uneven", rng.exponential(2e-5, n).astype(np.float32)),
        ("tiny", np.full(n, 1e-8, np.float32)),
        ("dense at last", np.r_[np.full(n - 1, 1e-6), 1e3].astype(np.float32)),
    ):
        before = np.concatenate([[0], tau.astype(np.float64).cumsum()])
        front, behind = weights_from_tau(torch.as_tensor(tau)[None])
        yield Measure(f"torch: transmittance, {name}", most(front[0], np.exp(-before[:-1])), 1e-6)
        yield Measure(f"torch: transmittance behind all, {name}", abs(float(behind) - float(np.exp(-before[-1]))), 1e-6)
        # a ray of one strand, and of two whose intervals take turns
        depths, rays = torch.as_tensor(t), torch.zeros(1, dtype=torch.long)
        whole = composite(1, [strands_of(torch.as_tensor(tau)[None], depths[None], rays)], 1, [], depths)
        halves = [strands_of(torch.as_tensor(tau[i::2].copy())[None], depths[i::2][None], rays) for i in range(2)]
        split = composite(1, halves, 1, [], depths)
        weight = np.exp(-before[:-1]) * -np.expm1(-tau.astype(np.float64))
        for what, traced in (("one strand", whole), ("two strands", split)):
            yield Measure(f"torch: weights' sum, {name}, {what}", abs(float(traced.feature) - float(weight.sum())), 2e-5)
            yield Measure(f"torch: opacity, {name}, {what}", abs(float(traced.opacity) + float(np.expm1(-before[-1]))), 2e-5)
        probe = probed()
        if probe is None:
            continue
        share, out = (-np.expm1(-tau) / 2).astype(np.float32), np.empty(n, np.float32)
        probe.probe_weights(
            1, n, address(t), address(tau), address(share), address(out), address(weighed := np.empty(n, np.float32))
        )
        yield Measure(f"kernels: transmittance, {name}", most(out, np.exp(-before[:-1])), 1e-6)
        yield Measure(f"kernels: weights' sum, {name}", abs(float(weighed.sum(dtype=np.float64)) - float(weight.sum())), 1e-6)
        two = [np.ascontiguousarray(np.stack([x[0::2], x[1::2]])) for x in (t, tau, share)]
        merged = np.empty((2, n // 2), np.float32)
        depth = probe.probe_merge(2, n // 2, *map(address, two), address(merged))
        # an interval stands in its middle, the first ones at their samples; of two at one place the first strand's comes first
        near = np.concatenate([two[0][:, :1], two[0][:, :-1]], 1)
        order = np.argsort((near + np.float32(0.5) * (two[0] - near)).reshape(-1), kind="stable")
        exact = np.empty(n)
        exact[order] = np.exp(-np.concatenate([[0], two[1].astype(np.float64).reshape(-1)[order].cumsum()])[:-1])
        yield Measure(f"kernels: merged transmittance, {name}", most(merged.reshape(-1), exact), 1e-6)
        yield Measure(f"kernels: merged optical depth, {name}", abs(depth / before[-1] - 1), 1e-6)


@functools.cache
def probed(variant: str = "") -> ctypes.CDLL | None:
    """`native_probe.cpp` for an instruction set, the one in use if none is named; None without the kernels."""
    if native.library() is None:
        return None
    variant = variant or native.variant()
    avx2 = ["-march=x86-64-v2", "-mavx2", "-mfma", "-mf16c"]
    flags = {"avx2": avx2, "avx512": [*avx2, "-mavx512f", "-mavx512dq", "-mavx512bw", "-mavx512vl"]}.get(variant, [])
    source = Path(__file__).parent / "native_probe.cpp"
    out = Path(tempfile.mkdtemp(prefix="probe-")) / "probe.so"
    include = f"-I{source.parents[2] / 'native'}"
    subprocess.run(["c++", "-std=c++17", "-O3", "-shared", "-fPIC", *flags, include, source, "-o", out], check=True)
    library = ctypes.CDLL(str(out))
    p, i32, i64 = ctypes.c_void_p, ctypes.c_int, ctypes.c_int64
    for name in ("exp", "softplus", "stopped", "log1p"):
        getattr(library, f"probe_{name}").argtypes = [p, p, i64]
    library.probe_merge.argtypes, library.probe_merge.restype = [i32, i32, p, p, p, p], ctypes.c_float
    library.probe_weights.argtypes = [i32, i32, p, p, p, p, p]
    library.probe_depths.argtypes = [i32, i32, p, p, ctypes.c_float, i32, p, p]
    return library


def ask(library: ctypes.CDLL, name: str, x: Array) -> Array:
    """A function of lanes.h at x (n)."""
    padded = np.zeros(-(-len(x) // library.probe_lanes()) * library.probe_lanes(), np.float32)
    padded[: len(x)] = x
    out = np.empty_like(padded)
    getattr(library, f"probe_{name}")(address(padded), address(out), len(padded))
    return out[: len(x)]


def ulps(got: Array, exact: FloatArray) -> float:
    """The largest error in units in the last place of what is exact, or of the least normal number."""
    unit = np.spacing(np.clip(np.abs(exact), LEAST_NORMAL, HUGE / 2).astype(np.float32)).astype(np.float64)
    return most(got / unit, exact / unit) if len(got) else 0.0


def variants() -> list[str]:
    """The instruction sets that run here."""
    order = ["portable", "avx2", "avx512"]
    return order[: order.index(native.variant()) + 1] if native.library() is not None else []


def functions(bench: Bench) -> Iterator[Measure]:
    """Functions of vectors over every magnitude that float32 has, and every half."""
    step = 65537 if bench.full == 1 else 257
    every = np.arange(0, 2**32, step, dtype=np.uint64).astype(np.uint32).view(np.float32)
    every = every[np.isfinite(every)]
    special = np.array([np.inf, -np.inf, np.nan, 0.0, -0.0, 1e-45, -1e-45, 3e38, -3e38], np.float32)

    def over(low: float, high: float) -> Array:
        dense = np.linspace(low, min(high, 200.0), 100_001 * bench.full).astype(np.float32)
        x = np.concatenate([every, dense])
        return x[(x >= low) & (x <= high)]

    for variant in variants():
        library = probed(variant)
        assert library is not None
        for name, low, high, exact, bound in (
            ("exp", -87.3, 88.3, np.exp, 2),
            ("stopped", 0.0, HUGE, lambda x: -np.expm1(-x), 6),
            ("log1p", 0.0, 1.0, np.log1p, 4),
            ("softplus", -87.0, HUGE, lambda x: np.logaddexp(0, x), 4),
        ):
            x = over(low, high)
            yield Measure(
                f"{variant}: {name}, units in the last place", ulps(ask(library, name, x), exact(x.astype(np.float64))), bound
            )
        below = ask(library, "exp", over(-HUGE, -87.3))
        yield Measure(f"{variant}: exp below its range", float(np.abs(below).max()), 1.3e-38)
        above = ask(library, "exp", over(88.3, HUGE))
        yield Measure(
            f"{variant}: exp above its range, not in 2e38 to infinity", float((~((above >= 2e38) & (above < np.inf))).sum()), 0
        )
        below = ask(library, "softplus", over(-HUGE, -87.0))
        yield Measure(f"{variant}: softplus below its range", float(np.abs(below).max()), 2e-38)
        nan = np.isnan(special)
        # NaN stays NaN, so that a training that diverges is seen
        for name in ("softplus", "exp"):
            yield Measure(
                f"{variant}: {name} of NaN, that became a number", float(np.isfinite(ask(library, name, special)[nan]).sum()), 0
            )
        yield Measure(f"{variant}: softplus of -infinity", float(ask(library, "softplus", special)[1]), 2e-38)
        yield Measure(f"{variant}: 1 - exp of -infinity, beside 1", abs(float(ask(library, "stopped", special)[0]) - 1), 0)
        halves = np.arange(65536, dtype=np.uint16).view(np.float16)
        finite, exact_halves = np.isfinite(halves), halves.astype(np.float32).view(np.uint32)
        for name in ("halves", "halves_by_four"):
            out = np.empty(65536, np.float32)
            getattr(library, f"probe_{name}")(ctypes.c_void_p(address(out)))
            wrong = (out.view(np.uint32) != exact_halves)[finite].sum()
            yield Measure(f"{variant}: {name} of 63 488 finite ones with other bits", float(wrong), 0)


VARIANT_SCRIPT = """
import sys
sys.path.insert(0, sys.argv[1])
import stress_cases
stress_cases.write_found(*sys.argv[2:])
"""


def write_found(folder: str, out: str, variant: str, full: str) -> None:
    """What the compiled tracer finds of a scene, and its picture, into a file: in a process of the instruction set asked for."""
    assert native.variant() == variant, native.variant()
    drive = edited()
    tracer, rays = CompiledTracer(CompiledScene(folder), drive), picture_rays(drive, int(full))
    found = tracer.trace(rays, PASSES, True, None, RenderStats())
    rgb = tracer.image(found, rays.directions, "front", (16 * int(full), 24 * int(full)))
    np.savez(out, rgb=rgb.reshape(-1, 3), **{name: values.astype(np.float64) for name, values in arrays_of(found).items()})


def compared_variants(bench: Bench) -> Iterator[Measure]:
    """How far instruction sets differ, on a random scene: in colours of 0 to 1 and in depths."""
    folder = make_scene(bench.folder / "scene", edited())
    results = {}
    for variant in variants():
        out = bench.folder / f"{variant}.npz"
        script = [sys.executable, "-c", VARIANT_SCRIPT, Path(__file__).parent, folder, out, variant, bench.full]
        environment = {**os.environ, "UNISIM_NATIVE_VARIANT": variant}
        subprocess.run([str(part) for part in script], env=environment, check=True, timeout=300)
        results[variant] = dict(np.load(out))
    last = results[variants()[-1]]
    solid = np.isfinite(last["depth"])
    for variant in variants()[:-1]:
        pair = f"{variant} beside {variants()[-1]}"
        rgb, depth = results[variant]["rgb"], results[variant]["depth"]
        both = solid & np.isfinite(depth)
        yield Measure(f"{pair}: colour", most(rgb, last["rgb"]), 1 / 255)
        yield Measure(
            f"{pair}: median depth of 98 in 100 rays, of the depth", most(depth[both] / last["depth"][both], 1.0, 0.98), 1e-5
        )
        yield Measure(f"{pair}: median depth, of the depth", most(depth[both] / last["depth"][both], 1.0), 1e-2)
        yield Measure(f"{pair}: rays solid in one alone, share", float((solid != np.isfinite(depth)).mean()), 0.005)


CASES: dict[str, Case] = {
    **{where: moved(where) for where in FAR_OFF},
    "training data far off": training_data,
    **{f"beta {beta:g}": sharpness(beta) for beta in (1.0, 30.0, 1e3, 1e4)},
    "intervals": intervals,
    "grazed at 0.1 degrees": grazed,
    "from inside": inside,
    "along axes": axes,
    "along faces": faces,
    "rays that are none": unsound,
    "boxes of 1 cm and 50 m": boxes,
    "6D rotations": rotations,
    "opaque and empty": opaque_and_empty,
    "largest halves": weights(largest_halves),
    "weights of 1000": weights(largest_weights),
    "NaN in the kernels": not_numbers,
    "one ray and many": counts,
    "odd images": odd_images,
    "100 000 intervals": accumulated,
    "functions": functions,
}
