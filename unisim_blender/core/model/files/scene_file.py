"""`scene.json`, the readable half of a trained scene: what it was trained on, its configuration and its refined drive.

The weights lie beside it in `weights.safetensors`. Every float64 survives writing and reading bit for bit.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...data.fingerprint import Fingerprint
from ...data.own_vehicle import check_outlines
from ...errors import SceneError, short
from ...geometry import FloatArray
from ...json_file import Node, parse_json, read_bytes, write_text
from ...world.drive import Box, Drive
from ...world.drive_json import drive_to_json, read_drive
from ...world.replay import parked_boxes
from ..config import ModelConfig

FORMAT = "unisim-scene"
VERSION = 1
HEADER_NAME = "scene.json"
WEIGHTS_NAME = "weights.safetensors"


@dataclass(frozen=True)
class SceneHeader:
    """Contents of `scene.json`. ``path`` is the scene's folder; ``drive`` has the refined tracklets and camera poses.

    ``model``, ``volume`` and ``training`` are free dictionaries that the trainer writes and the loader reads.
    ``weights`` is the SHA-256 of the weights that the header belongs to, "" where it is not known. ``fingerprint``
    tells whether a log is of the drive that the scene was trained on; None in scenes of versions that did not keep one.
    """

    path: Path
    name: str
    log_name: str
    log_path: str
    world_origin: FloatArray
    model: dict[str, Any]
    volume: dict[str, Any]
    drive: Drive
    training: dict[str, Any]
    weights: str = ""
    fingerprint: Fingerprint | None = None

    @property
    def method(self) -> str:
        """The method that the scene was trained by. Scenes of versions that did not store it are told
        by their shapes."""
        if "method" in self.training:
            return str(self.training["method"])
        if self.model.get("density") != "volume":
            return "neural"
        return "ngp" if self.model.get("actors") == "none" else "nsg"

    @property
    def parked(self) -> dict[str, Box]:
        """Boxes of actors that stood still throughout the recording, by their ids: the static field does not hold them.
        A scene that is one field holds everything, so it has none."""
        return {} if ModelConfig.from_dict(self.model).actors == "none" else parked_boxes(self.drive)


def header_path(path: Path) -> Path:
    """The header's file, given the scene's folder or the file itself."""
    path = Path(path)
    return path if path.suffix == ".json" else path / HEADER_NAME


def read_scene_header(path: Path) -> SceneHeader:
    """Read the header of the scene in folder ``path``. Raises `SceneError` naming the file and the value at fault."""
    return read_header(path)[0]


def read_header(path: Path) -> tuple[SceneHeader, str]:
    """Read the header of the scene in folder ``path``, and the SHA-256 of its file in hexadecimal. Raises `SceneError`."""
    file = header_path(path)
    content = read_bytes(file, SceneError)
    document = Node(parse_json(content, file, SceneError), f"{file}: ", SceneError)
    return _header(file, document), hashlib.sha256(content).hexdigest()


def _header(file: Path, document: Node) -> SceneHeader:
    if document.object().get("format") != FORMAT:
        raise SceneError(
            f'{file}: is no trained scene: its format is {short(document.value.get("format"))}, not "{FORMAT}"'
        )
    version = document.key("version").integer(at_least=1)
    if version > VERSION:
        raise SceneError(f"{file}: has version {version}, newer than the {VERSION} that this program reads")
    log, drive = document.key("log"), read_drive(document.key("drive"))
    if not drive.frames:
        document.key("drive").key("time_s").fail("a drive needs at least one frame")
    return SceneHeader(
        path=file.parent,
        name=document.key("name").text(),
        log_name=log.key("name").text(),
        log_path=log.key("path").text(),
        world_origin=document.key("world_origin").array(3),
        model=document.key("model").object(),
        volume=document.key("volume").object(),
        drive=drive,
        training=_read_training(document.key("training")),
        weights=document.key("weights").text() if "weights" in document.object() else "",
        fingerprint=Fingerprint.from_json(log.key("fingerprint")) if "fingerprint" in log.object() else None,
    )


def _read_training(node: Node) -> dict[str, Any]:
    """A trainer's dictionary, whose members that a renderer reads are what they should be where they are there."""
    there = node.object()
    for name in ("cameras", "lidars", "without"):
        for child in node.key(name).elements() if name in there else ():
            child.text()
    for child in node.key("frames").elements() if "frames" in there else ():
        child.integer()
    if there.get("width") is not None:
        node.key("width").integer(at_least=1)
    if "method" in there:
        node.key("method").text()
    for name in ("iterations", "seed"):
        if name in there:
            node.key(name).integer()
    if "seconds" in there:
        node.key("seconds").number()
    if there.get("own_vehicle") is not None:
        check_outlines(node.key("own_vehicle"))
    return there


def write_scene_header(path: Path, header: SceneHeader) -> None:
    """Write the header into folder ``path``, whole or not at all. Raises `SceneError`, also for numbers
    that are not finite."""
    file = header_path(path)
    document = {
        "format": FORMAT,
        "version": VERSION,
        "name": header.name,
        "log": {"name": header.log_name, "path": header.log_path}
        | ({} if header.fingerprint is None else {"fingerprint": header.fingerprint.to_json()}),
        "world_origin": np.asarray(header.world_origin, np.float64).tolist(),
        "model": header.model,
        "volume": header.volume,
        "training": header.training,
        "weights": header.weights,
        "drive": drive_to_json(header.drive),
    }
    lines = []
    for key, value in document.items():
        try:
            lines.append(f" {json.dumps(key)}: {json.dumps(value, allow_nan=False)}")
        except (TypeError, ValueError) as fault:
            raise SceneError(f"{file}: {key} cannot be written as JSON: {fault}") from fault
    write_text(file, "{\n" + ",\n".join(lines) + "\n}\n", SceneError)
