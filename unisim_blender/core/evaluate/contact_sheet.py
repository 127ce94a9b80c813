"""Recorded, replayed, edited and true images side by side, and their sweeps from above."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..colour import bytes_from_srgb
from ..files import write_file
from ..geometry import BoolArray, FloatArray, invert_pose, transform_points
from ..output.frame_files import png_bytes
from .images import Tile, difference_image, outline, sheet, sweep_image
from .metrics import ImageArray

SWEEP_METRES_PER_PIXEL = 0.17


class CameraRow(NamedTuple):
    """One frame's images, side by side."""

    recorded: Tile
    replay: Tile
    edited: Tile
    truth: Tile
    difference: Tile


def camera_row(
    label: str,
    recorded: ImageArray | None,
    replay: ImageArray | None,
    edited: ImageArray,
    truth: ImageArray,
    region: BoolArray,
) -> CameraRow:
    """One frame's images (H, W, 3); the edited region (H, W) is outlined in the difference. What is
    None stays empty."""
    blank = np.zeros((*truth.shape[:2], 3), np.uint8)
    return CameraRow(
        Tile(f"{label}: recorded", blank if recorded is None else bytes_from_srgb(recorded)),
        Tile("replay", blank if replay is None else bytes_from_srgb(replay)),
        Tile("edited", bytes_from_srgb(edited)),
        Tile("truth of the edit", bytes_from_srgb(truth)),
        Tile("difference (white: 0.25)", outline(difference_image(edited, truth), region)),
    )


def sweep_tile(
    label: str, points: FloatArray, intensity: NDArray[np.float32], world_from_ego: FloatArray, size: tuple[int, int]
) -> Tile:
    """A sweep's points (N, 3), world frame, from above, the vehicle in the middle and heading up; size
    is width, height."""
    local = transform_points(invert_pose(world_from_ego), points)
    return Tile(label, sweep_image(local, intensity, *size, SWEEP_METRES_PER_PIXEL))


def write_contact_sheet(path: Path, rows: Sequence[Sequence[Tile]]) -> None:
    """Write rows of images as one PNG. Raises `OutputError`."""
    write_file(path, png_bytes(sheet(rows)))
