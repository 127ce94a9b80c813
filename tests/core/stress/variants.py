"""How far instruction sets differ."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from instruction_sets import run_with, sets_here
from random_scene import CARS, PASSES, edited
from whole_drive import bound_to

from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.sensors.frames import RenderStats

from .measures import Bench, Measure, most
from .scenes import image_rays, make_scene
from .truths import arrays_of

VARIANT_SCRIPT = """
from stress.variants import write_found
write_found(*sys.argv[1:])
"""


def write_found(folder: str, out: str, full: str) -> None:
    """What the compiled tracer finds of a scene, and its image, into a file: in a process of the
    instruction set asked for."""
    drive = edited(CARS)
    tracer, rays = bound_to(CompiledBackend(CompiledScene(folder)), drive), image_rays(drive, int(full))
    found = tracer.trace(rays, PASSES, True, None, RenderStats())
    rgb = tracer.image(found, rays.directions, "front", (16 * int(full), 24 * int(full)))
    np.savez(
        out, rgb=rgb.reshape(-1, 3), **{name: values.astype(np.float64) for name, values in arrays_of(found).items()}
    )


def compared_variants(bench: Bench) -> Iterator[Measure]:
    """How far instruction sets differ, on a random scene: in colours of 0 to 1 and in depths."""
    folder = make_scene(bench.folder / "scene", edited(CARS))
    results = {}
    for variant in sets_here():
        out = bench.folder / f"{variant}.npz"
        run_with(variant, VARIANT_SCRIPT, folder, out, bench.full)
        results[variant] = dict(np.load(out))
    last = results[sets_here()[-1]]
    solid = np.isfinite(last["depth"])
    for variant in sets_here()[:-1]:
        pair = f"{variant} beside {sets_here()[-1]}"
        rgb, depth = results[variant]["rgb"], results[variant]["depth"]
        both = solid & np.isfinite(depth)
        # a sample that rounding moves into the next voxel changes its ray, and pixels whose decoded patch holds it
        yield Measure(f"{pair}: colour of 99.9 in 100 pixels", most(rgb, last["rgb"], 0.999), 1 / 255)
        yield Measure(f"{pair}: colour", most(rgb, last["rgb"]), 0.1)
        yield Measure(
            f"{pair}: median depth of 98 in 100 rays, of the depth",
            most(depth[both] / last["depth"][both], 1.0, 0.98),
            1e-5,
        )
        off = np.abs(depth[both] / last["depth"][both] - 1) > 1e-2
        yield Measure(f"{pair}: rays with a median depth beyond 1 %, share", float(off.mean()), 0.005)
        yield Measure(f"{pair}: rays solid in one alone, share", float((solid != np.isfinite(depth)).mean()), 0.005)
