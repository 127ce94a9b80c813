"""A trained scene on disk: `scene.json` (see scene_file.py) and `weights.safetensors`.

Tables in half precision, actors' grids baked. No pickle."""

from __future__ import annotations

import dataclasses
import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save_file
from torch import Tensor

from ..errors import SceneError
from ..scene_file import HEADER_NAME, SceneHeader, read_scene_header, write_scene_header
from .config import ModelConfig
from .config_check import check_config
from .scene import SceneModel
from .volume import Volume

WEIGHTS = "weights.safetensors"


@dataclass
class Scene:
    """A trained scene, ready to render: header, model, and every actor's grid (actors, rows, features), baked."""

    path: Path
    header: SceneHeader
    model: SceneModel
    actor_tables: Tensor


def _pack(model: SceneModel) -> dict[str, Tensor]:
    tensors = {}
    for name, value in model.state_dict().items():
        if name.startswith(("actors.hypernetwork", "actors.latents")):
            continue
        if name in ("occupancy.values", "observed"):
            # nearly all of them are 0: numbers of the others and their values
            index = torch.nonzero(value.view(-1))[:, 0]
            tensors[f"{name}.index"], tensors[f"{name}.value"] = index.int(), value.view(-1)[index]
        else:
            large = value.ndim >= 2 and value.numel() > 1 << 15 and name != "ground.heights"  # heights need their centimetres
            tensors[name] = (value.half() if large else value).contiguous().cpu()
    with torch.no_grad():
        tensors["actors.tables"] = model.actors.tables().half().cpu().contiguous()
    return tensors


def save_scene(path: Path, header: SceneHeader, model: SceneModel) -> None:
    """Write both files; each appears under its name only when it is complete."""
    path.mkdir(parents=True, exist_ok=True)
    temporary = path / f".{WEIGHTS}.part"
    try:
        save_file(_pack(model), temporary)
        os.replace(temporary, path / WEIGHTS)
    except (OSError, SafetensorError) as error:
        temporary.unlink(missing_ok=True)
        raise SceneError(f"{path / WEIGHTS} cannot be written: {error}") from error
    # a kill between the two leaves a header that does not belong to the weights, and says so
    write_scene_header(path, dataclasses.replace(header, weights=weights_hash(path)))


def load_scene(path: str | Path, device: str = "cpu") -> Scene:
    """Read a trained scene; SceneError says what is wrong with its version, shapes or numbers."""
    path = Path(path)
    header = read_scene_header(path)
    config = ModelConfig.from_dict(header.model)
    check_config(config, f"{path / HEADER_NAME}: model")
    volume = Volume.from_dict(header.volume)
    file = path / WEIGHTS
    if not file.is_file():
        raise SceneError(f"{file}: the trained scene has no weights")
    try:
        tensors = load_file(file)
    except (OSError, SafetensorError, ValueError) as error:
        raise SceneError(f"{file} cannot be read: {error}") from error
    cameras = tuple(str(name) for name in header.training.get("cameras", ()))
    model = SceneModel(config, volume, tuple(sorted(header.drive.actors)), cameras)
    model.actors.drop_hypernetwork()
    tables = tensors.pop("actors.tables", None)
    state = _unpack(file, tensors, model)
    expected = (len(header.drive.actors), model.actors.grid.rows, config.actor_grid.features)
    if tables is None or tuple(tables.shape) != expected:
        raise SceneError(f"{file}: actors.tables has shape {None if tables is None else tuple(tables.shape)}, not {expected}")
    _check_finite(file, "actors.tables", tables)
    if header.weights and header.weights != weights_hash(path):
        raise SceneError(
            f"{file} does not belong to the {HEADER_NAME} beside it: one of the two was written or copied without the other"
        )
    model.load_state_dict(state)
    model.eval().requires_grad_(False).to(device)
    return Scene(path, header, model, tables.float().to(device))


def _unpack(file: Path, tensors: dict[str, Tensor], model: SceneModel) -> dict[str, Tensor]:
    state = {}
    for name, value in model.state_dict().items():
        if name in ("occupancy.values", "observed"):
            index, entries = tensors.get(f"{name}.index"), tensors.get(f"{name}.value")
            if index is None or entries is None:
                raise SceneError(f"{file}: {name} is missing")
            if index.shape != entries.shape or (len(index) and not 0 <= int(index.min()) <= int(index.max()) < value.numel()):
                raise SceneError(f"{file}: {name} does not fit a grid of {tuple(value.shape)} voxels")
            full = torch.zeros(value.numel(), dtype=torch.uint8)
            full[index.long()] = entries.to(torch.uint8)
            state[name] = full.view(value.shape)
            continue
        if name not in tensors:
            raise SceneError(f"{file}: {name} is missing")
        if tensors[name].shape != value.shape:
            raise SceneError(f"{file}: {name} has shape {tuple(tensors[name].shape)}, scene.json asks for {tuple(value.shape)}")
        _check_finite(file, name, tensors[name])
        state[name] = tensors[name].to(value.dtype)
    return state


def _check_finite(file: Path, name: str, value: Tensor) -> None:
    if value.is_floating_point() and not bool(torch.isfinite(value).all()):
        where = np.unravel_index(int((~torch.isfinite(value)).flatten().int().argmax()), tuple(value.shape) or (1,))
        raise SceneError(f"{file}: {name}{[int(i) for i in where]} is not a finite number")


def weights_hash(path: str | Path) -> str:
    """SHA-256 of the weights file, in hexadecimal."""
    with (Path(path) / WEIGHTS).open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
