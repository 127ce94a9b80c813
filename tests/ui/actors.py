"""Finding the actor that one wants: the list, the presence timeline, thumbnails. Run by `run.py`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
from buttons import found_at, open_panel, place_of, press
from hands import click, edits, import_dropped, key, middle, mouse, object_named, sidebar, to, write
from heart import uncounted
from session import (
    ARCHIVE,
    MODULE,
    OUT,
    area,
    inside,
    named,
    screenshot,
    start,
    until,
    view,
    viewport_image,
    wait_for_image,
)
from tasks import begin, changed, task

BLUE = np.array([0x47, 0x72, 0xB3])
"""Of chosen rows and pressed buttons, in Blender's own theme."""
ROW_PX = 36
GROUP_UP_PX = 77
"""How far above the list's first row the class filter is."""
SECOND = "car-03"
"""The second of the street's cars by name."""
SECOND_DOWN_PX = 141
"""How far below the middle of the chosen actor's image the grid's second one is."""


def module(name: str) -> Any:
    """A module of the extension's."""
    return sys.modules[f"{MODULE}.{name}"]


@uncounted
def shot(name: str) -> NDArray[np.float32]:
    """A screenshot (H, W, 3) in steps of eight bits, the bottom row first, as the mouse counts."""
    screenshot(name)
    image = bpy.data.images.load(str(OUT / f"{name}.png"), check_existing=False)
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.array(image.pixels[:], np.float32).reshape(height, width, -1)[..., :3] * 255
    bpy.data.images.remove(image)
    return pixels


def blue_runs(pixels: NDArray[np.float32], x: int) -> list[tuple[int, int]]:
    """Where a column of the screen has the theme's blue for 12 to 30 pixels: from and to, the topmost first."""
    is_blue = (np.abs(pixels[:, x - 8 : x + 9] - BLUE).max(-1) < 14).any(1)  # letters stand in it
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_blue, [False]]).astype(int)))
    runs = [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True) if 12 <= b - a <= 30]
    return sorted(runs, reverse=True)


def shown() -> list[Any]:
    """What the list shows, in order."""
    return list(module("features.actor_list.listing").table_of(bpy.context.scene).shown)


def chosen() -> str:
    """The name of the active object, where it is selected."""
    active = bpy.context.view_layer.objects.active
    return str(active.name) if active is not None and active.select_get() else ""


def tab() -> bpy.types.Region:
    """The sidebar."""
    return next(r for r in view()[0].regions if r.type == "UI")


def first_row() -> Iterator[float]:
    """Put the mouse on the list's first row, which is found as the chosen one on the screen."""
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.choose_actor("EXEC_DEFAULT", True, name=shown()[0].name)
    x = tab().x + 165
    for _ in range(20):  # until it is drawn: the row, and the pressed buttons below the list
        yield 0.5
        runs = blue_runs(shot("rows"), x)
        if len(runs) > 1:
            break
    assert len(runs) > 1, "no row of the list is marked"
    yield from to(x - 90, (runs[0][0] + runs[0][1]) / 2)


def first_import() -> Iterator[float]:
    """A trained scene dropped onto Blender's default file."""
    yield from import_dropped(names=False)
    yield from sidebar()
    yield from open_panel("Actors", "unisim_actors")
    assert not edits()


def thumbnails_come() -> Iterator[float]:
    """Thumbnails and words for colours come in by themselves; nothing counts as edited."""
    yield from named()
    yield from until(
        lambda: any(o.name == "Car 12, white" for o in bpy.context.scene.objects), "no name has a colour", 10
    )
    yield from until(lambda: any(entry.name == "Car 12, white" for entry in shown()), "the list has the old names", 10)
    assert not edits() and not any(entry.edited for entry in shown())
    yield 1.0


