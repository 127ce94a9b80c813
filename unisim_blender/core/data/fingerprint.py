"""Fingerprint of a log, by which a trained scene recognises the same drive in a copy, a cut or another layout.

Of some frames: the ego's pose, the brightness of an image in cells of direction, and the median range of a sweep in
sectors of direction. Directions are in the ego's axes, so neither a re-centred world nor rectified images change them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import LogError, SceneError
from ..geometry import (
    FloatArray,
    invert_pose,
    nearest_rotation,
    rotate_vectors,
    spread_indices,
    transform_points,
)
from ..json_file import Node
from ..world.drive import Camera, Drive
from .log import Log
from .moved import moved_log

MOST_FRAMES = 12
"""Largest number of frames of a fingerprint."""
COMPARED_FRAMES = 3
"""Number of frames whose images and sweeps are read to compare two logs."""
CELLS = 6, 12
SAMPLES = 8
"""Number of samples of direction along each side of a cell of an image."""
IMAGE_FRACTION = 0.6
"""Fraction of the field of view, around the optical axis, that is compared: rectified images show less."""
SECTORS = 72
BANDS_RAD = np.deg2rad([-2.0, 1.5, 10.0])
"""Elevations, radians, between which ranges are compared: standing objects, and little of the ground."""
LEAST_POINTS = 5
"""Smallest number of returns of a sector whose range is known."""
LEAST_SECTORS = 12
"""Smallest number of sectors of known range of a sweep that is compared."""
LEAST_AGREEMENT = 0.8
"""Smallest fraction of sectors that agree in sweeps of one drive: 0.91 and more were measured across layouts, 0.62 and
less between drives."""
MOST_BRIGHTNESS = 8.0
"""Largest mean difference of cells, of 255, in images of one drive: 2.3 and less were measured across layouts,
rectified and encoded anew; 10 and more between drives."""
SAME_MOTION_M = 1.0
SAME_WORLD_M, SAME_WORLD_RAD = 0.01, 1e-3
"""Largest movement, metres and radians, of a world that counts as the same: layouts round poses."""
SAME_TIME_S = 1e-3


@dataclass(frozen=True)
class FrameMarks:
    """Fingerprint of one frame: ``image`` (CELLS) in 0..255 and ``sweep`` (2, SECTORS) in metres, NaN where nothing is
    known; None without one."""

    image: FloatArray | None
    sweep: FloatArray | None


@dataclass(frozen=True)
class Fingerprint:
    """Fingerprint of a log: of ``camera``'s images over the directions ``span_rad`` (yaw from, to; pitch from, to,
    ego's axes) and ``lidar``'s sweeps; "" where the log has none. ``poses`` are the ego's (4, 4), ``times_s`` the
    frames' times."""

    camera: str
    span_rad: tuple[float, float, float, float]
    lidar: str
    times_s: dict[int, float]
    poses: dict[int, FloatArray]
    frames: dict[int, FrameMarks]

    def to_json(self) -> dict[str, Any]:

        def numbers(array: FloatArray | None) -> list[float | None] | None:
            if array is None:
                return None
            return [None if np.isnan(x) else round(float(x), 2) for x in array.ravel()]

        return {
            "camera": self.camera,
            "span_rad": list(self.span_rad),
            "lidar": self.lidar,
            "frames": {
                str(frame): {
                    "time_s": self.times_s[frame],
                    "world_from_ego": self.poses[frame].tolist(),
                    "image": numbers(marks.image),
                    "sweep": numbers(marks.sweep),
                }
                for frame, marks in self.frames.items()
            },
        }

    @staticmethod
    def from_json(node: Node) -> Fingerprint:
        """Return the fingerprint of `to_json`. Raises what ``node`` does for a broken one."""

        def numbers(child: Node, shape: tuple[int, ...]) -> FloatArray | None:
            if child.value is None:
                return None
            values = [np.nan if number.value is None else number.number() for number in child.elements()]
            if len(values) != np.prod(shape):
                child.fail(f"must be {np.prod(shape)} numbers")
            return np.array(values).reshape(shape)

        times, poses, frames = {}, {}, {}
        for name in node.key("frames").object():
            child = node.key("frames").key(name)
            if not name.isdecimal():
                child.fail("must be named by the number of a frame")
            times[int(name)] = child.key("time_s").number()
            poses[int(name)] = child.key("world_from_ego").array(4, 4)
            frames[int(name)] = FrameMarks(
                numbers(child.key("image"), CELLS), numbers(child.key("sweep"), (len(BANDS_RAD) - 1, SECTORS))
            )
        yaw_from, yaw_to, pitch_from, pitch_to = node.key("span_rad").array(4).tolist()
        span = yaw_from, yaw_to, pitch_from, pitch_to
        return Fingerprint(node.key("camera").text(), span, node.key("lidar").text(), times, poses, frames)


