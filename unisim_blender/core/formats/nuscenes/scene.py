"""One scene of nuScenes' tables: its sensors with their captures, the vehicle's poses, and its boxes."""

from __future__ import annotations

import hashlib
import io
import json
import os
import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...data.image_files import files_by_stem, image_suffixes
from ...errors import LogError, in_a_line, refused
from ...files import write_file
from ...geometry import FloatArray, make_pose, quaternion_from_matrix
from ...json_file import Node, check_finite, json_bytes, read_json
from . import find_tables

LIDAR = "LIDAR_TOP"
KINDS = ("camera", "lidar")
"""Radars are passed over."""


@dataclass
class SensorRows:
    """A sensor of a scene: its mount (4, 4) in the ego frame, and its captures in the order of time.

    ``intrinsics``: (3, 3), of a camera. ``stamps_us`` (K,), ``files`` (K,), ``there`` (K,): whether the file exists.
    """

    ego_from_sensor: FloatArray
    intrinsics: FloatArray | None
    width: int
    height: int
    stamps_us: NDArray[np.int64]
    files: list[Path]
    there: list[bool]


@dataclass
class BoxRows:
    """Boxes of key frames, N: track, class (N,) texts, when their sample was taken (N,), pose (N, 4, 4) in the map's frame, size
    (N, 3): length, width, height; score (N,) of results, of annotations none."""

    uid: list[str] = field(default_factory=list)
    label: list[str] = field(default_factory=list)
    stamp_us: list[int] = field(default_factory=list)
    pose: list[FloatArray] = field(default_factory=list)
    size_m: list[FloatArray] = field(default_factory=list)
    score: list[float] = field(default_factory=list)


@dataclass
class NuScenesScene:
    """A scene; the vehicle's poses (T, 4, 4) in the map's frame at ``pose_stamps_us`` (T,), in order; the times of
    ``samples``, microseconds, by their tokens."""

    name: str
    description: str
    tables: Path
    sensors: dict[str, SensorRows]
    pose_stamps_us: NDArray[np.int64]
    poses: FloatArray
    samples: dict[str, int]
    boxes: BoxRows


def read_scene(path: Path) -> NuScenesScene:
    """Return the scene that a path stands for; see `layout.find_tables`. Raises `LogError`."""
    root, folders, file = find_tables(path)
    tables, scene = _chosen(path, folders, file)
    name, token = scene.key("name").text(), scene.key("token").text()
    description = str(scene.object().get("description", ""))
    samples = {row.key("token").text(): row for row in rows(tables / "sample.json", "scene_token", {token})}
    if not samples:
        raise LogError(f"{tables / 'sample.json'}: has no sample of {name}")
    data = list(rows(tables / "sample_data.json", "sample_token", samples))
    mounts = by_token(tables / "calibrated_sensor.json", {row.key("calibrated_sensor_token").text() for row in data})
    kinds = by_token(tables / "sensor.json", {row.key("sensor_token").text() for row in mounts.values()})
    captures: dict[str, list[Node]] = {}
    for row in data:
        kind = kinds[mounts[row.key("calibrated_sensor_token").text()].key("sensor_token").text()]
        if kind.key("modality").text() in KINDS:
            captures.setdefault(kind.key("channel").text(), []).append(row)
    if LIDAR not in captures:
        raise LogError(f"{tables / 'sample_data.json'}: has no sweep of {LIDAR} in {name}")
    used = {row.key("ego_pose_token").text() for parts in captures.values() for row in parts}
    stamps, poses = _poses(by_token(tables / "ego_pose.json", used))
    sensors = {channel: _sensor(root, channel, parts, mounts) for channel, parts in sorted(captures.items())}
    taken = {token: row.key("timestamp").integer(at_least=0) for token, row in samples.items()}
    return NuScenesScene(name, description, tables, sensors, stamps, poses, taken, _boxes(tables, taken))


