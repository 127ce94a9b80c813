"""What a scene's rays meet, by torch's own modules in float64 throughout, and both tracers beside it."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from random_scene import CARS, PASSES, edited
from whole_drive import bound_to, whole_state

from unisim_blender.core import native
from unisim_blender.core.geometry import (
    FloatArray,
    invert_pose,
)
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.model.tracklets import Tracklets
from unisim_blender.core.ops.ray_segments import RayBatch
from unisim_blender.core.ops.segment_trace import SegmentTrace
from unisim_blender.core.render.quality import QUALITIES, quality_named
from unisim_blender.core.render.tracer import Tracer, TraceResult, active_actors
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.render.tracers.torch.actor_tensors import ActiveActorTensors, active_actor_tensors
from unisim_blender.core.render.tracers.torch.ray_passes import median_depth
from unisim_blender.core.render.tracers.torch.segments import Sampling
from unisim_blender.core.render.tracers.torch.trace import trace
from unisim_blender.core.render.tracers.torch.tracer import TorchBackend
from unisim_blender.core.sensors.frames import RenderStats
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.world.drive import Actor, Drive

from .measures import Bench, Case, Measure, most
from .scenes import Change, image_rays, make_scene


def exactly(tracklets: Tracklets, actors: tuple[Actor, ...]) -> None:
    """Tracklets in float64, of what was never rounded."""
    tracklets.double()
    for i, actor in enumerate(actors):
        trajectory = actor.world_from_actor
        k = len(trajectory.times_s)
        tracklets.positions[i, :k] = torch.as_tensor(trajectory.positions - tracklets.corner)
        tracklets.quaternions[i, :k] = torch.as_tensor(trajectory.quaternions_wxyz)
        tracklets.sizes_m[i] = torch.as_tensor(actor.appearance_size_m).float()


def truth(
    folder: Path, drive: Drive, rays: Rays, quality: str = "balanced", sky: bool = True
) -> tuple[SegmentTrace, FloatArray]:
    """What flat rays meet, and their median depths (N,), by torch in float64 throughout."""
    scene = load_scene(folder)
    model, tables = scene.model.double(), scene.actor_tables.double()
    model.frame.rotation.copy_(torch.as_tensor(model.volume.world_from_volume[:3, :3].T))
    active = active_actors(whole_state(drive, scene.header.drive), {"": tuple(model.actor_ids)})
    tensors: ActiveActorTensors = active_actor_tensors(active, {"": (model, tables)})
    exactly(tensors.own.tracklets, active.own.actors)
    corner = model.volume.corner

    def recentred(pose: FloatArray) -> FloatArray:
        return np.vstack([np.c_[pose[:3, :3], pose[:3, 3] - corner], pose[3:]])

    if tensors.copies is not None:
        exactly(tensors.copies, active.targets)
        tensors.copy_source = torch.as_tensor(np.stack([recentred(box.world_from_box) for box in active.sources]))
    if tensors.removals is not None:
        poses = np.stack([invert_pose(recentred(box.world_from_box)) for box in active.removals])
        tensors.removals = torch.as_tensor(poses), tensors.removals[1].double()
    batch = RayBatch(
        model.frame.recentred(rays.origins), torch.as_tensor(rays.directions), torch.as_tensor(rays.time_s)
    )
    assert batch.origins.dtype == torch.float64
    with torch.no_grad():
        traced = trace(model, tensors, batch, Sampling(fine=quality_named(quality).samples, sky=sky))
        return traced, median_depth(traced).numpy()


Tracers = dict[str, Tracer[Any]]


def tracers(folder: Path, drive: Drive, quality: str = "balanced") -> Tracers:
    """The compiled tracer, where it was built, and torch's."""
    out: Tracers = {"torch": bound_to(TorchBackend(load_scene(folder), QUALITIES[quality]), drive)}
    if native.library() is not None:
        compiled = bound_to(CompiledBackend(CompiledScene(folder)), drive)
        # torch's very samples: a march has others
        compiled.quality = dataclasses.replace(QUALITIES["reference"], samples=quality_named(quality).samples)
        out["compiled"] = compiled
    return out


def arrays_of(found: TraceResult[Any]) -> dict[str, NDArray[Any]]:
    """All that was found, in numpy."""
    named = {"feature": found.feature, "depth_m": found.depth_m, "opacity": found.opacity, **found.maps}
    return {name: np.asarray(values) for name, values in named.items()}


def not_finite(found: TraceResult[Any]) -> float:
    """How many numbers are not finite; the depth pass is infinite where nothing solid is."""
    arrays = arrays_of(found)
    if "depth" in arrays:
        arrays["depth"] = arrays["depth"][arrays["opacity"] > 0.5]
    return float(sum((~np.isfinite(values)).sum() for values in arrays.values()))


def beside_truth(
    folder: Path, drive: Drive, rays: Rays, depth: float, opacity: float, feature: float, quality: str = "balanced"
) -> Iterator[Measure]:
    """Both tracers against float64. Errors are those of 98 in 100 rays: where a place of a sample is rounded into the
    next voxel, as many other samples are as good."""
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
        yield Measure(
            f"{name}: features, of their mean size", most(got["feature"], exact.feature, 0.98) / scale, feature
        )


def changed(change: Change, depth: float) -> Case:
    """The edited drive through a scene of random weights that are changed; ``depth`` bounds its error, metres."""

    def case(bench: Bench) -> Iterator[Measure]:
        drive = edited(CARS)
        folder = make_scene(bench.folder / "scene", drive, change)
        yield from beside_truth(folder, drive, image_rays(drive, bench.full), depth, 1e-4, 2e-3)

    return case
