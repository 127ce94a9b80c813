"""The training loop: batches in, one optimiser step out, checkpoints that survive a kill."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable
from concurrent.futures import Future
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from .. import native
from ..data.classes import motion_of
from ..data.fingerprint import Fingerprint, fingerprint_of
from ..data.log import Log, extras_of
from ..errors import LogError, SceneError
from ..geometry import FloatArray, invert_pose, transform_points
from ..model.fields import HashTable
from ..model.scene import SceneModel
from ..model.shapes import cells_of
from ..model.space.occupancy import OccupancyTrainer
from ..model.space.volume import Volume
from ..model.tracklets import Tracklets
from ..ops.constants import VEHICLES
from ..ops.devices import kernel_threads, module_to, tensor_to, torch_threads, zeros_on_demand
from ..ops.encode.gradient_sink import GradientSink
from ..ops.ray_segments import RayBatch
from ..ops.segment_trace import SegmentTrace
from ..render.tracers.torch.actor_tensors import ActiveActorTensors, ActorSetTensors
from ..render.tracers.torch.sampling import Sampling
from ..render.tracers.torch.trace import trace
from ..world.drive import Actor, Drive
from ..world.replay import with_windows
from .batches.data import CameraData, LidarData, PatchBatch, lidar_captures
from .batches.lidar_batch import LidarBatch
from .batches.pixels import Draw, PixelChoice
from .batches.sweeps import Capture, SweepWindow, all_sweeps_held
from .config import TrainConfig
from .losses.adversarial import Adversary, shifted
from .losses.parallel import BranchGradients, run_branches
from .losses.perceptual import VggLoss
from .losses.shape import Shape
from .losses.terms import as_shown, colour_squares, distortion, lidar_terms, perceptual_stand_in
from .optimiser import Adam
from .poses.camera_poses import CameraPoses
from .poses.disturb import with_drive
from .poses.fitted_trajectories import fitted
from .recipe import recipe
from .space.ground_heights import driven_places, ground_heights
from .space.long_drives import free_away, sized
from .space.seed_voxels import VoxelEvidence, seed_by_evidence, seed_voxels, voxel_evidence
from .space.unobserved import UnobservedPrior

BETA_MAX = 100.0
"""Sharper than this, 1 / metres, a surface is far thinner than the finest cell, and no gradient
comes from beside it."""
LAST_RATE = 0.1
"""What rates are multiplied by in the end, when samples have stood still for a while."""
_STOPPED_FROM = 0.8
"""From this progress on surfaces are sharp, and how much of a ray stops in a voxel tells a surface from haze."""


@dataclass(frozen=True)
class _BranchStart:
    """What a branch of a step starts with: the training's progress, the active actors, whose actors have these
    ``tables``, random numbers and gradients of its own, and what the cameras' rays hit, once it is known."""

    done: float
    active: ActiveActorTensors
    tables: Tensor
    rng: np.random.Generator
    generator: torch.Generator
    gradients: BranchGradients
    seen: Future[SegmentTrace]


@dataclass(frozen=True)
class _Branch:
    """What a branch of a step leaves: the values of its terms, metrics, what its rays hit, recorded
    and made-up images."""

    terms: dict[str, float]
    metrics: dict[str, float]
    traced: SegmentTrace | None
    fake: tuple[Tensor, Tensor] | None


