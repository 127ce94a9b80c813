"""Driving cars and the ego vehicle moved and turned by keys, with and without auto-keying, judged by
data and pixels."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
from buttons import press, redo_panel
from hands import click, edits, key, middle, object_named, to
from heart import uncounted
from pixels import as_rendered, export, grab
from session import MODULE, OUT, area, start, until
from tasks import click_car, curves_of, fresh, imported, keys, open_file, save_file, task, through_camera

STATUS_HIGH, STATUS_WIDE = 20, 700
"""The part of the window where the status bar shows a sentence."""
said: list[str] = []
"""What the status bar was told to show."""


def listen() -> None:
    """Note what the status bar is told, beside showing it."""
    following: Any = sys.modules.get(f"{MODULE}.bridge.changes.following")
    if following is None:
        return
    say = following.say

    def noted(sentence: str) -> None:
        said.append(sentence)
        say(sentence)

    following.say = noted


def ego() -> bpy.types.Object:
    """The ego vehicle."""
    return next(one for one in bpy.context.scene.objects if one.unisim.kind == "EGO")


def select(kind: str) -> Iterator[float]:
    """Select the nearest driving car by a click in the view, or the ego vehicle by one in the Outliner."""
    if kind == "car":
        yield from click_car(driving=True)
        return
    outliner = area("OUTLINER")
    for down in range(45, outliner.height, 10):
        yield from to(outliner.x + 130, outliner.y + outliner.height - down)
        yield from click()
        yield 0.05
        if bpy.context.view_layer.objects.active == ego() and ego().select_get():
            break
    else:
        raise AssertionError("no line of the Outliner selects the ego vehicle")
    yield from to(*middle(area("VIEW_3D")))


@uncounted
def poses(name: str) -> NDArray[np.float64]:
    """Where an object is at every frame (N, 4, 4); the frame that was shown is shown again."""
    scene, found = bpy.context.scene, []
    now = scene.frame_current
    for frame in range(scene.frame_start, scene.frame_end + 1):
        scene.frame_set(frame)
        found.append(np.array(object_named(name).matrix_world, float))
    scene.frame_set(now)
    return np.array(found)


def status_bar() -> NDArray[np.uint8]:
    """The pixels of the status bar."""
    return grab()[-STATUS_HIGH:, :STATUS_WIDE].copy()


def undone() -> Iterator[float]:
    """Ctrl-Z until no edit is left: a step of a frame is undone by itself."""
    for _ in range(3):
        yield from key("Z", ctrl=True)
        yield 0.3
        if not edits():
            return
    raise AssertionError(f"not undone: {edits()}")


def done_again(wanted: list[tuple[str, str]]) -> Iterator[float]:
    """Ctrl-Shift-Z until the edit is there again."""
    for _ in range(3):
        yield from key("Z", ctrl=True, shift=True)
        yield 0.3
        if edits() == wanted:
            return
    raise AssertionError(f"not done again: {edits()}")


def edited(name: str) -> list[tuple[str, str]]:
    """The scenario's edits where an object was displaced."""
    return [("Ego", "")] if object_named(name).unisim.kind == "EGO" else [("Move", object_named(name).unisim.uid)]


def displaced(kind: str, pressed: tuple[str, ...], shown: str, other: str, amount: float) -> Iterator[float]:
    """Keys on a car or the ego vehicle without auto-keying; F9 takes ``shown`` to ``other``, which is ``amount``
    in the scene."""
    yield from fresh()
    yield from through_camera(rendered=False)
    yield from select(kind)
    name = bpy.context.view_layer.objects.active.name
    before, bar = poses(name), status_bar()
    said.clear()
    yield from keys(*pressed)
    yield from until(lambda: edits() == edited(name), f"{pressed} is no displacement of the whole: {edits()}", 10)
    yield from until(lambda: said, "the status bar says nothing", 3)
    assert "whole trajectory is displaced" in said[-1], said
    yield 0.5
    assert (np.abs(status_bar().astype(int) - bar) > 50).sum() > 100, "the status bar shows nothing"
    yield from to(600, 500)
    yield from redo_panel(shown, other)
    yield from until(lambda: edits() == edited(name), "F9 loses the edit", 10)
    moved = object_named(name).matrix_world.copy()
    yield from key("RIGHT_ARROW")
    yield 0.2
    yield from key("LEFT_ARROW")
    yield 0.2
    assert np.abs(np.array(object_named(name).matrix_world) - np.array(moved)).max() < 1e-4, (
        "a step of a frame puts it back"
    )
    yield from undone()
    assert np.abs(poses(name) - before).max() < 1e-4, "undone, it is not where it was recorded"
    yield from done_again(edited(name))
    after = poses(name)
    relative = np.linalg.inv(before) @ after
    assert np.abs(relative - relative[0]).max() < 2e-3, "frames are displaced differently"
    size = float(np.linalg.norm(relative[0, :3, 3]) if "G" in pressed else angles(relative)[0])
    assert abs(size - amount) < 0.02, f"F9 displaces it by {size:.3f}, not {amount}"
    exported = json.loads(export("before_saving").read_text())
    save_file(OUT.parent / "displaced.blend")
    open_file(OUT.parent / "displaced.blend")
    yield 0.5
    assert np.abs(poses(name) - after).max() < 1e-4, "saved and opened, it is elsewhere"
    assert json.loads(export("after_opening").read_text())["edits"] == exported["edits"], (
        "saved and opened, the edits are others"
    )
    yield from key("RIGHT_ARROW")
    yield from through_camera()
    yield from as_rendered(f"displaced_{kind}_{pressed[0]}")


