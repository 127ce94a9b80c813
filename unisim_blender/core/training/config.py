"""How a scene is trained: the options of a training, and the recipe, its preset as these options change it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from ..errors import SceneError
from ..presets import Ablation, Preset, SignedDistance, preset

PATCH_CELLS = 16
RAYS, GPU_RAYS = 4096, 16384
"""Rays of the cameras in a step, on a CPU and on a GPU, which a step of few rays leaves idle."""


def ray_counts(device: str, rays: int | None = None) -> tuple[int, int]:
    """Return `TrainConfig`'s ``patches`` and ``lidar_rays`` for so many rays of the cameras in a step; None for the
    device's own count. LiDAR has a quarter as many."""
    rays = rays or (GPU_RAYS if device.startswith("cuda") else RAYS)
    return max(rays // PATCH_CELLS**2, 2), max(rays // 4, 1)


def steps_of(preset: Preset, patches: int) -> int | None:
    """Return how many steps of so many patches a preset asks for, None where it asks for none."""
    return None if preset.all_rays is None else math.ceil(preset.all_rays / (patches * PATCH_CELLS**2))


MOST_RATE = 2.0
"""Largest factor of `rate_factor`."""


def rate_factor(preset: Preset, rays: int) -> float:
    """Return the factor of the learning rates, which are those of `RAYS` rays in a step, for so many. Adam's grow by the
    root of a batch's size (Malladi et al., "On the SDEs and Scaling Rules for Adaptive Gradient Algorithms", 2022)."""
    return 1.0 if preset.rays is None else min(MOST_RATE, math.sqrt(rays / RAYS))


@dataclass(frozen=True)
class TrainConfig:
    """Sensors and frames to train on, and for how long. Stages are shares of the whole: geometry and colour first, then the
    perceptual term, then the tracklets and the adversarial term join in (as the re-implementation's 2500, 7500 and 10
    001 iterations do)."""

    cameras: tuple[str, ...]
    lidars: tuple[str, ...]
    frames: tuple[int, ...]
    width: int | None = None
    preset: str = "small"
    without: tuple[str, ...] = ()
    """Left out, of `ABLATIONS`."""
    density: SignedDistance | None = None
    """Which signed distance's density; None for the preset's."""
    disturb: tuple[float, float] | None = None
    """Noise on moving actors' boxes, metres and degrees, see `poses.disturbed`."""
    minutes: float | None = None
    iterations: int | None = None
    device: str = "cpu"
    seed: int = 0
    patches: int = 16
    patch_cells: int = PATCH_CELLS
    scattered: float = 0.75
    """Share of the patches that is taken apart, a ray here and a ray there, where the decoder looks at each by itself:
    a step then touches many more places. What is left serves the perceptual term."""
    lidar_rays: int = 1024
    perceptual_from: float = 0.1
    poses_from: float = 0.3
    turned_rad: float = 0.1
    """Standard deviation by which the directions that colours depend on are turned at random: a drive sees each place
    from a narrow fan of directions, and fine detail that hangs on them instead of on the place is gone a lane
    further to the side."""
    prune_from: int = 300
    settled_from: float = 0.08
    """From here on surfaces hide what is behind them: where no ray has come since, nobody saw anything."""
    unobserved_from: float = 0.15
    still_from: float = 0.92
    """From here on samples stand still, and rates fall to a tenth: what a step's draw adds to the fields wears off."""
    still_samples: float = 4.0
    """How many times as many samples a ray then has. What rises and falls again between few samples stops nothing there, but
    does at a renderer's finer steps: faint haze in front of everything."""
    rate_tables: tuple[float, float] = (1e-2, 1e-3)
    rate_networks: tuple[float, float] = (5e-3, 3e-4)
    rate_shifts: tuple[float, float] = (4e-3, 4e-4)
    rate_turns: tuple[float, float] = (1e-3, 1e-4)
    """Rates of the boxes' shifts and turns: metres and radians a step at most."""
    rate_camera_shifts: tuple[float, float] = (5e-5, 5e-6)
    rate_camera_turns: tuple[float, float] = (5e-5, 5e-6)
    rate_exposures: tuple[float, float] = (2e-3, 2e-4)
    """Rates of the logarithms of images' gains."""
    slow_every: int = 4
    """Steps whose gradients are added up before the hypernetwork, the tracklets and the camera mounts are updated: few
    rays of a step tell about one pose, and taking a gradient through the hypernetwork costs the same for one
    step as for four."""
    checkpoint_s: float = 120.0
    preview_s: float | None = None
    """At most how often a held-out image is rendered and left in the folder; None: never."""
    vgg: str | None = None
    adversarial: bool = False

    @property
    def noise(self) -> dict[str, float] | None:
        """``disturb`` as a scene's header tells of it."""
        return None if self.disturb is None else dict(zip(("metres", "degrees"), self.disturb, strict=True))


def without_decoder(preset: Preset) -> Preset:
    """Return the preset in which every sample has its own colour, and no decoder makes pixels of features."""
    return replace(preset, model=replace(preset.model, colour="sample", decoder_kernel=1, upsample=1))


def without_actor_prior(preset: Preset) -> Preset:
    """Return the preset without what actors share: the hypernetwork, and that their sides are alike."""
    return replace(preset, model=replace(preset.model, actors="tables"), mirrored=0.0)


def without_tracklet_refinement(preset: Preset) -> Preset:
    """Return the preset in which boxes stay where the log has them."""
    return replace(preset, refines_tracklets=False)


def without_lidar(preset: Preset) -> Preset:
    """Return the preset that reads no sweep."""
    absent = dict.fromkeys((name for name in vars(preset.weights) if name.startswith("lidar_")), 0.0)
    return replace(preset, weights=replace(preset.weights, **absent), uses_lidar=False)


ABLATIONS: dict[Ablation, Callable[[Preset], Preset]] = {
    "decoder": without_decoder,
    "actor-prior": without_actor_prior,
    "tracklet-refinement": without_tracklet_refinement,
    "lidar": without_lidar,
}
"""By the name that `unisim train --without` has for them."""


def recipe(config: TrainConfig) -> Preset:
    """Return the preset as a training's options change it. Raises `SceneError` naming what does not go together."""
    chosen = preset(config.preset)
    for name in config.without:
        if name not in ABLATIONS:
            raise SceneError(f"there is no ablation {name!r}: there are {', '.join(ABLATIONS)}")
        if name not in chosen.ablations:
            raise SceneError(
                f"preset {config.preset!r} cannot do without {name!r}, only without {', '.join(chosen.ablations)}"
            )
    if config.density is not None:
        if config.density not in chosen.densities:
            raise SceneError(
                f"preset {config.preset!r} does not take a density {config.density!r}: it is another method's"
            )
        chosen = replace(chosen, model=replace(chosen.model, density=config.density))
    if config.adversarial and not chosen.can_be_adversarial:
        raise SceneError(f"preset {config.preset!r} does not take an adversarial loss: it is another method's")
    for name, ablated in ABLATIONS.items():
        if name in config.without:
            chosen = ablated(chosen)
    return chosen
