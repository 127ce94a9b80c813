"""Tasks of a person, timed, and what the screen shows compared with what the engine made. Sessions run their steps as tasks."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from typing import Any

import bpy
import hands
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from numpy.typing import NDArray
from session import MODULE, OUT, picture, results, screenshot, view, wait_for_picture

BEAT_S = 0.005
SAME_BYTES = 2.0
"""How far a pixel on the screen may be from the rendered one, in steps of eight bits."""


class Heart:
    """Measures for how long the window did nothing else at most, in seconds."""

    def __init__(self) -> None:
        self.last = time.monotonic()
        self.longest = 0.0

    def beat(self) -> float:
        """Called by a timer of Blender's."""
        now = time.monotonic()
        self.longest = max(self.longest, now - self.last - BEAT_S)
        self.last = now
        return BEAT_S


heart = Heart()
presses = [0]


def task(name: str, todo: Callable[[], Iterator[float]]) -> Iterator[float]:
    """Run a task and note how many presses it took, how long, and the longest block."""
    table = results.setdefault("tasks", {})
    assert isinstance(table, dict)
    presses[0], heart.longest, heart.last, begun = 0, 0.0, time.monotonic(), time.monotonic()
    event = hands.event

    def counted(kind: str, value: str, **more: Any) -> None:
        presses[0] += value == "PRESS"
        event(kind, value, **more)

    hands.event = counted
    try:
        yield from todo()
    finally:
        hands.event = event
        table[name] = {
            "presses": presses[0],
            "seconds": round(time.monotonic() - begun, 2),
            "longest_block_s": round(heart.longest, 3),
        }
    screenshot(name)


def on_screen() -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """What the screen shows where the engine's image is, and that image: (H, W, 3) each in steps of eight bits, top row first."""
    screenshot("pixels")
    image = bpy.data.images.load(str(OUT / "pixels.png"), check_existing=False)
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    screen = np.array(image.pixels[:], np.float32).reshape(height, width, -1)[..., :3]
    bpy.data.images.remove(image)
    found, _, _ = view()
    region = next(r for r in found.regions if r.type == "WINDOW")
    shown = list(sys.modules[f"{MODULE}.viewport"].VIEWS)[-1]
    left, bottom, wide, high = shown.rectangle
    linear = np.clip(shown.linear[..., :3], 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-8) ** (1 / 2.4) - 0.055)
    # inside both the region and the frame, and clear of what lies over the view's edges
    low_x, high_x = max(left, 80), min(left + wide, region.width - 120)
    low_y, high_y = max(bottom, 40), min(bottom + high, region.height - 60)
    y, x = region.y, region.x
    on = screen[y + low_y : y + high_y, x + low_x : x + high_x]
    made = srgb[low_y - bottom : high_y - bottom, low_x - left : high_x - left]
    return on[::-1] * 255, np.asarray(made[::-1] * 255, np.float32)


def bare_view(space: bpy.types.SpaceView3D) -> None:
    """Hide what a person would call overlays, but not what Blender draws behind or over a camera's view."""
    overlay = space.overlay
    overlay.show_floor = overlay.show_axis_x = overlay.show_axis_y = overlay.show_text = overlay.show_cursor = False
    overlay.show_extras = overlay.show_outline_selected = overlay.show_object_origins = False
    space.show_object_viewport_mesh = False
    space.show_gizmo = False
    bpy.context.scene.unisim.show_ways = False


def differing(what: str) -> Iterator[float]:
    """Note the share of the view's pixels that are not the rendered image's."""
    yield from wait_for_picture()
    yield 1.0
    on, made = on_screen()
    share = float((np.abs(on - made).max(-1) > SAME_BYTES).mean())
    results[what] = share
    assert share < 0.01, f"{what}: {share:.1%} of the view's pixels are not the rendered ones"


def changed(before: NDArray[Any] | None) -> bool:
    """Whether the viewport's finished picture is another one than before."""
    now = picture()
    return now is not None and before is not None and bool(np.abs(now - before).max() > 0.05)


def seen(driving: bool) -> str:
    """The name of the actor nearest in the middle of the camera's view that drives, or stands."""
    found, _, looks = view()
    region = next(r for r in found.regions if r.type == "WINDOW")
    camera = bpy.context.scene.camera.matrix_world.inverted()
    ranked = []
    for one in bpy.context.scene.objects:
        if one.unisim.kind != "ACTOR" or (one.parent is not None) != driving or one.hide_viewport:
            continue
        at = location_3d_to_region_2d(region, looks, one.matrix_world.translation)
        away = -(camera @ one.matrix_world.translation).z
        eye = bpy.context.scene.camera.matrix_world.translation
        depsgraph = bpy.context.evaluated_depsgraph_get()
        hit = bpy.context.scene.ray_cast(depsgraph, eye, (one.matrix_world.translation - eye).normalized())
        if not hit[0] or hit[4].name != one.name:
            continue  # another one stands before it
        if at is not None and away > 4 and 150 < at.x < region.width - 200 and 80 < at.y < region.height - 80:
            ranked.append((away, one.name))
    assert ranked, "no such actor is in view"
    return min(ranked)[1]


def begin() -> None:
    """Begin to measure how long the window does nothing else."""
    bpy.app.timers.register(heart.beat, persistent=True)
