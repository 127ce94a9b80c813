"""What a person does with mouse and keys, as simulated events. Run by `run.py`, which starts Blender with this file."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from mathutils import Vector

sys.path.insert(0, str(Path(__file__).parent))
from heart import uncounted
from session import (
    ARCHIVE,
    MODULE,
    OUT,
    SCENE,
    area,
    choose,
    from_behind,
    inside,
    named,
    screenshot,
    start,
    until,
    view,
)

mouse = [800, 450]
"""Where the mouse is, in pixels of the window from its lower left corner."""
window = [0]
"""Which of Blender's windows hears mouse and keys: a file browser has one of its own."""
KEYS = {" ": "SPACE", "/": "SLASH", ".": "PERIOD", "-": "MINUS", "_": "MINUS"} | dict(
    zip("0123456789", "ZERO ONE TWO THREE FOUR FIVE SIX SEVEN EIGHT NINE".split(), strict=True)
)
"""The keys of characters that are no letters."""


def event(kind: str, value: str, **more: Any) -> None:
    """One event where the mouse is."""
    windows = bpy.context.window_manager.windows
    heard = windows[
        min(window[0], len(windows) - 1)
    ]  # a key's press may have closed the window that was to hear its release
    heard.event_simulate(type=kind, value=value, x=mouse[0], y=mouse[1], **more)


def to(x: float, y: float) -> Iterator[float]:
    """Move the mouse."""
    mouse[:] = round(x), round(y)
    event("MOUSEMOVE", "NOTHING")
    yield 0.0


def key(kind: str, text: str = "", **modifiers: bool) -> Iterator[float]:
    """Press a key and let it go, with ctrl, shift, alt as they are given."""
    event(kind, "PRESS", **modifiers, **({"unicode": text} if text else {}))
    yield 0.0
    event(kind, "RELEASE", **modifiers)
    yield 0.0


def write(text: str) -> Iterator[float]:
    """Type letters, digits, and the characters of a path."""
    for letter in text:
        yield from key(KEYS.get(letter, letter.upper()), letter, **({"shift": True} if letter == "_" else {}))


def click() -> Iterator[float]:
    """Press the left mouse button and let it go."""
    yield from key("LEFTMOUSE")


def drag(x: float, y: float, to_x: float, to_y: float, shot: str = "", let_go: bool = True) -> Iterator[float]:
    """Drag from one place of the window to another, as a hand does: in steps, with a look at what is under
    the mouse first."""
    yield from to(x - 3, y)
    yield 0.15
    yield from to(x, y)
    yield 0.3
    event("LEFTMOUSE", "PRESS")
    yield 0.1
    for share in np.linspace(0.1, 1.0, 8):
        yield from to(x + share * (to_x - x), y + share * (to_y - y))
        yield 0.1
    if shot:
        yield 0.3
        screenshot(shot)
    if let_go:
        event("LEFTMOUSE", "RELEASE")
        yield 0.3


def middle(found: bpy.types.Area) -> tuple[float, float]:
    """The middle of an area."""
    region = next(r for r in found.regions if r.type == "WINDOW")
    return region.x + region.width / 2, region.y + region.height / 2


def place(point: Vector) -> tuple[float, float]:
    """Where the 3D view shows a point of the world."""
    found, _, looks = view()
    region = next(r for r in found.regions if r.type == "WINDOW")
    x, y = location_3d_to_region_2d(region, looks, point)
    return region.x + x, region.y + y


@uncounted
def scenario() -> Any:
    """What the scene stands for, as the extension would export it."""
    export = sys.modules[f"{MODULE}.features.drive.export_operators"]
    return export.scenario_of(bpy.context.scene, OUT.parent / "scenario.json")


def edits() -> list[tuple[str, str]]:
    """The scenario's edits: which they are, and of which actor."""
    return [(type(edit).__name__, getattr(edit, "actor", "")) for edit in scenario().edits]


def object_named(name: str) -> bpy.types.Object:
    """An object by its name: undo leaves no other hold on it."""
    return bpy.data.objects[name]


def look_at(name: str, away_m: float = 14.0) -> Iterator[float]:
    """Turn the view to an object, from behind and above."""
    _, _, looks = view()
    from_behind(looks)
    looks.view_location, looks.view_distance = object_named(name).matrix_world.translation, away_m
    looks.update()
    yield from to(*place(object_named(name).matrix_world.translation))


