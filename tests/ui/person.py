"""What a person does first, with mouse and keys, judged by what the screen shows. Run by `run.py`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from hands import click, drop, edits, key, middle, place, thing, to
from session import ARCHIVE, OUT, SCENE, area, inside, named, picture, screenshot, start, until, view, wait_for_picture
from tasks import bare_view, begin, changed, differing, seen, task


def first_import() -> Iterator[float]:
    """A trained scene dropped onto Blender's default file."""
    yield from to(*middle(area("VIEW_3D")))
    drop(SCENE)
    scene = bpy.context.scene
    yield from until(lambda: scene.render.engine == "UNISIM" and scene.camera.unisim.kind == "CAMERA", "the import does not end")
    yield 0.5
    yield from named()
    assert "Cube" not in bpy.context.view_layer.objects and "Cube" in bpy.data.objects
    assert view()[2].view_perspective == "CAMERA"
    assert not edits()


def clicked_car() -> Iterator[float]:
    """A click on a car through the camera selects the car."""
    car = seen(driving=False)
    yield from to(*place(thing(car).matrix_world.translation))
    yield from click()
    yield from until(
        lambda: bpy.context.view_layer.objects.active == thing(car) and thing(car).select_get(), "the car is not selected"
    )
    space = view()[1]
    assert not space.show_object_select_empty and not space.show_object_select_camera


def moved_driving_car() -> Iterator[float]:
    """G Y 3 on a car that drives, the next frame, undo and redo."""
    car = seen(driving=True)
    uid = thing(car).unisim.uid
    yield from to(*place(thing(car).matrix_world.translation))
    yield from click()
    yield from until(lambda: bpy.context.view_layer.objects.active == thing(car), "the driving car is not selected")
    for press in (("G",), ("Y",), ("THREE", "3"), ("RET",)):
        yield from key(*press)
    yield from until(lambda: thing(car).location.length > 2.9, "not moved")
    yield 0.5
    screenshot("status")
    yield from key("RIGHT_ARROW")
    yield 0.3
    assert abs(thing(car).location.length - 3) < 1e-3, "the next frame puts it back"
    assert edits() == [("Move", uid)]
    yield from key("LEFT_ARROW")
    yield from key("Z", ctrl=True)
    yield from key("Z", ctrl=True)
    yield from until(lambda: not edits(), "not undone")
    yield from key("Z", ctrl=True, shift=True)
    yield from until(lambda: edits() == [("Move", uid)], "not done again")


def auto_keyed_car() -> Iterator[float]:
    """With auto-key on, a change of one moment blends in."""
    scene = bpy.context.scene
    scene.tool_settings.use_keyframe_insert_auto = True
    scene.frame_set(10)
    yield 0.3
    car = seen(driving=True)
    yield from to(*place(thing(car).matrix_world.translation))
    yield from click()
    yield from until(lambda: bpy.context.view_layer.objects.active == thing(car), "the driving car is not selected")
    for press in (("G",), ("Y",), ("ONE", "1"), ("RET",)):
        yield from key(*press)

    def keys() -> list[int]:
        action = thing(car).animation_data.action if thing(car).animation_data else None
        return [len(c.keyframe_points) for c in action.fcurves if c.data_path == "location"] if action else []

    yield from until(lambda: keys() == [3, 3, 3], "the change is not blended")
    scene.tool_settings.use_keyframe_insert_auto = False
    places = []
    for frame in range(8, 13):
        scene.frame_set(frame)
        places.append(thing(car).location.copy())
        yield 0.05
    jumps = [(b - a).length for a, b in zip(places, places[1:], strict=False)]
    assert max(jumps) < 0.2, f"it jumps by {max(jumps):.2f} m"
    scene.frame_set(10)


def rendered_view() -> Iterator[float]:
    """Rendered shading through the camera shows the render and nothing else."""
    _, space, _ = view()
    space.shading.type = "RENDERED"
    bare_view(space)
    yield from differing("rendered_view_differs")


def shifted_ego() -> Iterator[float]:
    """The same with the vehicle two metres to the left."""
    before = picture()
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.shift_ego("INVOKE_DEFAULT", left_m=2.0)
    yield from until(lambda: changed(before), "the view does not follow", 60)
    yield from differing("shifted_view_differs")


def retimed_car() -> Iterator[float]:
    """Ctrl-Alt-T on a selected driving car: box and image follow without anything else."""
    space = view()[1]
    space.show_object_viewport_mesh = True
    yield 0.3
    car = seen(driving=True)
    yield from to(*place(thing(car).matrix_world.translation))
    yield from click()
    yield from until(lambda: bpy.context.view_layer.objects.active == thing(car), "the driving car is not selected")
    yield from wait_for_picture()
    before, stood = picture(), thing(car).matrix_world.translation.copy()
    yield from key("T", ctrl=True, alt=True)
    yield from until(lambda: (thing(car).matrix_world.translation - stood).length > 0.1, "the box does not follow", 5)
    yield from until(lambda: changed(before), "the image does not follow", 20)


def shown_points() -> Iterator[float]:
    """Recorded points, and those of the next frame."""
    view()[1].shading.type = "SOLID"
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.show_points("INVOKE_DEFAULT", recorded=True, simulated=False)
    has = lambda: any(o.unisim.kind == "POINTS" and len(o.data.vertices) for o in bpy.context.scene.objects)  # noqa: E731
    yield from until(has, "no recorded points are shown")
    yield from to(*middle(area("VIEW_3D")))
    for _ in range(3):
        yield from key("RIGHT_ARROW")
        yield 0.5
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.show_points("INVOKE_DEFAULT", recorded=False, simulated=False)


def opened_file() -> Iterator[float]:
    """Another file is opened while a sequence runs: progress and Cancel stay, and the next sequence can begin."""
    scene, manager = bpy.context.scene, bpy.context.window_manager
    scene.unisim.out = str(OUT.parent / "sequence")
    with inside(area("VIEW_3D")):
        assert bpy.ops.unisim.render_sequence("INVOKE_DEFAULT") == {"FINISHED"}
    yield from until(lambda: "frames" in manager.unisim_task, "no progress is shown")
    bpy.ops.wm.save_as_mainfile(filepath=str(OUT.parent / "kept.blend"))
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    yield 1.0
    yield from until(lambda: "frames" in bpy.context.window_manager.unisim_task, "progress vanishes with the file", 10)
    bpy.ops.wm.open_mainfile(filepath=str(OUT.parent / "kept.blend"))
    yield 1.0
    with inside(area("VIEW_3D")):
        assert bpy.ops.unisim.cancel_task("INVOKE_DEFAULT") == {"FINISHED"}
    yield from until(lambda: "Stopped at" in bpy.context.window_manager.unisim_task, "Cancel is not answered", 60)
    with inside(area("VIEW_3D")):
        assert bpy.ops.unisim.render_sequence.poll(), "Render Sequence stays grey"


def steps() -> Iterator[float]:
    """The session."""
    bpy.ops.extensions.package_install_files(filepath=str(ARCHIVE), repo="user_default", enable_on_install=True, overwrite=True)
    yield 1.0
    begin()
    for name, todo in (
        ("first_import", first_import),
        ("clicked_car", clicked_car),
        ("moved_driving_car", moved_driving_car),
        ("auto_keyed_car", auto_keyed_car),
        ("rendered_view", rendered_view),
        ("shifted_ego", shifted_ego),
        ("retimed_car", retimed_car),
        ("shown_points", shown_points),
        ("opened_file", opened_file),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "person")
