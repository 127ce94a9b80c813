"""Files of boxes: tracks of actors beside a log, as JSON. Such a file names its log, and opens as that log with these
boxes as its actors.

`boxes_schema` is the JSON Schema of the files. A track is written as one line.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, count
from pathlib import Path
from typing import Any

import numpy as np

from ..data.log import Log, extras_of
from ..errors import LogError, short
from ..files import write_file
from ..geometry import FloatArray, Trajectory, TrajectoryError, make_pose, spread_indices
from ..json_file import Node, read_json
from ..scenario.json_schema import NUMBER, POSITIVE, TEXT, Schema, members_of, numbers
from ..world.box_tracks import HALF_FRAME_S, TrackedBoxes, actor_of_boxes, actors_of_boxes
from ..world.drive import Actor, Appearance, Drive

FORMAT, VERSION = "unisim-boxes", 1
SUFFIX = ".boxes.json"
COMPARED_KEYS = 12
"""Number of the ego's places that a file has, by which boxes of another drive are recognised."""
SAME_DRIVE_M = 5.0
"""Largest distance, metres, between the ego's places in a file of boxes and in its log."""
HEAD_BYTES = 512
"""Bytes at a file's begin in which a file of boxes states its format."""
_IS_BOXES = re.compile(rb'\A\s*{\s*"format"\s*:\s*"' + FORMAT.encode() + rb'"')


@dataclass(frozen=True)
class Track:
    """An actor and where it comes from. ``certainty``: 0..1, that there is such an actor; ``source``: what saw it, as
    "lidar"; ``returns``: of sweeps inside its box, 0 where they are not counted, over ``sweeps``; ``drawn_s``: the times
    of its keys, seconds, that a person set; ``unsure``: times and certainty where following it was doubtful;
    ``dismissed``: times and kinds of doubtful places that a person looked at."""

    actor: Actor
    certainty: float = 1.0
    source: str = ""
    returns: int = 0
    sweeps: int = 0
    drawn_s: tuple[float, ...] = ()
    unsure: tuple[tuple[float, float], ...] = ()
    dismissed: tuple[tuple[float, str], ...] = ()


NOTES = ("drawn_s", "unsure", "dismissed")
"""What is noted at times of a track: these, or tuples that begin with them."""
LEAST_PATH_M = 0.5
"""A track of several moves where it gets further from its first place."""


def joined(first: Track, others: Sequence[Track]) -> Track:
    """Return one track of several: where they are at a time together, the first one counts, then the surest."""
    order = [first, *sorted(others, key=lambda track: -track.certainty)]
    keys: dict[float, FloatArray] = {}
    spans: list[tuple[float, float]] = []
    actors = [track.actor for track in order]
    for actor in actors:
        path, ends = actor.world_from_actor, np.clip([actor.start_s, actor.end_s], -1e6, 1e6).tolist()
        for time in path.times_list if actor.is_moving else ends:
            if not any(low <= time <= high for low, high in spans):
                keys[time] = path.at(time)
        spans.append((ends[0], ends[1]))
    path = Trajectory.from_poses(np.array(sorted(keys)), np.array([keys[time] for time in sorted(keys)]))
    is_moving = bool(np.linalg.norm(path.positions[:, :2] - path.positions[0, :2], axis=1).max() > LEAST_PATH_M)
    actor = replace(
        first.actor,
        world_from_actor=path if is_moving else first.actor.world_from_actor,
        start_s=min(one.start_s for one in actors),
        end_s=max(one.end_s for one in actors),
        is_moving=is_moving,
    )
    noted: dict[str, Any] = {name: tuple(sorted({at for t in order for at in getattr(t, name)})) for name in NOTES}
    counts = {name: sum(getattr(track, name) for track in order) for name in ("returns", "sweeps")}
    return replace(first, actor=actor, certainty=max(track.certainty for track in order), **counts, **noted)


