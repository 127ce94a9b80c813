"""What a person does, done by a script inside a Blender with its window. Run by `run.py`, which starts Blender with this file.

Arguments after `--`: the extension's .zip, the sample scene's scene.json, a folder for screenshots and for results.json.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Euler, Vector
from numpy.typing import NDArray

ARCHIVE, SCENE, OUT = (Path(argument) for argument in sys.argv[sys.argv.index("--") + 1 :])
MODULE = "bl_ext.user_default.unisim_blender"
results: dict[str, object] = {}


def area(kind: str) -> bpy.types.Area:
    """The first area of a kind."""
    return next(a for a in bpy.context.window_manager.windows[0].screen.areas if a.type == kind)


def view() -> tuple[bpy.types.Area, bpy.types.SpaceView3D, bpy.types.RegionView3D]:
    """The 3D view."""
    found = area("VIEW_3D")
    return found, found.spaces.active, found.spaces.active.region_3d


def screenshot(name: str) -> None:
    """A picture of the whole window."""
    subprocess.run(["import", "-window", "root", str(OUT / f"{name}.png")], check=True)


def inside(found: bpy.types.Area) -> bpy.types.Context:
    """The context of an area, for operators that need one."""
    window = bpy.context.window_manager.windows[0]
    region = next(r for r in found.regions if r.type == "WINDOW")
    return bpy.context.temp_override(window=window, area=found, region=region)


def picture() -> NDArray[Any] | None:
    """What the viewport's engine shows, linear, or None while more is to come."""
    viewport = sys.modules.get(f"{MODULE}.viewport")
    if viewport is None or not viewport.VIEWS:
        return None
    shown = list(viewport.VIEWS)[-1]
    if shown.problem:
        raise AssertionError(shown.problem)
    return None if shown.pending or not shown.linear.size else shown.linear.copy()


def nearest(scene: bpy.types.Scene) -> bpy.types.Object:
    """The standing car that is nearest in front of the camera."""
    camera = scene.camera.matrix_world.inverted()

    def ahead(thing: bpy.types.Object) -> tuple[float, float]:
        x, _, z = camera @ thing.matrix_world.translation
        return -z, abs(x)

    standing = [o for o in scene.objects if o.unisim.kind == "ACTOR" and o.animation_data is None and "Car" in o.name]
    return min((o for o in standing if ahead(o)[0] > 8 and ahead(o)[1] < ahead(o)[0] / 3), key=ahead)


def choose(thing: bpy.types.Object) -> None:
    """Select an object and nothing else."""
    for other in bpy.context.selected_objects:
        other.select_set(False)
    thing.select_set(True)
    bpy.context.view_layer.objects.active = thing


def from_behind(region: bpy.types.RegionView3D) -> None:
    """Look along the street from above and behind the vehicle."""
    ego = next(o for o in bpy.context.scene.objects if o.unisim.kind == "EGO")
    region.view_perspective = "PERSP"
    region.view_location = ego.matrix_world.translation + Vector((14.0, 0.0, 0.0))
    region.view_rotation = Euler((np.radians(62), 0.0, np.radians(-90))).to_quaternion()
    region.view_distance = 34.0


def wait_for_picture(limit_s: float = 240.0) -> Iterator[float]:
    """Let the window go on until the viewport's picture is finished."""
    until = time.monotonic() + limit_s
    for found in bpy.context.window_manager.windows[0].screen.areas:
        found.tag_redraw()
    yield 0.3
    yield 0.3
    while picture() is None:
        assert time.monotonic() < until, "the viewport's picture does not come"
        yield 0.2


