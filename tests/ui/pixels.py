"""What the screen shows, pixel by pixel, beside what `unisim render` makes of the exported scenario.

Compared are all pixels of the camera's frame but those under what Blender draws over a view whatever it shows
(`uncovered`): the area's other regions (header, toolbar, sidebar, redo panel) and the dashed line round
the camera's frame.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
from heart import uncounted
from numpy.typing import NDArray
from session import MODULE, OUT, inside, results, screenshot, until, view, wait_for_image

SAME_BYTES = 2
"""How far a pixel on the screen may be from the rendered one, in steps of eight bits."""
LINE = 2
"""How far the dashed line of the camera's frame reaches to either side of the frame's edge, in pixels."""
MARGIN = 8
"""How far what a region draws reaches beyond it, in pixels."""
STATUS_HIGH = 24
"""How high the status bar is, which shows sentences for some seconds."""
HEADLESS = OUT.parent / "headless"
"""What `unisim render` leaves, a folder a comparison."""

Image = NDArray[np.uint8]


@uncounted
def grab() -> Image:
    """Return the whole screen: (H, W, 3), top row first."""
    raw = subprocess.run(["import", "-window", "root", "-depth", "8", "rgb:-"], check=True, capture_output=True).stdout
    window = bpy.context.window_manager.windows[0]
    return np.frombuffer(raw, np.uint8).reshape(window.height, window.width, 3)


def settled(into: list[Image], limit_s: float = 90.0) -> Iterator[float]:
    """Put the screen into ``into`` once it stays as it is: Blender draws lines smoother in each of some drawings."""
    last, until_s = grab(), time.monotonic() + limit_s
    while True:
        yield 0.6
        now = grab()
        if (now[:-STATUS_HIGH] == last[:-STATUS_HIGH]).all():
            break
        assert time.monotonic() < until_s, "the window never stays as it is"
        last = now
    into[:] = [now]


def part(screen: Image, rectangle: tuple[int, int, int, int]) -> Image:
    """Return the pixels of a rectangle: left, bottom, width, height in the window, which Blender counts from below."""
    left, bottom, width, height = rectangle
    return screen[len(screen) - bottom - height : len(screen) - bottom, left : left + width]


def region_rectangle(kind: str, found: bpy.types.Area | None = None) -> tuple[int, int, int, int]:
    """Return left, bottom, width and height in the window of a region of the 3D view, or of another area."""
    region = next(r for r in (found or view()[0]).regions if r.type == kind)
    return region.x, region.y, region.width, region.height


def frame_rectangle() -> tuple[int, int, int, int]:
    """Return where the viewport's image is in the window: left, bottom, width, height."""
    left, bottom, width, height = list(sys.modules[f"{MODULE}.viewport.views"].VIEWS)[-1].rectangle
    x, y, _, _ = region_rectangle("WINDOW")
    return x + left, y + bottom, width, height


@uncounted
def uncovered(screen: Image, frame: tuple[int, int, int, int]) -> NDArray[np.bool_]:
    """Return which of the frame's pixels nothing but the engine draws: (height, width), top row first."""
    free = np.zeros(screen.shape[:2], np.uint8)
    part(free, region_rectangle("WINDOW"))[:] = 1
    for region in view()[0].regions:
        if region.type != "WINDOW" and region.width > 1 and region.height > 1:
            low_x, low_y = max(region.x - MARGIN, 0), max(region.y - MARGIN, 0)
            high_x, high_y = region.x + region.width + MARGIN, region.y + region.height + MARGIN
            part(free, (low_x, low_y, high_x - low_x, high_y - low_y))[:] = 0
    inner = part(free, frame).astype(bool)
    inner[:LINE] = inner[-LINE:] = inner[:, :LINE] = inner[:, -LINE:] = False
    return inner