def halves(track: Track, time_s: float, uid: str) -> tuple[Track, Track]:
    """Return a track up to a time, and from then on, that one with another id."""
    actor, path = track.actor, track.actor.world_from_actor
    parts = []
    for name, late, start, end in ((actor.uid, False, actor.start_s, time_s - 1e-3), (uid, True, time_s, actor.end_s)):
        times = path.times_s[(path.times_s >= time_s) == late]
        own = Trajectory.from_poses(times, path.at(times)) if actor.is_moving and len(times) else path
        part = replace(actor, uid=name, appearance=Appearance(name), start_s=start, end_s=end)
        part = replace(part, world_from_actor=own, is_moving=len(own.times_s) > 1)
        noted: dict[str, Any] = {
            note: tuple(at for at in getattr(track, note) if start <= (at[0] if isinstance(at, tuple) else at) <= end)
            for note in NOTES
        }
        parts.append(replace(track, actor=part, **noted))
    return parts[0], parts[1]


def common_times(a: Actor, b: Actor, least_s: float) -> FloatArray:
    """Return some times (9,) at which two actors are both there; (0,) where that lasts less than ``least_s``."""
    start, end = max(a.start_s, b.start_s), min(a.end_s, b.end_s)
    return np.linspace(start, end, 9 if end - start >= max(least_s, 0.0) else 0)


def unused_uid(uid: str, taken: Container[str]) -> str:
    """Return an id, with a number where it is taken."""
    return next(name for name in chain([uid], (f"{uid}-{number}" for number in count(2))) if name not in taken)


@dataclass(frozen=True)
class BoxFile:
    """Content of a file of boxes; None for what it leaves out. ``source``: what made it; ``world_origin`` (3,): see
    `Drive`; ``ego``: times (K,) and positions (K, 3) of the ego, in the world of the boxes."""

    path: Path
    tracks: tuple[Track, ...]
    source: str = ""
    log: Path | None = None
    world_origin: FloatArray | None = None
    ego: tuple[FloatArray, FloatArray] | None = None


def is_box_file(path: Path) -> bool:
    """Return whether a file states at its begin that it is a file of boxes."""
    try:
        if path.suffix != ".json" or not path.is_file():
            return False
        with path.open("rb") as file:
            return _IS_BOXES.match(file.read(HEAD_BYTES)) is not None
    except OSError:
        return False


def default_path(log: Path) -> Path:
    """Return where a log's boxes are saved by default: beside it, under its name."""
    log = log.resolve()
    return log.with_name(log.name.removesuffix(SUFFIX) + SUFFIX)


_TIMES: Schema = {"type": "array", "items": NUMBER, "minItems": 1}
_COUNT: Schema = {"type": "integer", "minimum": 0}
_BOUND: Schema = {"type": ["number", "null"]}
_MARK = members_of({"kind": TEXT, "time_s": NUMBER}, ("kind", "time_s"))


def _certainty(node: Node) -> float:
    if not 0 <= (value := node.number()) <= 1:
        node.fail(f"must be in 0..1, not {value}")
    return value


_ABOUT: dict[str, tuple[Schema, Callable[[Node], Any]]] = {
    "certainty": ({"type": "number", "minimum": 0, "maximum": 1}, _certainty),
    "source": ({"type": "string"}, Node.text),
    "returns": (_COUNT, lambda node: node.integer(at_least=0)),
    "sweeps": (_COUNT, lambda node: node.integer(at_least=0)),
    "drawn_s": (
        {"type": "array", "items": NUMBER, "description": "Times of keys that a person set."},
        lambda node: tuple(node.array(-1).tolist()),
    ),
    "unsure": (
        {"type": "array", "items": numbers(2), "description": "Times, and how certain the box is there."},
        lambda node: tuple(map(tuple, node.array(-1, 2).tolist())),
    ),
    "dismissed": (
        {"type": "array", "items": _MARK, "description": "Doubtful places that a person looked at."},
        lambda node: tuple((at.key("time_s").number(), at.key("kind").text()) for at in node.elements()),
    ),
}
"""Members of a track that may be missing, as fields of `Track`: their schemas, and functions that read them."""