def blended(kind: str, pressed: tuple[str, ...], path: str, least: float) -> Iterator[float]:
    """The same with auto-keying on, from its button in the timeline, at frame 10: a key there, and the
    change blends in."""
    yield from fresh()
    yield from through_camera(rendered=False)
    yield from press("use_keyframe_insert_auto", "HEADER", columns=COLUMNS, where="DOPESHEET_EDITOR")
    assert bpy.context.scene.tool_settings.use_keyframe_insert_auto, "auto-keying is not on"
    yield from to(*middle(area("VIEW_3D")))
    for _ in range(10):
        yield from key("RIGHT_ARROW")
    yield from until(lambda: bpy.context.scene.frame_current == 10, "not at frame 10", 10)
    yield 0.3
    yield from select(kind)
    name = bpy.context.view_layer.objects.active.name
    before = poses(name)
    said.clear()
    yield from keys(*pressed)

    def keyed() -> list[int]:
        curves = curves_of(object_named(name))
        return [len(curve.keyframe_points) for curve in curves if curve.data_path == path]

    yield from until(lambda: keyed() and set(keyed()) == {3}, f"the change is not blended: {keyed()} keys", 10)
    yield from until(lambda: said, "the status bar says nothing", 3)
    assert "keyed at frame 10" in said[-1], said
    relative = np.linalg.inv(before) @ poses(name)
    there = np.linalg.norm(relative[:, :3, 3], axis=1) if path == "location" else angles(relative)
    assert there[10] > least, f"at its key it is displaced by {there[10]:.2f}"
    assert there[10] == there.max() and there[0] < there[5] < there[10] > there[15], "it does not blend in and out"
    assert np.abs(np.diff(there)).max() < 0.2 * there[10], f"it jumps by {np.abs(np.diff(there)).max():.2f}"
    yield from to(600, 500)
    yield from undone()
    yield from done_again(edited(name))
    assert np.abs(np.linalg.inv(before) @ poses(name) - relative).max() < 1e-4, "done again, it is elsewhere"
    yield from key("RIGHT_ARROW")
    yield from through_camera()
    yield from as_rendered(f"blended_{kind}_{pressed[0]}")


def angles(poses_: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far rotations (N, 4, 4) turn, in degrees."""
    return np.asarray(np.degrees(np.arccos(np.clip((np.trace(poses_[:, :3, :3], axis1=1, axis2=2) - 1) / 2, -1, 1))))


COLUMNS = tuple((column + 0.5) / 100 for column in range(34, 44))


def steps() -> Iterator[float]:
    """The session."""
    yield from imported()
    listen()
    tasks: tuple[tuple[str, Callable[[], Iterator[float]]], ...] = (
        ("move_car", partial(displaced, "car", ("G", "Y", "3", "RET"), "3", "2", 2.0)),
        ("rotate_car", partial(displaced, "car", ("R", "Z", "1", "0", "RET"), "10", "15", 15.0)),
        ("move_ego", partial(displaced, "ego", ("G", "Y", "1", "RET"), "1", "2", 2.0)),
        ("rotate_ego", partial(displaced, "ego", ("R", "Z", "1", "0", "RET"), "10", "5", 5.0)),
        ("move_car_keyed", partial(blended, "car", ("G", "Y", "1", "RET"), "location", 0.99)),
        ("rotate_car_keyed", partial(blended, "car", ("R", "Z", "1", "0", "RET"), "rotation_quaternion", 9.9)),
        ("move_ego_keyed", partial(blended, "ego", ("G", "Y", "1", "RET"), "location", 0.99)),
        ("rotate_ego_keyed", partial(blended, "ego", ("R", "Z", "1", "0", "RET"), "rotation_quaternion", 9.9)),
    )
    for name, todo in tasks:
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "displaced")
