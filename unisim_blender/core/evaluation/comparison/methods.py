"""Methods that can be compared: ours, its ablations, and the baselines."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...errors import UnisimError
from ...prepare.selection import select_frames
from ...presets import SignedDistance
from ...world.drive import Drive


@dataclass(frozen=True)
class Method:
    """How a method's scene is trained; or ``untrained``, the renderer that makes do without one."""

    title: str
    preset: str = "small"
    without: tuple[str, ...] = ()
    density: SignedDistance | None = None
    adversarial: bool = False
    untrained: str | None = None


OURS: dict[str, Method] = {"unisim": Method("UniSim, ours")}
ABLATIONS: dict[str, Method] = {
    "no-decoder": Method("ours, no decoder", without=("decoder",)),
    "no-actor-prior": Method("ours, no actor prior", without=("actor-prior",)),
    "no-refinement": Method("ours, no tracklet refinement", without=("tracklet-refinement",)),
    "adversarial": Method("ours, with the adversarial loss", adversarial=True),
    "unisim-density": Method("ours, density of the paper", density="unisim"),
}
BASELINES: dict[str, Method] = {
    "ngp": Method("Instant-NGP, with LiDAR", preset="ngp"),
    "ngp-images": Method("Instant-NGP, images alone", preset="ngp", without=("lidar",)),
    "nsg": Method("NSG", preset="nsg"),
    "surfel": Method("LiDARsim (surfels)", untrained="surfel"),
    "warp": Method("FVS (warping)", untrained="warp"),
}
METHODS = {**OURS, **ABLATIONS, **BASELINES}
"""By the name that the command line has for them, in the table's order."""
USUAL = ("unisim", "ngp", "nsg", "surfel", "warp")
"""Those compared where nobody names others: the paper's table 1."""


def methods_named(names: tuple[str, ...] | None) -> dict[str, Method]:
    """The methods of these names ("all" for every one), in the table's order. UnisimError lists
    those that there are."""
    wanted = USUAL if names is None else tuple(METHODS) if names == ("all",) else names
    for name in wanted:
        if name not in METHODS:
            raise UnisimError(f"no method {name!r}: there are {', '.join(METHODS)}, or all")
    return {name: method for name, method in METHODS.items() if name in wanted}


@dataclass(frozen=True)
class CompareOptions:
    """Each training has ``minutes``, or ``iterations`` where those are given. ``frames`` are trained on and looked at;
    every other one is compared in the replay, and ``truth_frames`` of them in each edit. Without ``cameras`` the one
    that looks ahead is. ``scenarios``: None for a street's usual edits. ``disturb`` is the noise on moving actors'
    boxes, metres and degrees, that trainings begin with."""

    methods: tuple[str, ...] | None = None
    minutes: float = 10.0
    iterations: int | None = None
    frames: str = "::2"
    cameras: tuple[str, ...] = ()
    width: int = 320
    truth_frames: int = 8
    scenarios: tuple[Path, ...] | None = None
    disturb: tuple[float, float] | None = None
    quality: str = "balanced"
    device: str = "cpu"
    seed: int = 0
    lpips: Path | None = None
    fid: Path | None = None

    def training_frames(self, drive: Drive) -> tuple[int, ...]:
        """Return the frames of a drive to train on. Raises `UnisimError`."""
        return select_frames(self.frames, drive.frames)
