"""A recorded drive on disk: its `Drive`, and images and sweeps, which are read on demand."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..files import cache_folder, content_digests, file_stamp
from ..geometry import FloatArray
from ..json_file import json_bytes
from ..memo import memoized
from ..world.box_tracks import TrackedBoxes
from ..world.classes import Motion
from ..world.drive import Drive, LidarModel
from ..world.drive_json import drive_to_json
from ..world.light import SunPosition


@dataclass(frozen=True)
class Sweep:
    """The returns of one sweep, N points, world frame; ray origins and times are each point's own.

    points (N, 3), origins (N, 3), metres, time_s (N,), seconds, intensity (N,) in 0..1, ring (N,) beam index or -1,
    column (N,) or -1, semantic (N,) class number or -1. ``rank`` (N,): 0 for the strongest return of its ray, 1 and
    more for the others (`sweep_cells.rank_returns`); None where a ray has one return. ``drops``: the rays that the log
    says did not return; None where it does not say, and they are inferred from the beam table.
    """

    points: FloatArray
    origins: FloatArray
    time_s: FloatArray
    intensity: NDArray[np.float32]
    ring: NDArray[np.int32]
    column: NDArray[np.int32]
    semantic: NDArray[np.int32]
    rank: NDArray[np.int32] | None = None
    drops: Drops | None = None


@dataclass(frozen=True)
class PlaneSweep:
    """Points (N, 3) of a sweep and their planes' unit normals (N, 3), in the sensor's frame at each point's own time
    ``time_s`` (N,); ``middle_s`` is the time of the sweep as a whole."""

    points: FloatArray
    normals: FloatArray
    time_s: FloatArray
    middle_s: float


@dataclass(frozen=True)
class Drops:
    """Rays of one sweep that did not return, M of them, world frame, as the log gives them.

    origins, directions (M, 3), unit length; time_s (M,); ring, column (M,), -1 where no beam table has them.
    """

    origins: FloatArray
    directions: FloatArray
    time_s: FloatArray
    ring: NDArray[np.int32]
    column: NDArray[np.int32]


@dataclass(frozen=True)
class OtherReturns:
    """Returns of a sweep beside each ray's strongest, K of them: ring, column, rank (K,), rank 1 and more; depth_m
    (K,), metres along the ray, intensity (K,) in 0..1."""

    ring: NDArray[np.int32]
    column: NDArray[np.int32]
    rank: NDArray[np.int32]
    depth_m: NDArray[np.float32]
    intensity: NDArray[np.float32]


@dataclass(frozen=True)
class SweepRays:
    """Rays of one sweep, drops included, N of them in no order, world frame: of a LiDAR that scans no beams x columns.

    origins, directions (N, 3), unit length; time_s (N,); depth_m, intensity (N,), 0 where nothing returned; returned
    (N,) bool.
    """

    origins: FloatArray
    directions: FloatArray
    time_s: FloatArray
    depth_m: NDArray[np.float32]
    intensity: NDArray[np.float32]
    returned: NDArray[np.bool_]


@dataclass(frozen=True)
class SweepGrid:
    """A sweep as beams x columns. Cells without a return are drops, save the blocked ones, of which nothing is known.

    origins, directions (B, C, 3) in the world frame, unit length (a drop's the log's own, or from the beam table);
    time_s (B, C); depth_m, intensity (B, C), of the strongest return, 0 where nothing returned; returned, blocked (B,
    C) bool. ``blocked``: the ego vehicle stands in the way, or the log gives drops, and this cell neither as one nor as
    a return. ``others``: the returns beside the strongest.
    """

    model: LidarModel
    origins: FloatArray
    directions: FloatArray
    time_s: FloatArray
    depth_m: NDArray[np.float32]
    intensity: NDArray[np.float32]
    returned: NDArray[np.bool_]
    blocked: NDArray[np.bool_]
    others: OtherReturns | None = None


class Log(Protocol):
    """Interface of a log, as every reader returns it; optional members are in `LogExtras`.

    Images and sweeps are read on demand and not cached.
    """

    path: Path
    drive: Drive
    missing: tuple[str, ...]
    """A sentence for each missing thing: a camera, a frame's image, a sweep."""

    def image_frames(self, camera: str) -> tuple[int, ...]:
        """Frames of which the camera has an image."""

    def sweep_frames(self, lidar: str) -> tuple[int, ...]:
        """Frames of which the LiDAR has a sweep."""

    def image_path(self, camera: str, frame: int) -> Path | None:
        """Return the file of the recorded image; None where there is none."""

    def image(self, camera: str, frame: int) -> NDArray[np.uint8]:
        """Return the recorded image (H, W, 3), sRGB."""

    def sweep(self, lidar: str, frame: int) -> Sweep:
        """Return the recorded returns."""

    def sweep_grid(self, lidar: str, frame: int) -> SweepGrid:
        """Return the recorded sweep as beams x columns, with drops."""


