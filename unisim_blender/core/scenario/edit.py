"""Base class and registry of edits. Each edit has a file of its own in `edits`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, TypeVar

from ..registry import Registry
from .json_schema import Schema, state_members

if TYPE_CHECKING:
    from ..world.drive import Drive
    from .context import EditContext
    from .types import Scenario


@dataclass(frozen=True)
class Edit(ABC):
    """A change of a drive: a frozen dataclass. Its fields are the members of the document, None where one is missing.

    A subclass defines how it is written (`type`, its fields), checks that a schema cannot express
    (`check`), its effect (`apply`), and which reader derives it from a Blender scene (`seen_by`). `register` adds it to
    the edits that scenarios may have.
    """

    type: ClassVar[str]
    """Its name in a document."""
    members: ClassVar[Mapping[str, Schema]]
    """The JSON Schema of each field, which follows from its type (`json_schema.schema_of`) unless it is stated; fields
    without a default are required."""
    former_names: ClassVar[Mapping[str, str]] = {}
    """Names that members had in earlier documents, which are read as the current ones: {former: current}."""
    meshes: ClassVar[tuple[str, ...]] = ()
    """Names of the members that are mesh files."""
    seen_by: ClassVar[str] = ""
    """The module of `editing/readers` that derives the edit from a Blender scene; "" if there is none."""
    unseen_because: ClassVar[str] = ""
    """Reason why there is no reader."""

    def check(self, scenario: Scenario, place: str) -> None:  # noqa: B027 most edits have nothing to say
        """Raise `ScenarioError` for faults that show without the drive; ``place`` names the edit in messages."""

    @abstractmethod
    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        """Return the edited drive. ``drive`` is not changed; the result shares the objects that the edit
        does not change.

        Raises `ScenarioError` naming ``place`` or a member of it.
        """

    def removes(self, uid: str) -> bool:
        """Return whether the edit removes an actor, so that later edits cannot name it."""
        return False


EDITS: Registry[type[Edit]] = Registry("an edit", key="type")
"""The registered edits by their names in documents."""
EditKindT = TypeVar("EditKindT", bound=type[Edit])


def register(kind: EditKindT) -> EditKindT:
    """Register an edit: scenarios that have it can then be read and checked. Raises `TypeError` for an
    incomplete class, `ValueError` for a name that is taken."""
    state_members(kind, "edit")
    members = kind.members.keys()
    if members & kind.former_names.keys() or not members >= set(kind.former_names.values()):
        raise TypeError(
            f'edit "{kind.type}": former names {dict(kind.former_names)} do not lead to its members {sorted(members)}'
        )
    EDITS.register(kind)
    return kind
