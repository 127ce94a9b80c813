"""What the sidebar says of an actor at a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...core.geometry import BoolArray
from ..sampled.clock import Clock
from ..sampled.scaling import UNIT, Factors, scale_text, size_text
from ..texts import Text

HALF_S = 0.1
"""Speed is that between so many seconds before and after the frame."""


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
