"""A person puts rigs on the vehicle, looks through their cameras, saves one, and gives the vehicle a body.
Run by `run.py`."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
from mathutils import Euler, Vector

sys.path.insert(0, str(Path(__file__).parent))
from buttons import found_at, open_panel, place_of
from hands import click, drop, edits, import_dropped, key, middle, object_named, scenario, sidebar, to
from session import (
    ARCHIVE,
    MODULE,
    OUT,
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
from tasks import begin, changed, task

OWN = "ours"
RENDERED = 0.8, 0.735
"""Where in its row of the list the button is that says whether a sensor is rendered, as a share of the sidebar's width:
without and with a scroll bar beside it."""


def sensors() -> list[str]:
    """Names of the sensors that the scenario renders; [] for those of the log."""
    found = scenario().sensors
    return [] if found is None else [spec.id for spec in (*(found.cameras or ()), *(found.lidars or ()))]


def presets() -> list[str]:
    """Names of one's own presets."""
    return [path.stem for path in sys.modules[f"{MODULE}.bridge.importing.rig_presets"].own_presets()]


def region_of(kind: str) -> bpy.types.Region:
    """A region of the 3D view."""
    return next(region for region in view()[0].regions if region.type == kind)


def imported() -> Iterator[float]:
    """The sample's trained scene, dropped."""
    yield from import_dropped()
    yield 0.5


def panel() -> Iterator[float]:
    """The sidebar's panel Sensors, opened."""
    yield from sidebar()
    yield from open_panel("Sensors", "unisim.show_sensor(", RENDERED[0])
    choose(object_named("front_camera"))
    yield 0.5


def menu_entry(number: int) -> Iterator[float]:
    """Open the menu of presets where the mouse is, and choose an entry by keys."""
    with inside(area("VIEW_3D")):
        bpy.ops.wm.call_menu(name="UNISIM_MT_rig_presets")
    yield 0.5
    screenshot("rigs_menu")
    for _ in range(number):
        yield from key("DOWN_ARROW")
        yield 0.1
    yield from key("RET")


def applied_rig() -> Iterator[float]:
    """A built-in preset from the menu, by keys; the sensors are in the scenario and in the list."""
    yield from to(*middle(area("VIEW_3D")))
    yield from menu_entry(1)  # the mouse is on the first
    yield from until(lambda: "CAM_FRONT" in bpy.data.objects, "the preset is not applied")
    assert bpy.context.scene.camera.name == "CAM_FRONT" and bpy.context.scene.render.resolution_x == 1600
    yield 0.5


def undone_rig() -> Iterator[float]:
    """One Ctrl-Z takes all of it back, Ctrl-Shift-Z brings it again."""
    yield from key("Z", ctrl=True)
    yield from until(lambda: "CAM_FRONT" not in bpy.data.objects, "one undo does not take the rig back")
    assert bpy.context.scene.camera.name == "front_camera" and not object_named("front_camera").hide_viewport
    yield 0.3
    yield from key("Z", ctrl=True, shift=True)
    yield from until(lambda: "CAM_FRONT" in bpy.data.objects, "the rig is not brought again")


def looked_through() -> Iterator[float]:
    """The camera's button in the list: the view is that of another camera of the rig, rendered."""
    space, looks = view()[1:]
    looks.view_perspective = "PERSP"
    yield 0.3
    space.shading.type = "RENDERED"
    with inside(area("VIEW_3D")):
        assert bpy.ops.unisim.look_through("INVOKE_DEFAULT", name="CAM_FRONT_LEFT") == {"FINISHED"}
    yield from wait_for_image()
    assert view()[2].view_perspective == "CAMERA" and bpy.context.scene.camera.name == "CAM_FRONT_LEFT"
    yield 0.5


def clicked_row() -> Iterator[float]:
    """A click on a row of the list selects that sensor."""
    choose(object_named("CAM_BACK"))
    yield 0.3
    wanted = "CAM_BACK_RIGHT"
    yield from place_of(f'unisim.show_sensor(name="{wanted}")', columns=RENDERED)
    for aside in (88, 90, 92):  # in Blender 5.2, a row hears of the mouse once it moves within it
        yield from to(region_of("UI").x + aside - 1, found_at[0][1])
        yield 0.1
        yield from to(region_of("UI").x + aside, found_at[0][1])
        yield 0.2
        yield from click()
        last_s = time.monotonic() + 3.0
        while time.monotonic() < last_s and bpy.context.view_layer.objects.active != object_named(wanted):
            yield 0.05
    assert bpy.context.view_layer.objects.active == object_named(wanted), "a click on its row does not select it"
    selected = list(bpy.context.view_layer.objects.selected)
    assert selected == [object_named(wanted)], f"selected are {selected}"


