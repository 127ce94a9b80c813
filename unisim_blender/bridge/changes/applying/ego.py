"""The vehicle of an edited drive in an imported scene, and its bodies."""

from __future__ import annotations

from ....core.meshes.read import read_mesh
from ....core.scenario.edits.ego_body import LABEL, EgoBody
from ....core.scenario.motion.placement import pose_of
from ...importing.drive import animate
from ...objects.ego_bodies import mount_body
from ...objects.imported import collection_of
from ...objects.mesh_objects import object_of
from .target import Target


def apply_bodies(target: Target) -> None:
    """Make the bodies and mount them."""
    for edit in target.scenario.edits:
        if isinstance(edit, EgoBody):
            obj = object_of(edit.id, read_mesh(target.scenario.resolve(edit.mesh)), edit.label or LABEL)
            collection_of(target.scene, "BODY").objects.link(obj)
            mount_body(obj, target.ego, pose_of(edit.mount), edit.label or LABEL)


def apply_ego(target: Target) -> None:
    """Let the vehicle drive elsewhere."""
    if target.edited.world_from_ego is not target.recorded.world_from_ego:
        animate(target.ego, target.edited.world_from_ego, target.clock)
