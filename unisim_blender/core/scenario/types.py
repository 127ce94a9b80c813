"""What a scenario document holds, field by field as it stands in the file; None is a member that is not there.

Units are the document's own: metres, seconds, degrees. `docs/reference/scenario.md` says what each edit does.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar, Union

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
RECORDED = "recorded"
"""The ``scene`` of a scenario that needs no trained scene."""


@dataclass(frozen=True, kw_only=True)
class Rotation:
    """Yaw, pitch and roll in degrees, or a unit quaternion."""

    yaw_deg: float | None = None
    pitch_deg: float | None = None
    roll_deg: float | None = None
    quaternion_wxyz: Quaternion | None = None


@dataclass(frozen=True, kw_only=True)
class Placement(Rotation):
    """A pose: in the world for boxes, on the ego vehicle for sensors."""

    position: Vector


@dataclass(frozen=True, kw_only=True)
class Offset(Rotation):
    """What a sensor's mount is changed by."""

    position: Vector | None = None


@dataclass(frozen=True, kw_only=True)
class Keyframe(Placement):
    """A pose at a time or at a frame's time."""

    time_s: float | None = None
    frame: int | None = None


@dataclass(frozen=True)
class ShiftKey:
    """How far left the ego vehicle drives at a time or at a frame's time."""

    left_m: float
    time_s: float | None = None
    frame: int | None = None


@dataclass(frozen=True, kw_only=True)
class BoxSpec(Placement):
    """A box of space: its centre's pose and its edges."""

    size_m: Vector


@dataclass(frozen=True)
class Present:
    """From when to when an actor is there; an end that is not given is the drive's."""

    start_s: float | None = None
    end_s: float | None = None


@dataclass(frozen=True)
class Remove:
    """The actor is not there."""

    type: ClassVar[str] = "remove"
    actor: str


@dataclass(frozen=True)
class Duplicate:
    """A second actor with the source's look: displaced, later, or on a path of its own."""

    type: ClassVar[str] = "duplicate"
    actor: str
    id: str
    offset_m: Vector | None = None
    world_offset_m: Vector | None = None
    turn_deg: float | None = None
    time_offset_s: float | None = None
    pose: Placement | None = None
    trajectory: tuple[Keyframe, ...] | None = None
    outside: str | None = None
    present: Present | None = None


@dataclass(frozen=True)
class Insert:
    """An actor of this or of another trained scene, on a path of its own or standing still."""

    type: ClassVar[str] = "insert"
    actor: str
    id: str
    scene: str | None = None
    pose: Placement | None = None
    trajectory: tuple[Keyframe, ...] | None = None
    outside: str | None = None
    present: Present | None = None


@dataclass(frozen=True)
class InsertMesh:
    """A mesh out of a file, on a path of its own or standing still; ``label`` is its class."""

    type: ClassVar[str] = "insert_mesh"
    mesh: str
    id: str
    label: str | None = None
    pose: Placement | None = None
    trajectory: tuple[Keyframe, ...] | None = None
    outside: str | None = None
    present: Present | None = None


@dataclass(frozen=True)
class EgoBody:
    """A mesh out of a file that is the ego vehicle's body: it rides at ``mount``, and the vehicle's own sensors do not see it."""

    type: ClassVar[str] = "ego_body"
    mesh: str
    id: str
    mount: Placement
    label: str | None = None


@dataclass(frozen=True)
class Move:
    """A new trajectory, or a place to stand."""

    type: ClassVar[str] = "move"
    actor: str
    pose: Placement | None = None
    trajectory: tuple[Keyframe, ...] | None = None
    outside: str | None = None
    present: Present | None = None


@dataclass(frozen=True)
class Retime:
    """The same path at other times: later, faster, or by pairs of (scenario time, recorded time)."""

    type: ClassVar[str] = "retime"
    actor: str
    offset_s: float | None = None
    speed: float | None = None
    pivot_s: float | None = None
    map: tuple[tuple[float, float], ...] | None = None
    outside: str | None = None


