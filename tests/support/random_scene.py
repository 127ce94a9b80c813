"""A scene of random weights, with surfaces here and there, saved as a trained one; and an edited drive through it."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from analytic_scene import drive_of, still

from unisim_blender.core.geometry import Trajectory, make_pose, quaternion_from_yaw
from unisim_blender.core.model.checkpoint import save_scene
from unisim_blender.core.model.config import GridConfig, ModelConfig
from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.model.scene_file import SceneHeader
from unisim_blender.core.model.volume import Volume
from unisim_blender.core.presets import preset
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.world.drive import Actor, Box, Drive, StaticCopy

TINY = preset("tiny").model
CONFIGS: dict[str, ModelConfig] = {
    "tiny": TINY,
    "walking": dataclasses.replace(TINY, gaits=(("van", 1.3),)),
    "dark": dataclasses.replace(TINY, light="fixed", features=31, hidden=64),
    "sample": dataclasses.replace(TINY, head="sample", static_grid=GridConfig(3.2, 0.1, 6, 2, 15)),
    "paper": dataclasses.replace(TINY, density="unisim", light="fixed", head="sample", unisim_step_m=0.5),
}
PASSES = {"depth", "instance", "normal", "opacity", "unsupported"}
CARS = [
    still("car", (-8, 1, 0.8), (4.0, 1.8, 1.6), yaw=0.4),
    still("near", (-9, 0, 0.8), (4.0, 1.8, 1.6), yaw=-0.9),
    still("cone", (-12, -2, 0.4), (0.6, 0.6, 0.8)),
]
MOVING = dataclasses.replace(
    still("van", (-6, -3, 1), (5.0, 2.0, 2.2)),
    world_from_actor=Trajectory(
        np.array([0.0, 0.2, 0.5]),
        np.array([[-6.0, -3, 1], [-7, -1, 1], [-9, 2, 1]]),
        quaternion_from_yaw(np.array([0.0, 0.3, 1.0])),
    ),
    is_moving=True,
)


def box(x: float, y: float, z: float, yaw: float, size: tuple[float, float, float]) -> Box:
    return Box(make_pose(np.array([x, y, z]), quaternion_from_yaw(yaw)), np.array(size))


def edited(cars: Sequence[Actor] = (*CARS[1:], MOVING)) -> Drive:
    """These actors, a car gone if none are named, a box emptied, a place copied."""
    copies = (
        StaticCopy(
            "copy", box(-5, 4, 1, 0.2, (3, 3, 3)), make_pose(np.array([-13.0, 3, 1.2]), quaternion_from_yaw(1.1))
        ),
    )
    return drive_of(list(cars), copies, (box(-11, 1, 1, 0.5, (3, 2, 2)),))


def rough(model: SceneModel) -> None:
    """Random weights, smooth enough to have surfaces, occupied here and there."""
    scene: Any = model
    for field in (scene.static, scene.background):
        rows = torch.linspace(2.0, 0.0, len(field.grid.table))[:, None]
        field.grid.table.copy_(torch.randn_like(field.grid.table) * rows)
    for parameter in scene.actors.hypernetwork.parameters():
        parameter.normal_(0, 1.0)
    scene.static.network[-1].bias[0] = -0.1
    scene.actors.network[-1].bias[0] = -0.3
    if scene.light is not None:
        scene.light.network[-1].weight.normal_(0, 0.1)
        scene.light.home.copy_(torch.rand(scene.light.home.shape) * 10 + 20)
    scene.ray_head.codes.normal_()
    scene.occupancy.values.copy_(torch.where(torch.rand(scene.occupancy.values.shape) < 0.03, 255, 0))
    scene.observed.copy_(torch.rand(scene.observed.shape) < 0.5)
    scene.ground.heights.copy_(3.5 + torch.rand(scene.ground.heights.shape))
    if scene.actors.gaits is not None:  # last: what is drawn before is that of scenes without gaits
        scene.actors.gaits.tables.normal_(0, 0.3)


def saved(folder: Path, config: ModelConfig, seed: int = 0) -> Path:
    """A scene with random weights, smooth enough to have surfaces, occupied here and there."""
    torch.manual_seed(seed)
    drive = drive_of([*CARS, MOVING])
    corner = make_pose(np.array([-30.0, -20.0, -4.0]), quaternion_from_yaw(0.1))
    model = SceneModel(config, Volume(corner, np.array([60.0, 40.0, 16.0])), tuple(sorted(drive.actors)), ("front",))
    with torch.no_grad():
        rough(model)
    volume = model.volume.to_dict()
    training = {"frames": [0, 2], "cameras": ["front"], "lidars": ["top"], "width": None}
    header = SceneHeader(folder, "random", "none", "../none", np.zeros(3), config.to_dict(), volume, drive, training)
    save_scene(folder, header, model)
    return folder


def image_rays(drive: Drive, up: int = 2) -> Rays:
    camera = drive.cameras["front"]
    return camera_rays(camera, camera.time_s[2], *pixel_grid(camera.model, up))
