"""A found track: an actor, and how certain it is that there is one."""

from __future__ import annotations

from dataclasses import dataclass

from ..world.drive import Actor


@dataclass(frozen=True)
class Track:
    """An actor that was found in sweeps. ``certainty``, from 0 to 1, that it is an actor of its class; numbers of
    returns and of sweeps that show it."""

    actor: Actor
    certainty: float
    returns: int
    sweeps: int
