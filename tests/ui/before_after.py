"""Pictures of what earlier versions of the extension did wrong, taken with any version of it. Run by `run.py`.

Each task does what a person does with mouse and keys, leaves pictures of the window, the last one under its name, and
notes in `seen` what the scenario or the selection says of it. It judges nothing but that the steps could be done:
`tools/before_after.py` puts the pictures of two versions beside each other.
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

sys.path.insert(0, str(Path(__file__).parent))
from browser import choose_path, menu_entry
from buttons import (
    ROW,
    Place,
    buttons,
    found_at,
    menu_button,
    open_panel,
    place_of,
    press,
    redo_panel,
    region_of,
    reports,
    under_mouse,
)
from displaced import select
from first_drive import searched
from hands import click, edits, key, look_at, middle, mouse, object_named, place, sidebar, to
from heart import heart
from pixels import HEADLESS, apart, export, frame_rectangle, grab, part, rendered, uncovered
from session import (
    MODULE,
    OUT,
    SCENE,
    area,
    choose,
    from_behind,
    named,
    results,
    screenshot,
    start,
    until,
    view,
    wait_for_image,
)
from tasks import (
    arrived,
    bare_view,
    click_car,
    fresh,
    imported,
    install,
    keys,
    redraw_alone,
    seen,
    task,
    through_camera,
)

WIDE = 640
"""How wide the camera's frame is in pictures of the Rendered view, in pixels."""
SMALL_LOG = OUT.parent / "small"
"""A log of three small frames that no scene is trained on, which `run.py` makes."""
ALONE = OUT.parent / "alone.blend"
"""That log, imported."""
TOOLTIP_S = 2.0
"""After how long Blender shows a button's tooltip, with time to spare."""
spots: dict[str, Place] = {}
"""Where buttons are whose tooltips are shown."""


def note(name: str, **values: Any) -> None:
    """Keep what a task saw beside its pictures."""
    table = results.setdefault("seen", {})
    assert isinstance(table, dict)
    table.setdefault(name, {}).update(values)


def framed(shading: str, bare: bool = False, width: int = WIDE) -> Iterator[float]:
    """Look through the camera with the boxes in view, or with ``bare`` without boxes and overlays."""
    yield from through_camera(rendered=False, width=width)
    bare_view(view()[1], bare)
    view()[1].shading.type = shading
    yield 0.3


def first_import() -> Iterator[float]:
    """File > Import > Trained Neural Scene in Blender's default file."""
    yield from menu_entry("trained neural")
    yield from choose_path(SCENE)
    yield from arrived()
    yield from named()
    area("PROPERTIES").spaces.active.context = "RENDER"
    yield 0.5
    scene = bpy.context.scene
    note(
        "first_import",
        camera=scene.camera.name,
        engine=scene.render.engine,
        size=[scene.render.resolution_x, scene.render.resolution_y],
    )


def clicked() -> Iterator[float]:
    """Clicks on two rows of places across the car ahead, three pixels apart, through the camera: what each
    of them selects."""
    yield from fresh()
    yield from framed("SOLID", width=960)
    car = seen(driving=True)
    box = [place(object_named(car).matrix_world @ Vector(corner)) for corner in object_named(car).bound_box]
    low, high = np.min(box, axis=0), np.max(box, axis=0)
    kinds: dict[str, int] = {}
    aside = None
    for up in (0.35, 0.65):
        for across in np.arange(0.1, 0.9, 3 / (high - low)[0]):
            yield from key("A", alt=True)
            yield from to(*(low + (high - low) * (across, up)))
            yield from click()
            yield 0.1
            active = bpy.context.view_layer.objects.active
            kind = active.unisim.kind if active is not None and active.select_get() else "NOTHING"
            kind = "THE CAR" if kind == "ACTOR" and active.name == car else kind
            kinds[kind] = kinds.get(kind, 0) + 1
            aside = aside or (tuple(mouse) if kind != "THE CAR" else None)
    note("clicked", actor=object_named(car).unisim.uid, selected=kinds)
    yield from key("A", alt=True)
    yield from to(*(aside or (low + high) / 2))
    yield from click()
    yield 1.0
    screenshot("clicked_once")
    yield from key("A")
    yield 0.5
    kinds = {}
    for one in bpy.context.selected_objects:
        kinds[one.unisim.kind] = kinds.get(one.unisim.kind, 0) + 1
    note("clicked", select_all=kinds)