def fingerprint_of(log: Log, camera: str, lidar: str) -> Fingerprint:
    """Read the fingerprint of a log from some of its frames, by one camera and one LiDAR; "" for none. Raises
    `LogError`."""
    drive = log.drive
    chosen = [drive.frames[i] for i in spread_indices(len(drive.frames), MOST_FRAMES)]
    span = _span(drive, drive.cameras[camera]) if camera else (0.0, 0.0, 0.0, 0.0)
    return Fingerprint(
        camera,
        span,
        lidar,
        {frame: drive.time_s[frame] for frame in chosen},
        {frame: drive.world_from_ego.at(drive.time_s[frame]) for frame in chosen},
        {frame: _marks(log, camera, span, lidar, frame) for frame in chosen},
    )


def _marks(log: Log, camera: str, span: tuple[float, float, float, float], lidar: str, frame: int) -> FrameMarks:
    image = _image_marks(log, camera, span, frame) if camera and frame in log.image_frames(camera) else None
    sweep = _sweep_marks(log, lidar, frame) if lidar and frame in log.sweep_frames(lidar) else None
    return FrameMarks(image, sweep)


def _span(drive: Drive, camera: Camera) -> tuple[float, float, float, float]:
    """Return the directions over which a camera's images are compared: yaw from, to, pitch from, to, radians, ego's
    axes."""
    axis = _ego_from_camera(drive, camera, min(camera.time_s))[:3, 2]
    yaw, pitch = float(np.arctan2(axis[1], axis[0])), float(np.arcsin(np.clip(axis[2], -1, 1)))
    half = [
        IMAGE_FRACTION * float(np.arctan(size / 2 / camera.model.pixels_per_rad))
        for size in (camera.model.width, camera.model.height)
    ]
    return yaw - half[0], yaw + half[0], pitch - half[1], pitch + half[1]


def _ego_from_camera(drive: Drive, camera: Camera, frame: int) -> FloatArray:
    time_s = camera.time_s[frame]
    return np.asarray(invert_pose(drive.world_from_ego.at(time_s)) @ camera.world_from_camera.at(time_s))


def _image_marks(log: Log, name: str, span: tuple[float, float, float, float], frame: int) -> FloatArray:
    """Return the mean brightness (CELLS), 0..255, of an image by direction; NaN for cells that it shows less than half
    of."""
    camera = log.drive.cameras[name]
    image = log.image(name, frame).mean(-1)
    step = max(1, image.shape[1] // 240)
    rows, columns = image.shape[0] // step, image.shape[1] // step
    image = image[: rows * step, : columns * step].reshape(rows, step, columns, step).mean((1, 3))
    yaw = np.linspace(span[1], span[0], CELLS[1] * SAMPLES)[None, :]
    pitch = np.linspace(span[3], span[2], CELLS[0] * SAMPLES)[:, None]
    directions = np.stack(
        np.broadcast_arrays(np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)), -1
    )
    seen = rotate_vectors(invert_pose(_ego_from_camera(log.drive, camera, frame)), directions)
    u, v, valid = camera.model.project(seen)
    scale = camera.model.width / image.shape[1]  # of a recorded image of another size than the model's, too
    with np.errstate(invalid="ignore"):
        inside = valid & (u >= 0) & (v >= 0) & (u < camera.model.width) & (v < image.shape[0] * scale)
        column, row = (np.where(inside, x / scale, 0).astype(int) for x in (u, v))
    values = np.where(inside, image[row.clip(0, rows - 1), column.clip(0, columns - 1)], np.nan)
    cells = values.reshape(CELLS[0], SAMPLES, CELLS[1], SAMPLES).swapaxes(1, 2).reshape(*CELLS, -1)
    known = np.isfinite(cells).sum(-1)
    means = np.nansum(cells, -1) / np.maximum(known, 1)
    return np.where(known * 2 >= SAMPLES**2, means, np.nan)


