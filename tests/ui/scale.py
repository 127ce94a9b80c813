"""Actors scaled with S, judged by what the screen shows and by what `unisim render` writes. Run by `run.py`."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
from hands import click, edits, key, middle, object_named, place, scenario, to
from session import (
    ARCHIVE,
    MODULE,
    OUT,
    area,
    inside,
    redraw,
    results,
    screenshot,
    start,
    until,
    view,
    viewport_image,
    wait_for_image,
)
from tasks import bare_view, begin, changed, differing, imported, seen, task

BYTE = 1 / 255
chosen: dict[str, str] = {}
"""Names of the cars that the session works on: one that stands, one that drives."""


def pick(car: str) -> Iterator[float]:
    """Click a car."""
    yield from to(*place(object_named(car).matrix_world.translation))
    yield from click()
    yield from until(
        lambda: bpy.context.view_layer.objects.active == object_named(car) and object_named(car).select_get(),
        "it is not selected",
    )


def scaled_by(*presses: tuple[str, ...]) -> Iterator[float]:
    """S, what is typed after it, Enter."""
    for press in (("S",), *presses, ("RET",)):
        yield from key(*press)


def factors() -> dict[str, tuple[float, ...]]:
    """The scenario's scales by actor."""
    return {edit.actor: edit.factors for edit in scenario().edits if type(edit).__name__ == "Scale"}


def underside(car: str) -> float:
    """How high an actor's underside is, in the world."""
    one = object_named(car)
    return float(min((one.matrix_world @ Vector(corner)).z for corner in one.bound_box))


def rests(car: str, low: float) -> Iterator[float]:
    """Wait until a car's underside is as high as it was."""
    yield from until(lambda: abs(underside(car) - low) < 2e-3, f"the underside of {car} does not stay at {low:.3f}", 10)


def shown() -> NDArray[np.float32]:
    """The viewport's finished image."""
    now = viewport_image()
    assert now is not None
    return now


def follows(change: Callable[[], Iterator[float]], what: str) -> Iterator[float]:
    """Make a change and wait until the image has followed it."""
    yield from wait_for_image()
    before = shown()
    yield from change()
    yield from until(lambda: changed(before), what, 60)
    yield from wait_for_image()


def begun() -> Iterator[float]:
    """A trained scene dropped onto the view, rendered shading, boxes shown over it."""
    yield from imported(installed=True)
    bpy.context.scene.frame_set(7)
    view()[1].shading.type = "RENDERED"
    yield from wait_for_image()
    chosen["stands"], chosen["drives"] = seen(driving=False), seen(driving=True)


def scaled_car() -> Iterator[float]:
    """Click a car that stands, S 1.5 Enter: box, image, card and status bar follow, and it stands on its wheels."""
    car = chosen["stands"]
    yield from pick(car)
    low = underside(car)

    def typed() -> Iterator[float]:
        yield from scaled_by(("ONE", "1"), ("PERIOD", "."), ("FIVE", "5"))
        yield from until(lambda: abs(object_named(car).scale.x - 1.5) < 1e-5, "not scaled")
        yield 0.4
        screenshot("scale_status")

    yield from follows(typed, "the image does not follow the scale")
    yield from rests(car, low)
    uid = object_named(car).unisim.uid
    assert edits() == [("Move", uid), ("Scale", uid)] and factors() == {uid: (1.5, 1.5, 1.5)}


def undone() -> Iterator[float]:
    """Ctrl-Z brings the image back to the bit, Ctrl-Shift-Z the scale."""
    car = chosen["stands"]
    uid, larger = object_named(car).unisim.uid, shown()
    yield from follows(lambda: key("Z", ctrl=True), "the image does not follow undo")
    assert object_named(car).scale.x == 1.0 and not edits()
    assert not np.array_equal(larger, shown())
    yield from follows(lambda: key("Z", ctrl=True, shift=True), "the image does not follow redo")
    assert factors() == {uid: (1.5, 1.5, 1.5)} and ("Move", uid) in edits()
    assert np.array_equal(larger, shown()), "the image after redo is not the one before undo"


def grounded() -> Iterator[float]:
    """Ctrl-Alt-G brings a car that was lifted off the road back to where its wheels were."""
    car = chosen["stands"]
    low = underside(car)
    yield from follows(lambda: lifted("ONE", "1"), "the image does not follow the car")
    assert underside(car) > low + 0.9
    yield from follows(lambda: key("G", ctrl=True, alt=True), "the image does not follow to the ground")
    assert abs(underside(car) - low) < 0.15, (low, underside(car))


def lifted(*metres: str) -> Iterator[float]:
    """G Z, some metres, Enter."""
    for press in (("G",), ("Z",), metres, ("RET",)):
        yield from key(*press)


def stretched_car() -> Iterator[float]:
    """S Z 1.4 Enter on a car that drives, and the next frame."""
    car = chosen["drives"]
    yield from pick(car)
    low = underside(car)

    def typed() -> Iterator[float]:
        yield from scaled_by(("Z",), ("ONE", "1"), ("PERIOD", "."), ("FOUR", "4"))
        yield from until(lambda: abs(object_named(car).scale.z - 1.4) < 1e-3, "not scaled")

    yield from follows(typed, "the image does not follow the scale along z")
    yield from rests(car, low)
    assert np.allclose(factors()[object_named(car).unisim.uid], (1.0, 1.0, 1.4), atol=1e-3)
    yield from to(*middle(area("VIEW_3D")))
    yield from key("RIGHT_ARROW")
    yield from until(lambda: bpy.context.scene.frame_current == 8, "the next frame is not shown")
    yield from wait_for_image()
    assert np.allclose(object_named(car).scale, (1.0, 1.0, 1.4), atol=1e-3), "the next frame puts it back"
    assert [kind for kind, _ in edits()].count("Scale") == 2