@dataclass(frozen=True)
class Swap:
    """Another actor's look and box, on the same ground."""

    type: ClassVar[str] = "swap"
    actor: str
    look: str
    scene: str | None = None


@dataclass(frozen=True)
class Scale:
    """The actor's box and field larger or smaller along its own axes (forward, left, up), about its box's centre."""

    type: ClassVar[str] = "scale"
    actor: str
    factors: Vector


@dataclass(frozen=True)
class CopyStatic:
    """What stands in the box stands also at the target."""

    type: ClassVar[str] = "copy_static"
    box: str
    id: str
    target: Placement


@dataclass(frozen=True)
class RemoveStatic:
    """What stands in the box is not there."""

    type: ClassVar[str] = "remove_static"
    box: str


@dataclass(frozen=True)
class Ego:
    """The recording vehicle drives further left, or elsewhere; its sensors ride along."""

    type: ClassVar[str] = "ego"
    shift_left_m: float | None = None
    shift: tuple[ShiftKey, ...] | None = None
    trajectory: tuple[Keyframe, ...] | None = None
    outside: str | None = None


Edit = Union[  # noqa: UP007 read at run time
    Remove, Duplicate, Insert, InsertMesh, EgoBody, Move, Retime, Swap, Scale, CopyStatic, RemoveStatic, Ego
]  # fmt: skip
EDIT_TYPES = {
    kind.type: kind
    for kind in (Remove, Duplicate, Insert, InsertMesh, EgoBody, Move, Retime, Swap, Scale, CopyStatic, RemoveStatic, Ego)
}


@dataclass(frozen=True)
class TimeRange:
    """Times ``rate_hz`` a second from ``start_s``, the recording's first time where None, up to but without ``stop_s``; up to the
    recording's last time, which is one of them where the rate meets it, where ``stop_s`` is None."""

    rate_hz: float
    start_s: float | None = None
    stop_s: float | None = None


Times = Union[tuple[float, ...], TimeRange]  # noqa: UP007 read at run time
"""Seconds from the log's first frame."""


@dataclass(frozen=True)
class Shutter:
    """A rolling shutter as in `drive.RollingShutter`."""

    duration_s: float
    reference: float | None = None


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
    columns: int | None = None
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


@dataclass(frozen=True)
class FrameRange:
    """Frames from ``start`` (the first) up to but without ``stop`` (past the last)."""

    start: int | None = None
    stop: int | None = None
    step: int | None = None


@dataclass(frozen=True)
class Outside:
    """What moves before and after the recording: actors are "absent" where None, or "hold" or "continue"; so does the ego."""

    actors: str | None = None
    ego: str | None = None


@dataclass(frozen=True)
class StreetLog:
    """A street's folder, and the options of `unisim synth` that make it."""

    path: str
    street: dict[str, float | str]


@dataclass(frozen=True)
class Outputs:
    """What is written; None leaves the choice to the renderer."""

    passes: tuple[str, ...] | None = None
    formats: tuple[str, ...] | None = None
    width: int | None = None
    quality: str | None = None
    contact_shadows: bool | None = None


@dataclass(frozen=True)
class Scenario:
    """A scenario document. ``path`` is its file, which the paths in it are relative to."""

    name: str
    log: str | StreetLog
    description: str | None = None
    scene: str | None = None
    frames: tuple[int, ...] | FrameRange | None = None
    times: Times | None = None
    outside: str | Outside | None = None
    sensors: Sensors | None = None
    boxes: dict[str, BoxSpec] | None = None
    edits: tuple[Edit, ...] = ()
    outputs: Outputs | None = None
    path: Path = field(default=Path("scenario.json"), compare=False)

    def resolve(self, name: str) -> Path:
        """A path of the document, made absolute."""
        return (self.path.parent / name).resolve()

    @property
    def log_path(self) -> Path:
        """The log's folder."""
        return self.resolve(self.log if isinstance(self.log, str) else self.log.path)

    @property
    def scene_path(self) -> Path | None:
        """The trained scene's folder; None where the scenario needs none."""
        return None if self.scene in (None, RECORDED) else self.resolve(str(self.scene))
