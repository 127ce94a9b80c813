"""Motion changed with the mouse: gizmos, pie menu, Shift Actor, and the speed graph. Run by `run.py`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Vector
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parent))
import hands
from buttons import open_panel, redo_panel
from hands import click, drag, edits, import_dropped, key, look_at, middle, object_named, place, scenario, sidebar, to
from heart import uncounted
from session import ARCHIVE, MODULE, OUT, area, choose, from_behind, inside, results, screenshot, start, until, view
from tasks import begin, task

ARROW_PX = 75
"""How long Blender draws an arrow of length 1."""
SHIFT_M = 0.1
"""How far a shifted trajectory may be from where it is worked out to be: keys stand a frame apart."""


def module(name: str) -> Any:
    """A module of the extension."""
    return sys.modules[f"{MODULE}.{name}"]


def object_of(kind: str) -> bpy.types.Object:
    """The first object of a kind."""
    return next(o for o in bpy.context.scene.objects if o.unisim.kind == kind)


def driving() -> str:
    """The name of the driving car that is nearest to the vehicle and present throughout."""
    ego = object_of("EGO").matrix_world.translation
    cars = [o for o in bpy.context.scene.objects if o.unisim.kind == "ACTOR" and o.parent and "Car" in o.name]
    return min((o for o in cars if not o.hide_viewport), key=lambda o: (o.matrix_world.translation - ego).length).name


@uncounted
def screen() -> NDArray[np.float32]:
    """What the window shows, (H, W, 3) from 0 to 1, bottom row first."""
    screenshot("pixels")
    image = bpy.data.images.load(str(OUT / "pixels.png"), check_existing=False)
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.array(image.pixels[:], np.float32).reshape(height, width, -1)[..., :3]
    bpy.data.images.remove(image)
    return pixels


def ray_at(x: float, y: float) -> tuple[Any, Any]:
    """The ray under a place of the window: origin and direction."""
    from bpy_extras.view3d_utils import region_2d_to_origin_3d, region_2d_to_vector_3d

    found, _, looks = view()
    region = next(r for r in found.regions if r.type == "WINDOW")
    at = x - region.x, y - region.y
    return np.array(region_2d_to_origin_3d(region, looks, at)), np.array(region_2d_to_vector_3d(region, looks, at))


def first_import() -> Iterator[float]:
    """The sample, seen from behind and above."""
    yield from import_dropped()
    yield 0.5
    assert view()[2].view_perspective == "CAMERA"
    screenshot("through_camera")
    from_behind(view()[2])
    yield 0.3


def free_shortcut() -> Iterator[float]:
    """Blender's default keymap has nothing else at the pie's key, wherever the key would go in Object
    Mode in the 3D view."""
    names = (
        "3D View",
        "3D View Generic",
        "Object Mode",
        "Object Non-modal",
        "Screen",
        "Screen Editing",
        "Window",
        "Frames",
        "Animation",
    )
    taken, seen = [], 0
    for keys in bpy.context.window_manager.keyconfigs.default.keymaps:
        for item in keys.keymap_items:
            if keys.name in names or keys.name.startswith("3D View Tool: Object"):
                seen += 1
                if item.type == "E" and item.ctrl and item.alt and not item.shift and not item.oskey:
                    taken.append(f"{keys.name}: {item.idname}")
    results["shortcut_taken"], results["shortcuts_seen"] = taken, seen
    assert not taken and seen > 100
    yield 0.0


def dragged_lane() -> Iterator[float]:
    """The ego vehicle's arrow, dragged to the left; one Ctrl-Z."""
    ego = object_of("EGO")
    looks = view()[2]
    looks.view_location, looks.view_distance = ego.matrix_world.translation, 18.0
    looks.update()
    yield 0.5
    origin = ego.matrix_world.translation.copy()
    left = ego.matrix_world.to_3x3().col[1].normalized()
    a, b = (np.array(place(origin + share * left)) for share in (0.0, 1.0))
    towards = (b - a) / np.linalg.norm(b - a)
    x, y = a + 0.85 * ARROW_PX * towards
    yield from to(x, y)
    yield 1.2
    screenshot("lane_hover")
    end = np.array([x, y]) + 120 * towards
    yield from drag(x, y, end[0], end[1], shot="lane_dragging")
    (edit,) = scenario().edits
    dragging = module("editing.motion.keys")
    first, last = (
        dragging.along_axis(*ray_at(*np.round(at)), np.array(origin), np.array(left)) for at in ((x, y), end)
    )
    results["lane_by_mouse_m"], results["lane_in_scenario_m"] = float(last - first), edit.shift_left_m
    assert type(edit).__name__ == "Ego" and abs(edit.shift_left_m - (last - first)) < 0.03, (
        edit.shift_left_m,
        last - first,
    )
    yield from key("Z", ctrl=True)
    yield from until(lambda: not edits(), "one Ctrl-Z does not undo the lane", 5)
    yield from key("Z", ctrl=True, shift=True)
    yield from until(lambda: edits() == [("Ego", "")], "not done again", 5)
    yield from key("Z", ctrl=True)
    yield from until(lambda: not edits(), "not undone", 5)
    yield from drag(x, y, end[0], end[1], let_go=False)
    yield from key("ESC")
    hands.event("LEFTMOUSE", "RELEASE")
    yield 0.2
    assert not edits(), "Esc does not put the vehicle back"