def copied_car() -> Iterator[float]:
    """Shift-D of the scaled car, Y 4 Enter: the copy is as large; X Enter takes it away."""
    car, count = chosen["drives"], len(bpy.context.scene.objects)
    yield from pick(car)
    yield from key("D", shift=True)
    for press in (("Y",), ("Y",), ("THREE", "3"), ("RET",)):
        yield from key(*press)
    yield from until(lambda: len(bpy.context.scene.objects) == count + 1, "not copied")
    yield from wait_for_image()
    copy = bpy.context.view_layer.objects.active.name
    assert factors()[copy] == factors()[object_named(car).unisim.uid], factors()
    screenshot("scale_copy")
    yield from follows(lambda: _removed(copy), "the image does not follow the removal")


def _removed(name: str) -> Iterator[float]:
    yield from key("X")
    yield 0.3
    yield from key("RET")
    yield from until(lambda: name not in bpy.context.scene.objects, "not removed")


def mirrored_car() -> Iterator[float]:
    """S X -1 Enter: the view leaves the car out and says why, by name; undone."""
    car, viewport = chosen["stands"], sys.modules[f"{MODULE}.viewport.views"]
    yield from pick(car)
    yield from scaled_by(("X",), ("MINUS", "-"), ("ONE", "1"))

    def notice() -> str:
        return " ".join(list(viewport.VIEWS)[-1].left_out)

    yield from until(lambda: notice() and object_named(car).scale.x < 0, "nobody says that it cannot be mirrored", 20)
    assert car in notice() and "mirrored" in notice(), notice()
    yield 0.5
    screenshot("scale_mirrored")
    yield from key("Z", ctrl=True)
    yield from until(lambda: object_named(car).scale.x > 0 and not notice(), "not undone")
    yield from wait_for_image()


def same_pixels() -> Iterator[float]:
    """The screen shows what the engine made."""
    bare_view(view()[1])
    yield from differing("scaled_view_differs")


def as_large_as(width: int, height: int) -> Iterator[float]:
    """Zoom the view until the camera's frame has the size of the camera's own images."""
    found, space, looks = view()
    space.shading.type = "SOLID"  # nothing is rendered until the size is found
    viewport = sys.modules[f"{MODULE}.viewport.views"]

    def size() -> tuple[int, int]:
        with inside(found):
            _, _, wide, high = viewport.camera_rectangle(bpy.context, bpy.context.scene)
        return wide, high

    zoom = (np.sqrt(2) + looks.view_camera_zoom / 50) * np.sqrt(width / size()[0])
    near = [0, *(k * sign for k in range(1, 9) for sign in (1, -1))]
    # a frame about the middle of a pixel has even sizes at one zoom alone: it is moved by parts of a pixel, too
    for aside, by in ((aside, by) for aside in (0.0, 0.0004, 0.0008, 0.0012) for by in near):
        looks.view_camera_zoom = float(50 * (zoom * (1 + by / 4000) - np.sqrt(2)))
        looks.view_camera_offset = (aside, aside)
        looks.update()
        redraw()
        yield 0.1
        if size() == (width, height):
            break
    assert size() == (width, height), size()
    space.shading.type = "RENDERED"
    yield from wait_for_image()


def same_render() -> Iterator[float]:
    """`unisim render` of the exported scenario gives the viewport's image."""
    yield from as_large_as(480, 270)
    linear = np.clip(shown()[::-1, :, :3], 0, 1)
    path, frames, frame = OUT.parent / "scaled.json", OUT.parent / "scaled", bpy.context.scene.frame_current
    with inside(area("VIEW_3D")):
        assert bpy.ops.unisim.export_scenario(filepath=str(path)) == {"FINISHED"}
    interpreters, client = sys.modules[f"{MODULE}.process.interpreters"], sys.modules[f"{MODULE}.process.client"]
    wanted = ["--frames", str(frame), "--sensors", "front_camera"]
    command = interpreters.command(
        client._client.python.path, "cli", "render", str(path), "--out", str(frames), *wanted
    )
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    yield from until(lambda: process.poll() is not None, "unisim render does not end")
    said = process.stderr.read().decode() if process.stderr is not None else ""
    assert process.returncode == 0, said
    (file,) = frames.glob("camera/front_camera/*.png")
    image = bpy.data.images.load(str(file))
    image.colorspace_settings.name = "Non-Color"
    across, down = image.size
    written = np.array(image.pixels[:], np.float32).reshape(down, across, -1)[::-1, :, :3]
    assert written.shape == linear.shape, (written.shape, linear.shape)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-8) ** (1 / 2.4) - 0.055)
    results["render_and_view_differ"] = float(np.abs(srgb - written).max() / BYTE)
    assert np.abs(srgb - written).max() <= BYTE, f"they differ by {np.abs(srgb - written).max() / BYTE:.2f} of 255"


def steps() -> Iterator[float]:
    """The session."""
    bpy.ops.extensions.package_install_files(
        filepath=str(ARCHIVE), repo="user_default", enable_on_install=True, overwrite=True
    )
    yield 1.0
    begin()
    for name, todo in (
        ("scale_begun", begun),
        ("scaled_car", scaled_car),
        ("scale_undone", undone),
        ("scale_grounded", grounded),
        ("stretched_car", stretched_car),
        ("scale_copied", copied_car),
        ("scale_refused", mirrored_car),
        ("scale_pixels", same_pixels),
        ("scale_rendered", same_render),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "scale")