def steps() -> Iterator[float]:
    """The session."""
    yield from dropped_extension()
    yield from stopped_import()
    yield from dropped_scene()
    yield from sidebar()
    car = standing_car()
    yield from moved_by_hand(car)
    yield from copied_by_hand(car)
    yield from removed_by_hand(car)
    yield from shortcuts(car)
    yield from searched(car)
    yield from menu(car)
    yield from dropped_scenario()
    yield from other_camera()
    yield from dragged_asset()


def dropped_extension() -> Iterator[float]:
    """The zip, dropped onto the window: Blender asks, Enter agrees."""
    yield from to(*middle(area("VIEW_3D")))
    with inside(area("VIEW_3D")):
        bpy.ops.extensions.package_install_files("INVOKE_DEFAULT", url=str(ARCHIVE))
    yield 0.5
    screenshot("zip")
    yield from key("RET")
    yield from until(lambda: hasattr(bpy.types, "UNISIM_OT_check"), "the extension is not there")
    for other in list(bpy.data.objects):
        bpy.data.objects.remove(other)
    bpy.ops.ed.undo_push(message="An empty scene")


def drop(path: Path, undo: bool = False) -> None:
    """What Blender does where a file is dropped onto the 3D view; ``undo``: with the step of undo that it makes for an
    operator that ends at once."""
    handler = sys.modules[f"{MODULE}.features.drive.import_operators"].UNISIM_FH_json
    assert path.suffix in handler.bl_file_extensions.split(";")
    with inside(area("PROPERTIES")):
        assert not handler.poll_drop(bpy.context)
    with inside(area("VIEW_3D")):
        assert handler.poll_drop(bpy.context)
        group, name = handler.bl_import_operator.split(".")
        getattr(getattr(bpy.ops, group), name)("INVOKE_DEFAULT", undo, filepath=str(path))


def import_dropped(names: bool = True) -> Iterator[float]:
    """Drop a trained scene onto Blender's default file and let the window go on until it is imported; with ``names``,
    until actors have the words for their colours, too."""
    yield from to(*middle(area("VIEW_3D")))
    drop(SCENE)
    scene = bpy.context.scene
    yield from until(
        lambda: scene.render.engine == "UNISIM" and scene.camera.unisim.kind == "CAMERA", "the import does not end"
    )
    if names:
        yield from named()


def stopped_import() -> Iterator[float]:
    """Esc while objects are imported one at a time."""
    steps_of: Any = sys.modules[f"{MODULE}.features.operator_bases"]
    steps_of.BUSY_S, busy = 0.0, steps_of.BUSY_S
    drop(SCENE)
    yield from until(lambda: len(bpy.data.objects) > 4, "the import does not begin")
    yield from key("ESC")
    yield from until(lambda: not bpy.data.objects, "half a drive stays")
    assert not bpy.context.scene.unisim.log
    yield from key("Z", ctrl=True, shift=True)
    assert not bpy.data.objects
    steps_of.BUSY_S = busy


def dropped_scene() -> Iterator[float]:
    """A trained scene's file, imported to its end."""
    drop(SCENE)
    yield from until(lambda: bpy.context.scene.camera, "the import does not end")
    yield from named()
    assert not edits()
    yield from key("HOME")
    screenshot("dropped")


def sidebar() -> Iterator[float]:
    """N opens the sidebar, a click its tab."""
    found, space, _ = view()
    yield from to(*middle(found))
    if not space.show_region_ui:
        yield from key("N")
    tabs = next(r for r in found.regions if r.type == "UI")
    yield from until(lambda: tabs.width > 50, "the sidebar does not open")
    yield 0.5
    for down in range(20, tabs.height, 20):
        if tabs.active_panel_category == "UniSim":
            break
        yield from to(tabs.x + tabs.width - 10, tabs.y + tabs.height - down)
        yield from click()
        yield 0.1
    assert tabs.active_panel_category == "UniSim"
    yield 0.5
    screenshot("tab")


def standing_car() -> str:
    """A car that stands, by name."""
    standing = [
        o for o in bpy.context.scene.objects if o.unisim.kind == "ACTOR" and o.parent is None and "Car" in o.name
    ]
    return min(standing, key=lambda o: o.matrix_world.translation.length).name


