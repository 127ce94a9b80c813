"""Speeds dragged in the graph, retimed cars, other classes, rows of cones and parked rows, with mouse and keys. Run by
`run.py`."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

sys.path.insert(0, str(Path(__file__).parent))
import hands
from hands import click, edits, import_dropped, key, look_at, middle, object_named, to
from motion import driving, module
from session import OUT, area, from_behind, inside, results, screenshot, start, until, view
from tasks import arrived, install, task


def imported() -> Iterator[float]:
    """The scene, or the log that `UNISIM_UI_LOG` names, seen from behind and above, with its speed graph."""
    if os.environ.get("UNISIM_UI_LOG"):
        with inside(area("VIEW_3D")):
            bpy.ops.unisim.import_log("INVOKE_DEFAULT", filepath=str(OUT.parent / "log"))
        yield from arrived()
    else:
        yield from import_dropped()
    from_behind(view()[2])
    bpy.context.scene.unisim_motion.show_graph = True
    bpy.context.scene.frame_set(8)
    yield 0.5


def picked(car: str) -> Iterator[float]:
    """A click on an actor."""
    yield from look_at(car)
    yield from click()
    yield from until(lambda: object_named(car).select_get(), "not selected", 5)


def in_graph(time_s: float) -> tuple[float, float]:
    """Where the window shows the speed graph's curve at a time."""
    overlay, layout = module("features.motion.overlay"), module("editing.layout.speed_graph")
    found, space, looks = view()
    region = next(r for r in found.regions if r.type == "WINDOW")
    with bpy.context.temp_override(area=found, region=region, space_data=space):
        graph, corner, scale = overlay.graph_place(bpy.context)
    axes = layout.axes_of(graph)
    at = np.array([axes.x(np.array(time_s)), axes.y(layout.speed_of(graph, time_s))])
    x, y = corner + scale * at
    return region.x + float(x), region.y + float(y)


def moves_to(x: float, y: float, to_x: float, to_y: float) -> Iterator[float]:
    """Press the mouse at a place and move it to another one, as a hand does."""
    for share in np.linspace(0.1, 1.0, 8):
        yield from to(x + share * (to_x - x), y + share * (to_y - y))
        yield 0.1


def dragged_speed() -> Iterator[float]:
    """The curve at 1 s, dragged down by 40 pixels, the wheel turned; one Ctrl-Z; then the same, left by Esc."""
    car = driving()
    yield from picked(car)
    yield 0.5
    x, y = in_graph(1.0)
    stood = object_named(car).matrix_world.translation.copy()
    for ended in ("LEFTMOUSE", "ESC"):
        yield from to(x + 2, y + 1)
        yield 0.2
        yield from to(x, y)
        yield 0.4
        screenshot("speed_hover")
        hands.event("LEFTMOUSE", "PRESS")
        yield 0.1
        yield from moves_to(x, y, x, y - 40)
        yield from key("WHEELUPMOUSE")
        yield 0.4
        screenshot(f"speed_dragging_{ended}")
        assert (object_named(car).matrix_world.translation - stood).length > 0.3 or bpy.context.scene.frame_current < 9
        if ended == "ESC":
            yield from key("ESC")
            yield 0.3
            hands.event("LEFTMOUSE", "RELEASE")
            yield from until(lambda: not edits(), "Esc leaves the speed", 5)
            continue
        hands.event("LEFTMOUSE", "RELEASE")
        yield from until(lambda: ("Move", object_named(car).unisim.uid) in edits(), "not dragged", 5)
        yield 0.3
        screenshot("speed_dragged")
        yield from key("Z", ctrl=True)
        yield from until(lambda: not edits(), "one Ctrl-Z does not undo the speed", 5)
        yield 0.3


def checked() -> list[str]:
    """What Check Edits warns of."""
    bpy.ops.unisim.check()
    return [f"{w.name}: {w.text}" for w in bpy.context.scene.unisim_check.warnings]


