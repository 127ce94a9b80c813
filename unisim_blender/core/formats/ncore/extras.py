"""Data without a place in NCore, in its free metadata under `unisim`: a sequence written by us reads back as it was.

It holds the frames' numbers and exact times (NCore's are whole microseconds), shutters' references, ranges and times of beam
tables, and when actors are there. A sequence of anybody else's has none, and NCore's tools pass over it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...errors import LogError
from ...json_file import MAX_INTEGER, Node
from ...lenses.lens import LensError
from ...world.classes import Motion
from ...world.drive import CameraModel, LidarModel, Readouts, RollingShutter, SpinPhase
from ...world.drive_json import arrays_to_json, read_phase, read_readouts, read_shutter

KEY, VERSION = "unisim", 1
NANOSECONDS, CLASSES, NO_CELL = "unisim_time_ns", "unisim_semantic", "unisim_no_cell"
"""Arrays beside a sweep: what its times are more than whole microseconds, its returns' classes, rays outside of the table."""
_TABLES = ("column_time_s", "beam_time_s")
_NUMBERS = ("sweep_s", "time_offset_s", "min_range_m", "max_range_m")
_START = "start_azimuth_rad"
MOTIONS: tuple[Motion, ...] = ("rigid", "deforming", "still")


@dataclass(frozen=True)
class SequenceExtras:
    """``epoch_us``: NCore's time of the drive's 0 s. ``time_s``: the drive's frames."""

    epoch_us: int
    time_s: dict[int, float]


@dataclass(frozen=True)
class SensorExtras:
    """``time_s`` of a sensor's captures, and ``ends_us``: the time by which NCore names each that was written."""

    time_s: dict[int, float]
    ends_us: dict[int, int]
    shutter: RollingShutter | None = None
    max_angle_deg: float | None = None
    sees_ego_body: bool = False
    phase: SpinPhase | None = None
    readouts: Readouts | None = None
    table: Node | None = None

    def camera(self, model: CameraModel, place: str) -> CameraModel:
        """Return a camera with what NCore has no place for. Raises `LogError`."""
        lens: Any = model.lens
        if self.max_angle_deg is not None and hasattr(lens, "max_angle_deg"):
            try:
                lens = replace(lens, max_angle_deg=self.max_angle_deg)
            except LensError as fault:
                raise LogError(f"{place}: {KEY}.max_angle_deg: {fault}") from fault
        return replace(model, lens=lens, shutter=model.shutter if self.shutter is None else self.shutter)

    def completed(self, model: LidarModel | None) -> LidarModel:
        """Return a beam table with what NCore has no place for; without one, the model of a LiDAR that has no beams."""
        assert self.table is not None
        model = model or LidarModel(np.zeros(0), np.zeros(0), columns=1)
        given: dict[str, Any] = {name: self.table.key(name).number() for name in _NUMBERS}
        if _START in self.table.object() and model.column_azimuth_rad is None:
            given[_START] = self.table.key(_START).number()
        counts = dict(zip(_TABLES, (model.columns, model.beams), strict=True))
        there = [name for name in _TABLES if name in self.table.object()]
        tables: dict[str, Any] = {name: self.table.key(name).array(counts[name]) for name in there}
        return replace(model, **given, **tables)


def sequence_json(epoch_us: int, time_s: Mapping[int, float]) -> dict[str, Any]:
    """Return the sequence's extras."""
    return {KEY: {"version": VERSION, "epoch_us": epoch_us, "time_s": _pairs(time_s)}}


def read_sequence(meta: object, place: str) -> SequenceExtras | None:
    """Return the sequence's extras; None where there are none. Raises `LogError`."""
    node = _find(meta, place)
    if node is None:
        return None
    if node.key("version").integer(at_least=1) > VERSION:
        node.key("version").fail(f"is newer than the {VERSION} that this program reads")
    time_s = _read_pairs(node.key("time_s"))
    frames = list(time_s)
    if not frames or any(a >= b for a, b in zip(frames, frames[1:], strict=False)):
        node.key("time_s").fail("must be frames whose numbers increase")
    if any(time_s[a] >= time_s[b] for a, b in zip(frames, frames[1:], strict=False)):
        node.key("time_s").fail("must be times that increase")
    return SequenceExtras(node.key("epoch_us").integer(at_least=0), time_s)


def sensor_json(
    time_s: Mapping[int, float], ends_us: Mapping[int, int], sees_ego_body: bool, **more: Any
) -> dict[str, Any]:
    """Return a sensor's extras."""
    return {KEY: {"time_s": _pairs(time_s), "ends_us": _pairs(ends_us), "sees_ego_body": sees_ego_body, **more}}


