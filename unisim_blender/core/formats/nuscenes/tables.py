"""nuScenes' JSON tables: rows by their tokens, those alone that a scene needs.

A small table is read whole. A large one (that of all of v1.0-trainval's files has a gigabyte) is read in pieces, of which rows
that name none of the wanted tokens are passed over unread.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ...errors import LogError, in_a_line
from ...files import write_file
from ...geometry import FloatArray, quaternion_from_matrix
from ...json_file import Node, check_finite, json_bytes, read_json

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
    found = {row.key("token").text(): row for row in rows(path, "token", wanted)}
    absent = [token for token in wanted or () if token not in found]
    if absent:
        raise LogError(f"{path}: has no row {absent[0]!r}" + (f", nor {len(absent) - 1} others" if absent[1:] else ""))
    return found


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
        found = name.search(text)
        if found is None or found.group(1) not in wanted:
            continue
        try:
            row = json.loads(text)
        except ValueError as error:
            raise LogError(f"{path}: row {number} is not valid JSON: {in_a_line(error)}") from error
        check_finite(row, f"{path}: [{number}]", LogError)
        yield Node(row, f"{path}: [{number}]", LogError)


def _rows_as_text(path: Path) -> Iterator[str]:
    rest = ""
    try:
        with path.open(encoding="utf-8") as stream:
            while piece := stream.read(PIECE_BYTES):
                text = rest + piece
                end = 0
                for found in _ROW.finditer(text):
                    end = found.end()
                    yield found.group()
                rest = text[end:]
                if len(rest) > PIECE_BYTES:
                    raise LogError(f"{path}: is no table of rows")
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise LogError(f"{path}: is not UTF-8 text (byte {error.start})") from error
    if not rest.strip().endswith("]"):
        raise LogError(f"{path}: is cut off")


def quaternion(node: Node) -> Any:
    """Return a rotation (4,), w x y z, of length 1. Raises `LogError`."""
    values = node.array(4)
    length = float((values @ values) ** 0.5)
    if abs(length - 1) > 1e-3:
        node.fail(f"has length {length:.6g}, not 1")
    return values / length
