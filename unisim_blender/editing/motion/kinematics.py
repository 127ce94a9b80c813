"""Speed, acceleration and curvature of a trajectory from its positions and times, and where they exceed
limits. numpy alone.

Annotated positions are noisy by centimetres, and differences of second order turn centimetres into several m/s². So
each quantity is a derivative of a polynomial fitted by least squares to the samples within `HALF_S`
(Savitzky and Golay 1964): a parabola through positions gives the velocity; a line through speeds the longitudinal
acceleration, and a line through headings the yaw rate, from which lateral acceleration and curvature follow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.actor_images.names import group_of
from ...core.geometry import BoolArray, FloatArray
from ...core.world.drive import Drive
from ..sampled.clock import Clock, recorded_poses, recorded_there
from ..sampled.scene import differ
from ..sampled.source import shown_actor
from ..texts import Text

HALF_S = 0.3
"""Half the width of a fit, in seconds; at least three samples."""
MOVING_M_S = 1.5
"""Slower than this the direction of travel is the annotations' noise: there is no curvature and no
lateral acceleration."""
TOLERANCE = 1.05
"""By which factor an edit may exceed what was recorded, where the recording itself exceeds a limit."""
ON_WHEELS = ("CAR", "TRUCK")
"""Groups of the classes that the limits are for. Pedestrians turn on the spot."""


@dataclass(frozen=True)
class Limits:
    """Limits of motion that a road vehicle is not expected to exceed.

    acceleration_m_s2: speeding up or braking. UN Regulation 13-H asks for a mean deceleration of 6.43 m/s² of the
    brakes of every passenger car; few drivers use it. lateral_m_s2: up to about 0.4 g tyres respond linearly, which
    ordinary driving does not leave (Mitschke and Wallentowitz, "Dynamik der Kraftfahrzeuge"). curvature_1_m: a radius
    of 5 m, about the smallest that a small car can drive; the design car of AASHTO's "Green Book" needs 6.4 m.
    """

    acceleration_m_s2: float = 6.0
    lateral_m_s2: float = 4.0
    curvature_1_m: float = 0.2


@dataclass(frozen=True)
class MotionProfile:
    """A trajectory's motion at times (N,), in seconds: arrays (N,) that are NaN where the object is absent, and where
    it is too slow to tell. Acceleration is positive while it speeds up, lateral acceleration and curvature are
    positive to the left."""

    times_s: FloatArray
    speed_m_s: FloatArray
    acceleration_m_s2: FloatArray
    lateral_m_s2: FloatArray
    curvature_1_m: FloatArray


@dataclass(frozen=True)
class MotionComparison:
    """An object's motion beside the recorded one, which is None for what nobody recorded. ``exceeded`` says where (N,)
    each quantity of `QUANTITIES` exceeds its limit: nowhere for what stands as recorded, and for
    classes without limits."""

    name: str
    frames: FloatArray
    now: MotionProfile
    recorded: MotionProfile | None
    is_edited: bool
    exceeded: dict[str, BoolArray]

    @property
    def anywhere(self) -> BoolArray:
        """Whether any limit is exceeded (N,)."""
        return np.any(list(self.exceeded.values()), axis=0)


QUANTITIES = ("acceleration_m_s2", "lateral_m_s2", "curvature_1_m")
"""The members that `Limits` and `MotionProfile` share."""


def motion_of(positions: FloatArray, times_s: FloatArray, there: BoolArray | None = None) -> MotionProfile:
    """Return the motion along positions (N, 3) at rising times (N,); ``there`` (N,) says when the object is present.

    Each stretch of presence is taken by itself. One of fewer than three samples has a speed alone.
    """
    count = len(times_s)
    there = np.ones(count, bool) if there is None else there
    assert positions.shape == (count, 3) and there.shape == (count,), (positions.shape, there.shape, count)
    speed, acceleration, lateral, curvature = (np.full(count, np.nan) for _ in range(4))
    for first, last in runs(there):
        part = slice(first, last)
        if last - first < 2:
            continue
        velocity = slopes(times_s[part], positions[part], 2)
        speed[part] = np.linalg.norm(velocity, axis=1)
        if last - first < 3:
            continue
        acceleration[part] = slopes(times_s[part], speed[part], 1)
        for begin, end in runs(speed[part] > MOVING_M_S):
            moving = slice(first + begin, first + end)
            if end - begin < 3:
                continue
            heading = np.unwrap(np.arctan2(velocity[begin:end, 1], velocity[begin:end, 0]))
            yaw_rate = slopes(times_s[moving], heading, 1)
            lateral[moving] = yaw_rate * speed[moving]
            curvature[moving] = yaw_rate / speed[moving]
    return MotionProfile(times_s, speed, acceleration, lateral, curvature)


def slopes(times_s: FloatArray, values: FloatArray, degree: int) -> FloatArray:
    """Return derivatives (N, ...) of values (N, ...) by time: those of polynomials fitted around each
    of the times (N,).

    The degree is 1 or 2, and 1 where there are two samples only. At both ends the fit is one-sided.
    """
    count = len(times_s)
    degree = min(degree, count - 1)
    half = max(HALF_S, 1.01 * float(np.diff(times_s).max()))
    first = np.searchsorted(times_s, times_s - half - 1e-9)
    last = np.searchsorted(times_s, times_s + half + 1e-9)
    while (few := last - first <= degree).any():  # one-sided and sparse
        first, last = np.where(few, np.maximum(first - 1, 0), first), np.where(few, np.minimum(last + 1, count), last)
    columns = first[:, None] + np.arange(int((last - first).max()))
    weights = (columns < last[:, None]).astype(float)
    near = np.minimum(columns, count - 1)
    powers = ((times_s[near] - times_s[:, None]) / half)[..., None] ** np.arange(degree + 1) * weights[..., None]
    flat = values.reshape(count, -1)
    left, right = np.swapaxes(powers, 1, 2) @ powers, np.swapaxes(powers, 1, 2) @ flat[near]
    return np.asarray(np.linalg.solve(left, right)[:, 1] / half).reshape(values.shape)


def runs(mask: BoolArray) -> list[tuple[int, int]]:
    """Return the stretches in which a mask (N,) is true, as first index and the index after the last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def is_limited(label: str) -> bool:
    """Return whether the limits are for actors of a class."""
    return group_of(label) in ON_WHEELS


