"""Interface of the parts of an object that carry edits: how an edit is applied, muted, unmuted and taken back."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any, ClassVar, TypeVar

import bpy

from ....core.world.drive import Actor, Drive
from ....editing.edits.lines import PARTS, EditLine
from ....editing.sampled.clock import Clock
from ....editing.sampled.source import DriveSource


@dataclass(frozen=True)
class Edited:
    """An actor of an edited drive. ``own_appearance`` is the actor whose appearance its object has without an edit;
    None for a mesh actor."""

    actor: Actor
    drive: Drive
    own_appearance: str | None
    clock: Clock


@dataclass(frozen=True)
class Muted:
    """A muted edit that is about to count again, as `UniSimMuted` had it; ``collection`` is where its object stood."""

    kind: str
    part: str
    parked: bpy.types.Object | None
    collection: bpy.types.Collection | None
    look: str
    look_scene: str
    scale: tuple[float, float, float]
    scale_lift_m: float
    kept: str


class Carrier(ABC):
    """A part of an object that edits change, in Blender."""

    name: ClassVar[str]
    """Name of the carrier, to which `Part.carrier` refers."""

    def apply(self, obj: bpy.types.Object, edited: Edited) -> None:  # noqa: B027 what is an object needs no more than to be there
        """Give an actor's object what an edited drive has of the actor."""

    @abstractmethod
    def mute(
        self, scene: bpy.types.Scene, source: DriveSource, item: Any, line: EditLine, obj: bpy.types.Object | None
    ) -> None:
        """Note in a `UniSimMuted` what the edit is, and let the object stand without it."""

    @abstractmethod
    def unmute(self, scene: bpy.types.Scene, source: DriveSource, muted: Muted, now: bpy.types.Object | None) -> None:
        """Let an edit count again; ``now`` is the object that stands for what was recorded."""

    @abstractmethod
    def revert(self, scene: bpy.types.Scene, source: DriveSource, line: EditLine, obj: bpy.types.Object | None) -> None:
        """Let the object stand without the edit."""

    def keep(self, now: bpy.types.Object, parked: bpy.types.Object) -> None:  # noqa: B027 for edits of their own alone
        """Give an actor's parked object, which takes the place of ``now``, what ``now`` has of this."""


CARRIERS: dict[str, Carrier] = {}
"""The carriers by their names, in the order in which they are applied."""
CarrierKindT = TypeVar("CarrierKindT", bound=type[Carrier])


def register(kind: CarrierKindT) -> CarrierKindT:
    """Let edits have a carrier."""
    CARRIERS[kind.name] = kind()
    return kind


def carrier_of(part: str) -> Carrier:
    """The carrier of a part's edits."""
    return CARRIERS[PARTS[part].carrier]