def steps() -> Iterator[float]:
    """The session; what is yielded are seconds for the window to go on."""
    bpy.ops.extensions.package_install_files(filepath=str(ARCHIVE), repo="user_default", enable_on_install=True, overwrite=True)
    yield 1.0
    for thing in list(bpy.data.objects):
        bpy.data.objects.remove(thing)
    begun = time.monotonic()
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.import_scene(filepath=str(SCENE))
    results["import_s"] = time.monotonic() - begun
    found, space, region = view()
    space.show_region_ui = True
    sidebar = next(r for r in found.regions if r.type == "UI")
    space.shading.type = "SOLID"
    region.view_perspective = "CAMERA"
    bpy.context.scene.frame_set(9)
    yield 1.0
    with suppress(AttributeError):  # read-only in older Blenders
        sidebar.active_panel_category = "UniSim"
    found.tag_redraw()
    yield 1.0
    screenshot("imported")
    from_behind(region)
    yield 1.0
    screenshot("overview")
    # a car that drives, shifted into the next lane: its way, and where it was recorded
    scene = bpy.context.scene
    driving = next(o for o in scene.objects if o.unisim.kind == "ACTOR" and o.animation_data is not None and not o.hide_viewport)
    choose(driving)
    with inside(found):
        bpy.ops.unisim.retime_actor(way="DELAY", frames=6)
    yield 1.0
    screenshot("way")
    with inside(found):
        bpy.ops.unisim.retime_actor(way="DELAY", frames=-6)
    yield 0.5
    # what the engine shows through the camera is what F12 renders
    scene.render.engine = "UNISIM"
    region.view_perspective = "CAMERA"
    space.shading.type = "RENDERED"
    begun = time.monotonic()
    yield from wait_for_picture()
    results["viewport_s"] = time.monotonic() - begun
    screenshot("rendered")
    shown = picture()
    assert shown is not None
    scene.render.resolution_x, scene.render.resolution_y = shown.shape[1], shown.shape[0]
    scene.render.filepath = str(OUT / "f12.png")
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGB"
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(OUT / "f12.png"))
    image.colorspace_settings.name = "Non-Color"
    f12 = np.array(image.pixels[:], np.float32).reshape(shown.shape[0], shown.shape[1], 4)[..., :3]
    linear = np.clip(shown[..., :3], 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-8) ** (1 / 2.4) - 0.055)
    results["viewport_and_f12"] = float(np.abs(srgb - f12).max() * 255)
    # an edit
    car = nearest(scene)
    choose(car)
    car.location.z += 1.0
    begun = time.monotonic()
    yield from wait_for_picture()
    results["refresh_s"] = time.monotonic() - begun
    results["refresh_changed"] = float(np.abs(picture() - shown).max())
    screenshot("moved")
    # the worker dies in the middle of a picture, and the next request brings it back
    worker = sys.modules[f"{MODULE}.client"]._client
    car.location.z -= 1.0
    car.location.x += 0.5
    yield 0.3
    os.kill(worker.process.pid, signal.SIGKILL)
    yield 1.5
    results["after_kill"] = worker.problem
    screenshot("killed")
    car.location.x -= 0.5
    yield from wait_for_picture()
    screenshot("again")
    # any angle, and a cone copied with Blender's own tools
    cone = next(o for o in scene.objects if o.unisim.kind == "ACTOR" and "Cone" in o.name)
    choose(cone)
    with inside(found):
        bpy.ops.object.duplicate_move(TRANSFORM_OT_translate={"value": (3.0, 1.5, 0.0)})
    yield from wait_for_picture()
    screenshot("cone")
    from_behind(region)
    yield from wait_for_picture()
    screenshot("any_angle")
    # for a Blender without a window
    bpy.ops.wm.save_userpref()
    bpy.ops.wm.save_as_mainfile(filepath=str(OUT.parent / "drive.blend"))
    results["done"] = True


def run(session: Iterator[float]) -> float | None:
    """One step, as a timer of Blender's."""
    try:
        return next(session)
    except StopIteration:
        pass
    except BaseException:
        results["error"] = traceback.format_exc()
        screenshot("error")
    (OUT / "results.json").write_text(json.dumps(results, indent=1))
    bpy.ops.wm.quit_blender()
    return None


if __name__ == "__main__":
    bpy.context.preferences.view.show_splash = False
    session = steps()
    bpy.app.timers.register(lambda: run(session), first_interval=2.0)