def boxes_schema() -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of files of boxes."""

    def rows(count: int) -> Schema:
        return {"type": "array", "items": numbers(count), "minItems": 1}

    track = members_of(
        {
            "id": TEXT,
            "class": TEXT,
            "size_m": {**numbers(3, POSITIVE), "description": "Length, width and height."},
            "times_s": {**_TIMES, "description": "Increasing; one key stands still."},
            "positions": {**rows(3), "description": "Of the box's centre at each time."},
            "quaternions_wxyz": {**rows(4), "description": "Rotation at each time: the box looks along its x axis."},
            "start_s": {**_BOUND, "description": "When the actor comes; null: before all frames."},
            "end_s": {**_BOUND, "description": "When it goes; null: after all frames."},
            "moves": {
                "type": "boolean",
                "description": "Where it is missing, told by how far the positions lie apart.",
            },
            **{name: schema for name, (schema, _) in _ABOUT.items()},
        },
        ("id", "class", "size_m", "times_s", "positions", "quaternions_wxyz"),
    )
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": f"Boxes of a log, version {VERSION}",
        "description": "Metres, seconds from the log's first frame; world: the log's own poses, z up, re-centred on the "
        "first ego pose. Boxes: x forward, y left, z up, positions are centres. Members stand in this order.",
        **members_of(
            {
                "format": {"const": FORMAT},
                "version": {"const": VERSION},
                "log": {"type": "string", "minLength": 1, "description": "The log, relative to this file."},
                "source": {"type": "string", "description": "What made the boxes."},
                "world_origin": {**numbers(3), "description": "What was subtracted from the log's own coordinates."},
                "ego": members_of({"times_s": _TIMES, "positions": rows(3)}, ("times_s", "positions")),
                "tracks": {"type": "array", "items": track},
            },
            ("format", "version", "tracks"),
        ),
    }


def write_boxes(path: Path, log: Log, tracks: Sequence[Track], source: str) -> None:
    """Write a log's tracks, whole or not at all; they are in the world of its own poses. Raises `OutputError`."""
    ego = log.drive.world_from_ego
    keys = spread_indices(len(ego.times_s), COMPARED_KEYS)
    recorded, compared = extras_of(log).recorded or log.path, (ego.times_s[keys], ego.positions[keys])
    text = text_of(BoxFile(path, tuple(tracks), source, recorded, log.drive.world_origin, compared))
    write_file(path, text)


def text_of(boxes: BoxFile) -> str:
    """Return the text of a file of boxes."""
    head: dict[str, Any] = {"format": FORMAT, "version": VERSION}
    if boxes.log is not None:
        head["log"] = Path(os.path.relpath(boxes.log.resolve(), boxes.path.resolve().parent)).as_posix()
    head["source"] = boxes.source
    if boxes.world_origin is not None:
        head["world_origin"] = boxes.world_origin.tolist()
    if boxes.ego is not None:
        head["ego"] = dict(zip(("times_s", "positions"), (array.tolist() for array in boxes.ego), strict=True))
    lines = [f'"{name}": {json.dumps(value, allow_nan=False)}' for name, value in head.items()]
    rows = ",\n".join(json.dumps(track_to_json(track), allow_nan=False) for track in boxes.tracks)
    lines.append('"tracks": [' + (f"\n{rows}\n" if rows else "") + "]")
    return "{\n" + ",\n".join(lines) + "\n}\n"


def track_to_json(track: Track) -> dict[str, Any]:
    """Return a track as in a file of boxes."""
    actor, path = track.actor, track.actor.world_from_actor
    return {
        "id": actor.uid,
        "class": actor.label,
        "size_m": np.asarray(actor.size_m).tolist(),
        "certainty": track.certainty,
        "source": track.source,
        "moves": bool(actor.is_moving),
        "start_s": float(actor.start_s) if math.isfinite(actor.start_s) else None,
        "end_s": float(actor.end_s) if math.isfinite(actor.end_s) else None,
        "returns": track.returns,
        "sweeps": track.sweeps,
        "times_s": path.times_s.tolist(),
        "positions": path.positions.tolist(),
        "quaternions_wxyz": path.quaternions_wxyz.tolist(),
        **({"drawn_s": list(track.drawn_s)} if track.drawn_s else {}),
        **({"unsure": [list(at) for at in track.unsure]} if track.unsure else {}),
        **({"dismissed": [{"kind": kind, "time_s": at} for at, kind in track.dismissed]} if track.dismissed else {}),
    }


