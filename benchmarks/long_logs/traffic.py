"""The boxes of a long drive: some are there at any time, each for a few seconds, and half of them move."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from unisim_blender.core.geometry import FloatArray

AT_ONCE, STAYS = 60, 40
"""Boxes in a frame, and frames that each stays for, ten a second."""
SIZE_M = (4.5, 1.9, 1.6)
SPEED_M_S = 8.0
"""The vehicle's own."""


@dataclass(frozen=True)
class Box:
    """A box in a frame: where its centre is (3,) seen from the vehicle; it is turned as the vehicle is."""

    uid: int
    place_m: FloatArray


def boxes_of(frame: int, frames: int) -> Iterator[Box]:
    """Give the boxes of a frame of so many, ten a second."""
    for uid in range(frames * AT_ONCE // STAYS + AT_ONCE):
        first = uid * STAYS // AT_ONCE - STAYS
        if first < frame <= first + STAYS:
            passed_m = (frame - first) * 0.1 * (SPEED_M_S if uid % 2 else 2 * SPEED_M_S)
            yield Box(uid, np.array([30.0 - passed_m + uid % 7, (-1) ** uid * (4.0 + 2 * (uid % 5)), 0.8]))
