"""The state of the world over a whole drive, and a backend bound to it: one tracer for the rays of every frame."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, TypeVar

from unisim_blender.core.world.drive import FRAME_MARGIN_S, Box, Drive
from unisim_blender.core.world.replay import DriveStates, WorldState, parked_boxes

Bound = TypeVar("Bound", covariant=True)


class Binding(Protocol[Bound]):
    """What of a `tracer.Backend` is needed here; it tells which tracer `bind` returns."""

    @property
    def parked(self) -> Mapping[str, Box]: ...

    def bind(self, state: WorldState) -> Bound: ...


def window_of(drive: Drive) -> tuple[float, float]:
    """Return when anything of a drive is there, or a sensor of it looks."""
    windows = [drive.window(actor) for actor in drive.actors.values()]
    first, last = drive.time_s[drive.frames[0]] - FRAME_MARGIN_S, drive.time_s[drive.frames[-1]] + FRAME_MARGIN_S
    return min([first, *(start for start, _ in windows)]), max([last, *(end for _, end in windows)])


def whole_state(drive: Drive, recorded: Drive | None = None) -> WorldState:
    """Return the state over a whole drive, of a scene that was trained on ``recorded``: the same drive where None."""
    return DriveStates(drive, parked_boxes(drive if recorded is None else recorded)).state(*window_of(drive))


def bound_to(backend: Binding[Bound], drive: Drive) -> Bound:
    """Return the tracer of the state over a whole drive."""
    return backend.bind(DriveStates(drive, backend.parked).state(*window_of(drive)))
