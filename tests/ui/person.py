"""What a person does first: imports, clicks on cars, looks at the rendered image. Run by `run.py`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy
from bpy_extras.view3d_utils import location_3d_to_region_2d, region_2d_to_vector_3d
from mathutils import Vector

sys.path.insert(0, str(Path(__file__).parent))
from browser import choose_path, menu_entry
from buttons import open_panel, press, redo_panel, reports
from hands import click, edits, key, middle, object_named, place, to
from pixels import Image, apart, as_rendered, part, region_rectangle, settled
from session import SCENE, area, from_behind, named, start, until, view, viewport_image
from tasks import bare_view, changed, click_car, drives, fresh, imported, install, keys, seen, task, through_camera

SENSORS = ("CAMERA", "LIDAR", "EGO")
REACH = 10
"""How far from the mouse Blender looks for what is clicked, in pixels."""


def first_import() -> Iterator[float]:
    """File > Import of a trained scene in Blender's default file, with the file browser."""
    yield from menu_entry("scenario or rollout")
    yield from choose_path(SCENE)
    scene = bpy.context.scene
    yield from until(
        lambda: scene.camera is not None and scene.camera.unisim.kind == "CAMERA", "the import does not end"
    )
    yield from named()
    assert (scene.render.resolution_x, scene.render.resolution_y) == (480, 270), (
        "images have another size than the camera's"
    )
    assert (scene.frame_start, scene.frame_end, scene.frame_current) == (0, 19, 0), "the frame range is not the drive's"
    assert scene.render.engine == "UNISIM", "the engine stays another one"
    assert view()[2].view_perspective == "CAMERA", "the view does not look through the camera"
    for name in ("Cube", "Light", "Camera"):
        assert name in bpy.data.objects and name not in bpy.context.view_layer.objects, (
            f"{name} stays in the drive's image"
        )
    said = [line for line in reports() if "Imported" in line]
    assert len(said) == 1 and "20 frames" in said[0] and "20 actors" in said[0], f"it says {said}"
    assert not edits()


def clear(one: bpy.types.Object, eye: Vector) -> bool:
    """Whether all that lies within a click's reach is the same object: Blender takes the nearest thing
    within some pixels."""
    found, _, looks = view()
    region = next(r for r in found.regions if r.type == "WINDOW")
    x, y = location_3d_to_region_2d(region, looks, one.matrix_world.translation)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    for dx, dy in ((REACH, REACH), (REACH, -REACH), (-REACH, REACH), (-REACH, -REACH)):
        hit = bpy.context.scene.ray_cast(depsgraph, eye, region_2d_to_vector_3d(region, looks, (x + dx, y + dy)))
        if not hit[0] or hit[4].name != one.name:
            return False
    return True


def clicked_cars() -> Iterator[float]:
    """A click on each car in view through the camera selects it, and Select All selects no sensor."""
    yield from fresh()
    names, eye = [], bpy.context.scene.camera.matrix_world.translation
    for one in bpy.context.scene.objects:
        if one.unisim.kind != "ACTOR" or one.hide_viewport:
            continue
        depsgraph, at = bpy.context.evaluated_depsgraph_get(), one.matrix_world.translation
        hit = bpy.context.scene.ray_cast(depsgraph, eye, (at - eye).normalized())
        left, bottom, width, height = region_rectangle("WINDOW")
        if (
            hit[0]
            and hit[4].name == one.name
            and -(bpy.context.scene.camera.matrix_world.inverted() @ at).z > 4
            and clear(one, eye)
        ):
            x, y = place(at)
            if left + 150 < x < left + width - 350 and bottom + 80 < y < bottom + height - 80:
                names.append(one.name)
    assert len(names) >= 3, f"only {names} are in view"
    for name in names:
        yield from to(*place(object_named(name).matrix_world.translation))
        yield from click()
        yield 0.1
        active = bpy.context.view_layer.objects.active
        assert active == object_named(name) and active.select_get(), (
            f"a click on {name} selects {active.name if active else 'nothing'}"
        )
    yield from key("A")
    yield 0.1
    chosen = {one.unisim.kind for one in bpy.context.selected_objects}
    assert chosen and not chosen & set(SENSORS), f"Select All selects {chosen} through the camera"


def sensors_drawn(into: list[int]) -> Iterator[float]:
    """Note how many pixels of the view sensors and the vehicle's axes make; the camera that is looked through draws
    the recorded image."""
    through = bpy.context.scene.camera if view()[2].view_perspective == "CAMERA" else None
    sensors = [one for one in bpy.context.scene.objects if one.unisim.kind in SENSORS and one != through]
    shown: list[Image] = []
    hidden: list[Image] = []
    yield from settled(shown)
    for one in sensors:
        one.hide_set(True)
    yield 0.3
    yield from settled(hidden)
    for one in sensors:
        one.hide_set(False)
    yield 0.3
    left, bottom, _, height = region_rectangle("WINDOW")
    rectangle = left, bottom, region_rectangle("UI")[0] - left, height  # the sidebar says meanwhile that edits are read
    into[:] = [int((apart(part(shown[0], rectangle), part(hidden[0], rectangle)) > 2).sum())]


