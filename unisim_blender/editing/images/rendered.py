"""The images of a rendered sequence, found in its folder."""

from __future__ import annotations

import math
import os
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ...core.world.captures import frame_name, key_of, time_name, time_of_name

FRESH_S = 1.0
"""How long a listing of a folder counts as new: a panel asks at every redraw."""
SUFFIX = ".png"

_listed: dict[Path, tuple[float, dict[str, Frames]]] = {}


@dataclass(frozen=True)
class Frames:
    """Finished images of one camera: their folder, and the first, the last and the step of their frame numbers, or of
    their times in microseconds where they are ``timed``."""

    folder: Path
    first: int
    last: int
    step: int
    count: int
    timed: bool = False

    @property
    def first_path(self) -> Path:
        """The first image."""
        return self.folder / f"{time_name(self.first) if self.timed else frame_name(self.first)}{SUFFIX}"


def rendered_cameras(out: Path) -> dict[str, Frames]:
    """Return the finished images in a sequence's folder by camera; those of at most `FRESH_S` ago."""
    now = time.monotonic()
    before = _listed.get(out)
    if before is not None and now - before[0] < FRESH_S:
        return before[1]
    found = {}
    for name in _names(out / "camera"):
        frames = frames_in(out / "camera" / name)
        if frames is not None:
            found[name] = frames
    _listed.clear()
    _listed[out] = now, found
    return found


def frames_in(folder: Path) -> Frames | None:
    """Return the images of one camera's folder; None where there are none.

    Those of frames, or where there are none of times, of which the player needs equal steps: others count as none.
    """
    frames, times = [], []
    for stem in (Path(name).stem for name in _names(folder) if name.endswith(SUFFIX)):
        with suppress(ValueError):
            key = key_of(stem)
            frames.append(key) if isinstance(key, int) else times.append(time_of_name(key))
    numbers = sorted(frames or times)
    if not numbers:
        return None
    if not frames and (numbers[0] < 0 or len({b - a for a, b in zip(numbers, numbers[1:], strict=False)}) > 1):
        return None
    step = math.gcd(*(b - a for a, b in zip(numbers, numbers[1:], strict=False))) if len(numbers) > 1 else 1
    return Frames(folder, numbers[0], numbers[-1], step, len(numbers), timed=not frames)


def _names(folder: Path) -> list[str]:
    try:
        return sorted(os.listdir(folder))
    except OSError:  # nothing is rendered yet, or it is a file
        return []


def player_command(blender: str, frames: Frames, fps: float, fps_base: float) -> list[str]:
    """Return the command line that plays images in Blender's own player at a rate of ``fps`` / ``fps_base``."""
    range_ = ["-s", str(frames.first), "-e", str(frames.last), "-j", str(frames.step)]
    return [blender, "-a", "-f", f"{fps:g}", f"{fps_base:g}", *range_, str(frames.first_path)]