def filtered_car() -> Iterator[float]:
    """The class filter, sorting aside, a click on a row: selected, active and framed."""
    bpy.context.scene.frame_set(9)
    yield from first_row()
    x, y = mouse
    yield from to(x, y + GROUP_UP_PX)
    yield from click()
    yield 0.5
    screenshot("classes")
    yield from key("C")  # the letter that is underlined
    manager = bpy.context.window_manager
    yield from until(lambda: manager.unisim_actors.group != "ALL", "the class is not chosen", 5)
    yield 0.5
    listed = shown()
    assert listed and all(entry.group == "CAR" for entry in listed)
    yield from first_row()
    x, y = mouse
    wanted = shown()[2]
    yield from to(x, y - 2 * ROW_PX)
    yield from click()
    yield from until(lambda: chosen() == wanted.name, f"{wanted.name} is not selected", 5)
    assert [o.name for o in bpy.context.selected_objects] == [wanted.name]
    yield 1.0


def timeline_click() -> Iterator[float]:
    """A click on a bar selects its actor and goes to the time; the wheel scrolls."""
    scene = bpy.context.scene
    filtering = bpy.context.window_manager.unisim_actors
    filtering.group, filtering.within_m = "ALL", 0.0
    scene.unisim.show_timeline = True
    yield 1.0
    found = area("VIEW_3D")
    window = next(r for r in found.regions if r.type == "WINDOW")
    with inside(found):
        timeline = module("features.actor_list.timeline").timeline_of(bpy.context)
    assert timeline is not None
    entry = timeline.rows[5]
    x, y = window.x + timeline.x_of(1.2), window.y + timeline.row_bottom(5) + timeline.row_px / 2
    yield from to(x, y + 200)
    yield 0.2
    yield from to(x, y)
    yield 0.3
    yield from click()
    yield from until(
        lambda: bpy.context.view_layer.objects.active.name == entry.name, f"{entry.name} is not selected", 5
    )
    yield from until(lambda: scene.frame_current == 12, f"frame {scene.frame_current} and not 12 is shown", 5)
    for _ in range(2):
        yield from key("WHEELDOWNMOUSE")
        yield 0.2
    assert bpy.context.window_manager.unisim_actors.scroll > 0, "the wheel does not scroll"
    yield 0.5


def second_by_thumbnail(words: str, name: str) -> Iterator[float]:
    """F3, an operator that shows thumbnails; a click on the image, on the second one of the grid, and on the button."""
    yield from to(*middle(area("VIEW_3D")))
    yield from key("F3")
    yield 0.7
    yield from write(words)
    yield 0.7
    yield from key("RET")
    yield 1.0
    right, height = blue_button(f"{name}_dialog")
    yield from to(right - 86, height + 157)
    yield 0.3
    yield from click()
    yield 1.5
    screenshot(f"{name}_grid")
    yield from to(mouse[0], mouse[1] - SECOND_DOWN_PX)
    yield 0.2
    yield from click()
    yield 0.7
    screenshot(f"{name}_chosen")
    yield from to(right, height)
    yield from click()


@uncounted
def blue_button(name: str) -> tuple[float, float]:
    """Where the dialog at the mouse has its blue button."""
    pixels = shot(name)
    wide = np.abs(pixels - BLUE).max(-1) < 14
    tall = [
        (x, run) for x in range(mouse[0] - 300, mouse[0] + 300) for run in blue_runs(pixels, x)[:1] if wide[run[0], x]
    ]
    assert tall, "the dialog has no button"
    return float(np.median([x for x, _ in tall])), float(np.median([(a + b) / 2 for _, (a, b) in tall]))


def within_distance() -> Iterator[float]:
    """20 m typed into Within: the list has the actors that near, and X lists all again."""
    scene, filtering = bpy.context.scene, bpy.context.window_manager.unisim_actors
    filtering.group = "ALL"
    scene.frame_set(9)
    yield 1.0
    everyone = {entry.name for entry in shown()}
    ego = next(o for o in scene.objects if o.unisim.kind == "EGO").matrix_world.translation
    actors = [o for o in scene.objects if o.unisim.kind == "ACTOR" and not o.hide_viewport]
    away = {o.name: (o.matrix_world.translation - ego).length for o in actors}
    yield from press("unisim_actors.is_near", columns=(0.49, 0.51, 0.53))
    assert filtering.within_m == 50.0, "the switch of the distance does not turn it on"
    yield from place_of("unisim_actors.within_m", columns=(0.75,))
    yield from to(*found_at[0])
    yield 0.2
    yield from key("RET")
    yield 0.2
    yield from key("A", ctrl=True)
    yield from write("20")
    yield from key("RET")
    yield from until(lambda: abs(filtering.within_m - 20) < 1e-3, "the field does not take 20", 5)
    yield from until(lambda: len(shown()) < len(everyone), "the list does not follow", 5)
    yield 0.5
    screenshot("within_20_m")
    listed = {entry.name for entry in shown()}
    # where an object's origin counts, or only the ground plane, tells within half a metre
    assert listed >= {name for name, metres in away.items() if metres < 19.5}, (listed, away)
    assert listed <= {name for name, metres in away.items() if metres < 20.5}, (listed, away)
    assert listed
    yield from press("unisim.clear_actor_filter", columns=(0.83,))
    yield from until(lambda: {entry.name for entry in shown()} == everyone, "X does not list all again", 5)
    assert not edits()


