"""What the workers of an executor do while it runs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

Doing = Literal["starting", "unit", "idle", "lost"]
"""A worker starts; is at a unit; has none, because none waits; was ended from outside."""


@dataclass(frozen=True)
class WorkerState:
    """What a worker does from now on. ``number`` counts workers from 0; what replaces a lost one has its number.

    At a unit, ``index`` is the unit's, and ``loads_scene`` says whether the worker loads the unit's scene first, because
    it holds another one or none.
    """

    number: int
    doing: Doing
    index: int | None = None
    loads_scene: bool = False


OnWorker = Callable[[WorkerState], object]


def ignore(state: WorkerState) -> None:
    """Do nothing with what a worker does."""