def _chosen(path: Path, folders: Collection[Path], file: str) -> tuple[Path, Node]:
    """The folder of tables, and the row of the scene."""
    if not folders:
        raise LogError(f"{path}: has no folder of tables with sample_data.json")
    if file:
        for tables in folders:
            for row in rows(tables / "sample_data.json", "filename", {file}):
                sample = by_token(tables / "sample.json", {row.key("sample_token").text()})
                token = next(iter(sample.values())).key("scene_token").text()
                return tables, by_token(tables / "scene.json", {token})[token]
        raise LogError(f"{path}: is in no table of {', '.join(str(tables) for tables in folders)}")
    scenes = [(tables, scene) for tables in folders for scene in rows(tables / "scene.json", "token")]
    if len(scenes) != 1:
        names = ", ".join(scene.key("name").text() for _, scene in scenes[:3])
        raise LogError(
            f"{path}: holds {len(scenes)} scenes ({names}{', ...' if len(scenes) > 3 else ''}); a file of samples/{LIDAR} "
            "stands for its own"
        )
    return scenes[0]


def _pose(row: Node) -> FloatArray:
    return make_pose(row.key("translation").array(3), quaternion(row.key("rotation")))


def _poses(pose_rows: dict[str, Node]) -> tuple[NDArray[np.int64], FloatArray]:
    """Poses at increasing stamps: of several at one stamp the first."""
    stamps = np.array([row.key("timestamp").integer(at_least=0) for row in pose_rows.values()], np.int64)
    poses = np.stack([_pose(row) for row in pose_rows.values()])
    stamps, first = np.unique(stamps, return_index=True)
    return stamps, poses[first]


def _sensor(root: Path, channel: str, parts: list[Node], mounts: dict[str, Node]) -> SensorRows:
    tokens = {row.key("calibrated_sensor_token").text() for row in parts}
    if len(tokens) > 1:
        parts[0].fail(f"{channel} has {len(tokens)} calibrations in one scene")
    mount = mounts[tokens.pop()]
    order = sorted(parts, key=lambda row: row.key("timestamp").integer(at_least=0))
    stamps = np.array([row.key("timestamp").integer() for row in order], np.int64)
    late = np.flatnonzero(np.diff(stamps) <= 0)
    if len(late):
        order[int(late[0]) + 1].key("timestamp").fail(f"of {channel} stands there twice")
    files = [_inside(root, row.key("filename")) for row in order]
    present: dict[Path, set[str]] = {}
    for file in files:
        if file.parent not in present:
            present[file.parent] = set(os.listdir(file.parent)) if file.parent.is_dir() else set()
    is_camera = bool(mount.key("camera_intrinsic").value)
    if is_camera:  # copies of the dataset with images packed anew keep its tables
        packed = {parent: files_by_stem(parent, image_suffixes(".jpg")) for parent, names in present.items()}
        files = [
            file if file.name in present[file.parent] else packed[file.parent].get(file.stem, file) for file in files
        ]
    return SensorRows(
        ego_from_sensor=_pose(mount),
        intrinsics=_intrinsics(mount.key("camera_intrinsic")) if is_camera else None,
        width=order[0].key("width").integer(at_least=1) if is_camera else 0,
        height=order[0].key("height").integer(at_least=1) if is_camera else 0,
        stamps_us=stamps,
        files=files,
        there=[file.name in present[file.parent] for file in files],
    )


def _inside(root: Path, name: Node) -> Path:
    parts = PurePosixPath(name.text()).parts
    if not parts or ".." in parts or name.text().startswith("/") or "\\" in name.text():
        name.fail("is no file inside the dataset's folder")
    return root.joinpath(*parts)


def _intrinsics(node: Node) -> FloatArray:
    values = node.array(3, 3)
    if not (values[0, 0] > 0 and values[1, 1] > 0):
        node.fail("has focal lengths that are not positive")
    return values