def _sweep_marks(log: Log, name: str, frame: int) -> FloatArray:
    """Return the median range (2, SECTORS), m, of a sweep by elevation and azimuth; NaN where there are too few
    returns."""
    lidar, ego = log.drive.lidars[name], log.drive.world_from_ego
    time_s = lidar.time_s[frame]
    points = log.sweep(name, frame).points - lidar.world_from_lidar.at(time_s)[:3, 3]
    points = rotate_vectors(invert_pose(ego.at(time_s)), points)
    level = np.hypot(points[:, 0], points[:, 1])
    band = np.digitize(np.arctan2(points[:, 2], level), BANDS_RAD) - 1
    sector = ((np.arctan2(points[:, 1], points[:, 0]) + np.pi) / (2 * np.pi) * SECTORS).astype(int) % SECTORS
    marks = np.full((len(BANDS_RAD) - 1, SECTORS), np.nan)
    cell = np.where((band >= 0) & (band < len(marks)), band * SECTORS + sector, -1)
    order = np.argsort(cell, kind="stable")
    cells, starts = np.unique(cell[order], return_index=True)
    for index, values in zip(cells, np.split(level[order], starts[1:]), strict=True):
        if index >= 0 and len(values) >= LEAST_POINTS:
            marks.flat[index] = np.median(values)
    return marks


@dataclass(frozen=True)
class LogComparison:
    """Result of comparing a log with a fingerprint. ``difference``: a sentence's part on the differences, "" for the
    same drive; ``compared``: what was compared. ``moved`` (4, 4) takes the log's world to the fingerprint's, and
    ``later_s``, seconds, is added to its times."""

    difference: str
    compared: str
    moved: FloatArray
    later_s: float

    @property
    def is_moved(self) -> bool:
        """Whether the log's world or time differs from the fingerprint's."""
        turned = np.abs(self.moved[:3, :3] - np.eye(3)).max()
        away = np.abs(self.moved[:3, 3]).max()
        return bool(turned > SAME_WORLD_RAD or away > SAME_WORLD_M or abs(self.later_s) > SAME_TIME_S)


def compare_log(own: Fingerprint, log: Log, apart_m: float = SAME_MOTION_M) -> LogComparison:
    """Compare a log with a fingerprint: the ego's motion over the frames that both have, and some of their images and
    sweeps.

    A capture that cannot be read is not compared.
    """
    drive = log.drive
    shared = [frame for frame in own.times_s if frame in drive.time_s]
    if not shared:
        return LogComparison(f"they share none of the frames {_some(own.times_s)}", "", np.eye(4), 0.0)
    there = np.array([drive.world_from_ego.at(drive.time_s[frame]) for frame in shared])
    here = np.array([own.poses[frame] for frame in shared])
    moved = _rigid(there, here)
    apart = np.linalg.norm(transform_points(moved, there[:, :3, 3]) - here[:, :3, 3], axis=1)
    later = np.array([own.times_s[frame] - drive.time_s[frame] for frame in shared])
    compared = f"the ego's motion over {len(shared)} frames"
    if apart.max() > apart_m:
        at = shared[int(apart.argmax())]
        return LogComparison(f"the vehicle is {apart.max():.1f} m away at frame {at}", compared, moved, 0.0)
    later_s = float(np.median(later))
    if np.abs(later - later_s).max() > 0.05:
        return LogComparison("their frames are at other times", compared, moved, 0.0)
    images, sweeps = _captures_apart(own, log, shared)
    differs = []
    if sweeps:
        compared += f", {len(sweeps)} sweeps of {own.lidar}"
        if np.median(sweeps) < LEAST_AGREEMENT:
            differs.append(f"sweeps agree in {100 * np.median(sweeps):.0f} % of directions")
    if images:
        compared += f", {len(images)} images of {own.camera}"
        if np.median(images) > MOST_BRIGHTNESS:
            differs.append(f"images differ by {np.median(images):.0f} of 255 in brightness")
    return LogComparison(" and ".join(differs), compared, moved, later_s if abs(later_s) > SAME_TIME_S else 0.0)


