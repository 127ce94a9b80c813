"""Entries of the actor list: the filter, the order, and their values in words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.geometry import FloatArray
from ...core.world.drive import Actor
from ..texts import Text


@dataclass(frozen=True)
class ActorFilter:
    """A filter: part of the name or class, a group or "ALL", metres from the ego vehicle (0: any), present now, edited;
    and the order, "NAME", "DISTANCE" or "TIME"."""

    text: str = ""
    group: str = "ALL"
    within_m: float = 0.0
    now: bool = False
    edited: bool = False
    order: str = "NAME"


@dataclass(frozen=True)
class Entry:
    """One actor as the list shows it: ``steps`` (S, 2) are the seconds from when to when it is there."""

    key: int
    name: str
    label: str
    group: str
    distance_m: float
    speed_m_s: float
    there: bool
    steps: FloatArray
    edited: bool
    hidden: bool

    @property
    def present_s(self) -> tuple[float, float] | None:
        """From when to when it is there at all; None where it never is."""
        return (float(self.steps[0, 0]), float(self.steps[-1, 1])) if len(self.steps) else None


def chosen_entries(entries: Sequence[Entry], wanted: ActorFilter) -> list[Entry]:
    """Return the entries that a filter lets through, in its order. Distances count for actors that are there now; the
    others come last by distance."""
    text = wanted.text.strip().lower()

    def passes(entry: Entry) -> bool:
        return (
            (not text or text in entry.name.lower() or text in entry.label.lower())
            and wanted.group in ("ALL", entry.group)
            and (not wanted.within_m or (entry.there and entry.distance_m <= wanted.within_m))
            and (entry.there or not wanted.now)
            and (entry.edited or not wanted.edited)
        )

    orders: dict[str, Callable[[Entry], Any]] = {
        "NAME": lambda entry: natural(entry.name),
        "DISTANCE": lambda entry: (not entry.there, entry.distance_m, natural(entry.name)),
        "TIME": lambda entry: (entry.present_s or (np.inf, np.inf), natural(entry.name)),
    }
    return sorted((entry for entry in entries if passes(entry)), key=orders[wanted.order])


def natural(name: str) -> list[tuple[int, int, str]]:
    """Return a key by which "Car 2" comes before "Car 10"."""
    parts: list[tuple[int, int, str]] = []
    number = ""
    for letter in name.lower() + "\0":
        if letter.isdigit():
            number += letter
            continue
        if number:
            parts.append((0, int(number), ""))
            number = ""
        parts.append((1, 0, letter))
    return parts


def nearest_present(entry: Entry, now_s: float) -> float | None:
    """Return the time nearest to ``now_s`` at which an actor is there; None where it never is."""
    if not len(entry.steps):
        return None
    inside = np.clip(now_s, entry.steps[:, 0], entry.steps[:, 1])
    return float(inside[np.abs(inside - now_s).argmin()])


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
