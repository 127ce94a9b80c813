"""A camera's images as one film."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from PIL import Image

from ..errors import OutputError
from ..files import partial_file


def write_video(images: list[Path], path: Path, frames_per_second: float) -> None:
    """Write PNG files of one size as H.264 in MP4; an odd last row or column is cut off. Raises `OutputError`."""
    with partial_file(path) as temporary:
        _encode(images, temporary, frames_per_second)
        count = _frames_of(temporary)
        if count != len(images):
            raise OutputError(
                f"{path}: cannot be written: the encoder left {count} of {len(images)} frames; is the disk full?"
            )


def _encode(images: list[Path], path: Path, frames_per_second: float) -> None:
    width, height = Image.open(images[0]).size
    width, height = width // 2 * 2, height // 2 * 2
    untyped: Any = imageio_ffmpeg.write_frames
    writer = untyped(
        str(path),
        (width, height),
        fps=frames_per_second,
        codec="libx264",
        quality=8,
        macro_block_size=2,
        output_params=["-f", "mp4"],
    )
    writer.send(None)
    for image in images:
        rgb = np.asarray(Image.open(image).convert("RGB"))[:height, :width]
        try:
            writer.send(np.ascontiguousarray(rgb))
        except OSError:
            return  # the encoder has ended: its file tells how far it came
    writer.close()


def _frames_of(path: Path) -> int:
    """How many frames of a film can be read: ffmpeg's writer does not tell whether it could write them."""
    untyped: Any = imageio_ffmpeg.count_frames_and_secs
    try:
        return int(untyped(str(path))[0])
    except RuntimeError:
        return 0
