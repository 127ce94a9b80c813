"""A picture from above of a moment of a rollout: returns, boxes, the plan and the recorded path about the ego vehicle."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw

from ...geometry import FloatArray
from ..states import EgoState, Footprint

AHEAD_M, BEHIND_M = 50.0, 20.0
"""What the picture shows ahead of the rear axle and behind it; as much across, half to each side."""
LOW_M, HIGH_M = -0.2, 3.0
"""Heights above the ground between which returns change their colour."""
HEIGHT_COLOURS = np.array([[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]], float)
"""From low to high: viridis (van der Walt and Smith, 2015) at even steps."""
BACKGROUND, RECORDED, BOX, EGO_BOX, PLANNED = (
    (16, 16, 20),
    (96, 96, 104),
    (230, 230, 230),
    (255, 140, 40),
    (80, 230, 120),
)


@dataclass(frozen=True)
class Overhead:
    """The square picture of ``pixels`` by ``pixels`` about an ego vehicle's ``state``, which drives upwards."""

    state: EgoState
    pixels: int

    def place(self, points: FloatArray) -> FloatArray:
        """Return the pixels (N, 2), column and row, of points (N, 2), world frame."""
        sine, cosine = math.sin(self.state.heading_rad), math.cos(self.state.heading_rad)
        offset = np.asarray(points, float) - (self.state.x_m, self.state.y_m)
        scale = self.pixels / (AHEAD_M + BEHIND_M)
        column = self.pixels / 2 - offset @ (-sine, cosine) * scale
        return np.stack([column, (AHEAD_M - offset @ (cosine, sine)) * scale], -1)

    def draw(
        self,
        returns: FloatArray,
        footprints: Iterable[Footprint],
        ego: Footprint,
        plan: FloatArray | None,
        recorded: FloatArray,
    ) -> NDArray[np.uint8]:
        """Return the picture (pixels, pixels, 3).

        ``returns`` (N, 3) are their places in the world's plane and their heights above the ground; ``plan`` (P, 2) and
        ``recorded`` (R, 2) are paths, world frame.
        """
        canvas = np.full((self.pixels, self.pixels, 3), BACKGROUND, np.uint8)
        at = np.floor(self.place(returns[:, :2])).astype(int)
        shown = ((at >= 0) & (at < self.pixels)).all(1)
        order = np.argsort(returns[shown, 2], kind="stable")  # what is higher hides what is lower
        at, heights = at[shown][order], returns[shown, 2][order]
        canvas[at[:, 1], at[:, 0]] = colours_of(heights)
        picture = Image.fromarray(canvas)
        pen = ImageDraw.Draw(picture)
        self._line(pen, recorded, RECORDED, 1)
        for one in footprints:
            self._outline(pen, one, BOX)
        if plan is not None:
            self._line(pen, plan, PLANNED, 2)
        self._outline(pen, ego, EGO_BOX)
        return np.asarray(picture)

    def _outline(self, pen: ImageDraw.ImageDraw, box: Footprint, colour: tuple[int, int, int]) -> None:
        corners = self.place(box.corners)
        pen.polygon([tuple(corner) for corner in corners], outline=colour)
        front, centre = corners[[0, 3]].mean(0), corners.mean(0)
        pen.line([tuple(centre), tuple(front)], fill=colour)

    def _line(self, pen: ImageDraw.ImageDraw, points: FloatArray, colour: tuple[int, int, int], width: int) -> None:
        if len(points) > 1:
            pen.line([tuple(place) for place in self.place(points)], fill=colour, width=width)


def colours_of(heights_m: FloatArray) -> NDArray[np.uint8]:
    """Return colours (N, 3) of heights (N,) above the ground."""
    share = np.clip((heights_m - LOW_M) / (HIGH_M - LOW_M), 0, 1) * (len(HEIGHT_COLOURS) - 1)
    steps = np.arange(len(HEIGHT_COLOURS))
    return np.stack([np.interp(share, steps, channel) for channel in HEIGHT_COLOURS.T], -1).astype(np.uint8)
