"""Static items of a scenario in an imported scene."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from ....core.scenario.edits import CopyStatic, RemoveStatic
from ....core.scenario.motion.placement import pose_of
from ...objects.imported import collection_of
from ...objects.static_items import mark
from .target import Target


def apply_static(target: Target) -> None:
    """Mark the boxes, and copy and remove what stands in them."""
    scene, scenario = target.scene, target.scenario
    gone = {edit.box for edit in scenario.edits if isinstance(edit, RemoveStatic)}
    for uid, spec in (scenario.boxes or {}).items():
        obj = mark(scene, pose_of(spec), np.array(spec.size_m), uid)
        for edit in scenario.edits:
            if isinstance(edit, CopyStatic) and edit.box == uid:
                copy = obj.copy()
                copy.name = edit.id
                collection_of(scene, "STATIC").objects.link(copy)
                copy.location, copy.rotation_quaternion, _ = Matrix(pose_of(edit.target).tolist()).decompose()
        if uid in gone:
            bpy.data.objects.remove(obj)
