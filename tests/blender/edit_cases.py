"""One of each kind of edit, made as people make them, for the tests of the edits list, of muting and of variants."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy
import numpy as np
from helpers import SAMPLE, driving, imported, select

from unisim_blender.bridge.objects.imported import copy_of, imported_objects, mark_static, source_of
from unisim_blender.bridge.sampling.edit_list import read_now
from unisim_blender.editing.edits.lines import EditLine


def passing(scene: Any) -> Any:
    """An actor that is not there throughout."""
    return next(
        t
        for t in imported_objects(scene, "ACTOR")
        if t.animation_data is not None and t.animation_data.action is not None
    )


def standing(scene: Any) -> Any:
    """An actor that stands still."""
    drive = source_of(scene).drive
    return imported(scene, "ACTOR", next(u for u, a in sorted(drive.actors.items()) if not a.is_moving))


def update() -> None:
    """Let Blender evaluate what was changed."""
    bpy.context.view_layer.update()


def moved(scene: Any) -> None:
    driving(scene).location.y = 3.0


def moved_standing(scene: Any) -> None:
    standing(scene).location.x += 2.5


def turned(scene: Any) -> None:
    one = driving(scene)
    one.rotation_quaternion = (np.cos(np.radians(10)), 0.0, 0.0, np.sin(np.radians(10)))


def keyed(scene: Any) -> None:
    one = driving(scene)
    for frame, left in ((0, 0.0), (10, 1.5), (19, 0.5)):
        scene.frame_set(frame)
        one.location.y = left
        one.keyframe_insert("location", frame=frame)


def constrained(scene: Any) -> None:
    empty = bpy.data.objects.new("leader", None)
    scene.collection.objects.link(empty)
    empty.location = (0.0, 0.0, 1.0)
    constraint = standing(scene).constraints.new("COPY_LOCATION")
    constraint.target, constraint.use_x, constraint.use_y = empty, False, False


def retimed(scene: Any) -> None:
    select(driving(scene))
    bpy.ops.unisim.retime_actor(mode="DELAY", seconds=0.6)


def scaled(scene: Any) -> None:
    driving(scene).scale = (1.3, 1.3, 1.3)


def body(scene: Any) -> None:
    bpy.ops.mesh.primitive_cube_add(size=1.5)
    select(bpy.context.active_object)
    assert bpy.ops.unisim.ego_body() == {"FINISHED"}


def removed(scene: Any) -> None:
    select(driving(scene))
    bpy.ops.unisim.delete_actor()


def hidden(scene: Any) -> None:
    driving(scene).hide_render = True


def left_out(scene: Any) -> None:
    one, away = driving(scene), bpy.data.collections.new("away")
    scene.collection.children.link(away)
    for collection in list(one.users_collection):
        collection.objects.unlink(one)
    away.objects.link(one)
    away.hide_render = True


def copied(scene: Any) -> None:
    select(driving(scene))
    bpy.ops.unisim.duplicate_actor(where="LANE_LEFT")


def copied_in_place(scene: Any) -> None:
    copy_of(bpy.context, standing(scene))


def inserted(scene: Any) -> None:
    scene.cursor.location = (12.0, 6.0, 0.0)
    bpy.ops.unisim.insert_actor(filepath=str(SAMPLE / "scene" / "scene.json"), actor="car-13", where="CURSOR")


def mesh(scene: Any) -> None:
    bpy.ops.mesh.primitive_cube_add(size=1.5, location=(15.0, 4.0, 0.75))
    one = bpy.context.active_object
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(15.0, 4.0, 1.75))
    bpy.context.active_object.parent = one
    bpy.context.active_object.matrix_parent_inverse = one.matrix_world.inverted()
    update()
    select(one)
    bpy.ops.unisim.mesh_actor(label="Other")


def swapped(scene: Any) -> None:
    select(driving(scene))
    bpy.ops.unisim.replace_appearance(appearance="car-02")


def ego(scene: Any) -> None:
    bpy.ops.unisim.shift_ego(left_m=2.0)


def camera_moved(scene: Any) -> None:
    imported(scene, "CAMERA", "front_camera").location.z += 0.3


def camera_lens(scene: Any) -> None:
    imported(scene, "CAMERA", "front_camera").data.lens *= 0.8


def camera_removed(scene: Any) -> None:
    bpy.data.objects.remove(imported(scene, "CAMERA", "front_camera"))


def camera_added(scene: Any) -> None:
    bpy.ops.unisim.add_camera(width=320, height=180)


def lidar_beams(scene: Any) -> None:
    select(imported(scene, "LIDAR", "pandar64"))
    bpy.ops.unisim.set_beams(preset="vlp16")


def _item(scene: Any) -> Any:
    pose = np.eye(4)
    pose[:3, 3] = (9.0, 4.0, 0.6)
    return mark_static(scene, pose, np.array([0.8, 0.8, 1.2]), "bin")


def item_moved(scene: Any) -> None:
    _item(scene).location.x += 4.0


def item_keyed(scene: Any) -> None:
    one = _item(scene)
    one.location.x += 4.0
    one.keyframe_insert("location", frame=0)


def item_removed(scene: Any) -> None:
    bpy.data.objects.remove(_item(scene))


def item_copied(scene: Any) -> None:
    copy_of(bpy.context, _item(scene)).location.x += 4.0


CASES: dict[str, tuple[Callable[[Any], None], str, str]] = {
    "moved": (moved, "MOVE", "Moved 3.0 m left"),
    "moved standing": (moved_standing, "MOVE", "Moved"),
    "turned": (turned, "MOVE", "Turned 20° left"),
    "keyed": (keyed, "MOVE", "Moved by up to 1.5 m left"),
    "constrained": (constrained, "MOVE", "Moved"),
    "retimed": (retimed, "MOVE", "Retimed: 0.6 s later"),
    "removed": (removed, "REMOVE", "Removed"),
    "hidden": (hidden, "REMOVE", "Removed"),
    "left out": (left_out, "REMOVE", "Removed"),
    "copied": (copied, "COPY", "Copied: 3.5 m left"),
    "copied in place": (copied_in_place, "COPY", "Copied, in place"),
    "inserted": (inserted, "INSERT", "Inserted"),
    "mesh": (mesh, "MESH", "Mesh inserted"),
    "swapped": (swapped, "APPEARANCE", "Appearance of Medium-sized Truck 1"),
    "scaled": (scaled, "SCALE", "Scaled by 1.3"),
    "body": (body, "BODY", "Body of the ego vehicle"),
    "ego": (ego, "EGO", "Moved 2.0 m left"),
    "camera moved": (camera_moved, "SENSOR", "Camera: "),
    "camera lens": (camera_lens, "SENSOR", "Camera: another lens"),
    "camera removed": (camera_removed, "REMOVE", "Camera removed"),
    "camera added": (camera_added, "INSERT", "Camera added"),
    "lidar beams": (lidar_beams, "SENSOR", "LiDAR: other beams"),
    "item moved": (item_moved, "MOVE", "Moved 4.0 m away"),
    "item keyed": (item_keyed, "MOVE", "Moved 4.0 m away"),
    "item removed": (item_removed, "REMOVE", "Removed"),
    "item copied": (item_copied, "COPY", "Copied: 4.0 m away"),
}
"""By name: what makes the edit, the part of the object that it changes, and how its line begins."""


def lines(scene: Any) -> tuple[EditLine, ...]:
    """The list of a scene."""
    update()
    return read_now(scene)


def press(operator: Any, line: EditLine) -> None:
    """Press a line's button."""
    kind, name, part = line.key
    assert operator(kind=kind, name=name, part=part, muted=line.muted) == {"FINISHED"}
