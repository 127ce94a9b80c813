"""A training's state on disk: everything that the next step needs, in one file of tensors."""

from __future__ import annotations

import dataclasses
import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor
from torch.optim import Optimizer

from ..data.fingerprint import Fingerprint, aligned
from ..data.log import Log
from ..errors import SceneError, in_a_line
from ..json_file import Node
from ..presets import preset
from .config import TrainConfig
from .trainer import Trainer

START, VALUE = "start", "value"
CHECKPOINT = "checkpoint.safetensors"
FORMER_SETTINGS = {"hidden_from": "unobserved_from"}
FORMER_WEIGHTS = {"band": "sdf_band", "flat": "normal_smoothness", "spread": "distortion", "hidden": "unobserved"}
"""Former names of settings and of weights in checkpoints, and those of today; both are read."""


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
        tensors = unpacked_grids(tensors, _grids(trainer))
        # the background model was named "far" once
        state = {re.sub(r"^far\.", "background.", name): value for name, value in under("model.").items()}
        _check_shapes(file, state, trainer.model.state_dict())
        trainer.model.load_state_dict(state)
        trainer.tracklets.load_state_dict(under("tracklets."), strict=False)
        if trainer.adversary:
            trainer.adversary.load_state(under("adversary."))
        trainer.camera_poses.load_state_dict(under("camera_poses."))
        trainer.log_gains.data.copy_(tensors["log_gains"])
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


def _state(trainer: Trainer) -> dict[str, Tensor]:
    tensors = {f"model.{k}": v for k, v in trainer.model.state_dict().items()}
    tensors |= {f"tracklets.{k}": v for k, v in trainer.tracklets.named_parameters()}
    tensors |= {f"camera_poses.{k}": v for k, v in trainer.camera_poses.named_parameters()}
    tensors["log_gains"] = trainer.log_gains
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
        tensors |= packed_grid(name, tensors.pop(name))
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
    settings = {
        k: v
        for k, v in dataclasses.asdict(config).items()
        if k not in ("minutes", "iterations", "device", "checkpoint_s", "preview_s")
    }
    stated = preset(config.preset)
    settings |= {"mirrored": stated.mirrored, "weights": dataclasses.asdict(stated.weights)}
    return json.dumps(settings, sort_keys=True)


def _read_settings(text: str) -> Any:
    """Return what `_settings` wrote, by today's names; None where it is no JSON object."""
    try:
        settings = json.loads(text)
        weights = {FORMER_WEIGHTS.get(name, name): weight for name, weight in settings["weights"].items()}
        return {**{FORMER_SETTINGS.get(name, name): value for name, value in settings.items()}, "weights": weights}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def _check_shapes(file: Path, stored: dict[str, Tensor], own: dict[str, Tensor]) -> None:
    """Raise SceneError naming the first weights that a checkpoint lacks, has beyond the model's, or has in another shape."""
    for name in sorted(own.keys() | stored.keys()):
        if name not in stored or name not in own:
            what = "lacks" if name in own else "has, as this version does not,"
            raise SceneError(f"{file} does not fit this log or version: it {what} the weights {name}")
        if stored[name].shape != own[name].shape:
            shapes = " x ".join(map(str, stored[name].shape)), " x ".join(map(str, own[name].shape))
            raise SceneError(f"{file} does not fit this log or version: its {name} are {shapes[0]}, not {shapes[1]}")


def _check_same_log(file: Path, fingerprint: str, log: Log) -> None:
    """Raise SceneError where a checkpoint is of another drive than the log, or of the same in another world."""
    try:
        own = Fingerprint.from_json(Node(json.loads(fingerprint), f"{file}: log: ", SceneError))
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


def packed_grid(name: str, grid: Tensor) -> dict[str, Tensor]:
    """Return a grid as where each run of equal entries starts (N,) and what they are (N,), by names that begin with ``name``;
    the grid itself where that is smaller."""
    flat = grid.detach().cpu().contiguous().view(-1)
    start = torch.cat([torch.zeros(1, dtype=torch.long), torch.nonzero(flat[1:] != flat[:-1])[:, 0] + 1])
    if len(start) * (4 + flat.element_size()) >= flat.nbytes:
        return {name: grid}
    return {f"{name}.{START}": start.int(), f"{name}.{VALUE}": flat[start]}


def unpacked_grids(tensors: Mapping[str, Tensor], grids: Mapping[str, torch.Size]) -> dict[str, Tensor]:
    """Return the tensors with grids of these names and shapes in place of what `packed_grid` made of them. Raises ValueError."""
    unpacked = dict(tensors)
    for name, shape in grids.items():
        if f"{name}.{START}" not in unpacked:
            continue
        start, value = (unpacked.pop(f"{name}.{part}") for part in (START, VALUE))
        if start.ndim != 1 or start.dtype != torch.int32 or start.shape != value.shape:
            raise ValueError(f"{name} is no packed grid")
        lengths = torch.diff(start.long(), append=torch.tensor([shape.numel()]))
        if not len(start) or start[0] != 0 or int(lengths.min()) <= 0:
            raise ValueError(f"{name} does not fit a grid of {tuple(shape)} voxels")
        unpacked[name] = value.repeat_interleave(lengths).view(shape)
    return unpacked
