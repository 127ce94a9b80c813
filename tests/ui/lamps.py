"""Lamps: found in the background with the window going on, cancelled once, set and keyed by clicks. Run by `run.py`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from buttons import CROSS, KNOWN, found_at, open_panel, place_of, press, region_of
from hands import click, edits, key, middle, scenario, sidebar, to
from session import MODULE, OUT, area, choose, inside, results, screenshot, start, until, view, wait_for_image
from tasks import arrived, install, task


def module(name: str) -> Any:
    """A module of the extension."""
    return sys.modules[f"{MODULE}.{name}"]


def running() -> bool:
    """Whether a task runs."""
    return bool(module("process.background").running)


def actor(uid: str) -> Any:
    """The object of an actor."""
    return next(obj for obj in bpy.context.scene.objects if (obj.unisim.kind, obj.unisim.uid) == ("ACTOR", uid))


def imported() -> Iterator[float]:
    """The log, and the panel of the car ahead."""
    yield from to(*middle(area("VIEW_3D")))
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.import_log("INVOKE_DEFAULT", filepath=str(OUT.parent / "lamp_log"))
    yield from arrived(20)
    yield from sidebar()
    choose(actor("car-01"))
    yield from open_panel("Lamps", "find_lamps")
    screenshot("lamps_before")


def cancelled() -> Iterator[float]:
    """Find Lamps, and the cross beside its bar."""
    yield from press("unisim.find_lamps")
    yield from until(running, "nothing runs", 10)
    region = region_of(view()[0], "UI")
    yield from to(region.x + CROSS * region.width, found_at[0][1] - 24)
    yield from click()
    yield from until(lambda: not running(), "the search does not end", 60)
    newest = module("process.background").newest[module("features.actors.lamps").LampTask]
    assert newest.cancelled and not newest.problem and not len(bpy.context.scene.unisim_lamps)
    screenshot("lamps_cancelled")


def found() -> Iterator[float]:
    """Find Lamps to its end."""
    yield from press("unisim.find_lamps")
    yield from until(running, "nothing runs", 10)
    yield 3.0
    screenshot("lamps_finding")
    yield from until(lambda: not running(), "the search does not end", 400)
    lamps = sorted((lamp.actor, lamp.name) for lamp in bpy.context.scene.unisim_lamps)
    assert lamps == [("car-01", "amber left"), ("car-01", "red"), ("traffic-light", "red-green")], lamps
    yield 1.0
    screenshot("lamps_found")


def keyed() -> Iterator[float]:
    """The brake lamp off at a frame and as recorded at a later one, by clicks and I over the setting."""
    scene = bpy.context.scene
    number = [lamp.name for lamp in scene.unisim_lamps].index("red")
    path = f"unisim_lamps[{number}].state"
    for frame, column in ((5, 0.5), (12, 0.2)):
        scene.frame_set(frame)
        KNOWN.clear()  # the buttons of a setting have one path
        yield from press(path, columns=(column,))
        yield from key("I")
        yield 0.5
        screenshot(f"lamps_keyed_{frame}")
    results["edits"] = edits()
    (edit,) = scenario().edits
    assert (edit.actor, edit.lamp, edit.state) == ("car-01", "red", "off"), edit
    assert edit.from_s is None and abs(edit.to_s - 1.2) < 1e-3, edit
    yield from place_of("unisim.go_to_edit", columns=(0.2,))
    screenshot("lamps_listed")


def shown() -> Iterator[float]:
    """Rendered shading at a frame at which the recorded brake lamp is on: it is off."""
    bpy.context.scene.frame_set(9)
    view()[1].shading.type = "RENDERED"
    yield from wait_for_image(600.0)
    screenshot("lamps_rendered")


def steps() -> Iterator[float]:
    """All of it."""
    yield from install()
    for name, todo in (
        ("Lamps: import", imported),
        ("Lamps: cancel", cancelled),
        ("Lamps: find", found),
        ("Lamps: key", keyed),
        ("Lamps: show", shown),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "lamps")
