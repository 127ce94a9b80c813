"""Buttons of the sidebar found by their operators and clicked, and what the edits list shows."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from typing import Any

import bpy
import buttons
import numpy as np
from hands import click, import_dropped, key, object_named, place, sidebar, to
from heart import uncounted
from numpy.typing import NDArray
from session import ARCHIVE, MODULE, OUT, area, inside, results, screenshot, until, view, wait_for_image


def module(name: str) -> Any:
    """A module of the extension."""
    return sys.modules[f"{MODULE}.{name}"]


def lines() -> list[Any]:
    """The list that the panel shows; none while it is being read."""
    reading = module("bridge.sampling.edit_list").reading_of(bpy.context.scene)
    return list(reading.lines) if reading.fresh else []


def listed(*wanted: tuple[str, bool]) -> Iterator[float]:
    """Wait until the panel shows these edits: how each begins, and whether it is muted."""

    def told() -> bool:
        now = sorted((line.what, line.muted >= 0) for line in lines())
        return len(now) == len(wanted) and all(
            a.startswith(b) and muted == is_muted for (a, muted), (b, is_muted) in zip(now, sorted(wanted), strict=True)
        )

    yield from until(told, f"the list does not show {wanted}, but {[(line.what, line.muted) for line in lines()]}", 40)
    yield 0.3


def shown_as(value: str | int) -> str:
    """Return how Blender writes an argument of a button's command."""
    return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"' if isinstance(value, str) else str(value)


def press(operator: str, across: float = 0.3, **values: Any) -> Iterator[float]:
    """Click on the button of an operator, with some of its properties; ``across`` says where in the row."""
    name = (f"{operator}(", *(f"{argument}={shown_as(value)}" for argument, value in values.items()))
    yield from buttons.press(name, columns=(across,))
    yield 0.3


def toggled(begins: str, across: float, *wanted: tuple[str, bool]) -> Iterator[float]:
    """Click the check mark of a line, again where a busy window lost the click; then the list shows ``wanted``."""
    for _ in range(3):
        line = next(line for line in lines() if line.what.startswith(begins))
        yield from press("unisim.mute_edit", across, **line_of(begins))
        last_s = time.monotonic() + 15.0
        while time.monotonic() < last_s:
            now = [one for one in lines() if one.what.startswith(begins)]
            if now and (now[0].muted >= 0) != (line.muted >= 0):
                yield from listed(*wanted)
                return
            yield 0.1
    yield from listed(*wanted)


def line_of(begins: str) -> dict[str, Any]:
    """The properties of the buttons of the line that begins so."""
    line = next(line for line in lines() if line.what.startswith(begins))
    kind, name, part = line.key
    return {"kind": kind, "name": name, "part": part, "muted": line.muted}


def picked(name: str) -> Iterator[float]:
    """Click an object in the view, again where a busy window lost the click."""
    for _ in range(3):
        yield from to(*place(object_named(name).matrix_world.translation))
        yield from click()
        last_s = time.monotonic() + 20.0
        while time.monotonic() < last_s:
            if bpy.context.view_layer.objects.active == object_named(name):
                return
            yield 0.1
    raise AssertionError(f"{name} is not selected, but {bpy.context.view_layer.objects.active}")


@uncounted
def shown_pixels(name: str) -> NDArray[np.float32]:
    """What the screen shows in the 3D view left of the sidebar, (H, W, 3) in steps of eight bits."""
    screenshot(name)
    image = bpy.data.images.load(str(OUT / f"{name}.png"), check_existing=False)
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    screen = np.array(image.pixels[:], np.float32).reshape(height, width, -1)[..., :3] * 255
    bpy.data.images.remove(image)
    regions = {region.type: region for region in area("VIEW_3D").regions}
    region, tabs = regions["WINDOW"], regions["UI"]
    return screen[region.y + 40 : region.y + region.height - 60, region.x + 80 : tabs.x - 10]


def apart(a: NDArray[np.float32], b: NDArray[np.float32]) -> float:
    """The share of pixels in which two images differ."""
    return float((np.abs(a - b).max(-1) > 6).mean())


def rendered() -> Iterator[float]:
    """Rendered shading, until the image is finished."""
    view()[1].shading.type = "RENDERED"
    yield from wait_for_image()
    yield 0.5


def timed_reading() -> None:
    """Note the processor time of the longest step in which the list is read: the wall's is that of all that runs
    beside."""
    watch = module("features.edits.watch")
    read = watch._read
    results["longest_reading_cpu_s"] = 0.0

    def timed() -> float | None:
        before = time.thread_time()
        again: float | None = read()
        results["longest_reading_cpu_s"] = max(
            float(str(results["longest_reading_cpu_s"])), time.thread_time() - before
        )
        return again

    watch._read = timed


def opened() -> Iterator[float]:
    """Install the extension, drop the sample's scene onto the window, and open the sidebar in a view as
    large as the window."""
    bpy.ops.extensions.package_install_files(
        filepath=str(ARCHIVE), repo="user_default", enable_on_install=True, overwrite=True
    )
    yield 1.0
    timed_reading()
    yield from import_dropped()
    yield from sidebar()
    with inside(area("VIEW_3D")):
        bpy.ops.screen.screen_full_area()
    yield 1.0
    yield from until(
        lambda: module("bridge.sampling.edit_list").reading_of(bpy.context.scene).fresh, "the list is not read"
    )
    assert not lines() and view()[2].view_perspective == "CAMERA"


def moved_along(*presses: tuple[str, ...]) -> Iterator[float]:
    """Press keys one after the other."""
    for press_ in presses:
        yield from key(*press_)
