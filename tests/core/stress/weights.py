"""Cases of what weights can be: opaque, empty, at the largest numbers, not numbers."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from analytic_scene import drive_of
from random_scene import CARS, PASSES, edited
from whole_drive import bound_to

from unisim_blender.core import native
from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.structs import address
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.sensors.frames import RenderStats

from .measures import Bench, Measure, most
from .scenes import image_rays, make_scene
from .truths import beside_truth, tracers


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
        scene.background.network[-1].bias[0] = -60.0
        scene.background.network[-1].weight[0].zero_()

    for name, change, wanted, drive in (("opaque", opaque, 1.0, edited(CARS)), ("empty", empty, 0.0, drive_of(CARS))):
        folder = make_scene(bench.folder / name, drive, change)
        rays = image_rays(drive, bench.full)
        for measure in beside_truth(folder, drive, rays, 1e-5, 1e-6, 5e-4):
            yield dataclasses.replace(measure, what=f"{name}, {measure.what}")
        for which, tracer in tracers(folder, drive).items():
            found = tracer.trace(rays, set(), True, None, RenderStats())
            yield Measure(f"{name}, {which}: opacity", most(np.asarray(found.opacity), wanted), 1e-6)


def largest_halves(model: SceneModel) -> None:
    """Tables of the largest halves, of both signs."""
    scene: Any = model
    for field in (scene.static, scene.background):
        field.grid.table.copy_(torch.where(torch.rand_like(field.grid.table) < 0.5, -65504.0, 65504.0))
    last = scene.actors.hypernetwork[-1]
    last.weight.zero_()
    last.bias.copy_(torch.where(torch.rand_like(last.bias) < 0.5, -65504.0, 65504.0))


def largest_weights(model: SceneModel) -> None:
    """Networks with weights of a thousand."""
    scene: Any = model
    for field in (scene.static, scene.background, scene.actors):
        for layer in (field.network[0], field.network[-1]):
            layer.weight.copy_(1000 * torch.sign(torch.randn_like(layer.weight)))


def not_numbers(bench: Bench) -> Iterator[Measure]:
    """Tables and networks of NaN and infinity, which no file may hold, given to the kernels directly:
    nothing is read beyond."""
    if native.library() is None:
        return
    drive = edited(CARS)
    folder = make_scene(bench.folder / "scene", drive)
    rays = image_rays(drive, bench.full)
    for bits in (0x7E00, 0x7C00, 0xFC00, 0xFFFF):
        tracer = bound_to(CompiledBackend(CompiledScene(folder)), drive)
        kept = []
        struct = tracer.scene.struct
        for field, grids in (
            (struct.static_field, 1),
            (struct.background, 1),
            (struct.actor_fields, len(tracer.scene.appearances)),
        ):
            assert field.half
            rows = int(field.grid.grid_stride) * grids
            table = np.full(rows * field.grid.features, bits, np.uint16)
            kept.append(table)
            field.table = address(table)
        found = tracer.trace(rays, PASSES, True, None, RenderStats())
        yield Measure(
            f"halves of {bits:#06x}: opacities not in 0 to 1",
            float((~((found.opacity >= 0) & (found.opacity <= 1))).sum()),
            0,
        )
        del kept
