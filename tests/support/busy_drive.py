"""A drive with everything that a state can hold, and scenes of random weights to render it with, by
kernels and by torch."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from analytic_scene import FRONT, still
from random_scene import CARS, MOVING, TINY, edited, saved

from unisim_blender.core import native
from unisim_blender.core.geometry import FloatArray, Trajectory, quaternion_from_yaw
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.render.tracer import Backend
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.render.tracers.torch.tracer import TorchBackend
from unisim_blender.core.world.drive import Actor, Appearance, Drive, RollingShutter

FOREIGN_SCENE = "other"


def weaving(keys: int, start: tuple[float, float, float], speed: float) -> Trajectory:
    """A trajectory along x through the drive's time, with a yaw that swings."""
    times = np.linspace(-0.1, 0.6, keys)
    positions = np.array(start) + np.stack([speed * times, 0.3 * np.sin(9 * times), 0 * times], -1)
    return Trajectory(times, positions, quaternion_from_yaw(0.3 * np.sin(7 * times)))


def ridden(trajectory: Trajectory, height: float, quaternion: FloatArray) -> Trajectory:
    """The way of a sensor on a vehicle that looks ahead."""
    return Trajectory(
        trajectory.times_s,
        trajectory.positions + [0, 0, height],
        np.broadcast_to(quaternion, trajectory.quaternions_wxyz.shape),
    )


def busy_drive(folder: Path) -> Drive:
    """An ego that moves, a rolling shutter, actors that move, one that is scaled, one of another scene, a mesh, a copy,
    an emptied box, parked actors that are gone, and actors that come late and leave early. The mesh's file goes
    into ``folder``."""
    mesh = folder / "cube.ply"
    cube = trimesh.creation.box([1.0, 1.0, 1.0])
    cube.visual.face_colors = [255, 64, 0, 255]
    cube.export(mesh)
    near, cone = CARS[1:]
    actors: list[Actor] = [
        replace(near, world_from_actor=weaving(8, (-9.0, 0.0, 0.8), -4.0), is_moving=True),
        replace(cone, size_m=cone.size_m * [1.5, 0.8, 2.0], scale=(1.5, 0.8, 2.0)),
        MOVING,
        still("guest", (-15, 1.5, 1.0), (3, 2, 2), yaw=0.3, appearance=Appearance("car", FOREIGN_SCENE), inserted=True),
        still(
            "cube",
            (0, 0, 0),
            (1, 1, 1),
            appearance=Appearance("cube", mesh=str(mesh)),
            inserted=True,
            world_from_actor=weaving(15, (-13.0, -1.0, 1.0), 6.0),
            is_moving=True,
        ),
        still("early", (-11, 1, 0.8), (4.0, 1.8, 1.6), appearance=Appearance("car"), start_s=-1.0, end_s=0.12),
        still("late", (-10, 2, 0.8), (4.0, 1.8, 1.6), appearance=Appearance("near"), start_s=0.33, end_s=0.5),
    ]
    drive = edited(actors)
    ego = weaving(29, (-20.0, 0.0, 0.0), 5.0)
    camera, lidar = drive.cameras["front"], drive.lidars["top"]
    camera = replace(
        camera,
        model=replace(camera.model, shutter=RollingShutter(0.04, 0.5)),
        world_from_camera=ridden(ego, 1.6, FRONT),
    )
    lidar = replace(lidar, world_from_lidar=ridden(ego, 1.8, np.array([1.0, 0, 0, 0])))
    return replace(drive, world_from_ego=ego, cameras={"front": camera}, lidars={"top": lidar})


def backends(folder: Path) -> dict[str, Backend]:
    """Two scenes of random weights, the second one for foreign actors, by the kernels where they are
    built and by torch."""
    scene, other = saved(folder / "scene", TINY), saved(folder / "other", replace(TINY, features=7), seed=1)
    found: dict[str, Backend] = {"torch": TorchBackend(load_scene(scene), others={FOREIGN_SCENE: load_scene(other)})}
    if native.library() is not None:
        found["compiled"] = CompiledBackend(CompiledScene(scene), others={FOREIGN_SCENE: CompiledScene(other)})
    return found
