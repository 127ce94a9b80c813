"""`meta/unisim.json`: the data that PandaSet's layout has no place for, so that a log written by us reads back
unchanged.

It holds the frames, the world's and the clock's origin, the cameras' shutters and lenses, and the LiDARs' mounts and
beam tables. A log of PandaSet's own has none, and PandaSet's tools pass over it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...errors import LogError
from ...files import write_file
from ...geometry import FloatArray
from ...json_file import Node, read_json
from ...lenses import PINHOLE
from ...lenses.lens import Lens
from ...world.drive import LidarModel, Readouts, RollingShutter, SpinPhase
from ...world.drive_json import (
    arrays_to_json,
    read_lens,
    read_lidar_model,
    read_phase,
    read_readouts,
    read_shutter,
)

FORMAT, VERSION = "unisim-log", 1


@dataclass(frozen=True)
class LidarSetup:
    """A LiDAR's number in a sweep's column ``d``, its mount (4, 4), its beams, and the phase of its sweeps."""

    device: int
    ego_from_lidar: FloatArray
    model: LidarModel
    phase: SpinPhase | None = None


@dataclass(frozen=True)
class LogSetup:
    """Setup that a log of ours states; times and positions of its files less the origins are the drive's."""

    name: str
    frames: tuple[int, ...]
    time_origin_s: float
    world_origin: FloatArray
    shutters: dict[str, RollingShutter]
    lidars: dict[str, LidarSetup]
    lenses: dict[str, Lens] = field(default_factory=dict)
    """Lenses of cameras that are not ideal pinholes."""
    readouts: dict[str, Readouts] = field(default_factory=dict)
    """Readouts of cameras whose images differ in readout time."""


def setup_path(log: Path) -> Path:
    """Return the path of a log's setup file."""
    return log / "meta" / "unisim.json"


def write_setup(log: Path, setup: LogSetup) -> None:
    """Write a log's setup, float64 to the bit. Raises `OutputError`."""
    document = {
        "format": FORMAT,
        "version": VERSION,
        "name": setup.name,
        "frames": list(setup.frames),
        "time_origin_s": setup.time_origin_s,
        "world_origin": np.asarray(setup.world_origin).tolist(),
        "cameras": {
            name: {
                "shutter": shutter.to_dict(),
                **({"lens": setup.lenses[name].to_dict()} if setup.lenses.get(name, PINHOLE) != PINHOLE else {}),
                **({"readouts": arrays_to_json(setup.readouts[name])} if name in setup.readouts else {}),
            }
            for name, shutter in setup.shutters.items()
        },
        "lidars": {name: _lidar_json(lidar) for name, lidar in setup.lidars.items()},
    }
    write_file(setup_path(log), (json.dumps(document, indent=1, allow_nan=False) + "\n").encode())


def read_setup(log: Path) -> LogSetup | None:
    """Return the setup of a log; None where it has none. Raises `LogError`."""
    path = setup_path(log)
    if not path.exists():
        return None
    document = Node(read_json(path, LogError), f"{path}: ", LogError)
    if document.key("format").text() != FORMAT:
        document.key("format").fail(f'must be "{FORMAT}"')
    if document.key("version").integer(at_least=1) > VERSION:
        document.key("version").fail(f"is newer than the {VERSION} that this program reads")
    frames = tuple(node.integer(at_least=0) for node in document.key("frames").elements())
    if not frames or any(a >= b for a, b in zip(frames, frames[1:], strict=False)):
        document.key("frames").fail("must be frame numbers that increase")
    for part in ("cameras", "lidars"):
        for sensor, node in document.key(part).members():
            if not sensor or Path(sensor).name != sensor:
                node.fail("is no sensor's name, which is a folder's")
    readouts = {name: read_readouts(node) for name, node in document.key("cameras").members()}
    return LogSetup(
        name=document.key("name").text(),
        frames=frames,
        time_origin_s=document.key("time_origin_s").number(),
        world_origin=document.key("world_origin").array(3),
        shutters={name: read_shutter(node.key("shutter")) for name, node in document.key("cameras").members()},
        lidars={name: _read_lidar(node) for name, node in document.key("lidars").members()},
        lenses={name: read_lens(node) for name, node in document.key("cameras").members()},
        readouts={name: times for name, times in readouts.items() if times is not None},
    )


def _lidar_json(lidar: LidarSetup) -> dict[str, object]:
    mount, phase = lidar.ego_from_lidar.tolist(), lidar.phase
    about = {"device": lidar.device, "ego_from_lidar": mount, "model": arrays_to_json(lidar.model)}
    return about if phase is None else {**about, "phase": arrays_to_json(phase)}


def _read_lidar(node: Node) -> LidarSetup:
    device, mount = node.key("device").integer(at_least=0), node.key("ego_from_lidar").pose()
    phase = read_phase(node.key("phase")) if "phase" in node.object() else None
    return LidarSetup(device, mount, read_lidar_model(node.key("model")), phase)
