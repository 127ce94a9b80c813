"""Rigs: a team's cameras and LiDARs on the vehicle, as data-only JSON files that any drive can take.

Sensors stand in them as in a scenario's `sensors`, each with a `mount` in the ego vehicle's axes (x
forward, y left, z up).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import OutputError, ScenarioError
from ..files import write_file
from ..geometry import FloatArray, quaternion_from_matrix
from ..json_file import read_json
from ..scenario import build, plain
from ..scenario.json_schema import Schema, members_of
from ..scenario.motion.placement import Placement, check_rotation
from ..scenario.schema import check_by_schema, scenario_schema
from ..scenario.sensors.document import CameraSpec, LidarSpec
from ..scenario.sensors.select import (
    FRONT_FROM_OPTICAL,
    camera_members,
    lidar_members,
    lidar_model,
    mounted_pose,
    new_camera_model,
)
from ..sensors.beam_tables import BEAM_TABLES
from ..world.drive import CameraModel, LidarModel

FORMAT, VERSION = "unisim-rig", 1
SUFFIX = ".json"
NOT_HERE = ("like", "mount_offset", "trajectory", "time_offset_s", "sees_ego_body")
"""Members that a scenario's sensors may have and a rig's may not: they have a meaning beside a log alone. LiDARs
have a time offset."""
POSITION_DIGITS, ROTATION_DIGITS = 5, 7


@dataclass(frozen=True, eq=False)
class RigCamera:
    """A camera on the vehicle: ego_from_camera (4, 4), OpenCV's axes in the ego vehicle's."""

    name: str
    model: CameraModel
    ego_from_camera: FloatArray


@dataclass(frozen=True, eq=False)
class RigLidar:
    """A LiDAR on the vehicle: ego_from_lidar (4, 4)."""

    name: str
    model: LidarModel
    ego_from_lidar: FloatArray


@dataclass(frozen=True, eq=False)
class Rig:
    """Cameras and LiDARs on the vehicle; ``about`` is what somebody should know of them."""

    cameras: tuple[RigCamera, ...]
    lidars: tuple[RigLidar, ...]
    about: str = ""


@cache
def rig_schema() -> dict[str, Any]:
    """The JSON Schema of rigs; its sensors are a scenario's."""

    def sensors(kind: str) -> dict[str, Any]:
        return {"type": "array", "items": {"allOf": [{"$ref": f"#/$defs/{kind}"}, {"required": ["mount"]}]}}

    members: dict[str, Schema] = {
        "format": {"const": FORMAT},
        "version": {"const": VERSION},
        "about": {"type": "string", "maxLength": 2000},
        "cameras": sensors("camera"),
        "lidars": sensors("lidar"),
    }
    shared = {name: scenario_schema()[name] for name in ("$schema", "$defs")}
    return {**shared, **members_of(members, ["format", "version"])}


def read_rig(path: Path) -> Rig:
    """Read and check a rig. Raises `ScenarioError` naming the file, the place in it and the value."""
    path = Path(path)
    document = read_json(path, ScenarioError)
    check_by_schema(document, rig_schema(), path)
    cameras, lidars, taken = [], [], set()
    for kind in ("cameras", "lidars"):
        for index, value in enumerate(document.get(kind, ())):
            place = f"{path}: {kind}[{index}]"
            for member in NOT_HERE:
                if member in value and not (kind == "lidars" and member == "time_offset_s"):
                    raise ScenarioError(f"{place}.{member}: is no part of a rig, whose sensors are new ones on a mount")
            if value["id"] in taken:
                raise ScenarioError(f'{place}.id: "{value["id"]}" stands twice')
            taken.add(value["id"])
            if kind == "cameras":
                camera: CameraSpec = build(CameraSpec, value)
                pose = mounted_pose(_mount(camera, place), FRONT_FROM_OPTICAL)
                cameras.append(RigCamera(camera.id, new_camera_model(camera, place), pose))
            else:
                lidar: LidarSpec = build(LidarSpec, value)
                lidars.append(
                    RigLidar(lidar.id, lidar_model(None, lidar, place), mounted_pose(_mount(lidar, place), np.eye(3)))
                )
    if not taken:
        raise ScenarioError(f"{path}: has neither cameras nor lidars")
    return Rig(tuple(cameras), tuple(lidars), document.get("about", ""))


def write_rig(rig: Rig, path: Path) -> None:
    """Write a rig, whole or not at all. Raises `OutputError`."""
    document = {
        "format": FORMAT,
        "version": VERSION,
        **({"about": rig.about} if rig.about else {}),
        "cameras": [plain(_camera_spec(camera)) for camera in rig.cameras],
        "lidars": [plain(_lidar_spec(lidar)) for lidar in rig.lidars],
    }
    write_file(path, json.dumps(document, indent=1, ensure_ascii=False) + "\n", OutputError)


def built_in_rigs() -> list[Path]:
    """The rigs that come with the program, by name."""
    return sorted(Path(__file__).parent.glob(f"*{SUFFIX}"), key=lambda path: path.stem.lower())


def _mount(spec: CameraSpec | LidarSpec, place: str) -> Placement:
    assert spec.mount is not None  # the schema wants one
    check_rotation(spec.mount, f"{place}.mount")
    return spec.mount


def _placement(pose: FloatArray) -> Placement:
    x, y, z = np.round(pose[:3, 3], POSITION_DIGITS).tolist()
    w, i, j, k = np.round(quaternion_from_matrix(pose[:3, :3]), ROTATION_DIGITS).tolist()
    return Placement(position=(x, y, z), quaternion_wxyz=(w, i, j, k))


def _camera_spec(camera: RigCamera) -> CameraSpec:
    return CameraSpec(camera.name, **camera_members(camera.model), mount=_placement(camera.ego_from_camera))


def _lidar_spec(lidar: RigLidar) -> LidarSpec:
    model, mount = lidar.model, _placement(lidar.ego_from_lidar)
    for name, table in BEAM_TABLES.items():
        if all(np.array_equal(value, getattr(model, key)) for key, value in vars(table()).items()):
            return LidarSpec(lidar.name, preset=name, mount=mount)
    return LidarSpec(lidar.name, **lidar_members(model), mount=mount)
