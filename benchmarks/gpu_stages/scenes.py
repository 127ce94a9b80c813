"""Trainings of the street, by what `unisim train` runs."""

from __future__ import annotations

import resource
import time
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from unisim_blender.core.data.log import Log
from unisim_blender.core.presets import PRESETS
from unisim_blender.core.training.config import TrainConfig, ray_counts

from .settings import CAMERA, Findings, Settings
from .street import street_of

KEPT_LOSSES = 100
"""Losses in the JSON, spread over a training."""


def scene_of(settings: Settings, preset: str) -> Path:
    """Return the folder of a preset's scene."""
    return Path(settings.work) / preset


def opened(settings: Settings) -> Log:
    """Return the street's log."""
    from unisim_blender.core.formats.readers import open_log

    return open_log(street_of(settings))


def held_out(log: Log) -> int:
    """Return the frame in the middle of those that nothing is learnt from: every second one, from the second on."""
    frames = tuple(log.drive.frames)[1::2]
    return frames[len(frames) // 2]


def beam_lidars(log: Log) -> tuple[str, ...]:
    """Return the names of the LiDARs whose beams are known."""
    return tuple(name for name, lidar in log.drive.lidars.items() if lidar.model.beams)


def config_of(log: Log, preset: str, settings: Settings, **values: Any) -> TrainConfig:
    """Return how the street is trained on: even frames, images at full size."""
    patches, lidar_rays = ray_counts(settings.device, PRESETS[preset].rays if settings.device != "cpu" else None)
    return TrainConfig(
        (CAMERA,), beam_lidars(log), tuple(log.drive.frames)[::2], preset=preset, device=settings.device,
        patches=patches, lidar_rays=lidar_rays, **values,
    )  # fmt: skip


def peak_memory(device: str) -> dict[str, int]:
    """Return the most memory that this process took, in bytes."""
    import torch

    found = {"process_bytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024}
    if device.startswith("cuda"):
        found |= {
            "gpu_bytes": torch.cuda.max_memory_allocated(),
            "gpu_reserved_bytes": torch.cuda.max_memory_reserved(),
        }
    return found


def train_scene(settings: Settings, found: Findings, preset: str) -> None:
    """Train a preset for the time given; note steps, losses, and how well a frame that was held out is rendered."""
    from unisim_blender.core.evaluation.recorded import recorded_image
    from unisim_blender.core.model.checkpoint import load_scene
    from unisim_blender.core.render.captures import render_image, states_of
    from unisim_blender.core.render.renderer import Renderer
    from unisim_blender.core.render.tracers.torch.tracer import TorchBackend
    from unisim_blender.core.training import loop, on_device
    from unisim_blender.core.training.trainer import Trainer
    from unisim_blender.core.world.captures import Capture

    log, begun = opened(settings), time.monotonic()
    done: list[tuple[float, dict[str, float]]] = []
    make = on_device.make_trainer

    def noted(*args: Any) -> Trainer:
        trainer = make(*args)
        step = trainer.step

        def stepped() -> dict[str, float]:
            metrics = step()
            # on a GPU most steps leave their loss there
            done.append((time.monotonic(), metrics or (done[-1][1] if done else {})))
            if len(done) % 50 == 1:
                found.note(steps=len(done), last=metrics)
            return metrics

        trainer.step = stepped  # type: ignore[method-assign]
        return trainer

    with patch.object(loop, "make_trainer", noted):
        header = loop.train(
            log, config_of(log, preset, settings, minutes=settings.seconds / 60), scene_of(settings, preset), quiet=True
        )
    seconds = float(header.training["seconds"])
    late = done[len(done) // 2 :]
    found.note(
        steps=len(done), seconds=seconds, steps_per_s=len(done) / max(seconds, 1e-9), last=done[-1][1],
        late_steps_per_s=(len(late) - 1) / max(late[-1][0] - late[0][0], 1e-9) if len(late) > 1 else None,
        losses=[[i, metrics.get("loss")] for i, (_, metrics) in list(enumerate(done))[:: max(len(done) // KEPT_LOSSES, 1)]],
        whole_s=round(time.monotonic() - begun, 1), training_peak=peak_memory(settings.device),
    )  # fmt: skip
    scene, frame = load_scene(scene_of(settings, preset), settings.device), held_out(log)
    renderer = Renderer(TorchBackend(scene))
    states = states_of(renderer, scene.header.drive)
    image = render_image(renderer, states, Capture.of_frame(states.camera(CAMERA), frame)).rgb
    error = float(np.mean((np.clip(image, 0, 1) - recorded_image(log, CAMERA, frame, None)) ** 2))
    found.note(
        held_out_frame=frame,
        psnr_db=round(-10 * float(np.log10(max(error, 1e-10))), 2),
        peak=peak_memory(settings.device),
    )
    if not np.isfinite(error):
        raise ValueError("the held-out image is not made of numbers")