def _captures_apart(own: Fingerprint, log: Log, shared: list[int]) -> tuple[list[float], list[float]]:
    """Return mean differences of images, of 255, and agreements of sweeps, 0..1, over some shared frames."""
    camera, lidar = _same_camera(own, log.drive), _same_lidar(own, log.drive)
    usable = [frame for frame in shared if _has(own, log, frame, camera, lidar)]
    images, sweeps = [], []
    for frame in (
        [usable[i] for i in np.unique(np.linspace(0, len(usable) - 1, COMPARED_FRAMES).astype(int))] if usable else []
    ):
        before = own.frames[frame]
        try:
            marks = _marks(log, camera, own.span_rad, lidar, frame)
        except (LogError, OSError):
            continue
        if before.image is not None and marks.image is not None:
            apart = np.abs(before.image - marks.image)
            if np.isfinite(apart).sum() >= apart.size // 4:
                images.append(float(np.nanmean(apart)))
        if before.sweep is not None and marks.sweep is not None:
            known = np.isfinite(before.sweep) | np.isfinite(marks.sweep)
            with np.errstate(invalid="ignore"):
                agree = np.abs(before.sweep - marks.sweep) <= 0.3 + 0.03 * before.sweep
            if np.isfinite(before.sweep).sum() >= LEAST_SECTORS:
                sweeps.append(float(agree.sum() / known.sum()))
    return images, sweeps


def _has(own: Fingerprint, log: Log, frame: int, camera: str, lidar: str) -> bool:
    marks = own.frames[frame]
    return bool(
        (camera and marks.image is not None and frame in log.image_frames(camera))
        or (lidar and marks.sweep is not None and frame in log.sweep_frames(lidar))
    )


def _same_camera(own: Fingerprint, drive: Drive) -> str:
    """Return the camera that looks where the fingerprint's does: that of its name, or the nearest; "" for none."""
    if not own.camera or own.camera in drive.cameras:
        return own.camera
    middle = np.array([own.span_rad[0] + own.span_rad[1], own.span_rad[2] + own.span_rad[3]]) / 2
    best, away = "", np.deg2rad(10)
    for name, camera in drive.cameras.items():
        span = _span(drive, camera) if camera.time_s else (np.inf, np.inf, np.inf, np.inf)
        other = np.array([span[0] + span[1], span[2] + span[3]]) / 2
        if (apart := float(np.abs(other - middle).max())) < away:
            best, away = name, apart
    return best


def _same_lidar(own: Fingerprint, drive: Drive) -> str:
    """Return the LiDAR of the fingerprint's name, or the drive's only one; "" for none."""
    if not own.lidar or own.lidar in drive.lidars:
        return own.lidar
    return next(iter(drive.lidars)) if len(drive.lidars) == 1 else ""


def _rigid(there: FloatArray, here: FloatArray) -> FloatArray:
    """Return the pose (4, 4) that takes poses ``there`` (K, 4, 4) to ``here``: the mean turn, then the mean shift."""
    turn = nearest_rotation((here[:, :3, :3] @ there[:, :3, :3].swapaxes(1, 2)).mean(0))
    moved = np.eye(4)
    moved[:3, :3] = turn
    moved[:3, 3] = (here[:, :3, 3] - there[:, :3, 3] @ turn.T).mean(0)
    return moved


def _some(frames: Any) -> str:
    names = [str(frame) for frame in frames]
    return ", ".join(names) if len(names) <= 4 else f"{names[0]}, {names[1]} … {names[-1]}"


def aligned(own: Fingerprint, log: Log, world_origin: FloatArray, place: str, apart_m: float = SAME_MOTION_M) -> Log:
    """Return a log in the world of a fingerprint, itself where that is its own. Raises `SceneError`, which begins with
    ``place``, where it is of another drive: where the ego is more than ``apart_m`` away, or captures differ;
    ``world_origin`` is that of the fingerprint's drive."""
    comparison = compare_log(own, log, apart_m)
    if comparison.difference:
        what = f" (compared: {comparison.compared})" if comparison.compared else ""
        raise SceneError(f"{place} another drive than {log.path}: {comparison.difference}{what}")
    if not comparison.is_moved:
        return log
    moved, later_s = comparison.moved, comparison.later_s
    return moved_log(log, lambda times: np.broadcast_to(moved, (*np.shape(times), 4, 4)), later_s, world_origin)