def read_boxes(path: Path) -> BoxFile:
    """Read a file of boxes. Raises `LogError` naming file, place and value."""
    root = Node(read_json(path, LogError), f"{path}: ", LogError)
    _check_members(root, boxes_schema())
    if root.key("format").text() != FORMAT:
        root.key("format").fail(f'must be "{FORMAT}", not {short(root.value["format"])}')
    if (version := root.key("version").integer()) != VERSION:
        root.key("version").fail(f"is {version}; this program reads {VERSION}")
    there, tracks, ego = root.object(), {}, None
    if "ego" in there:
        times = root.key("ego").key("times_s").array(-1)
        ego = times, root.key("ego").key("positions").array(len(times), 3)
    for node in root.key("tracks").elements():
        track = _track(node)
        if track.actor.uid in tracks:
            node.key("id").fail(f"{short(track.actor.uid)} is the id of an earlier track, too")
        tracks[track.actor.uid] = track
    return BoxFile(
        path,
        tuple(tracks.values()),
        root.key("source").text() if "source" in there else "",
        path.parent / root.key("log").text() if "log" in there else None,
        root.key("world_origin").array(3) if "world_origin" in there else None,
        ego,
    )


def _check_members(node: Node, schema: Schema) -> None:
    for name in node.object():
        if name not in schema["properties"]:
            node.fail(f"has a member {short(name)}, which is none of {', '.join(schema['properties'])}")


def track_from_json(value: Any, place: str) -> Track:
    """Return a track of its JSON, as in a file of boxes. Raises `LogError` naming the ``place``."""
    return _track(Node(value, place, LogError))


def _track(node: Node) -> Track:
    _check_members(node, boxes_schema()["properties"]["tracks"]["items"])
    there = node.object()
    uid, label, size_m = _text(node.key("id")), _text(node.key("class")), node.key("size_m").array(3)
    if (size_m <= 0).any():
        node.key("size_m").fail(f"must be above 0, not {size_m.tolist()}")
    times = node.key("times_s").array(-1)
    if not len(times):
        node.key("times_s").fail("is empty")
    positions, turns = node.key("positions").array(len(times), 3), node.key("quaternions_wxyz").array(len(times), 4)
    try:
        path = Trajectory(times, positions, turns)
    except TrajectoryError as fault:
        node.fail(str(fault))
    start_s, end_s = _bound(node, "start_s", -math.inf, times[0]), _bound(node, "end_s", math.inf, times[-1])
    if not start_s <= end_s:
        node.key("end_s").fail(f"{end_s} is before start_s, {start_s}")
    if "moves" in there:
        actor = Actor(uid, label, size_m, path, start_s, end_s, node.key("moves").flag(), Appearance(uid))
    else:
        actor = actor_of_boxes(uid, label, size_m, times, path.positions, path.quaternions_wxyz, (start_s, end_s))
    return Track(actor, **{name: read(node.key(name)) for name, (_, read) in _ABOUT.items() if name in there})


def _text(node: Node) -> str:
    text = node.text()
    if not 0 < len(text) <= TEXT["maxLength"]:
        node.fail(f"must be a text of 1 to {TEXT['maxLength']} letters, not {short(text)}")
    return text


def _bound(node: Node, name: str, unbounded: float, key_s: float) -> float:
    """Return when a track begins or ends; where that is missing, half a frame beyond its key."""
    if name not in node.object():
        return float(key_s) + math.copysign(HALF_FRAME_S, unbounded)
    return unbounded if node.key(name).value is None else node.key(name).number()


def tracks_of(path: Path, boxes: TrackedBoxes, source: str) -> tuple[Track, ...]:
    """Return the tracks of the boxes of a file; scores that are no fractions become such by the logistic function.
    Raises `LogError`."""
    if (boxes.uid == "").any():
        raise LogError(f"{path}: has detections, which are of no track; link them by unisim track --boxes")
    scores = np.ones(len(boxes.uid)) if boxes.score is None else boxes.score
    if len(scores) and (scores.min() < 0 or scores.max() > 1):
        scores = 1 / (1 + np.exp(-np.clip(scores, -50, 50)))
    actors = actors_of_boxes(path, boxes)
    return tuple(Track(actor, float(scores[boxes.uid == uid].mean()), source) for uid, actor in actors.items())