def dragged_handle() -> Iterator[float]:
    """A handle on a driving car's trajectory, dragged in the ground plane; one Ctrl-Z."""
    car = driving()
    yield from look_at(car, 22.0)
    yield from click()
    yield from until(
        lambda: bpy.context.view_layer.objects.active == object_named(car) and object_named(car).select_get(),
        "not selected",
        5,
    )
    yield 0.5
    screenshot("handles")
    clock = module("editing.sampled.clock").Clock.of(
        module("bridge.objects.imported").source_of(bpy.context.scene).drive
    )
    handles = module("bridge.changes.handles").handles_of(object_named(car), clock)
    handle = min(handles, key=lambda one: abs(one.time_s - 1.0))
    x, y = place(Vector(handle.place))
    yield from to(x, y)
    yield 1.2
    screenshot("handle_hover")
    yield from drag(x, y, x - 60, y + 25, shot="handle_dragging")
    assert edits() == [("Move", object_named(car).unisim.uid)], edits()
    up = np.array([0.0, 0.0, 1.0])
    dragging = module("editing.motion.keys")
    first, last = (dragging.on_plane(*ray_at(*np.round(at)), handle.place, up) for at in ((x, y), (x - 60, y + 25)))
    apply, source = (
        module("core.scenario").apply_scenario,
        module("bridge.objects.imported").source_of(bpy.context.scene),
    )
    now = apply(scenario(), source.drive, module("editing.sampled.source").scene_actors).actors[
        object_named(car).unisim.uid
    ]
    before = source.drive.actors[object_named(car).unisim.uid]
    moved = (now.world_from_actor.at(handle.time_s) - before.world_from_actor.at(handle.time_s))[:3, 3]
    results["handle_by_mouse_m"], results["handle_in_scenario_m"] = (last - first).tolist(), moved.tolist()
    assert np.abs(moved - (last - first)).max() < 0.05, (moved, last - first)
    yield 0.3
    screenshot("handle_dragged")
    yield from key("Z", ctrl=True)
    yield from until(lambda: not edits(), "one Ctrl-Z does not undo the handle", 5)
    assert object_named(car).animation_data is None or not [
        c for c in module("bridge.objects.animation").curves_of(object_named(car)) if c.data_path == "location"
    ]


def clicked_through() -> Iterator[float]:
    """A click on a handle, without a drag: on the car it selects the car, beside it nothing changes."""
    car = driving()
    choose(object_named(car))
    bpy.context.scene.frame_set(10)
    with inside(area("VIEW_3D")):
        assert bpy.ops.unisim.drag_trajectory("EXEC_DEFAULT", True, time_s=1.0, offset_m=(0.0, 0.5, 0.0)) == {
            "FINISHED"
        }
    before = scenario()
    yield from look_at(car, 40.0)
    yield 0.5
    screenshot("key_handle")
    yield from click()
    yield 0.5
    assert (
        bpy.context.view_layer.objects.active == object_named(car)
        and object_named(car).select_get()
        and scenario() == before
    )
    clock = module("editing.sampled.clock").Clock.of(
        module("bridge.objects.imported").source_of(bpy.context.scene).drive
    )
    free = next(h for h in module("bridge.changes.handles").handles_of(object_named(car), clock) if not h.is_key)
    yield from to(*place(Vector(free.place)))
    yield 0.3
    yield from click()
    yield 0.5
    assert object_named(car).select_get() and scenario() == before, "a click on a free handle changes something"
    yield from key("Z", ctrl=True)
    yield from until(lambda: not edits(), "not undone", 5)
    bpy.context.scene.frame_set(0)


