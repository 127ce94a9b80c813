"""How a scene is trained."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class LossWeights:
    """Weights of the terms."""

    rgb: float = 3.0
    chroma: float = 7.0
    """How much more what is not grey of a difference of colours counts, see `losses.colour_squares`."""
    perceptual: float = 0.01
    lidar_depth: float = 0.05
    lidar_reach: float = 0.02
    lidar_opacity: float = 0.01
    lidar_free: float = 0.05
    lidar_intensity: float = 0.1
    lidar_drop: float = 0.02
    band: float = 0.1
    eikonal: float = 0.0015
    flat: float = 0.0012
    spread: float = 0.0003
    hidden: float = 0.02
    adversarial: float = 0.001
    latent: float = 1e-5


@dataclass(frozen=True)
class TrainConfig:
    """What to train on, and for how long. Stages are shares of the whole: geometry and colour first, then the perceptual term,
    then the tracklets and the adversarial term join in (as the re-implementation's 2500, 7500 and 10 001 iterations do)."""

    cameras: tuple[str, ...]
    lidars: tuple[str, ...]
    frames: tuple[int, ...]
    width: int | None = None
    preset: str = "small"
    without: tuple[str, ...] = ()
    """Parts that the method is to do without, of `recipe.PARTS`."""
    density: Literal["logistic", "unisim"] | None = None
    """Which signed distance's density; None for the preset's."""
    disturb: tuple[float, float] | None = None
    """Noise on moving actors' boxes, metres and degrees, see `disturb.disturbed`."""
    minutes: float | None = None
    iterations: int | None = None
    device: str = "cpu"
    seed: int = 0
    patches: int = 16
    patch_cells: int = 16
    scattered: float = 0.75
    """Share of the patches that is taken apart, a ray here and a ray there, where the decoder looks at each by itself: a step
    then touches many more places. What is left serves the perceptual term."""
    lidar_rays: int = 1024
    perceptual_from: float = 0.1
    poses_from: float = 0.3
    mirrored: float = 0.1
    """Chance that a step sees a vehicle mirrored. What was never recorded learns from the other side all the same; with a half,
    a lit side and a shaded one would blend."""
    turned_rad: float = 0.1
    """Standard deviation by which the directions that looks depend on are turned at random: a drive sees each place from a narrow
    fan of directions, and fine detail that hangs on them instead of on the place is gone a lane further to the side."""
    prune_from: int = 300
    settled_from: float = 0.08
    """From here on surfaces hide what is behind them: where no ray has come since, nobody saw anything."""
    hidden_from: float = 0.15
    still_from: float = 0.92
    """From here on samples stand still, and rates fall to a tenth: what a step's draw adds to the fields wears off."""
    rate_tables: tuple[float, float] = (1e-2, 1e-3)
    rate_networks: tuple[float, float] = (5e-3, 3e-4)
    rate_shifts: tuple[float, float] = (4e-3, 4e-4)
    rate_turns: tuple[float, float] = (1e-3, 1e-4)
    """Of boxes, metres and radians a step at most."""
    rate_cameras: tuple[float, float] = (5e-5, 5e-6)
    slow_every: int = 4
    """Steps whose gradients are added up before the hypernetwork, the tracklets and the camera mounts are updated: few rays of a
    step tell about one pose, and taking a gradient through the hypernetwork costs the same for one step as for four."""
    checkpoint_s: float = 120.0
    preview_s: float | None = None
    """At most how often a held-out image is rendered and left in the folder; None: never."""
    vgg: str | None = None
    adversarial: bool = False
    weights: LossWeights = field(default_factory=LossWeights)

    @property
    def noise(self) -> dict[str, float] | None:
        """``disturb`` as a scene's header tells of it."""
        return None if self.disturb is None else dict(zip(("metres", "degrees"), self.disturb, strict=True))
