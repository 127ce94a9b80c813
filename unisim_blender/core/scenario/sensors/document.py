"""A scenario's sensors as its document states them: the log's, changed ones and new ones."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from ..checks import require
from ..json_schema import NOT_NEGATIVE, NUMBER, PIXELS, POSITIVE, TEXT, Schema, members_of, ref
from ..motion.keys import Keyframe, check_keys
from ..motion.placement import Offset, Placement, check_rotation
from ..time_range import Times


@dataclass(frozen=True)
class Shutter:
    """A rolling shutter as in `drive.RollingShutter`."""

    duration_s: float
    reference: float | None = None
    axis: str | None = None


@dataclass(frozen=True)
class CameraSpec:
    """A camera of the log, changed or not, or a new one on its own mount."""

    id: str
    like: str | None = None
    width: int | None = None
    height: int | None = None
    fx: float | None = None
    fy: float | None = None
    cx: float | None = None
    cy: float | None = None
    horizontal_fov_deg: float | None = None
    shutter: Shutter | None = None
    lens: dict[str, Any] | None = field(default=None, hash=False)
    time_offset_s: float | None = None
    mount: Placement | None = None
    mount_offset: Offset | None = None
    trajectory: tuple[Keyframe, ...] | None = None
    sees_ego_body: bool | None = None
    times: Times | None = None


@dataclass(frozen=True)
class LidarSpec:
    """A LiDAR of the log, changed or not, or a new one with its own mount and beam table."""

    id: str
    like: str | None = None
    preset: str | None = None
    elevation_deg: tuple[float, ...] | None = None
    azimuth_offset_deg: tuple[float, ...] | None = None
    beam_time_s: tuple[float, ...] | None = None
    columns: int | None = None
    column_azimuth_deg: tuple[float, ...] | None = None
    column_time_s: tuple[float, ...] | None = None
    sweep_s: float | None = None
    start_azimuth_deg: float | None = None
    direction: int | None = None
    time_offset_s: float | None = None
    min_range_m: float | None = None
    max_range_m: float | None = None
    mount: Placement | None = None
    mount_offset: Offset | None = None
    trajectory: tuple[Keyframe, ...] | None = None
    sees_ego_body: bool | None = None
    times: Times | None = None


@dataclass(frozen=True)
class Sensors:
    """The sensors to render; None stands for all of the log's."""

    cameras: tuple[CameraSpec, ...] | None = None
    lidars: tuple[LidarSpec, ...] | None = None


MAX_COLUMNS = 36000
BEAMS: Schema = {"type": "array", "items": NUMBER, "minItems": 1, "maxItems": 1024}
COLUMNS: Schema = {"type": "array", "items": NUMBER, "minItems": 1, "maxItems": MAX_COLUMNS}
NAME: Schema = {"type": "string", "pattern": "^[A-Za-z0-9_][A-Za-z0-9_.-]*$", "maxLength": 100}
"""JSON Schema of a name that can be part of file names."""
PLACE: dict[str, Schema] = {
    "mount": ref("placement"),
    "mount_offset": ref("mount_offset"),
    "trajectory": ref("keyframes"),
    "sees_ego_body": {
        "type": "boolean",
        "description": "Whether an ego_body is visible to it; where missing: if it has a trajectory.",
    },
    "times": ref("own_times"),
}
DEFS: dict[str, Schema] = {
    "sensors": members_of(
        {"cameras": {"type": "array", "items": ref("camera")}, "lidars": {"type": "array", "items": ref("lidar")}},
        (),
        "The sensors to render; a missing list stands for all of the log's.",
    ),
    "shutter": members_of(
        {
            "duration_s": NUMBER,
            "reference": {"type": "number", "minimum": 0, "maximum": 1},
            "axis": {"enum": ["rows", "columns"], "description": "Which lines are exposed one after the other."},
        },
        ["duration_s"],
    ),
    "lens": {
        "type": "object",
        "properties": {"type": TEXT},
        "required": ["type"],
        "additionalProperties": {"type": ["number", "array"], "items": NUMBER},
        "description": "A lens model, by its name, and its parameters; fx, fy, cx, cy scale and move its plane.",
    },
    "camera": members_of(
        {
            "id": NAME,
            "like": TEXT,
            "width": PIXELS,
            "height": PIXELS,
            "fx": POSITIVE,
            "fy": POSITIVE,
            "cx": NUMBER,
            "cy": NUMBER,
            "horizontal_fov_deg": {"type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 360},
            "shutter": ref("shutter"),
            "lens": ref("lens"),
            "time_offset_s": NUMBER,
            **PLACE,
        },
        ["id"],
    ),
    "lidar": members_of(
        {
            "id": NAME,
            "like": TEXT,
            "preset": {"enum": ["pandar64", "vlp16", "vlp32c", "hdl32e", "hdl64e", "os1-64", "os1-128"]},
            "elevation_deg": {
                "type": "array",
                "items": {"type": "number", "minimum": -90, "maximum": 90},
                "minItems": 1,
                "maxItems": 1024,
            },
            "azimuth_offset_deg": BEAMS,
            "beam_time_s": BEAMS,
            "columns": {"type": "integer", "minimum": 1, "maximum": MAX_COLUMNS},
            "column_azimuth_deg": COLUMNS,
            "column_time_s": COLUMNS,
            "sweep_s": NOT_NEGATIVE,
            "start_azimuth_deg": NUMBER,
            "direction": {"enum": [-1, 1]},
            "time_offset_s": NUMBER,
            "min_range_m": NOT_NEGATIVE,
            "max_range_m": POSITIVE,
            **PLACE,
        },
        ["id"],
    ),
}


def check_sensors(sensors: Sensors, place: str) -> None:
    """Raise `ScenarioError` for ids that stand twice and for places that exclude each other."""
    both: dict[str, tuple[CameraSpec | LidarSpec, ...]] = {
        "cameras": sensors.cameras or (),
        "lidars": sensors.lidars or (),
    }
    for kind, specs in both.items():
        seen: set[str] = set()
        for index, spec in enumerate(specs):
            here = f"{place}.{kind}[{index}]"
            require(spec.id not in seen, f"{here}.id", f'"{spec.id}" stands twice')
            seen.add(spec.id)
            given = [name for name in ("mount", "mount_offset", "trajectory") if getattr(spec, name) is not None]
            require(len(given) <= 1, here, f"has both {' and '.join(given)}, which exclude each other")
            check_keys(spec.trajectory or (), f"{here}.trajectory")
            for member, rotation in (("mount", spec.mount), ("mount_offset", spec.mount_offset)):
                if rotation is not None:
                    check_rotation(rotation, f"{here}.{member}")