@uncounted
def read_image(path: Path) -> Image:
    """Return an image file: (H, W, 3), top row first."""
    image = bpy.data.images.load(str(path), check_existing=False)
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    read = values.reshape(height, width, -1)[::-1, :, :3]
    bpy.data.images.remove(image)
    return np.rint(np.clip(read, 0, 1) * 255).astype(np.uint8)


def command_line(*arguments: str) -> list[str]:
    """Return how the command `unisim` is run with the extension's own copy of it and Blender's own Python."""
    interpreters = sys.modules[f"{MODULE}.process.interpreters"]
    return list(interpreters.command(sys.executable, "cli", *arguments))


@uncounted
def export(name: str) -> Path:
    """Write the scenario that the scene stands for; return its path."""
    path = HEADLESS / f"{name}.json"
    path.parent.mkdir(exist_ok=True)
    with inside(view()[0]):
        bpy.ops.unisim.export_scenario(filepath=str(path))
    return path


def rendered(path: Path, images: list[Image], width: int, frame: int | None = None) -> Iterator[float]:
    """Run `unisim render` on a scenario for a frame of the active camera; what it made, (H, W, 3), is put
    into ``images``."""
    scene = bpy.context.scene
    frame = scene.frame_current if frame is None else frame
    folder = path.with_suffix("")
    shutil.rmtree(folder, ignore_errors=True)
    camera = scene.camera.unisim.uid or scene.camera.name
    wanted = ["--frames", str(frame), "--sensors", camera, "--width", str(width), "--passes", "rgb", "--jobs", "1"]
    with (HEADLESS / "log.txt").open("wb") as log:
        process = subprocess.Popen(
            command_line("render", str(path), "--out", str(folder), *wanted), stdout=log, stderr=subprocess.STDOUT
        )
        yield from until(lambda: process.poll() is not None, "unisim render does not end", 240)
    assert process.returncode == 0, (HEADLESS / "log.txt").read_text()[-1000:]
    (image,) = folder.glob("camera/*/*.png")
    images.append(read_image(image))


@uncounted
def apart(on: Image, made: Image) -> NDArray[np.int16]:
    """Return how far apart two images are at each pixel, in steps of eight bits: (H, W)."""
    return np.asarray(np.abs(on.astype(np.int16) - made.astype(np.int16)).max(-1))


def as_rendered(name: str) -> Iterator[float]:
    """Fail where an uncovered pixel of the camera's frame is not that of `unisim render`; note the
    shares as results."""
    yield from wait_for_image()
    yield 0.5
    screenshot(name)
    screen, frame = grab(), frame_rectangle()
    images: list[Image] = []
    yield from rendered(export(name), images, frame[2])
    (made,) = images
    on, free = part(screen, frame), uncovered(screen, frame)
    assert on.shape == made.shape, f"{name}: the view's image is {on.shape}, the rendered one {made.shape}"
    far = apart(on, made)
    wrong = (far > SAME_BYTES) & free
    shown = {"pixels": int(free.sum()), "covered": round(float(1 - free.mean()), 4), "furthest": int(far[free].max())}
    compared = results.setdefault("compared", {})
    assert isinstance(compared, dict)
    compared[name] = {**shown, "differing": int(wrong.sum())}
    if wrong.any():
        _keep(name, on, made, wrong)
    assert not wrong.any(), (
        f"{name}: {wrong.sum()} of {free.sum()} pixels are not those of unisim render, by up to {far[free].max()}"
    )


@uncounted
def _keep(name: str, on: Image, made: Image, wrong: NDArray[np.bool_]) -> None:
    """Leave an image of what was compared: the screen, what was rendered, and where they differ, one
    below the other."""
    marked = np.repeat(np.where(wrong, 255, on.mean(-1) / 4).astype(np.uint8)[..., None], 3, -1)
    shown = np.concatenate([on, made, marked])
    height, width = shown.shape[:2]
    arguments = ["convert", "-size", f"{width}x{height}", "-depth", "8", "rgb:-", str(OUT / f"{name}_differs.png")]
    subprocess.run(arguments, input=shown.tobytes(), check=True)
