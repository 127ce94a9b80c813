"""Tasks of a person, timed, and what they begin with. Sessions run their steps as tasks."""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy
import hands
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from heart import heart, uncounted, watch
from numpy.typing import NDArray
from session import (
    ARCHIVE,
    MODULE,
    OUT,
    SCENE,
    area,
    is_searching,
    named,
    redraw,
    results,
    screenshot,
    until,
    view,
    viewport_image,
    waited_s,
)

IMPORTED = OUT.parent / "imported.blend"
"""The sample's trained scene, imported and nothing else."""


presses, steps = [0], [0]
"""Of the task that runs: what was pressed, and the same with a text that is typed, or a wheel that is turned, as one."""


def task(name: str, todo: Callable[[], Iterator[float]]) -> Iterator[float]:
    """Run a task and note how many presses and steps it took, how long, with and without waiting for the window and
    searching it for buttons, the longest block, and the longest of redrawing alone after it.

    A task that fails is noted with its reason, and the session goes on; `run.py` says so and fails. `UNISIM_UI_TASKS`
    in the environment, names with commas between, is for those tasks alone.
    """
    only = os.environ.get("UNISIM_UI_TASKS")
    if only and name not in only.split(","):
        return
    table = results.setdefault("tasks", {})
    assert isinstance(table, dict)
    heart.begin()
    presses[0], steps[0], begun = 0, 0, time.monotonic()
    event, before, waited_before = hands.event, [""], dict(waited_s)

    def counted(kind: str, value: str, **more: Any) -> None:
        if value == "PRESS" and not is_searching[0]:
            presses[0] += 1
            goes_on = "text" if "unicode" in more else kind if kind.startswith("WHEEL") else ""
            steps[0] += not goes_on or goes_on != before[0]
            before[0] = goes_on
        event(kind, value, **more)

    hands.event = counted
    failed, trace = "", ""
    try:
        yield from todo()
    except Exception as fault:
        failed, trace = str(fault) or type(fault).__name__, traceback.format_exc()
    hands.event = event
    seconds = time.monotonic() - begun
    noted = {
        "presses": presses[0],
        "steps": steps[0],
        "seconds": round(seconds, 2),
        "without_waiting_s": round(seconds - sum(waited_s[name] - waited_before[name] for name in waited_s), 2),
        "longest_block_s": round(heart.longest, 3),
        "ours_s": round(heart.ours_s(), 2),
        "within": dict(heart.within.most_common(4)),
        "blocks": heart.blocks,
    }
    screenshot(name)
    if failed:
        table[name] = {**noted, "redraw_s": 0.0, "failed": failed, "trace": trace}
        (OUT / "so_far.json").write_text(json.dumps(results, indent=1))
        hands.window[0] = 0
        for _ in range(3):  # leave menus and popups, and what is being moved
            yield from hands.key("ESC")
        return
    yield from redraw_alone()
    table[name] = {**noted, "redraw_s": round(heart.longest, 3)}
    (OUT / "so_far.json").write_text(json.dumps(results, indent=1))


def redraw_alone(times: int = 6) -> Iterator[float]:
    """Draw the whole window again some times; the longest block of it is then `heart.longest`."""
    yield 0.2
    heart.begin()
    for _ in range(times):
        redraw()
        yield 0.05
        yield 0.05


def install() -> Iterator[float]:
    """Install the extension and begin to measure."""
    bpy.ops.extensions.package_install_files(
        filepath=str(ARCHIVE), repo="user_default", enable_on_install=True, overwrite=True
    )
    # else lines are drawn smoother in each of eight drawings, and the screen stays as it is only after the last
    bpy.context.preferences.system.viewport_aa = "OFF"
    yield 1.0
    begin()


def imported(installed: bool = False) -> Iterator[float]:
    """Install the extension unless it is there, import the sample's trained scene, open the sidebar, keep the file."""
    if not installed:
        yield from install()
    yield from hands.to(*hands.middle(area("VIEW_3D")))
    hands.drop(SCENE)
    yield from arrived()
    scene = bpy.context.scene
    if scene.camera.unisim.kind != "CAMERA":  # earlier versions left that, and what follows from it, to the person
        for name in ("Cube", "Light", "Camera"):
            bpy.data.objects.remove(bpy.data.objects[name])
        scene.camera = next(one for one in scene.objects if one.unisim.kind == "CAMERA")
        scene.render.engine = "UNISIM"
        scene.frame_set(scene.frame_start)
    yield from named()
    yield from hands.sidebar()
    view()[2].view_perspective = "CAMERA"
    save_file(IMPORTED)


def arrived(least: int = 20) -> Iterator[float]:
    """Let the window go on until there are that many objects and no more come."""
    counts = [0]
    while counts[-1] < least or counts[-3:] != counts[-1:] * 3:
        counts.append(len(bpy.data.objects))
        assert len(counts) < 200, "the import does not end"
        yield 0.7


def fresh() -> Iterator[float]:
    """Open the file that was kept after the import, so that no task depends on another one."""
    open_file(IMPORTED)
    yield 0.5
    yield from hands.to(*hands.middle(area("VIEW_3D")))


@uncounted
def open_file(path: Path) -> None:
    """Open a .blend file."""
    bpy.ops.wm.open_mainfile(filepath=str(path))


