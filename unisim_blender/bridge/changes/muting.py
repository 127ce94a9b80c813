"""Edits taken back, and muted: the object stands as it was imported, and the edit waits in the file until it is unmuted.

A scenario is the difference between the drive and what stands there. A muted edit is therefore none of the scene's
state: what carries it keeps it elsewhere (see `carriers`).
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy

from ...editing.edits.lines import EditLine
from ...editing.sampled.source import DriveSource
from ...editing.texts import packed
from ..objects.imported import original_of
from . import carriers  # noqa: F401 so that all are registered
from .carriers.carrier import Muted, carrier_of
from .carriers.own_object import discard


def mute(scene: bpy.types.Scene, source: DriveSource, line: EditLine) -> None:
    """Keep an edit of a scene without letting it count. Raises `UnisimError`."""
    obj = scene.objects.get(line.object_name)
    item = scene.unisim_edits.muted.add()
    note(item, line)
    carrier_of(line.part).mute(scene, source, item, line, obj)


def unmute(scene: bpy.types.Scene, source: DriveSource, number: int, conflicts: Iterable[EditLine] = ()) -> None:
    """Let a muted edit count again. ``conflicts`` are edits that cannot stand beside it:
    they are muted instead."""
    for conflict in conflicts:
        mute(scene, source, conflict)
    item = scene.unisim_edits.muted[number]
    uid, collection = item.uid, scene.collection if item.at_root else item.collection
    muted = Muted(
        item.kind, item.part, item.parked, collection, item.look, item.look_scene, tuple(item.scale),
        item.scale_lift_m, item.kept
    )  # fmt: skip
    scene.unisim_edits.muted.remove(number)
    carrier_of(muted.part).unmute(scene, source, muted, original_of(scene, muted.kind, uid))


def drop(scene: bpy.types.Scene, number: int) -> None:
    """Delete a muted edit: what is shown stays as it is."""
    parked = scene.unisim_edits.muted[number].parked
    scene.unisim_edits.muted.remove(number)
    if parked is not None:
        discard(parked)


def note(item: Any, line: EditLine) -> None:
    """Write the line of an edit into a muted edit."""
    item.name, item.kind, item.uid, item.part, item.what = line.who, line.kind, line.uid, line.part, line.what
    item.what_parts = packed(line.what)
    item.thing, item.start_s, item.end_s = line.object_name, line.start_s, line.end_s
    item.first, item.last = line.frames[0], line.frames[-1]


def revert(scene: bpy.types.Scene, source: DriveSource, line: EditLine) -> None:
    """Take an edit of a scene back; what else is edited stays.

    A removed object comes back, a copied or inserted one is deleted, a moved one gets its recorded trajectory and no
    displacement. Raises `UnisimError`.
    """
    carrier_of(line.part).revert(scene, source, line, scene.objects.get(line.object_name))
