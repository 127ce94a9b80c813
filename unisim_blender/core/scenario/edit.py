"""What an edit is, and the edits that are known. Each has a file of its own in `edits`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, ClassVar, TypeVar

from .fragments import Schema

if TYPE_CHECKING:
    from ..world.drive import Drive
    from .context import Context
    from .types import Scenario


@dataclass(frozen=True)
class Edit(ABC):
    """A change of a drive: a frozen dataclass whose fields are the members that a document has, None where one is missing.

    A subclass says how it is written (`type`, `members`), what a schema cannot say of it (`check`), what it does (`apply`), and
    which reader of Blender's side makes it of what a person did there (`seen_by`). `register` makes it part of scenarios.
    """

    type: ClassVar[str]
    """Its name in a document."""
    members: ClassVar[Mapping[str, Schema]]
    """The JSON Schema of each field; fields without a default are required."""
    former_names: ClassVar[Mapping[str, str]] = {}
    """Names that members had in earlier documents, which are read as the current ones: {former: current}."""
    meshes: ClassVar[tuple[str, ...]] = ()
    """Those of its members that name a mesh's file."""
    seen_by: ClassVar[str] = ""
    """The module of Blender's readers (`editing/readers`) that makes it of what stands in a scene; "" where none does."""
    unseen_because: ClassVar[str] = ""
    """Why no reader makes it."""

    def check(self, scenario: Scenario, place: str) -> None:  # noqa: B027 most edits have nothing to say
        """Raise `ScenarioError` for what the edit and its document alone show to be wrong; ``place`` is the edit's."""

    @abstractmethod
    def apply(self, drive: Drive, place: str, context: Context) -> Drive:
        """The edited drive. ``drive`` stays as it is, and what the edit does not touch is the same object in both.

        Raises `ScenarioError` naming ``place`` or a member of it.
        """

    def removes(self, uid: str) -> bool:
        """Whether an actor is gone after the edit, so that no later one can name it."""
        return False


EDITS: dict[str, type[Edit]] = {}
"""The known edits by their names in documents."""
Kind = TypeVar("Kind", bound=type[Edit])


def register(kind: Kind) -> Kind:
    """Make an edit part of scenarios, which are read and checked with it. Raises `TypeError` for one that is not whole."""
    stated, held = set(kind.members), {field.name for field in fields(kind)}
    if stated != held:
        raise TypeError(f'edit "{kind.type}": members {sorted(stated)} are not its fields {sorted(held)}')
    if stated & kind.former_names.keys() or not stated >= set(kind.former_names.values()):
        raise TypeError(f'edit "{kind.type}": former names {dict(kind.former_names)} do not lead to its members {sorted(stated)}')
    if EDITS.get(kind.type, kind) is not kind:
        raise TypeError(f'edit "{kind.type}": is registered already, by {EDITS[kind.type].__name__}')
    EDITS[kind.type] = kind
    return kind