def _boxes(tables: Path, stamps: dict[str, int]) -> BoxRows:
    boxes = BoxRows()
    annotations = list(rows(tables / "sample_annotation.json", "sample_token", stamps))
    instances = by_token(tables / "instance.json", {row.key("instance_token").text() for row in annotations})
    categories = by_token(tables / "category.json", {row.key("category_token").text() for row in instances.values()})
    labels = {
        token: categories[row.key("category_token").text()].key("name").text() for token, row in instances.items()
    }
    for row in sorted(annotations, key=lambda row: stamps[row.key("sample_token").text()]):
        width, length, height = row.key("size").array(3)
        if not min(width, length, height) > 0:
            row.key("size").fail("is not positive")
        uid = row.key("instance_token").text()
        boxes.uid.append(uid)
        boxes.label.append(labels[uid])
        boxes.stamp_us.append(stamps[row.key("sample_token").text()])
        boxes.pose.append(_pose(row))
        boxes.size_m.append(np.array([length, width, height]))
    return boxes


VERSION_FOLDER = "v1.0-mini"
"""That which the dataset's own tools open where nothing else is asked for."""
MAP_FILE = "maps/none.png"
TABLES = (
    "attribute", "calibrated_sensor", "category", "ego_pose", "instance", "log", "map", "sample", "sample_annotation",
    "sample_data", "scene", "sensor", "visibility",
)  # fmt: skip
ATTRIBUTES = ("vehicle.moving", "vehicle.parked", "pedestrian.moving", "pedestrian.standing")
VISIBILITIES = ("v0-40", "v40-60", "v60-80", "v80-100")
SPLIT = "converted"
"""A split of this scene alone, which newer versions of the dataset's own tools find in `splits.json`."""
LISTED = "scene-0103"
"""The name that a scene gets which has none of the dataset's form: predefined splits list it in mini_val and val."""
TableRow = dict[str, Any]


def token(*what: object) -> str:
    """Return the token, 32 hexadecimal digits, of a thing."""
    return hashlib.md5("\0".join(map(str, what)).encode(), usedforsecurity=False).hexdigest()


def scene_name(drive: str) -> str:
    """Return the name of a drive's scene: the drive's own where it is of the dataset's form, "scene-0061"."""
    return drive if re.fullmatch(r"scene-\d{4}", drive) else LISTED


def place_of(pose: FloatArray) -> TableRow:
    """Return a pose (4, 4) as rows have it."""
    return {"translation": pose[:3, 3].tolist(), "rotation": quaternion_from_matrix(pose[:3, :3]).tolist()}


def attribute_of(category: str, is_moving: bool) -> list[str]:
    """Return the tokens of what an object of a category does; none where the dataset has no word for it, or it is not known."""
    if category.startswith("vehicle.") and not category.startswith(("vehicle.bicycle", "vehicle.motorcycle")):
        return [token("attribute", "vehicle.moving" if is_moving else "vehicle.parked")]
    if category.startswith("human.pedestrian."):
        return [token("attribute", "pedestrian.moving" if is_moving else "pedestrian.standing")]
    return []


def visibility_of(hidden: float) -> str:
    """Return the token of an object's visibility, of which that share is hidden; the lowest for NaN, where nothing tells."""
    seen = 0.0 if np.isnan(hidden) else 1.0 - hidden
    return str(1 + int(seen > 0.4) + int(seen > 0.6) + int(seen > 0.8))


def chained(rows: Sequence[TableRow]) -> list[TableRow]:
    """Return rows, in order, each with the tokens of the one before and the one after."""
    tokens = ["", *(row["token"] for row in rows), ""]
    return [{**row, "prev": tokens[at], "next": tokens[at + 2]} for at, row in enumerate(rows)]