def moved_by_hand(car: str) -> Iterator[float]:
    """A click, G X 3 Enter, undone and done again."""
    yield from look_at(car)
    yield from click()
    yield from until(
        lambda: bpy.context.view_layer.objects.active == object_named(car) and object_named(car).select_get(),
        "not selected",
    )
    before = object_named(car).location.x
    yield from key("G")
    yield from key("X")
    yield from key("THREE", "3")
    yield from key("RET")
    yield from until(lambda: abs(object_named(car).location.x - before - 3) < 1e-4, "not moved")
    assert edits() == [("Move", object_named(car).unisim.uid)]
    screenshot("moved_by_hand")
    yield from key("Z", ctrl=True)
    yield from until(lambda: abs(object_named(car).location.x - before) < 1e-4, "not undone")
    assert not edits()
    yield from key("Z", ctrl=True, shift=True)
    yield from until(lambda: abs(object_named(car).location.x - before - 3) < 1e-4, "not done again")
    assert edits() == [("Move", object_named(car).unisim.uid)]


def copied_by_hand(car: str) -> Iterator[float]:
    """Shift-D, the mouse, Enter."""
    count = len(bpy.data.objects)
    x, y = mouse
    yield from key("D", shift=True)
    yield from to(x + 60, y)
    yield from to(x + 160, y)
    yield from key("RET")
    yield from until(lambda: len(bpy.data.objects) == count + 1, "not copied")
    copy = bpy.context.view_layer.objects.active
    assert (copy.location - object_named(car).location).length > 0.5
    assert edits() == [("Duplicate", copy.unisim.uid), ("Move", copy.unisim.uid)]
    screenshot("copied_by_hand")


def removed_by_hand(car: str) -> Iterator[float]:
    """X on the copy, then on the car itself; Ctrl-Z brings that back."""
    uid, copy = object_named(car).unisim.uid, bpy.context.view_layer.objects.active.name
    yield from key("X")
    yield 0.3
    screenshot("delete")
    yield from key("RET")
    yield from until(lambda: copy not in bpy.data.objects, "not removed")
    yield from look_at(car)
    yield from click()
    yield from key("X")
    yield from key("RET")
    yield from until(lambda: car not in bpy.context.scene.objects, "not removed")
    assert edits() == [("Remove", uid)]
    yield from key("Z", ctrl=True)
    yield from until(lambda: car in bpy.context.scene.objects, "not brought back")


def shortcuts(car: str) -> Iterator[float]:
    """The extension's own keys."""
    yield from look_at(car)
    yield from click()
    uid, height = object_named(car).unisim.uid, object_named(car).location.z
    yield from key("D", ctrl=True, alt=True)
    yield from until(lambda: ("Duplicate", uid) in edits(), "Ctrl-Alt-D does not copy")
    yield from key("Z", ctrl=True)
    yield from until(lambda: ("Duplicate", uid) not in edits(), "the copy is not undone")
    object_named(car).location.z += 2.0
    yield 0.1
    yield from key("K", ctrl=True, alt=True)
    yield from until(
        lambda: any(w.name == car for w in bpy.context.scene.unisim_check.warnings), "Ctrl-Alt-K finds nothing"
    )
    screenshot("checked")
    yield from key("G", ctrl=True, alt=True)
    yield from until(
        lambda: abs(object_named(car).location.z - height) < 0.15, "Ctrl-Alt-G does not put it on the ground"
    )
    driving = next(
        o for o in bpy.context.scene.objects if o.unisim.kind == "ACTOR" and o.parent and not o.hide_viewport
    )
    choose(driving)
    yield 0.1
    yield from key("T", ctrl=True, alt=True)
    yield from until(lambda: ("Move", driving.unisim.uid) in edits(), "Ctrl-Alt-T does not retime")


def searched(car: str) -> Iterator[float]:
    """F3, a few letters, Enter."""
    yield from look_at(car)
    yield from click()
    height = object_named(car).location.z
    object_named(car).location.z += 2.0
    yield 0.1
    yield from key("F3")
    yield 0.5
    yield from write("snap to ground")
    yield 0.5
    screenshot("search")
    yield from key("RET")
    yield from until(lambda: abs(object_named(car).location.z - height) < 0.01, "the search does not find an operator")


def menu(car: str) -> Iterator[float]:
    """The extension's menu at the end of Blender's own, and its last entry by keys."""
    with inside(area("VIEW_3D")):
        bpy.ops.wm.call_menu(name="VIEW3D_MT_object")
    yield from key("UP_ARROW")
    yield from key("RIGHT_ARROW")
    yield 0.5
    screenshot("menu")
    yield from key("UP_ARROW")
    bpy.context.scene.unisim_check.warnings.clear()
    object_named(car).location.z += 2.0
    yield from key("RET")
    yield from until(
        lambda: any(w.name == car for w in bpy.context.scene.unisim_check.warnings),
        "the menu's last entry does not check",
    )
    object_named(car).location.z -= 2.0


