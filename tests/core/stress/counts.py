"""Cases of how many: rays, and pixels of an image."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from random_scene import CARS, PASSES, TINY, edited

from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.frames import RenderStats

from .measures import Bench, Measure, most
from .scenes import fan, make_scene
from .truths import arrays_of, not_finite, tracers


def counts(bench: Bench) -> Iterator[Measure]:
    """One ray and many: the same bits alone as in company."""
    drive = edited(CARS)
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
                    rays.part(part),
                    PASSES,
                    True,
                    None,
                    RenderStats(),
                )
            )
            errors += [
                most(alone[key], value[part])
                for key, value in arrays_of(whole).items()
                if key not in ("depth", "unsupported")
            ]
        yield Measure(
            f"{name}: one ray alone beside itself among all", max(errors), 0.0 if name == "compiled" else 1e-4
        )


def odd_images(bench: Bench) -> Iterator[Measure]:
    """Pictures whose sizes nothing divides."""
    drive = edited(CARS)
    folder = make_scene(bench.folder / "scene", drive)
    camera = drive.cameras["front"]
    for width, height in ((1, 1), (1, 7), (13, 1), (47, 31)):
        model = dataclasses.replace(camera.model, width=width, height=height)
        u, v = pixel_grid(model, TINY.upsample)
        rays = camera_rays(dataclasses.replace(camera, model=model), camera.time_s[2], u, v)
        images = {}
        for name, tracer in tracers(folder, drive).items():
            found = tracer.trace(rays, set(), True, None, RenderStats())
            images[name] = tracer.image(found, rays.flat().directions, "front", u.shape)
            yield Measure(
                f"{width} x {height}, {name}: pixels that are not finite", float((~np.isfinite(images[name])).sum()), 0
            )
        if len(images) == 2:
            yield Measure(
                f"{width} x {height}: compiled beside torch", most(images["compiled"], images["torch"], 0.98), 1e-4
            )
