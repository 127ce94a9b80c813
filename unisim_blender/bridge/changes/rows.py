"""Rows of copies: objects that an edit `row` puts, made, moved and deleted as its numbers change."""

from __future__ import annotations

import json
from collections.abc import Sequence

import bpy
import numpy as np

from ...core.geometry import FloatArray
from ...core.scenario import plain
from ...core.scenario.edits.row import Row, clear, standing
from ...core.world.drive import Drive
from ...editing.readers.actors import row_of
from ...editing.sampled.scene import rigid
from ..objects.imported import add_actor, copy_of, imported_objects, stand_at
from ..objects.meshes import size_of
from ..objects.trajectories import free, remove, settle_on

Boxes = Sequence[tuple[FloatArray, FloatArray]]
"""What a row keeps clear of: poses (T, 4, 4) and a size (3,) each."""


def row_text(row: Row) -> str:
    """Return a row as its objects note it."""
    return json.dumps(plain(row))


def members(scene: bpy.types.Scene, row: Row) -> list[bpy.types.Object]:
    """Return the objects of a row that are there."""
    names = {obj.name: row_of(obj.unisim.row) for obj in imported_objects(scene, "ACTOR") if obj.unisim.row}
    return [scene.objects[name] for name, own in names.items() if own is not None and own.id == row.id]


def arranged(scene: bpy.types.Scene, row: Row, drive: Drive, others: Boxes) -> list[bpy.types.Object]:
    """Let the objects of a row of copies of a recorded actor stand where it puts them, and return them. Raises
    `ScenarioError`."""
    actor = drive.actors[row.actor]
    poses = row.poses(standing(actor), actor.size_m, drive, row.id)
    before = {obj.name: obj for obj in members(scene, row)}
    placed = []
    for number, pose in enumerate(poses[clear(poses, actor.size_m, others)], 1):
        name = f"{row.id} {number}"
        obj = before.pop(name, None)
        if obj is None:
            obj = add_actor(scene, name, actor)
        put(obj, pose)
        obj.unisim.row = row_text(row)
        placed.append(obj)
    for obj in before.values():
        remove(obj)
    return placed


def copies(
    context: bpy.types.Context, source: bpy.types.Object, row: Row, drive: Drive, others: Boxes
) -> list[bpy.types.Object]:
    """Return copies of an object that no log has where a row puts them. Raises `ScenarioError`."""
    size_m = np.array(size_of(source), float)
    poses = row.poses(rigid(np.array(source.matrix_world, float)), size_m, drive, row.id)
    placed = []
    for pose in poses[clear(poses, size_m, others)]:
        placed.append(copy_of(context, source))
        put(placed[-1], pose)
    return placed


def put(obj: bpy.types.Object, pose: FloatArray) -> None:
    """Let an object stand at a pose (4, 4), throughout."""
    free(obj)
    settle_on(obj)
    obj.rotation_mode = "QUATERNION"
    stand_at(obj, pose)