def retimed() -> Iterator[float]:
    """Ctrl-Alt-T with its defaults for Speed and Stretch: Check Edits passes."""
    car = driving()
    for mode in ("SPEED", "STRETCH"):
        yield from picked(car)
        bpy.context.scene.frame_set(3)
        yield from to(*middle(area("VIEW_3D")))
        with bpy.context.temp_override(area=view()[0], region=view()[0].regions[-1]):
            bpy.ops.unisim.retime_actor("INVOKE_DEFAULT", True, mode=mode)
        yield from until(lambda: edits(), "not retimed", 5)
        yield 0.5
        screenshot(f"retimed_{mode}")
        warned = [line for line in checked() if "m/s²" in line]
        results[f"warned_{mode}"] = warned
        assert not warned, warned
        yield from key("Z", ctrl=True)
        yield from until(lambda: not edits(), "one Ctrl-Z does not undo it", 5)


def searched(words: str) -> Iterator[float]:
    """F3, some letters, Enter."""
    yield from to(*middle(area("VIEW_3D")))
    yield from key("F3")
    yield 0.5
    yield from hands.write(words)
    yield 0.7
    yield from key("RET")


def in_rows() -> list[str]:
    """The names of what stands in rows."""
    return sorted(obj.name for obj in bpy.context.scene.objects if obj.unisim.row)


def cones() -> Iterator[float]:
    """Row of Cones by F3; its end dragged aside; Esc; one Ctrl-Z for each."""
    bpy.context.scene.frame_set(0)
    yield from searched("row of cones")
    yield from until(lambda: [kind for kind, _ in edits()] == ["Row"], "no row", 10)
    from_behind(view()[2])
    yield 0.5
    screenshot("cones")
    assert not checked(), checked()
    rows = module("features.motion.rows")
    for ended in ("LEFTMOUSE", "ESC"):
        before = str(hands.scenario().edits)
        x, y = hands.place(Vector(rows.ends(bpy.context)[1]))
        yield from to(x - 3, y)
        yield 0.2
        yield from to(x, y)
        yield 0.5
        hands.event("LEFTMOUSE", "PRESS")
        yield 0.1
        yield from moves_to(x, y, x - 90, y - 10)
        yield 0.3
        screenshot(f"cones_dragging_{ended}")
        if ended == "ESC":
            yield from key("ESC")
        hands.event("LEFTMOUSE", "RELEASE")
        yield 0.5
        assert (str(hands.scenario().edits) == before) == (ended == "ESC"), "the drag"
    screenshot("cones_dragged")
    yield from key("Z", ctrl=True)
    yield 0.5
    yield from key("Z", ctrl=True)
    yield from until(lambda: not edits() and not in_rows(), "two Ctrl-Z do not undo the row and its drag", 5)


def parked() -> Iterator[float]:
    """A click on a parked car, Parked Row by F3; Swap Class of the car from the menu; each one Ctrl-Z."""
    standing = [
        o for o in bpy.context.scene.objects if o.unisim.kind == "ACTOR" and o.parent is None and "Car" in o.name
    ]
    car = min(standing, key=lambda o: o.matrix_world.translation.length).name
    yield from picked(car)
    yield from searched("parked row")
    yield from until(lambda: [kind for kind, _ in edits()] == ["Row"], "no row", 10)
    from_behind(view()[2])
    yield 0.5
    screenshot("parked")
    assert not checked(), checked()
    yield from key("F9")
    yield 0.7
    screenshot("parked_panel")
    yield from key("ESC")
    yield 0.3
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z", ctrl=True)
    yield from until(lambda: not edits(), "one Ctrl-Z does not undo the row", 5)
    yield from picked(car)
    for group in ("TRUCK", "PERSON") if os.environ.get("UNISIM_UI_LOG") else ("TRUCK",):
        with bpy.context.temp_override(area=view()[0], region=view()[0].regions[-1]):
            bpy.ops.unisim.swap_class("INVOKE_DEFAULT", True, group=group)
        yield 0.5
        screenshot(f"swapped_{group}")
        results[f"swap_warned_{group}"] = checked()
        yield from key("Z", ctrl=True)
        yield from until(lambda: not edits(), "one Ctrl-Z does not undo the class", 5)


def steps() -> Iterator[float]:
    """The session."""
    yield from install()
    for name, todo in (
        ("placing_import", imported),
        ("dragged_speed", dragged_speed),
        ("retimed_smoothly", retimed),
        ("row_of_cones", cones),
        ("parked_row", parked),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "placing")
