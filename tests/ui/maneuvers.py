"""Maneuvers with mouse and keys: from the pie and the context menu, changed by F9, undone. Run by `run.py`.

`UNISIM_UI_LOG` names another log than the street of eight seconds.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from hands import edits, event, key, middle, object_named, place, scenario, to
from mathutils import Vector
from session import MODULE, OUT, area, from_behind, inside, results, screenshot, start, until, view
from tasks import arrived, begin, install, task

LOG = OUT.parent / "log"
FRAME = 12
"""Frame at which maneuvers are asked for."""
SLOT = "NUMPAD_9"
"""Of the pie: Maneuver."""
KINDS = {
    "cut_in": "NUMPAD_4",
    "cross": "NUMPAD_6",
    "lane_change": "NUMPAD_2",
    "brake": "NUMPAD_8",
    "platoon": "NUMPAD_7",
}


def imported() -> Iterator[float]:
    """Import the log and look through its front camera."""
    yield from install()
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.import_log("INVOKE_DEFAULT", filepath=str(LOG))
    yield from arrived()
    begin()
    bpy.context.scene.frame_set(FRAME)
    view()[2].view_perspective = "CAMERA"
    bpy.ops.ed.undo_push(message="Imported")
    yield 2.0


def deselected() -> Iterator[float]:
    """Nothing is selected: Alt-A."""
    yield from to(*middle(area("VIEW_3D")))
    yield from key("A", alt=True)
    yield 0.2


def from_pie(kind: str) -> Iterator[float]:
    """Ctrl-Alt-E, the slot of maneuvers, the slot of one."""
    count = len(edits())
    yield from to(*middle(area("VIEW_3D")))
    yield from key("E", ctrl=True, alt=True)
    yield 0.5
    screenshot(f"{kind}_pie")
    yield from key(SLOT)
    yield 0.5
    screenshot(f"{kind}_maneuvers")
    yield from key(KINDS[kind])
    yield from until(lambda: len(edits()) > count, f"no {kind}", 30)
    yield 0.5


def looked_at(name: str, *frames: int) -> Iterator[float]:
    """A screenshot of each of some frames."""
    for frame in frames:
        bpy.context.scene.frame_set(frame)
        yield 0.6
        screenshot(f"{name}_{frame:03d}")
    bpy.context.scene.frame_set(FRAME)
    yield 0.3


def named_edits() -> list[dict[str, Any]]:
    """The scenario's edits in short."""
    short = []
    for edit in scenario().edits:
        values = {name: getattr(edit, name) for name in edit.members if name not in ("trajectory", "pose")}
        short.append({"type": edit.type, **{name: value for name, value in values.items() if value is not None}})
    return short


def redone(kind: str) -> Iterator[float]:
    """F9: the numbers."""
    yield from to(*middle(area("VIEW_3D")))
    yield from key("F9")
    yield 0.7
    screenshot(f"{kind}_f9")
    yield from key("ESC")
    yield 0.3


def a_maneuver(kind: str, *frames: int) -> Iterator[float]:
    """One by a new or the selected actor, looked at, and undone."""
    before = len(edits())
    yield from from_pie(kind)
    results[kind] = named_edits()
    screenshot(kind)
    yield from redone(kind)
    yield from looked_at(kind, *frames)
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z", ctrl=True)
    yield from until(lambda: len(edits()) == before, f"one Ctrl-Z does not undo {kind}", 20)


def cut_in() -> Iterator[float]:
    """A new car cuts in."""
    yield from deselected()
    yield from a_maneuver("cut_in", 20, 30, 40, 50, 60, 70)


def crossing() -> Iterator[float]:
    """A new pedestrian crosses."""
    yield from deselected()
    yield from a_maneuver("cross", 5, 25, 35, 42, 50, 60)


def chosen(name: str) -> Iterator[float]:
    """Select an actor, as a click on its line in the list does."""
    for other in list(bpy.context.selected_objects):
        other.select_set(False)
    obj = object_named(name)
    obj.select_set(True)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.ed.undo_push(message="Select")
    yield 0.3


def driving() -> str:
    """The name of the car in front of the vehicle that drives."""
    scene = bpy.context.scene
    ego = next(obj for obj in scene.objects if obj.unisim.kind == "EGO").matrix_world.inverted()

    def ahead(obj: bpy.types.Object) -> float:
        place = ego @ obj.matrix_world.translation
        return float(place.x + 2 * abs(place.y)) if place.x > 5 else 1e9

    cars = [
        obj for obj in scene.objects
        if obj.unisim.kind == "ACTOR" and obj.parent is not None and "Car" in obj.name and obj.visible_get()
    ]  # fmt: skip
    return min(cars, key=ahead).name


def selected_ones() -> Iterator[float]:
    """The car ahead brakes, changes lanes, and is followed."""
    car = driving()
    results["car"] = car
    for kind in ("brake", "lane_change", "platoon"):
        yield from chosen(car)
        try:
            yield from a_maneuver(kind, 30, 50, 70)
        except AssertionError as fault:
            results[f"{kind}_failed"] = str(fault)
            screenshot(f"{kind}_refused")
            yield from key("ESC")


def dragged() -> Iterator[float]:
    """The handle of a lane change, dragged sideways in the view from behind, and Esc."""
    car, before = driving(), len(edits())
    yield from chosen(car)
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.maneuver(kind="LANE_CHANGE")
    yield from until(lambda: len(edits()) > before, "no lane change", 20)
    looks = view()[2]
    from_behind(looks)
    looks.view_location = object_named(car).matrix_world.translation
    looks.update()
    yield 1.0
    module = sys.modules[f"{MODULE}.features.motion.maneuvers"]
    clock = sys.modules[f"{MODULE}.editing.sampled.clock"].Clock.of
    source = sys.modules[f"{MODULE}.bridge.objects.imported"].source_of
    places = dict(module.maneuver_handles(object_named(car), clock(source(bpy.context.scene).drive)))
    x, y = place(Vector(places["left_m"]))
    screenshot("handles")
    for ended in ("ESC", "LEFTMOUSE"):
        first = next(edit["left_m"] for edit in named_edits() if edit["type"] == "lane_change")
        yield from to(x + 2, y + 1)
        yield 0.3
        yield from to(x, y)
        yield 0.5
        event("LEFTMOUSE", "PRESS")
        yield 0.2
        for step in range(1, 6):
            yield from to(x + 12 * step, y)
            yield 0.3
        screenshot(f"handle_dragging_{ended}")
        if ended == "ESC":
            yield from key("ESC")
        event("LEFTMOUSE", "RELEASE")
        yield 0.8
        now = [edit["left_m"] for edit in named_edits() if edit["type"] == "lane_change"]
        results[f"dragged_{ended}"] = [first, *now]
        assert len(now) == 1, "the lane change is none any more"
        assert (now[0] == first) == (ended == "ESC"), f"{first} m became {now[0]} m"
    screenshot("handle_dragged")


def context_menu() -> Iterator[float]:
    """The right mouse button."""
    yield from to(*middle(area("VIEW_3D")))
    yield from key("RIGHTMOUSE")
    yield 0.5
    screenshot("context_menu")
    yield from key("ESC")
    yield 0.3


def steps() -> Iterator[float]:
    """The session."""
    for name, todo in (
        ("maneuvers_import", imported),
        ("cut_in_task", cut_in),
        ("crossing_task", crossing),
        ("selected_task", selected_ones),
        ("dragged_task", dragged),
        ("context_task", context_menu),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "maneuvers")
