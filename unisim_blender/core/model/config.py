"""Shapes of a scene model."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

from ..errors import SceneError

_FORMER_MEMBERS = {"far_grid": "background_grid", "far_proposals": "background_proposals", "far": "background"}
"""Names that scene.json had before, and those of today."""


@dataclass(frozen=True)
class GridConfig:
    """Levels of a hash grid. ``coarsest`` and ``finest``: cells in metres for the static grid, cells an
    axis for the others."""

    coarsest: float
    finest: float
    levels: int
    features: int
    log2_table: int


@dataclass(frozen=True)
class SampleConfig:
    """Numbers of samples of a ray. Proposals evaluate the signed distance or the density only, to place the others."""

    static_proposals: int
    static: int
    actor_proposals: int
    actor: int
    background_proposals: int
    background: int


@dataclass(frozen=True)
class ModelConfig:
    """All sizes of a scene model."""

    static_grid: GridConfig
    background_grid: GridConfig
    actor_grid: GridConfig
    samples: SampleConfig
    hidden: int = 64
    features: int = 31
    """Length of the geometry feature that an interval carries."""
    head: Literal["ray", "sample"] = "ray"
    """Place of the view direction's input: once a ray, after compositing, or at every sample as in the paper."""
    colour: Literal["decoded", "sample"] = "decoded"
    """Composited quantity: features, which a decoder makes pixels of, or every sample's own colour, as in a NeRF."""
    density: Literal["logistic", "unisim", "volume"] = "logistic"
    """Quantity that stops a ray: a signed distance, in one of two ways, or a density of its own, as in a NeRF."""
    actors: Literal["hypernetwork", "tables", "latent", "none"] = "hypernetwork"
    """Representation of an actor: a hash grid that one hypernetwork makes of its latent, a hash grid that it learns
    alone, a latent that conditions one network for all (Ost et al., "Neural Scene Graphs for Dynamic Scenes", 2021); or
    none, with one field for everything."""
    gaits: tuple[tuple[str, float], ...] = ()
    """Ids of actors that change their shape, ascending, and metres of path in a cycle of each one's gait."""
    unisim_step_m: float = 0.2
    light: Literal["fixed", "ground"] = "fixed"
    """Whether an actor's appearance is one for all places, as in the paper, or follows the light on the
    ground under it."""
    beta: float = 20.0
    latent: int = 64
    hyper_hidden: int = 64
    hyper_layers: int = 2
    decoder_channels: int = 32
    decoder_blocks: int = 2
    decoder_kernel: int = 3
    upsample: int = 2
    """Image pixels along one edge of a cell of the feature map."""
    voxel_m: float = 0.5
    far_m: float = 3000.0

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON; without ``gaits`` where there are none, so that earlier versions read the scene."""
        values = dataclasses.asdict(self)
        return {name: value for name, value in values.items() if name != "gaits" or value}

    @staticmethod
    def from_dict(values: dict[str, Any]) -> ModelConfig:
        """Return the configuration of `to_dict`, also with former names. Raises `SceneError`, which names the value at
        fault."""
        try:
            values = _renamed(values)
            nested = {
                "static_grid": GridConfig(**values["static_grid"]),
                "background_grid": GridConfig(**values["background_grid"]),
                "actor_grid": GridConfig(**values["actor_grid"]),
                "samples": SampleConfig(**_renamed(values["samples"])),
            }
            gaits = tuple((str(uid), float(cycle_m)) for uid, cycle_m in values.get("gaits", ()))
            config = ModelConfig(**{**values, **nested, "gaits": gaits})
        except (KeyError, TypeError, ValueError) as error:
            raise SceneError(f"scene.json: the model's configuration does not fit this version: {error}") from error
        if bad := [uid for uid, cycle_m in config.gaits if not 0.01 <= cycle_m <= 1000]:
            raise SceneError(f"scene.json: model.gaits has a cycle of {bad[0]!r} that is not from 0.01 to 1000 m")
        if config.colour == "sample" and (config.upsample != 1 or config.features < 3):
            raise SceneError(
                f"scene.json: model.upsample is {config.upsample} and model.features {config.features}: samples that have "
                "colours make one pixel, of three features at least"
            )
        return config


def _renamed(values: dict[str, Any]) -> dict[str, Any]:
    """Return values by current names. Raises TypeError where a member has both of its names."""
    if twice := [f"{old} and {new}" for old, new in _FORMER_MEMBERS.items() if old in values and new in values]:
        raise TypeError(f"{twice[0]} are both given, and are the same")
    return {_FORMER_MEMBERS.get(name, name): value for name, value in values.items()}
