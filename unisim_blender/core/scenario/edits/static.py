"""Edits of what carries no annotation: a box of space copied or emptied. The ground in it stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...world.drive import Box, Drive, StaticCopy
from ..types import BoxSpec, CopyStatic, RemoveStatic
from .context import Context, fail, pose_of


def copy_static(drive: Drive, edit: CopyStatic, place: str, context: Context) -> Drive:
    """The drive in which what stands in the box stands also at the target."""
    if edit.id in context.recorded.actors or edit.id in drive.actors:
        fail(f"{place}.id", f'"{edit.id}" is an actor already')
    copy = StaticCopy(edit.id, _box(edit.box, context), pose_of(edit.target))
    return replace(drive, static_copies=(*drive.static_copies, copy))


def remove_static(drive: Drive, edit: RemoveStatic, place: str, context: Context) -> Drive:
    """The drive in which nothing stands in the box."""
    return replace(drive, static_removals=(*drive.static_removals, _box(edit.box, context)))


def _box(key: str, context: Context) -> Box:
    box: BoxSpec = (context.scenario.boxes or {})[key]  # it is there: the scenario was checked
    return Box(pose_of(box), np.array(box.size_m, float))
