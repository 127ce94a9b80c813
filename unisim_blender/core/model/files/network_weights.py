"""Weights of a published network in a file that the user gives."""

from __future__ import annotations

from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from ...errors import UnisimError, in_a_line


def read_tensors(path: Path, network: str) -> dict[str, Tensor]:
    """Return tensors by name, from .safetensors or from a file of torch's, of which nothing but tensors is unpickled.

    Raises `UnisimError`, which says whose ``network`` weights they are not.
    """
    try:
        state = (
            load_file(path)
            if path.suffix == ".safetensors"
            else torch.load(path, map_location="cpu", weights_only=True)
        )
    except (OSError, SafetensorError) as error:
        raise UnisimError(f"{path}: {network} weights cannot be read: {in_a_line(error)}") from error
    except Exception as error:  # torch raises pickle's own errors, and whatever else a broken file brings about
        raise UnisimError(f"{path}: {network} weights are refused: {in_a_line(error)}") from error
    named = isinstance(state, dict) and all(isinstance(n, str) and isinstance(v, Tensor) for n, v in state.items())
    if not named:
        raise UnisimError(f"{path}: holds something else than named tensors, so these are no {network} weights")
    return dict(state)
