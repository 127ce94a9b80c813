"""A log of a street with a frame every half second, and the scenario of a car that stands in the ego vehicle's lane."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from benchmarks.rendered_beside_exact.streets import sparse
from unisim_blender.core.formats.pandaset.write import PandasetWriter
from unisim_blender.core.geometry import invert_pose
from unisim_street.street import Street, build_street
from unisim_street.truth import truth_camera, truth_lidar

CAMERA, LIDAR = "front_camera", "pandar64"
FRAMES, EVERY, PERIOD_S = 66, 5, 0.2
AHEAD_M = 34.0
"""How far ahead of the vehicle's rear axle the car's middle is at the start."""
IN_LANE = ("car-01", "car-02", "car-05")
"""Traffic of every street that drives in the ego vehicle's lane."""


def write_sparse_street(out: Path, seed: int) -> Path:
    """Write the log of a street; its folder."""
    made = build_street(seed, FRAMES, 320, 180, (CAMERA,), 0.0)
    drive = sparse(made.drive, EVERY)
    writer = PandasetWriter(out, drive)
    for frame in drive.frames:
        rgb = truth_camera(made, drive, CAMERA, frame, samples=1).rgb
        writer.write_image(CAMERA, frame, np.rint(rgb * 255).astype(np.uint8))
        writer.write_sweep(frame, {LIDAR: truth_lidar(made, drive, LIDAR, frame)})
        writer.write_cuboids(frame)
    writer.finish()
    return out


def write_scenario(log: Path, street: Street, path: Path) -> str:
    """Write the scenario; the identifier of the car that stands in the lane."""
    car = parked_car(street)
    height = float(street.drive.actors[car].size_m[2])
    document = {
        "format": "unisim-scenario",
        "version": 1,
        "name": "stopped",
        "log": str(log),
        "edits": [
            *({"type": "remove", "actor": uid} for uid in IN_LANE),
            {"type": "move", "actor": car, "pose": {"position": [AHEAD_M, 0.0, height / 2], "yaw_deg": 0.0}},
        ],
        "simulation": {
            "step_s": PERIOD_S,
            "rates": {name: {"period_s": PERIOD_S} for name in (CAMERA, LIDAR)},
        },
    }
    path.write_text(json.dumps(document))
    return car


def parked_car(street: Street) -> str:
    """A car that is parked on the right and that the vehicle passes after some metres: its rear was seen."""
    ego = invert_pose(street.drive.world_from_ego.poses[0])
    found = []
    for uid, actor in street.drive.actors.items():
        pose = ego @ actor.world_from_actor.poses[0]
        if not actor.is_moving and actor.label == "Car" and pose[0, 0] > 0.9 and pose[1, 3] < 0:
            found.append((abs(float(pose[0, 3]) - 25.0), uid))
    return min(found)[1]
