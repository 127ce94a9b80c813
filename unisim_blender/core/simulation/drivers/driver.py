"""Interface of drivers: their observations (sensors' data, the vehicle's motion and its route; neither boxes nor the
scenario), and the drivers that are registered."""

from __future__ import annotations

import traceback
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...errors import SimulationError, UnisimError, in_a_line, short
from ...files import write_file
from ...geometry import FloatArray
from ...output.frame_files import POINT_FIELDS as FIELDS
from ...registry import Registry, named_function
from ...world.drive import CameraModel, LidarModel
from ..actors.recording import Recording
from ..states import EgoState, Traffic
from ..vehicle.actions import Control, Plan
from ..vehicle.parameters import Vehicle
from ..world import Action, FollowLog

POINT_FIELDS = np.dtype([(name, FIELDS[name]) for name in FIELDS.names or () if name != "instance"])
"""As in the files of sweeps (`output.frame_files.POINT_FIELDS`), without the instances."""


@dataclass(frozen=True, eq=False)
class CameraImage:
    """A camera's image: ``rgb`` (H, W, 3) uint8, sRGB, row 0 at the top. ``time_us`` is its timestamp, ``start_us`` and
    ``end_us`` are when its exposure started and ended, integer microseconds from the log's first frame. ``confidence`` (H, W)
    in 0..1 is there where the rollout has this pass."""

    sensor_id: str
    time_us: int
    start_us: int
    end_us: int
    rgb: NDArray[np.uint8]
    confidence: NDArray[np.float32] | None = None


@dataclass(frozen=True, eq=False)
class LidarSweep:
    """A LiDAR's returns; times as of an `CameraImage`.

    ``points`` are records (N,) of `POINT_FIELDS`, for example ``points["x"]``: ``x``, ``y``, ``z`` (m) in the LiDAR's frame at
    ``time_us``, `SensorSetup.rear_axle_from_sensor` places it on the vehicle; ``intensity``, 0 to 1; ``ring``, the beam;
    ``azimuth`` (rad) and ``time`` (s from the log's first frame) of firing. ``confidence`` (N,): see `CameraImage`.
    """

    sensor_id: str
    time_us: int
    start_us: int
    end_us: int
    points: NDArray[np.void]
    confidence: NDArray[np.float32] | None = None


@dataclass(frozen=True)
class EgoMotion:
    """The vehicle's state at a time, as its own sensors measure it: without error."""

    time_us: int
    state: EgoState


@dataclass(frozen=True, eq=False)
class SensorSetup:
    """A sensor as the driver knows it: its model, and its pose (4, 4) in the rear axle's frame (x forward, y left, z up)."""

    model: CameraModel | LidarModel
    rear_axle_from_sensor: FloatArray


@dataclass(frozen=True, eq=False)
class DriverSetup:
    """Information that a driver has before it drives: its vehicle, its sensors by name, a step's length and its
    answers' delay (integer microseconds), and a seed.

    ``route`` (P, 2) are points on the way in order, world frame, metres: the recorded path, without times.
    ``rear_axle_height_m``: how high the middle of the rear axle, as the log's ego frame has it, lies above the ground where the
    drive starts. ``history`` are the vehicle's recorded states of up to 2 s before the start, a step apart; none where the
    recording begins there, or the vehicle starts elsewhere than it was recorded."""

    vehicle: Vehicle
    sensors: Mapping[str, SensorSetup]
    route: FloatArray
    step_us: int
    delay_us: int
    seed: int
    rear_axle_height_m: float = 0.0
    history: tuple[EgoMotion, ...] = ()
    recording: Recording | None = field(default=None, repr=False)
    """For privileged drivers alone."""


@dataclass(frozen=True, eq=False)
class Observation:
    """Data for a driver at ``time_us``: all delivered since it was asked last, in the order in which exposures ended.

    ``motion`` has the vehicle's states since then, the last one of now. ``traffic`` is there for privileged drivers alone.
    """

    time_us: int
    images: tuple[CameraImage, ...]
    sweeps: tuple[LidarSweep, ...]
    motion: tuple[EgoMotion, ...]
    traffic: Traffic | None = field(default=None, repr=False)

    @property
    def ego(self) -> EgoState:
        """The vehicle's state now."""
        return self.motion[-1].state


TRACEBACK_NAME = "driver-error.txt"
"""Where in its folder a rollout leaves the traceback of a driver that failed."""
OURS = Path(__file__).parents[3]


class Driver(Protocol):
    """Drives one rollout. Its answers depend on what it was given alone: a rollout repeats them where it is resumed."""

    def drive(self, observation: Observation) -> Action:
        """Return what the vehicle is to do from ``observation.time_us`` on: a `Control`, which is held until the next answer
        takes effect, or a `Plan`, which is tracked. Left is positive: of steering angles, and of headings, which count
        counter-clockwise from the world's x."""

    def close(self) -> None:
        """Give back what the driver holds; it is not asked again."""


@dataclass(frozen=True)
class Endpoint:
    """Where a driver's process listens: "HOST:PORT" or "unix:PATH". ``authority``: the file of the certificates by which another
    machine's is known, which goes with TLS."""

    address: str
    authority: Path | None = None


