"""What the actor list and the choice of actors say of an actor, in words, and the order of the list's rows."""

from __future__ import annotations

from ...core.world.drive import Actor
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


def class_and_size(actor: Actor) -> str:
    """Return an actor's class and size."""
    return f"{actor.label}, {size_text(actor)}"


def size_text(actor: Actor) -> str:
    """Return an actor's length, width and height."""
    return " x ".join(f"{edge:.1f}" for edge in actor.size_m) + " m"
