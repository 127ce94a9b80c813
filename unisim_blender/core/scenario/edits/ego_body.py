"""A mesh as the ego vehicle's body: it rides on the vehicle, and only sensors that do not ride there see it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...world.drive import Actor, Drive, Look
from ..types import EgoBody
from .actors import check_new, mesh_of
from .context import SENSOR_MARGIN_S, Context, pose_of
from .motion import is_moving, merged_times, sampled

LABEL = "Car"
"""The class of a body whose class nobody told."""


def ego_body(drive: Drive, edit: EgoBody, place: str, context: Context) -> Drive:
    """The drive with a mesh on the vehicle, wherever edits before and after this one let it drive."""
    path, size_m = mesh_of(edit.mesh, place, context)
    check_new(drive, edit.id, place, context)
    ego, mount = drive.world_from_ego, pose_of(edit.mount)
    ends = np.array([min(drive.time_s.values()) - SENSOR_MARGIN_S, max(drive.time_s.values()) + SENSOR_MARGIN_S])
    trajectory = sampled(lambda t: ego.at(t) @ mount, merged_times(ego.times_s, ends))
    start, end = context.presence(None, place)
    body = Actor(
        edit.id, edit.label or LABEL, size_m, trajectory, start, end, is_moving(trajectory), Look(edit.id, mesh=str(path)),
        inserted=True, is_ego_body=True,
    )  # fmt: skip
    return replace(drive, actors={**drive.actors, body.uid: body})
