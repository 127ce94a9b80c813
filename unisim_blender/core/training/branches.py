"""The loss of a step in two branches, the cameras' and the LiDAR's, which run in parallel where that is faster.

Their graphs share only leaves, so each goes forward and backward in its own thread.
"""

from __future__ import annotations

import contextvars
import dataclasses
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ..errors import SceneError
from ..ops.devices import tensor_to
from ..ops.encode import as_branch
from ..ops.padding import Padding, masked_mean, masked_quantile
from ..ops.ray_segments import RayBatch
from ..ops.segment_trace import SegmentTrace
from ..render.tracers.torch.actor_tensors import ActiveActorTensors
from ..render.tracers.torch.segments import Sampling, only
from ..render.tracers.torch.trace import trace
from .batches.data import PatchBatch
from .batches.images import PixelDraw
from .batches.sweeps import LidarBatch
from .losses.terms import as_shown, colour_squares, distortion, exposed, lidar_terms, shifted_patches
from .setup import TrainingSetup

T = TypeVar("T")


def run_branches(branches: Sequence[Callable[[], T]], together: bool) -> list[T]:
    """Return each branch's result; ``together`` runs them at once, else one comes after the other.

    A branch may wait for what one before it leaves, none for one behind it. Of errors the first branch's is raised,
    when all have ended.
    """
    threads = torch.get_num_threads()
    results: list[T | BaseException | None] = [None] * len(branches)

    def work(number: int) -> None:
        try:
            # of its own accord a new thread takes all cores in some of torch's libraries
            torch.set_num_threads(threads)
            with as_branch(number):
                results[number] = branches[number]()
        except BaseException as error:  # noqa: BLE001
            results[number] = error

    others = []
    for number in range(1, len(branches) if together else 1):
        thread = threading.Thread(target=contextvars.copy_context().run, args=(work, number))
        thread.start()
        others.append(thread)
    for number in range(1 if together else len(branches)):
        work(number)
    for thread in others:
        thread.join()
    out: list[T] = []
    for result in results:
        if isinstance(result, BaseException):
            raise result
        out.append(result)  # type: ignore[arg-type]
    return out


class BranchGradients:
    """Gradients of a branch's terms with respect to some leaves, apart from the leaves' own until they are added to
    these."""

    def __init__(self, leaves: Sequence[Tensor]) -> None:
        self.leaves = leaves
        self._own: list[Tensor | None] = [None] * len(leaves)

    def take(self, loss: Tensor) -> None:
        """Go backward from a loss, whose graph is then gone."""
        if not loss.requires_grad:
            return
        parts = torch.autograd.grad(loss, self.leaves, allow_unused=True)
        pairs = zip(self._own, parts, strict=True)
        self._own = [new if old is None else old if new is None else old + new for old, new in pairs]

    def add(self) -> None:
        """Add them to the leaves' own."""
        for leaf, gradient in zip(self.leaves, self._own, strict=True):
            if gradient is None:
                continue
            if leaf.grad is None:
                leaf.grad = gradient.clone(memory_format=torch.preserve_format)
            else:
                leaf.grad.add_(gradient)


STOPPED_FROM = 0.8
"""From this progress on surfaces are sharp, and how much of a ray stops in a voxel tells a surface from haze."""


@dataclass(frozen=True)
class BranchStart:
    """Inputs of a branch of a step: the iteration, the training's progress (0 to 1) and whether samples stand still by
    now, the active actors, whose actors have these ``tables``, random numbers and gradients of its own, and the trace
    of the cameras' rays, once it is known."""

    iteration: int
    done: float
    annealed: bool
    active: ActiveActorTensors
    tables: Tensor
    rng: np.random.Generator
    generator: torch.Generator | None
    gradients: BranchGradients
    seen: Future[SegmentTrace]
    padding: Padding | None = None
    """Where shapes must not depend on values: the lengths that ray segments are padded to."""


@dataclass(frozen=True)
class BranchResult:
    """Result of a branch of a step: the values of its terms, metrics, the trace of its rays, recorded and made-up
    images."""

    terms: dict[str, float]
    metrics: dict[str, float]
    traced: SegmentTrace | None
    fake: tuple[Tensor, Tensor] | None


@dataclass(frozen=True)
class CameraTerms:
    """Terms of the cameras' rays: PSNR () in dB, mean squared errors (N,) of the last batch's cells, recorded and made-up
    images."""

    terms: dict[str, Tensor]
    psnr: Tensor
    errors: Tensor
    fake: tuple[Tensor, Tensor] | None


@dataclass(frozen=True)
class SweptTerms:
    """Terms of LiDAR beams: their trace, points (N, 3) and which of them (N,) are near returns, and the median error () of
    their depths, metres."""

    terms: dict[str, Tensor]
    traced: SegmentTrace
    near: tuple[Tensor, Tensor] | None
    error_m: Tensor


