"""Plausible ranges of a log's values, doubts about values outside of them, and the scales of intensities.

A few images and sweeps are measured: each sensor's first, middle and last. A value outside of its range is not an error
but a doubt: one sentence with file, value and range.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import LogError
from ..geometry import FloatArray, Trajectory, invert_pose, spread_indices
from ..world.classes import motion_of
from ..world.drive import Actor, Camera, Drive, Lidar
from .image_files import Notes, image_header
from .log import Log, Sweep, extras_of

FULL_SCALES = (1.0, 255.0, 65535.0)
"""Full scales of intensities, in layouts and in files that others wrote in them."""
OUTLIERS = 1e-3
"""Largest share of a sweep's intensities above the full scale that does not indicate another scale."""
MOST_TURN_RAD = 4 * np.pi
"""Largest angle, radians; a larger one is in another unit."""
FULLY, MOST_ALIKE = 0.99, 0.9
"""Intensity that counts as 1, and the largest share of intensities that may be 0, or 1."""
SHARE = 0.5
"""Smallest share of a log's returns, steps or boxes that a property must hold for; it is doubted below that."""
LEAST_SPEED_M_S = 2.0
"""Lowest speed, metres per second, at which motion determines a heading."""
FEWEST, FEWEST_RETURNS = 3, 100
"""Smallest number of steps of a trajectory, or of boxes, and of returns of a sweep, that are judged."""
SAMPLED_STEPS = 200
FACTORS = {1e-9: "nano", 1e-6: "micro", 1e-3: "milli", 1e-2: "centi", 1e3: "kilo"}


@dataclass(frozen=True)
class Range:
    """Plausible range, ``low`` to ``high``, of a quantity in drives of vehicles, its unit, and its ``usual`` value,
    where files may have another unit."""

    what: str
    low: float
    high: float
    unit: str
    usual: float = 0.0

    def doubt(self, where: object, value: float) -> Iterator[str]:
        """Yield a sentence where a value of ``where`` lies outside of the range, with the unit in which it would
        fit."""
        if self.low <= value <= self.high:
            return
        hint = ""
        fits = [factor for factor in FACTORS if self.low <= value * factor <= self.high]
        if self.usual and fits:
            nearest = min(fits, key=lambda factor: abs(np.log(value * factor / self.usual)))
            hint = f", as if it were given in {FACTORS[nearest]}{'metres' if self.unit.startswith('m') else 'seconds'}"
        bounds = f"{self.low:g} to {self.high:g}{' ' if self.unit else ''}{self.unit}"
        yield f"{where}: {self.what} is {value:.4g}{' ' if self.unit else ''}{self.unit}, not {bounds}{hint}"


STEP = Range("the time from one frame to the next", 0.002, 10, "s", 0.1)
SPEED = Range("the vehicle's speed", 0, 100, "m/s", 10)
HEADING = Range("the angle between where the vehicle looks and where it goes", 0, 45, "degrees")
TILT = Range("the vehicle's tilt", 0, 45, "degrees")
APART = Range("the time from the drive's frames to a capture", 0, 1, "s")
MOUNT = Range("the distance from the vehicle's origin", 0, 30, "m", 1.5)
LIDAR_TILT = Range("the tilt of the LiDAR's axis", 0, 75, "degrees")
CAMERA_TILT = Range("the angle between an image's up and the world's", 0, 110, "degrees")
CENTRE = Range("the principal point's distance from the image's middle, in sides of the image,", 0, 0.35, "")
VIEW = Range("the horizontal field of view", 3, 170, "degrees")
DISTANCE = Range("the median distance of returns", 0.5, 250, "m", 15)
TURN = Range("the time of a LiDAR's turn", 0.01, 1, "s", 0.1)
SPAN = Range("the time from a sweep's first return to its last, in turns,", 0.2, 3, "")
ON_BEAMS = Range("the share of returns that lie on a beam of the table", 0.5, 1, "")
EDGE = Range("the longest edge of a box", 0.05, 150, "m", 4)
ACTOR_SPEED = Range("an actor's speed", 0, 100, "m/s", 8)
ACTOR_HEADING = Range("the angle between where vehicles' boxes look and where they go", 0, 45, "degrees")
RANGES = (
    STEP, SPEED, HEADING, TILT, APART, MOUNT, LIDAR_TILT, CAMERA_TILT,
    CENTRE, VIEW, DISTANCE, TURN, SPAN, ON_BEAMS, EDGE, ACTOR_SPEED, ACTOR_HEADING,
)  # fmt: skip
"""Quantities that are measured of every log."""