def saved_rig() -> Iterator[float]:
    """The dialog, with a name in it: Enter saves, and the menu has it."""
    yield from to(*middle(area("VIEW_3D")))
    before = presets()
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.save_rig("INVOKE_DEFAULT", name=OWN)
    yield 0.5
    screenshot("rigs_dialog")
    yield from key("RET")
    yield from until(lambda: presets() != before, "nothing is saved", 10)
    assert presets() == [*before, OWN], presets()
    yield 0.3
    with inside(area("VIEW_3D")):
        bpy.ops.wm.call_menu(name="UNISIM_MT_rig_presets")
    yield 0.5
    screenshot("rigs_own_in_menu")
    yield from key("ESC")
    yield 0.2


def restored() -> Iterator[float]:
    """Recorded sensors come back, beside the rig's."""
    with inside(area("VIEW_3D")):
        assert bpy.ops.unisim.restore_sensors("INVOKE_DEFAULT") == {"FINISHED"}
    yield from until(lambda: not object_named("front_camera").hide_render, "the recorded camera is not restored")


def dropped_rig() -> Iterator[float]:
    """A preset's file that a colleague gave away, dropped onto the view: its sensors stand on the vehicle instead of
    those there; one Ctrl-Z."""
    (saved,) = [
        path for path in sys.modules[f"{MODULE}.bridge.importing.rig_presets"].own_presets() if path.stem == OWN
    ]
    given = json.loads(saved.read_text())
    given["cameras"] = [{**one, "id": f"GIVEN_{one['id']}"} for one in given["cameras"][:2]]
    path = OUT.parent / "given.json"
    path.write_text(json.dumps(given))
    before, kept = sensors(), presets()
    bpy.ops.ed.undo_push(message="Restored")  # which operators that a script calls leave out
    yield from to(*middle(area("VIEW_3D")))
    drop(path, undo=True)
    yield from until(lambda: any(name.startswith("GIVEN_") for name in bpy.data.objects.keys()), "no sensor comes", 10)
    yield 0.5
    screenshot("rig_given")
    wanted = sorted(one["id"] for one in (*given["cameras"], *given["lidars"]))
    assert sorted(sensors()) == wanted, (sensors(), wanted)
    assert presets() == kept, "a dropped file counts as one's own preset"
    yield from key("Z", ctrl=True)
    yield from until(lambda: sensors() == before, "one Ctrl-Z does not take the rig back", 10)


def moved_sensor() -> Iterator[float]:
    """A recorded camera is moved up by hand: where it was recorded is drawn in grey."""
    view()[1].shading.type = "SOLID"
    looks = view()[2]
    looks.view_perspective = "PERSP"
    from_behind(looks)
    looks.view_location, looks.view_distance = object_named("front_camera").matrix_world.translation, 5.0
    looks.update()
    choose(object_named("front_camera"))
    yield 0.3
    yield from to(*middle(area("VIEW_3D")))
    for press in (("G",), ("Z",), ("ONE", "1"), ("RET",)):
        yield from key(*press)
    yield 0.6
    card = sys.modules[f"{MODULE}.bridge.views.sensor_facts"].card_of_sensor
    drive = sys.modules[f"{MODULE}.bridge.objects.imported"].source_of(bpy.context.scene).drive
    assert card(bpy.context.scene, object_named("front_camera"), drive).state == "recorded, moved"


def ego_body() -> Iterator[float]:
    """A box is added, used as the ego's body, and seen from behind, rendered."""
    space, looks = view()[1:]
    ego = next(o for o in bpy.context.scene.objects if o.unisim.kind == "EGO")
    with inside(area("VIEW_3D")):
        bpy.ops.mesh.primitive_cube_add(
            size=1.0, location=ego.matrix_world.translation + Vector((0, 12, 3)), scale=(4.4, 1.9, 1.5)
        )
    box = bpy.context.view_layer.objects.active
    box.name = "own car"
    paint = bpy.data.materials.new("paint")
    paint.use_nodes = True
    paint.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.7, 0.05, 0.05, 1.0)
    box.data.materials.append(paint)
    bpy.ops.ed.undo_push(message="A box")
    yield 0.2
    with inside(area("VIEW_3D")):
        assert bpy.ops.unisim.ego_body("INVOKE_DEFAULT") == {"FINISHED"}
    assert ("EgoBody", "") in edits()
    # in the middle of the drive, from within what it recorded: elsewhere fog hides the vehicle
    bpy.context.scene.frame_set(14)
    looks.view_perspective = "PERSP"
    looks.view_location, looks.view_distance = ego.matrix_world.translation + Vector((2.0, 0, 1.2)), 9.0
    looks.view_rotation = Euler((np.radians(80), 0.0, np.radians(-75))).to_quaternion()
    looks.update()
    yield 0.5
    screenshot("rigs_body_solid")
    space.shading.type = "RENDERED"
    yield from wait_for_image()
    results["red_from_behind"] = red()
    assert red() > 0.005, "the body is not seen from behind"


