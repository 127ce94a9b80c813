"""Images as one film."""

from __future__ import annotations

from collections.abc import Iterable
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
    writer: Any = None
    given = 0
    for given, image in enumerate(images, 1):
        rgb = image if isinstance(image, np.ndarray) else np.asarray(Image.open(image).convert("RGB"))
        height, width = (side // 2 * 2 for side in rgb.shape[:2])
        if writer is None:
            writer = _writer(path, (width, height), frames_per_second)
        try:
            writer.send(np.ascontiguousarray(rgb[:height, :width]))
        except OSError:
            return given  # the encoder has ended: its file tells how far it came
    if writer is not None:
        writer.close()
    return given


def _writer(path: Path, size: tuple[int, int], frames_per_second: float) -> Any:
    untyped: Any = imageio_ffmpeg.write_frames
    writer = untyped(
        str(path),
        size,
        fps=frames_per_second,
        codec="libx264",
        quality=8,
        macro_block_size=2,
        output_params=["-f", "mp4"],
    )
    writer.send(None)
    return writer


def _frames_of(path: Path) -> int:
    """How many frames of a film can be read: ffmpeg's writer does not tell whether it could write them."""
    untyped: Any = imageio_ffmpeg.count_frames_and_secs
    try:
        return int(untyped(str(path))[0])
    except RuntimeError:
        return 0