class Intensities:
    """A LiDAR's intensities, from 0 to 1.

    ``stated``: where the layout's scale is full. Files that others wrote may have another: where a sweep does not fit,
    the first, the middle and the last one tell which, ``samples()``. What is done is noted.
    """

    def __init__(
        self, lidar: str, stated: float, samples: Callable[[], Iterable[NDArray[np.floating[Any]]]], notes: Notes
    ) -> None:
        self._lidar, self._stated, self._samples, self._notes = lidar, stated, samples, notes
        self._full: float | None = None

    def scaled(self, values: NDArray[np.floating[Any]], where: str) -> NDArray[np.float32]:
        """Return a sweep's intensities (N,), which ``where`` names, in 0..1. Raises `LogError` where no scale holds
        them."""
        full = self._stated if self._full is None else self._full
        if self._full is None and not _fits(values, full):
            full = self._full = self._found(where)
        low, high = float(values.min(initial=0.0)), float(values.max(initial=0.0))
        outside = int(((values < 0) | (values > full * (1 + 1e-6))).sum())
        if outside:
            self._notes.say(
                f"clipped {self._lidar}",
                f"{where}: {outside} of {len(values)} intensities lie outside of 0 to {full:g}, from {low:g} to {high:g}: "
                "they are cut off there",
            )
        return np.clip(values / full, 0, 1).astype(np.float32)

    def _found(self, where: str) -> float:
        values = np.concatenate([*self._samples(), np.zeros(1)])
        low, high = float(values.min()), float(values.max())
        scales = [full for full in FULL_SCALES if full >= self._stated and _fits(values, full)]
        if _is_unit(values):
            scales = [1.0]
        if not scales:
            raise LogError(
                f"{where}: intensities from {low:g} to {high:g} fit no scale: the layout's is 0 to {self._stated:g}"
            )
        if scales[0] != self._stated:
            self._notes.say(
                f"scale {self._lidar}",
                f"{where}: intensities from {low:g} to {high:g} are not in the layout's range of 0 to {self._stated:g}: they are "
                f"taken as 0 to {scales[0]:g}",
            )
        return scales[0]


def _is_unit(values: NDArray[np.floating[Any]]) -> bool:
    """Return whether intensities (N,) are fractions up to 1."""
    return bool(0 < values.max(initial=0.0) <= 1 and (values != np.floor(values)).any())


def _fits(values: NDArray[np.floating[Any]], full: float) -> bool:
    above = (values > full * (1 + 1e-6)).mean() if len(values) else 0.0
    return bool(above <= OUTLIERS) and not (full > 1 and _is_unit(values))