def beside_render(name: str) -> Iterator[float]:
    """Leave what `unisim render` makes of the exported scenario beside the view's picture, and note how
    many pixels differ."""
    yield from wait_for_image()
    yield 0.7
    screenshot(name)
    screen, frame = grab(), frame_rectangle()
    images: list[Any] = []
    yield from rendered(export(name), images, frame[2])
    on, free = part(screen, frame), uncovered(screen, frame)
    (path,) = (HEADLESS / name).glob("camera/*/*.png")
    (OUT / f"{name}_render.png").write_bytes(path.read_bytes())
    note(name, frame=list(frame))
    if on.shape == images[0].shape:
        far = apart(on, images[0])[free]
        note(name, pixels=int(free.sum()), differing=int((far > 2).sum()), furthest=int(far.max()))


def edited() -> Iterator[float]:
    """A car that drives removed with X, one that stands moved with G Y -2; the Rendered view of it."""
    yield from fresh()
    yield from framed("SOLID", width=960)
    yield from click_car(driving=True)
    yield from keys("X", "RET")
    yield 0.3
    yield from click_car(driving=False)
    yield from keys("G", "Y", "-", "2", "RET")
    yield 0.3
    note("edited", edits=edits())
    yield from framed("RENDERED", bare=True)
    yield from beside_render("edited")


def shifted() -> Iterator[float]:
    """The same after Shift Ego Lane 2 m."""
    yield from fresh()
    yield from searched("shift ego")
    yield from until(lambda: edits(), "the ego vehicle is not shifted", 10)
    yield from to(600, 500)
    yield from redo_panel("1", "2")
    yield 0.3
    note("shifted", edits=edits())
    yield from framed("RENDERED", bare=True)
    yield from beside_render("shifted")


def moved() -> Iterator[float]:
    """G Y 3 on a car that drives, at frame 5, and the next frame."""
    yield from fresh()
    bpy.context.scene.frame_set(5)
    yield from framed("SOLID", width=960)
    car = seen(driving=True)
    yield from look_at(car, 24.0)
    yield 0.5
    screenshot("moved_recorded")
    yield from click()
    yield 0.3
    yield from keys("G", "Y", "3", "RET")
    yield 1.0
    screenshot("moved_at_once")
    note("moved", actor=object_named(car).unisim.uid, at_once=edits(), y=object_named(car).matrix_world.translation.y)
    yield from key("RIGHT_ARROW")
    yield 1.0
    note("moved", next_frame=edits(), next_y=object_named(car).matrix_world.translation.y)


def retimed(shading: str) -> Iterator[float]:
    """A delay from the panel's menu; nothing is done afterwards that would draw the window again."""
    yield from fresh()
    bpy.context.scene.frame_set(5)
    yield from framed("SOLID", width=960)
    yield from click_car(driving=True)
    car = bpy.context.view_layer.objects.active.name
    above = "unisim.delete_actor()" if drives_on_parent(car) else "unisim.insert_actor"
    yield from place_of(above)
    yield from to(*middle(area("VIEW_3D")))
    view()[1].shading.type = shading
    if shading == "RENDERED":
        yield from wait_for_image()
    yield 0.5
    name = f"retimed_{shading.lower()}"
    screenshot(f"{name}_recorded")
    stood = object_named(car).matrix_world.translation.copy()
    yield from menu_button(above, 0)
    yield 5.0
    screenshot(f"{name}_at_once")
    note(
        name,
        actor=object_named(car).unisim.uid,
        box_moved_m=(object_named(car).matrix_world.translation - stood).length,
        edits=edits(),
    )


def drives_on_parent(car: str) -> bool:
    """Whether a car rides on a hidden parent, as it does since the panel has Retime below Delete."""
    return object_named(car).parent is not None


def followed() -> Iterator[float]:
    """Follow Curve at 8 m/s, at 30 frames a second in Blender; the car after one second, beside the
    3D cursor at 8 m."""
    yield from fresh()
    scene = bpy.context.scene
    scene.render.fps = 30
    yield from framed("SOLID", width=960)
    yield from click_car(driving=True)
    car = bpy.context.view_layer.objects.active.name
    low = min(corner[2] for corner in object_named(car).bound_box)
    turn = object_named(car).matrix_world.to_euler()
    start_at, eight = (object_named(car).matrix_world @ Vector((x, 0.0, low)) for x in (10.0, 8.0))
    bpy.ops.curve.primitive_nurbs_path_add(radius=5.0, location=start_at, rotation=turn)
    curve = bpy.context.view_layer.objects.active
    curve.select_set(True)
    object_named(car).select_set(True)
    bpy.context.view_layer.objects.active = object_named(car)
    uid = object_named(car).unisim.uid
    scene.cursor.location = eight
    yield 0.3
    yield from press("unisim.follow_curve()")
    yield from look_at(car, 28.0)
    for _ in range(10):
        yield from key("RIGHT_ARROW")
    yield from until(lambda: bpy.context.scene.frame_current == 10, "not at frame 10", 10)
    yield 0.5
    path = export("followed")
    for edit in json.loads(path.read_text())["edits"]:
        if edit.get("actor") == uid and "trajectory" in edit:
            keyframes = edit["trajectory"]
            places = np.array([one["position"] for one in keyframes])
            times = np.array([one["time_s"] if "time_s" in one else one["frame"] * 0.1 for one in keyframes])
            speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(times)
            note("followed", actor=uid, speed_m_s=float(np.median(speeds[1:10])))


