"""Scenarios and meshes that both trees render, written once."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

# trees from before and after a renaming read the former names that are written here: ``support``, and ``look``
# of # a # swap
PASSES = ["rgb", "depth", "normal", "instance", "opacity", "support"]
FEW_BEAMS = {
    "id": "few",
    "elevation_deg": [2.0, -1.0, -4.0, -9.0, -15.0, -22.0],
    "columns": 60,
    "mount": {"position": [0.8, 0.0, 1.9]},
}
"""A LiDAR whose turn costs little, so that plain torch can render it, too."""
FRONT = {"id": "front_camera"}
ROADSIDE = {
    "id": "roadside",
    "width": 480,
    "height": 270,
    "horizontal_fov_deg": 70,
    "shutter": {"duration_s": 0.04, "reference": 0.5},
    "trajectory": [
        {"time_s": 0.0, "position": [2.0, 5.0, 2.6], "yaw_deg": -25, "pitch_deg": -8},
        {"time_s": 0.3, "position": [3.0, 5.0, 2.6], "yaw_deg": -20, "pitch_deg": -8},
    ],
}
"""A camera with its own trajectory, which sees the ego vehicle's body and exposes its rows one after the other."""


def write_inputs(folder: Path, scene: Path, log: Path) -> None:
    """Write all scenarios into ``folder``, those of the sample beside two copies of its trained ``scene``; the others
    read the log at ``log``, which need not be there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    for copy in ("scene", "other"):
        shutil.copytree(scene, folder / copy, dirs_exist_ok=True)
    (folder / "block.ply").write_text(_block())
    sample = {"log": "no log", "scene": "scene"}
    recorded = {"log": str(log)}
    documents: dict[str, dict[str, Any]] = {
        "plain": {**sample, "sensors": {"cameras": [FRONT], "lidars": [FEW_BEAMS, {"id": "pandar64"}]}, "edits": []},
        "edited": {**sample, "sensors": {"cameras": [FRONT], "lidars": [FEW_BEAMS]}, "edits": _sample_edits()},
        "busy": {
            **sample,
            "sensors": {"cameras": [FRONT, ROADSIDE], "lidars": [FEW_BEAMS]},
            "boxes": _boxes(),
            "edits": _busy_edits(),
        },
        "replayed": {**recorded, "scene": "scene", "sensors": {"cameras": [FRONT], "lidars": [FEW_BEAMS]}, "edits": []},
        "log": {**recorded, "sensors": {"cameras": [FRONT], "lidars": [FEW_BEAMS]}, "edits": []},
        "log-edited": {
            **recorded,
            "sensors": {"cameras": [FRONT, ROADSIDE], "lidars": [FEW_BEAMS]},
            "boxes": _boxes(),
            "edits": _log_edits(),
        },
        "log-guest": {
            **recorded,
            "sensors": {"cameras": [FRONT], "lidars": [FEW_BEAMS]},
            "edits": [_foreign_actor("scene")],
        },
    }
    for name, document in documents.items():
        outputs = {"passes": PASSES, "contact_shadows": name in ("busy", "log-edited", "log-guest")}
        whole = {"format": "unisim-scenario", "version": 1, "name": name, **document, "outputs": outputs}
        (folder / f"{name}.json").write_text(json.dumps(whole, indent=1))


def _sample_edits() -> list[dict[str, Any]]:
    """As in `sample/scenario.json`: what is there changes, and the sensors follow another trajectory."""
    return [
        {"type": "remove", "actor": "car-12"},
        {"type": "duplicate", "actor": "cone-3", "id": "cone-copy", "world_offset_m": [-1.5, 1.2, 0.0]},
        {"type": "retime", "actor": "car-03", "offset_s": 0.6, "outside": "continue"},
        {
            "type": "insert",
            "actor": "car-13",
            "id": "car-new",
            "pose": {"position": [32.0, 6.2, 0.725], "yaw_deg": 180.0},
        },
        {
            "type": "ego",
            "shift": [{"frame": 0, "left_m": 0.0}, {"frame": 10, "left_m": 1.0}, {"frame": 16, "left_m": 2.0}],
        },
    ]


def _busy_edits() -> list[dict[str, Any]]:
    """Every type of edit, with presences that begin and end within the drive."""
    return [
        *_sample_edits(),
        _foreign_actor("other"),
        _mesh(),
        {"type": "ego_body", "mesh": "block.ply", "id": "body", "mount": {"position": [1.4, 0.0, 0.8]}},
        {"type": "scale", "actor": "car-01", "factors": [1.2, 1.0, 1.4]},
        {"type": "swap", "actor": "car-10", "look": "car-05"},
        {
            "type": "move",
            "actor": "car-14",
            "trajectory": [
                {"time_s": 0.0, "position": [24.0, 2.0, 0.725], "yaw_deg": 170},
                {"time_s": 1.9, "position": [14.0, 3.0, 0.725], "yaw_deg": 190},
            ],
            "present": {"start_s": 0.3, "end_s": 1.25},
        },
        {
            "type": "copy_static",
            "box": "kerb",
            "id": "kerb-copy",
            "target": {"position": [20.0, 1.5, 1.0], "yaw_deg": 20},
        },
        {"type": "remove_static", "box": "kerb"},
    ]


def _log_edits() -> list[dict[str, Any]]:
    """Edits that a log of four frames has room for."""
    return [
        {"type": "remove", "actor": "car-07"},
        {"type": "duplicate", "actor": "cone-3", "id": "cone-copy", "world_offset_m": [-1.5, 1.2, 0.0]},
        {"type": "retime", "actor": "car-03", "offset_s": 0.1, "outside": "continue"},
        {"type": "scale", "actor": "car-01", "factors": [1.2, 1.0, 1.4]},
        {
            "type": "move",
            "actor": "car-09",
            "pose": {"position": [14.0, 2.0, 0.725], "yaw_deg": 170},
            "present": {"start_s": 0.05, "end_s": 0.25},
        },
        _mesh(),
        {
            "type": "copy_static",
            "box": "kerb",
            "id": "kerb-copy",
            "target": {"position": [20.0, 1.5, 1.0], "yaw_deg": 20},
        },
        {"type": "remove_static", "box": "kerb"},
        {"type": "ego", "shift_left_m": 0.7},
    ]


def _boxes() -> dict[str, Any]:
    return {"kerb": {"position": [22.0, -5.0, 1.0], "yaw_deg": 10, "size_m": [4.0, 3.0, 2.0]}}


def _foreign_actor(scene: str) -> dict[str, Any]:
    """An actor of another trained scene."""
    keys = [
        {"time_s": 0.0, "position": [20.0, 3.4, 0.9], "yaw_deg": 180},
        {"time_s": 0.3, "position": [17.0, 3.4, 0.9], "yaw_deg": 175},
    ]
    return {"type": "insert", "actor": "car-03", "scene": scene, "id": "guest", "trajectory": keys}


def _mesh() -> dict[str, Any]:
    return {
        "type": "insert_mesh",
        "mesh": "block.ply",
        "id": "block",
        "label": "Car",
        "trajectory": [
            {"time_s": 0.0, "position": [12.0, -0.5, 0.7], "yaw_deg": 30},
            {"time_s": 0.3, "position": [13.0, -0.2, 0.7], "yaw_deg": 45},
        ],
    }


def _block() -> str:
    """A slanted block with colours at its corners, as text PLY."""
    corners = [(x * 1.2, y * 0.7 * (1 - 0.3 * (z > 0)), z * 0.7) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    colours = [(40 + 30 * i, 230 - 25 * i, 60 + 90 * (i % 3)) for i in range(8)]
    squares = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in squares for face in ((a, b, c), (a, c, d))]
    properties = [
        *(f"property float {axis}" for axis in "xyz"),
        *(f"property uchar {c}" for c in ("red", "green", "blue")),
    ]
    head = ["ply", "format ascii 1.0", f"element vertex {len(corners)}", *properties, f"element face {len(faces)}"]
    head += ["property list uchar int vertex_indices", "end_header"]
    rows = [" ".join(map(str, (*corner, *colour))) for corner, colour in zip(corners, colours, strict=True)]
    return "\n".join([*head, *rows, *("3 " + " ".join(map(str, face)) for face in faces)]) + "\n"