def spread(frames: Collection[int]) -> list[int]:
    """Return the first, the middle and the last of some frames."""
    there = sorted(frames)
    return sorted({there[at] for at in (0, len(there) // 2, -1)}) if there else []


def check_angles(where: object, what: str, angles: FloatArray) -> None:
    """Raise `LogError` for an angle that is too large to be in radians."""
    most = float(np.abs(angles).max(initial=0.0))
    if most > MOST_TURN_RAD:
        raise LogError(f"{where}: {what} is {most:g}, which is no angle in radians; degrees are not read")


def time_unit(times: FloatArray) -> float:
    """Return the unit of frames' times (T,) in seconds: 1, or that of milli-, micro- or nanoseconds where seconds would
    be too far apart for frames."""
    step = float(np.median(np.diff(times))) if len(times) > 1 else STEP.low
    if step <= STEP.high:
        return 1.0
    return next((unit for unit in (1e-3, 1e-6, 1e-9) if STEP.low <= step * unit <= STEP.high), 1.0)


def check_times(path: Path, drive: Drive) -> None:
    """Raise `LogError` where a drive's frames are too far apart, or too near to each other, for its times to be
    seconds."""
    steps = np.diff([drive.time_s[frame] for frame in drive.frames])
    if len(steps):
        for sentence in STEP.doubt(path, float(np.median(steps))):
            raise LogError(sentence)


def doubts(log: Log, cameras: Collection[str] | None = None, lidars: Collection[str] | None = None) -> list[str]:
    """Return a sentence for each value of a log that lies outside of its range, and for each conversion made in reading
    it.

    Images and sweeps are those of ``cameras`` and ``lidars``; of all where these are None.
    """
    drive = log.drive
    sentences = [*_ego_doubts(log.path, drive), *_actor_doubts(log.path, drive)]
    for name, camera in drive.cameras.items():
        sentences += _camera_doubts(f"{log.path}: {name}", camera, drive)
        if cameras is None or name in cameras:
            sentences += _image_doubts(log, name, camera)
    for name, lidar in drive.lidars.items():
        where = f"{log.path}: {name}"
        sentences += _mount_doubts(where, lidar, drive)
        sentences += _angle(LIDAR_TILT, where, lidar.trajectory, drive, np.array([0.0, 0, 1]), True)
        if lidar.model.beams and lidar.model.sweep_s:
            sentences += TURN.doubt(where, lidar.model.sweep_s)
        if lidars is None or name in lidars:
            sentences += _sweep_doubts(log, name, lidar)
    return list(dict.fromkeys([*sentences, *extras_of(log).notes.values()]))


def _times(drive: Drive) -> FloatArray:
    times = np.array([drive.time_s[frame] for frame in drive.frames])
    return times[spread_indices(len(times), SAMPLED_STEPS)]


def _moves(track: Trajectory, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Speeds (T - 1,) of a trajectory between times (T,), and by what angles it goes beside its x axis where it moves
    (K,), degrees."""
    poses = track.at(times)
    velocity = np.diff(poses[:, :3, 3], axis=0) / np.diff(times)[:, None]
    speed = np.linalg.norm(velocity, axis=1)
    forward = np.einsum("tji,tj->ti", poses[:-1, :3, :3], velocity)[speed > LEAST_SPEED_M_S]
    return speed, np.degrees(np.abs(np.arctan2(np.hypot(forward[:, 1], forward[:, 2]), forward[:, 0])))


def _ego_doubts(path: Path, drive: Drive) -> Iterator[str]:
    times = _times(drive)
    yield from _angle(TILT, path, drive.world_from_ego, drive, np.array([0.0, 0, 1]))
    if len(times) <= FEWEST:
        return
    speed, beside = _moves(drive.world_from_ego, times)
    fast = float(np.quantile(speed, 0.9))
    yield from SPEED.doubt(path, fast)
    if len(beside) >= FEWEST and fast <= SPEED.high:
        yield from HEADING.doubt(path, float(np.median(beside)))


def _angle(
    limits: Range, where: object, track: Trajectory, drive: Drive, axis: FloatArray, either: bool = False
) -> Iterator[str]:
    """Yield a doubt about the angle between an axis of a sensor, or ``either`` of its ends, and the world's z."""
    up = float(np.median(track.at(_times(drive))[:, 2, :3] @ axis))
    yield from limits.doubt(where, float(np.degrees(np.arccos(np.clip(abs(up) if either else up, -1, 1)))))


def _mount_doubts(where: str, sensor: Camera | Lidar, drive: Drive) -> Iterator[str]:
    """Yield doubts about a sensor that rides on the vehicle; one beside the road has none."""
    times = _times(drive)[[0, -1]]
    poses = invert_pose(drive.world_from_ego.at(times)) @ sensor.trajectory.at(times)
    if not sensor.sees_ego_body and np.linalg.norm(poses[0, :3, 3] - poses[1, :3, 3]) < 1.0:
        yield from MOUNT.doubt(where, float(np.linalg.norm(poses[0, :3, 3])))


def _camera_doubts(where: str, camera: Camera, drive: Drive) -> Iterator[str]:
    model = camera.model
    yield from _mount_doubts(where, camera, drive)
    yield from _angle(CAMERA_TILT, where, camera.world_from_camera, drive, np.array([0.0, -1, 0]))
    first, last = drive.time_s[drive.frames[0]], drive.time_s[drive.frames[-1]]
    captured = np.array(list(camera.time_s.values()))
    if len(captured):
        beyond = np.maximum(first - captured, captured - last)
        yield from APART.doubt(where, max(0.0, float(np.median(beyond))))
    across, down = model.cx / model.width, model.cy / model.height
    size = f"{where}: {model.width}x{model.height} pixels with the principal point {model.cx:.4g}, {model.cy:.4g}"
    scale = 2 * float(np.sqrt(max(across * down, 0.0)))
    if abs(scale - 1) > 0.2 and abs(across - down) < 0.1 * scale:
        times = f"{scale:.3g} times as large" if scale > 1 else f"{1 / scale:.3g} times as small"
        yield f"{size}: it is near the middle of an image {times}, so the intrinsics are of another size"
    else:
        yield from CENTRE.doubt(size, max(abs(across - 0.5), abs(down - 0.5)))
    if model.is_pinhole:
        yield from VIEW.doubt(where, float(np.degrees(2 * np.arctan(model.width / 2 / model.fx))))


def _image_doubts(log: Log, name: str, camera: Camera) -> Iterator[str]:
    """Doubts about some images of a camera; those that are not plain are decoded, so that what is done with them is
    noted."""
    size = camera.model.width, camera.model.height
    encoded: Callable[[str, int], bytes] | None = getattr(log, "encoded_image", None)
    for frame in spread(log.image_frames(name)):
        try:
            source = log.image_path(name, frame) if encoded is None else bytes(encoded(name, frame))
            if source is not None:
                header = image_header(source, f"{log.path}: {name}: image {frame}" if encoded else "")
                if header.plain and header.stored == size:
                    continue
            height, width = log.image(name, frame).shape[:2]
        except LogError as fault:
            yield str(fault)
            return
        if (width, height) != size:
            yield f"{log.path}: {name}: image {frame} has {width}x{height} pixels, its camera {size[0]}x{size[1]}"
            return


def _sweep_doubts(log: Log, name: str, lidar: Lidar) -> Iterator[str]:
    for frame in spread(log.sweep_frames(name)):
        try:
            sweep = log.sweep(name, frame)
        except LogError as fault:
            yield str(fault)
            return
        sentences = list(_return_doubts(f"{log.path}: {name}: sweep {frame}", sweep, lidar))
        yield from sentences
        if sentences:
            return


def _return_doubts(where: str, sweep: Sweep, lidar: Lidar) -> Iterator[str]:
    if len(sweep.points) < FEWEST_RETURNS:
        if not len(sweep.points):
            yield f"{where}: no point of it is a return that lies outside of the vehicle"
        return
    distance = np.linalg.norm(sweep.points - sweep.origins, axis=1)
    bright = sweep.intensity
    if not (np.isfinite(distance).all() and np.isfinite(bright).all() and np.isfinite(sweep.time_s).all()):
        yield f"{where}: holds returns that are not finite"
        return
    yield from DISTANCE.doubt(where, float(np.median(distance)))
    if bright.min() < 0 or bright.max() > 1:
        yield f"{where}: intensities are from {bright.min():g} to {bright.max():g}, not 0 to 1"
    for value, share in ((0, (bright <= 0).mean()), (1, (bright >= FULLY).mean())):
        if share > MOST_ALIKE:
            yield f"{where}: {share:.0%} of the returns have the intensity {value}: the layout's scale is another, or it was lost"
    if lidar.model.beams and lidar.model.sweep_s:
        yield from SPAN.doubt(where, float(np.ptp(sweep.time_s)) / lidar.model.sweep_s)
    if lidar.model.beams:
        yield from ON_BEAMS.doubt(where, float((sweep.ring >= 0).mean()))


def _actor_doubts(path: Path, drive: Drive) -> Iterator[str]:
    edges = {uid: float(actor.size_m.max()) for uid, actor in drive.actors.items()}
    wrong = {uid: edge for uid, edge in edges.items() if not EDGE.low <= edge <= EDGE.high}
    if wrong:
        uid = max(wrong, key=wrong.__getitem__)
        others = f" (and {len(wrong) - 1} others)" if len(wrong) > 1 else ""
        yield from EDGE.doubt(f"{path}: box {uid}{others}", wrong[uid])
    vehicles = [actor for actor in drive.actors.values() if motion_of(actor.label) == "rigid"]
    if len(vehicles) > FEWEST:
        wide = np.mean([actor.size_m[0] < actor.size_m[1] for actor in vehicles])
        if wide > SHARE:
            yield f"{path}: {wide:.0%} of {len(vehicles)} vehicles' boxes are wider than long, as if swapped"
    yield from _motion_doubts(path, drive, [actor for actor in vehicles if actor.is_moving])


def _motion_doubts(path: Path, drive: Drive, vehicles: list[Actor]) -> Iterator[str]:
    speeds, beside = [], []
    for actor in vehicles:
        keys = actor.world_from_actor.times_s
        if len(keys) > FEWEST:
            speed, angles = _moves(actor.world_from_actor, keys)
            speeds.append(float(np.median(speed)))
            beside += [float(np.median(angles))] if len(angles) >= FEWEST else []
    if len(speeds) >= FEWEST:
        yield from ACTOR_SPEED.doubt(path, float(np.median(speeds)))
    if len(beside) >= FEWEST:
        yield from ACTOR_HEADING.doubt(path, float(np.median(beside)))
