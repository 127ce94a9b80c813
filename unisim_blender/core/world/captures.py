"""Captures: what one sensor measures at one time. Everything that renders names its work by captures.

Times are integer microseconds from the log's first frame, so that sensors of different rates share times exactly. A
sensor's frame of the log is a capture, too: the frame's number names its files and seeds its random draws, and its time
is the sensor's own timestamp, to the bit.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from .drive import Camera, Drive, Lidar

US_PER_SECOND = 1_000_000
MAX_TIME_US = 10**13
"""Largest absolute value of times, microseconds."""
_FRAME_NAME = re.compile(r"-?\d{1,18}")
_TIME_NAME = re.compile(r"([nt])(\d{13})us")
_SEED_SEPARATOR = 256
"""Separates a time from a sensor's name in a seed. No byte of a name has this value, so seeds of times and
of frames differ."""


def microseconds(time_s: float) -> int:
    """Return a time in seconds as the nearest integer microseconds."""
    return round(time_s * US_PER_SECOND)


@dataclass(frozen=True)
class Capture:
    """Capture of a sensor at ``time_us``. ``frame`` is the number of the log's frame that the capture belongs to, if
    any."""

    sensor_id: str
    time_us: int
    frame: int | None = None

    @staticmethod
    def of_frame(sensor: Camera | Lidar, frame: int) -> Capture:
        """Return a sensor's capture in a frame of the log."""
        return Capture(sensor.sensor_id, microseconds(sensor.time_s[frame]), frame)

    @staticmethod
    def at(sensor: Camera | Lidar, time_us: int) -> Capture:
        """Return a sensor's capture at a time, which is that of a frame of the log if the frame has this timestamp."""
        frame = next((frame for frame, time_s in sensor.time_s.items() if microseconds(time_s) == time_us), None)
        return Capture(sensor.sensor_id, time_us, frame)

    def time_s(self, sensor: Camera | Lidar) -> float:
        """Return the time in seconds; for a frame of the log, the sensor's own timestamp, to the bit."""
        return self.time_us / US_PER_SECOND if self.frame is None else sensor.time_s[self.frame]

    def seed(self, seed: int) -> list[int]:
        """Return a seed for numpy's generators, derived from ``seed``, the sensor, and the frame (or the time
        if there is none)."""
        name = self.sensor_id.encode()
        if self.frame is not None:
            return [seed, self.frame, *name]
        return [seed, 2 * abs(self.time_us) + (self.time_us < 0), _SEED_SEPARATOR, *name]


CaptureKey = int | str
"""Key of a moment: the number of a log's frame, or the name of a time (`time_name`)."""


@dataclass(frozen=True)
class Moment:
    """Captures of several sensors that share the names of their files: those of one frame of the log, or
    those at one time.

    ``time_us`` is the time of the moment's labels: the frame's, or the time itself.
    """

    key: CaptureKey
    time_us: int
    cameras: tuple[Capture, ...] = ()
    lidars: tuple[Capture, ...] = ()

    @staticmethod
    def of_frame(drive: Drive, frame: int, cameras: Iterable[str], lidars: Iterable[str]) -> Moment:
        """Return the moment of a frame of the log, with those of these sensors that have the frame."""
        return Moment(
            frame,
            microseconds(drive.time_s[frame]),
            tuple(
                Capture.of_frame(drive.cameras[name], frame) for name in cameras if frame in drive.cameras[name].time_s
            ),
            tuple(Capture.of_frame(drive.lidars[name], frame) for name in lidars if frame in drive.lidars[name].time_s),
        )

    @staticmethod
    def at(drive: Drive, time_us: int, cameras: Iterable[str], lidars: Iterable[str]) -> Moment:
        """Return the moment at a time, with all of these sensors."""
        return Moment(
            time_name(time_us),
            time_us,
            tuple(Capture.at(drive.cameras[name], time_us) for name in cameras),
            tuple(Capture.at(drive.lidars[name], time_us) for name in lidars),
        )

    @property
    def captures(self) -> dict[str, Capture]:
        """Its captures, cameras first, by their names: "camera/NAME", "lidar/NAME"."""
        named = {f"camera/{capture.sensor_id}": capture for capture in self.cameras}
        return named | {f"lidar/{capture.sensor_id}": capture for capture in self.lidars}

    @property
    def frame(self) -> int | None:
        """Number of the log's frame; None for a moment at a time."""
        return self.key if isinstance(self.key, int) else None

    @property
    def name(self) -> str:
        """Name of the moment's files, without their suffixes."""
        return name_of(self.key)

    def time_s(self, drive: Drive) -> float:
        """Return the time in seconds; for a frame of the log, its own time, to the bit."""
        return self.time_us / US_PER_SECOND if self.frame is None else drive.time_s[self.frame]


