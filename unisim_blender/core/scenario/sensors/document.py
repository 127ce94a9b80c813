"""A scenario's sensors as its document states them: the log's, changed ones and new ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Annotated, Any

from ..checks import require
from ..json_schema import (
    NOT_NEGATIVE,
    NUMBER,
    POSITIVE,
    TEXT,
    NotNegative,
    PixelCount,
    Positive,
    Schema,
    SchemaOf,
    members_of,
    object_of,
    ref,
)  # fmt: skip
from ..motion.keys import Keyframes, check_keys
from ..motion.placement import Offset, Placement, check_rotation
from ..time_range import Times

MAX_COLUMNS = 36000
Name = Annotated[str, SchemaOf({"type": "string", "pattern": "^[A-Za-z0-9_][A-Za-z0-9_.-]*$", "maxLength": 100})]
"""A name that can be part of file names."""


def _table(most: int, **limits: float) -> SchemaOf:
    """Return the schema of a table of numbers with at most so many entries."""
    return SchemaOf({"type": "array", "items": {**NUMBER, **limits}, "minItems": 1, "maxItems": most})


Beams = Annotated[tuple[float, ...], _table(1024)]
Columns = Annotated[tuple[float, ...], _table(MAX_COLUMNS)]
LENS: Schema = {
    "type": "object",
    "properties": {"type": TEXT},
    "required": ["type"],
    "additionalProperties": {"type": ["number", "array"], "items": NUMBER},
    "description": "A lens model, by its name, and its parameters; fx, fy, cx, cy scale and move its plane.",
}
AXIS: Schema = {"enum": ["rows", "columns"], "description": "Which lines are exposed one after the other."}
PRESET: Schema = {"enum": ["pandar64", "vlp16", "vlp32c", "hdl32e", "hdl64e", "os1-64", "os1-128"]}
SEES_EGO_BODY: Schema = {
    "type": "boolean",
    "description": "Whether an ego_body is visible to it; where missing: if it has a trajectory.",
}


@dataclass(frozen=True)
class Shutter:
    """A rolling shutter as in `drive.RollingShutter`."""

    duration_s: float
    reference: Annotated[float, SchemaOf({**NOT_NEGATIVE, "maximum": 1})] | None = None
    axis: Annotated[str, SchemaOf(AXIS)] | None = None


@dataclass(frozen=True, kw_only=True)
class SensorPlace:
    """Where a sensor is, when it captures, and whether it sees the ego vehicle's body."""

    mount: Placement | None = None
    mount_offset: Annotated[Offset, SchemaOf(ref("mount_offset"))] | None = None
    trajectory: Keyframes | None = None
    sees_ego_body: Annotated[bool, SchemaOf(SEES_EGO_BODY)] | None = None
    times: Annotated[Times, SchemaOf(ref("own_times"))] | None = None


@dataclass(frozen=True)
class CameraSpec(SensorPlace):
    """A camera of the log, changed or not, or a new one on its own mount."""

    id: Name
    like: str | None = None
    width: PixelCount | None = None
    height: PixelCount | None = None
    fx: Positive | None = None
    fy: Positive | None = None
    cx: float | None = None
    cy: float | None = None
    horizontal_fov_deg: Annotated[float, SchemaOf({**POSITIVE, "exclusiveMaximum": 360})] | None = None
    shutter: Shutter | None = None
    lens: Annotated[dict[str, Any], SchemaOf(ref("lens"))] | None = field(default=None, hash=False)
    time_offset_s: float | None = None


@dataclass(frozen=True)
class LidarSpec(SensorPlace):
    """A LiDAR of the log, changed or not, or a new one with its own mount and beam table."""

    id: Name
    like: str | None = None
    preset: Annotated[str, SchemaOf(PRESET)] | None = None
    elevation_deg: Annotated[tuple[float, ...], _table(1024, minimum=-90, maximum=90)] | None = None
    azimuth_offset_deg: Beams | None = None
    beam_time_s: Beams | None = None
    columns: Annotated[int, SchemaOf({"type": "integer", "minimum": 1, "maximum": MAX_COLUMNS})] | None = None
    column_azimuth_deg: Columns | None = None
    column_time_s: Columns | None = None
    sweep_s: NotNegative | None = None
    start_azimuth_deg: float | None = None
    direction: Annotated[int, SchemaOf({"enum": [-1, 1]})] | None = None
    time_offset_s: float | None = None
    min_range_m: NotNegative | None = None
    max_range_m: Positive | None = None


@dataclass(frozen=True)
class Sensors:
    """The sensors to render; None stands for all of the log's."""

    cameras: tuple[CameraSpec, ...] | None = None
    lidars: tuple[LidarSpec, ...] | None = None

    def placed(self) -> Iterator[tuple[str, str, CameraSpec | LidarSpec]]:
        """Yield each sensor's kind, "camera" or "lidar", its place below ``sensors``, and the sensor."""
        for i, camera in enumerate(self.cameras or ()):
            yield "camera", f"cameras[{i}]", camera
        for i, lidar in enumerate(self.lidars or ()):
            yield "lidar", f"lidars[{i}]", lidar

    def with_times(self, times_of: Callable[[CameraSpec | LidarSpec], Times | None]) -> Sensors:
        """Return the sensors with other times of their own."""
        cameras, lidars = self.cameras, self.lidars
        return Sensors(
            None if cameras is None else tuple(replace(spec, times=times_of(spec)) for spec in cameras),
            None if lidars is None else tuple(replace(spec, times=times_of(spec)) for spec in lidars),
        )


DEFS: dict[str, Schema] = {
    "sensors": members_of(
        {f"{kind}s": {"type": "array", "items": ref(kind)} for kind in ("camera", "lidar")},
        about="The sensors to render; a missing list stands for all of the log's.",
    ),
    "shutter": object_of(Shutter),
    "lens": LENS,
    "camera": object_of(CameraSpec),
    "lidar": object_of(LidarSpec),
}


def check_sensors(sensors: Sensors, place: str) -> None:
    """Raise `ScenarioError` for ids that stand twice and for places that exclude each other."""
    seen: set[tuple[str, str]] = set()
    for kind, at, spec in sensors.placed():
        here = f"{place}.{at}"
        require((kind, spec.id) not in seen, f"{here}.id", f'"{spec.id}" stands twice')
        seen.add((kind, spec.id))
        given = [name for name in ("mount", "mount_offset", "trajectory") if getattr(spec, name) is not None]
        require(len(given) <= 1, here, f"has both {' and '.join(given)}, which exclude each other")
        check_keys(spec.trajectory or (), f"{here}.trajectory")
        for member, rotation in (("mount", spec.mount), ("mount_offset", spec.mount_offset)):
            if rotation is not None:
                check_rotation(rotation, f"{here}.{member}")
