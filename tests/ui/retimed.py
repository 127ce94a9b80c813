"""Retiming from panel, menu, shortcut and redo panel, all of it shown at once; and times that are seconds.
Run by `run.py`."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

sys.path.insert(0, str(Path(__file__).parent))
from browser import choose_path, header_menu
from buttons import menu_button, press, redo_panel, reports
from hands import key, middle, object_named, to
from pixels import HEADLESS, STATUS_HIGH, Image, apart, as_rendered, export, part, region_rectangle, settled
from session import area, redraw, screenshot, start, until, view, viewport_image
from tasks import bare_view, changed, click_car, fresh, imported, task, through_camera


def from_panel() -> Iterator[float]:
    """Actor > Retime > Delay."""
    yield from menu_button("unisim.delete_actor()", 0)


def from_menu() -> Iterator[float]:
    """Object > UniSim > Retime > Delay."""
    yield from header_menu("Object", "delay")


def from_shortcut() -> Iterator[float]:
    """Ctrl-Alt-T with the mouse over the view."""
    yield from key("T", ctrl=True, alt=True)


def from_redo_panel() -> Iterator[float]:
    """Ctrl-Alt-T, then another delay in the redo panel."""
    yield from key("T", ctrl=True, alt=True)
    yield 0.3
    yield from to(600, 500)
    yield from redo_panel("500", "-500ms")


def retimed(name: str, retime: Callable[[], Iterator[float]]) -> Iterator[float]:
    """Retime a driving car: with no further event the window shows what it shows after everything is evaluated anew."""
    yield from fresh()
    bpy.context.scene.frame_set(5)
    yield from through_camera(rendered=False)
    yield from click_car(driving=True)
    car = bpy.context.view_layer.objects.active.name
    yield from to(*middle(area("VIEW_3D")))
    yield 0.5
    stood = object_named(car).matrix_world.translation.copy()
    before: list[Image] = []
    at_once: list[Image] = []
    anew: list[Image] = []
    yield from settled(before)
    yield from retime()
    yield from until(
        lambda: (object_named(car).matrix_world.translation - stood).length > 1.0, "the box does not follow", 5
    )
    yield from to(*middle(area("VIEW_3D")))
    yield 0.5
    yield from settled(at_once)
    screenshot(f"retimed_{name}")
    for shown in (6, 5):
        bpy.context.scene.frame_set(shown)
        yield 0.3
    redraw()
    yield from settled(anew)
    far = apart(at_once[0], anew[0])[:-STATUS_HIGH] > 2
    assert not far.any(), (
        f"{far.sum()} pixels of the window change once the scene is evaluated anew, about {np.argwhere(far)[0]}"
    )
    for kind in ("WINDOW", "UI"):  # the box and its trajectory; the actor's card
        rectangle = region_rectangle(kind)
        x, y, width, height = rectangle
        lower = (x, y, width, height - 80) if kind == "WINDOW" else rectangle
        assert (apart(part(before[0], lower), part(at_once[0], lower)) > 8).sum() > 30, (
            f"nothing changes in the region {kind}"
        )
    yield from through_camera()
    yield from as_rendered(f"retimed_{name}")


def retimed_image() -> Iterator[float]:
    """Ctrl-Alt-T in Rendered shading: the image follows without anything else."""
    yield from fresh()
    bpy.context.scene.frame_set(5)
    yield from through_camera(rendered=False)
    yield from click_car(driving=True)
    yield from through_camera()
    yield from until(lambda: viewport_image() is not None, "no image comes")
    before = viewport_image()
    bare_view(view()[1], False)  # what a view does not show is not selected there
    yield from to(*middle(area("VIEW_3D")))
    yield 0.3
    yield from from_shortcut()
    yield from until(lambda: changed(before), "the image does not follow", 30)
    yield from through_camera()
    yield from as_rendered("retimed_image")


def seconds() -> Iterator[float]:
    """Blender at 30 frames a second: Follow Curve at 8 m/s is 8 m/s in the scenario."""
    yield from fresh()
    scene = bpy.context.scene
    scene.render.fps = 30
    yield from through_camera(rendered=False)
    yield from click_car(driving=True)
    car = bpy.context.view_layer.objects.active
    start_at = car.matrix_world @ ahead_below(car)
    bpy.ops.curve.primitive_nurbs_path_add(radius=10.0, location=start_at, rotation=car.matrix_world.to_euler())
    curve = bpy.context.view_layer.objects.active
    car = object_named(car.name)
    curve.select_set(True)
    car.select_set(True)
    bpy.context.view_layer.objects.active = car
    uid = car.unisim.uid
    yield 0.3
    yield from press("unisim.follow_curve()")
    path = export("followed")
    yield 0.2
    moves = [
        edit for edit in json.loads(path.read_text())["edits"] if edit.get("actor") == uid and "trajectory" in edit
    ]
    assert moves, "the car does not follow"
    keyframes = moves[0]["trajectory"]
    places = np.array([one["position"] for one in keyframes])
    times = np.array([one["time_s"] if "time_s" in one else one["frame"] * 0.1 for one in keyframes])
    speeds = np.linalg.norm(np.diff(places, axis=0), axis=1) / np.diff(times)
    driven = speeds[1:-1]
    assert len(driven) > 5 and np.abs(driven - 8).max() < 0.1, (
        f"it drives at {driven.min():.2f} to {driven.max():.2f} m/s"
    )
    yield from through_camera()
    yield from as_rendered("followed_curve")


def ahead_below(car: bpy.types.Object) -> Vector:
    """A place ten metres ahead of a car on the height of its underside, in its own axes."""
    return Vector((10.0, 0.0, min(corner[2] for corner in car.bound_box)))


def stretched() -> Iterator[float]:
    """Output > Frame Range > Time Stretching: the export refuses with a sentence and writes nothing."""
    yield from fresh()
    bpy.context.scene.render.frame_map_new = 200
    yield 0.2
    path = HEADLESS / "stretched.json"
    HEADLESS.mkdir(exist_ok=True)
    yield from press("unisim.export_scenario()")
    yield from choose_path(path)
    yield 0.5
    screenshot("refused_stretching")
    refused = [line for line in reports() if "stretch" in line.lower() and not line.startswith("bpy.")]
    assert len(refused) == 1 and refused[0].count(". ") == 0, f"it says {refused or reports()[-2:]}"
    assert not path.exists(), "something is written"


def steps() -> Iterator[float]:
    """The session."""
    yield from imported()
    for name, retime in (
        ("panel", from_panel),
        ("menu", from_menu),
        ("shortcut", from_shortcut),
        ("redo_panel", from_redo_panel),
    ):
        yield from task(f"retime_{name}", partial(retimed, name, retime))
    yield from task("retime_image", retimed_image)
    yield from task("curve_at_30_fps", seconds)
    yield from task("time_stretching", stretched)


if __name__ == "__main__":
    start(steps(), "retimed")
