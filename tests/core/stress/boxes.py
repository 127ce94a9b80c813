"""Cases of boxes: their sizes and how they are turned."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import torch
from analytic_scene import still
from random_scene import CARS, edited

from unisim_blender.core.model.tracklets import quaternion_from_rotation, rotation_from_6d
from unisim_blender.core.sensors.rays import Rays

from .measures import Bench, Measure, most
from .scenes import image_rays, make_scene
from .truths import beside_truth


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
    for where, rays, feature in (("all", image_rays(drive, bench.full), 2e-3), ("a centimetre", aimed, 0.2)):
        for measure in beside_truth(folder, drive, rays, 5e-3, 1e-4, feature):
            yield dataclasses.replace(measure, what=f"{where}, {measure.what}")


def scaled(bench: Bench) -> Iterator[Measure]:
    """Actors at the least and the largest size that a scenario gives them, evenly and along one axis."""
    folder = make_scene(bench.folder / "scene", edited(CARS))
    for name, factors in (
        ("0.1", (0.1, 0.1, 0.1)), ("10", (10.0, 10.0, 10.0)), ("one axis", (10.0, 0.1, 1.0)), ("1", (1.0, 1.0, 1.0)),
    ):  # fmt: skip
        cars = [dataclasses.replace(car, size_m=car.size_m * np.array(factors), scale=factors) for car in CARS]
        drive = edited(cars)
        for measure in beside_truth(folder, drive, image_rays(drive, bench.full), 5e-3, 1e-4, 2e-3):
            yield dataclasses.replace(measure, what=f"{name}, {measure.what}")


def rotations(bench: Bench) -> Iterator[Measure]:
    """6D rotations whose columns are nearly parallel, nearly nothing, or huge; values against
    float64, and gradients."""
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
