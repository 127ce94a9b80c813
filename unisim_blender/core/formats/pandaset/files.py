"""The files of a PandaSet log that are not pickles, read and checked: JSON lists, frame numbers."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ...data.image_files import Notes, files_by_stem
from ...errors import LogError, in_a_line
from ...geometry import FloatArray

MAX_JSON_BYTES = 64 * 2**20
CLOSEST_S = 1e-6
"""Between two frames' times: between closer ones speeds are beyond numbers."""


def read_json(path: Path) -> Any:
    """The JSON document at ``path``."""
    try:
        if path.stat().st_size > MAX_JSON_BYTES:
            raise LogError(f"{path}: refused, it has more than {MAX_JSON_BYTES // 2**20} MiB")
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError as error:
        raise LogError(f"{path}: is missing") from error
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error
    except (ValueError, RecursionError) as error:
        raise LogError(f"{path}: is not valid JSON ({in_a_line(error)})") from error


def read_times(path: Path) -> FloatArray:
    """Timestamps (T,) in seconds; they must increase strictly from frame to frame."""
    times = _numbers(path, read_json(path), "timestamps")
    if len(times) == 0:
        raise LogError(f"{path}: holds no timestamp")
    late = np.flatnonzero(np.diff(times) < CLOSEST_S)
    if len(late):
        frame = int(late[0]) + 1
        raise LogError(
            f"{path}: frame {frame} at {times[frame]} s is not later than frame {frame - 1} at {times[frame - 1]} s"
        )
    return times


def read_poses(path: Path, count: int) -> tuple[FloatArray, FloatArray]:
    """Positions (count, 3) and unit quaternions wxyz (count, 4), one for each timestamp."""
    poses = read_json(path)
    if not isinstance(poses, list) or len(poses) != count:
        found = f"{len(poses)} poses" if isinstance(poses, list) else "no list of poses"
        raise LogError(f"{path}: holds {found} for {count} timestamps")
    positions, quaternions = np.zeros((count, 3)), np.zeros((count, 4))
    for frame, pose in enumerate(poses):
        try:
            positions[frame] = [float(pose["position"][axis]) for axis in "xyz"]
            quaternions[frame] = [float(pose["heading"][axis]) for axis in "wxyz"]
        except (KeyError, TypeError, ValueError) as error:
            raise LogError(
                f"{path}: the pose of frame {frame} is no position and heading ({in_a_line(error)})"
            ) from error
        values = [*positions[frame], *quaternions[frame]]
        if not np.isfinite(values).all():
            raise LogError(f"{path}: the pose of frame {frame} holds a value that is not finite")
        length = float(np.linalg.norm(quaternions[frame]))
        if abs(length - 1) > 1e-3:
            raise LogError(f"{path}: the heading of frame {frame} has length {length:.6g}, not 1")
        if abs(length - 1) > 1e-12:
            quaternions[frame] /= length
    return positions, quaternions


def read_intrinsics(path: Path) -> dict[str, float]:
    """fx, fy, cx, cy in pixels of the images as stored."""
    values = read_json(path)
    try:
        intrinsics = {name: float(values[name]) for name in ("fx", "fy", "cx", "cy")}
    except (KeyError, TypeError, ValueError) as error:
        raise LogError(f"{path}: does not hold the numbers fx, fy, cx and cy ({in_a_line(error)})") from error
    for name, value in intrinsics.items():
        if not np.isfinite(value) or (name in ("fx", "fy") and value <= 0):
            raise LogError(f"{path}: {name} is {value}")
    return intrinsics


def frame_files(folder: Path, suffixes: tuple[str, ...], count: int, notes: Notes | None = None) -> dict[int, Path]:
    """Files by frame number, which is the name before one of ``suffixes``; a number that has no timestamp is an error."""
    files: dict[int, Path] = {}
    for stem, path in files_by_stem(folder, suffixes, notes).items():
        if not stem.isascii() or not stem.isdigit():
            continue
        frame = int(stem)
        if frame >= count:
            raise LogError(f"{path}: is frame {frame}, but there are {count} timestamps only")
        if frame in files:
            raise LogError(f"{path}: is frame {frame}, and so is {files[frame].name}")
        files[frame] = path
    return files


def _numbers(path: Path, values: Any, what: str) -> FloatArray:
    if not isinstance(values, list) or not all(isinstance(value, int | float) for value in values):
        raise LogError(f"{path}: is no list of {what}")
    array = np.array(values, np.float64)
    if not np.isfinite(array).all():
        raise LogError(f"{path}: entry {int(np.flatnonzero(~np.isfinite(array))[0])} is not finite")
    return array