class Trainer:
    """Trains one scene on one log."""

    def __init__(self, log: Log, config: TrainConfig) -> None:
        self.config, self.recipe = config, recipe(config)
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
        ids = () if shapes.actors == "none" else tuple(sorted(drive.actors))
        appearances = {uid: drive.actors[uid] for uid in ids}
        into = invert_pose(self.volume.world_from_volume)
        # of a long drive the first sweeps and images are read while the model is made
        captures = lidar_captures(log, self.lidars, config.frames)
        held = all_sweeps_held(drive, captures)
        window = None if held else self._sweep_window(captures, appearances.values(), shapes.voxel_m)
        self.cameras = CameraData(
            log, list(config.cameras), list(config.frames), config.width, self.volume.corner, config.seed
        )
        model = SceneModel(shapes, self.volume, ids, config.cameras)
        shape = tuple(model.occupancy.values.shape)
        self.model = model.to(config.device)
        actors = with_windows(drive, appearances.values())
        self.tracklets = module_to(Tracklets(actors, refine=True, corner=self.volume.corner), config.device)
        self.rows = torch.arange(len(actors), device=config.device)
        mirrored = [self.recipe.mirrored * self._is_symmetric(a.label) for a in actors]
        self.mirror = torch.tensor(mirrored, device=config.device)
        self.camera_poses = module_to(CameraPoses(self.cameras.times_s()), config.device)
        self._make_optimiser()
        if window is not None:
            self.deferred()  # while the first sweeps are read
        self.choice = PixelChoice(self.cameras.rooms(shapes.upsample))
        self.lidar: LidarData | SweepWindow
        if window is None:
            self.lidar = LidarData(log, self.lidars, config.frames, self.volume.corner)
            origins, points = self.lidar.static_returns(appearances.values())
        else:
            self.lidar = window
            origins, points = window.static_returns()
        origins, points = transform_points(into, origins), transform_points(into, points)
        under = points if self.lidars else transform_points(into, driven_places(drive))
        heights, known = ground_heights(under, self.volume.size_m)
        if self.recipe.uses_lidar:
            grid = (shape[0], shape[1], shape[2]), model.config.voxel_m, heights, known
            seeded = seed_by_evidence(window.first_evidence(), *grid) if window else seed_voxels(origins, points, *grid)
            free_away(seeded, self.volume, model.config.voxel_m, drive)
            model.occupancy.values.copy_(torch.as_tensor(seeded))
        model.ground.heights.copy_(torch.as_tensor(heights))
        if model.light is not None:
            positions = [_middle(actor)[:3, 3] for actor in appearances.values()]
            model.light.home.copy_(torch.as_tensor(transform_points(into, np.reshape(positions, (-1, 3)))))
        self.known_ground = torch.as_tensor(np.argwhere(known)).float().to(config.device)
        self.occupancy = OccupancyTrainer(self.model.occupancy)
        self.shape = Shape(self.model, self.occupancy, self.known_ground)
        self.unobserved = UnobservedPrior(
            self.model, self.occupancy, self.known_ground, self._still_boxes(drive), torch.as_tensor(points).float()
        )
        self.perceptual = VggLoss(Path(config.vgg)).to(config.device) if config.vgg else perceptual_stand_in
        self.iteration, self.elapsed_s = 0, 0.0
        self.adversary = Adversary(config.device, config.seed) if config.adversarial else None

    @cached_property
    def fingerprint(self) -> Fingerprint:
        """What tells the log's drive again, by the first camera and LiDAR that are trained on. Raises `LogError`."""
        return fingerprint_of(self.log, (*self.config.cameras, "")[0], (*self.lidars, "")[0])

    def _sweep_window(self, captures: list[Capture], actors: Iterable[Actor], voxel_m: float) -> SweepWindow:
        """Sweeps that are too many to be held; those of the first step are under way already."""
        into = invert_pose(self.volume.world_from_volume)
        x, y, z = cells_of(self.volume.size_m, voxel_m)

        def mark(origins: FloatArray, points: FloatArray) -> VoxelEvidence:
            return voxel_evidence(transform_points(into, origins), transform_points(into, points), (x, y, z), voxel_m)

        return SweepWindow(self.log, captures, self.volume.corner, self.config.seed, actors, mark)

    def _is_symmetric(self, label: str) -> bool:
        """Whether a class's two sides look alike: a vehicle's do, a rider's do not."""
        motion = motion_of(label, extras_of(self.log).classes)
        return any(word in label.lower() for word in VEHICLES) and motion not in ("deforming", "still")

    def _still_boxes(self, drive: Drive) -> tuple[Tensor, Tensor] | None:
        still = [a for _, a in sorted(drive.actors.items()) if not a.is_moving]
        if not still:
            return None
        poses = np.stack([_middle(a) for a in still])
        poses[:, :3, 3] -= self.volume.corner
        sizes = np.stack([a.size_m for a in still])
        device = self.config.device
        return torch.as_tensor(poses).float().to(device), torch.as_tensor(sizes).float().to(device)

    def _make_optimiser(self) -> None:
        tables, networks = [], []
        self._sinks: list[tuple[GradientSink, Tensor]] = []
        for module in self.model.modules():
            if isinstance(module, HashTable):
                tables.append(module.table)
                if self.config.device == "cpu":
                    module.sink = GradientSink()
                    self._sinks.append((module.sink, module.table))
        if self.config.device == "cpu":
            self.model.actors.sink = GradientSink()
        appearances = self.model.actors.own()
        known = {id(p) for p in (*tables, *appearances)}
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
            {"params": [self.tracklets.shift_m], "rates": c.rate_shifts, "eps": 1e-10},
            {"params": [self.tracklets.turn_6d], "rates": c.rate_turns, "eps": 1e-10},
            {"params": list(self.camera_poses.parameters()), "rates": c.rate_cameras, "eps": 1e-10},
        ]
        self.optimiser, self.slow = (
            Adam(groups, lr=1e-3, betas=(0.9, 0.99), fused=c.device != "mps") for groups in (fast, slow)
        )
        self._held: tuple[dict[str, Tensor], dict[str, Tensor]] | None = None

    # ---- one step

    @property
    def progress(self) -> float:
        """How much of the training is done, 0 to 1."""
        if self.config.iterations is not None:
            return min(1.0, self.iteration / self.config.iterations)
        assert self.config.minutes is not None
        return min(1.0, self.elapsed_s / (self.config.minutes * 60))

    def _active(self, tables: Tensor, keys: tuple[Tensor, Tensor]) -> ActiveActorTensors:
        uids = tuple(self.model.actor_ids)
        return ActiveActorTensors(ActorSetTensors(self.model, tables, self.tracklets, self.rows, uids, keys))

    def step(self) -> dict[str, float]:
        """Take one batch, update once and return the values of the loss."""
        compiled = self.config.device == "cpu" and native.library() is not None
        # a GPU waits for Python, which starts its work: one branch goes backward while the other goes forward
        together = self.config.device.startswith("cuda") or (compiled and kernel_threads() > 1)
        # a batch's tensors are small: threads lose more on them by waiting for each other than they save, the
        # kernels' apart
        with torch_threads(1 if compiled else None):
            return self._step(together)

    def _step(self, together: bool) -> dict[str, float]:
        w, done = self.recipe.weights, self.progress
        self._set_rates(done)
        deferred = self.deferred()
        for found in self.lidar.advance(self.iteration):
            told = (torch.as_tensor(cells).to(self.config.device) for cells in (found.hit, found.beside, found.passed))
            self.occupancy.add_evidence(*told)
        seen: Future[SegmentTrace] = Future()
        work = [self._camera_branch] + [self._lidar_branch] * bool(self.recipe.uses_lidar or w.unobserved)
        starts = [self._start(number, done, deferred, seen) for number in range(len(work))]
        for sink, _ in self._sinks_of(deferred["tables"]):
            sink.clear()
        branches = run_branches([partial(f, start) for f, start in zip(work, starts, strict=True)], together)
        self._update(starts, deferred["tables"])
        if not self._lidar_follows:
            for branch in branches:
                if branch.traced is not None:
                    self._update_occupancy(branch.traced, camera=branch is branches[0])
        if self.adversary and branches[0].fake is not None:
            self.adversary.update(*branches[0].fake)
        self.iteration += 1
        terms = {name: value for branch in branches for name, value in branch.terms.items()}
        return {
            **terms,
            "loss": sum(terms.values()),
            **{k: v for branch in branches for k, v in branch.metrics.items()},
        }

    def _start(self, number: int, done: float, deferred: dict[str, Tensor], seen: Future[SegmentTrace]) -> _BranchStart:
        # seeded by the iteration: a resumed run draws what an uninterrupted one would
        c, seed = self.config, (self.config.seed * 1_000_003 + self.iteration) * 2 + number
        rng = np.random.default_rng([c.seed, self.iteration, number])
        generator = torch.Generator(device=c.device).manual_seed(seed)
        groups = (*self.optimiser.param_groups, *self.slow.param_groups)
        leaves = [p for group in groups for p in group["params"]] + [deferred["tables"]]
        keys = deferred["positions"], deferred["quaternions"]
        if self.recipe.refines_tracklets and done >= c.poses_from:
            leaves += keys
        else:
            keys = keys[0].detach(), keys[1].detach()
        return _BranchStart(
            done,
            self._active(deferred["tables"], keys),
            deferred["tables"],
            rng,
            generator,
            BranchGradients(leaves),
            seen,
        )

    @property
    def _lidar_follows(self) -> bool:
        """Whether the LiDAR's branch updates the occupancy: it has time to, and no ray of the cameras is
        traced any more."""
        return self.recipe.uses_lidar and self.adversary is None

    def _camera_branch(self, start: _BranchStart) -> _Branch:
        """What the cameras' rays teach. Leaves what they hit as soon as that is known."""
        try:
            return self._camera_terms(start)
        except BaseException as error:
            if not start.seen.done():
                start.seen.set_exception(error)
            raise

    def _camera_terms(self, start: _BranchStart) -> _Branch:
        c, w, done, active, generator = self.config, self.recipe.weights, start.done, start.active, start.generator
        batches, draw = self._draw_pixels(start.rng)
        sampling = self._sampling(start)
        # gradients with respect to the static field's points are dear: most steps go without
        learn_cameras = self.recipe.refines_cameras and done >= c.poses_from and self.iteration % c.slow_every == 0
        batches = [
            dataclasses.replace(b, rays=self.camera_poses(b.rays, b.camera, b.world_from_camera, learn_cameras))
            for b in batches
        ]
        seen = trace(self.model, active, _together([b.rays for b in batches]), sampling)
        start.seen.set_result(seen)
        features = seen.feature.split([len(b.rays) for b in batches])
        images = [self._decode(f, b, generator) for f, b in zip(features, batches, strict=True)]
        wrong = [i - b.target for i, b in zip(images, batches, strict=True)]
        squares = [colour_squares(d, w.chroma) for d in wrong]
        image, patch = images[0], batches[0]
        real = as_shown(patch.target, patch.shown)
        weight = [wrong[0].new_ones(()) for _ in wrong]
        if patch.shown is not None:
            weight[0] = patch.shown
        if draw is not None:
            self.choice.note(draw.block, squares[1].detach().mean((1, 2, 3)).double().cpu().numpy())
            weight[1] = tensor_to(torch.as_tensor(draw.weight).float(), c.device)[:, None, None, None]
        shown = [b.shown for b in batches]
        terms = {"rgb": w.rgb * _mean(squares, weight, shown)}
        if w.distortion:
            terms["distortion"] = w.distortion * distortion(seen)
        if w.perceptual and done >= c.perceptual_from:
            terms["perceptual"] = w.perceptual * self.perceptual(as_shown(image, patch.shown), real)
        fake = None
        if self.adversary and done >= c.poses_from:
            beside = shifted(patch, generator)
            fake = self._decode(trace(self.model, active, beside.rays, sampling).feature, beside, generator)
            fake = as_shown(fake, beside.shown)
            terms["adversarial"] = w.adversarial * self.adversary.generator_loss(fake)
        penalty = self.model.actors.penalty()
        if penalty is not None:
            terms["latent"] = w.latent * penalty
        self._take(start, terms)
        mse = _mean([d.detach().square() for d in wrong], weight, shown)
        metrics = {"psnr": -10 * float(torch.log10(mse.clamp_min(1e-10)))}
        return _Branch(_values(terms), metrics, seen, None if fake is None else (real, fake))

    def _lidar_branch(self, start: _BranchStart) -> _Branch:
        """What beams and places teach. What needs the cameras' rays comes last."""
        c, w, tables, generator = self.config, self.recipe.weights, start.tables, start.generator
        terms: dict[str, Tensor] = {}
        metrics: dict[str, float] = {}
        swept, near = None, None
        if self.recipe.uses_lidar:
            lidar = self._to_device(self.lidar.sample(start.rng, c.lidar_rays))
            swept = trace(self.model, start.active, lidar.rays, self._sampling(start, sky=False))
            terms = self._lidar_loss(swept, lidar)
            if w.sdf_band or w.eikonal or w.normal_smoothness:
                band, near = self.shape.sdf_band(tables, swept, lidar, generator)
                terms["sdf_band"] = w.sdf_band * band
            self._take(start, terms)
            metrics["lidar_m"] = float((swept.volume_depth_m - lidar.depth_m)[lidar.returned].detach().abs().median())
        if w.unobserved and start.done >= c.unobserved_from:
            terms["unobserved"] = w.unobserved * self.unobserved.loss(generator)
            self._take(start, {"unobserved": terms["unobserved"]})
        seen = start.seen.result()
        if swept is not None and near is not None:
            slopes = self.shape.slopes(tables, swept, seen, near, generator)
            slopes = {name: getattr(w, name) * term for name, term in slopes.items()}
            self._take(start, slopes)
            terms |= slopes
        if swept is not None and self._lidar_follows:
            self._update_occupancy(seen, camera=True)
            self._update_occupancy(swept, camera=False)
        return _Branch(_values(terms), metrics, swept, None)

    def _sampling(self, start: _BranchStart, sky: bool = True) -> Sampling:
        still = self._still(start.done) > 0
        fine = self.config.still_samples if still else 1.0
        return Sampling(jitter=not still, fine=fine, sky=sky, mirror=self.mirror, generator=start.generator)

    def _take(self, start: _BranchStart, terms: dict[str, Tensor]) -> None:
        """Have a branch's gradients of the sum of terms, whose graph is then gone."""
        loss = torch.stack(list(terms.values())).sum()
        if not bool(torch.isfinite(loss)):
            bad = [name for name, value in terms.items() if not bool(torch.isfinite(value))]
            raise SceneError(
                f"training diverged at iteration {self.iteration}: {', '.join(bad)} is not a finite number"
            )
        start.gradients.take(loss)

    def _sinks_of(self, tables: Tensor) -> list[tuple[GradientSink, Tensor]]:
        own = self.model.actors.sink
        return self._sinks if own is None else [*self._sinks, (own, tables)]

    def _update(self, starts: list[_BranchStart], tables: Tensor) -> None:
        """Add the branches' gradients up, in their order, and update what they are of; ``tables`` are the actors'."""
        with torch_threads(None):
            self.optimiser.zero_grad(set_to_none=False)
        for start in starts:
            start.gradients.add()
        for sink, table in self._sinks_of(tables):
            if table.grad is None:
                table.grad = zeros_on_demand(table.shape)
            sink.pour(table.grad)
        with torch_threads(None):
            self.optimiser.step()
        with torch.no_grad():
            self.model.log_beta.clamp_(max=math.log(BETA_MAX))
        if (self.iteration + 1) % self.config.slow_every == 0:
            with torch_threads(None):
                self._update_slow()

    def deferred(self) -> dict[str, Tensor]:
        """What the slow parameters make, as it stands between two slow updates: every actor's grid (``tables``), the
        tracklets' keys (``positions``, ``quaternions``). Their gradients, of many encodings and steps, are added up."""
        if self._held is None:
            with torch_threads(None):
                positions, quaternions = self.tracklets.keys()
                made = {"tables": self.model.actors.tables(), "positions": positions, "quaternions": quaternions}
            cut = {name: value.detach().requires_grad_() for name, value in made.items()}
            # of a long drive's actors a few steps hit few
            cut["tables"].grad = zeros_on_demand(made["tables"].shape, device=made["tables"].device)
            self._held = made, cut
        return self._held[1]

    def _update_slow(self) -> None:
        assert self._held is not None
        made, cut = self._held
        for name, value in made.items():
            if cut[name].grad is not None:
                value.backward(cut[name].grad)
        self.slow.step()
        self.slow.zero_grad()
        self._held = None

    def deferred_gradients(self) -> dict[str, Tensor]:
        """What has been added up since the last slow update, by name."""
        parameters = [p for group in self.slow.param_groups for p in group["params"]]
        named = {str(i): p for i, p in enumerate(parameters)} | (self._held[1] if self._held is not None else {})
        return {name: tensor.grad for name, tensor in named.items() if tensor.grad is not None}

    def load_deferred_gradients(self, deferred: dict[str, Tensor]) -> None:
        """The inverse of `deferred_gradients`."""
        parameters = [p for group in self.slow.param_groups for p in group["params"]]
        self._held = None
        for name, value in deferred.items():
            parameter = parameters[int(name)] if name.isdigit() else self.deferred()[name]
            parameter.grad = value.to(parameter.device)

    def _still(self, done: float) -> float:
        """How much of the part in which samples stand still is done, 0 to 1: 0 until it begins."""
        begin = self.config.still_from
        return max(0.0, done - begin) / (1 - begin) if begin < 1 else 0.0

    def _set_rates(self, done: float) -> None:
        for group in (*self.optimiser.param_groups, *self.slow.param_groups):
            first, last = group["rates"]
            warm = min(1.0, (self.iteration + 1) / 100)
            group["lr"] = warm * first * (last / first) ** done * LAST_RATE ** self._still(done)

    def _draw_pixels(self, rng: np.random.Generator) -> tuple[list[PatchBatch], Draw | None]:
        """Patches, then as many single cells as the patches that were taken apart held, drawn by their errors."""
        c, up = self.config, self.model.config.upsample
        apart = min(round(c.patches * c.scattered), c.patches - 1) if self.model.camera_decoder.reach == 0 else 0
        self.cameras.advance(self.iteration)
        batches, draw = [self.cameras.patches(rng, c.patches - apart, c.patch_cells, up)], None
        if apart:
            draw = self.choice.draw(rng, apart * c.patch_cells**2, self.cameras.images.drawable)
            batches.append(self.cameras.pixels(draw, up))
        return [self._to_device(b) for b in batches], draw

    def _decode(self, feature: Tensor, patch: PatchBatch, generator: torch.Generator) -> Tensor:
        cells, directions = patch.cells, patch.rays.directions
        camera = patch.camera.repeat_interleave(cells * cells)
        # a patch turns as one, for it is looked at as one
        turn = torch.randn(len(patch.camera), 3, generator=generator, device=directions.device) * self.config.turned_rad
        turned = directions + torch.linalg.cross(turn.repeat_interleave(cells * cells, 0), directions)
        features = self.model.ray_head(feature, F.normalize(turned, dim=-1), camera)
        features = features.view(len(patch.camera), cells, cells, -1).permute(0, 3, 1, 2)
        image: Tensor = self.model.camera_decoder(features)
        return image

    def _lidar_loss(self, swept: SegmentTrace, lidar: LidarBatch) -> dict[str, Tensor]:
        w = self.recipe.weights
        end = self.model.frame.points(lidar.rays.origins + lidar.rays.directions * lidar.depth_m[:, None])
        terms, good = lidar_terms(swept, lidar, self.model.frame.inside(end))
        intensity, logit = self.model.lidar_head(swept.feature, lidar.rays.directions, swept.depth_m, swept.opacity)
        return {
            **{name: getattr(w, f"lidar_{name}") * terms[name] for name in terms if getattr(w, f"lidar_{name}")},
            "intensity": w.lidar_intensity * F.mse_loss(intensity[good], lidar.intensity[good]),
            "drop": w.lidar_drop * F.binary_cross_entropy_with_logits(logit, lidar.returned.float(), lidar.weight),
        }

    @torch.no_grad()
    def _update_occupancy(self, traced: SegmentTrace, camera: bool) -> None:
        if traced.static is None:
            return
        segments, weights = traced.static
        self.occupancy.update(
            segments.points.reshape(-1, 3), weights.samples.flatten(), weights.transmittance_before.flatten(),
            prune=self.iteration >= self.config.prune_from, settled=self.progress >= self.config.settled_from,
            camera=camera,
        )  # fmt: skip
        if self.progress >= _STOPPED_FROM and segments.density == "logistic":
            self.occupancy.note_stopped(segments.points, weights.samples, weights.transmittance_before)

    def _to_device(self, batch: Any) -> Any:
        device = self.config.device

        def move(value: Any) -> Any:
            if isinstance(value, Tensor):
                return tensor_to(value, device)
            if dataclasses.is_dataclass(value) and not isinstance(value, type):
                return dataclasses.replace(
                    value, **{f.name: move(getattr(value, f.name)) for f in dataclasses.fields(value)}
                )
            return value

        return move(batch)


def _values(terms: dict[str, Tensor]) -> dict[str, float]:
    return {name: float(value.detach()) for name, value in terms.items()}


def _mean(parts: list[Tensor], weight: list[Tensor], shown: list[Tensor | None]) -> Tensor:
    """Mean over all numbers of all parts (B, C, H, W), less those that are not ``shown`` (B, 1, H, W); each part's counting by
    its weight."""
    total = torch.stack([(p * w).sum() for p, w in zip(parts, weight, strict=True)]).sum()
    counts = [p.numel() if s is None else s.sum() * p.shape[1] for p, s in zip(parts, shown, strict=True)]
    return total / sum(counts)


def _together(parts: list[RayBatch]) -> RayBatch:
    return RayBatch(*(torch.cat([getattr(p, name) for p in parts]) for name in ("origins", "directions", "time_s")))


def _middle(actor: Actor) -> FloatArray:
    """An actor's pose (4, 4) in the middle of its time."""
    return actor.world_from_actor.at((actor.start_s + actor.end_s) / 2)
