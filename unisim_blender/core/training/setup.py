"""Set-up of a training before its first step: the data of the log, the model seeded by it, the optimisers."""

from __future__ import annotations

import dataclasses
import inspect
import math
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from .. import native
from ..data.fingerprint import Fingerprint, fingerprint_of
from ..data.log import Log, extras_of
from ..errors import LogError
from ..geometry import FloatArray, invert_pose, transform_points
from ..model.actors import GridActors
from ..model.config import ModelConfig
from ..model.fields import HashTable
from ..model.occupancy import OccupancyTrainer
from ..model.scene import SceneModel
from ..model.shapes import cells_of, check_sizes
from ..model.tracklets import Tracklets
from ..model.volume import Volume
from ..ops.constants import SYMMETRIC_CLASSES
from ..ops.devices import kernel_threads, module_to, torch_threads, zeros_on_demand
from ..ops.encode import GradientSink
from ..world.classes import motion_of
from ..world.drive import Actor, Drive
from ..world.replay import with_windows
from .batches.data import CameraData, LidarData, lidar_captures
from .batches.images import PixelChoice
from .batches.sweeps import SweepRef, SweepWindow, all_sweeps_fit
from .config import TrainConfig, rate_factor, recipe
from .gaits import gaits_of
from .losses.shape import ShapeLosses
from .losses.terms import Adversary, VggLoss, perceptual_stand_in
from .losses.unobserved import UnobservedPrior
from .poses import CameraPoses, fitted, with_drive
from .seeding import (
    VoxelEvidence,
    driven_places,
    free_away,
    seed_by_evidence,
    seed_ground,
    seed_voxels,
    sized,
    voxel_evidence,
)


def _plain(name: str) -> Any:
    """A method of torch's Adam as it is written, out of what decorates it."""
    return inspect.unwrap(getattr(torch.optim.Adam, name))


class Adam(torch.optim.Adam):
    """`torch.optim.Adam`, equal to the bit, without torch's compiler, which torch's optimisers take seconds to import; it
    cannot be part of what torch compiles."""

    add_param_group, zero_grad = _plain("add_param_group"), _plain("zero_grad")
    state_dict, load_state_dict = _plain("state_dict"), _plain("load_state_dict")
    step = torch.no_grad()(_plain("step"))


class CompiledAdam(Adam):
    """`Adam` by the compiled kernel: one pass over the memory, after which gradients are zero. It takes float32
    parameters on the CPU without gaps; its threads end with the pass, where torch's would wait for more work in a loop."""

    @torch.no_grad()
    def step(self, closure: None = None) -> None:  # type: ignore[override]
        """Update the parameters that have a gradient, and set their gradients to zero."""
        lib, parts = native.library(), []
        assert lib is not None
        beta1, beta2 = self.defaults["betas"]
        for group in self.param_groups:
            for p in group["params"]:
                if p.grad is None:
                    continue
                state = self.state[p]
                if not state:
                    state.update(step=torch.tensor(0.0), exp_avg=torch.zeros_like(p), exp_avg_sq=torch.zeros_like(p))
                state["step"] += 1
                # a kernel's weights may have their channels last
                p.grad, state["exp_avg"], state["exp_avg_sq"] = arrays = [
                    a if a.stride() == p.stride() else torch.empty_like(p).copy_(a)
                    for a in (p.grad, state["exp_avg"], state["exp_avg_sq"])
                ]
                assert all(a.dtype == torch.float32 for a in (p, *arrays)), p.shape
                taken = float(state["step"])
                rate, root = group["lr"] / (1 - beta1**taken), math.sqrt(1 - beta2**taken)
                pointers = (a.data_ptr() for a in (p, *arrays))
                parts.append(native.AdamStruct(p.numel(), *pointers, rate, root, group["eps"]))
        lib.unisim_adam((native.AdamStruct * len(parts))(*parts), len(parts), beta1, beta2, kernel_threads())


