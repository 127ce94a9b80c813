"""Interfaces of the readers of edits: from the objects of a sampled scene they make the edits of a scenario, and lines
of the edits list."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np

from ...core.errors import ScenarioError
from ...core.geometry import BoolArray, FloatArray, invert_pose
from ...core.scenario.edit import Edit
from ...core.scenario.motion.maneuvers import Maneuver
from ...core.scenario.motion.placement import BoxSpec
from ...core.world.drive import Actor, Drive
from ..sampled.axes import axes_of
from ..sampled.clock import Clock, recorded_poses, recorded_there
from ..sampled.scene import Sampled, SampledObject
from ..sampled.source import scene_actors
from ..texts import free_name
from .lines import EditLine, displaced_words, is_retimed, line_of, presence_words, trajectory_words, turned
from .trajectories import pose_or_trajectory

EditT = TypeVar("EditT", bound=Edit)


@dataclass(frozen=True)
class ReadContext:
    """A sampled scene and what it is read against. Ids of new actors go into ``taken``, boxes of static items into
    ``boxes``, maneuvers into ``maneuvers``; ``relative`` gives a file or a folder as the scenario names it."""

    sampled: Sampled
    drive: Drive
    taken: set[str]
    relative: Callable[[str], str] = str
    boxes: dict[str, BoxSpec] = field(default_factory=dict)
    maneuvers: list[Maneuver] = field(default_factory=list)

    @property
    def clock(self) -> Clock:
        """When the scene was sampled."""
        return self.sampled.clock

    def new_id(self, obj: SampledObject) -> str:
        """An id after the object's name that nothing else has; it is taken from now on."""
        uid = free_name(obj.title, self.taken)
        self.taken.add(uid)
        return uid


class GroupReader(ABC):
    """Reads all edits of objects that are read together."""

    group: ClassVar[str]
    """Name of the objects that are sampled and read together; readers may share one."""
    kinds: ClassVar[tuple[str, ...]]
    """Kinds of the objects that it reads."""
    by_id: ClassVar[bool] = False
    """Whether those of each id are a group of their own."""

    @abstractmethod
    def edits(self, reading: ReadContext) -> Iterator[Edit]:
        """The edits that make the objects of the recorded ones, in the order of a scenario. Raises `ScenarioError`."""

    @abstractmethod
    def lines(self, reading: ReadContext, uid: str) -> Iterator[EditLine]:
        """The lines of a group's edits; ``uid`` is the group's id where each has its own. Raises `ScenarioError`."""

    def edited_ids(self, reading: ReadContext) -> set[str]:
        """Ids of what was recorded and does not stand as it was imported."""
        return set()


