"""Small networks of the fields, modules with frozen parameters, and published weights from a file."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import TypeVar

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor, nn

from ..errors import UnisimError, in_a_line
from ..ops.mlp import two_layers


def mlp(width_in: int, hidden: int, width_out: int, layers: int = 2) -> nn.Sequential:
    """Return a perceptron of ``layers`` linear layers with ReLU between them; only the last has a bias, as in
    Instant-NGP."""
    widths = [width_in] + [hidden] * (layers - 1) + [width_out]
    parts: list[nn.Module] = []
    for i in range(layers):
        last = i + 1 == layers
        parts.append(nn.Linear(widths[i], widths[i + 1], bias=last))
        if not last:
            parts.append(nn.ReLU(inplace=True))
    return nn.Sequential(*parts)


def run_mlp(network: nn.Sequential, x: Tensor, outputs: int | None = None) -> Tensor:
    """Return the output (N, O) of ``network``, as `mlp` makes it, at x (N, width); its first ``outputs`` columns alone,
    where that is given.

    One of two layers is the operation `two_layers`, deeper ones are plain torch.
    """
    if len(network) == 3:
        return two_layers(x, *two_layers_of(network, outputs))
    last = network[-1]
    assert isinstance(last, nn.Linear)
    return nn.functional.linear(network[:-1](x), last.weight[:outputs], last.bias[:outputs])


def two_layers_of(network: nn.Sequential, outputs: int | None = None) -> tuple[Tensor, Tensor, Tensor]:
    """Return weights (H, I) and (O, H) and bias (O,) of a network of two layers, for its first ``outputs`` columns or
    all."""
    first, _, last = network
    assert isinstance(first, nn.Linear) and isinstance(last, nn.Linear)
    return first.weight, last.weight[:outputs], last.bias[:outputs]


def spherical_harmonics(d: Tensor) -> Tensor:
    """Return real spherical harmonics of degree 0 to 3 (N, 16) of unit directions (N, 3).

    Constants as in Sloan, "Stupid Spherical Harmonics Tricks", 2008, appendix A2.
    """
    x, y, z = d.unbind(-1)
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    return torch.stack(
        [
            torch.full_like(x, 0.28209479177387814),
            -0.48860251190291987 * y,
            0.48860251190291987 * z,
            -0.48860251190291987 * x,
            1.0925484305920792 * xy,
            -1.0925484305920792 * yz,
            0.94617469575755997 * zz - 0.31539156525251999,
            -1.0925484305920792 * xz,
            0.54627421529603959 * (xx - yy),
            0.59004358992664352 * y * (-3 * xx + yy),
            2.8906114426405538 * xy * z,
            0.45704579946446572 * y * (1 - 5 * zz),
            0.3731763325901154 * z * (5 * zz - 3),
            0.45704579946446572 * x * (1 - 5 * zz),
            1.4453057213202769 * z * (xx - yy),
            0.59004358992664352 * x * (-xx + 3 * yy),
        ],
        -1,
    )


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


M = TypeVar("M", bound=nn.Module)


def frozen(module: M) -> M:
    """Return a module that shares a module's parameters' memory and gives them no gradient."""
    twin = shallow(module)
    for name, parameter in module._parameters.items():
        twin._parameters[name] = None if parameter is None else parameter.detach()  # type: ignore[assignment]
    for name, part in module._modules.items():
        twin._modules[name] = None if part is None else frozen(part)
    return twin


def shallow(module: M) -> M:
    """Return a shallow copy of a module: replacing its parts leaves the original unchanged."""
    twin = copy.copy(module)
    twin._parameters, twin._modules = dict(module._parameters), dict(module._modules)
    return twin
