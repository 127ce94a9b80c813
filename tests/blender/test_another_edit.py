"""An edit that the package does not have: a type, a reader and a carrier make it editable in Blender, and
nothing else does."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import bpy
import pytest
from edit_cases import lines, press, standing
from helpers import SAMPLE, edited, imported, read

from unisim_blender.bridge.changes.carriers import carrier
from unisim_blender.bridge.changes.carriers.carrier import CARRIERS, Carrier, Edited, Muted
from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.window import refresh
from unisim_blender.core.scenario import edit as edits
from unisim_blender.core.scenario.context import EditContext, current, with_actor
from unisim_blender.core.scenario.edit import EDITS, Edit
from unisim_blender.core.scenario.json_schema import TEXT
from unisim_blender.core.world.drive import Drive
from unisim_blender.editing.edits import reader
from unisim_blender.editing.edits.lines import PARTS, EditLine, EditPart, line_of
from unisim_blender.editing.edits.reader import ACTORS, ActorEditContext, ActorReader
from unisim_blender.editing.sampled.source import DriveSource


@dataclass(frozen=True)
class Relabel(Edit):
    """The actor is of another class."""

    type = "relabel"
    members = {"actor": TEXT, "label": TEXT}
    seen_by = "relabel"

    actor: str
    label: str

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        return with_actor(drive, replace(current(drive, self.actor, f"{place}.actor", context), label=self.label))


class RelabelReader(ActorReader[Relabel]):
    """Reads classes."""

    def read(self, context: ActorEditContext) -> Relabel | None:
        label = context.here.label
        return Relabel(context.known.uid, label) if label not in ("", context.known.label) else None

    def line(self, edit: Relabel, context: ActorEditContext) -> EditLine:
        there = context.here.there
        return line_of("ACTOR", edit.actor, "CLASS", f"Class {edit.label}", context.names, there, context.clock, edit)


class LabelCarrier(Carrier):
    """The class that an actor's object notes."""

    name = "label"

    def apply(self, obj: bpy.types.Object, edited: Edited) -> None:
        obj.unisim.label = edited.actor.label

    def mute(self, scene: Any, source: DriveSource, item: Any, line: EditLine, obj: Any) -> None:
        item.kept = obj.unisim.label
        self.revert(scene, source, line, obj)

    def unmute(self, scene: Any, source: DriveSource, muted: Muted, now: Any) -> None:
        now.unisim.label = muted.kept
        refresh([now])

    def revert(self, scene: Any, source: DriveSource, line: EditLine, obj: Any) -> None:
        obj.unisim.label = ""
        refresh([obj])

    def keep(self, now: bpy.types.Object, parked: bpy.types.Object) -> None:
        parked.unisim.label = now.unisim.label


@pytest.fixture(autouse=True)
def relabel() -> Iterator[None]:
    """The edit is there for a test."""
    readers = list(ACTORS)
    edits.register(Relabel)
    reader.register(RelabelReader)
    carrier.register(LabelCarrier)
    PARTS["CLASS"] = EditPart("CLASS", "BOOKMARKS", "label")
    yield
    ACTORS[:] = readers
    del EDITS["relabel"], CARRIERS["label"], PARTS["CLASS"]


def test_it_is_read_listed_muted_and_taken_back(street: Any) -> None:
    one = standing(street)
    uid, before = one.unisim.uid, source_of(street).drive.actors[one.unisim.uid].label
    assert lines(street) == ()
    one.unisim.label = "Taxi"
    (line,) = lines(street)
    assert (line.part, line.what, line.icon, line.object_name) == ("CLASS", "Class Taxi", "BOOKMARKS", one.name)
    assert read(street).edits == (Relabel(uid, "Taxi"),) and edited(street).actors[uid].label == "Taxi"
    press(bpy.ops.unisim.mute_edit, line)
    assert read(street).edits == () and edited(street).actors[uid].label == before
    (line,) = lines(street)
    assert line.muted == 0 and line.what == "Class Taxi"
    press(bpy.ops.unisim.mute_edit, line)
    assert read(street).edits == (Relabel(uid, "Taxi"),)
    press(bpy.ops.unisim.revert_edit, lines(street)[0])
    assert lines(street) == () and read(street).edits == ()


def test_it_stands_beside_a_move_that_is_muted(street: Any) -> None:
    one = standing(street)
    uid = one.unisim.uid
    one.location.y += 3.0
    one.unisim.label = "Taxi"
    assert [line.part for line in lines(street)] == ["CLASS", "MOVE"]
    press(bpy.ops.unisim.mute_edit, lines(street)[1])
    assert [edit.type for edit in read(street).edits] == ["relabel"]
    press(bpy.ops.unisim.revert_edit, next(line for line in lines(street) if line.part == "CLASS"))
    press(bpy.ops.unisim.mute_edit, next(line for line in lines(street) if line.part == "MOVE"))
    assert [edit.type for edit in read(street).edits] == ["move"], (
        "the parked object has the class that the actor has now"
    )
    assert imported(street, "ACTOR", uid).unisim.label == ""


def test_a_scenario_with_it_is_opened(scene: Any, tmp_path: Path) -> None:
    document = json.loads((SAMPLE / "objects.json").read_text())
    document["log"]["path"], document["scene"] = str(tmp_path / "log"), str(SAMPLE / "scene")
    document["edits"] = [{"type": "relabel", "actor": "car-03", "label": "Taxi"}]
    path = tmp_path / "scenario.json"
    path.write_text(json.dumps(document))
    assert bpy.ops.unisim.import_scenario(filepath=str(path)) == {"FINISHED"}
    assert imported(scene, "ACTOR", "car-03").unisim.label == "Taxi"
    (edit,) = read(scene).edits
    assert edit == Relabel("car-03", "Taxi")