def aimed(kind: str) -> Iterator[float]:
    """The handle ahead of a sensor, dragged to the left; one Ctrl-Z."""
    sensor = object_of(kind).name
    choose(object_named(sensor))
    looks = view()[2]
    from_behind(looks)
    looks.view_location, looks.view_distance = object_named(sensor).matrix_world.translation, 16.0
    looks.update()
    yield 0.6
    drag_of, aiming = module("features.motion.drag"), module("bridge.objects.sensors")
    before = np.degrees(aiming.direction_of(object_named(sensor)))
    x, y = place(Vector(drag_of.target_of(object_named(sensor))))
    yield from to(x, y)
    yield 1.2
    screenshot(f"aim_hover_{kind}")
    yield from drag(x, y, x - 90, y, shot=f"aim_dragging_{kind}")
    after = np.degrees(aiming.direction_of(object_named(sensor)))
    sensors = scenario().sensors
    (spec,) = sensors.cameras if kind == "CAMERA" else sensors.lidars
    w, _, _, z = spec.mount_offset.quaternion_wxyz
    results[f"aim_{kind}_deg"] = [*before.tolist(), *after.tolist(), float(np.degrees(2 * np.arctan2(z, w)))]
    assert after[0] - before[0] > 5, (before, after)
    yield from key("Z", ctrl=True)
    yield from until(lambda: scenario().sensors is None, "one Ctrl-Z does not undo the direction", 5)


def pie(shot: str) -> Iterator[float]:
    """Open the pie menu and keep its key pressed."""
    hands.event("E", "PRESS", ctrl=True, alt=True)
    yield 0.3
    x, y = hands.mouse
    for aside in (1, 2, 1, 0):  # the menu unfolds while it is drawn
        yield from to(x + aside, y)
        yield 0.2
    screenshot(shot)


def chosen_in_pie() -> Iterator[float]:
    """Ctrl-Alt-E held on a car, the mouse moved to the left, and the key let go; the pies of the ego vehicle and of a
    camera, with 8 for what is above and 2 for what is below; one Ctrl-Z for each."""
    car = driving()
    yield from look_at(car)
    yield from click()
    yield from until(lambda: object_named(car).select_get(), "not selected", 5)
    count = len(bpy.data.objects)
    yield from pie("pie")
    x, y = hands.mouse
    for away in (40, 80, 130):
        yield from to(x - away, y)
        yield 0.1
    screenshot("pie_left")
    hands.event("E", "RELEASE")
    yield from until(lambda: ("Duplicate", object_named(car).unisim.uid) in edits(), "the pie does not copy", 5)
    yield 0.3
    yield from key("Z", ctrl=True)
    yield from until(lambda: not edits() and len(bpy.data.objects) == count, "one Ctrl-Z does not undo the copy", 5)
    for kind, digit, does in (("EGO", "NUMPAD_8", shifts_lane), ("CAMERA", "NUMPAD_2", adds_camera)):
        choose(object_of(kind))
        bpy.ops.ed.undo_push(message=f"The {kind}")
        yield from to(*middle(area("VIEW_3D")))
        yield from pie(f"pie_{kind}")
        yield from key(digit)
        hands.event("E", "RELEASE")
        yield from until(does, f"{digit} in the pie of the {kind} does not do what stands there", 5)
        yield 0.3
        yield from key("Z", ctrl=True)
        yield from until(lambda: not edits() and scenario().sensors is None, "one Ctrl-Z does not undo it", 5)
        assert len(bpy.data.objects) == count


def shifts_lane() -> bool:
    """Whether the ego vehicle's lane is shifted by the metre that the operator begins with, and nothing else."""
    changed = scenario().edits
    return [type(edit).__name__ for edit in changed] == ["Ego"] and abs(changed[0].shift_left_m - 1.0) < 1e-3


def adds_camera() -> bool:
    """Whether the scenario renders one more camera than the log has."""
    sensors, log = scenario().sensors, module("bridge.objects.imported").source_of(bpy.context.scene).drive.cameras
    return sensors is not None and len(sensors.cameras or ()) == len(log) + 1 and not edits()


def closed_panel() -> Iterator[float]:
    """Close the panel that F9 opened, with the mouse over it: Esc keeps what the operator did."""
    x, y = hands.mouse
    yield from to(x + 60, y - 40)
    yield 0.3
    yield from key("ESC")
    yield 0.5
    yield from to(x, y)
    yield 0.3


