"""A camera's pictures as one film."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from PIL import Image

from ..files import partial_file


def write_video(pictures: list[Path], path: Path, frames_per_second: float) -> None:
    """Write PNG files of one size as H.264 in MP4; an odd last row or column is cut off. Raises `OutputError`."""
    width, height = Image.open(pictures[0]).size
    width, height = width // 2 * 2, height // 2 * 2
    with partial_file(path) as temporary:
        untyped: Any = imageio_ffmpeg.write_frames
        writer = untyped(
            str(temporary),
            (width, height),
            fps=frames_per_second,
            codec="libx264",
            quality=8,
            macro_block_size=2,
            output_params=["-f", "mp4"],
        )
        writer.send(None)
        for picture in pictures:
            rgb = np.asarray(Image.open(picture).convert("RGB"))[:height, :width]
            writer.send(np.ascontiguousarray(rgb))
        writer.close()
