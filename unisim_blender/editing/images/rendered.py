"""The images of a rendered sequence, found in its folder."""

from __future__ import annotations

import atexit
import math
import os
import shutil
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from ...core.output.video import playback
from ...core.world.captures import US_PER_SECOND, frame_name, key_of, time_name, time_of_name

FRESH_S = 1.0
"""Time for which a listing of a folder counts as new, in seconds: a panel asks at every redraw."""
SUFFIX = ".png"

_listed: dict[Path, tuple[float, dict[str, RenderedFrames]]] = {}


@dataclass(frozen=True)
class RenderedFrames:
    """Finished images of one camera: their folder, and the first, the last and the step of their frame numbers. Those
    at times have ``times_us``, and no frame numbers."""

    folder: Path
    first: int
    last: int
    step: int
    count: int
    times_us: tuple[int, ...] = ()

    @property
    def first_path(self) -> Path:
        return self.folder / f"{time_name(self.times_us[0]) if self.times_us else frame_name(self.first)}{SUFFIX}"


def rendered_cameras(out: Path) -> dict[str, RenderedFrames]:
    """Return the finished images in a sequence's folder by camera; those of at most `FRESH_S` ago."""
    now = time.monotonic()
    before = _listed.get(out)
    if before is not None and now - before[0] < FRESH_S:
        return before[1]
    cameras = {}
    for name in _names(out / "camera"):
        frames = frames_in(out / "camera" / name)
        if frames is not None:
            cameras[name] = frames
    _listed.clear()
    _listed[out] = now, cameras
    return cameras


def frames_in(folder: Path) -> RenderedFrames | None:
    """Return the images of one camera's folder; None where there are none.

    Those of frames, or where there are none of times.
    """
    frames, times = [], []
    for stem in (Path(name).stem for name in _names(folder) if name.endswith(SUFFIX)):
        with suppress(ValueError):
            key = key_of(stem)
            frames.append(key) if isinstance(key, int) else times.append(time_of_name(key))
    if times and not frames:
        return RenderedFrames(folder, 0, 0, 1, len(times), tuple(sorted(times)))
    if not frames:
        return None
    numbers = sorted(frames)
    step = math.gcd(*(b - a for a, b in zip(numbers, numbers[1:], strict=False))) if len(numbers) > 1 else 1
    return RenderedFrames(folder, numbers[0], numbers[-1], step, len(numbers))


def _names(folder: Path) -> list[str]:
    try:
        return sorted(os.listdir(folder))
    except OSError:  # nothing is rendered yet, or it is a file
        return []


def player_command(blender: str, frames: RenderedFrames, fps: float, fps_base: float) -> list[str]:
    """Return the command line that plays images in Blender's own player at a rate of ``fps`` / ``fps_base``. Images at
    times are played as fast as they were taken: through links in a folder that is removed when this process ends.
    Raises OSError where they cannot be linked."""
    if frames.times_us:
        fps, counts = playback([time_us / US_PER_SECOND for time_us in frames.times_us], fps / fps_base)
        paths = [frames.folder / f"{time_name(time_us)}{SUFFIX}" for time_us in frames.times_us]
        first, count = _linked([path for path, shown in zip(paths, counts, strict=True) for _ in range(shown)])
        fps_base = 1.0
        range_ = ["-s", "0", "-e", str(count - 1), "-j", "1"]
    else:
        first, range_ = frames.first_path, ["-s", str(frames.first), "-e", str(frames.last), "-j", str(frames.step)]
    return [blender, "-a", "-f", f"{fps:g}", f"{fps_base:g}", *range_, str(first)]


def _linked(images: list[Path]) -> tuple[Path, int]:
    """Return the first of numbered links to images, and how many there are: the player knows numbers alone."""
    folder = Path(tempfile.mkdtemp(prefix="unisim-play-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    for number, image in enumerate(images):
        link = folder / f"{number:06d}{SUFFIX}"
        try:
            link.symlink_to(image.absolute())
        except OSError:  # Windows allows links to some users alone
            shutil.copyfile(image, link)
    return folder / f"{0:06d}{SUFFIX}", len(images)