def at_the_end(name: str) -> Iterator[float]:
    """Scroll the sidebar to its end and find a button there, from below; its place goes to `found_at`."""
    found = area("VIEW_3D")
    region = region_of(found, "UI")
    yield from to(region.x + region.width / 2, region.y + region.height / 2)
    for _ in range(3):
        yield from key("PAGE_DOWN")
        yield 0.2
    places: list[Place] = []
    for up in range(ROW // 2, region.height, ROW):
        yield from to(region.x + region.width / 2, region.y + up)
        yield 0.0
        if name in under_mouse(found, region):
            places.append((mouse[0], mouse[1]))
        elif places:
            break
    assert places, f"there is no button {name} at the end of the sidebar"
    found_at[:] = [places[len(places) // 2]]


def told() -> str:
    """What the panel says of the task that runs."""
    return str(bpy.context.window_manager.unisim_task)


def opened_file() -> Iterator[float]:
    """A sequence begun from the panel, and another file opened while it runs."""
    yield from fresh()
    other = OUT.parent / "another.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(other), copy=True)
    about = bpy.context.scene.unisim
    about.out, about.quality = str(OUT.parent / "sequence"), "reference"  # which goes on for minutes
    yield from at_the_end("unisim.render_sequence()")
    yield from to(*found_at[0])
    yield from click()
    yield from until(lambda: "frames" in told(), "no progress is shown", 60)
    yield from to(*middle(area("VIEW_3D")))
    yield 2.0  # while the scene is read, nothing but Esc is heard
    yield from key("O", ctrl=True)
    yield from choose_path(other)
    yield from until(lambda: Path(bpy.data.filepath) == other, "not opened", 10)
    yield from at_the_end("unisim.render_sequence()")
    yield from to(*middle(area("VIEW_3D")))
    yield 1.0
    note("opened_file", told=told(), can_cancel=bpy.ops.unisim.cancel_task.poll())
    background: Any = sys.modules[f"{MODULE}.process.background"]
    for running in list(background.running):
        running.cancel()
    background.running.clear()  # with earlier versions nothing else does


def log_alone() -> Iterator[float]:
    """File > Import > Driving Log of a log without a trained scene, and Render Sequence."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    yield 1.0
    bpy.context.preferences.view.show_splash = False
    yield from menu_entry("driving log")
    yield from choose_path(SMALL_LOG, folder=True)
    yield from arrived()
    yield from sidebar()
    scene = bpy.context.scene
    scene.unisim.out = str(OUT.parent / "surfels")
    yield from at_the_end("unisim.render_sequence()")
    spots["log_alone"] = found_at[0]
    bpy.ops.wm.save_as_mainfile(filepath=str(ALONE))
    can_render = bpy.ops.unisim.render_sequence.poll()
    yield from to(*found_at[0])
    yield from click()
    yield 1.0
    if can_render:
        yield from until(lambda: told().startswith("Done"), f"the sequence does not end: {told()}", 300)
    yield from to(*middle(area("VIEW_3D")))
    yield 1.0
    note("log_alone", can_render=can_render, told=told())


def tooltips() -> Iterator[float]:
    """Tooltips of Snap to Ground with nothing selected, and of Render Sequence in a log without a trained scene.

    Blender shows none for simulated events, so from here on the real mouse is moved and simulated ones
    are heard no more."""
    yield from fresh()
    yield from place_of("unisim.snap_to_ground()")
    spots["snap"] = found_at[0]
    yield from key("A", alt=True)
    yield 0.3
    bpy.app.use_event_simulate = False
    yield from hovered("snap")
    bpy.ops.wm.open_mainfile(filepath=str(ALONE))
    yield 1.0
    yield from hovered("log_alone")


def hovered(name: str) -> Iterator[float]:
    """Hold the real mouse over a button for a while and take a picture."""
    x, y = spots[name]
    height = bpy.context.window_manager.windows[0].height
    for away in (40, 20, 10, 5, 2, 0):
        subprocess.run(["xdotool", "mousemove", str(x - away), str(height - y + away // 4)], check=True)
        yield 0.2
    yield TOOLTIP_S
    screenshot(f"tooltip_{name}")


def panels() -> Iterator[float]:
    """The sidebar with a driving car active."""
    yield from fresh()
    bpy.context.scene.frame_set(5)
    yield from framed("SOLID", width=960)
    yield from click_car(driving=True)
    yield 1.0


def scaled() -> Iterator[float]:
    """S 1.5 on a car that stands, in Rendered shading."""
    yield from fresh()
    yield from framed("SOLID", width=960)
    yield from click_car(driving=False)
    yield from keys("S", "1")
    yield from key("PERIOD", ".")
    yield from keys("5", "RET")
    yield from framed("RENDERED")
    yield from wait_for_image()
    yield 1.0
    note("scaled", edits=edits())


def outside() -> Iterator[float]:
    """The arrow key beyond the drive's last frame, in Rendered shading."""
    yield from fresh()
    bpy.context.scene.frame_set(bpy.context.scene.frame_end)
    yield from framed("RENDERED")
    yield from wait_for_image()
    yield from to(*middle(area("VIEW_3D")))
    yield from key("RIGHT_ARROW")
    yield 2.0
    yield from wait_for_image()
    yield 1.0


def from_outside() -> Iterator[float]:
    """The Rendered view from behind and above the vehicle."""
    yield from fresh()
    from_behind(view()[2])
    bare_view(view()[1])
    view()[1].shading.type = "RENDERED"
    yield from wait_for_image(400)
    yield 1.0


def aside() -> Iterator[float]:
    """A camera turned aside by R Z 90, and Check Edits."""
    yield from fresh()
    scene = bpy.context.scene
    choose(scene.camera)
    yield from to(*middle(area("VIEW_3D")))
    yield from keys("R", "Z", "9", "0", "RET")
    yield 0.3
    yield from press("unisim.check()")
    yield 2.0
    yield from to(*middle(area("VIEW_3D")))
    yield 0.5


def deleted_ego() -> Iterator[float]:
    """X on the ego vehicle, and Export Scenario."""
    yield from fresh()
    yield from select("ego")
    yield from keys("X", "RET")
    yield 0.5
    path = HEADLESS / "without_ego.json"
    HEADLESS.mkdir(exist_ok=True)
    yield from at_the_end("unisim.export_scenario()")
    yield from to(*found_at[0])
    yield from click()
    yield from choose_path(path)
    yield 0.7
    screenshot("deleted_ego_at_once")
    note("deleted_ego", written=path.exists(), said=[line for line in reports() if not line.startswith("bpy.")][-2:])


def points() -> Iterator[float]:
    """Recorded points, shown for the first time by their button, and the longest block of the window meanwhile."""
    yield from fresh()
    name, columns = "unisim.show_points(recorded=True, simulated=False)", (0.15, 0.3, 0.45, 0.62, 0.8)
    here: dict[str, list[Place]] = {}
    yield from buttons(area("VIEW_3D"), "UI", here, columns)
    if name not in here:
        yield from open_panel("Show", "show_ways")
    yield from place_of(name, columns=columns)
    yield from redraw_alone()
    without = heart.longest
    yield from to(*found_at[0])
    yield 0.3
    heart.begin()
    yield from click()
    there = lambda: any(o.unisim.kind == "POINTS" and len(o.data.vertices) for o in bpy.context.scene.objects)  # noqa: E731
    yield from until(there, "no recorded points are shown", 60)
    yield 1.0
    note("points", longest_block_s=heart.longest, redraw_s=without)
    yield from to(*middle(area("VIEW_3D")))
    yield 0.5


def steps() -> Iterator[float]:
    """The session."""
    yield from install()
    yield from task("pictures_first_import", first_import)
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    yield 1.0
    yield from imported(installed=True)
    for todo in (
        panels,
        clicked,
        edited,
        shifted,
        moved,
        followed,
        scaled,
        outside,
        from_outside,
        aside,
        deleted_ego,
        points,
        log_alone,
        opened_file,
    ):
        yield from task(f"pictures_{todo.__name__}", todo)
    for shading in ("SOLID", "RENDERED"):
        yield from task(f"pictures_retimed_{shading.lower()}", partial(retimed, shading))
    yield from task("pictures_tooltips", tooltips)  # after it no simulated event is heard


if __name__ == "__main__":
    start(steps(), "before_after")