def write_tables(root: Path, rows: dict[str, list[TableRow]]) -> None:
    """Write the tables of one scene, and those that every scene has, to the dataset's folder. Raises `OutputError`."""
    scene = rows["scene"][0]
    fixed: dict[str, list[TableRow]] = {
        "attribute": [{"token": token("attribute", name), "name": name, "description": ""} for name in ATTRIBUTES],
        "visibility": [
            {"token": str(at), "level": level, "description": ""} for at, level in enumerate(VISIBILITIES, 1)
        ],
        "log": [
            {"token": scene["log_token"], "logfile": scene["description"], "vehicle": "", "date_captured": "1970-01-01",
             "location": "unknown"}
        ],
        "map": [
            {"token": token("map"), "log_tokens": [scene["log_token"]], "category": "semantic_prior",
             "filename": MAP_FILE}
        ],
    }  # fmt: skip
    buffer = io.BytesIO()
    Image.fromarray(np.zeros((16, 16), np.uint8)).save(buffer, "PNG")
    write_file(root / MAP_FILE, buffer.getvalue())
    write_file(root / VERSION_FOLDER / "splits.json", json_bytes({SPLIT: [scene["name"]]}))
    for table in TABLES:
        # the last: a folder with it is taken for a dataset
        if table != "sample_data":
            write_file(root / VERSION_FOLDER / f"{table}.json", json_bytes({**fixed, **rows}[table]))
    write_file(root / VERSION_FOLDER / "sample_data.json", json_bytes(rows["sample_data"]))


WHOLE_BYTES = 32 * 2**20
PIECE_BYTES = 8 * 2**20
_ROW = re.compile(r"\{[^{}]*\}")
"""Rows hold no objects."""


def rows(path: Path, key: str, wanted: Collection[str] | None = None) -> Iterator[Node]:
    """Give the rows of a table whose ``key`` is one of the ``wanted`` texts; all where that is None. Raises `LogError`."""
    for row in _all(path, key, wanted):
        if wanted is None or row.key(key).text() in wanted:
            yield row


def by_token(path: Path, wanted: Collection[str] | None = None) -> dict[str, Node]:
    """Return rows by their tokens. Raises `LogError` for wanted ones that are missing."""
    by_name = {row.key("token").text(): row for row in rows(path, "token", wanted)}
    absent = [token for token in wanted or () if token not in by_name]
    if absent:
        raise LogError(f"{path}: has no row {absent[0]!r}" + (f", nor {len(absent) - 1} others" if absent[1:] else ""))
    return by_name


def _all(path: Path, key: str, wanted: Collection[str] | None) -> Iterator[Node]:
    try:
        size = path.stat().st_size
    except FileNotFoundError as error:
        raise LogError(f"{path}: is missing") from error
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error
    if size <= WHOLE_BYTES or wanted is None:
        yield from Node(read_json(path, LogError), f"{path}: ", LogError).elements()
        return
    name = re.compile(rf'"{re.escape(key)}"\s*:\s*"([^"]*)"')
    for number, text in enumerate(_rows_as_text(path)):
        match = name.search(text)
        if match is None or match.group(1) not in wanted:
            continue
        try:
            row = json.loads(text)
        except ValueError as error:
            raise LogError(f"{path}: row {number} is not valid JSON: {in_a_line(error)}") from error
        check_finite(row, f"{path}: [{number}]", LogError)
        yield Node(row, f"{path}: [{number}]", LogError)


def _rows_as_text(path: Path) -> Iterator[str]:
    rest = ""
    with refused(path, "read", LogError), path.open(encoding="utf-8") as stream:
        while piece := stream.read(PIECE_BYTES):
            text = rest + piece
            end = 0
            for match in _ROW.finditer(text):
                end = match.end()
                yield match.group()
            rest = text[end:]
            if len(rest) > PIECE_BYTES:
                raise LogError(f"{path}: is no table of rows")
    if not rest.strip().endswith("]"):
        raise LogError(f"{path}: is cut off")


def quaternion(node: Node) -> Any:
    """Return a rotation (4,), w x y z, of length 1. Raises `LogError`."""
    values = node.array(4)
    length = float((values @ values) ** 0.5)
    if abs(length - 1) > 1e-3:
        node.fail(f"has length {length:.6g}, not 1")
    return values / length
