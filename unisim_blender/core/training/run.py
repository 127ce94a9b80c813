"""A training from start to end: progress, previews, checkpoints that survive a kill at any moment,
the finished scene."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor
from torch.optim import Optimizer

from ..data.fingerprint import Fingerprint, aligned
from ..data.images import resize_image
from ..data.log import Log
from ..data.own_vehicle import outlines_to_json
from ..errors import SceneError, in_a_line
from ..files import holds_out
from ..geometry import Trajectory
from ..json_file import Node
from ..model.files.checkpoint import TorchScene, save_scene
from ..model.files.scene_file import SceneHeader
from ..presets import preset
from ..progress import Bar
from ..render.drive_renderer import DriveRenderer
from ..render.quality import QUALITY
from ..render.renderer import Renderer
from ..render.tracers.compiled.scene import cells_to_store
from ..render.tracers.torch.tracer import TorchBackend
from ..world.drive import Drive
from .config import TrainConfig
from .packed_voxels import packed, unpacked
from .poses.disturb import disturbed, with_drive
from .space.observed import observe
from .trainer import Trainer

CHECKPOINT = "checkpoint.safetensors"
FORMER_SETTINGS = {"hidden_from": "unobserved_from"}
FORMER_WEIGHTS = {"band": "sdf_band", "flat": "normal_smoothness", "spread": "distortion", "hidden": "unobserved"}
"""Former names of settings and of weights in checkpoints, and those of today; both are read."""
PREVIEW_WIDTH = 240
PREVIEW_SHARE = 0.01
"""Of a training's time at most: previews that cost more come less often."""


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
    trainer = Trainer(log, config)
    out.mkdir(parents=True, exist_ok=True)
    if resume:
        load_checkpoint(file, trainer)
    with _stoppable() as stopped:
        _loop(trainer, out, stopped, quiet)
    if stopped and trainer.progress < 1:
        save_checkpoint(file, trainer)
        raise KeyboardInterrupt
    save_checkpoint(file, trainer)
    return finish(trainer, out)


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
        libc.mallopt(-3, 32 << 20)
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


def _state(trainer: Trainer) -> dict[str, Tensor]:
    tensors = {f"model.{k}": v for k, v in trainer.model.state_dict().items()}
    tensors |= {f"tracklets.{k}": v for k, v in trainer.tracklets.named_parameters()}
    tensors |= {f"camera_poses.{k}": v for k, v in trainer.camera_poses.named_parameters()}
    tensors |= {
        f"occupancy.{k}": v.to(torch.uint8) if v.dtype == torch.bool else v
        for k, v in trainer.occupancy.state().items()
    }
    tensors |= {f"choice.{k}": v for k, v in trainer.choice.state().items()}
    if trainer.adversary:
        tensors |= {f"adversary.{k}": v for k, v in trainer.adversary.state().items()}
    for name, optimiser in _optimisers(trainer):
        for number, state in optimiser.state_dict()["state"].items():
            tensors |= {f"{name}.{number}.{k}": v for k, v in state.items()}
    tensors |= {f"held.{k}": v for k, v in trainer.deferred_gradients().items()}
    for name in _grids(trainer):
        tensors |= packed(name, tensors.pop(name))
    return {k: v.detach().cpu().contiguous() for k, v in tensors.items()}


def _grids(trainer: Trainer) -> dict[str, torch.Size]:
    """Shapes of the voxel grids among a checkpoint's tensors, by name."""
    of_model, of_training = trainer.model.state_dict(), trainer.occupancy.state()
    return {
        **{f"model.{name}": of_model[name].shape for name in ("occupancy.values", "observed")},
        **{f"occupancy.{name}": grid.shape for name, grid in of_training.items()},
    }


def _optimisers(trainer: Trainer) -> tuple[tuple[str, torch.optim.Optimizer], ...]:
    return ("optimiser", trainer.optimiser), ("slow", trainer.slow)


def _settings(config: TrainConfig) -> str:
    kept = {
        k: v
        for k, v in dataclasses.asdict(config).items()
        if k not in ("minutes", "iterations", "device", "checkpoint_s", "preview_s")
    }
    stated = preset(config.preset)
    kept |= {"mirrored": stated.mirrored, "weights": dataclasses.asdict(stated.weights)}
    return json.dumps(kept, sort_keys=True)