def shifted_actor() -> Iterator[float]:
    """F3, Shift Actor; in its panel Along Path 3 m and Later 0.5 s are typed; one Ctrl-Z."""
    car = driving()
    yield from look_at(car)
    yield from click()
    yield from until(lambda: object_named(car).select_get(), "not selected", 5)
    yield from key("F3")
    yield 0.5
    yield from hands.write("shift actor")
    yield 0.5
    screenshot("search_shift")
    yield from key("RET")
    yield from until(
        lambda: edits() == [("Move", object_named(car).unisim.uid)], "the search does not find Shift Actor", 5
    )
    yield 0.5
    yield from key("F9")
    yield 0.7
    screenshot("shift_panel")
    yield from closed_panel()
    assert edits(), "closing the panel undoes it"
    assert shift_apart(car, 0.0, 0.0) < SHIFT_M
    x, y = hands.mouse
    for new, left in (("3", "0"), ("0.5", "0")):  # Along Path is the upper one of those that show 0
        yield from to(x, y)
        yield from redo_panel(left, new)
    yield from to(x, y)
    yield 0.5
    screenshot("shifted_along_and_later")
    results["shift_apart_m"], others = shift_apart(car, 3.0, 0.5), [shift_apart(car, *to) for to in ((3, 0), (0, 0.5))]
    assert results["shift_apart_m"] < SHIFT_M < min(others), (results["shift_apart_m"], others)  # type: ignore[operator]
    yield from key("Z", ctrl=True)
    yield from until(lambda: not edits(), "one Ctrl-Z does not undo the shift", 5)


@uncounted
def shift_apart(car: str, ahead_m: float, later_s: float) -> float:
    """How far the exported trajectory of a car is at most from its recorded one, 1 m further left, ``ahead_m`` along its
    path and ``later_s`` later, in metres, while the recorded one has such places and the car is there."""
    source, uid = module("bridge.objects.imported").source_of(bpy.context.scene), object_named(car).unisim.uid
    moved = module("core.scenario").apply_scenario(
        scenario(), source.drive, module("editing.sampled.source").scene_actors
    )
    before, after = source.drive.actors[uid].world_from_actor, moved.actors[uid].world_from_actor
    first, last = float(before.times_s[0]), float(before.times_s[-1])
    times = np.linspace(first, last, 2000)
    poses = np.array([before.at(time_s) for time_s in times])
    steps_m = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    along_m = np.concatenate([[0.0], np.cumsum(steps_m)])
    assert along_m[-1] > 5, "the car hardly drives"
    furthest, compared = 0.0, 0
    for time_s in np.arange(first + later_s, last, 0.1):
        wanted_m = np.interp(time_s - later_s, times, along_m) + ahead_m
        if wanted_m > along_m[-1]:
            break
        pose = poses[np.searchsorted(along_m, wanted_m)]
        wanted = pose[:3, 3] + pose[:3, 1]
        furthest, compared = max(furthest, float(np.linalg.norm(after.at(time_s)[:3, 3] - wanted))), compared + 1
    assert compared >= 5, "the car is hardly there"
    return furthest


def followed_curve() -> Iterator[float]:
    """Follow Curve and Retime Actor say seconds and frames in their panels."""
    car = driving()
    curve = bpy.data.curves.new("way", "CURVE")
    curve.dimensions = "3D"
    spline = curve.splines.new("POLY")
    spline.points.add(2)
    at = object_named(car).matrix_world.translation
    for point, (x, y) in zip(spline.points, ((0, 0), (10, 0), (20, 4)), strict=True):
        point.co = (at.x + x, at.y + y, 0, 1)
    line = bpy.data.objects.new("way", curve)
    bpy.context.scene.collection.objects.link(line)
    choose(line)
    object_named(car).select_set(True)
    bpy.context.view_layer.objects.active = object_named(car)
    bpy.ops.ed.undo_push(message="A curve")
    yield from to(*middle(area("VIEW_3D")))
    with inside(area("VIEW_3D")):
        assert bpy.ops.unisim.follow_curve("INVOKE_DEFAULT", True, speed_m_s=8.0) == {"FINISHED"}
    yield 0.3
    yield from key("F9")
    yield 0.7
    screenshot("follow_panel")
    yield from closed_panel()
    assert edits(), "closing the panel undoes it"
    yield from key("Z", ctrl=True)
    yield from until(lambda: not edits(), "one Ctrl-Z does not undo Follow Curve", 5)
    bpy.data.objects.remove(bpy.data.objects["way"])


