"""The sidebar stays where it is; renamed actors; frames outside the drive; cameras aside; a deleted vehicle.
Run by `run.py`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from browser import choose_path
from buttons import INNER, TASKS, Place, buttons, choose_task, held, press, region_of, reports
from displaced import select
from hands import edits, key, middle, object_named, to, write
from pixels import HEADLESS, Image, apart, grab, part, region_rectangle
from session import MODULE, OUT, area, choose, redraw, results, screenshot, start, until, view, viewport_image
from tasks import click_car, fresh, imported, keys, task, through_camera, told


def tabs() -> bpy.types.Region:
    """The sidebar."""
    return region_of(area("VIEW_3D"), "UI")


def button_places(into: dict[str, Place]) -> Iterator[float]:
    """Note where the sidebar's buttons are, by task and name without arguments, as far as they are seen without
    scrolling."""
    found: dict[str, list[Place]] = {}
    for task_name in TASKS:
        yield from choose_task((task_name,))
        yield from buttons(area("VIEW_3D"), "UI", found)
        into.update({f"{task_name} {name.split('(')[0]}": places[0] for name, places in found.items() if places})
        high = -round(tabs().view2d.region_to_view(0, 0)[1])
        results[f"sidebar_px {task_name}"] = {"all": high, "seen_at_once": tabs().height}


def elsewhere(first: dict[str, Place], into: list[str]) -> Iterator[float]:
    """Note which buttons are no longer where they were, by what is there now."""
    here = [""]
    for task_name in TASKS:
        yield from choose_task((task_name,))
        for name, (x, y) in first.items():
            if not name.startswith(f"{task_name} "):
                continue
            for aside in (-INNER, INNER):
                yield from held(area("VIEW_3D"), tabs(), x, y + aside, here)
                if f"{task_name} {here[0].split('(')[0]}" != name:
                    into.append(f"where {name} was is {here[0] or 'none'}")


def steady_panel() -> Iterator[float]:
    """Labels come and go with what is active and what runs; no button moves under the mouse."""
    yield from fresh()
    yield from through_camera(rendered=False)
    scene = bpy.context.scene
    scene.unisim.out = str(OUT.parent / "steady")
    if hasattr(scene.unisim, "first_steps"):
        scene.unisim.first_steps = False  # else Check is below what is seen at once
    first: dict[str, Place] = {}
    moved: list[str] = []
    yield from button_places(first)
    assert {"EDIT unisim.replace_appearance", "EDIT unisim.check", "RENDER unisim.render_sequence"} <= set(first), first

    def nothing() -> Iterator[float]:
        yield from key("A", alt=True)

    def actor() -> Iterator[float]:
        yield from click_car(driving=True)

    def shading() -> Iterator[float]:
        view()[1].shading.type = "RENDERED"
        yield 0.5

    def sensor() -> Iterator[float]:
        choose(bpy.context.scene.camera)
        yield 0.1

    def next_frame() -> Iterator[float]:
        yield from key("RIGHT_ARROW")

    def running() -> Iterator[float]:
        with bpy.context.temp_override(area=area("VIEW_3D")):
            bpy.ops.unisim.render_sequence("INVOKE_DEFAULT")
        yield from until(lambda: "frames" in told(), "no sequence begins")

    def ended() -> Iterator[float]:
        if bpy.ops.unisim.cancel_task.poll():
            bpy.ops.unisim.cancel_task()
        yield from until(
            lambda: told().startswith(("Stopped", "Done")),
            "the sequence does not end",
            60,
        )

    for change in (actor, next_frame, shading, sensor, running, nothing, ended):
        yield from to(*middle(area("VIEW_3D")))
        yield from change()
        yield 0.5
        yield from elsewhere(first, moved)
        assert not moved, f"after {change.__name__}, buttons are elsewhere: {moved}"


def renamed() -> Iterator[float]:
    """F2 and another name: it stays the recorded actor."""
    yield from fresh()
    yield from through_camera(rendered=False)
    yield from click_car(driving=True)
    uid = bpy.context.view_layer.objects.active.unisim.uid
    yield from key("F2")
    yield 0.4
    yield from key("A", ctrl=True)
    yield from write("taxi")
    yield from key("RET")
    yield from until(lambda: "taxi" in bpy.data.objects, "F2 does not rename it", 10)
    yield 0.3
    assert object_named("taxi").unisim.uid == uid and not edits(), f"renamed, it is {edits()}"
    actor = sys.modules[f"{MODULE}.features.actors.panel"]
    card = actor.active_card(bpy.context)
    assert card is not None and card.name == "taxi" and card.role == "recorded", card


def yellow(image: Image, rectangle: tuple[int, int, int, int]) -> int:
    """How many pixels of a part of the screen have the colour of what views say they cannot show."""
    shown = part(image, rectangle).astype(int)
    return int(((shown[..., 0] > 200) & (shown[..., 1] > 150) & (shown[..., 2] < 140)).sum())


def outside_frames() -> Iterator[float]:
    """The arrow key at the end: frames outside the drive are marked all over the view, with and without
    overlays, and say so."""
    yield from fresh()
    yield from through_camera()
    view()[1].overlay.show_text = True
    yield from until(lambda: viewport_image() is not None, "no image comes")
    bpy.context.scene.frame_set(bpy.context.scene.frame_end)
    yield 2.0
    yield from until(lambda: viewport_image() is not None, "no image comes")
    x, y, width, height = region_rectangle("WINDOW")
    text, frame = (x + 60, y + height - 200, 700, 140), camera_frame()
    yield 0.5
    inside = grab()
    assert yellow(inside, text) == 0, "a frame of the drive is said to be outside"
    yield from key("RIGHT_ARROW")
    yield from until(lambda: bpy.context.scene.frame_current == 20, "the arrow key does not go beyond the end", 10)
    yield 2.0
    yield from until(lambda: viewport_image() is not None, "no image comes")
    yield 0.5
    screenshot("outside_rendered")
    rendered = grab()
    assert yellow(rendered, text) > 300, "nothing in Rendered shading says that the frame is outside"
    assert_striped(part(inside, frame), part(rendered, frame))
    view()[1].overlay.show_overlays = False
    yield 1.0
    assert_striped(part(inside, frame), part(grab(), frame))
    view()[1].overlay.show_overlays = True
    yield from through_camera(rendered=False)
    yield 0.5
    screenshot("outside_solid")
    outside = grab()
    assert yellow(outside, text) > 300, "nothing in Solid shading says that the frame is outside"
    beside = (x + 80, y + 40, 300, 120)  # below the camera's frame
    yield from key("LEFT_ARROW")
    yield 0.5
    inside = grab()
    spread = [float(part(image, beside).astype(int).std()) for image in (inside, outside)]
    assert yellow(inside, text) == 0 and spread[0] + 4 < spread[1], (
        f"nothing in Solid shading marks the frame: {spread}"
    )


def camera_frame() -> tuple[int, int, int, int]:
    """The middle of the image that the view shows, on the screen: left, bottom, width, height."""
    x, y, _, _ = region_rectangle("WINDOW")
    left, bottom, width, height = list(sys.modules[f"{MODULE}.viewport.views"].VIEWS)[-1].rectangle
    return x + left + width // 4, y + bottom + height // 4, width // 2, height // 2


def assert_striped(before: Image, now: Image) -> None:
    """Raise where an image has no stripes that ``before`` has not, or is not much darker where it was bright."""
    bright = before.min(-1) > 150
    assert bright.any() and now[bright].max() < 190, f"what was bright is as bright as {now[bright].max()}"
    jumps = [float(np.abs(np.diff(image.astype(int).mean(-1)[:, ::10], axis=1)).mean()) for image in (before, now)]
    assert jumps[1] > 25, f"from stripe to stripe there are {jumps[1]:.0f} of 255, and {jumps[0]:.0f} before"


def camera_aside() -> Iterator[float]:
    """A camera turned aside is found by Check Edits, and a click on its line goes there."""
    yield from fresh()
    scene = bpy.context.scene
    choose(scene.camera)
    name = scene.camera.name
    yield from to(*middle(area("VIEW_3D")))
    yield from keys("R", "Z", "9", "0", "RET")
    yield 0.3
    yield from press("unisim.check()")
    warnings = bpy.context.scene.unisim_check.warnings
    yield from until(
        lambda: any(one.name == name and "beside all" in one.text for one in warnings), "it is not found", 20
    )
    yield 1.0
    at_once = part(grab(), region_rectangle("UI")).copy()
    redraw()
    yield 0.5
    stale = int((apart(at_once, part(grab(), region_rectangle("UI"))) > 8).sum())
    assert not stale, f"{stale} pixels of the sidebar say something else once it is drawn again"
    frame = next(one.frame for one in warnings if one.name == name)
    scene.frame_set(frame + 3 if frame < 10 else frame - 3)
    yield from to(*middle(area("VIEW_3D")))
    yield from key("A", alt=True)
    yield 0.3
    screenshot("checked_camera")
    yield from press("unisim.go_to(")
    yield from until(lambda: bpy.context.scene.frame_current == frame, "the click does not go to the frame", 10)
    assert bpy.context.view_layer.objects.active == object_named(name) and object_named(name).select_get(), (
        "the camera is not selected"
    )


def deleted_ego() -> Iterator[float]:
    """X on the ego vehicle: the export refuses with a sentence."""
    yield from fresh()
    yield from select("ego")
    yield from keys("X", "RET")
    yield from until(lambda: not any(one.unisim.kind == "EGO" for one in bpy.context.scene.objects), "not deleted", 10)
    path = HEADLESS / "without_ego.json"
    HEADLESS.mkdir(exist_ok=True)
    yield from press("unisim.export_scenario()")
    yield from choose_path(path)
    yield 0.5
    screenshot("refused_without_ego")
    refused = [line for line in reports() if "vehicle" in line.lower() and not line.startswith("bpy.")]
    assert len(refused) == 1, f"it says {refused or reports()[-2:]}"
    assert not path.exists(), "something is written"


def steps() -> Iterator[float]:
    """The session."""
    yield from imported()
    for name, todo in (
        ("steady_panel", steady_panel),
        ("renamed_actor", renamed),
        ("outside_frames", outside_frames),
        ("camera_aside", camera_aside),
        ("deleted_ego", deleted_ego),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "panel")
