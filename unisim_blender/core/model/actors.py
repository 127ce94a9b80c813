"""Fields of actors. Each actor has a row of ``tables``; the network after it is shared by all.

A trained scene has the tables; only training needs the parameters that they are computed from.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from ..ops.encode import GradientSink, encode
from ..ops.field_values import FieldValues, log_densities, signed_distances
from ..ops.grid_shape import GridArrays
from ..ops.mlp import two_layers
from .config import ModelConfig
from .fields import Density, parts, query, start_at, values_of
from .networks import mlp, run_mlp, two_layers_of
from .shapes import (
    GAIT_BINS,
    GAIT_HARMONICS,
    LATENT_OCTAVES,
    GaitRows,
    actor_grid,
    actor_row,
    gait_basis,
    gait_rows,
    perceptrons,
)

INITIAL_DISTANCE_M, INITIAL_LOG_DENSITY = 0.3, -1.5
"""Initial output of an actor's field: it must not stop a ray that enters the box."""


class ActorField(nn.Module, ABC):
    """Base class of the fields of actors. ``row`` is the shape of one actor's own parameters."""

    OWN: tuple[str, ...]
    """Names of the parameters that the tables are computed from."""
    row: tuple[int, ...]
    network: nn.Sequential

    def __init__(self, density: Density) -> None:
        super().__init__()
        self.density = density
        self.gaits: Gaits | None = None
        self.sink: GradientSink | None = None
        """Where training set it, hash grids leave their gradients here, see `encode`."""

    @abstractmethod
    def own_rows(self) -> Tensor:
        """Return the rows (actors, *row) of all actors, without those of poses; grids are queried by these, too."""

    def tables(self) -> Tensor:
        """Return the rows of all actors, and behind them those of poses (`GaitRows`): (rows, *row)."""
        return self.posed(self.own_rows())

    def posed(self, rows: Tensor) -> Tensor:
        """Return rows (actors, *row) with those of poses behind them."""
        return rows if self.gaits is None else self.gaits(rows)

    @abstractmethod
    def _query(self, tables: Tensor, x: Tensor, actor: Tensor, outputs: int | None) -> Tensor: ...

    def own(self) -> list[nn.Parameter]:
        """Return the parameters that `tables` is computed from."""
        return [parameter for name, parameter in self.named_parameters() if name.startswith((*self.OWN, "gaits"))]

    def drop_own(self) -> None:
        """Remove the parameters that `tables` is computed from: baked tables take their place."""
        for name in self.OWN:
            delattr(self, name)

    def penalty(self) -> Tensor | None:
        """Return the mean square of the latents; None where there are none."""
        latents = self.get_parameter("latents") if "latents" in self.OWN else None
        return None if latents is None or not len(latents) else latents.square().mean()

    def forward(self, tables: Tensor, x: Tensor, actor: Tensor) -> tuple[FieldValues, Tensor]:
        """Return values (N,) and features (N, F) at points x (N, 3) in the unit cube of each point's actor (N,)
        int64."""
        output, feature = parts(self._query(tables, x, actor, None))
        return values_of(self.density, output), feature

    def values(self, tables: Tensor, x: Tensor, actor: Tensor) -> FieldValues:
        """Return the values (N,) alone."""
        return values_of(self.density, self._query(tables, x, actor, 1)[:, 0])

    def signed_distance(self, tables: Tensor, x: Tensor, actor: Tensor) -> Tensor:
        """Return signed distances (N,), metres. Raises TypeError for a field of densities."""
        return signed_distances(self.values(tables, x, actor))

    def log_density(self, tables: Tensor, x: Tensor, actor: Tensor) -> Tensor:
        """Return logarithms (N,) of densities in 1 / metres. Raises TypeError for a field of signed distances."""
        return log_densities(self.values(tables, x, actor))


class Gaits(nn.Module):
    """Tables of the poses of actors that change their shape, in bins of the phase of a gait.

    A pose's table is the actor's own plus a sum of its ``tables`` (G, 2 GAIT_HARMONICS, *row) by factors that are smooth in
    the phase. ``first`` and ``cycles_m`` (actors,) are those of `GaitRows`.
    """

    def __init__(self, config: ModelConfig, rows: GaitRows) -> None:
        super().__init__()
        count = len(config.gaits)
        shape = count, 2 * GAIT_HARMONICS, *actor_row(config)
        self.tables = nn.Parameter(torch.zeros(shape))
        self.register_buffer("basis", torch.as_tensor(gait_basis()).float(), persistent=False)
        self.register_buffer("first", torch.as_tensor(rows.first).long(), persistent=False)
        self.register_buffer("cycles_m", torch.as_tensor(rows.cycles_m), persistent=False)
        self.register_buffer("owner", torch.as_tensor(rows.owner), persistent=False)
        self.sink: GradientSink | None = None
        """Where training set it, encodings by ``tables`` leave their gradients here."""

    basis: Tensor
    first: Tensor
    cycles_m: Tensor
    owner: Tensor

    def forward(self, rows: Tensor) -> Tensor:
        """Return the actors' own rows (actors, *row), and behind them the tables of poses (G * GAIT_BINS, *row)."""
        walkers = self.owner[len(rows) :: GAIT_BINS]
        changes = (self.basis.to(rows) @ self.tables.flatten(2)).view(len(walkers), GAIT_BINS, *rows.shape[1:])
        return torch.cat([rows, (rows[walkers, None] + changes).flatten(0, 1)])

    def changes(self, grid: GridArrays, x: Tensor, row: Tensor) -> Tensor:
        """Return what poses add to the encodings (N, width) by actors' own tables: of points x (N, 3) in the rows (N,) of
        poses. An encoding is linear in its table, so the tables of poses need not be made."""
        walker, phase = (
            (row - len(self.first)).div(GAIT_BINS, rounding_mode="floor"),
            (row - len(self.first)) % GAIT_BINS,
        )
        count = 2 * GAIT_HARMONICS
        index = walker[:, None] * count + torch.arange(count, device=row.device)
        parts = encode(grid, self.tables.flatten(0, 1), x.repeat_interleave(count, 0), index.flatten(), self.sink)
        return (self.basis[phase, :, None].to(parts) * parts.view(len(row), count, -1)).sum(1)


