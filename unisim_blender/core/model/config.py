"""Shapes of a scene model, and the presets by name."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, Literal

from ..errors import SceneError


@dataclass(frozen=True)
class GridConfig:
    """Levels of a hash grid. ``coarsest`` and ``finest``: cells in metres for the static grid, cells an axis for the others."""

    coarsest: float
    finest: float
    levels: int
    features: int
    log2_table: int


@dataclass(frozen=True)
class SampleConfig:
    """Samples a ray. Proposals evaluate the signed distance or the density only, to place the others."""

    static_proposals: int
    static: int
    actor_proposals: int
    actor: int
    far_proposals: int
    far: int


@dataclass(frozen=True)
class ModelConfig:
    """All sizes of a scene model."""

    static_grid: GridConfig
    far_grid: GridConfig
    actor_grid: GridConfig
    samples: SampleConfig
    hidden: int = 64
    features: int = 31
    """Length of the geometry feature that an interval carries."""
    head: Literal["ray", "sample"] = "ray"
    """Where the view direction enters: once a ray, behind compositing, or at every sample as in the paper."""
    colour: Literal["decoded", "sample"] = "decoded"
    """What is composited: features, which a decoder makes pixels of, or every sample's own colour, as in a NeRF."""
    density: Literal["logistic", "unisim", "volume"] = "logistic"
    """What stops a ray: a signed distance, in one of two ways, or a density of its own, as in a NeRF."""
    actors: Literal["hypernetwork", "tables", "latent", "none"] = "hypernetwork"
    """What an actor is: a hash grid that one hypernetwork makes of its latent, a hash grid that it learns alone, a latent that
    conditions one network for all (Ost et al., "Neural Scene Graphs for Dynamic Scenes", 2021); or nothing, in one field."""
    unisim_step_m: float = 0.2
    light: Literal["fixed", "ground"] = "fixed"
    """Whether an actor's look is one for all places, as in the paper, or follows the light on the ground under it."""
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

    @property
    def method(self) -> str:
        """Whose method this is: "ngp", one field for everything; "nsg", a scene graph of latent-coded actors; else "neural"."""
        if self.density != "volume":
            return "neural"
        return "ngp" if self.actors == "none" else "nsg"

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return dataclasses.asdict(self)

    @staticmethod
    def from_dict(values: dict[str, Any]) -> ModelConfig:
        """The inverse of `to_dict`; SceneError names what does not fit."""
        try:
            nested = {
                "static_grid": GridConfig(**values["static_grid"]),
                "far_grid": GridConfig(**values["far_grid"]),
                "actor_grid": GridConfig(**values["actor_grid"]),
                "samples": SampleConfig(**values["samples"]),
            }
            config = ModelConfig(**{**values, **nested})
        except (KeyError, TypeError) as error:
            raise SceneError(f"scene.json: the model's configuration does not fit this version: {error}") from error
        if config.colour == "sample" and (config.upsample != 1 or config.features < 3):
            raise SceneError(
                f"scene.json: model.upsample is {config.upsample} and model.features {config.features}: samples that have "
                "colours make one pixel, of three features at least"
            )
        return config


PRESETS: dict[str, ModelConfig] = {
    "tiny": ModelConfig(
        static_grid=GridConfig(3.2, 0.1, 6, 4, 15),
        far_grid=GridConfig(8, 256, 4, 4, 13),
        actor_grid=GridConfig(4, 32, 4, 4, 11),
        samples=SampleConfig(12, 8, 6, 4, 4, 2),
        light="ground",
        hidden=32,
        features=15,
        latent=16,
        hyper_hidden=16,
        decoder_channels=16,
        decoder_blocks=1,
    ),
    "small": ModelConfig(
        static_grid=GridConfig(3.2, 0.05, 8, 4, 19),
        far_grid=GridConfig(8, 2048, 8, 4, 17),
        actor_grid=GridConfig(4, 64, 6, 4, 13),
        samples=SampleConfig(32, 12, 10, 8, 16, 6),
        light="ground",
        decoder_blocks=1,
        decoder_kernel=1,
        upsample=1,
    ),
    "compact": ModelConfig(
        static_grid=GridConfig(3.2, 0.05, 8, 4, 17),
        far_grid=GridConfig(8, 1024, 6, 4, 15),
        actor_grid=GridConfig(4, 48, 5, 4, 12),
        samples=SampleConfig(32, 12, 10, 8, 16, 6),
        light="ground",
        decoder_blocks=1,
        decoder_kernel=1,
        upsample=1,
    ),
    "paper": ModelConfig(
        static_grid=GridConfig(7.5, 0.03, 16, 2, 21),
        far_grid=GridConfig(16, 4096, 16, 2, 19),
        actor_grid=GridConfig(16, 256, 8, 2, 14),
        samples=SampleConfig(48, 32, 24, 24, 24, 16),
        hidden=32,
        features=32,
        head="sample",
        density="unisim",
        decoder_kernel=7,
        upsample=3,
    ),
}
"""``tiny`` for tests, ``compact`` for scenes of some megabytes, ``small`` for two CPU cores, ``hd`` for images that are learnt
and rendered 1920 wide, ``paper`` with the re-implementation's sizes; ``ngp`` and ``nsg`` are the rivals."""

PRESETS["hd"] = dataclasses.replace(PRESETS["small"], upsample=3)
"""A ray for nine pixels. With kernels of one pixel rays can be learnt from scattered, which is worth more than looking aside."""

_RIVAL = dataclasses.replace(
    PRESETS["small"], samples=SampleConfig(48, 24, 12, 12, 16, 8), light="fixed", colour="sample", density="volume",
    decoder_kernel=1, upsample=1,
)  # fmt: skip
PRESETS["ngp"] = dataclasses.replace(_RIVAL, actors="none")
"""After Instant-NGP (Mueller et al., 2022): one density for everything that is there, moving or not."""
PRESETS["nsg"] = dataclasses.replace(_RIVAL, actors="latent")
"""After Neural Scene Graphs (Ost et al., 2021): a density for what stands still, one conditioned by latents for actors."""


def preset(name: str) -> ModelConfig:
    """The preset of that name; SceneError lists the names."""
    if name not in PRESETS:
        raise SceneError(f"no preset {name!r}: there are {', '.join(PRESETS)}")
    return PRESETS[name]