def _read_settings(text: str) -> Any:
    """Return what `_settings` wrote, by today's names; None where it is no JSON object."""
    try:
        found = json.loads(text)
        weights = {FORMER_WEIGHTS.get(name, name): weight for name, weight in found["weights"].items()}
        return {**{FORMER_SETTINGS.get(name, name): value for name, value in found.items()}, "weights": weights}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def save_checkpoint(file: Path, trainer: Trainer) -> None:
    """Everything that the next step needs, whole or not at all."""
    about = {
        "iteration": str(trainer.iteration),
        "elapsed_s": repr(trainer.elapsed_s),
        "settings": _settings(trainer.config),
        "log": json.dumps(trainer.fingerprint.to_json()),
    }
    temporary = file.with_name(f".{file.name}.part")
    try:
        save_file(_state(trainer), temporary, metadata=about)
        os.replace(temporary, file)
    except (OSError, SafetensorError) as error:
        temporary.unlink(missing_ok=True)
        raise SceneError(f"{file} cannot be written: {error}") from error


def load_checkpoint(file: Path, trainer: Trainer) -> None:
    """The inverse of `save_checkpoint`; SceneError where the file is of a training with other settings."""
    try:
        with safe_open(file, framework="pt") as stored:
            about = stored.metadata() or {}
            tensors = {name: stored.get_tensor(name) for name in stored.keys()}  # noqa: SIM118
    except (OSError, SafetensorError) as error:
        raise SceneError(f"{file} cannot be read: {in_a_line(error)}") from error
    if _read_settings(about.get("settings", "")) != json.loads(_settings(trainer.config)):
        raise SceneError(
            f"{file} is of a training with other settings; give the same cameras, frames, width, preset and seed"
        )
    if "log" in about:
        _check_same_log(file, about["log"], trainer.log)

    def under(prefix: str) -> dict[str, Tensor]:
        return {name[len(prefix) :]: value for name, value in tensors.items() if name.startswith(prefix)}

    try:
        tensors = unpacked(tensors, _grids(trainer))
        # the background model was named "far" once
        state = {re.sub(r"^far\.", "background.", name): value for name, value in under("model.").items()}
        _check_shapes(file, state, trainer.model.state_dict())
        trainer.model.load_state_dict(state)
        trainer.tracklets.load_state_dict(under("tracklets."), strict=False)
        if trainer.adversary:
            trainer.adversary.load_state(under("adversary."))
        trainer.camera_poses.load_state_dict(under("camera_poses."))
        trainer.choice.load_state(under("choice."))
        trainer.occupancy.load_state(
            {k: v.to(trainer.occupancy.state()[k].dtype) for k, v in under("occupancy.").items()}
        )
        for prefix, optimiser in _optimisers(trainer):
            _load_optimiser(optimiser, under(f"{prefix}."))
        trainer.load_deferred_gradients(under("held."))
        trainer.iteration, trainer.elapsed_s = int(about["iteration"]), float(about["elapsed_s"])
    except (RuntimeError, KeyError, ValueError, TypeError, IndexError, AttributeError) as error:
        raise SceneError(f"{file} does not fit this log or version: {in_a_line(error)}") from error


def _check_shapes(file: Path, stored: dict[str, Tensor], own: dict[str, Tensor]) -> None:
    """Raise SceneError naming the first weights that a checkpoint lacks, has beyond the model's, or has in another shape."""
    for name in sorted(own.keys() | stored.keys()):
        if name not in stored or name not in own:
            what = "lacks" if name in own else "has, as this version does not,"
            raise SceneError(f"{file} does not fit this log or version: it {what} the weights {name}")
        if stored[name].shape != own[name].shape:
            shapes = " x ".join(map(str, stored[name].shape)), " x ".join(map(str, own[name].shape))
            raise SceneError(f"{file} does not fit this log or version: its {name} are {shapes[0]}, not {shapes[1]}")


def _check_same_log(file: Path, kept: str, log: Log) -> None:
    """Raise SceneError where a checkpoint is of another drive than the log, or of the same in another world."""
    try:
        own = Fingerprint.from_json(Node(json.loads(kept), f"{file}: log: ", SceneError))
    except ValueError as error:
        raise SceneError(f"{file}: log: is no JSON: {in_a_line(error)}") from error
    if aligned(own, log, log.drive.world_origin, f"{file} is of a training on") is not log:
        raise SceneError(f"{file} is of a training on this drive whose world has another origin than {log.path}")


def _load_optimiser(optimiser: Optimizer, tensors: dict[str, Tensor]) -> None:
    """Put what `_state` told of an optimiser into it. Raises ValueError for what is of no parameter of its own."""
    parameters = [parameter for group in optimiser.param_groups for parameter in group["params"]]
    state: dict[int, dict[str, Tensor]] = {}
    for name, value in tensors.items():
        number, key = name.split(".", 1)
        if not 0 <= int(number) < len(parameters) or value.shape not in (parameters[int(number)].shape, ()):
            raise ValueError(f"an optimiser has {name} of shape {tuple(value.shape)}")
        state.setdefault(int(number), {})[key] = value
    optimiser.load_state_dict({"state": state, "param_groups": optimiser.state_dict()["param_groups"]})


