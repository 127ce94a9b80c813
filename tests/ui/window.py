"""What a person does, done by a script inside a Blender with its window. Run by `run.py`, which starts
Blender with this file."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

sys.path.insert(0, str(Path(__file__).parent))
from session import (
    ARCHIVE,
    MODULE,
    OUT,
    SCENE,
    area,
    choose,
    from_behind,
    inside,
    results,
    screenshot,
    start,
    until,
    view,
    viewport_image,
    wait_for_image,
)


def nearest(scene: bpy.types.Scene) -> bpy.types.Object:
    """The standing car that is nearest in front of the camera."""
    camera = scene.camera.matrix_world.inverted()

    def ahead(obj: bpy.types.Object) -> tuple[float, float]:
        x, _, z = camera @ obj.matrix_world.translation
        return -z, abs(x)

    standing = [o for o in scene.objects if o.unisim.kind == "ACTOR" and o.parent is None and "Car" in o.name]
    return min((o for o in standing if ahead(o)[0] > 8 and ahead(o)[1] < ahead(o)[0] / 3), key=ahead)


def ahead_of_camera(away_m: float) -> Vector:
    """A place so far in front of the camera, on its own height."""
    looks = bpy.context.scene.camera.matrix_world
    along = looks.to_3x3() @ Vector((0.0, 0.0, -1.0))
    return looks.translation + Vector((along.x, along.y, 0.0)).normalized() * away_m


def swept() -> str:
    """What tells one simulated sweep from the next; "" where none is shown."""
    return next((obj.unisim.stamp for obj in bpy.context.scene.objects if obj.unisim.kind == "POINTS"), "")


def shown_sweeps() -> list[str]:
    """Names of the sweeps that have points."""
    return [obj.name for obj in bpy.context.scene.objects if obj.unisim.kind == "POINTS" and len(obj.data.vertices)]


def f12() -> None:
    """Render in a window of its own, as the key does."""
    with inside(area("VIEW_3D")):
        bpy.ops.render.render("INVOKE_DEFAULT", use_viewport=True)


def escape() -> None:
    """Esc on the real keyboard, with the mouse over the image's window: Blender stops a render at no simulated one.
    That window is as large as its image, and without a window manager a key goes to what lies under the mouse."""
    main, image = (
        bpy.context.window_manager.windows[0],
        bpy.context.window_manager.windows[-1],
    )  # one, where none is open
    x, y = image.x + image.width // 2, main.height - image.y - image.height // 2
    subprocess.run(["xdotool", "mousemove", str(x), str(y), "key", "Escape"], check=True)


def rendering() -> bool:
    """Whether F12 is at work."""
    return bpy.app.is_job_running("RENDER")


def stopped_by_esc() -> Iterator[float]:
    """F12 of a large image, Esc in the middle of it, then F12 of a small one, by the same worker."""
    scene, manager = bpy.context.scene, bpy.context.window_manager
    worker = sys.modules[f"{MODULE}.process.client"]._client
    process, arrays, bands = worker.process.pid, worker.arrays, []

    def counted(event: dict[str, Any]) -> Any:
        bands.append(event["rows"])
        return arrays(event)

    worker.arrays = counted
    scene.render.resolution_percentage = 200
    f12()
    yield from until(lambda: len(bands) >= 2, "F12 does not render")
    screenshot("rendering")
    begun = time.monotonic()
    escape()
    yield from until(lambda: not rendering(), "Esc does not stop F12")
    results["esc_s"] = time.monotonic() - begun
    results["esc_left"] = 1 - bands[-1][1] / (2 * scene.render.resolution_y)
    scene.render.resolution_percentage = 10
    begun = time.monotonic()
    f12()
    yield from until(rendering, "F12 does not render again")
    yield from until(lambda: not rendering(), "the worker does not answer after Esc")
    results["after_esc_s"] = time.monotonic() - begun
    yield 0.5
    screenshot("after_esc")
    del worker.arrays
    assert not worker.problem and worker.process.pid == process
    presses, last = 0, 0.0
    while len(manager.windows) > 1:
        assert presses < 4, "the window of the image stays"
        if time.monotonic() - last > 3.0:
            escape()
            presses, last = presses + 1, time.monotonic()
        yield 0.05
    results["esc_presses"] = presses
    scene.render.resolution_percentage = 100


def timed(change: Callable[[], None]) -> Iterator[float]:
    """Make a change; the window's times go to `TIMES`: seconds to the first drawing of what comes of it and to the
    last, and for how long the window did nothing else at most."""
    viewport = sys.modules[f"{MODULE}.viewport.views"]
    before, drawn, draw = [one.wanted for one in viewport.VIEWS], [], viewport.ViewportImage.draw

    def noted(self: Any, *arguments: Any) -> None:
        fresh, pending = self.fresh, self.pending
        draw(self, *arguments)
        if not fresh and all(self.wanted is not wanted for wanted in before):
            drawn.append((time.monotonic(), pending))

    viewport.ViewportImage.draw = noted
    begun = last = time.monotonic()
    change()
    longest = 0.0
    while not drawn or drawn[-1][1]:
        states = [(one.pending, one.fresh, one.waits, one.problem) for one in viewport.VIEWS]
        assert last < begun + 60, f"the viewport's image does not come: {states}"
        yield 0.005
        longest, last = max(longest, time.monotonic() - last), time.monotonic()
    viewport.ViewportImage.draw = draw
    TIMES.append((drawn[0][0] - begun, drawn[-1][0] - begun, longest))
    yield 0.3


def medians() -> dict[str, float]:
    """Of `TIMES`, which then are none."""
    values = dict(zip(("first_s", "last_s", "longest_wait_s"), np.median(TIMES, 0).round(3).tolist(), strict=True))
    TIMES.clear()
    return values


def times() -> Iterator[float]:
    """How soon a camera's view of 960 x 540 pixels follows another frame, a box that is moved, and one
    that is dragged."""
    scene = bpy.context.scene
    with inside(area("VIEW_3D")):
        bpy.ops.screen.screen_full_area()
    yield 1.0
    found, _, region = view()
    width = next(r for r in found.regions if r.type == "WINDOW").width
    region.view_camera_zoom = 50 * (2 * np.sqrt(960 / width) - np.sqrt(2))
    yield from wait_for_image()
    for frame in (10, 11, 12, 13, 14):
        yield from timed(partial(scene.frame_set, frame))
    shown = viewport_image()
    assert shown is not None
    measured: dict[str, Any] = {"size": [shown.shape[1], shown.shape[0]], "frame": medians()}
    screenshot("times")
    car = nearest(scene)

    def move() -> None:
        car.location.x += 0.1

    for _ in range(5):
        yield from timed(move)
    measured["box"] = medians()
    for _ in range(10):
        move()
        yield 0.05
    yield from timed(move)
    results["times"] = {**measured, "dragged": medians()}
    car.location.x -= 1.6
    scene.frame_set(9)
    region.view_camera_zoom = 0.0
    with inside(area("VIEW_3D")):
        bpy.ops.screen.screen_full_area()
    yield 1.0


TIMES: list[tuple[float, float, float]] = []


def steps() -> Iterator[float]:
    """The session; what is yielded are seconds for the window to go on."""
    bpy.ops.extensions.package_install_files(
        filepath=str(ARCHIVE), repo="user_default", enable_on_install=True, overwrite=True
    )
    yield 1.0
    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
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
    driving = next(
        o for o in scene.objects if o.unisim.kind == "ACTOR" and o.parent is not None and not o.hide_viewport
    )
    choose(driving)
    with inside(found):
        bpy.ops.unisim.retime_actor(mode="DELAY", seconds=0.6)
    yield 1.0
    screenshot("way")
    with inside(found):
        bpy.ops.unisim.retime_actor(mode="DELAY", seconds=-0.6)
    yield 0.5
    # what the engine shows through the camera is what F12 renders
    scene.render.engine = "UNISIM"
    region.view_perspective = "CAMERA"
    space.shading.type = "RENDERED"
    begun = time.monotonic()
    yield from wait_for_image()
    results["viewport_s"] = time.monotonic() - begun
    renderer = sys.modules[f"{MODULE}.process.client"]._client.python
    results["own_python"] = renderer.path == sys.executable
    results["packages_lacking"] = renderer.about["training_lacks"]
    screenshot("rendered")
    shown = viewport_image()
    assert shown is not None
    scene.render.resolution_x, scene.render.resolution_y = shown.shape[1], shown.shape[0]
    scene.render.filepath = str(OUT / "f12.png")
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGB"
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(OUT / "f12.png"))
    image.colorspace_settings.name = "Non-Color"
    written = np.array(image.pixels[:], np.float32).reshape(shown.shape[0], shown.shape[1], 4)[..., :3]
    linear = np.clip(shown[..., :3], 0, 1)
    srgb = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-8) ** (1 / 2.4) - 0.055)
    results["viewport_and_f12"] = float(np.abs(srgb - written).max() * 255)
    yield from stopped_by_esc()
    yield from times()
    found, space, region = view()
    yield from wait_for_image()
    # an edit
    car = nearest(scene)
    choose(car)
    car.location.z += 1.0
    begun = time.monotonic()
    yield from wait_for_image()
    results["refresh_s"] = time.monotonic() - begun
    results["refresh_changed"] = float(np.abs(viewport_image() - shown).max())
    screenshot("moved")
    # the worker dies in the middle of an image, and the next request brings it back
    worker = sys.modules[f"{MODULE}.process.client"]._client
    car.location.z -= 1.0
    car.location.x += 0.5
    yield 0.3
    os.kill(worker.process.pid, signal.SIGKILL)
    yield 1.5
    results["after_kill"] = worker.problem
    screenshot("killed")
    car.location.x -= 0.5
    yield from wait_for_image()
    screenshot("again")
    # any angle, and a cone copied with Blender's own tools
    cone = next(o for o in scene.objects if o.unisim.kind == "ACTOR" and "Cone" in o.name)
    choose(cone)
    with inside(found):
        bpy.ops.object.duplicate_move(TRANSFORM_OT_translate={"value": (3.0, 1.5, 0.0)})
    yield from wait_for_image()
    screenshot("cone")
    # a mesh that nobody recorded, in the lane ahead
    with inside(found):
        bpy.ops.mesh.primitive_monkey_add(size=1.6, location=ahead_of_camera(14.0), rotation=(0.0, 0.0, -np.pi / 2))
    monkey = bpy.context.view_layer.objects.active
    paint = bpy.data.materials.new("clay")
    if paint.node_tree is None:
        paint.use_nodes = True
    paint.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.7, 0.25, 0.05, 1.0)
    monkey.data.materials.append(paint)
    before = viewport_image()
    with inside(found):
        bpy.ops.object.shade_smooth()
        bpy.ops.unisim.mesh_actor(label="Other")
        bpy.ops.unisim.snap_to_ground()
    yield from wait_for_image()
    after = viewport_image()
    assert before is not None and after is not None
    results["mesh_changed"] = float(np.abs(after - before).max())
    screenshot("mesh")
    from_behind(region)
    yield from wait_for_image()
    screenshot("any_angle")
    # a simulated sweep follows an edit
    space.shading.type = "SOLID"
    scene.unisim.points_colour = "INSTANCE"
    with inside(found):
        bpy.ops.unisim.show_points(recorded=False, simulated=True)
    yield from until(swept, "no simulated sweep comes")
    before_edit = swept()
    results["sweep_points"] = sum(len(o.data.vertices) for o in scene.objects if o.unisim.kind == "POINTS")
    car.location.y += 1.0
    yield from until(lambda: swept() not in ("", before_edit), "the sweep does not follow an edit")
    yield 0.5
    screenshot("sweep")
    car.location.y -= 1.0
    # recorded and simulated points together, by their depth
    scene.unisim.points_colour = "DEPTH"
    with inside(found):
        bpy.ops.unisim.show_points(recorded=True, simulated=True)
    yield from until(lambda: len(shown_sweeps()) == 2, "recorded and simulated points are not shown together")
    yield 1.0
    screenshot("sweeps_by_depth")
    with inside(found):
        bpy.ops.unisim.show_points(recorded=False, simulated=False)
    # for a Blender without a window
    bpy.ops.wm.save_userpref()
    bpy.ops.wm.save_as_mainfile(filepath=str(OUT.parent / "drive.blend"))


if __name__ == "__main__":
    start(steps(), "window")
