"""The edits that simulators are usually asked for, of any street."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np

from unisim_blender.core.files import write_file
from unisim_blender.core.world.drive import Actor

from .layout import PARKED_Y_M
from .street import Street

SCENARIOS_FOLDER = "scenarios"
SHIFTS_M = (0.5, 2.0, 3.0)
_PARKED_AHEAD_M = (12.0, 30.0)
"""Where, before the drive's start, a parked car is well seen."""
_USUAL_CAR_LENGTH_M = 4.6
"""A usual car's length."""


def write_scenarios(street: Street, out: Path, log: Path) -> tuple[Path, ...]:
    """Write the usual edits of the street whose log is at ``log`` as scenarios below ``out``; their paths."""
    paths, where = [], Path(os.path.relpath(log, out / SCENARIOS_FOLDER)).as_posix()
    for name, edits in usual_edits(street).items():
        document = {"format": "unisim-scenario", "version": 1, "name": name, "log": where, "edits": edits}
        path = out / SCENARIOS_FOLDER / f"{name}.json"
        write_file(path, (json.dumps(document, indent=1) + "\n").encode())
        paths.append(path)
    return tuple(paths)


def usual_edits(street: Street) -> dict[str, list[dict[str, Any]]]:
    """Edits by name: a car removed, one inserted, cones copied, a car retimed, and the vehicle moved to the left."""
    actors = street.drive.actors
    # the left row: the right one has the works' cones and skip
    parked = {uid: actor for uid, actor in actors.items() if uid.startswith("car-") and _parked_left(street, actor)}
    x = {uid: _coordinates(street, actor)[0] for uid, actor in parked.items()}
    middle = sum(_PARKED_AHEAD_M) / 2
    removed = min(x, key=lambda uid: abs(x[uid] - middle))
    travel = float(np.ptp(street.drive.world_from_ego.positions[:, 0]))
    places = np.arange(_PARKED_AHEAD_M[0], 2 * _PARKED_AHEAD_M[1], 0.5)
    low, high = street.plan.crossing
    places = places[(places < low - _USUAL_CAR_LENGTH_M) | (places > high + _USUAL_CAR_LENGTH_M)]
    away = np.abs(places[:, None] - np.array(list(x.values()))).min(1)
    # of the places with room for a car the one that is seen best
    roomy = places[away >= min(_USUAL_CAR_LENGTH_M + 0.8, away.max())]
    place = float(roomy[np.abs(roomy - middle).argmin()])
    # what no camera came near shows nobody how it looks
    passed = [uid for uid in x if uid != removed and _PARKED_AHEAD_M[0] <= x[uid] <= _PARKED_AHEAD_M[1] + travel]
    appearance = min(passed or [removed], key=lambda uid: abs(float(actors[uid].size_m[0]) - _USUAL_CAR_LENGTH_M))
    at = street.plan.course.place(*(np.array([value]) for value in (place, PARKED_Y_M, np.pi)))
    x_m, y_m, yaw_deg = (float(value[0]) * scale for value, scale in zip(at, (1.0, 1.0, 180 / np.pi), strict=True))
    position = [x_m, y_m - float(street.drive.world_origin[1]), float(actors[appearance].size_m[2]) / 2]
    oncoming = next(
        uid for uid in sorted(actors) if actors[uid].is_moving and actors[uid].world_from_actor.poses[0, 0, 0] < -0.1
    )
    cone = {"type": "duplicate", "actor": "cone-3"}
    shifts = {f"shift-{m:g}m": [{"type": "ego", "shift": [{"frame": 0, "left_m": m}]}] for m in SHIFTS_M}
    return {
        "removal": [{"type": "remove", "actor": removed}],
        "insertion": [
            {
                "type": "insert",
                "actor": appearance,
                "id": "inserted",
                "pose": {"position": position, "yaw_deg": yaw_deg},
            }
        ],
        "cones": [
            {**cone, "id": "cone-a", "world_offset_m": [-1.5, 1.2, 0.0]},
            {**cone, "id": "cone-b", "world_offset_m": [1.5, 1.0, 0.0]},
        ],
        "retiming": [{"type": "retime", "actor": oncoming, "offset_s": 0.6, "outside": "continue"}],
        **shifts,
    }


def _parked_left(street: Street, actor: Actor) -> bool:
    return not actor.is_moving and _coordinates(street, actor)[1] > 0


def _coordinates(street: Street, actor: Actor) -> tuple[float, float]:
    """Metres along and beside the street of an actor's first place."""
    at = actor.world_from_actor.positions[:1, :2] + street.drive.world_origin[:2]
    along, beside = street.plan.course.coordinates(at)
    return float(along[0]), float(beside[0])
