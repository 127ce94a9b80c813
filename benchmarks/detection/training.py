"""Trains a detector on sets of samples: the same seed, samples and settings give the same weights;
interrupted, it goes on."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from tqdm import trange

from unisim_blender.core.errors import OutputError, UnisimError
from unisim_blender.core.files import partial_file, write_file
from unisim_blender.core.json_file import read_json

from .camera import CameraDetector
from .detector import Detector, loss
from .lidar import LidarDetector
from .samples import Sample, read_set

DETECTORS: dict[str, type[LidarDetector] | type[CameraDetector]] = {"lidar": LidarDetector, "camera": CameraDetector}
SETTINGS, WEIGHTS, CHECKPOINT, LOG = "detector.json", "weights.safetensors", "checkpoint.pt", "training.jsonl"
_SHOWN_EVERY, _KEPT_EVERY = 20, 50


@dataclass(frozen=True)
class TrainingSettings:
    """All that a training depends on beside its samples."""

    detector: str
    sequences: tuple[str, ...]
    samples: int
    steps: int
    batch: int = 6
    learning_rate: float = 2e-3
    weight_decay: float = 1e-2
    seed: int = 0


class Trainer:
    """A training at some step."""

    def __init__(self, settings: TrainingSettings, samples: Sequence[Sample]) -> None:
        torch.manual_seed(settings.seed)
        self.settings, self.samples, self.step = settings, samples, 0
        self.detector: Detector = DETECTORS[settings.detector]()
        self.network = self.detector.network().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        self.optimizer = torch.optim.AdamW(
            self.network.parameters(), settings.learning_rate, weight_decay=settings.weight_decay
        )
        self.schedule = torch.optim.lr_scheduler.OneCycleLR(
            self.optimizer, settings.learning_rate, total_steps=settings.steps, pct_start=0.1, cycle_momentum=False
        )

    def advance(self) -> tuple[float, float]:
        """One step; its losses of class and box."""
        image, classes, regression = self._batch()
        self.network.train()
        focal, away = loss(self.network(image), classes, regression)
        self.optimizer.zero_grad()
        (focal + away).backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), 10.0)
        self.optimizer.step()
        self.schedule.step()
        self.step += 1
        return focal.item(), away.item()

    def _batch(self) -> tuple[Tensor, Tensor, Tensor]:
        """A batch of this step, drawn from the seed and the step alone, every sample once a round."""
        at = self.step * self.settings.batch + np.arange(self.settings.batch)
        examples = []
        for number in at:
            turn, place = divmod(int(number), len(self.samples))
            order = np.random.default_rng([self.settings.seed, turn]).permutation(len(self.samples))
            rng = np.random.default_rng([self.settings.seed, 1, int(number)])
            examples.append(self.detector.example(self.samples[order[place]], rng))
        image = torch.from_numpy(np.stack([e.input for e in examples])).contiguous(memory_format=torch.channels_last)
        classes = torch.from_numpy(np.stack([e.classes for e in examples]))
        return image, classes, torch.from_numpy(np.stack([e.regression for e in examples]))

    def state(self) -> dict[str, Any]:
        """All that goes on."""
        parts = {"network": self.network, "optimizer": self.optimizer, "schedule": self.schedule}
        return {"step": self.step, **{name: part.state_dict() for name, part in parts.items()}}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from what `state` gave."""
        self.step = state["step"]
        self.network.load_state_dict(state["network"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.schedule.load_state_dict(state["schedule"])


def train(detector: str, sets: Sequence[Path], out: Path, steps: int, batch: int, seed: int) -> None:
    """Train on all samples of sets and write ``out``; a training of the same settings there goes on.
    Raises `UnisimError`."""
    pairs = [pair for path in sets for pair in read_set(path).items()]
    sequences, samples = tuple(sorted({key.sequence for key, _ in pairs})), [sample for _, sample in pairs]
    settings = TrainingSettings(detector, sequences, len(samples), steps, batch, seed=seed)
    _claim(out, settings)
    trainer = Trainer(settings, samples)
    if (out / CHECKPOINT).is_file():
        trainer.restore(torch.load(out / CHECKPOINT, weights_only=True))
    bar = trange(trainer.step, steps, initial=trainer.step, total=steps, desc=f"{detector} detector", unit="step")
    means = np.zeros(2)
    for _ in bar:
        means = 0.95 * means + 0.05 * np.array(trainer.advance()) if means.any() else np.array(trainer.advance())
        if trainer.step % _SHOWN_EVERY == 0:
            bar.set_postfix_str(f"class {means[0]:.3f} box {means[1]:.3f}")
        if trainer.step % _KEPT_EVERY == 0 or trainer.step == steps:
            line = {"step": trainer.step, "class": round(float(means[0]), 4), "box": round(float(means[1]), 4)}
            with open(out / LOG, "a") as log:
                log.write(json.dumps(line) + "\n")
            with partial_file(out / CHECKPOINT) as temporary:
                torch.save(trainer.state(), temporary)
    with partial_file(out / WEIGHTS) as temporary:
        save_file({name: value.contiguous() for name, value in trainer.network.state_dict().items()}, temporary)


def _claim(out: Path, settings: TrainingSettings) -> None:
    file, document = out / SETTINGS, json.loads(json.dumps(asdict(settings)))
    if file.is_file() and read_json(file, OutputError) != document:
        raise OutputError(f"{out}: holds a training of other settings, see {file}")
    if not file.is_file() and out.exists() and any(out.iterdir()):
        raise OutputError(f"{out}: is not empty and holds no detector")
    write_file(file, (json.dumps(document, indent=1) + "\n").encode())


@dataclass(frozen=True)
class Trained:
    """A detector with its weights, and what it was trained with."""

    detector: Detector
    network: nn.Module
    settings: dict[str, Any]


def load_detector(path: Path) -> Trained:
    """The trained detector in a folder. Raises `UnisimError`."""
    settings = read_json(path / SETTINGS, UnisimError)
    if not (path / WEIGHTS).is_file():
        raise UnisimError(f"{path / WEIGHTS}: is missing: this training has not finished")
    detector: Detector = DETECTORS[settings["detector"]]()
    network = detector.network()
    network.load_state_dict(load_file(path / WEIGHTS))
    return Trained(detector, network.eval().to(memory_format=torch.channels_last), settings)  # type: ignore[call-overload]