def frame_name(frame: int) -> str:
    """Return the name of a frame's files, without their suffixes: "000042"."""
    return f"{frame:06d}"


def time_name(time_us: int) -> str:
    """Return the name of files at a time, without their suffixes: "t0000001050000us".

    Names sort by time, after those of frames. Times before the log's first frame count from -10^13, so that they sort,
    too: -0.5 s is "n9999999500000us".
    """
    return f"t{time_us:013d}us" if time_us >= 0 else f"n{MAX_TIME_US + time_us:013d}us"


def name_of(key: CaptureKey) -> str:
    """Return the name of a moment's files, without their suffixes."""
    return frame_name(key) if isinstance(key, int) else key


def key_of(name: str) -> CaptureKey:
    """Return the key of the moment whose files have this name: the inverse of `name_of`. Raises ValueError."""
    if _FRAME_NAME.fullmatch(name):
        return int(name)
    time_of_name(name)
    return name


def time_of_name(name: str) -> int:
    """Return the time in microseconds whose files have this name: the inverse of `time_name`. Raises ValueError."""
    match = _TIME_NAME.fullmatch(name)
    if match is None:
        raise ValueError(f"{name!r} is neither a frame's nor a time's name")
    return int(match[2]) - (MAX_TIME_US if match[1] == "n" else 0)


def in_order(keys: Iterable[CaptureKey]) -> list[CaptureKey]:
    """Return the keys sorted: frames by number, then times."""
    return sorted(keys, key=lambda key: (isinstance(key, str), key))


def moments_of(
    drive: Drive,
    frames: Sequence[int],
    times_us: Sequence[int] | None,
    cameras: Iterable[str],
    lidars: Iterable[str],
    of_sensors: dict[str, tuple[int, ...]] | None = None,
) -> tuple[Moment, ...]:
    """Return the moments to render: frames first, then times in order.

    Sensors are captured at ``times_us``, or in ``frames`` if that is None. Sensors with an entry in ``of_sensors``
    (keys "camera/NAME", "lidar/NAME") are captured at the times given there instead.
    """
    own = of_sensors or {}
    names = [*(("camera", name) for name in cameras), *(("lidar", name) for name in lidars)]
    together = [sensor for sensor in names if "/".join(sensor) not in own]
    # without any sensor there are labels
    shared = bool(together) or not names
    at: dict[int, list[tuple[str, str]]] = {time_us: [] for time_us in times_us or () if shared}
    for sensor in names:
        for time_us in own.get("/".join(sensor), times_us or ()):
            at.setdefault(time_us, []).append(sensor)

    def split(chosen: list[tuple[str, str]]) -> tuple[list[str], list[str]]:
        return [name for kind, name in chosen if kind == "camera"], [name for kind, name in chosen if kind == "lidar"]

    in_frames = frames if times_us is None and shared else ()
    return (
        *(Moment.of_frame(drive, frame, *split(together)) for frame in in_frames),
        *(Moment.at(drive, time_us, *split(at[time_us])) for time_us in sorted(at)),
    )