def graph() -> Iterator[float]:
    """The speed graph of a car that is retimed and swerves: grey, blue, red, and a line at the frame that is shown."""
    car = driving()
    bpy.context.scene.unisim_motion.show_graph = True
    yield from look_at(car)
    yield from click()
    yield from until(lambda: object_named(car).select_get(), "not selected", 5)
    yield 0.5
    screenshot("graph_recorded")
    plain = colours_in_graph()
    assert plain["blue"] == 0 and plain["red"] == 0 and plain["grey"] > 100, plain
    yield from key("T", ctrl=True, alt=True)
    yield from until(lambda: edits(), "not retimed", 5)
    with inside(area("VIEW_3D")):
        assert bpy.ops.unisim.drag_trajectory("EXEC_DEFAULT", True, time_s=1.0, offset_m=(0.0, 4.0, 0.0)) == {
            "FINISHED"
        }
    bpy.context.scene.frame_set(8)
    yield 0.5
    screenshot("graph_edited")
    marked = colours_in_graph()
    results["graph_pixels"] = marked
    assert marked["blue"] + marked["red"] > 100 and marked["red"] > 50, marked
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.check()
    found = [w.text for w in bpy.context.scene.unisim_check.warnings if w.name == car]
    assert any("m/s²" in text for text in found), found
    yield from sidebar()
    yield 0.5
    screenshot("graph_beside_sidebar")
    yield from open_panel("Motion", "show_graph")
    screenshot("motion_panel")
    bpy.context.scene.unisim_motion.show_graph = False


def colours_in_graph() -> dict[str, int]:
    """How many pixels of the graph's corner have each of its colours."""
    found, _, _ = view()
    region = next(r for r in found.regions if r.type == "WINDOW")
    side = next(r for r in found.regions if r.type == "UI")
    right = side.x if side.width > 1 else region.x + region.width
    corner = screen()[region.y : region.y + 240, right - 430 : right]
    red, green, blue = corner[..., 0], corner[..., 1], corner[..., 2]
    return {
        "red": int(((red > 0.8) & (green < 0.3) & (blue < 0.3)).sum()),
        "blue": int(((red < 0.4) & (green < 0.7) & (blue > 0.85)).sum()),
        "grey": int((np.abs(corner - 0.62).max(-1) < 0.04).sum()),
    }


def no_gizmos_in_camera() -> Iterator[float]:
    """Through the recorded camera there is nothing of them; the popover Gizmos has the switches."""
    car = driving()
    choose(object_named(car))
    bpy.context.scene.frame_set(3)
    view()[2].view_perspective = "CAMERA"
    yield 0.6
    screenshot("camera_without_gizmos")
    bpy.context.scene.unisim_motion.gizmos_in_cameras = True
    yield 0.6
    screenshot("camera_with_gizmos")
    bpy.context.scene.unisim_motion.gizmos_in_cameras = False
    from_behind(view()[2])
    yield 0.3
    with inside(area("VIEW_3D")):
        bpy.ops.wm.call_panel(name="VIEW3D_PT_gizmo_display")
    yield 0.7
    screenshot("popover")
    yield from key("ESC")
    view()[1].show_gizmo = False
    yield 0.5
    screenshot("no_gizmos")
    view()[1].show_gizmo = True


def steps() -> Iterator[float]:
    """The session."""
    bpy.ops.extensions.package_install_files(
        filepath=str(ARCHIVE), repo="user_default", enable_on_install=True, overwrite=True
    )
    yield 1.0
    begin()
    for name, todo in (
        ("motion_import", first_import),
        ("free_shortcut", free_shortcut),
        ("dragged_lane", dragged_lane),
        ("dragged_handle", dragged_handle),
        ("clicked_through", clicked_through),
        ("aimed_camera", lambda: aimed("CAMERA")),
        ("aimed_lidar", lambda: aimed("LIDAR")),
        ("chosen_in_pie", chosen_in_pie),
        ("shifted_actor", shifted_actor),
        ("followed_curve", followed_curve),
        ("graph", graph),
        ("no_gizmos_in_camera", no_gizmos_in_camera),
    ):
        yield from task(name, todo)
        if edits():  # of a task that failed: the others are independent of it
            hands.event("LEFTMOUSE", "RELEASE")
            yield from key("ESC")
            for _ in range(4):
                yield from key("Z", ctrl=True)
                yield 0.3


if __name__ == "__main__":
    start(steps(), "motion")
