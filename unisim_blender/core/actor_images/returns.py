"""What stands before an actor and is no actor, a fence or a wall, told by LiDAR returns between it and the camera."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from ..data.log import Log
from ..errors import UnisimError
from ..geometry import FloatArray, invert_pose, transform_points
from ..world.drive import Actor, CameraModel
from .best_views import View

LEAST = 6
"""Fewer returns about an actor tell nothing."""
BEFORE_M = 0.4
"""A return is before the actor when it is this much nearer to the camera than the box's nearest corner."""
ABOUT_M = 0.2
"""Returns so far outside the box are still the actor's."""
APART = 2
"""A sweep at most so many frames away stands in for a missing one."""


def clear_fraction(points: FloatArray, size_m: FloatArray, view: View, model: CameraModel) -> float:
    """Return the fraction of returns (N, 3), world, in an actor's rectangle that are its own and not of
    something before it."""
    seen = transform_points(invert_pose(view.camera_pose), points)
    ahead = seen[:, 2] > 0.5
    points, seen = points[ahead], seen[ahead]
    # NaN is within no rectangle
    u, v, _ = model.project(seen)
    left, top, right, bottom = view.rectangle
    within = (u > left) & (u < right) & (v > top) & (v < bottom)
    within &= view.free(u, v, model)
    points, depth = points[within], seen[within, 2]
    local = transform_points(invert_pose(view.pose), points)
    half = np.asarray(size_m, float) / 2
    own = (np.abs(local) <= half + ABOUT_M).all(-1)
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1], indexing="ij"), -1).reshape(8, 3)
    corners = transform_points(invert_pose(view.camera_pose) @ view.pose, signs * half)
    before = ~own & (depth < corners[:, 2].min() - BEFORE_M)
    count = int(own.sum() + before.sum())
    return 1.0 if count < LEAST else float(own.sum() / count)


def cleared(log: Log, actors: Mapping[str, Actor], views: Mapping[str, list[View]]) -> dict[str, list[View]]:
    """Return the views of actors with what LiDAR says stands before them, the best first. Every sweep is read once."""
    lidar = next(iter(log.drive.lidars), "")
    frames = np.array(log.sweep_frames(lidar) if lidar else (), int)
    wanted: dict[int, list[tuple[str, int]]] = {}
    for uid, some in views.items():
        for number, view in enumerate(some):
            if len(frames):
                nearest = int(frames[np.abs(frames - view.frame).argmin()])
                if abs(nearest - view.frame) <= APART:
                    wanted.setdefault(nearest, []).append((uid, number))
    found = {uid: list(some) for uid, some in views.items()}
    for frame, those in sorted(wanted.items()):
        try:
            points = log.sweep(lidar, frame).points
        except (UnisimError, OSError):
            continue
        for uid, number in those:
            view = found[uid][number]
            clear = clear_fraction(points, actors[uid].size_m, view, log.drive.cameras[view.camera].model)
            found[uid][number] = replace(view, clear=clear)
    return {uid: sorted(some, key=lambda view: -view.score) for uid, some in found.items()}