class LossBranches:
    """Evaluates the branches of a step and takes their gradients."""

    def __init__(self, setup: TrainingSetup) -> None:
        self.setup = setup

    @property
    def lidar_follows(self) -> bool:
        """Whether the LiDAR's branch updates the occupancy: it has time to, and no ray of the cameras is
        traced any more."""
        setup = self.setup
        return setup.recipe.uses_lidar and setup.adversary is None

    def camera(self, start: BranchStart) -> BranchResult:
        """Evaluate the terms of the cameras' rays. Publishes their trace as soon as it is known."""
        try:
            return self._camera_terms(start)
        except BaseException as error:
            if not start.seen.done():
                start.seen.set_exception(error)
            raise

    def _camera_terms(self, start: BranchStart) -> BranchResult:
        batches, draw = self.draw_pixels(start.rng, start.iteration)
        weight = None
        if draw is not None:
            weight = tensor_to(torch.as_tensor(draw.weight).float(), self.setup.config.device)
        batches, seen = self.seen(start, batches)
        start.seen.set_result(seen)
        found = self.camera_terms(start, batches, seen, weight)
        if draw is not None:
            self.setup.choice.note(draw.block, found.errors.double().cpu().numpy())
        self._backward(start, found.terms)
        return BranchResult(_values(found.terms), {"psnr": float(found.psnr)}, seen, found.fake)

    def seen(self, start: BranchStart, batches: list[PatchBatch]) -> tuple[list[PatchBatch], SegmentTrace]:
        """Return the batches with their rays where the cameras are by now, and the trace of all their rays."""
        setup = self.setup
        # gradients with respect to the static field's points are dear: most steps go without
        learn = (
            setup.recipe.refines_cameras
            and start.done >= setup.config.poses_from
            and start.iteration % setup.config.slow_every == 0
        )
        batches = [
            dataclasses.replace(b, rays=setup.camera_poses(b.rays, b.camera, b.world_from_camera, learn))
            for b in batches
        ]
        members = ("origins", "directions", "time_s")
        rays = RayBatch(*(torch.cat([getattr(batch.rays, name) for batch in batches]) for name in members))
        return batches, trace(setup.model, start.active, rays, self._sampling(start))

    def camera_terms(
        self, start: BranchStart, batches: list[PatchBatch], seen: SegmentTrace, drawn_weight: Tensor | None
    ) -> CameraTerms:
        """Return the terms of the cameras' rays. ``drawn_weight`` (N,) are the weights of the second batch's pixels."""
        setup = self.setup
        c, w = setup.config, setup.recipe.weights
        done, generator = start.done, start.generator
        features = seen.feature.split([len(b.rays) for b in batches])
        images = [self._decode(f, b, start) for f, b in zip(features, batches, strict=True)]
        wrong = [i - b.target for i, b in zip(images, batches, strict=True)]
        squares = [colour_squares(d, w.chroma) for d in wrong]
        image, patch = images[0], batches[0]
        real = as_shown(patch.target, patch.shown)
        weight = [wrong[0].new_ones(()) for _ in wrong]
        if patch.shown is not None:
            weight[0] = patch.shown
        if drawn_weight is not None:
            weight[1] = drawn_weight[:, None, None, None]
        shown = [b.shown for b in batches]
        terms = {"rgb": w.rgb * _mean(squares, weight, shown)}
        if w.distortion:
            terms["distortion"] = w.distortion * distortion(seen)
        if w.perceptual and done >= c.perceptual_from:
            terms["perceptual"] = w.perceptual * setup.perceptual(as_shown(image, patch.shown), real)
        fake = None
        if setup.adversary and done >= c.poses_from:
            beside = shifted_patches(patch, generator)
            traced = trace(setup.model, start.active, beside.rays, self._sampling(start))
            fake = as_shown(self._decode(traced.feature, beside, start), beside.shown)
            terms["adversarial"] = w.adversarial * setup.adversary.generator_loss(fake)
        if self._exposes(start):
            terms["exposure"] = w.exposure * setup.log_gains.square().mean()
        penalty = setup.model.actors.penalty()
        if penalty is not None:
            terms["latent"] = w.latent * penalty
        mse = _mean([d.detach().square() for d in wrong], weight, shown)
        return CameraTerms(
            terms,
            -10 * torch.log10(mse.clamp_min(1e-10)),
            squares[-1].detach().mean((1, 2, 3)),
            None if fake is None else (real, fake),
        )

    def lidar(self, start: BranchStart) -> BranchResult:
        """Evaluate the terms of LiDAR beams and of unobserved places. Terms that need the trace of the cameras' rays
        come last."""
        setup = self.setup
        terms: dict[str, Tensor] = {}
        metrics: dict[str, float] = {}
        swept = None
        if setup.recipe.uses_lidar:
            lidar = self._to_device(setup.lidar.sample(start.rng, setup.config.lidar_rays))
            swept = self.swept(start, lidar)
            terms = swept.terms
            self._backward(start, terms)
            metrics["lidar_m"] = float(swept.error_m)
        # these two take turns, at twice their weights
        even = start.iteration % 2 == 0
        unobserved = {} if even else _twice(self.unobserved(start))
        if unobserved:
            self._backward(start, unobserved)
        seen = start.seen.result()
        slopes = _twice(self.slopes(start, swept, seen)) if even and swept is not None else {}
        if slopes:
            self._backward(start, slopes)
        if swept is not None and self.lidar_follows:
            self.update_occupancy(start, seen, camera=True)
            self.update_occupancy(start, swept.traced, camera=False)
        values = _values({**terms, **unobserved, **slopes})
        return BranchResult(values, metrics, None if swept is None else swept.traced, None)

    def swept(self, start: BranchStart, lidar: LidarBatch) -> SweptTerms:
        """Return the terms of LiDAR beams."""
        setup, w = self.setup, self.setup.recipe.weights
        traced, near = trace(setup.model, start.active, lidar.rays, self._sampling(start, sky=False)), None
        terms = self._lidar_loss(traced, lidar)
        if w.sdf_band or w.eikonal or w.normal_smoothness:
            band, near = setup.shape.sdf_band(start.tables, traced, lidar, start.generator)
            terms["sdf_band"] = w.sdf_band * band
        wrong = (traced.volume_depth_m - lidar.depth_m).detach().abs()
        return SweptTerms(terms, traced, near, masked_quantile(wrong, lidar.returned, 0.5))

    def unobserved(self, start: BranchStart) -> dict[str, Tensor]:
        """Return the term of unobserved places; none before it joins in."""
        setup, weight = self.setup, self.setup.recipe.weights.unobserved
        if not weight or start.done < setup.config.unobserved_from:
            return {}
        return {"unobserved": weight * setup.unobserved.loss(start.generator)}

    def slopes(self, start: BranchStart, swept: SweptTerms, seen: SegmentTrace) -> dict[str, Tensor]:
        """Return the terms of distances' slopes, at places of beams and of the cameras' rays."""
        if swept.near is None:
            return {}
        slopes = self.setup.shape.slopes(start.tables, swept.traced, seen, swept.near, start.generator)
        return {name: getattr(self.setup.recipe.weights, name) * term for name, term in slopes.items()}

    def _sampling(self, start: BranchStart, sky: bool = True) -> Sampling:
        setup = self.setup
        fine = setup.config.still_samples if start.annealed else 1.0
        return Sampling(jitter=not start.annealed, fine=fine, sky=sky, mirror=setup.mirror, generator=start.generator,
                        padding=start.padding)  # fmt: skip

    def _backward(self, start: BranchStart, terms: dict[str, Tensor]) -> None:
        """Take the gradients of the sum of terms, whose graph is then freed. Raises `SceneError` for one that is not
        finite."""
        loss = torch.stack(list(terms.values())).sum()
        if not bool(torch.isfinite(loss)):
            bad = [name for name, value in terms.items() if not bool(torch.isfinite(value))]
            raise SceneError(
                f"training diverged at iteration {start.iteration}: {', '.join(bad)} is not a finite number"
            )
        start.gradients.take(loss)

    def terms(
        self, start: BranchStart, batches: list[PatchBatch], weight: Tensor | None, beams: LidarBatch | None
    ) -> tuple[dict[str, Tensor], dict[str, Tensor], Tensor, list[SegmentTrace]]:
        """Return what both branches give in one graph: the terms of the loss, metrics, the last batch's squared errors
        (N,), and the traces of the cameras' rays and of beams. ``weight`` is that of `camera_terms`."""
        batches, seen = self.seen(start, batches)
        camera = self.camera_terms(start, batches, seen, weight)
        terms, metrics, traced = dict(camera.terms), {"psnr": camera.psnr}, [seen]
        swept = None if beams is None else self.swept(start, beams)
        if swept is not None:
            terms, traced = {**terms, **swept.terms}, [*traced, swept.traced]
            metrics["lidar_m"] = swept.error_m
        terms.update(self.unobserved(start))
        if swept is not None:
            terms.update(self.slopes(start, swept, seen))
        return terms, metrics, camera.errors, traced

    def patches_apart(self) -> int:
        """Return the number of patches that are taken apart, a ray here and a ray there: see `TrainConfig.scattered`."""
        c = self.setup.config
        alone = self.setup.model.camera_decoder.reach == 0
        return min(round(c.patches * c.scattered), c.patches - 1) if alone else 0

    def draw_pixels(self, rng: np.random.Generator, iteration: int) -> tuple[list[PatchBatch], PixelDraw | None]:
        """Patches, then as many single cells as the patches that were taken apart held, drawn by their errors."""
        setup, apart = self.setup, self.patches_apart()
        c, up = setup.config, setup.model.config.upsample
        setup.cameras.advance(iteration)
        batches, draw = [setup.cameras.patches(rng, c.patches - apart, c.patch_cells, up)], None
        if apart:
            draw = setup.choice.draw(rng, apart * c.patch_cells**2, setup.cameras.images.drawable)
            batches.append(setup.cameras.pixels(draw, up))
        return [self._to_device(b) for b in batches], draw

    def _exposes(self, start: BranchStart) -> bool:
        """Whether images have gains of their own by now: first the colours settle that they have in common."""
        return self.setup.recipe.refines_cameras and start.done >= self.setup.config.perceptual_from

    def _decode(self, feature: Tensor, patch: PatchBatch, start: BranchStart) -> Tensor:
        setup, generator = self.setup, start.generator
        cells, directions = patch.cells, patch.rays.directions
        camera = patch.camera.repeat_interleave(cells * cells)
        # a patch turns as one, for it is looked at as one
        turn = (
            torch.randn(len(patch.camera), 3, generator=generator, device=directions.device) * setup.config.turned_rad
        )
        turned = directions + torch.linalg.cross(turn.repeat_interleave(cells * cells, 0), directions)
        features = setup.model.ray_head(feature, F.normalize(turned, dim=-1), camera)
        features = features.view(len(patch.camera), cells, cells, -1).permute(0, 3, 1, 2)
        image: Tensor = setup.model.camera_decoder(features)
        return exposed(image, setup.log_gains[patch.view], patch.target) if self._exposes(start) else image

    def _lidar_loss(self, swept: SegmentTrace, lidar: LidarBatch) -> dict[str, Tensor]:
        setup = self.setup
        w = setup.recipe.weights
        end = setup.model.frame.points(lidar.rays.origins + lidar.rays.directions * lidar.depth_m[:, None])
        terms, good = lidar_terms(swept, lidar, setup.model.frame.inside(end))
        intensity, logit = setup.model.lidar_head(swept.feature, lidar.rays.directions, swept.depth_m, swept.opacity)
        return {
            **{name: getattr(w, f"lidar_{name}") * terms[name] for name in terms if getattr(w, f"lidar_{name}")},
            "intensity": w.lidar_intensity * masked_mean((intensity - lidar.intensity).square(), good),
            "drop": w.lidar_drop * F.binary_cross_entropy_with_logits(logit, lidar.returned.float(), lidar.weight),
        }

    @torch.no_grad()
    def update_occupancy(self, start: BranchStart, traced: SegmentTrace, camera: bool) -> None:
        """Tell the occupancy where rays of the cameras, or of the LiDAR, stop and pass."""
        setup = self.setup
        if traced.static is None:
            return
        segments, weights = traced.static
        setup.occupancy.update(
            segments.points.reshape(-1, 3), weights.samples.flatten(), weights.transmittance_before.flatten(),
            prune=start.iteration >= setup.config.prune_from, settled=start.done >= setup.config.settled_from,
            camera=camera,
            there=None if segments.there is None else segments.there.repeat_interleave(segments.t.shape[1]),
        )  # fmt: skip
        if start.done >= STOPPED_FROM and segments.density == "logistic":
            before = only(segments.there, weights.transmittance_before)
            setup.occupancy.note_stopped(segments.points, weights.samples, before)

    def _to_device(self, batch: Any) -> Any:
        device = self.setup.config.device

        def move(value: Any) -> Any:
            if isinstance(value, Tensor):
                return tensor_to(value, device)
            if dataclasses.is_dataclass(value) and not isinstance(value, type):
                return dataclasses.replace(
                    value, **{f.name: move(getattr(value, f.name)) for f in dataclasses.fields(value)}
                )
            return value

        return move(batch)


def _twice(terms: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: 2 * value for name, value in terms.items()}


def _values(terms: dict[str, Tensor]) -> dict[str, float]:
    return {name: float(value.detach()) for name, value in terms.items()}


def _mean(parts: list[Tensor], weight: list[Tensor], shown: list[Tensor | None]) -> Tensor:
    """Mean over all numbers of all parts (B, C, H, W), less those that are not ``shown`` (B, 1, H, W); each part's counting by
    its weight."""
    total = torch.stack([(p * w).sum() for p, w in zip(parts, weight, strict=True)]).sum()
    counts = [p.numel() if s is None else s.sum() * p.shape[1] for p, s in zip(parts, shown, strict=True)]
    return total / sum(counts)