class GridActors(ActorField):
    """Each actor has a hash grid, which it learns by itself."""

    OWN: tuple[str, ...] = ("own_tables",)

    def __init__(self, config: ModelConfig, actors: int) -> None:
        super().__init__(config.density)
        self.grid = GridArrays(actor_grid(config))
        self.row = actor_row(config)
        self._make_own(config, actors)
        self.network = mlp(*perceptrons(config)["actors.network"])
        start_at(self.network, self.density, INITIAL_DISTANCE_M, INITIAL_LOG_DENSITY)

    def _make_own(self, config: ModelConfig, actors: int) -> None:
        self.own_tables = nn.Parameter(torch.empty(actors, *self.row).uniform_(-1e-4, 1e-4))

    def own_rows(self) -> Tensor:
        """Every actor's grid (actors, rows, features)."""
        return self.own_tables

    def _query(self, tables: Tensor, x: Tensor, actor: Tensor, outputs: int | None) -> Tensor:
        gaits = self.gaits
        if gaits is None or len(tables) > len(gaits.first):
            return query(self.grid, tables, self.network, x, actor, outputs, self.sink)
        # the tables of poses were not made
        own, posed = gaits.owner[actor], torch.nonzero(actor >= len(tables))[:, 0]
        if len(posed) == 0:
            return query(self.grid, tables, self.network, x, own, outputs, self.sink)
        code = encode(self.grid, tables, x, own, self.sink)
        code = code.index_add(0, posed, gaits.changes(self.grid, x[posed], actor[posed]))
        return two_layers(code, *two_layers_of(self.network, outputs))


class HypernetworkActors(GridActors):
    """Each actor's latent goes through one hypernetwork to that actor's own hash grid."""

    OWN: tuple[str, ...] = ("hypernetwork", "latents")

    def _make_own(self, config: ModelConfig, actors: int) -> None:
        self.latents = nn.Parameter(torch.randn(actors, config.latent))
        self.hypernetwork = mlp(*perceptrons(config)["actors.hypernetwork"])
        last = self.hypernetwork[-1]
        assert isinstance(last, nn.Linear)
        nn.init.uniform_(last.weight, -1e-3, 1e-3)
        nn.init.zeros_(last.bias)

    def own_rows(self) -> Tensor:
        """Every actor's grid (actors, rows, features), from its latent."""
        out: Tensor = self.hypernetwork(self.latents)
        return out.view(len(self.latents), *self.row)


class LatentActors(ActorField):
    """Each actor is a latent that goes with points, encoded by sines, into one network for all: Ost et al., "Neural
    Scene Graphs for Dynamic Scenes", CVPR 2021, eq. 5, the encoding as in Mildenhall et al., "NeRF", 2020, eq. 4."""

    OWN = ("latents",)

    def __init__(self, config: ModelConfig, actors: int) -> None:
        super().__init__(config.density)
        self.row = actor_row(config)
        self.latents = nn.Parameter(torch.randn(actors, config.latent))
        self.network = mlp(*perceptrons(config)["actors.network"])
        start_at(self.network, self.density, INITIAL_DISTANCE_M, INITIAL_LOG_DENSITY)
        octaves = math.pi * 2.0 ** torch.arange(LATENT_OCTAVES)
        self.register_buffer("octaves", octaves, persistent=False)

    octaves: Tensor

    def own_rows(self) -> Tensor:
        """Every actor's latent (actors, latent)."""
        return self.latents

    def _query(self, tables: Tensor, x: Tensor, actor: Tensor, outputs: int | None) -> Tensor:
        y = 2 * x - 1
        angles = (y[..., None] * self.octaves).flatten(1)
        inputs = torch.cat([y, torch.sin(angles), torch.cos(angles), tables.index_select(0, actor)], -1)
        return run_mlp(self.network, inputs, outputs)


def actor_field(config: ModelConfig, actors: Sequence[str]) -> ActorField:
    """Return the configuration's field of the actors of these ids."""
    kinds: dict[str, Callable[[ModelConfig, int], ActorField]] = {
        "hypernetwork": HypernetworkActors,
        "tables": GridActors,
        "latent": LatentActors,
        "none": GridActors,
    }
    field = kinds[config.actors](config, len(actors))
    if config.gaits:
        field.gaits = Gaits(config, gait_rows(config, actors))
    return field
