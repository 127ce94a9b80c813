"""What a row of the actor list says, in words, and the order of its rows."""

from __future__ import annotations

from ..texts import Text
from .filter import Entry


def distance_text(entry: Entry) -> str:
    """Return how far an actor is from the ego vehicle, in metres; a dash where it is not there."""
    return f"{entry.distance_m:.0f}" if entry.there else "–"


def speed_text(entry: Entry) -> str:
    """Return an actor's speed in km/h; a dash where it is not there."""
    return f"{entry.speed_m_s * 3.6:.0f}" if entry.there else "–"


def time_text(entry: Entry) -> str:
    """Return from when to when an actor is there, in seconds."""
    if entry.present_s is None:
        return Text("never")
    return "–".join(f"{time_s:.1f}".removesuffix(".0") for time_s in entry.present_s)


def dense(order: list[int]) -> list[int]:
    """Return ranks without gaps, in the same order."""
    places = {rank: place for place, rank in enumerate(sorted(order))}
    return [places[rank] for rank in order]