def red() -> float:
    """Which share of the viewport's image is as red as the body."""
    linear = viewport_image()
    assert linear is not None
    return float(((linear[..., 0] > 3 * linear[..., 1]) & (linear[..., 0] > 0.02)).mean())


def unseen_from_the_front_camera() -> Iterator[float]:
    """Through a camera of the vehicle the body is neither rendered nor drawn; released, the image is the same."""
    space = view()[1]
    with inside(area("VIEW_3D")):
        assert bpy.ops.unisim.look_through("INVOKE_DEFAULT", name="front_camera") == {"FINISHED"}
    object_named("front_camera").location.z -= 1.0
    yield 1.0
    yield from wait_for_image()
    assert red() < 0.03, red()  # cones
    assert object_named("own car").hide_get(), "Blender draws the body before the camera"
    with_body = viewport_image()
    screenshot("rigs_front_rendered")
    # it is hidden for views alone: the scenario has it, in its shape, wherever the vehicle is
    before = next(edit for edit in scenario().edits if type(edit).__name__ == "EgoBody")
    results["mount_hidden"] = list(before.mount.position)
    assert np.allclose(before.mount.position, [1.2, 0.0, 0.75], atol=1e-3), before.mount
    space.shading.type = "SOLID"
    yield 0.5
    screenshot("rigs_front_solid")
    space.shading.type = "RENDERED"
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.release_ego_body("INVOKE_DEFAULT")
    yield 1.0
    yield from wait_for_image()
    assert not changed(with_body) and viewport_image() is not None
    assert np.array_equal(np.asarray(viewport_image()), np.asarray(with_body)), (
        "the image is another one without the body"
    )
    choose(object_named("own car"))
    with inside(area("VIEW_3D")):
        assert bpy.ops.unisim.ego_body("INVOKE_DEFAULT", place="HERE", forward="X") == {"FINISHED"}
    yield 0.5


def from_the_roadside() -> Iterator[float]:
    """A camera of the rig, taken off the vehicle with Alt-P, sees the body go by."""
    looks = view()[2]
    ego = next(o for o in bpy.context.scene.objects if o.unisim.kind == "EGO")
    camera = object_named("CAM_FRONT")
    camera.parent = None
    at = ego.matrix_world.translation
    camera.location = at + Vector((10, 3.0, 1.5))
    camera.rotation_mode = "XYZ"
    camera.rotation_euler = (np.pi / 2, 0.0, np.arctan2(3.0, 9.0) + np.pi / 2)
    bpy.ops.ed.undo_push(message="Roadside")
    yield 0.2
    looks.view_perspective = "PERSP"
    with inside(area("VIEW_3D")):
        assert bpy.ops.unisim.look_through("INVOKE_DEFAULT", name="CAM_FRONT") == {"FINISHED"}
    yield 1.0
    yield from wait_for_image()
    results["red_from_the_roadside"] = red()
    assert red() > 0.005 and not object_named("own car").hide_get()


def steps() -> Iterator[float]:
    """The session."""
    bpy.ops.extensions.package_install_files(
        filepath=str(ARCHIVE), repo="user_default", enable_on_install=True, overwrite=True
    )
    yield 1.0
    begin()
    nuscenes = [
        "CAM_BACK",
        "CAM_BACK_LEFT",
        "CAM_BACK_RIGHT",
        "CAM_FRONT",
        "CAM_FRONT_LEFT",
        "CAM_FRONT_RIGHT",
        "LIDAR_TOP",
    ]
    # what the scenario has is read between tasks: that steps through all frames, and is no person's waiting
    for name, todo, wanted in (
        ("rig_imported", imported, []),
        ("rig_panel", panel, []),
        ("rig_applied", applied_rig, nuscenes),
        ("rig_undone", undone_rig, nuscenes),
        ("rig_looked_through", looked_through, nuscenes),
        ("rig_clicked_row", clicked_row, nuscenes),
        ("rig_saved", saved_rig, nuscenes),
        ("rig_restored", restored, sorted([*nuscenes, "front_camera", "pandar64"])),
        ("rig_dropped", dropped_rig, sorted([*nuscenes, "front_camera", "pandar64"])),
    ):
        yield from task(name, todo)
        assert sorted(sensors()) == wanted, (name, sensors())
    for name, todo in (
        ("rig_moved_sensor", moved_sensor),
        ("rig_ego_body", ego_body),
        ("rig_front_camera", unseen_from_the_front_camera),
        ("rig_roadside", from_the_roadside),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "rigs")
