"""Training steps on a GPU without decisions on the host: data and random numbers are the device's, shapes depend on no
value, and what a phase of the training does is captured once as a graph of operations and replayed.

A value is read every `READ_EVERY` steps.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor

from ..data.log import Log
from ..errors import SceneError
from ..ops.mlp import in_bfloat16
from ..ops.padding import Padding
from .batches.data import LidarData, PatchBatch
from .batches.images import LoadedImages
from .batches.on_device import DeviceImages, DeviceSweeps, device_bytes
from .batches.sweeps import LidarBatch
from .branches import STOPPED_FROM
from .config import TrainConfig
from .trainer import BETA_MAX_LOG, Trainer

READ_EVERY = 10
"""Steps from one reading of the loss to the next."""
HITS_PER_RAY, MORE_HITS = 1.0, 1.5
"""Hits of boxes for which a step has room, on average for each ray; and how many times as many once there were more."""
MEMORY_SHARE = 0.5
"""Largest share of a device's free memory that the data may take."""


def make_trainer(log: Log, config: TrainConfig) -> Trainer:
    """Return a trainer: on CUDA one whose steps wait for no value."""
    return (DeviceTrainer if config.device.startswith("cuda") else Trainer)(log, config)


class OperationsGraph:
    """A function of no arguments, called as it is at first, then captured as a CUDA graph, whose memory is of ``pool``, and
    replayed; without a pool, on other devices, it is called as it is."""

    def __init__(self, function: Callable[[], None], pool: Any) -> None:
        self._function, self._pool, self._calls = function, pool, 0
        self._graph: Any = None

    def __call__(self) -> None:
        """Do what the function does."""
        self._calls += 1
        if self._pool is not None and self._calls == 2:
            self._graph = torch.cuda.CUDAGraph()
            with torch.cuda.graph(self._graph, pool=self._pool, stream=torch.cuda.current_stream()):
                self._function()
        if self._graph is None:
            self._function()
        else:
            self._graph.replay()