def lidar_json(model: LidarModel, phase: SpinPhase | None) -> dict[str, Any]:
    """Return what a LiDAR's extras have more."""
    tables = {name: getattr(model, name).tolist() for name in _TABLES if getattr(model, name) is not None}
    table: dict[str, Any] = {**{name: getattr(model, name) for name in _NUMBERS}, **tables}
    if model.column_azimuth_rad is None:
        table[_START] = model.start_azimuth_rad
    about: dict[str, Any] = {"table": table}
    return about if phase is None else {**about, "phase": arrays_to_json(phase)}


def camera_json(model: CameraModel, readouts: Readouts | None) -> dict[str, Any]:
    """Return what a camera's extras have more. NCore's own largest angle is that which the image reaches."""
    angle = getattr(model.lens, "max_angle_deg", None)
    return {
        "shutter": model.shutter.to_dict(),
        **({} if angle is None else {"max_angle_deg": angle}),
        **({} if readouts is None else {"readouts": arrays_to_json(readouts)}),
    }


def read_sensor(meta: object, place: str) -> SensorExtras | None:
    """Return a sensor's extras; None where there are none. Raises `LogError`."""
    node = _find(meta, place)
    if node is None:
        return None
    there = node.object()
    ends = _read_pairs(node.key("ends_us"))
    return SensorExtras(
        time_s=_read_pairs(node.key("time_s")),
        ends_us={number: int(end) for number, end in ends.items()},
        shutter=read_shutter(node.key("shutter")) if "shutter" in there else None,
        max_angle_deg=node.key("max_angle_deg").number() if "max_angle_deg" in there else None,
        sees_ego_body=node.key("sees_ego_body").flag(),
        phase=read_phase(node.key("phase")) if "phase" in there else None,
        readouts=read_readouts(node),
        table=node.key("table") if "table" in there else None,
    )


def actors_json(actors: Mapping[str, tuple[float, float, bool]], classes: Mapping[str, Motion]) -> dict[str, Any]:
    """Return the extras of cuboids: when each track's actor is there (infinite: null), whether it moves; classes' motions."""
    rows = {
        uid: [start if np.isfinite(start) else None, end if np.isfinite(end) else None, moves]
        for uid, (start, end, moves) in actors.items()
    }
    return {KEY: {"actors": rows, "classes": dict(classes)}}


def read_actors(meta: object, place: str) -> tuple[dict[str, tuple[float, float, bool]], dict[str, Motion]]:
    """Return the extras of cuboids, empty where there are none. Raises `LogError`."""
    node = _find(meta, place)
    if node is None:
        return {}, {}
    actors = {}
    for uid, row in node.key("actors").members():
        cells = list(row.elements())
        if len(cells) != 3:
            row.fail("must be a start, an end, and whether the actor moves")
        start = -np.inf if cells[0].value is None else cells[0].number()
        end = np.inf if cells[1].value is None else cells[1].number()
        actors[uid] = (start, end, cells[2].flag())
    classes: dict[str, Motion] = {}
    for label, named in node.key("classes").members():
        motion = next((motion for motion in MOTIONS if motion == named.text()), None)
        if motion is None:
            named.fail(f"must be one of {', '.join(MOTIONS)}")
        classes[label] = motion
    return actors, classes


def poses_json(added: Mapping[str, tuple[bool, bool]]) -> dict[str, Any]:
    """Return the extras of poses: of which frames the first and the last pose were added, so that poses cover the sequence."""
    return {KEY: {"added": {name: list(ends) for name, ends in added.items()}}}


def read_poses(meta: object, place: str) -> dict[str, tuple[bool, bool]]:
    """Return the extras of poses, empty where there are none. Raises `LogError`."""
    node = _find(meta, place)
    if node is None:
        return {}
    added = {}
    for name, row in node.key("added").members():
        ends = [flag.flag() for flag in row.elements()]
        if len(ends) != 2:
            row.fail("must say it of the first and of the last pose")
        added[name] = (ends[0], ends[1])
    return added


def _find(meta: object, place: str) -> Node | None:
    if not isinstance(meta, dict) or KEY not in meta:
        return None
    return Node(meta[KEY], f"{place}: {KEY}", LogError)


def _pairs(values: Mapping[int, float]) -> list[list[float]]:
    return [[number, values[number]] for number in sorted(values)]


def _read_pairs(node: Node) -> dict[int, float]:
    """The numbers of captures and what each has."""
    rows = node.array(-1, 2)
    whole = np.abs(rows[:, 0]) <= MAX_INTEGER
    if not (whole.all() and (rows[:, 0] == np.rint(rows[:, 0])).all()):
        node.fail("must be whole numbers and what each has")
    return dict(zip(rows[:, 0].astype(np.int64).tolist(), rows[:, 1].tolist(), strict=True))
