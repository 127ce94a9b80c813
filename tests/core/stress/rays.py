"""Cases of rays: from inside, along axes and faces, and such as are none."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
from analytic_scene import still
from random_scene import CARS, PASSES, edited

from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.sensors.frames import RenderStats
from unisim_blender.core.sensors.rays import Rays

from .measures import Bench, Measure, most
from .scenes import fan, image_rays, make_scene, plane
from .truths import arrays_of, beside_truth, not_finite, tracers, truth


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
    drive = edited(CARS)
    folder = make_scene(bench.folder / "scene", drive)
    rays = image_rays(drive, bench.full)
    for name, tracer in tracers(folder, drive).items():
        whole = tracer.trace(rays, PASSES, True, None, RenderStats())
        expected = arrays_of(whole)
        shape = (16 * bench.full, 24 * bench.full)
        image = tracer.image(whole, rays.directions, "front", shape).reshape(*shape, tracer.upsample, -1)
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
        again = tracer.image(found, other.directions, "front", shape).reshape(image.shape)
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
