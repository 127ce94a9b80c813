"""Estimates from a drive's sweeps of what its files do not state: beams, the spin, and poses where there are none.

They are stored for later in the user's cache by the names, sizes and times of the files that they depend on.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from ...errors import LogError, OutputError
from ...files import cache_folder, file_stamp, write_file
from ...geometry import Trajectory
from ...json_file import Node, read_json
from ...world.drive import LidarModel
from .beams import KittiBeams, assign_columns, assign_rings, find_beams
from .files import PERIOD_S, KittiFiles, read_points
from .registration.planes import SweepPlanes, find_planes
from .registration.register import Registered, register
from .spin import STATED, WORDS, PlanePoints, Spin, fit_spin, point_times

VERSION = 1
"""Counted on whenever what is found changes: what an older program kept is found anew."""
BEAM_SWEEPS = 4
TRIED_SWEEPS = 20
"""The spin is told by so many sweeps in the middle of the drive."""

SPIN_EVERY = 3
"""Every third column of a sweep tells the spin well enough."""


@dataclass(frozen=True)
class LidarCalibration:
    """Beams and spin of the LiDAR; its poses where the drive has none, with the sentence on how sure they are."""

    beams: KittiBeams
    spin: Spin
    trajectory: Trajectory | None
    sentence: str


def find(
    path: Path, files: KittiFiles, world_from_lidar: Trajectory | None, stated: LidarModel | None = None
) -> LidarCalibration | None:
    """Return what the sweeps tell, ``world_from_lidar`` given where the drive has poses, and ``stated`` where it says which way
    the LiDAR turns, and which beams it has, if any; None where there are no sweeps.

    Raises `LogError`.
    """
    if not files.sweeps:
        return None
    direction = None if stated is None else stated.direction
    if stated is not None and stated.beams and world_from_lidar is not None:
        flat = np.zeros(stated.beams)
        beams = KittiBeams(stated.elevation_rad, flat, stated.azimuth_offset_rad, stated.columns, stated=True)
        return LidarCalibration(beams, _stated_spin(stated.direction), None, "")
    kept = cache_folder() / "kitti" / f"{_identity(files, world_from_lidar, direction)}.json"
    if kept.is_file():
        try:
            return _from_json(Node(read_json(kept, LogError), f"{kept}: ", LogError))
        except LogError:
            pass  # a broken one is found and written anew
    found = _find(path, files, world_from_lidar, direction)
    try:
        write_file(kept, (json.dumps(_to_json(found)) + "\n").encode())
    except OutputError:
        pass  # a cache that cannot be written costs time and nothing else
    return found


def _find(
    path: Path, files: KittiFiles, world_from_lidar: Trajectory | None, direction: int | None
) -> LidarCalibration:
    frames = sorted(files.sweeps)
    chosen = sorted({frames[at] for at in np.linspace(0, len(frames) - 1, BEAM_SWEEPS).round().astype(int)})
    beams = find_beams([read_points(files.sweeps[frame]) for frame in chosen])
    if beams is None:
        raise LogError(
            f"{files.sweeps[chosen[0]]}: shows no rings of a turning LiDAR, nor do {len(chosen) - 1} other sweeps"
        )

    read = _planes_of(files, beams, 1 if world_from_lidar is None else SPIN_EVERY)
    if world_from_lidar is not None and direction is not None:
        return LidarCalibration(beams, _stated_spin(direction), None, "")
    if world_from_lidar is not None:
        return LidarCalibration(beams, fit_spin(_stretch(frames), read, files.turns, world_from_lidar), None, "")
    if len(frames) < 2:
        raise LogError(f"{path}: has no poses, and a single sweep tells none")
    # as if each sweep were taken in a moment, which favours neither direction
    still = _registered(path, files, read, _stretch(frames), 0)
    spin = fit_spin(_stretch(frames), read, files.turns, still.trajectory)
    registered = _registered(path, files, read, frames, spin.direction)
    return LidarCalibration(beams, spin, registered.trajectory, registered.sentence())


def _stated_spin(direction: int) -> Spin:
    return Spin(direction, True, f"the LiDAR turns {WORDS[direction]}, as the drive says")


def _stretch(frames: list[int]) -> list[int]:
    """The frames in the middle that the spin is told by."""
    first = max(0, (len(frames) - TRIED_SWEEPS) // 2)
    return frames[first : first + TRIED_SWEEPS]


def _planes_of(files: KittiFiles, beams: KittiBeams, every: int) -> Callable[[int], PlanePoints]:
    model = beams.model(STATED, PERIOD_S)

    @lru_cache(maxsize=TRIED_SWEEPS)
    def planes(frame: int) -> PlanePoints:
        points = read_points(files.sweeps[frame])
        ring = assign_rings(points, beams)
        chosen, normals = find_planes(
            points, ring, assign_columns(points, ring, model), model.beams, model.columns, every
        )
        return PlanePoints(points[chosen, :3], normals)

    return planes


def _registered(
    path: Path, files: KittiFiles, read: Callable[[int], PlanePoints], frames: list[int], spin: int
) -> Registered:
    def surface(frame: int) -> SweepPlanes:
        planes, forward = read(frame), files.turns[frame][1]
        late = point_times(planes.points, files.turns[frame], spin) - forward
        return SweepPlanes(planes.points, planes.normals, late, forward)

    return register(str(path), frames, surface)


def _identity(files: KittiFiles, world_from_lidar: Trajectory | None, direction: int | None) -> str:
    digest = hashlib.sha256(f"{VERSION}{direction or ''}".encode())
    for frame, path in sorted(files.sweeps.items()):
        digest.update(f"{path.resolve()} {file_stamp(path)} {files.turns[frame]}\n".encode())
    digest.update(b"" if world_from_lidar is None else world_from_lidar.content())
    return digest.hexdigest()[:32]


def _to_json(found: LidarCalibration) -> dict[str, object]:
    beams, spin, track = found.beams, found.spin, found.trajectory
    return {
        "elevation_rad": beams.elevation_rad.tolist(),
        "height_m": beams.height_m.tolist(),
        "azimuth_offset_rad": beams.azimuth_offset_rad.tolist(),
        "columns": beams.columns,
        "direction": spin.direction,
        "told": spin.told,
        "spin": spin.sentence,
        "times_s": [] if track is None else track.times_s.tolist(),
        "positions": [] if track is None else track.positions.tolist(),
        "quaternions_wxyz": [] if track is None else track.quaternions_wxyz.tolist(),
        "sentence": found.sentence,
    }


def _from_json(node: Node) -> LidarCalibration:
    elevation = node.key("elevation_rad").array(-1)
    beams = KittiBeams(
        elevation,
        node.key("height_m").array(len(elevation)),
        node.key("azimuth_offset_rad").array(len(elevation)),
        node.key("columns").integer(at_least=1),
    )
    spin = Spin(node.key("direction").integer(), node.key("told").flag(), node.key("spin").text())
    times = node.key("times_s").array(-1)
    track = (
        Trajectory(times, node.key("positions").array(-1, 3), node.key("quaternions_wxyz").array(-1, 4))
        if len(times)
        else None
    )
    return LidarCalibration(beams, spin, track, node.key("sentence").text())