class DeviceTrainer(Trainer):
    """Trains with all data on the device, where it has the memory; else as `Trainer` does, and says in one sentence why."""

    def __init__(self, log: Log, config: TrainConfig) -> None:
        super().__init__(log, config)
        self._at, self._graphs = torch.device(config.device), dict[tuple[bool, ...], OperationsGraph]()
        self._data: tuple[DeviceImages, DeviceSweeps | None] | None = None
        self._stream = torch.cuda.Stream(self._at) if self._at.type == "cuda" else None
        self._pool = torch.cuda.graph_pool_handle() if self._stream else None
        self._sums: dict[str, Tensor] = {}
        why = self.unsuited()
        if why is None:
            self.padding = Padding(HITS_PER_RAY, torch.zeros((), dtype=torch.long, device=self._at))
            self.shape.padded = True
        else:
            print(f"steps on {config.device} are led by the host, which takes longer: {why}", file=sys.stderr)

    def unsuited(self) -> str | None:
        """Return why the log or the options need the host's decisions, None where they do not."""
        if self.adversary is not None:
            return "the adversarial term has an optimiser of its own"
        if not isinstance(self.cameras.images, LoadedImages) or not isinstance(self.lidar, LidarData):
            return "the drive is too long for its images and sweeps to be in memory"
        if self._at.type == "cuda":
            need, free = device_bytes(self.cameras, self.lidar), torch.cuda.mem_get_info(self._at)[0]
            if need > MEMORY_SHARE * free:
                return f"its images and sweeps take {need / 2**30:.1f} GiB, and {free / 2**30:.1f} GiB are free there"
        return None

    def step(self) -> dict[str, float]:
        """Take one batch and update once; return the mean values since they were read, none between two readings."""
        if self.padding is None:
            return super().step()
        done, config = self.progress, self.config
        with self._alone():
            self._set_rates(done)
            # a resumed run draws what an uninterrupted one would
            torch.manual_seed((config.seed * 1_000_003 + self.iteration) * 2)
            phase = self._phase(done)
            if phase not in self._graphs:
                self._graphs[phase] = OperationsGraph(lambda: self._once(done, phase[-1]), self._pool)
            self._graphs[phase]()
            self.iteration += 1
            return self._read() if self.iteration % READ_EVERY == 0 or self.progress >= 1 else {}

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """Work in a stream of its own, as graphs must be captured, after what was begun before and before what follows."""
        if self._stream is None:
            yield
            return
        self._stream.wait_stream(torch.cuda.current_stream(self._at))
        with torch.cuda.stream(self._stream):
            yield
        torch.cuda.current_stream(self._at).wait_stream(self._stream)

    def _phase(self, done: float) -> tuple[bool, ...]:
        """What a step's operations depend on; last, whether the slow parameters are updated."""
        c, i = self.config, self.iteration
        begins = (c.perceptual_from, c.poses_from, c.unobserved_from, c.settled_from, c.still_from, STOPPED_FROM)
        slow = (i + 1) % c.slow_every == 0
        return (
            *(done >= begin for begin in begins),
            self._anneal(done) > 0,
            i >= c.prune_from,
            i % c.slow_every == 0,
            slow,
        )

    def draw(self) -> tuple[list[PatchBatch], tuple[Tensor, Tensor] | None, LidarBatch | None]:
        """Return patches and single cells of the images, the single cells' blocks and weights (N,), and beams."""
        c, up = self.config, self.model.config.upsample
        if self._data is None:
            sweeps = DeviceSweeps(self.lidar, c.device) if self.recipe.uses_lidar else None  # type: ignore[arg-type]
            self._data = DeviceImages(self.cameras, self.choice, c.patch_cells, up, c.device), sweeps
        images, sweeps = self._data
        apart, blocks = self.branches.patches_apart(), None
        batches = [images.patches(c.patches - apart)]
        if apart:
            cells, block, weight = images.scattered(apart * c.patch_cells**2)
            batches, blocks = [*batches, cells], (block, weight)
        return batches, blocks, None if sweeps is None else sweeps.sample(c.lidar_rays)

    def _once(self, done: float, slow: bool) -> None:
        start = self._start(0, done, self.deferred(), Future())
        batches, blocks, beams = self.draw()
        for sink, _ in self._sinks_of(start.tables):
            sink.clear()
        with in_bfloat16(self.recipe.bfloat16):
            terms, metrics, errors, traced = self.branches.terms(
                start, batches, None if blocks is None else blocks[1], beams
            )
        self.optimiser.zero_grad(set_to_none=False)
        torch.stack(list(terms.values())).sum().backward()
        self._pour(start.tables)
        if blocks is not None and self._data is not None:
            self._data[0].note(blocks[0], errors)
        self.optimiser.step()
        with torch.no_grad():
            self.model.log_beta.clamp_(max=BETA_MAX_LOG)
        if slow:
            self._update_slow()
        for number, trace in enumerate(traced):
            self.branches.update_occupancy(start, trace, camera=number == 0)
        for name, value in {**terms, **metrics}.items():
            if name not in self._sums:
                self._sums[name] = torch.zeros(2, device=self._at)
            self._sums[name] += torch.stack([value.detach(), torch.ones_like(value)])

    def _update_slow(self) -> None:
        if self.padding is None:
            return super()._update_slow()
        # between two graphs of operations no graph of gradients is kept: what the slow parameters give is computed anew
        deferred, outputs = self.deferred(), self.slow_outputs()
        for name, value in outputs.items():
            gradient = deferred[name].grad
            if gradient is not None:
                value.backward(gradient)
                gradient.zero_()
        self.slow.step()
        self.slow.zero_grad(set_to_none=False)
        with torch.no_grad():
            for name, value in self.slow_outputs().items():
                deferred[name].copy_(value)

    def _read(self) -> dict[str, float]:
        """Return the means of the terms and metrics since they were read. Raises `SceneError` where one is no number."""
        names = list(self._sums)
        totals, counts = torch.stack(list(self._sums.values())).T.tolist()
        values = {name: total / count for name, total, count in zip(names, totals, counts, strict=True) if count}
        metrics = {name: value for name, value in values.items() if name in ("psnr", "lidar_m")}
        terms = {name: value for name, value in values.items() if name not in metrics}
        bad = [name for name, value in terms.items() if not abs(value) < float("inf")]
        if bad:
            raise SceneError(
                f"training diverged before iteration {self.iteration}: {', '.join(bad)} is not a finite number"
            )
        for total in self._sums.values():
            total.zero_()
        if self.padding is not None and int(self.padding.missed):
            self.padding.missed.zero_()
            self.padding.hits_per_ray *= MORE_HITS
            self._graphs.clear()
        return {**terms, "loss": sum(terms.values()), **metrics}
