"""How high the ground is at a place: LiDAR returns around it where the log is at hand, else the undersides of
recorded actors."""

from __future__ import annotations

import numpy as np

from ...core.geometry import BoolArray, FloatArray, invert_pose, transform_points
from ...core.world.drive import Drive
from ..sampled.clock import Clock, recorded_poses, recorded_there
from ..sampled.source import DriveSource

AROUND_M = 3.0
LEAST_RETURNS = 20
LOW_PERCENT = 20.0
"""Of the returns around a place: lower ones are noise, higher ones stand on the ground."""
BESIDE_M = 0.1
"""How far outside an actor's box its returns may lie."""
NEAR_M = 40.0


def ground_height(source: DriveSource, place: FloatArray, frame: int) -> float | None:
    """The ground's z under a place (3,), None where nothing tells."""
    drive, log = source.drive, source.log
    if log is not None:
        for name, lidar in drive.lidars.items():
            frames = log.sweep_frames(name) if lidar.model.beams else ()
            if not frames:
                continue
            nearest = min(frames, key=lambda f: abs(f - frame))
            points = log.sweep(name, nearest).points
            around = points[np.linalg.norm(points[:, :2] - place[:2], axis=1) < AROUND_M]
            around = around[np.abs(around[:, 2] - place[2]) < AROUND_M]
            around = around[~on_actors(drive, around, nearest)]
            if len(around) >= LEAST_RETURNS:
                return float(np.percentile(around[:, 2], LOW_PERCENT))
    found = heights(undersides(drive), place[None])[0]
    return None if np.isnan(found) else float(found)


def on_actors(drive: Drive, points: FloatArray, frame: int) -> BoolArray:
    """Return which points (N, 3) lie on an actor at a frame of the recorded drive: in its box, which is
    drawn generously."""
    found = np.zeros(len(points), bool)
    time_s = drive.time_s[frame]
    for actor in drive.actors.values():
        start, end = drive.window(actor)
        if start <= time_s <= end:
            inside = transform_points(invert_pose(actor.world_from_actor.at(time_s)), points)
            found |= (np.abs(inside) <= actor.size_m / 2 + BESIDE_M).all(1)
    return found


def undersides(drive: Drive) -> FloatArray:
    """Places (M, 3) on the ground, under recorded actors."""
    clock = Clock.of(drive)
    places = [np.zeros((0, 3))]
    for actor in drive.actors.values():
        poses = recorded_poses(actor, clock)[recorded_there(actor, drive, clock)]
        places.append(poses[:, :3, 3] - poses[:, :3, 2] * actor.size_m[2] / 2)
    return np.concatenate(places)


def heights(ground: FloatArray, places: FloatArray) -> FloatArray:
    """The ground's z (N,) under places (N, 3) from places (M, 3) on it, the nearest counting most; NaN
    where none is near."""
    away = np.linalg.norm(ground[None, :, :2] - places[:, None, :2], axis=-1)
    weight = np.where(away < NEAR_M, 1 / (1.0 + away) ** 2, 0.0)
    total = weight.sum(1)
    return np.where(total > 0, (weight * ground[:, 2]).sum(1) / np.maximum(total, 1e-12), np.nan)