def inserted() -> Iterator[float]:
    """Add > Actor of the Drive by thumbnail, on the path ahead of the vehicle; one Ctrl-Z."""
    _, space, looks = view()
    scene = bpy.context.scene
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.choose_actor(
            "EXEC_DEFAULT", True, name=next(o.name for o in scene.objects if o.unisim.uid == "car-01")
        )
    space.shading.type, looks.view_perspective = "SOLID", "CAMERA"
    ego = next(o for o in scene.objects if o.unisim.kind == "EGO").name
    there = {o.name for o in scene.objects}
    yield 0.5
    yield from second_by_thumbnail("actor of the drive", "inserting")
    yield from until(lambda: len(bpy.context.scene.objects) > len(there), "nothing is inserted", 10)
    (new,) = {o.name for o in bpy.context.scene.objects if o.unisim.kind == "ACTOR"} - there  # and its trajectory
    yield 1.0
    screenshot("inserted_actor")
    assert edits() == [("Insert", SECOND)] and object_named(new).unisim.look == SECOND, edits()
    ahead = object_named(ego).matrix_world.inverted() @ object_named(new).matrix_world.translation
    assert 5.0 < ahead.x < 60.0 and abs(ahead.y) < 3.0, ahead
    assert abs(ahead.z - object_named(new).dimensions.z / 2) < 0.3, ahead
    assert chosen() == new, "it is not selected"
    yield from key("Z", ctrl=True)
    yield from until(lambda: {o.name for o in bpy.context.scene.objects} == there, "one Ctrl-Z does not undo it", 10)
    assert not edits()


def replaced() -> Iterator[float]:
    """Replace Appearance by thumbnail in Rendered shading: the image follows, and undo takes it back."""
    _, space, looks = view()
    scene = bpy.context.scene
    scene.unisim.show_timeline, bpy.context.window_manager.unisim_actors.within_m = False, 0.0
    looks.view_perspective = "CAMERA"
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.choose_actor(
            "EXEC_DEFAULT", True, name=next(o.name for o in scene.objects if o.unisim.uid == "car-01")
        )
    car = bpy.context.view_layer.objects.active.name
    scene.frame_set(9)
    space.shading.type = "RENDERED"
    yield from wait_for_image()
    before = viewport_image()
    yield from second_by_thumbnail("replace appearance", "replacing")
    yield from until(lambda: object_named(car).unisim.look, "the appearance is not replaced", 10)
    yield from until(lambda: changed(before), "the image does not follow", 60)
    assert edits() == [("Swap", "car-01")] and object_named(car).unisim.look == SECOND
    screenshot("appearance")
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z", ctrl=True)
    yield from until(lambda: not object_named(car).unisim.look, "not undone", 10)
    assert not edits()
    yield from until(lambda: not any(entry.edited for entry in shown()), "the list still has it as edited", 10)
    assert any(entry.name == "Car 12, white" for entry in shown()), "undo leaves old names"
    yield from wait_for_image()


def steps() -> Iterator[float]:
    """The session."""
    bpy.ops.extensions.package_install_files(
        filepath=str(ARCHIVE), repo="user_default", enable_on_install=True, overwrite=True
    )
    yield 1.0
    begin()
    for name, todo in (
        ("actors_import", first_import),
        ("thumbnails_come", thumbnails_come),
        ("filtered_car", filtered_car),
        ("within_distance", within_distance),
        ("timeline_click", timeline_click),
        ("replaced", replaced),
        ("inserted_by_thumbnail", inserted),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "actors")