@dataclass(frozen=True)
class DriverKind:
    """A driver by the name that `unisim drive --driver` has for it. ``start`` gives the driver of one rollout.

    ``about`` says what it does, in a few words for the command line's help. A ``privileged`` driver is told where everything
    is: its scores do not compare with others'. ``drives``: whether it moves the vehicle; one that replays the log does not.
    ``remote``: of a driver that is a process of its own, what gives ``start`` for its address.
    """

    name: str
    about: str
    start: Callable[[DriverSetup], Driver]
    privileged: bool = False
    drives: bool = True
    remote: Callable[[Endpoint], Callable[[DriverSetup], Driver]] | None = None


@dataclass(eq=False)
class CheckedDriver:
    """A driver of which everything that goes wrong is one sentence: `SimulationError` that names the driver and the step.

    The traceback of its own code goes to ``driver-error.txt`` in ``out``, a rollout's folder.
    """

    name: str
    out: Path
    driver: Any = None
    step: int = 0
    _failed: bool = field(default=False, init=False)

    @staticmethod
    def started(kind: DriverKind, setup: DriverSetup, out: Path) -> CheckedDriver:
        """Return the driver of one rollout, started."""
        checked = CheckedDriver(kind.name, out)
        with suppress(OSError):
            (out / TRACEBACK_NAME).unlink(missing_ok=True)
        try:
            checked.driver = kind.start(setup)
        except (Exception, SystemExit) as error:
            raise checked._fault("at its start", error) from error
        for name in ("drive", "close"):
            if not callable(getattr(checked.driver, name, None)):
                raise SimulationError(
                    f'driver "{kind.name}": must give an object with drive(observation) and close(); '
                    f"{_described(checked.driver)} has no {name}"
                )
        return checked

    def drive(self, observation: Observation) -> Action:
        self.step += 1
        when = f"at step {self.step}, {observation.time_us / 1e6:g} s"
        try:
            answer: object = self.driver.drive(observation)
        except (Exception, SystemExit) as error:
            raise self._fault(when, error) from error
        if isinstance(answer, Control | Plan | FollowLog):
            return answer
        self._failed = True
        if hasattr(answer, "close"):  # what a generator or a coroutine holds
            answer.close()
        raise SimulationError(
            f'driver "{self.name}" {when}: answered with {_described(answer)}, not with a Control or a Plan{self._resume_hint}'
        )

    def close(self) -> None:
        """See `Driver.close`. A driver that cannot be closed is warned of: what it drove is finished."""
        try:
            self.driver.close()
        except (Exception, SystemExit) as error:
            if not self._failed:
                warnings.warn(str(self._fault("as it was closed", error)), stacklevel=2)

    @property
    def _resume_hint(self) -> str:
        return "; the steps before it are kept: continue with --resume" if self.step > 1 else ""

    def _fault(self, when: str, error: BaseException) -> SimulationError:
        self._failed = True
        place, frames = "", _own_frames(error.__traceback__)
        if frames is not None:
            name = frames.tb_frame.f_code.co_filename
            line = [frame.lineno for frame in traceback.extract_tb(frames) if frame.filename == name][-1]
            place = f" ({Path(name).name}, line {line})"
        text = str(error) if isinstance(error, UnisimError) else f"{type(error).__name__}: {in_a_line(error)}"  # type: ignore[arg-type]
        if frames is not None and not isinstance(error, UnisimError):
            with suppress(OSError, UnisimError):
                lines = traceback.format_exception(type(error), error, frames)
                write_file(self.out / TRACEBACK_NAME, "".join(lines).encode(errors="replace"))
                place += f", traceback in {self.out / TRACEBACK_NAME}"
        return SimulationError(f'driver "{self.name}" {when}: {text}{place}{self._resume_hint}')


def _own_frames(frames: TracebackType | None) -> TracebackType | None:
    """Return a traceback from the first frame on that is not this package's; None where there is none."""
    while frames is not None and Path(frames.tb_frame.f_code.co_filename).is_relative_to(OURS):
        frames = frames.tb_next
    return frames


def _described(value: object) -> str:
    shape = getattr(value, "shape", None)
    size = f" of shape {tuple(shape)}" if isinstance(shape, tuple) else ""
    return "None" if value is None else f"a {type(value).__name__}{size} {short(value)}"


DRIVERS: Registry[DriverKind] = Registry("a driver")
"""The registered drivers by the name that `unisim drive --driver` has for them."""
register = DRIVERS.register


def driver_named(name: str, endpoint: Endpoint | None = None) -> DriverKind:
    """Return the driver of a name: one of `DRIVERS`, at ``endpoint`` if it is remote, or ``module:function``, which is called
    with a `DriverSetup` and returns a `Driver`. Raises `UnisimError`."""
    kind = DRIVERS.get(name)
    remote = None if kind is None else kind.remote
    if endpoint is not None and remote is None:
        raise UnisimError(f'--driver-address {endpoint.address}: the driver "{name}" has none')
    if kind is not None and remote is None:
        return kind
    if kind is not None and remote is not None:
        if endpoint is None:
            raise UnisimError(f'--driver "{name}": needs --driver-address')
        return replace(kind, start=remote(endpoint))
    start = named_function("--driver", name, "a DriverSetup", f"one of {', '.join(DRIVERS)}, or module:function")
    return DriverKind(name, "of a module", start)
