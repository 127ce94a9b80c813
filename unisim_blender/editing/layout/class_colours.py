"""Colours of classes of actors."""

from __future__ import annotations

CAR, TRUCK, PERSON, CYCLE = (0.16, 0.45, 0.85), (0.85, 0.40, 0.10), (0.85, 0.15, 0.35), (0.55, 0.25, 0.80)
COLOURS = {
    "car": CAR, "truck": TRUCK, "bus": TRUCK, "pedestrian": PERSON, "bicycle": CYCLE, "motorcycle": CYCLE,
    "cone": (0.95, 0.60, 0.05), "sign": (0.75, 0.70, 0.15),
    # of other datasets than PandaSet: a REGULAR_VEHICLE and a TYPE_VEHICLE are cars
    "trailer": TRUCK, "cyclist": CYCLE, "person": PERSON, "human": PERSON, "van": CAR, "_vehicle": CAR,
}  # fmt: skip
"""By a word of the class, linear RGB; the first that it has."""
OTHER_COLOUR = (0.35, 0.55, 0.45)


def class_colour(label: str) -> tuple[float, float, float]:
    """The colour of a class of actors."""
    words = label.lower()
    return next((colour for word, colour in COLOURS.items() if word in words), OTHER_COLOUR)