@dataclass(frozen=True)
class ActorEditContext:
    """An object beside the recorded actor that it stands for, or that it is a copy of; None is one
    that is not there."""

    reading: ReadContext
    obj: SampledObject | None
    actor: Actor | None

    @property
    def is_gone(self) -> bool:
        """Whether the actor is at no frame of the scene."""
        return self.obj is None or not self.obj.there.any()

    @property
    def here(self) -> SampledObject:
        """The object, which is there."""
        assert self.obj is not None
        return self.obj

    @property
    def known(self) -> Actor:
        """The recorded actor, which is there."""
        assert self.actor is not None
        return self.actor

    @property
    def clock(self) -> Clock:
        """When the scene was sampled."""
        return self.reading.clock

    @property
    def names(self) -> tuple[str, str]:
        """The object's names in the scenario and in Blender."""
        return self.here.title, self.here.name

    def line(self, part: str, words: str, edit: Edit, shows: BoolArray | None = None) -> EditLine:
        """Return the line of an edit of the object, which shows at some frames (N,), by default while the object is
        there."""
        obj = self.here
        return line_of(
            "ACTOR", obj.uid, part, words, self.names, obj.there if shows is None else shows, self.clock, edit
        )

    @cached_property
    def recorded(self) -> FloatArray:
        """Poses (N, 4, 4) of the recorded actor."""
        return recorded_poses(self.known, self.clock)

    @cached_property
    def recorded_there(self) -> BoolArray:
        """Whether the recorded actor is there (N,)."""
        return recorded_there(self.known, self.reading.drive, self.clock)

    @property
    def axes(self) -> FloatArray | None:
        """Axes (3, 3) in which its displacements are given; None for its own."""
        return axes_of(self.known.label, self.recorded[0, :3, 3], self.reading.drive)

    @cached_property
    def lifted(self) -> FloatArray:
        """Poses (N, 4, 4) of the recorded actor where it stands on the same ground with the object's appearance."""
        poses = self.recorded
        if not self.here.appearance:
            return poses
        lifted = poses.copy()
        lifted[:, :3, 3] += (self.appearance_size_m[2] - self.known.size_m[2]) / 2 * poses[:, :3, 2]
        return lifted

    @cached_property
    def raised(self) -> FloatArray:
        """``lifted``, with the wheels of a scaled object where the actor's are: poses (N, 4, 4)."""
        raised = self.lifted.copy()
        raised[:, :3, 3] += self.here.scale_lift_m * self.recorded[:, :3, 2]
        return raised

    def path_phrases(self) -> list[str]:
        """Return in phrases how the object moves otherwise than the recorded actor, which lies raised for an object with
        another appearance or scale. Directions are those of ``axes``."""
        obj, base, there, clock, recorded = (
            self.here, self.recorded, self.recorded_there, self.clock, self.known.world_from_actor,
        )  # fmt: skip
        at = obj.there & there if (obj.there & there).any() else obj.there
        few = Clock(clock.frames[at], clock.times_s[at])
        turn = np.eye(3) if self.axes is None else self.axes @ np.swapaxes(base[at, :3, :3], -1, -2)
        parts = []
        poses, start, raised = (turned(poses[at], turn) for poses in (obj.poses, base, self.raised))
        if obj.ridden is not None:
            ridden = turned(obj.ridden[at], turn)
            parts.append(trajectory_words(few, ridden, start, recorded, is_retimed(obj, recorded, clock)))
            parts.append(displaced_words(invert_pose(ridden @ (invert_pose(start) @ raised)) @ poses))
        else:
            parts.append(trajectory_words(few, poses, raised, None, False))
        if (obj.there != there).any() and not any(part.startswith("Retimed") for part in parts):
            parts.append(presence_words(clock, obj.there))
        return [part for part in parts if part]

    @property
    def appearance_size_m(self) -> FloatArray:
        """The size (3,) of the box that comes with the object's appearance. Raises `ScenarioError`."""
        obj = self.here
        actors = scene_actors(Path(obj.appearance_scene)) if obj.appearance_scene else self.reading.drive.actors
        if obj.appearance not in actors:
            where = obj.appearance_scene or "the log"
            raise ScenarioError(f'object "{obj.name}": has the appearance of "{obj.appearance}", which {where} lacks')
        return actors[obj.appearance].size_m

    @property
    def appearance_scene(self) -> str | None:
        """The other trained scene that the appearance is of, as the scenario names it."""
        return self.reading.relative(self.here.appearance_scene) if self.here.appearance_scene else None

    def path(self) -> dict[str, Any]:
        """``pose`` or ``trajectory`` of the object; what is between frames is as in the recorded actor's."""
        actor = self.actor
        recorded = (
            actor.world_from_actor if actor is not None and actor.is_moving and not self.here.appearance else None
        )
        return dict(pose_or_trajectory(self.clock, self.here.poses, self.here.there, recorded))


class ActorReader(ABC, Generic[EditT]):
    """Reads one edit off the object of a recorded actor."""

    of_absent: ClassVar[bool] = False
    """Whether it reads actors that are gone, in place of those that are there."""

    @abstractmethod
    def read(self, context: ActorEditContext) -> EditT | None:
        """The edit; None where the actor is without it."""

    @abstractmethod
    def line(self, edit: EditT, context: ActorEditContext) -> EditLine | None:
        """The edit in words; None where the line of another edit says it."""

    def read_new(self, new: str, context: ActorEditContext) -> EditT | None:
        """The edit of an actor ``new`` that another edit adds; None where it is without."""
        return None


class NewActorReader(ABC, Generic[EditT]):
    """Reads the edit that adds an actor off its object."""

    @abstractmethod
    def reads(self, context: ActorEditContext) -> bool:
        """Whether an object is of this reader. Of each object one reader is."""

    @abstractmethod
    def read(self, context: ActorEditContext) -> EditT:
        """The edit."""

    @abstractmethod
    def line(self, edit: EditT, context: ActorEditContext) -> EditLine:
        """The edit in words."""


GROUPS: list[GroupReader] = []
"""Readers of groups, in the order in which a scenario has their edits."""
ACTORS: list[ActorReader[Any]] = []
"""Readers of recorded actors, in the order in which edits of one actor are applied."""
NEW_ACTORS: list[NewActorReader[Any]] = []
ReaderKindT = TypeVar("ReaderKindT", bound="type[GroupReader] | type[ActorReader[Any]] | type[NewActorReader[Any]]")


def register(kind: ReaderKindT) -> ReaderKindT:
    """Let a reader read scenes."""
    reader = kind()
    if isinstance(reader, GroupReader):
        GROUPS.append(reader)
    elif isinstance(reader, ActorReader):
        ACTORS.append(reader)
    else:
        NEW_ACTORS.append(reader)
    return kind
