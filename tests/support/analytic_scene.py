"""A scene model whose fields are known in closed form, and drives through it: what tracing is held against."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from drive_frames import DriveFrames
from torch import Tensor
from whole_drive import whole_state

from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_matrix, quaternion_from_yaw
from unisim_blender.core.model.checkpoint import TorchScene
from unisim_blender.core.model.config import ModelConfig
from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.model.scene_file import SceneHeader
from unisim_blender.core.model.volume import Volume
from unisim_blender.core.ops.field_values import FieldValues, LogDensities, SignedDistances
from unisim_blender.core.ops.ray_segments import RayBatch
from unisim_blender.core.ops.segment_trace import SegmentTrace
from unisim_blender.core.presets import preset
from unisim_blender.core.render.quality import quality_named
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracer import active_actors
from unisim_blender.core.render.tracers.torch.actor_tensors import ActiveActorTensors, active_actor_tensors
from unisim_blender.core.render.tracers.torch.segments import Sampling
from unisim_blender.core.render.tracers.torch.trace import trace
from unisim_blender.core.render.tracers.torch.tracer import TorchBackend
from unisim_blender.core.world.drive import (
    Actor,
    Appearance,
    Box,
    Camera,
    CameraModel,
    Drive,
    Lidar,
    LidarModel,
    StaticCopy,
)

GROUND_M = 0.0
"""World height of the ground, where a scene has one."""
EMPTY = 9.0
Points = Sequence[float] | FloatArray
Distance = Callable[[Tensor], Tensor]
"""Signed distances (N,) in metres at points (N, 3); logarithms of densities, where the configuration has these."""


def empty(x: Tensor) -> Tensor:
    return torch.full_like(x[:, 0], EMPTY)


def ground(x: Tensor) -> Tensor:
    """The plane z = GROUND_M of world points."""
    return x[:, 2] - GROUND_M


def sphere(centre: Points, radius: float) -> Distance:
    return lambda x: (x - torch.tensor(centre, dtype=x.dtype)).norm(dim=-1) - radius


def wall(x_m: float) -> Distance:
    """Everything beyond x = ``x_m``."""
    return lambda x: x_m - x[:, 0]


def block(size_m: Points) -> Distance:
    """A box about the origin."""

    def distance(x: Tensor) -> Tensor:
        q = x.abs() - torch.tensor(size_m, dtype=x.dtype) / 2
        return q.clamp_min(0).norm(dim=-1) + q.amax(-1).clamp_max(0)

    return distance


def union(*parts: Distance) -> Distance:
    return lambda x: torch.stack([part(x) for part in parts]).amin(0)


def mark(number: int, width: int) -> Tensor:
    """A feature that tells one field from another: 1 in its own place."""
    return torch.nn.functional.one_hot(torch.tensor(number), width).float()


def analytic_scene(
    static: Distance,
    actors: dict[str, tuple[Distance, FloatArray]],
    config: ModelConfig | None = None,
    beta: float = 200.0,
) -> SceneModel:
    """A model in a volume of 60 x 40 x 16 m about the origin, 4 m of it under the ground, turned by 30 degrees.

    ``static`` takes world points; ``actors`` are by id a distance about the box's centre and the box's size. Features
    say where weight came from: place 0 the static field, place n the n-th actor in the order of ids. Voxels that a
    surface may cross are occupied.
    """
    config = config or preset("tiny").model
    yaw = quaternion_from_yaw(np.radians(30))
    corner = make_pose(np.zeros(3), yaw) @ np.array([-30.0, -20.0, 0, 1])
    volume = Volume(make_pose(np.array([corner[0], corner[1], GROUND_M - 4]), yaw), np.array([60.0, 40.0, 16.0]))
    uids = tuple(sorted(actors))
    torch.manual_seed(0)
    scene = SceneModel(config, volume, uids, ("front",))
    with torch.no_grad():
        scene.log_beta.fill_(np.log(beta))
        scene.ground.heights.fill_(4.0)
    into = torch.as_tensor(volume.world_from_volume).float()

    def static_distance(x: Tensor) -> Tensor:
        return static(x @ into[:3, :3].T + into[:3, 3])

    def actor_distance(tables: Tensor, x: Tensor, row: Tensor) -> Tensor:
        out = torch.empty_like(x[:, 0])
        for i, uid in enumerate(uids):
            distance, size = actors[uid]
            mine = row == i
            out[mine] = distance((x[mine] - 0.5) * torch.as_tensor(size, dtype=x.dtype))
        return out

    step = config.voxel_m
    axes = (torch.arange(n) * step + step / 2 for n in scene.occupancy.values.shape)
    centres = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    near = static_distance(centres).abs() < 1.5 * step
    scene.occupancy.values.copy_(near.view(scene.occupancy.values.shape) * 255)
    marks = torch.stack([mark(n, config.features) for n in range(len(uids) + 1)])
    parts: Any = (scene.static, scene.actors, scene.background)

    kind = LogDensities if config.density == "volume" else SignedDistances

    def static_values(x: Tensor) -> FieldValues:
        return kind(static_distance(x))

    def actor_values(tables: Tensor, x: Tensor, row: Tensor) -> FieldValues:
        return kind(actor_distance(tables, x, row))

    for part in parts:  # the kernels query grids: they take the fields' own classes alone
        part.__class__ = type(f"Analytic{type(part).__name__}", (type(part),), {})
    parts[0].values, parts[1].values = static_values, actor_values
    parts[0].forward = lambda x: (static_values(x), marks[:1].expand(len(x), -1))
    parts[1].forward = lambda tables, x, row: (actor_values(tables, x, row), marks[row + 1])
    # nothing but the sky lies beyond the volume
    parts[2].forward = lambda x: (torch.zeros_like(x[:, 0]), x.new_zeros(len(x), config.features))
    parts[2].density = lambda x: torch.zeros_like(x[:, 0])
    return scene.requires_grad_(False).eval()


def still(uid: str, position: Points, size: Points, yaw: float = 0.0, **changes: Any) -> Actor:
    """An actor that stands still, throughout."""
    trajectory = Trajectory(np.zeros(1), np.array([position], float), quaternion_from_yaw(np.array([yaw])))
    return replace(Actor(uid, "Car", np.array(size, float), trajectory, 0.0, 0.5, False, Appearance(uid)), **changes)


FRONT = quaternion_from_matrix(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]))


def drive_of(actors: Sequence[Actor], copies: tuple[StaticCopy, ...] = (), removals: tuple[Box, ...] = ()) -> Drive:
    """Six frames from 0 to 0.5 s of an ego that stands at (-20, 0) and looks along x, with one camera and one LiDAR."""
    times = {frame: 0.1 * frame for frame in range(6)}

    def stands(quaternion: FloatArray) -> Trajectory:
        return Trajectory(np.zeros(1), np.array([[-20.0, 0, 1.6]]), quaternion[None])

    camera = Camera("front", CameraModel(48, 32, 40.0, 40.0, 24.0, 16.0), stands(FRONT), times)
    level = np.array([1.0, 0, 0, 0])
    model = LidarModel(np.radians([3.0, 0.0, -3.0, -8.0]), np.zeros(4), columns=180)
    lidar = Lidar("top", model, stands(level), times)
    return Drive(
        "analytic",
        tuple(times),
        times,
        stands(level),
        {"front": camera},
        {"top": lidar},
        {a.uid: a for a in actors},
        copies,
        removals,
    )


@dataclass
class Stage:
    """A scene and its active actors, ready to be traced."""

    scene: SceneModel
    drive: Drive
    others: dict[str, SceneModel] = field(default_factory=dict)

    def active(self) -> ActiveActorTensors:
        scenes = {path: (scene, tables(scene)) for path, scene in {"": self.scene, **self.others}.items()}
        appearances = {path: tuple(scene.actor_ids) for path, (scene, _) in scenes.items()}
        return active_actor_tensors(active_actors(whole_state(self.drive), appearances), scenes)

    def trace(
        self,
        origins: Any,
        directions: Any,
        time_s: Any = 0.0,
        fine: float = 4.0,
        background: bool = False,
        among: Tensor | None = None,
    ) -> SegmentTrace:
        """Rays (N, 3) or one (3,), at one time or each at its own; directions need no unit length."""
        o, d = np.broadcast_arrays(np.atleast_2d(origins).astype(float), np.atleast_2d(directions).astype(float))
        d = d / np.linalg.norm(d, axis=1, keepdims=True)
        batch = RayBatch(
            self.scene.frame.recentred(o),
            torch.tensor(d, dtype=torch.float32),
            torch.tensor(np.broadcast_to(time_s, len(o)).copy(), dtype=torch.float64),
        )
        with torch.no_grad():
            return trace(self.scene, self.active(), batch, Sampling(fine=fine, background=background), among)

    def as_scene(self, path: str = "scene") -> TorchScene:
        """The scene as a renderer takes it."""
        return TorchScene(Path(path), header_of(self.scene, self.drive, Path(path)), self.scene, tables(self.scene))


def tables(scene: SceneModel) -> Tensor:
    with torch.no_grad():
        return scene.actors.tables()


def header_of(scene: SceneModel, drive: Drive, path: Path) -> SceneHeader:
    """What `scene.json` says of it."""
    return SceneHeader(
        path,
        "analytic",
        "none",
        "../none",
        np.zeros(3),
        scene.config.to_dict(),
        scene.volume.to_dict(),
        drive,
        {"cameras": ["front"]},
    )


def renderer_of(
    scene: TorchScene,
    drive: Drive,
    quality: str = "balanced",
    others: dict[str, TorchScene] | None = None,
    shadows: bool = False,
    draw: int | None = None,
) -> DriveFrames:
    """The renderer of a drive through a scene, traced by torch."""
    return DriveFrames(Renderer(TorchBackend(scene, quality_named(quality), others), shadows), drive, draw)
