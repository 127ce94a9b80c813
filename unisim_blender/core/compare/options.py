"""Options of a comparison."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..prepare.selection import select_frames
from ..world.drive import Drive


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
