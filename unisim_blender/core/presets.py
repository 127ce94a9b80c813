"""Presets by name: what a training does, which is the method, the model's shapes and the loss.

Their order is that of the names in the command line's help and in Blender.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

from .errors import SceneError
from .model.config import GridConfig, ModelConfig, SampleConfig
from .registry import Registry

Ablation = Literal["decoder", "actor-prior", "tracklet-refinement", "poses", "lidar"]
"""Parts that a training can leave out, see `training/config.py`."""
SignedDistance = Literal["logistic", "unisim"]


@dataclass(frozen=True)
class LossWeights:
    """Each preset states those of its terms; a term of weight 0 is not part of its loss."""

    rgb: float = 0.0
    chroma: float = 0.0
    """How much more what is not grey of a difference of colours counts, see `losses.colour_squares`."""
    perceptual: float = 0.0
    lidar_depth: float = 0.0
    lidar_reach: float = 0.0
    lidar_opacity: float = 0.0
    lidar_free: float = 0.0
    lidar_intensity: float = 0.0
    lidar_drop: float = 0.0
    sdf_band: float = 0.0
    eikonal: float = 0.0
    normal_smoothness: float = 0.0
    distortion: float = 0.0
    unobserved: float = 0.0
    adversarial: float = 0.0
    latent: float = 0.0
    exposure: float = 0.0
    """Keeps images' gains near 1."""


OUR_WEIGHTS = LossWeights(
    rgb=3.0,
    chroma=7.0,
    perceptual=0.01,
    lidar_depth=0.05,
    lidar_reach=0.02,
    lidar_opacity=0.01,
    lidar_free=0.05,
    lidar_intensity=0.1,
    lidar_drop=0.02,
    sdf_band=0.1,
    eikonal=0.0015,
    normal_smoothness=0.0012,
    distortion=0.0003,
    unobserved=0.02,
    adversarial=0.001,
    latent=1e-5,
    exposure=0.02,
)


@dataclass(frozen=True)
class Preset:
    """How a scene is trained, by the name that `unisim train --preset` has for it. The defaults are those of our
    method."""

    name: str
    title: str
    about: str
    """One line for people, without a full stop."""
    model: ModelConfig
    method: str = "neural"
    """Whose method it is: "neural" is ours. `scene.json` keeps it, and it is the name of the scene's renderer."""
    weights: LossWeights = OUR_WEIGHTS
    mirrored: float = 0.1
    """Chance that a step sees a vehicle mirrored. What was never recorded learns from the other side all the same; with
    a half, a lit side and a shaded one would blend."""
    refines_tracklets: bool = True
    refines_cameras: bool = True
    poses: bool = True
    """Whether actors of classes that deform have a field for each pose of their gait, not one for all."""
    ablations: tuple[Ablation, ...] = ("decoder", "actor-prior", "tracklet-refinement", "poses")
    """Ablations that can be chosen: parts that training leaves out (`unisim train --without`)."""
    densities: tuple[SignedDistance, ...] = ("logistic", "unisim")
    """Densities that can be chosen in place of the model's own (`--density`)."""
    can_be_adversarial: bool = True
    is_baseline: bool = False
    """Whether it is there to be compared with, and not offered in Blender."""
    uses_lidar: bool = True
    rays: int | None = None
    """Rays of the cameras in a step, where a preset is made for so many: learning rates then follow from their number."""
    all_rays: int | None = None
    """Rays of the cameras in a whole training that is given neither a time nor a number of steps."""
    bfloat16: bool = False
    """Whether the fields' networks multiply bfloat16."""


PRESETS: Registry[Preset] = Registry("a preset")
"""The registered presets by the name that `unisim train --preset` has for them."""
register = PRESETS.register


def preset(name: str) -> Preset:
    """Return the preset of that name. Raises `SceneError`, which lists the names."""
    if name not in PRESETS:
        raise SceneError(f"no preset {name!r}: there are {', '.join(PRESETS)}")
    return PRESETS[name]


def methods() -> tuple[str, ...]:
    """Return the methods that scenes can be trained by."""
    return tuple(dict.fromkeys(preset.method for preset in PRESETS.values()))


