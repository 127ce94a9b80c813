"""Rows of nuScenes' tables, which name each other by tokens that follow from what they are."""

from __future__ import annotations

import hashlib
import io
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ...files import write_file
from ...geometry import FloatArray, quaternion_from_matrix
from ...json_file import json_bytes

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
