"""Readers of edits: each edit has one or a reason for none, each object one, each part a carrier;
another one reads, too."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from imported_scene import added, changed, imported, one_of, sampled_object, standing

from unisim_blender.core.scenario.context import EditContext, current, with_actor
from unisim_blender.core.scenario.edit import EDITS, Edit
from unisim_blender.core.scenario.json_schema import TEXT
from unisim_blender.core.world.drive import Drive
from unisim_blender.editing import readers
from unisim_blender.editing.edits.lines import PARTS, EditLine, EditPart, line_of
from unisim_blender.editing.edits.reader import (
    ACTORS,
    GROUPS,
    NEW_ACTORS,
    ActorEditContext,
    ActorReader,
    ReadContext,
    register,
)
from unisim_blender.editing.reading.scenario import edited_ids, group_lines, read_scenario
from unisim_blender.editing.sampled.source import DriveSource

FILES = Path(str(readers.__file__)).parent
CARRIERS = FILES.parents[1] / "bridge" / "changes" / "carriers"


@pytest.fixture
def own_readers() -> Iterator[None]:
    """What a test registers is taken back."""
    actors, parts = list(ACTORS), dict(PARTS)
    yield
    ACTORS[:] = actors
    PARTS.clear()
    PARTS.update(parts)


@pytest.mark.parametrize("kind", [kind for kind in EDITS.values() if kind.seen_by], ids=lambda kind: kind.type)
def test_an_edits_reader_makes_it(kind: type[Edit]) -> None:
    module = import_module(f"unisim_blender.editing.readers.{kind.seen_by}")
    assert getattr(module, kind.__name__) is kind, "the reader of an edit makes it"
    registered = {type(reader).__module__ for reader in (*GROUPS, *ACTORS, *NEW_ACTORS)}
    assert module.__name__ in registered


def test_each_file_is_registered_by_a_line() -> None:
    lines = (FILES / "__init__.py").read_text().splitlines()
    for path in FILES.glob("*.py"):
        if path.stem != "__init__":
            assert any(line.startswith(f"from .{path.stem} import ") for line in lines), path.stem
    found = {type(reader).__module__.rpartition(".")[2] for reader in (*GROUPS, *ACTORS, *NEW_ACTORS)}
    assert found == {path.stem for path in FILES.glob("*.py")} - {"__init__"}


def test_each_part_has_a_carrier() -> None:
    carriers = {part.carrier for part in PARTS.values()} - {""}
    lines = (CARRIERS / "__init__.py").read_text()
    assert all(f"from .{carrier} import " in lines and (CARRIERS / f"{carrier}.py").is_file() for carrier in carriers)


def test_of_each_new_actor_one_reader_is(source: DriveSource) -> None:
    sampled = imported(source.drive)
    actor = standing(source.drive)
    reading = ReadContext(sampled, source.drive, set())
    for known in (actor, None):
        for about in ({}, {"appearance": "van"}, {"mesh": "box.npz"}) if known is None else ({}, {"appearance": "van"}):
            obj = sampled_object("New", "ACTOR", one_of(sampled, actor.uid).poses, **about)
            assert sum(reader.reads(ActorEditContext(reading, obj, known)) for reader in NEW_ACTORS) == 1


@dataclass(frozen=True)
class Relabel(Edit):
    """The actor is of another class."""

    type = "relabel"
    members = {"actor": TEXT, "label": TEXT}

    actor: str
    label: str

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        return with_actor(drive, replace(current(drive, self.actor, place, context), label=self.label))


class RelabelReader(ActorReader[Relabel]):
    """Reads classes, also those of new actors."""

    def read(self, context: ActorEditContext) -> Relabel | None:
        return self.read_new(context.known.uid, context)

    def read_new(self, new: str, context: ActorEditContext) -> Relabel | None:
        label = "" if context.here.mesh else context.here.label
        return Relabel(new, label) if label else None

    def line(self, edit: Relabel, context: ActorEditContext) -> EditLine:
        there = context.here.there
        return line_of("ACTOR", edit.actor, "CLASS", f"Class {edit.label}", context.names, there, context.clock, edit)


def test_another_reader_reads(source: DriveSource, own_readers: None) -> None:
    uid, sampled = standing(source.drive).uid, imported(source.drive)
    copy: Any = replace(one_of(sampled, uid), name="Copy", label="Van")
    taxi = added(changed(sampled, uid, label="Taxi"), copy)
    before = read_scenario(taxi, source, Path("/tmp/drive/scenario.json")).edits
    assert [edit.type for edit in before] == ["duplicate"] and edited_ids(taxi, source.drive) == set()
    register(RelabelReader)
    PARTS["CLASS"] = EditPart("CLASS", "BOOKMARKS", "label")
    edits = read_scenario(taxi, source, Path("/tmp/drive/scenario.json")).edits
    assert edits == (before[0], Relabel("Copy", "Van"), Relabel(uid, "Taxi"))
    assert edited_ids(taxi, source.drive) == {uid}
    lines = list(group_lines("ACTOR", uid, taxi, source.drive))
    assert [(line.part, line.what, line.who, line.icon) for line in lines] == [
        ("COPY", "Copied, in place", "Copy", "DUPLICATE"),
        ("CLASS", "Class Taxi", uid, "BOOKMARKS"),
    ]
    assert [line.is_own_object for line in lines] == [True, False]
