"""The training loop: steps until the budget is spent, with a progress bar, previews and checkpoints that survive a kill."""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import torch

from ..data.log import Log
from ..errors import SceneError
from ..files import holds_out
from ..model.scene_file import SceneHeader
from ..progress import Bar
from .checkpoint import CHECKPOINT, load_checkpoint, save_checkpoint
from .config import TrainConfig
from .export import preview, with_own_boxes, write_scene
from .on_device import make_trainer
from .poses import disturbed, with_drive
from .trainer import Trainer

PREVIEW_SHARE = 0.01
"""Largest share of a training's time that previews take: those that cost more come less often."""


@holds_out
def train(log: Log, config: TrainConfig, out: Path, resume: bool = False, quiet: bool = False) -> SceneHeader:
    """Train a scene into folder ``out``; with ``resume``, go on from its checkpoint.

    Ctrl-C and SIGTERM end it after the step at hand, with a checkpoint. Raises SceneError where ``out`` holds
    another training.
    """
    file = out / CHECKPOINT
    if not resume and (file.exists() or (out / "scene.json").exists()):
        raise SceneError(f"{out} holds a trained scene already: give another folder, or --resume to go on")
    if resume and not file.exists():
        raise SceneError(f"{file}: there is no checkpoint to resume")
    _check_device(config.device)
    keep_freed_memory()
    if config.disturb is not None:
        log = with_drive(log, disturbed(log.drive, *config.disturb, config.seed))
    trainer = make_trainer(log, config)
    out.mkdir(parents=True, exist_ok=True)
    trainer.log = with_own_boxes(trainer.log, out)
    if resume:
        load_checkpoint(file, trainer)
    with _stoppable() as stopped:
        _loop(trainer, out, stopped, quiet)
    if stopped and trainer.progress < 1:
        save_checkpoint(file, trainer)
        raise KeyboardInterrupt
    save_checkpoint(file, trainer)
    return write_scene(trainer, out)


def _check_device(name: str) -> None:
    try:
        torch.zeros(1, device=name)
    except (RuntimeError, AssertionError, NotImplementedError, TypeError) as error:
        raise SceneError(f"device {name!r} cannot be used here: {str(error).splitlines()[0]}") from error


def keep_freed_memory() -> None:
    """Have glibc keep what it was given back: a step's buffers are the same each time, and new pages are slow."""
    import ctypes

    try:
        libc = ctypes.CDLL("libc.so.6")
        libc.mallopt(-4, 0)  # none is a mapping of its own, whose pages are new at every step
        libc.mallopt(-1, 1 << 30)
        libc.mallopt(-8, 1)  # one arena: those of other threads are given back when they are empty
    except (OSError, AttributeError):
        return


@contextmanager
def _stoppable() -> Iterator[list[int]]:
    """A list that SIGINT or SIGTERM makes non-empty."""
    stopped: list[int] = []
    before = {}
    for number in (signal.SIGINT, signal.SIGTERM):
        try:
            before[number] = signal.signal(number, lambda n, _: stopped.append(n))
        except ValueError:  # not the main thread: whoever runs this thread stops it
            break
    try:
        yield stopped
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _loop(trainer: Trainer, out: Path, stopped: list[int], quiet: bool) -> None:
    config = trainer.config
    begun = time.monotonic() - trainer.elapsed_s
    saved = time.monotonic()
    next_preview = saved + (config.preview_s or 0.0)
    smooth: dict[str, float] = {}
    bar = Bar(total=100, unit="%", disable=quiet, bar_format="{percentage:5.1f}% |{bar}| {elapsed} {postfix}")
    with bar, (out / "training.jsonl").open("a") as history:
        while trainer.progress < 1 and not stopped:
            metrics = trainer.step()
            trainer.elapsed_s = time.monotonic() - begun
            for name, value in metrics.items():
                smooth[name] = value if name not in smooth else 0.98 * smooth[name] + 0.02 * value
            done = trainer.progress
            if trainer.iteration % 10 == 0:
                left = trainer.elapsed_s * (1 / max(done, 1e-6) - 1)
                bar.n = 100 * done
                lidar = f"LiDAR {100 * smooth['lidar_m']:.1f} cm, " if "lidar_m" in smooth else ""
                bar.set_postfix_str(
                    f"step {trainer.iteration} loss {smooth['loss']:.4f} PSNR {smooth['psnr']:.2f} dB {lidar}"
                    f"{left / 60:.1f} min left"
                )
            if trainer.iteration % 100 == 0:
                record = {"iteration": trainer.iteration, "seconds": trainer.elapsed_s, **smooth}
                history.write(json.dumps(record) + "\n")
                history.flush()
            now = time.monotonic()
            if now - saved > config.checkpoint_s:
                save_checkpoint(out / CHECKPOINT, trainer)
                saved = time.monotonic()
            if config.preview_s is not None and now > next_preview:
                preview(trainer, out / "preview.png")
                spent = time.monotonic() - now
                next_preview = now + max(config.preview_s, spent / PREVIEW_SHARE)
