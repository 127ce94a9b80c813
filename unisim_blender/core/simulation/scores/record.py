"""Record of a rollout, as scores read it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...errors import UnisimError
from ...geometry import BoolArray, FloatArray, Trajectory
from ...world.classes import Motion, motion_of
from ...world.drive import EGO
from ..footprints import radii
from ..states import EgoState, Footprint

TimeArray = NDArray[np.int64]


class RecordError(UnisimError):
    """A record of a rollout that cannot be scored."""


@dataclass(frozen=True, eq=False)
class PlanRecord:
    """A plan that a driver gave: ``planned_us`` is the time of the state that it started from, ``times_us`` (K,) are its
    times and ``poses`` (K, 3) the x, y (m) and heading (rad) of the middle of the rear axle then, world frame."""

    planned_us: int
    times_us: TimeArray
    poses: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "times_us", _times(self.times_us, f"the plan of {self.planned_us / 1e6:g} s"))
        object.__setattr__(self, "poses", np.asarray(self.poses, np.float64))
        name = f"the plan of {self.planned_us / 1e6:g} s"
        if self.poses.shape != (len(self.times_us), 3):
            raise RecordError(
                f"{name} has poses {self.poses.shape} for {len(self.times_us)} times, not a row of 3 each"
            )
        if not np.isfinite(self.poses).all():
            row = int(np.isfinite(self.poses).all(1).argmin())
            raise RecordError(f"{name} has a pose {row} that is not finite: {self.poses[row].tolist()}")


@dataclass(frozen=True, eq=False)
class Tracks:
    """All actors of a record as arrays: ``boxes`` (T, A, 5) of x, y, length, width, heading, ``speeds_m_s`` (T, A)
    along the heading, ``present`` (T, A). Where an actor is absent its box and speed are 0. ``uids`` and ``labels``
    are A long."""

    uids: tuple[str, ...]
    labels: tuple[str, ...]
    boxes: FloatArray
    speeds_m_s: FloatArray
    present: BoolArray

    @cached_property
    def radii_m(self) -> FloatArray:
        """Radii (A,) of the circles around the actors' boxes, the greatest of all steps."""
        return np.asarray(radii(self.boxes).max(0))


