"""A step of training: one batch, the gradients of its loss, one update of the parameters."""

from __future__ import annotations

import math
from concurrent.futures import Future
from functools import partial

import numpy as np
import torch
from torch import Tensor

from .. import native
from ..data.log import Log
from ..ops.devices import kernel_threads, torch_threads, zeros_on_demand
from ..ops.encode import GradientSink
from ..ops.mlp import in_bfloat16
from ..ops.padding import Padding
from ..ops.segment_trace import SegmentTrace
from ..render.tracers.torch.actor_tensors import ActiveActorTensors, ActorSetTensors
from .branches import BranchGradients, BranchStart, LossBranches, run_branches
from .config import TrainConfig
from .setup import CompiledAdam, TrainingSetup

BETA_MAX_LOG = math.log(100.0)
"""Logarithm of the largest sharpness, 1 / metres: a sharper surface is far thinner than the finest cell, and no gradient
comes from beside it."""
LAST_RATE = 0.1
"""Factor on the learning rates at the end of training, reached gradually once samples stand still."""


class Trainer(TrainingSetup):
    """Trains one scene on one log."""

    padding: Padding | None = None
    """Lengths that a step's ray segments are padded to, where the host decides nothing; random numbers are then torch's
    own of the device."""

    def __init__(self, log: Log, config: TrainConfig) -> None:
        super().__init__(log, config)
        self.branches = LossBranches(self)
        self.iteration, self.elapsed_s = 0, 0.0

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
        for evidence in self.lidar.advance(self.iteration):
            cells = (evidence.hit, evidence.beside, evidence.passed)
            self.occupancy.add_evidence(*(torch.as_tensor(c).to(self.config.device) for c in cells))
        seen: Future[SegmentTrace] = Future()
        branches = self.branches
        work = [branches.camera] + [branches.lidar] * bool(self.recipe.uses_lidar or w.unobserved)
        starts = [self._start(number, done, deferred, seen) for number in range(len(work))]
        for sink, _ in self._sinks_of(deferred["tables"]):
            sink.clear()
        with in_bfloat16(self.recipe.bfloat16):
            results = run_branches([partial(f, start) for f, start in zip(work, starts, strict=True)], together)
        self._update(starts, deferred["tables"])
        if not branches.lidar_follows:
            for start, result in zip(starts, results, strict=True):
                if result.traced is not None:
                    branches.update_occupancy(start, result.traced, camera=result is results[0])
        if self.adversary and results[0].fake is not None:
            self.adversary.update(*results[0].fake)
        self.iteration += 1
        terms = {name: value for result in results for name, value in result.terms.items()}
        return {
            **terms,
            "loss": sum(terms.values()),
            **{name: value for result in results for name, value in result.metrics.items()},
        }

    def _start(self, number: int, done: float, deferred: dict[str, Tensor], seen: Future[SegmentTrace]) -> BranchStart:
        # seeded by the iteration: a resumed run draws what an uninterrupted one would
        c, seed = self.config, (self.config.seed * 1_000_003 + self.iteration) * 2 + number
        rng = np.random.default_rng([c.seed, self.iteration, number])
        generator = None if self.padding else torch.Generator(device=c.device).manual_seed(seed)
        groups = (*self.optimiser.param_groups, *self.slow.param_groups)
        leaves = [p for group in groups for p in group["params"]] + [deferred["tables"]]
        keys = deferred["positions"], deferred["quaternions"]
        if self.recipe.refines_tracklets and done >= c.poses_from:
            leaves += keys
        else:
            keys = keys[0].detach(), keys[1].detach()
        return BranchStart(
            self.iteration,
            done,
            self._anneal(done) > 0,
            self._active(deferred["tables"], keys),
            deferred["tables"],
            rng,
            generator,
            BranchGradients(leaves),
            seen,
            self.padding,
        )

    def _sinks_of(self, tables: Tensor) -> list[tuple[GradientSink, Tensor]]:
        own = self.model.actors.sink
        return self.sinks if own is None else [*self.sinks, (own, tables)]

    def _pour(self, tables: Tensor) -> None:
        """Add the tables' gradients from their sinks; ``tables`` are the actors'."""
        for sink, table in self._sinks_of(tables):
            if table.grad is None:
                table.grad = zeros_on_demand(table.shape, device=table.device)
            sink.pour(table.grad)

    def _update(self, starts: list[BranchStart], tables: Tensor) -> None:
        """Add the branches' gradients up, in their order, and update what they are of; ``tables`` are the actors'."""
        if not isinstance(self.optimiser, CompiledAdam):
            with torch_threads(None):
                self.optimiser.zero_grad(set_to_none=False)
        for start in starts:
            start.gradients.add()
        self._pour(tables)
        with torch_threads(None):
            self.optimiser.step()
        with torch.no_grad():
            self.model.log_beta.clamp_(max=BETA_MAX_LOG)
        if (self.iteration + 1) % self.config.slow_every == 0:
            with torch_threads(None):
                self._update_slow()

    def _update_slow(self) -> None:
        assert self._deferred is not None
        outputs, cut = self._deferred
        for name, value in outputs.items():
            if cut[name].grad is not None:
                value.backward(cut[name].grad)
        self.slow.step()
        self.slow.zero_grad()
        self._deferred = None

    def deferred_gradients(self) -> dict[str, Tensor]:
        """Return the gradients accumulated since the last slow update, by name."""
        parameters = [p for group in self.slow.param_groups for p in group["params"]]
        named = {str(i): p for i, p in enumerate(parameters)} | (
            self._deferred[1] if self._deferred is not None else {}
        )
        return {name: tensor.grad for name, tensor in named.items() if tensor.grad is not None}

    def load_deferred_gradients(self, deferred: dict[str, Tensor]) -> None:
        parameters = [p for group in self.slow.param_groups for p in group["params"]]
        self._deferred = None
        for name, value in deferred.items():
            parameter = parameters[int(name)] if name.isdigit() else self.deferred()[name]
            parameter.grad = value.to(parameter.device)

    def _anneal(self, done: float) -> float:
        """How much of the part in which samples stand still is done, 0 to 1: 0 until it begins."""
        begin = self.config.still_from
        return max(0.0, done - begin) / (1 - begin) if begin < 1 else 0.0

    def _set_rates(self, done: float) -> None:
        for group in (*self.optimiser.param_groups, *self.slow.param_groups):
            first, last = group["rates"]
            warm = min(1.0, (self.iteration + 1) / 100)
            rate = self.rate_factor * warm * first * (last / first) ** done * LAST_RATE ** self._anneal(done)
            if isinstance(group["lr"], Tensor):
                group["lr"].fill_(rate)
            else:
                group["lr"] = rate
