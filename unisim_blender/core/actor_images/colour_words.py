"""A word for the colour of paint, from its pixels and those of the ground beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..colour import lab_from_srgb, linear_from_srgb

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
LEAST_PIXELS = 12
"""Fewer pixels of paint or of ground tell nothing."""
BELOW, ABOVE = 60, 85
"""Percentiles of the paint's luminance. Gaps, lamps and tyres make panels look darker, seldom brighter."""
BLACK, LIGHT, WHITE = 0.8, 2.6, 4.0
"""Luminance of paint over that of asphalt under the same light: black below the first at `BELOW`; light grey from the
second and white from the third at `ABOVE`."""
WHITE_L = 85.0
"""What is this light in the image, in CIE Lab, looks white whatever lies beside it."""
CHROMA, PLAIN_CHROMA, SATURATION = 8.0, 12.0, 0.25
"""CIE Lab chroma beside the ground's from which on paint has a hue: the first where chroma over lightness is that
saturation, the second in any case, and always for blue, since every glossy body reflects the sky."""
DARKEST_L = 12.0
"""Saturation is told as if nothing were darker than this, in CIE Lab lightness: noise has a hue."""
HUES = (
    (20.0, "red"),
    (45.0, "red"),
    (68.0, "orange"),
    (105.0, "yellow"),
    (190.0, "green"),
    (300.0, "blue"),
    (340.0, "purple"),
)
"""Hue angles in CIE Lab (degrees) up to which each word goes; above the last it is red again."""
BROWN_BELOW = 1.6
"""Orange and yellow paint less bright than this beside asphalt is brown."""


@dataclass(frozen=True)
class Tone:
    """Paint beside the ground in one image: luminance ratios at `BELOW` and `ABOVE`, differences in CIE Lab's a and b,
    and the paint's own lightness there."""

    below: float
    above: float
    a: float
    b: float
    lightness: float


def tone_of(paint: NDArray[np.uint8], asphalt: NDArray[np.uint8], ground: NDArray[np.uint8]) -> Tone | None:
    """Return the tone of pixels of paint (N, 3) beside pixels of asphalt (M, 3) and of the ground about it (K, 3),
    sRGB; None where there are too few.

    The ground is taken to be grey: what colour it has is the light's.
    """
    if min(len(paint), len(asphalt), len(ground)) < LEAST_PIXELS:
        return None
    bright = linear_from_srgb(unit(paint)) @ LUMINANCE
    reference = max(float(np.median(linear_from_srgb(unit(asphalt)) @ LUMINANCE)), 1e-4)
    panel = lab_from_srgb(unit(paint[bright >= np.percentile(bright, 40)]))
    lightness, a, b = np.median(panel, 0)
    _, ground_a, ground_b = np.median(lab_from_srgb(unit(ground)), 0)
    below, above = np.percentile(bright, [BELOW, ABOVE]) / reference
    return Tone(float(below), float(above), float(a - ground_a), float(b - ground_b), float(lightness))


def unit(pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return pixels in 0..1."""
    return np.asarray(pixels, np.float32) / 255


def colour_word(tones: Sequence[Tone], weights: Sequence[float] | None = None) -> str:
    """Return "white", "light grey", "grey", "black", "red", "orange", "yellow", "green", "blue", "purple" or "brown"
    for one paint's tones in several images, each counted by its weight; "" where there are none."""
    if not tones:
        return ""
    share = np.ones(len(tones)) if weights is None else np.asarray(weights, float)

    def middle(values: list[float]) -> float:
        order = np.argsort(values)
        total = np.cumsum(share[order])
        return float(values[order[int(np.searchsorted(total, total[-1] / 2))]])

    below, above = middle([tone.below for tone in tones]), middle([tone.above for tone in tones])
    a, b = middle([tone.a for tone in tones]), middle([tone.b for tone in tones])
    lightness = middle([tone.lightness for tone in tones])
    hue = hue_word(a, b, lightness)
    if hue in ("orange", "yellow") and below < BROWN_BELOW:
        return "brown"
    if hue:
        return hue
    if below < BLACK and above < LIGHT:  # the grille of a white car is black
        return "black"
    return "white" if above >= WHITE or lightness >= WHITE_L else "light grey" if above >= LIGHT else "grey"


def hue_word(a: float, b: float, lightness: float) -> str:
    """Return the word for a hue in CIE Lab; "" where there is too little of it."""
    chroma, angle = float(np.hypot(a, b)), float(np.degrees(np.arctan2(b, a)) % 360)
    word = next((word for end, word in HUES if angle < end), "red")
    saturated = word not in ("blue", "purple") and chroma >= SATURATION * max(lightness, DARKEST_L)
    return word if chroma >= (CHROMA if saturated else PLAIN_CHROMA) else ""