def hidden_sensors() -> Iterator[float]:
    """Sensors are not drawn through the camera, but from outside until Drive > Show > Sensors is clicked."""
    yield from fresh()
    pixels: list[int] = []
    yield from sensors_drawn(pixels)
    assert pixels == [0], f"{pixels[0]} pixels are sensors, through the camera"
    from_behind(view()[2])
    yield from sensors_drawn(pixels)
    assert pixels[0] > 50, "from outside no sensor is drawn"
    yield from open_panel("Show", "show_sensors")
    yield from press("show_sensors")
    yield from to(*middle(area("VIEW_3D")))
    yield from sensors_drawn(pixels)
    assert pixels == [0], f"{pixels[0]} pixels are sensors after they were hidden"
    ego = next(one for one in bpy.context.scene.objects if one.unisim.kind == "EGO")
    yield from to(*place(ego.matrix_world.translation))
    yield from click()
    active = bpy.context.view_layer.objects.active
    assert active is None or active.unisim.kind not in SENSORS, "a hidden sensor is selected"


def rendered_view() -> Iterator[float]:
    """Z 8, Rendered shading, shows the render and nothing else, with overlays and without them, in two sizes."""
    yield from fresh()
    yield from key("Z")
    yield 0.4
    yield from key("NUMPAD_8")
    yield from until(lambda: view()[1].shading.type == "RENDERED", "Z 8 does not change the shading", 5)
    yield from through_camera()
    yield from as_rendered("rendered_view")
    bare_view(view()[1], False)
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z", alt=True, shift=True)  # overlays off
    view()[1].show_gizmo = False
    yield from as_rendered("rendered_without_overlays")
    yield from key("Z", alt=True, shift=True)
    yield from key("N")  # the sidebar's place is the view's
    yield from through_camera(width=960)
    yield from as_rendered("rendered_large")


def removed_car() -> Iterator[float]:
    """X on a car that drives, in Rendered shading."""
    yield from fresh()
    yield from through_camera()
    yield from until(lambda: viewport_image() is not None, "no image comes")
    before = viewport_image()
    bare_view(view()[1], False)
    yield 0.3
    car = seen(driving=True)
    uid = object_named(car).unisim.uid
    yield from click_car(driving=True)
    yield from keys("X", "RET")
    yield from until(lambda: edits() == [("Remove", uid)], "X does not remove it", 10)
    yield from through_camera()
    yield from until(lambda: changed(before), "the image does not follow", 30)
    yield from as_rendered("removed_car")


def moved_car() -> Iterator[float]:
    """G X 2 on a car that stands."""
    yield from fresh()
    yield from through_camera(rendered=False)
    car = seen(driving=False)
    assert not drives(object_named(car))
    yield from click_car(driving=False)
    yield from keys("G", "X", "2", "RET")
    yield from until(lambda: edits() == [("Move", object_named(car).unisim.uid)], "not moved", 10)
    yield from through_camera()
    yield from as_rendered("moved_car")


def shifted_ego() -> Iterator[float]:
    """Ego > Shift Ego Lane, and 2 m in the redo panel."""
    yield from fresh()
    yield from through_camera()
    yield from until(lambda: viewport_image() is not None, "no image comes")
    before = viewport_image()
    yield from open_panel("Ego", "unisim.shift_ego")
    yield from press("unisim.shift_ego")
    yield from to(600, 500)
    yield from redo_panel("1", "2")
    yield from until(lambda: changed(before), "the view does not follow", 60)
    assert edits() == [("Ego", "")], f"the scenario has {edits()}"
    ego = next(one for one in bpy.context.scene.objects if one.unisim.kind == "EGO")
    assert abs(ego.location.y - 2) < 1e-3, f"it is shifted by {ego.location.y:.2f} m"
    yield from as_rendered("shifted_ego")


def steps() -> Iterator[float]:
    """The session."""
    yield from install()
    yield from task("first_import", first_import)
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    yield 1.0
    yield from imported(installed=True)
    for name, todo in (
        ("clicked_cars", clicked_cars),
        ("hidden_sensors", hidden_sensors),
        ("rendered_view", rendered_view),
        ("removed_car", removed_car),
        ("moved_car", moved_car),
        ("shifted_ego", shifted_ego),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "person")
