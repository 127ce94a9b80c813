"""The compiled kernels beside plain torch: interleaved in one run, medians, and their ratio.

python benchmarks/kernels.py [--samples N] [--rounds R]
"""

from __future__ import annotations

import time
from collections.abc import Callable

import click
import numpy as np
import torch
from torch import Tensor, nn

from unisim_blender.core import native
from unisim_blender.core.model.networks import mlp, run_mlp
from unisim_blender.core.ops.encode import encode, encode_reference
from unisim_blender.core.ops.grid_shape import GridArrays, GridShape
from unisim_blender.core.presets import preset

Case = tuple[str, Callable[[], Tensor], Callable[[], Tensor]]


def cases(samples: int) -> list[Case]:
    """Each kernel at the sizes of preset `small`: name, compiled, plain."""
    torch.manual_seed(0)
    config = preset("small").model
    g = config.static_grid
    grid = GridArrays(GridShape.cubic((240.0, 120.0, 40.0), g.coarsest, g.finest, g.levels, g.features, g.log2_table))
    table = nn.Parameter(torch.randn(grid.rows, g.features))
    # rays of samples: neighbours share voxels, as they do in an image
    start = torch.rand(samples // 16, 1, 3)
    x = (start + torch.linspace(0, 0.01, 16)[:, None] * torch.randn(samples // 16, 1, 3)).clamp(0, 1).reshape(-1, 3)
    network = mlp(grid.shape.width, config.hidden, 1 + config.features)
    encoding = torch.randn(len(x), grid.shape.width, requires_grad=True)
    return [
        ("hash grid", lambda: encode(grid, table, x), lambda: encode_reference(grid, table, x)),
        ("network", lambda: run_mlp(network, encoding), lambda: network(encoding)),
        ("network, distance", lambda: run_mlp(network, encoding, 1), lambda: _first(network, encoding)),
    ]


def _first(network: nn.Sequential, x: Tensor) -> Tensor:
    last = network[-1]
    assert isinstance(last, nn.Linear)
    return nn.functional.linear(network[:-1](x), last.weight[:1], last.bias[:1])


def timed(function: Callable[[], Tensor]) -> tuple[float, float]:
    """Seconds forward and backward."""
    begun = time.perf_counter()
    out = function()
    between = time.perf_counter()
    out.backward(torch.ones_like(out))
    return between - begun, time.perf_counter() - between


@click.command()
@click.option("--samples", default=65536, show_default=True)
@click.option("--rounds", default=9, show_default=True)
def main(samples: int, rounds: int) -> None:
    """Time every kernel and its reference in turn."""
    click.echo(
        f"variant {native.variant()}, {torch.get_num_threads()} threads, {samples} samples, medians of {rounds} rounds"
    )
    for name, compiled, plain in cases(samples):
        times = np.array([(timed(compiled), timed(plain)) for _ in range(rounds)])
        fast, slow = np.median(times, axis=0) * 1e3
        click.echo(
            f"{name:18} forward {fast[0]:6.1f} ms, torch {slow[0]:6.1f} ms, ratio {slow[0] / fast[0]:4.1f}   "
            f"backward {fast[1]:6.1f} ms, torch {slow[1]:6.1f} ms, ratio {slow[1] / fast[1]:4.1f}"
        )


if __name__ == "__main__":
    main()