def dropped_scenario() -> Iterator[float]:
    """The scenario, exported, and dropped onto a new scene."""
    path = OUT.parent / "scenario.json"
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.export_scenario(filepath=str(path))
    before, old = edits(), bpy.context.scene.name
    assert before
    with inside(area("VIEW_3D")):
        bpy.ops.scene.new(type="NEW")
    assert bpy.context.scene.name != old and not bpy.context.scene.objects
    drop(path)
    yield from until(lambda: bpy.context.scene.camera, "the scenario is not imported")
    yield from until(lambda: edits() == before, "the scenario's edits are not applied", 10)
    yield from key("HOME")
    yield 0.5
    screenshot("scenario")
    bpy.context.window_manager.windows[0].scene = bpy.data.scenes[old]
    yield 0.1


def other_camera() -> Iterator[float]:
    """Ctrl-Numpad 0 with another camera of the rig selected; undone, the size is that of the one before."""
    scene = bpy.context.scene
    first = scene.camera.name
    size = scene.render.resolution_x, scene.render.resolution_y
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.add_camera("INVOKE_DEFAULT", width=320, height=200)
    added = scene.camera.name
    yield 0.1
    assert (scene.render.resolution_x, scene.render.resolution_y) == (320, 200)
    choose(object_named(first))
    yield 0.1
    yield from to(*middle(area("VIEW_3D")))
    yield from key("NUMPAD_0", ctrl=True)
    yield from until(lambda: bpy.context.scene.camera.name == first, "Ctrl-Numpad 0 does not change the camera")
    yield from until(
        lambda: bpy.context.scene.render.resolution_x == size[0], "the resolution does not follow the camera"
    )
    screenshot("camera")
    bpy.context.scene.camera = object_named(added)
    yield from until(lambda: bpy.context.scene.render.resolution_x == 320, "the resolution does not follow a script")
    choose(object_named(first))
    bpy.context.scene.camera = object_named(first)
    yield from until(
        lambda: bpy.context.scene.render.resolution_x == size[0], "the resolution does not follow a script"
    )


def dragged_asset() -> Iterator[float]:
    """An actor library, shown in an Asset Browser below the view, and one of its assets dragged onto the street."""
    library = OUT.parent / "library" / "actors.blend"
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.make_library("EXEC_DEFAULT", filepath=str(library))
    yield from until(library.is_file, "the library is not written")
    bpy.context.preferences.filepaths.asset_libraries.new(name="Actors", directory=str(library.parent))
    with inside(area("VIEW_3D")):
        bpy.ops.screen.area_split(direction="HORIZONTAL", factor=0.4)
    _, _, looks = view()
    from_behind(looks)
    yield 0.2
    browser = min(
        (a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == "VIEW_3D"), key=lambda a: a.y
    )
    browser.ui_type = "ASSETS"
    yield 0.2
    browser.spaces.active.params.asset_library_reference = "Actors"
    yield from to(*middle(browser))
    for _ in range(100):  # until the library is read, there is nothing to select
        yield from key("A")
        yield 0.2
        with inside(browser):
            if bpy.context.selected_assets:
                break
    spot = Vector((10.0, -8.0, 0.0))
    before, there = edits(), {o.name for o in bpy.context.scene.objects}
    tiles = next(r for r in browser.regions if r.type == "WINDOW")
    yield from to(tiles.x + 60, tiles.y + tiles.height - 60)
    event("LEFTMOUSE", "PRESS")
    yield 0.0
    x, y = mouse
    end_x, end_y = place(spot)
    for share in np.linspace(0.05, 1.0, 12):
        yield from to(x + share * (end_x - x), y + share * (end_y - y))
        yield 0.1
    screenshot("dragging")
    event("LEFTMOUSE", "RELEASE")
    yield from until(lambda: len(bpy.context.scene.objects) > len(there), "nothing is dropped")
    (new,) = {o.name for o in bpy.context.scene.objects} - there
    yield 0.5
    screenshot("dragged")
    added = [edit for edit in edits() if edit not in before]
    assert added == [("Insert", object_named(new).unisim.look)], added
    apart = object_named(new).matrix_world.translation - spot
    assert apart.xy.length < 3.0 and abs(apart.z - object_named(new).dimensions.z / 2) < 0.01, apart


if __name__ == "__main__":
    start(steps(), "hands")
