"""Images as one film."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..errors import OutputError
from ..files import partial_file

MAX_RATE_HZ = 240.0
"""The highest rate at which images of uneven times are played."""
EVEN_TOLERANCE = 0.02
"""Relative difference of steps from their mean up to which times count as evenly spaced."""


def playback(times_s: Sequence[float], least_hz: float = 0.0) -> tuple[float, list[int]]:
    """Return a rate in frames per second, and the number of frames that each image is shown for.

    Evenly spaced times (N,), ascending, in seconds, are played at their own rate, one frame each. Other ones at a rate
    at which the shortest step lasts a frame, within ``least_hz`` and `MAX_RATE_HZ`: each image is shown until the time
    of the next one, the last for one frame. An image whose step is shorter than half a frame is not shown.
    """
    steps = np.diff(np.asarray(times_s, float))
    if not len(steps):
        return least_hz or 10.0, [1] * len(times_s)
    if np.ptp(steps) <= EVEN_TOLERANCE * steps.mean() and 1 / steps.mean() >= least_hz:
        return float(1 / steps.mean()), [1] * len(times_s)
    rate = float(max(min(1 / steps.min(), MAX_RATE_HZ), least_hz))
    ticks = np.round((np.asarray(times_s, float) - times_s[0]) * rate).astype(int)
    return rate, [*np.diff(ticks).tolist(), 1]


def write_video(images: Iterable[Path | NDArray[np.uint8]], path: Path, frames_per_second: float) -> None:
    """Write images of one size, PNG files or arrays (H, W, 3) uint8 sRGB, as H.264 in MP4; an odd last row or column is
    cut.

    Raises `OutputError`.
    """
    with partial_file(path) as temporary:
        given = _encode(images, temporary, frames_per_second)
        count = _frames_of(temporary)
        if count != given:
            raise OutputError(
                f"{path}: cannot be written: the encoder left {count} of {given} frames; is the disk full?"
            )


def _encode(images: Iterable[Path | NDArray[np.uint8]], path: Path, frames_per_second: float) -> int:
    """Encode images and return how many were given, up to that at which the encoder ended."""
    encoder: subprocess.Popen[bytes] | None = None
    given = 0
    try:
        for image in images:
            given += 1
            rgb = image if isinstance(image, np.ndarray) else np.asarray(Image.open(image).convert("RGB"))
            height, width = (side // 2 * 2 for side in rgb.shape[:2])
            if encoder is None:
                encoder = _encoder(path, (width, height), frames_per_second)
            assert encoder.stdin is not None
            try:
                encoder.stdin.write(rgb[:height, :width].tobytes())
            except OSError:
                return given  # the encoder has ended: its file tells how far it came
        if encoder is not None:
            encoder.communicate()
    finally:
        if encoder is not None and encoder.poll() is None:
            encoder.kill()
            encoder.wait()
    return given


def _encoder(path: Path, size: tuple[int, int], frames_per_second: float) -> subprocess.Popen[bytes]:
    """Return ffmpeg, which reads RGB images of ``size``, width and height, from its standard input."""
    import imageio_ffmpeg  # here: Blender's own Python plays films, and writes none

    rate = str(Fraction(frames_per_second).limit_denominator())
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    command += ["-s", f"{size[0]}x{size[1]}", "-r", rate, "-i", "-", "-an"]
    command += ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "10", "-f", "mp4", f"file:{path}"]
    # not imageio's writer: its function between fork and exec lets gRPC's threads close the encoder's pipes
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, process_group=0)


def _frames_of(path: Path) -> int:
    """Return the number of frames of a film that can be read: ffmpeg's writer does not report whether it wrote them."""
    import imageio_ffmpeg

    untyped: Any = imageio_ffmpeg.count_frames_and_secs
    try:
        return int(untyped(str(path))[0])
    except RuntimeError:
        return 0
