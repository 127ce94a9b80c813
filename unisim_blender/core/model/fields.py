"""Fields of the static scene and of the background; actors are in actors.py. Each field maps points to one number and a
feature.

The number says what stops a ray: it is a signed distance in metres or, where the configuration's density is
``volume``, minus the logarithm of a density in 1 / metres. A field gives it as what it is, see `FieldValues`. The
background model gives densities.
"""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor, nn

from ..ops import field
from ..ops.constants import MAX_LOG_DENSITY
from ..ops.encode import GradientSink
from ..ops.field_values import FieldValues, LogDensities, SignedDistances, log_densities, signed_distances
from ..ops.grid_shape import GridArrays, GridShape
from .config import ModelConfig
from .networks import mlp, two_layers_of
from .shapes import background_grid, perceptrons, static_grid
from .space.volume import Volume
from .space.volume_frame import VolumeFrame, contract, contract_direction

Density = Literal["logistic", "unisim", "volume"]

INITIAL_M, INITIAL_LOG_DENSITY = 0.1, -3.5
"""Output of a new static field at every point: a distance, or the logarithm of a density that lets most of a ray
through for 30 m."""
INITIAL_BACKGROUND_LOG_DENSITY = -1.0


def query(
    grid: GridArrays,
    table: Tensor,
    network: nn.Sequential,
    x: Tensor,
    index: Tensor | None = None,
    outputs: int | None = None,
    sink: GradientSink | None = None,
) -> Tensor:
    """Return the outputs of ``network``, of two layers, for the encodings of points x (N, 3) in the unit cube: its
    first ``outputs`` columns, or all."""
    return field.query(grid, table, x, *two_layers_of(network, outputs), index, sink)


def values_of(density: Density, output: Tensor) -> FieldValues:
    """Return the field values that the first output (...) of a field's network stands for."""
    return LogDensities(-output) if density == "volume" else SignedDistances(output)


def start_at(network: nn.Sequential, density: Density, distance_m: float, log_density: float) -> None:
    """Set a new field to one value, a distance or the logarithm of a density: it is empty, a ray comes through it."""
    last = network[-1]
    assert isinstance(last, nn.Linear)
    with torch.no_grad():
        last.bias[0] = -log_density if density == "volume" else distance_m


class HashTable(nn.Module):
    """A learnable table of one grid. Training may give it a sink for its gradients, see `encode`."""

    def __init__(self, shape: GridShape) -> None:
        super().__init__()
        self.grid = GridArrays(shape)
        self.table = nn.Parameter(torch.empty(shape.rows, shape.features).uniform_(-1e-4, 1e-4))
        self.sink: GradientSink | None = None

    def query(self, network: nn.Sequential, x: Tensor, outputs: int | None = None) -> Tensor:
        """Return the outputs of a network for the encodings of points (N, 3) in the unit cube."""
        return query(self.grid, self.table, network, x, outputs=outputs, sink=self.sink)


def parts(out: Tensor) -> tuple[Tensor, Tensor]:
    """The first column (N,) and the others (N, F); their gradients are put together in one go."""
    first, others = out.split((1, out.shape[1] - 1), 1)
    return first[:, 0], others


def _bounded_density(raw: Tensor) -> Tensor:
    return torch.exp(raw.clamp_max(MAX_LOG_DENSITY))


class StaticField(nn.Module):
    """Everything that stands still inside the volume."""

    def __init__(self, config: ModelConfig, volume: Volume) -> None:
        super().__init__()
        self.grid = HashTable(static_grid(config, volume.size_m))
        self.network = mlp(*perceptrons(config)["static.network"])
        self.register_buffer("size_m", torch.as_tensor(volume.size_m).float(), persistent=False)
        self.density: Density = config.density
        start_at(self.network, self.density, INITIAL_M, INITIAL_LOG_DENSITY)

    size_m: Tensor

    def forward(self, x: Tensor) -> tuple[FieldValues, Tensor]:
        """Values (N,) and features (N, F) at points (N, 3) in volume coordinates."""
        output, feature = parts(self.grid.query(self.network, x / self.size_m))
        return values_of(self.density, output), feature

    def values(self, x: Tensor) -> FieldValues:
        """Values (N,) alone: the last layer's other rows are not computed."""
        return values_of(self.density, self.grid.query(self.network, x / self.size_m, 1)[:, 0])

    def signed_distance(self, x: Tensor) -> Tensor:
        """Signed distances (N,) in metres; TypeError where the field says densities."""
        return signed_distances(self.values(x))

    def log_density(self, x: Tensor) -> Tensor:
        """Logarithms (N,) of densities in 1 / metres; TypeError where the field says signed distances."""
        return log_densities(self.values(x))


class BackgroundModel(nn.Module):
    """Everything beyond the volume, up to the sky, in contracted coordinates about the volume's centre."""

    def __init__(self, config: ModelConfig, volume: Volume) -> None:
        super().__init__()
        self.grid = HashTable(background_grid(config))
        self.network = mlp(*perceptrons(config)["background.network"])
        self.radius_m = float(min(volume.size_m[:2]) / 2)
        self.frame = VolumeFrame(volume)
        last = self.network[-1]
        assert isinstance(last, nn.Linear)
        with torch.no_grad():
            # nearly empty: the sky comes first, and matter where it moves against the sky
            last.bias[0] = INITIAL_BACKGROUND_LOG_DENSITY

    def forward(self, x: Tensor) -> tuple[Tensor, Tensor]:
        """Densities (N,), optical depth over the whole way beyond the volume, even in disparity, and features (N, F)
        at points (N, 3) in volume coordinates."""
        raw, feature = parts(self.grid.query(self.network, self._contracted(x)))
        return _bounded_density(raw), feature

    def density(self, x: Tensor) -> Tensor:
        """Densities (N,) alone."""
        return _bounded_density(self.grid.query(self.network, self._contracted(x), 1)[:, 0])

    def _contracted(self, x: Tensor) -> Tensor:
        return contract(x - self.frame.size_m / 2, self.radius_m)

    def sky(self, d: Tensor) -> Tensor:
        """Features (N, F) at infinity, along directions (N, 3) in volume axes."""
        return self.grid.query(self.network, contract_direction(d))[:, 1:]