REFINED = "refined"
"""Value of `LogExtras.poses`, and of a scene's, for a trajectory that sweeps have corrected."""


def no_mask(camera: str) -> NDArray[np.bool_] | None:
    """Return None: there is no mask of any camera."""
    return None


@dataclass(frozen=True)
class LogExtras:
    """The members that a log may have besides those of `Log`, under the same names; only `extras_of` looks for them.

    A member that a log lacks, or that is None, has its default here.
    """

    classes: Mapping[str, Motion] = field(default_factory=dict)
    """Kinds of motion of the log's classes, before the tables of `classes`: {"robot": "deforming"}."""
    own_vehicle_mask: Callable[[str], NDArray[np.bool_] | None] = no_mask
    """Function from a camera's name to the mask (H, W) bool, at the recorded size, of pixels that show the vehicle
    itself; None where the log has none."""
    files: tuple[Path, ...] = ()
    """The files that images and sweeps are read from, of a log that is named by one of its files; `log_digest` reads
    them."""
    notes: Mapping[str, str] = field(default_factory=dict)
    """Notes so far for a user from reading images and sweeps, a sentence a matter: `image_files.Notes`."""
    poses: str = "log"
    """Where the ego's trajectory comes from: "log", or `REFINED`."""
    road: Mapping[int, bool] = field(default_factory=dict)
    """Whether semantic classes of sweeps, by their numbers, are road or something else that stands; other classes, as
    vehicles', do not tell what is below them. Empty where sweeps have no classes."""
    recorded: Path | None = None
    """The log that a file of boxes, ``path``, gives actors to; None where ``path`` is the log itself."""
    sun: SunPosition | None = None
    """Where the sun stood; None where the log does not tell place and time."""
    boxes_of: Callable[[Path], TrackedBoxes] | None = None
    """Function from a file of boxes in its dataset's own format, as of results, to these; raises `LogError`."""
    boxes_at: Callable[[Path], str] | None = None
    """Function from another path to the text of the same file of boxes there; None for a log without such a file."""


def extras_of(log: Log) -> LogExtras:
    """Return the optional members of a log."""
    given: dict[str, Any] = {member.name: getattr(log, member.name, None) for member in fields(LogExtras)}
    return LogExtras(**{name: value for name, value in given.items() if value is not None})


def log_digest(log: Log) -> str:
    """Return a digest of all that a log is read from: the content of every file, by its name below the log's folder.

    It is the same wherever the log lies. The files of a log that is named by one of them are the reader's ``files``
    (`LogExtras`); without these, all captures are read. Raises `LogError`, and `OSError` where a file cannot be read.
    """
    if log.path.is_dir():
        return _digest_of_files(log.path, tuple(sorted(path for path in log.path.rglob("*") if path.is_file())))
    digest = hashlib.sha256(json_bytes(drive_to_json(log.drive)))
    if files := extras_of(log).files:
        folder = Path(*_common_parts(files))
        digest.update(_digest_of_files(folder, tuple(sorted(files))).encode())
        return digest.hexdigest()
    for name in log.drive.cameras:
        for frame in log.image_frames(name):
            digest.update(f"{name} {frame}".encode() + log.image(name, frame).tobytes())
    for name in log.drive.lidars:
        for frame in log.sweep_frames(name):
            sweep = log.sweep(name, frame)
            digest.update(f"{name} {frame}".encode() + sweep.points.tobytes() + sweep.intensity.tobytes())
    return digest.hexdigest()


def cached_file(log: Log, folder: str, name: str) -> Path:
    """Return the file ``name`` of a log in a folder of the cache: its own by the log's poses, boxes and files' stamps."""
    files = extras_of(log).files or (sorted(log.path.rglob("*")) if log.path.is_dir() else [log.path])
    digest = hashlib.sha256(json_bytes(drive_to_json(log.drive)))
    for file in files if log.path.exists() else ():
        digest.update(f"{file}{file_stamp(file)}".encode())
    return cache_folder() / folder / f"{digest.hexdigest()[:32]}-{name}"


@memoized
def _digest_of_files(folder: Path, files: tuple[Path, ...]) -> str:
    digest, contents = hashlib.sha256(), content_digests(files)
    for file in files:
        digest.update(f"{file.relative_to(folder).as_posix()}\0{contents[file]}\n".encode())
    return digest.hexdigest()


def _common_parts(files: tuple[Path, ...]) -> list[str]:
    """Return the parts of the path of the folder that holds all files."""
    parts = list(files[0].parent.parts)
    for file in files:
        other = file.parent.parts
        same = [a == b for a, b in zip(parts, other, strict=False)]
        parts = parts[: same.index(False) if False in same else len(same)]
    return parts