def exceeded(motion: MotionProfile, limits: Limits, recorded: MotionProfile | None = None) -> dict[str, BoolArray]:
    """Return where (N,) each of `QUANTITIES` exceeds its limit.

    ``recorded`` is the motion that was edited: where it exceeds a limit itself, by a fault of the annotation say, the
    edit has to exceed its largest value by `TOLERANCE`, so that an edit is not blamed for what the recording has.
    """
    masks = {}
    for name in QUANTITIES:
        limit = getattr(limits, name)
        before = np.abs(getattr(recorded, name)) if recorded is not None else np.zeros(0)
        before = before[np.isfinite(before)]
        if len(before) and before.max() > limit:
            limit = TOLERANCE * before.max()
        masks[name] = np.nan_to_num(np.abs(getattr(motion, name))) > limit
    return masks


def describe(name: str, value: float) -> str:
    """Return what a vehicle does whose quantity of this name has this value, as a part of a sentence."""
    if name == "acceleration_m_s2":
        return Text("accelerates at {value:.1f} m/s²" if value > 0 else "brakes at {value:.1f} m/s²", value=abs(value))
    if name == "lateral_m_s2":
        return Text("corners at {value:.1f} m/s²", value=abs(value))
    return Text(
        "turns at a radius of {radius:.1f} m ({curvature:.2f} 1/m)", radius=1 / abs(value), curvature=abs(value)
    )


EGO_LABEL = "Ego vehicle (car)"


@dataclass(frozen=True)
class ObjectTrack:
    """An object at the clock's frames: poses (N, 4, 4), whether it is present (N,), and what it is."""

    name: str
    kind: str
    uid: str
    label: str
    poses: FloatArray
    there: BoolArray


def compared(track: ObjectTrack, drive: Drive, clock: Clock, limits: Limits) -> MotionComparison:
    """Return an object's motion beside the recorded one of its id."""
    now = motion_of(track.poses[:, :3, 3], clock.times_s, track.there)
    recorded = recorded_track(track, drive, clock)
    before = None if recorded is None else motion_of(recorded[0][:, :3, 3], clock.times_s, recorded[1])
    is_edited = recorded is None or differ(track.poses, track.there, *recorded)
    over = exceeded(now, limits, before)
    if not is_edited or not is_limited(track.label):
        over = {name: np.zeros(len(where), bool) for name, where in over.items()}
    return MotionComparison(track.name, clock.frames, now, before, is_edited, over)


def recorded_track(track: ObjectTrack, drive: Drive, clock: Clock) -> tuple[FloatArray, BoolArray] | None:
    """Return the recorded poses (N, 4, 4) and presence (N,) of an object's id; None where nobody recorded it."""
    if track.kind == "EGO":
        return drive.world_from_ego.at(clock.times_s), np.ones(len(clock.frames), bool)
    actor = drive.actors.get(track.uid)
    return None if actor is None else (recorded_poses(actor, clock), recorded_there(actor, drive, clock))


def label_of(kind: str, uid: str, scene: str, own: str, drive: Drive) -> str:
    """Return the class of an object with the appearance of actor ``uid`` of a trained scene in folder ``scene``, or of
    the drive where that is ""; that of a mesh is its ``own``. "" where nothing tells."""
    if kind == "EGO":
        return EGO_LABEL
    actor = None if own else shown_actor(uid, scene, drive)
    return own if actor is None else actor.label


_newest: dict[str, tuple[tuple[object, ...], MotionComparison]] = {}
"""The newest comparison of each object, and what it was made of."""
MOST = 8
"""Comparisons that are kept."""


def cached_comparison(track: ObjectTrack, drive: Drive, clock: Clock, limits: Limits) -> MotionComparison:
    """Return what `compared` does; the newest of each object is kept until its motion or a limit changes."""
    key = (id(drive), limits, track.kind, track.uid, track.label, track.poses.tobytes(), track.there.tobytes())
    cached = _newest.pop(track.name, None)
    if cached is None or cached[0] != key:
        cached = key, compared(track, drive, clock, limits)
    _newest[track.name] = cached
    while len(_newest) > MOST:
        del _newest[next(iter(_newest))]
    return cached[1]
