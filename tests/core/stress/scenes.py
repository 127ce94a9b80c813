"""Scenes of random weights, or of a surface that is known exactly, their edited drive and the rays
that look at them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from random_scene import TINY, rough

from unisim_blender.core.geometry import (
    FloatArray,
    make_pose,
    quaternion_from_yaw,
    rotate_vectors,
    transform_points,
)
from unisim_blender.core.model.checkpoint import save_scene
from unisim_blender.core.model.config import ModelConfig
from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.model.scene_file import SceneHeader
from unisim_blender.core.model.volume import Volume
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.world.drive import Box, Drive, StaticCopy

SIZE_M = np.array([60.0, 40.0, 16.0])
CORNER = np.array([-30.0, -20.0, -4.0])
Change = Callable[[SceneModel], None]


def plane(height_m: float, beta: float) -> Change:
    """A level plane, known exactly: the distance is the height above it, for the coarsest level's
    vertices hold their z."""

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
        scene.background.network[-1].bias[0] = -30.0
        scene.ground.heights.fill_(height_m)

    return change


def moved_drive(drive: Drive, motion: FloatArray) -> Drive:
    """A drive, and all that is in it, moved by a rigid motion (4, 4)."""

    def box(pose: FloatArray) -> FloatArray:
        return motion @ pose

    actors = {
        u: dataclasses.replace(a, world_from_actor=a.world_from_actor.transformed(motion))
        for u, a in drive.actors.items()
    }
    return dataclasses.replace(
        drive,
        actors=actors,
        cameras={
            n: dataclasses.replace(c, world_from_camera=c.world_from_camera.transformed(motion))
            for n, c in drive.cameras.items()
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
    header = SceneHeader(
        folder, "stress", "none", "../none", np.zeros(3), config.to_dict(), volume.to_dict(), recorded, training
    )
    save_scene(folder, header, model)
    return folder


def image_rays(drive: Drive, full: int = 1) -> Rays:
    """The front camera's, a ray for every two pixels of 48 x 32, or more."""
    recorded = drive.cameras["front"]
    camera = dataclasses.replace(recorded, model=recorded.model.resized(recorded.model.width * full))
    return camera_rays(camera, camera.time_s[2], *pixel_grid(camera.model, 2)).flat()


def moved_rays(rays: Rays, motion: FloatArray) -> Rays:
    """Rays moved by a rigid motion (4, 4)."""
    return Rays(transform_points(motion, rays.origins), rotate_vectors(motion, rays.directions), rays.time_s)


def fan(n: int, origin: Any, spread: float = 0.3, seed: int = 0) -> Rays:
    """Rays about +x from one place, at times from 0 to 0.5 s."""
    rng = np.random.default_rng(seed)
    d = rng.normal([1, 0, 0], [0, spread, spread / 2], (n, 3))
    return Rays(
        np.tile(np.asarray(origin, float), (n, 1)), d / np.linalg.norm(d, axis=1, keepdims=True), rng.uniform(0, 0.5, n)
    )
