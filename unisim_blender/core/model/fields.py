"""Fields of the static scene and of the background; actors are in actors.py. Each field maps points to one number and a
feature.

The number determines where a ray stops: it is a signed distance in metres or, where the configuration's density is
``volume``, the logarithm of a density in 1 / metres; `FieldValues` has a type for each. The background model gives
densities.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Literal

import numpy as np
import torch
from torch import Tensor, nn

from ..geometry import FloatArray
from ..ops import field
from ..ops.constants import MAX_LOG_DENSITY
from ..ops.encode import GradientSink
from ..ops.field_values import FieldValues, LogDensities, SignedDistances, log_densities, signed_distances
from ..ops.grid_shape import GridArrays, GridShape
from .config import ModelConfig
from .networks import mlp, two_layers_of
from .shapes import background_grid, perceptrons, static_grid
from .volume import Volume


class VolumeFrame(torch.nn.Module):
    """A volume as tensors: points and directions into its own axes, and where rays enter and leave it.

    Tensors hold world points along the world's axes, less the volume's `corner`, as `recentred` makes them.
    """

    def __init__(self, volume: Volume) -> None:
        super().__init__()
        self.corner, self.diagonal_m = volume.corner, float(np.linalg.norm(volume.size_m))
        rotation = np.ascontiguousarray(volume.world_from_volume[:3, :3].T)
        self.register_buffer("rotation", torch.as_tensor(rotation).float(), persistent=False)
        self.register_buffer("size_m", torch.as_tensor(volume.size_m).float(), persistent=False)

    rotation: Tensor
    size_m: Tensor

    def recentred(self, points: FloatArray) -> Tensor:
        """Return world points (..., 3) measured from the corner, float32, subtracted in float64: float32 resolves 1e-7
        of a distance."""
        return torch.as_tensor(points - self.corner).to(self.rotation.dtype).to(self.rotation.device)

    def points(self, x: Tensor) -> Tensor:
        """Return recentred points (..., 3) along the volume's axes."""
        return x @ self.rotation.T

    def vectors(self, d: Tensor) -> Tensor:
        """Return world directions (..., 3) along the volume's axes."""
        return d @ self.rotation.T

    def inside(self, x: Tensor) -> Tensor:
        """Return which points (..., 3) in volume coordinates lie in the volume: (...) bool."""
        return ((x > 0) & (x < self.size_m)).all(-1)

    def span(self, o: Tensor, d: Tensor, near_m: float) -> tuple[Tensor, Tensor]:
        """Return where rays o, d (N, 3), volume coordinates, are inside the volume: t_near, t_far (N,), metres, t_near
        at least ``near_m``; t_far <= t_near where they miss."""
        safe = torch.where(d.abs() < 1e-9, torch.full_like(d, 1e-9), d)
        a, b = -o / safe, (self.size_m - o) / safe
        t_near = torch.minimum(a, b).amax(-1).clamp_min(near_m)
        t_far = torch.maximum(a, b).amin(-1)
        return t_near, torch.maximum(t_far, t_near)


def contract(x: Tensor, radius_m: float) -> Tensor:
    """Map points (N, 3) around the origin into the unit cube: space within ``radius_m`` to its inner half, the rest to
    the shell.

    mip-NeRF 360's contraction (Barron et al., 2022, eq. 10), moved from the ball of radius 2 into [0, 1].
    """
    x = x / radius_m
    norm = x.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    return torch.where(norm <= 1, x, (2 - 1 / norm) * x / norm) / 4 + 0.5


def contract_direction(d: Tensor) -> Tensor:
    """Map directions (N, 3) to the shell of `contract`, where rays end at infinity."""
    return d / 2 + 0.5


Density = Literal["logistic", "unisim", "volume"]

INITIAL_DISTANCE_M, INITIAL_LOG_DENSITY = 0.1, -3.5
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
    """Set the output of a new field to one value, a distance or the logarithm of a density, so that rays pass through
    it."""
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
    """Split an output (N, 1 + F) into its first column (N,) and the others (N, F); their gradients are joined in one
    step."""
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
        start_at(self.network, self.density, INITIAL_DISTANCE_M, INITIAL_LOG_DENSITY)

    size_m: Tensor

    def forward(self, x: Tensor) -> tuple[FieldValues, Tensor]:
        """Return values (N,) and features (N, F) at points (N, 3) in volume coordinates."""
        output, feature = parts(self.grid.query(self.network, x / self.size_m))
        return values_of(self.density, output), feature

    def values(self, x: Tensor) -> FieldValues:
        """Return the values (N,) alone: the last layer's other rows are not computed."""
        return values_of(self.density, self.grid.query(self.network, x / self.size_m, 1)[:, 0])

    def signed_distance(self, x: Tensor) -> Tensor:
        """Return signed distances (N,), metres. Raises TypeError for a field of densities."""
        return signed_distances(self.values(x))

    def log_density(self, x: Tensor) -> Tensor:
        """Return logarithms (N,) of densities in 1 / metres. Raises TypeError for a field of signed distances."""
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
        """Return densities (N,), as optical depth over the whole way beyond the volume, even in disparity, and features
        (N, F) at points (N, 3) in volume coordinates."""
        raw, feature = parts(self.grid.query(self.network, self._contracted(x)))
        return _bounded_density(raw), feature

    def density(self, x: Tensor) -> Tensor:
        """Return the densities (N,) alone."""
        return _bounded_density(self.grid.query(self.network, self._contracted(x), 1)[:, 0])

    def _contracted(self, x: Tensor) -> Tensor:
        return contract(x - self.frame.size_m / 2, self.radius_m)

    def sky(self, d: Tensor) -> Tensor:
        """Return features (N, F) at infinity, along directions (N, 3) in volume axes."""
        return self.grid.query(self.network, contract_direction(d))[:, 1:]


CORNERS = 4


@functools.cache
def _tetrahedron(device: torch.device, dtype: torch.dtype) -> Tensor:
    """Return its corners (4, 3), made once on each device."""
    return torch.tensor([[1.0, -1, -1], [-1, -1, 1], [-1, 1, -1], [1, 1, 1]], dtype=dtype, device=device)


def outward_gradient(
    outward: Callable[[Tensor], Tensor], x: Tensor, step_m: float, size_m: Tensor | None = None
) -> Tensor:
    """Return gradients (N, 3), per metre, at points x (N, 3), of a function ``outward`` that rises towards free space;
    of signed distances, metres per metre.

    ``outward`` gets points (N * CORNERS, 3), each point's one after the other. ``size_m`` (N, 3) is what a unit of x
    measures along its axes, for points in an actor's unit cube.
    """
    corners = _tetrahedron(x.device, x.dtype)
    offsets = step_m * corners if size_m is None else step_m * corners / size_m[:, None]
    values = outward((x[:, None] + offsets).reshape(-1, 3)).view(-1, CORNERS)
    return torch.einsum("nk,kj->nj", values, corners) / (CORNERS * step_m)
