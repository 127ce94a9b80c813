"""What every session in a Blender window needs: arguments, areas, screenshots, waiting, and steps run by a timer.

Arguments after `--`: the extension's .zip, the sample scene's scene.json, a folder for screenshots and results.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from heart import uncounted
from mathutils import Euler, Vector
from numpy.typing import NDArray

ARCHIVE, SCENE, OUT = (Path(argument) for argument in sys.argv[sys.argv.index("--") + 1 :])
MODULE = "bl_ext.user_default.unisim_blender"
results: dict[str, object] = {}
waited_s = {"machine": 0.0, "search": 0.0}
"""For how long a session has waited for the window's work, and searched the window for buttons, which a person sees."""
is_searching = [False]
"""Whether keys are pressed for such a search: they are none of a person's."""


def area(kind: str) -> bpy.types.Area:
    """The first area of a kind."""
    return next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == kind)


def view() -> tuple[bpy.types.Area, bpy.types.SpaceView3D, bpy.types.RegionView3D]:
    """The 3D view."""
    found = area("VIEW_3D")
    return found, found.spaces.active, found.spaces.active.region_3d


@uncounted
def screenshot(name: str) -> None:
    """An image of the whole window."""
    begun = time.monotonic()
    subprocess.run(["import", "-window", "root", str(OUT / f"{name}.png")], check=True)
    waited_s["search"] += time.monotonic() - begun


def inside(found: bpy.types.Area) -> bpy.types.Context:
    """The context of an area, for operators that need one."""
    window = bpy.context.window_manager.windows[0]
    region = next(r for r in found.regions if r.type == "WINDOW")
    return bpy.context.temp_override(window=window, area=found, region=region)


def viewport_image() -> NDArray[Any] | None:
    """What the viewport's engine shows, linear, or None while more is to come."""
    viewport = sys.modules.get(f"{MODULE}.viewport.views")
    if viewport is None or not viewport.VIEWS:
        return None
    shown = list(viewport.VIEWS)[-1]
    if shown.problem:
        raise AssertionError(shown.problem)
    return None if shown.pending or not shown.linear.size else shown.linear.copy()


def choose(obj: bpy.types.Object) -> None:
    """Select an object and nothing else."""
    for other in bpy.context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    bpy.context.view_layer.objects.active = obj


def from_behind(region: bpy.types.RegionView3D) -> None:
    """Look along the street from above and behind the vehicle."""
    ego = next(o for o in bpy.context.scene.objects if o.unisim.kind == "EGO")
    region.view_perspective = "PERSP"
    region.view_location = ego.matrix_world.translation + Vector((14.0, 0.0, 0.0))
    region.view_rotation = Euler((np.radians(62), 0.0, np.radians(-90))).to_quaternion()
    region.view_distance = 34.0


def until(holds: Callable[[], object], what: str, limit_s: float = 120.0) -> Iterator[float]:
    """Let the window go on until something holds; ``what`` is said where it never does."""
    begun = time.monotonic()
    try:
        while not holds():
            assert time.monotonic() < begun + limit_s, what
            yield 0.05
    finally:
        waited_s["machine"] += time.monotonic() - begun


def named() -> Iterator[float]:
    """Let the window go on until actors have the words for their colours: names stay as they are from then on."""
    thumbnails = sys.modules.get(f"{MODULE}.features.actors.thumbnails")
    if thumbnails is None:
        return  # earlier versions have no such words
    log = thumbnails.log_of(bpy.context.scene)
    done = lambda: log in thumbnails._complete or log in thumbnails._problems  # noqa: E731
    yield from until(done, "no thumbnails come", 300)
    assert log in thumbnails._complete, thumbnails._problems
    yield 0.5


def redraw() -> None:
    """Draw the window again."""
    for found in bpy.context.window_manager.windows[0].screen.areas:
        found.tag_redraw()


def wait_for_image(limit_s: float = 240.0) -> Iterator[float]:
    """Let the window go on until the viewport's image is finished."""
    redraw()
    yield 0.3
    yield 0.3
    yield from until(lambda: viewport_image() is not None, "the viewport's image does not come", limit_s)


def start(steps: Iterator[float], name: str) -> None:
    """Run a session, whose yields are seconds for the window to go on; results go to a file of that name,
    and Blender ends."""
    bpy.context.preferences.view.show_splash = False
    bpy.app.timers.register(lambda: _step(steps, name), first_interval=2.0, persistent=True)


def _step(steps: Iterator[float], name: str) -> float | None:
    try:
        return next(steps)
    except StopIteration:
        results["done"] = True
    except BaseException:
        results["error"] = traceback.format_exc()
        screenshot(f"{name}_error")
    (OUT / f"{name}.json").write_text(json.dumps(results, indent=1))
    bpy.ops.wm.quit_blender()
    return None