class TrainingSetup:
    """A scene to be trained on one log: data, model, corrected poses, optimisers and the networks of losses."""

    def __init__(self, log: Log, config: TrainConfig) -> None:
        self.config, self.recipe = config, recipe(config)
        self.rate_factor = rate_factor(self.recipe, config.patches * config.patch_cells**2)
        torch.manual_seed(config.seed)
        # noise that differs from key to key is for the labels to tell of: rays see a box at a few moments only
        self.log = log = with_drive(log, fitted(log.drive)) if self.recipe.refines_tracklets else log
        drive = log.drive
        self.volume = Volume.along(drive)
        shapes = sized(self.recipe.model, drive, self.volume)
        self.lidars = config.lidars if self.recipe.uses_lidar else ()
        if self.recipe.uses_lidar and not self.lidars:
            raise LogError(
                f"{log.path}: has no LiDAR sweep to train on; the presets ngp and nsg need none, --without lidar"
            )
        if self.recipe.poses:
            shapes = dataclasses.replace(shapes, gaits=gaits_of(log, self.lidars, config.frames))
            check_sizes(shapes, self.volume, drive.name)
        ids = () if shapes.actors == "none" else tuple(sorted(drive.actors))
        actors = [drive.actors[uid] for uid in ids]
        # of a long drive the first sweeps and images are read while the model is made
        captures = lidar_captures(log, self.lidars, config.frames)
        in_memory = all_sweeps_fit(drive, captures)
        window = None if in_memory else self._sweep_window(captures, actors, shapes.voxel_m)
        self.cameras = CameraData(
            log, list(config.cameras), list(config.frames), config.width, self.volume.corner, config.seed
        )
        self._make_model(shapes, ids)
        self._make_optimisers()
        self._deferred: tuple[dict[str, Tensor], dict[str, Tensor]] | None = None
        if window is not None:
            self.deferred()  # while the first sweeps are read
        self.choice = PixelChoice(self.cameras.rooms(shapes.upsample), self.cameras.actors())
        self.lidar: LidarData | SweepWindow
        if window is None:
            self.lidar = LidarData(log, self.lidars, config.frames, self.volume.corner, actors)
            origins, points = self.lidar.static_returns()
        else:
            self.lidar = window
            origins, points = window.static_returns()
        origins, points = transform_points(self._into, origins), transform_points(self._into, points)
        self._seed(window, origins, points, actors)
        self.occupancy = OccupancyTrainer(self.model.occupancy)
        self.shape = ShapeLosses(self.model, self.occupancy, self.known_ground)
        self.unobserved = UnobservedPrior(
            self.model, self.occupancy, self.known_ground, self._still_boxes(drive), torch.as_tensor(points).float()
        )
        self.perceptual = VggLoss(Path(config.vgg)).to(config.device) if config.vgg else perceptual_stand_in
        self.adversary = Adversary(config.device, config.seed) if config.adversarial else None

    def _make_model(self, shapes: ModelConfig, ids: tuple[str, ...]) -> None:
        config, drive = self.config, self.log.drive
        self.model = SceneModel(shapes, self.volume, ids, config.cameras).to(config.device)
        actors = with_windows(drive, [drive.actors[uid] for uid in ids])
        self.tracklets = module_to(Tracklets(actors, refine=True, corner=self.volume.corner), config.device)
        self.rows = torch.arange(len(actors), device=config.device)
        mirrored = [self.recipe.mirrored * self._is_symmetric(a.label) for a in actors]
        self.mirror = torch.tensor(mirrored, device=config.device)
        self.log_gains = nn.Parameter(torch.zeros(len(self.cameras.views), 3, device=config.device))
        self.camera_poses = module_to(CameraPoses(self.cameras.times_s()), config.device)

    def _seed(self, window: SweepWindow | None, origins: FloatArray, points: FloatArray, actors: list[Actor]) -> None:
        """Fill the model's occupancy and ground by what the log's beams hit: their ``origins`` and ``points`` (N, 3) on
        what stands, frame of the volume."""
        model, drive = self.model, self.log.drive
        under = points if self.lidars else transform_points(self._into, driven_places(drive))
        heights, known = seed_ground(under, self.volume.size_m)
        if self.recipe.uses_lidar:
            x, y, z = model.occupancy.values.shape
            grid = (x, y, z), model.config.voxel_m, heights, known
            seeded = seed_by_evidence(window.first_evidence(), *grid) if window else seed_voxels(origins, points, *grid)
            free_away(seeded, self.volume, model.config.voxel_m, drive)
            model.occupancy.values.copy_(torch.as_tensor(seeded))
        model.ground.heights.copy_(torch.as_tensor(heights))
        if model.light is not None:
            positions = [_middle(actor)[:3, 3] for actor in actors]
            model.light.home.copy_(torch.as_tensor(transform_points(self._into, np.reshape(positions, (-1, 3)))))
        self.known_ground = torch.as_tensor(np.argwhere(known)).float().to(self.config.device)

    @cached_property
    def _into(self) -> FloatArray:
        """The volume's frame from the world's (4, 4)."""
        return invert_pose(self.volume.world_from_volume)

    @cached_property
    def fingerprint(self) -> Fingerprint:
        """Fingerprint that identifies the log's drive, by the first camera and LiDAR that are trained on. Raises
        `LogError`."""
        return fingerprint_of(self.log, (*self.config.cameras, "")[0], (*self.lidars, "")[0])

    def _sweep_window(self, captures: list[SweepRef], actors: Iterable[Actor], voxel_m: float) -> SweepWindow:
        """Sweeps that are too many to be held; those of the first step are under way already."""
        into = self._into
        x, y, z = cells_of(self.volume.size_m, voxel_m)

        def mark(origins: FloatArray, points: FloatArray) -> VoxelEvidence:
            return voxel_evidence(transform_points(into, origins), transform_points(into, points), (x, y, z), voxel_m)

        return SweepWindow(self.log, captures, self.volume.corner, self.config.seed, actors, mark)

    def _is_symmetric(self, label: str) -> bool:
        """Whether a class's two sides look alike: a vehicle's do, a rider's do not."""
        motion = motion_of(label, extras_of(self.log).classes)
        return any(word in label.lower() for word in SYMMETRIC_CLASSES) and motion not in ("deforming", "still")

    def _still_boxes(self, drive: Drive) -> tuple[Tensor, Tensor] | None:
        still = [a for _, a in sorted(drive.actors.items()) if not a.is_moving]
        if not still:
            return None
        poses = np.stack([_middle(a) for a in still])
        poses[:, :3, 3] -= self.volume.corner
        sizes = np.stack([a.size_m for a in still])
        device = self.config.device
        return torch.as_tensor(poses).float().to(device), torch.as_tensor(sizes).float().to(device)

    def _make_optimisers(self) -> None:
        tables = []
        self.sinks: list[tuple[GradientSink, Tensor]] = []
        has_kernels = self.config.device.startswith(("cpu", "cuda"))
        for module in self.model.modules():
            if isinstance(module, HashTable):
                tables.append(module.table)
                if has_kernels:
                    module.sink = GradientSink()
                    self.sinks.append((module.sink, module.table))
        if has_kernels:
            self.model.actors.sink = GradientSink()
        gaits = self.model.actors.gaits
        if gaits is not None and not self._makes_poses:
            gaits.sink = GradientSink()
            self.sinks.append((gaits.sink, gaits.tables))
        poses = [] if gaits is None else [gaits.tables]
        appearances = [p for p in self.model.actors.own() if all(p is not pose for pose in poses)]
        known = {id(p) for p in (*tables, *appearances, *poses)}
        networks = [p for p in self.model.parameters() if id(p) not in known]
        c = self.config
        fast = [
            {"params": tables, "rates": c.rate_tables, "eps": 1e-15},
            {"params": networks, "rates": c.rate_networks, "eps": 1e-10},
        ]
        slow = [
            {"params": appearances, "rates": c.rate_tables, "eps": 1e-15}
            if self.model.config.actors == "tables"
            else {"params": appearances, "rates": c.rate_networks, "eps": 1e-10},
            {"params": poses, "rates": c.rate_tables, "eps": 1e-15},
            {"params": [self.tracklets.shift_m], "rates": c.rate_shifts, "eps": 1e-10},
            {"params": [self.tracklets.turn_6d], "rates": c.rate_turns, "eps": 1e-10},
            {"params": [self.camera_poses.shift_m], "rates": c.rate_camera_shifts, "eps": 1e-10},
            {"params": [self.camera_poses.turn_rad], "rates": c.rate_camera_turns, "eps": 1e-10},
            {"params": [self.log_gains], "rates": c.rate_exposures, "eps": 1e-10},
        ]
        on_gpu = c.device.startswith("cuda")
        if on_gpu:
            # a graph of operations reads a rate where it is, not what it was
            for group in (*fast, *slow):
                group["lr"] = torch.full((), 1e-3, device=c.device)
        kind = CompiledAdam if c.device == "cpu" and native.library() is not None else Adam
        self.optimiser, self.slow = (
            kind(groups, lr=1e-3, betas=(0.9, 0.99), fused=c.device != "mps", capturable=on_gpu)
            for groups in (fast, slow)
        )

    @property
    def _makes_poses(self) -> bool:
        """Whether steps have the tables of all poses: a GPU writes them sooner than it waits for which samples need some."""
        return self.config.device != "cpu" or not isinstance(self.model.actors, GridActors)

    def slow_outputs(self) -> dict[str, Tensor]:
        """Return what the slow parameters give: see `deferred`."""
        positions, quaternions = self.tracklets.keys()
        actors = self.model.actors
        tables = actors.tables() if self._makes_poses else actors.own_rows()
        return {"tables": tables, "positions": positions, "quaternions": quaternions}

    def deferred(self) -> dict[str, Tensor]:
        """Return the outputs of the slow parameters, constant between two slow updates: every actor's grid
        (``tables``), the tracklets' keys (``positions``, ``quaternions``). Their gradients, of many encodings and
        steps, are added up."""
        if self._deferred is None:
            with torch_threads(None):
                outputs = self.slow_outputs()
            cut = {name: value.detach().requires_grad_() for name, value in outputs.items()}
            # of a long drive's actors a few steps hit few
            cut["tables"].grad = zeros_on_demand(outputs["tables"].shape, device=outputs["tables"].device)
            self._deferred = outputs, cut
        return self._deferred[1]


def _middle(actor: Actor) -> FloatArray:
    """An actor's pose (4, 4) in the middle of its time."""
    return actor.world_from_actor.at((actor.start_s + actor.end_s) / 2)
