"""A trained scene on disk: `scene.json` (see scene_file.py) and `weights.safetensors`.

Tables in half precision, actors' own baked. No pickle."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..errors import SceneError
from .config import ModelConfig
from .scene import SceneModel
from .scene_file import (
    HEADER_NAME,
    WEIGHTS_NAME,
    SceneHeader,
    Weights,
    check_belongs,
    read_scene_header,
    read_weights,
    weights_hash,
    write_scene_header,
)
from .shapes import check_config, check_sizes, stored_arrays, stored_voxels
from .volume import Volume


@dataclass
class TorchScene:
    """A trained scene, ready to render: header, model, and the baked tables (actors, ...) of its actors."""

    path: Path
    header: SceneHeader
    model: SceneModel
    actor_tables: Tensor


def _pack(model: SceneModel) -> dict[str, Tensor]:
    tensors, own = {}, tuple(f"actors.{name}" for name in model.actors.OWN)
    for name, value in model.state_dict().items():
        if name.startswith(own):
            continue
        if name in ("occupancy.values", "observed"):
            # nearly all of them are 0: numbers of the others and their values
            index = torch.nonzero(value.view(-1))[:, 0]
            tensors[f"{name}.index"], tensors[f"{name}.value"] = index.int(), value.view(-1)[index]
        else:
            large = (
                value.ndim >= 2 and value.numel() > 1 << 15 and name != "ground.heights"
            )  # heights need their centimetres
            tensors[name] = (value.half() if large else value).contiguous().cpu()
    with torch.no_grad():
        tensors["actors.tables"] = model.actors.own_rows().half().cpu().contiguous()
    return tensors


Beside = Callable[[SceneHeader, Weights], dict[str, NDArray[Any]]]
"""Function from a scene's header and weights to further arrays that are stored with them."""


def save_scene(path: Path, header: SceneHeader, model: SceneModel, beside: Beside | None = None) -> None:
    """Write both files; each appears under its name only when it is complete. The weights include the arrays of
    ``beside``."""
    from safetensors import SafetensorError  # here: what renders does not need it
    from safetensors.torch import save_file

    path.mkdir(parents=True, exist_ok=True)
    temporary = path / f".{WEIGHTS_NAME}.part"
    tensors = _pack(model)
    if beside is not None:
        weights = Weights(path / WEIGHTS_NAME, {name: value.cpu().numpy() for name, value in tensors.items()})
        tensors |= {name: torch.from_numpy(np.array(value)) for name, value in beside(header, weights).items()}
    try:
        save_file(tensors, temporary)
        os.replace(temporary, path / WEIGHTS_NAME)
    except (OSError, SafetensorError) as error:
        temporary.unlink(missing_ok=True)
        raise SceneError(f"{path / WEIGHTS_NAME} cannot be written: {error}") from error
    # a kill between the two leaves a header that does not belong to the weights, and says so
    write_scene_header(path, dataclasses.replace(header, weights=weights_hash(path)))


def load_scene(path: str | Path, device: str = "cpu", header: SceneHeader | None = None) -> TorchScene:
    """Read a trained scene; SceneError says what is wrong with its version, shapes or numbers. ``header`` is its
    header, where it is read already."""
    path = Path(path)
    header = read_scene_header(path) if header is None else header
    config = ModelConfig.from_dict(header.model)
    check_config(config, f"{path / HEADER_NAME}: model")
    volume = Volume.from_dict(header.volume)
    check_sizes(config, volume, f"{path / HEADER_NAME}: model")
    file = path / WEIGHTS_NAME
    if not file.is_file():
        raise SceneError(f"{file}: the trained scene has no weights")
    weights = read_weights(file)
    cameras = tuple(str(name) for name in header.training.get("cameras", ()))
    actors = tuple(sorted(header.drive.actors))
    shapes = stored_arrays(config, volume.size_m, len(actors), len(cameras))
    voxels = stored_voxels(config, volume.size_m)
    weights.check_shapes(shapes)
    model = SceneModel(config, volume, actors, cameras)
    model.actors.drop_own()
    arrays = {name: weights.array(name, shape) for name, shape in shapes.items()}
    arrays |= {name: weights.voxels(name, shape) for name, shape in voxels.items()}
    tables = arrays.pop("actors.tables")
    state = {name: _tensor(arrays[name], value.dtype) for name, value in model.state_dict().items()}
    check_belongs(header)
    model.load_state_dict(state)
    model.eval().requires_grad_(False).to(device)
    rows = _tensor(tables, torch.float32).to(device)
    # in half precision, as the kernels have them
    return TorchScene(
        path, header, model, rows if model.actors.gaits is None else model.actors.posed(rows).half().float()
    )


def _tensor(array: NDArray[Any], dtype: torch.dtype) -> Tensor:
    """Return a tensor of a mapped array: one copy, which converts."""
    open_array = array.view()
    open_array.flags.writeable = True  # torch warns of arrays that cannot be written, though this one is only read
    return torch.from_numpy(open_array).to(dtype, copy=True)