class BoxedLog:
    """A log with the boxes of a file as its actors. Other members are the recorded log's own."""

    def __init__(self, log: Log, boxes: BoxFile, drive: Drive) -> None:
        self._log, self._boxes, self.path, self.drive, self.missing = log, boxes, boxes.path, drive, log.missing
        self.recorded = log.path

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # a copy is asked for these before it has any member
            raise AttributeError(name)
        return getattr(self._log, name)

    def boxes_at(self, path: Path) -> str:
        """Return the text of the same file of boxes at another path."""
        return text_of(replace(self._boxes, path=path, log=self.recorded))

    @cached_property
    def files(self) -> tuple[Path, ...]:
        """The files that the log is read from, and that of the boxes."""
        recorded = self.recorded
        own = sorted(file for file in recorded.rglob("*") if file.is_file()) if recorded.is_dir() else [recorded]
        return (*(extras_of(self._log).files or own), self.path)


def boxed_log(log: Log, boxes: BoxFile) -> Log:
    """Return a log with the boxes of a file as its only actors. Raises `LogError` where they are of another drive."""
    boxes = in_world_of(boxes, log.drive)
    actors = {track.actor.uid: track.actor for track in boxes.tracks}
    boxed: Any = BoxedLog(log, boxes, replace(log.drive, actors=actors))
    other: Log = boxed
    return other


def in_world_of(boxes: BoxFile, drive: Drive) -> BoxFile:
    """Return the content of a file in the world of a drive, whose origin it may have otherwise. Raises `LogError` where
    it is of another drive."""
    shift = np.zeros(3) if boxes.world_origin is None else boxes.world_origin - drive.world_origin
    _check_same_drive(boxes, drive, shift)
    boxes = replace(boxes, world_origin=drive.world_origin)
    if not shift.any():
        return boxes
    ego = None if boxes.ego is None else (boxes.ego[0], boxes.ego[1] + shift)
    return replace(boxes, tracks=moved(boxes.tracks, lambda times: make_pose(shift, np.array([1.0, 0, 0, 0]))), ego=ego)


def moved(tracks: Sequence[Track], motion: Callable[[FloatArray], FloatArray]) -> tuple[Track, ...]:
    """Return tracks in another world, to which ``motion`` takes those of this one: from times (T,) to poses (..., 4, 4).
    What stands moves as in the middle of its time."""

    def actor(own: Actor) -> Actor:
        path = own.world_from_actor
        times = path.times_s if own.is_moving else np.array([(own.start_s + own.end_s) / 2])
        return replace(own, world_from_actor=path.transformed(left=motion(times)))

    return tuple(replace(track, actor=actor(track.actor)) for track in tracks)


def _check_same_drive(boxes: BoxFile, drive: Drive, shift: FloatArray) -> None:
    if boxes.ego is not None:
        times, places = boxes.ego
        apart = np.linalg.norm(places + shift - drive.world_from_ego.positions_at(times), axis=1)
        if (far := float(apart.max(initial=0.0))) > SAME_DRIVE_M:
            at = times[int(apart.argmax())]
            raise LogError(
                f"{boxes.path}: has boxes of another drive than {drive.name}, whose vehicle is {far:.1f} m away at {at:.1f} s"
            )
    first, last = drive.time_s[drive.frames[0]] - HALF_FRAME_S, drive.time_s[drive.frames[-1]] + HALF_FRAME_S
    spans = [(track.actor.start_s, track.actor.end_s) for track in boxes.tracks]
    if spans and all(end < first or start > last for start, end in spans):
        begin, end = min(start for start, _ in spans), max(end for _, end in spans)
        raise LogError(
            f"{boxes.path}: its boxes are there from {begin:.1f} to {end:.1f} s, the drive {drive.name} lasts from "
            f"{first + HALF_FRAME_S:.1f} to {last - HALF_FRAME_S:.1f} s"
        )
