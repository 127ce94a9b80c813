"""The actor list and the presence timeline: tracks of actors and their values at a frame, entries with filter and
order; cards of actors in the sidebar, and their names."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...core.actor_images.cache import cached_images
from ...core.actor_images.names import full_name, plain_names
from ...core.geometry import BoolArray, FloatArray
from ...core.world.drive import Actor
from ..sampled.clock import Clock
from ..sampled.scene import UNIT, Factors, scale_text, size_text
from ..sampled.source import DriveSource
from ..texts import Text, kmh


@dataclass(frozen=True)
class ActorTrack:
    """One actor at the clock's frames (N,): positions (N, 3) in the world, whether it is there (N,), its speeds (N,), NaN
    where it is not. ``edited`` tells whether it differs from what was recorded, ``group`` and ``label`` are its class,
    ``steps`` (S, 2) the seconds from when to when it is there."""

    name: str
    uid: str
    label: str
    group: str
    positions: FloatArray
    there: BoolArray
    speed_m_s: FloatArray
    steps: FloatArray
    edited: bool


@dataclass(frozen=True)
class FrameValues:
    """Of A actors at one frame: metres from the ego vehicle (A,), metres a second (A,), whether each is there (A,)."""

    distance_m: FloatArray
    speed_m_s: FloatArray
    there: BoolArray


def steps_of(there: BoolArray, clock: Clock) -> FloatArray:
    """Return the seconds (S, 2) from when to when something is there (N,), for each time that it comes."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], there, [False]]).astype(int)))
    return np.stack([clock.times_s[edges[::2]], clock.times_s[edges[1::2] - 1]], -1) if len(edges) else np.zeros((0, 2))


def values_at(tracks: list[ActorTrack], ego: FloatArray, clock: Clock, frame: float) -> FrameValues:
    """Return the values of actors at a frame; ``ego`` (N, 3) are the vehicle's positions at the clock's frames."""
    if not tracks:
        return FrameValues(np.zeros(0), np.zeros(0), np.zeros(0, bool))
    positions = np.stack([track.positions for track in tracks])
    now = float(clock.time_s(np.array(frame)))
    apart = at_time(positions, clock, now) - at_time(ego, clock, now)
    number = clock.index(frame)
    return FrameValues(
        np.linalg.norm(apart, axis=-1),
        np.array([track.speed_m_s[number] for track in tracks]),
        np.array([track.there[number] for track in tracks]),
    )


def at_time(positions: FloatArray, clock: Clock, time_s: float) -> FloatArray:
    """Return positions (..., 3) at a time, of positions (..., N, 3) at the clock's times; carried on at the ends."""
    last = len(clock.times_s) - 2
    lower = int(np.clip(np.searchsorted(clock.times_s, time_s, side="right") - 1, 0, last))
    share = (time_s - clock.times_s[lower]) / (clock.times_s[lower + 1] - clock.times_s[lower])
    return np.asarray(positions[..., lower, :] * (1 - share) + positions[..., lower + 1, :] * share)


@dataclass(frozen=True)
class ActorCard:
    """An actor's name and class, what became of it, its speed, how far it is from the ego vehicle, from when to when it
    is there, in seconds of the log, and how large it is, in words."""

    name: str
    label: str
    role: str
    speed_m_s: float
    distance_m: float
    present_s: tuple[float, float] | None
    size: str = ""


def present_span(there: BoolArray, clock: Clock) -> tuple[float, float] | None:
    """Return the times in seconds of the first and the last frame at which an actor is present (N,); None for none."""
    shown = clock.times_s[there]
    return (float(shown[0]), float(shown[-1])) if len(shown) else None


def size_words(size_m: Sequence[float], factors: Factors) -> str:
    """Return how large an actor is drawn (3,), and by what it is scaled, in words."""
    # as long as the sidebar shows at its first width
    return size_text(size_m, digits=2) if factors == UNIT else f"{size_text(size_m, digits=1)} ×{scale_text(factors)}"


def role_words(is_mesh: bool, is_recorded: bool, is_copy: bool, other_appearance: bool) -> str:
    """Return what an actor is in one or two words."""
    if is_mesh:
        return Text("mesh")
    if not is_recorded:
        return Text("inserted")
    if is_copy:
        return Text("copy")
    return Text("recorded, other appearance" if other_appearance else "recorded")


def names_at_import(source: DriveSource) -> dict[str, str]:
    """Return the names of a source's actors by id, with the words for their colours where these are kept already."""
    images = cached_images(source.log_path) or {}
    words = {uid: image.word for uid, image in images.items()}
    return {uid: full_name(plain, words.get(uid, "")) for uid, plain in plain_names(named_actors(source)).items()}


def named_actors(source: DriveSource) -> dict[str, Actor]:
    """Return the actors that are counted: all of the log's, so that a scene trained on it has the same names."""
    return {**source.drive.actors, **(source.log.drive.actors if source.log is not None else {})}


def is_plain(name: str, plain: str) -> bool:
    """Return whether a name is the plain one, with the number that Blender adds where another scene
    has that name too."""
    return re.fullmatch(re.escape(plain) + r"(\.\d{3,})?", name) is not None


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
        """First and last time at which it is present, in seconds; None where it never is."""
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


def natural(name: str) -> list[tuple[bool, int, str]]:
    """Return a key by which "Car 2" comes before "Car 10"."""
    parts = [part for part in re.split(r"([0-9]+)", name.lower()) if part]
    return [(not part.isdecimal(), int(part) if part.isdecimal() else 0, part) for part in parts]


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
    return kmh(entry.speed_m_s).removesuffix(" km/h") if entry.there else "–"


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
    return f"{actor.label}, {size_text(actor.size_m)}"