@uncounted
def save_file(path: Path) -> None:
    """Save the file that is open."""
    bpy.ops.wm.save_as_mainfile(filepath=str(path))


@uncounted
def empty_file() -> None:
    """Open Blender's default file."""
    bpy.ops.wm.read_homefile(use_factory_startup=True)


def click_car(driving: bool) -> Iterator[float]:
    """Click on the nearest car in view that drives, or stands; it is then the active object."""
    car = seen(driving)
    yield from hands.to(*hands.place(hands.object_named(car).matrix_world.translation))
    yield from hands.click()
    yield from until(
        lambda: (
            bpy.context.view_layer.objects.active == hands.object_named(car) and hands.object_named(car).select_get()
        ),
        "a click on a car does not select it",
        10,
    )


def keys(*pressed: str) -> Iterator[float]:
    """Press keys one after the other; a digit is typed."""
    for name in pressed:
        yield from hands.key(hands.KEYS.get(name, name), name if len(name) == 1 and name in hands.KEYS else "")


def drives(one: bpy.types.Object) -> bool:
    """Return whether an actor has a trajectory, on a parent or, as in earlier versions, as keys of its own."""
    return one.parent is not None or any(
        curve.data_path == "location" and len(curve.keyframe_points) > 1 for curve in curves_of(one)
    )


def curves_of(one: bpy.types.Object) -> list[bpy.types.FCurve]:
    """Return an object's curves, whichever version of the extension made them."""
    data = one.animation_data
    if data is None or data.action is None:
        return []
    if not hasattr(data, "action_slot"):  # before Blender 4.4
        return list(data.action.fcurves)
    bag = data.action.layers[0].strips[0].channelbag(data.action_slot) if data.action.layers else None
    return [] if bag is None else list(bag.fcurves)


def bare_view(space: bpy.types.SpaceView3D, bare: bool = True) -> None:
    """Hide the boxes and what a person would call overlays, or show them again; but not what Blender draws behind or
    over a camera's view, the recorded image above all."""
    overlay, shown = space.overlay, not bare
    overlay.show_floor = overlay.show_axis_x = overlay.show_axis_y = overlay.show_text = overlay.show_cursor = shown
    overlay.show_outline_selected = overlay.show_object_origins = shown
    space.show_object_viewport_mesh = space.show_object_viewport_curve = space.show_gizmo = shown
    bpy.context.scene.unisim.show_ways = shown


def through_camera(rendered: bool = True, width: int = 480) -> Iterator[float]:
    """Show the view as it is compared: Rendered shading without boxes and overlays, the camera's frame so many pixels
    wide; or with ``rendered`` False as it was before."""
    found, space, looks = view()
    region = next(r for r in found.regions if r.type == "WINDOW")
    # a frame as wide as the region has this zoom
    looks.view_camera_zoom = 50 * (2 * np.sqrt(width / region.width) - np.sqrt(2))
    looks.view_camera_offset = 0.0, 0.0
    looks.view_perspective = "CAMERA"
    space.shading.type = "RENDERED" if rendered else "SOLID"
    bare_view(space, rendered)
    yield 0.3


def differing(what: str) -> Iterator[float]:
    """Compare the view with `unisim render` of the exported scenario, by `pixels.as_rendered`."""
    import pixels

    yield from through_camera()
    yield from pixels.as_rendered(what)


def changed(before: NDArray[Any] | None) -> bool:
    """Whether the viewport's finished image is another one than before."""
    now = viewport_image()
    return now is not None and before is not None and bool(np.abs(now - before).max() > 0.05)


@uncounted
def seen(driving: bool) -> str:
    """The name of the actor nearest in the middle of the camera's view that drives, or stands."""
    found, _, looks = view()
    region, sidebar = (next(r for r in found.regions if r.type == kind) for kind in ("WINDOW", "UI"))
    right = min(region.width - 200, sidebar.x - region.x - 20) if sidebar.width > 1 else region.width - 200
    camera = bpy.context.scene.camera.matrix_world.inverted()
    ranked = []
    for one in bpy.context.scene.objects:
        if one.unisim.kind != "ACTOR" or drives(one) != driving or one.hide_viewport:
            continue
        at = location_3d_to_region_2d(region, looks, one.matrix_world.translation)
        away = -(camera @ one.matrix_world.translation).z
        eye = bpy.context.scene.camera.matrix_world.translation
        depsgraph = bpy.context.evaluated_depsgraph_get()
        hit = bpy.context.scene.ray_cast(depsgraph, eye, (one.matrix_world.translation - eye).normalized())
        if not hit[0] or hit[4].name != one.name:
            continue  # another one stands before it
        if at is not None and away > 4 and 150 < at.x < right and 80 < at.y < region.height - 80:
            ranked.append((away, one.name))
    assert ranked, "no such actor is in view"
    return min(ranked)[1]


def told() -> str:
    """What the window says of the newest task; "" without one."""
    manager = bpy.context.window_manager
    if hasattr(manager, "unisim_task"):  # earlier versions
        return str(manager.unisim_task)
    newest = sys.modules[f"{MODULE}.process.background"].newest.values()
    return str(max(newest, key=lambda one: float(one.started_s)).line) if newest else ""


def begin() -> None:
    """Begin to measure how long the window does nothing else, and what it does."""
    watch()
    bpy.app.timers.register(heart.beat, persistent=True)
