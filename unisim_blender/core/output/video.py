"""Images as one film."""

from __future__ import annotations

import subprocess
from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..errors import OutputError
from ..files import partial_file


def write_video(images: Iterable[Path | NDArray[np.uint8]], path: Path, frames_per_second: float) -> None:
    """Write images of one size, PNG files or arrays (H, W, 3), as H.264 in MP4; an odd last row or column is cut off.

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
    rate = str(Fraction(frames_per_second).limit_denominator())
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    command += ["-s", f"{size[0]}x{size[1]}", "-r", rate, "-i", "-", "-an"]
    command += ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "10", "-f", "mp4", f"file:{path}"]
    # not imageio's writer: its function between fork and exec lets gRPC's threads close the encoder's pipes
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, process_group=0)


def _frames_of(path: Path) -> int:
    """How many frames of a film can be read: ffmpeg's writer does not tell whether it could write them."""
    untyped: Any = imageio_ffmpeg.count_frames_and_secs
    try:
        return int(untyped(str(path))[0])
    except RuntimeError:
        return 0