def refined_drive(trainer: Trainer) -> Drive:
    """The log's drive with the tracklets and camera mounts as training refined them."""
    drive = trainer.log.drive
    positions, quaternions = (t.detach().cpu().double().numpy() for t in trainer.tracklets.keys())
    positions = trainer.tracklets.corner + positions
    actors = dict(drive.actors)
    for i, uid in enumerate(trainer.model.actor_ids if trainer.recipe.refines_tracklets else ()):
        actor = drive.actors[uid]
        k = len(actor.world_from_actor.times_s)
        q = quaternions[i, :k] / np.linalg.norm(quaternions[i, :k], axis=1, keepdims=True)
        actors[uid] = dataclasses.replace(
            actor, world_from_actor=Trajectory(actor.world_from_actor.times_s, positions[i, :k], q)
        )
    cameras = dict(drive.cameras)
    for number, name in enumerate(trainer.config.cameras):
        cameras[name] = trainer.camera_poses.corrected(cameras[name], number)
    return dataclasses.replace(drive, actors=actors, cameras=cameras)


def header_of(trainer: Trainer, out: Path) -> SceneHeader:
    """What `scene.json` is to say."""
    config, log = trainer.config, trainer.log
    training = {
        "preset": config.preset, "method": trainer.recipe.method, "without": list(config.without),
        "cameras": list(config.cameras), "lidars": list(trainer.lidars), "frames": list(config.frames),
        "width": config.width, "iterations": trainer.iteration, "minutes": config.minutes,
        "seconds": round(trainer.elapsed_s, 1), "rays": config.patches * config.patch_cells**2,
        "seed": config.seed, "adversarial": config.adversarial, "device": config.device,
        "own_vehicle": outlines_to_json(trainer.cameras.outlines),
    }  # fmt: skip
    if config.noise is not None:
        training["disturbed"] = config.noise
    return SceneHeader(
        path=out,
        name=out.name,
        log_name=log.drive.name,
        log_path=os.path.relpath(log.path, out),
        world_origin=log.drive.world_origin,
        model=trainer.model.config.to_dict(),
        volume=trainer.volume.to_dict(),
        drive=refined_drive(trainer),
        training=training,
        fingerprint=trainer.fingerprint,
    )


def _as_scene(trainer: Trainer, out: Path) -> TorchScene:
    with torch.no_grad():
        return TorchScene(out, header_of(trainer, out), trainer.model, trainer.model.actors.tables())


def finish(trainer: Trainer, out: Path) -> SceneHeader:
    """Free what was never seen, note which voxels the recording supports, write the scene."""
    for parameter in trainer.model.parameters():
        parameter.grad = None
    scene = _as_scene(trainer, out)
    trainer.model.eval()
    trainer.occupancy.free_unshown()
    through = observe(scene, trainer.config.cameras, trainer.config.frames, trainer.lidar.points_by_sweep())
    if trainer.recipe.weights.unobserved:
        trainer.occupancy.free_unobserved(through, trainer.unobserved.continued)
    save_scene(out, scene.header, trainer.model, cells_to_store)
    return scene.header


def preview_frame(trainer: Trainer) -> tuple[str, int]:
    """Camera and frame of the preview: of the first camera the middle frame that is not trained on, or
    else the middle one."""
    config = trainer.config
    frames = trainer.log.image_frames(config.cameras[0])
    held_out = [frame for frame in frames if frame not in config.frames] or list(frames)
    return config.cameras[0], held_out[len(held_out) // 2]


def preview(trainer: Trainer, file: Path) -> None:
    """Write a small image: recorded beside rendered. It changes nothing of the training."""
    name, frame = preview_frame(trainer)
    width = min(PREVIEW_WIDTH, trainer.cameras.cameras[name].model.width)
    trainer.model.eval()
    scene = _as_scene(trainer, file.parent)
    drive = scene.header.drive
    rendered = DriveRenderer(Renderer(TorchBackend(scene, QUALITY["fast"])), drive).camera(name, frame, width=width)
    trainer.model.train()
    recorded = resize_image(trainer.log.image(name, frame), rendered.model)
    both = np.concatenate([recorded, np.round(rendered.rgb * 255).astype(np.uint8)], 1)
    temporary = file.with_name(f".{file.name}")
    Image.fromarray(both).save(temporary, format="png")
    os.replace(temporary, file)
