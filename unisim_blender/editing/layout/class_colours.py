"""Colours of classes of actors."""

from __future__ import annotations

COLOURS = {
    "car": (0.16, 0.45, 0.85), "truck": (0.85, 0.40, 0.10), "bus": (0.85, 0.40, 0.10), "pedestrian": (0.85, 0.15, 0.35),
    "bicycle": (0.55, 0.25, 0.80), "motorcycle": (0.55, 0.25, 0.80), "cone": (0.95, 0.60, 0.05),
    "sign": (0.75, 0.70, 0.15),
}  # fmt: skip
"""By a word of the class, linear RGB."""
OTHER_COLOUR = (0.35, 0.55, 0.45)


def class_colour(label: str) -> tuple[float, float, float]:
    """The colour of a class of actors."""
    words = label.lower()
    return next((colour for word, colour in COLOURS.items() if word in words), OTHER_COLOUR)