SMALL_SHAPES = ModelConfig(
    static_grid=GridConfig(3.2, 0.05, 8, 4, 19),
    background_grid=GridConfig(8, 2048, 8, 4, 17),
    actor_grid=GridConfig(4, 64, 6, 4, 13),
    samples=SampleConfig(32, 12, 10, 8, 16, 6),
    light="ground",
    decoder_blocks=1,
    decoder_kernel=1,
    upsample=1,
)
TINY_SHAPES = ModelConfig(
    static_grid=GridConfig(3.2, 0.1, 6, 4, 15),
    background_grid=GridConfig(8, 256, 4, 4, 13),
    actor_grid=GridConfig(4, 32, 4, 4, 11),
    samples=SampleConfig(12, 8, 6, 4, 4, 2),
    light="ground",
    hidden=32,
    features=15,
    latent=16,
    hyper_hidden=16,
    decoder_channels=16,
    decoder_blocks=1,
)
COMPACT_SHAPES = replace(
    SMALL_SHAPES,
    static_grid=GridConfig(3.2, 0.05, 8, 4, 17),
    background_grid=GridConfig(8, 1024, 6, 4, 15),
    actor_grid=GridConfig(4, 48, 5, 4, 12),
)
PAPER_SHAPES = ModelConfig(
    static_grid=GridConfig(7.5, 0.03, 16, 2, 21),
    background_grid=GridConfig(16, 4096, 16, 2, 19),
    actor_grid=GridConfig(16, 256, 8, 2, 14),
    samples=SampleConfig(48, 32, 24, 24, 24, 16),
    hidden=32,
    features=32,
    head="sample",
    density="unisim",
    decoder_kernel=7,
    upsample=3,
)
# a ray for nine pixels; with kernels of one pixel rays can be learnt from scattered, which is worth more than
# looking aside
HD_SHAPES = replace(SMALL_SHAPES, upsample=3)
# a few visits to every pixel of six cameras 1920 wide need tables that collide less
HD_GPU_SHAPES = replace(
    HD_SHAPES, static_grid=GridConfig(3.2, 0.03, 8, 4, 21), background_grid=GridConfig(8, 4096, 8, 4, 19)
)
for _preset in (
    Preset("tiny", "Tiny", "For tests", TINY_SHAPES),
    Preset("compact", "Compact", "For scenes of a few megabytes", COMPACT_SHAPES),
    Preset("small", "Small", "For training on two processor cores", SMALL_SHAPES),
    Preset("hd", "HD", "For images that are learnt and rendered 1920 wide", HD_SHAPES),
    Preset(
        "hd-gpu",
        "HD on a GPU",
        "For full-size images of six cameras on a GPU, untried there",
        HD_GPU_SHAPES,
        rays=32768,
        all_rays=600_000_000,
        bfloat16=True,
    ),
    Preset("paper", "Paper", "The sizes of the paper's re-implementation, for a GPU", PAPER_SHAPES),
):
    register(_preset)

BASELINE_SHAPES = replace(
    SMALL_SHAPES, samples=SampleConfig(48, 24, 12, 12, 16, 8), light="fixed", colour="sample", density="volume",
    decoder_kernel=1, upsample=1,
)  # fmt: skip
"""Shapes of the baselines: those of ``small``, with a density of its own and a colour at every sample."""
BASELINE_WEIGHTS = LossWeights(
    rgb=3.0, lidar_depth=0.05, lidar_reach=0.02, lidar_intensity=0.1, lidar_drop=0.02, latent=1e-5
)


def baseline(name: str, title: str, about: str, model: ModelConfig) -> Preset:
    """Return a baseline's preset; its method has its name.

    Baselines do what their papers say, with our rays, samples and optimisers: squared errors of colours, depths at LiDAR
    returns, and nothing of what shapes a signed distance, refines poses or continues what nobody saw.
    """
    return Preset(
        name, title, about, model, name, BASELINE_WEIGHTS, mirrored=0.0, refines_tracklets=False, refines_cameras=False,
        ablations=("lidar",), densities=(), can_be_adversarial=False, is_baseline=True,
        poses=False,
    )  # fmt: skip


# after Instant-NGP (Mueller et al., 2022): one density for everything that is there, moving or not
NGP_SHAPES = replace(BASELINE_SHAPES, actors="none")
register(baseline("ngp", "Instant-NGP", "Baseline: one field for everything, without actors", NGP_SHAPES))
# after Neural Scene Graphs (Ost et al., 2021): a density for what stands still, one conditioned by latents for actors
NSG_SHAPES = replace(BASELINE_SHAPES, actors="latent")
register(baseline("nsg", "Neural Scene Graphs", "Baseline: one network for all actors", NSG_SHAPES))