@dataclass(frozen=True, eq=False)
class Record:
    """A finished rollout of T steps. World: metres, z up, as in `world.drive`.

    ``times_us`` (T,): of the steps, increasing, from the log's first frame. ``ego``, ``ego_footprints``, ``actors``:
    what was there at each step; actors alone that are present. ``recorded_ego``: the log's drive of the middle of the
    ego's rear axle.

    Optional: ``plans`` in the order they were made. ``unsupported_share``: for each step the share, 0 to 1, of the
    pixels shown to the driver that nobody recorded; None where it was shown none. ``confidence``: likewise the mean over
    sensors of the mean confidence of pixels or returns. ``recorded_paths``: paths (K, 2) of
    the log's vehicles, the ego's apart. ``ego_poses`` (T, 4, 4): world from the ground beneath the middle of the rear
    axle, x forward, y left, z away from the ground. ``classes``: how actors of the log's own classes move (see
    `world.classes`).

    Raises `RecordError` in one sentence that names the step and the value.
    """

    times_us: TimeArray
    ego: tuple[EgoState, ...]
    ego_footprints: tuple[Footprint, ...]
    actors: tuple[tuple[Footprint, ...], ...]
    recorded_ego: Trajectory
    plans: tuple[PlanRecord, ...] | None = None
    unsupported_share: tuple[float | None, ...] | None = None
    confidence: tuple[float | None, ...] | None = None
    recorded_paths: tuple[FloatArray, ...] = ()
    ego_poses: FloatArray | None = None
    classes: Mapping[str, Motion] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "times_us", _times(self.times_us, "the record"))
        steps = len(self.times_us)
        for name in ("ego", "ego_footprints", "actors", "unsupported_share", "confidence", "ego_poses"):
            value = getattr(self, name)
            if value is not None and len(value) != steps:
                raise RecordError(f"the record has {steps} times and {len(value)} of {name}")
        self._check_finite(np.array([_numbers(state) for state in self.ego], np.float64), "the ego's state")
        sound = np.isfinite(self.ego_boxes).all(1) & (self.ego_boxes[:, 2:4] > 0).all(1)
        if not sound.all():
            step = int(sound.argmin())
            raise RecordError(f"the ego's footprint {self._at(step)} is no box: {self.ego_footprints[step]}")
        _ = self.tracks  # made here, so that a record that exists is known to be sound
        for name, values in (("unsupported share", self.unsupported_share), ("confidence", self.confidence)):
            for step, value in enumerate(values or ()):
                if value is not None and not 0 <= value <= 1:
                    raise RecordError(f"the {name} {self._at(step)} is {value}, not from 0 to 1")
        if self.ego_poses is not None:
            object.__setattr__(self, "ego_poses", np.asarray(self.ego_poses, np.float64))
            if self.ego_poses.shape != (steps, 4, 4):
                raise RecordError(f"the ego's poses are {self.ego_poses.shape}, not ({steps}, 4, 4)")
            self._check_finite(self.ego_poses.reshape(steps, 16), "the ego's pose")
        paths = tuple(np.asarray(path, np.float64) for path in self.recorded_paths)
        for index, path in enumerate(paths):
            if path.ndim != 2 or path.shape[1:] != (2,) or not len(path) or not np.isfinite(path).all():
                raise RecordError(f"recorded path {index} is no list of finite x, y: {path.shape}")
        object.__setattr__(self, "recorded_paths", paths)
        times_us = [plan.planned_us for plan in self.plans or ()]
        if any(later <= earlier for earlier, later in zip(times_us, times_us[1:], strict=False)):
            raise RecordError(f"plans are not in the order they were made: {times_us}")

    @cached_property
    def times_s(self) -> FloatArray:
        """Seconds (T,) of the steps, from the log's first frame."""
        return self.times_us / 1e6

    def until(self, steps: int) -> Record:
        """Return the record of the first ``steps`` steps."""
        plans = None if self.plans is None else tuple(p for p in self.plans if p.planned_us < self.times_us[steps - 1])
        parts = {
            name: getattr(self, name)[:steps]
            for name in ("times_us", "ego", "ego_footprints", "actors")
            + ("unsupported_share", "confidence", "ego_poses")
            if getattr(self, name) is not None
        }
        return replace(self, **parts, plans=plans)

    @cached_property
    def ego_axle(self) -> FloatArray:
        """x, y and heading (T, 3) of the middle of the ego's rear axle."""
        return np.array([(state.x_m, state.y_m, state.heading_rad) for state in self.ego], np.float64)

    @cached_property
    def ego_speeds(self) -> FloatArray:
        """Speeds (T,) of the ego along its heading."""
        return np.array([state.speed_m_s for state in self.ego], np.float64)

    @cached_property
    def ego_boxes(self) -> FloatArray:
        """The ego's boxes (T, 5): x, y, length, width, heading."""
        return np.array([_box(footprint) for footprint in self.ego_footprints], np.float64)

    @cached_property
    def tracks(self) -> Tracks:
        labels = {footprint.uid: footprint.label for step in reversed(self.actors) for footprint in step}
        uids = tuple(sorted(labels))
        if EGO in labels:
            raise RecordError(f'an actor of the record has the uid "{EGO}", which is the ego vehicle\'s')
        column = {uid: index for index, uid in enumerate(uids)}
        steps = np.repeat(np.arange(len(self.actors)), [len(step) for step in self.actors])
        columns = np.array([column[footprint.uid] for step in self.actors for footprint in step], np.int64)
        footprints = [footprint for step in self.actors for footprint in step]
        rows = np.array([(*_box(footprint), footprint.speed_m_s) for footprint in footprints], np.float64).reshape(
            -1, 6
        )
        sound = np.isfinite(rows).all(1) & (rows[:, 2:4] > 0).all(1)
        if not sound.all():
            fault = int(sound.argmin())
            wrong = footprints[fault]
            raise RecordError(f"the footprint of actor {wrong.uid} {self._at(int(steps[fault]))} is no box: {wrong}")
        present = np.zeros((len(self.actors), len(uids)), bool)
        present[steps, columns] = True
        if present.sum() != len(rows):
            counts = np.zeros(present.shape, np.int64)
            np.add.at(counts, (steps, columns), 1)
            step, actor = np.argwhere(counts > 1)[0]
            raise RecordError(f"actor {uids[actor]} stands twice in the record {self._at(int(step))}")
        boxes = np.zeros((*present.shape, 6))
        boxes[steps, columns] = rows
        return Tracks(uids, tuple(labels[uid] for uid in uids), boxes[..., :5].copy(), boxes[..., 5].copy(), present)

    @cached_property
    def recorded_times(self) -> BoolArray:
        """Which steps (T,) are within the log: what lies before or after was not recorded."""
        first, last = self.recorded_ego.times_s[[0, -1]]
        return np.asarray((self.times_s >= first - 1e-6) & (self.times_s <= last + 1e-6))

    def is_object(self, label: str) -> bool:
        """Whether actors of a class are objects that stand where they are, as cones do, and no road users."""
        return motion_of(label, self.classes) == "still"

    def _check_finite(self, rows: FloatArray, name: str) -> None:
        finite = np.isfinite(rows).all(1)
        if not finite.all():
            step = int(finite.argmin())
            raise RecordError(f"{name} {self._at(step)} is not finite: {rows[step].tolist()}")

    def _at(self, step: int) -> str:
        return f"at step {step} ({self.times_s[step]:g} s)"


def _times(times_us: Sequence[int] | TimeArray, name: str) -> TimeArray:
    """Times (T,), T >= 1, that increase, as an array."""
    times = np.asarray(times_us)
    if times.ndim != 1 or not len(times) or not np.issubdtype(times.dtype, np.integer):
        raise RecordError(f"{name} needs times in whole microseconds, one at least, not {times.dtype} {times.shape}")
    late = np.flatnonzero(np.diff(times) <= 0)
    if len(late):
        index = int(late[0])
        raise RecordError(
            f"{name} has time {index + 1}, {times[index + 1]} us, that is not later than {times[index]} us"
        )
    return times.astype(np.int64)


def _box(footprint: Footprint) -> tuple[float, ...]:
    return footprint.x_m, footprint.y_m, footprint.length_m, footprint.width_m, footprint.heading_rad


def _numbers(state: EgoState) -> tuple[float, ...]:
    return state.x_m, state.y_m, state.heading_rad, state.speed_m_s, state.acceleration_m_s2, state.steering_rad
