"""The trajectory that a log is used with: its own poses, or refined ones, which are cached among the user's files."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields

import numpy as np

from ..data.log import REFINED, Log, cached_file
from ..data.moved import Choice, on_trajectory
from ..errors import LogError
from ..files import write_cached
from ..geometry import Trajectory, invert_pose
from ..json_file import Node, read_json
from .agreement import LagAgreement, agreement
from .refine import Refined, corrected, refine
from .sweeps import planes_of, reference_lidar, standing

VERSION = 2
"""Counted on whenever what is measured or refined changes: what an older program cached is made anew."""
WORSE_M = 0.01
"""Refined poses are not used where sweeps agree by this much less at any lag."""


@dataclass(frozen=True)
class PosesReport:
    """What sweeps tell of a log's poses. ``lidar``: whose sweeps; "" without two sweeps."""

    lidar: str
    lags: tuple[LagAgreement, ...] = ()

    @property
    def doubt(self) -> str:
        """A sentence where poses drift; "" where they do not."""
        doubtful = [row for row in self.lags if row.is_doubtful]
        if not doubtful:
            return ""
        row = max(doubtful, key=lambda row: row.off_planes_m - row.plausible_off_planes_m)
        return (
            f"the poses drift: {self.lidar}'s returns lie {row.off_planes_m * 100:.1f} cm (median) from the planes of the "
            f"sweep {row.lag} frames later, and {row.plausible_off_planes_m * 100:.1f} cm where the two sweeps are "
            f"registered, which moves them by {row.moved_m:.2f} m"
        )

    @property
    def words(self) -> str:
        """The agreement in words: "velodyne's sweeps agree to 5, 7 cm over 2, 10 frames"."""
        rows = [(f"{row.apart_m * 100:.0f}", f"{row.plausible_m * 100:.0f}", str(row.lag)) for row in self.lags]
        if not rows:
            return "nothing tells how well the poses fit: there are no two sweeps some frames apart"
        apart, plausible, lags = (", ".join(column) for column in zip(*rows, strict=True))
        return (
            f"{self.lidar}'s sweeps agree to {apart} cm over {lags} frames; {plausible} cm where pairs are registered"
        )


def measured(log: Log) -> PosesReport:
    """Return how well a log's sweeps agree under its poses; from the cache where the log was measured before.

    Raises `LogError` where scipy is not installed, or a sweep cannot be read.
    """
    lidar = reference_lidar(log)
    if lidar is None:
        return PosesReport("")
    cached = cached_file(log, "poses", f"agreement-{VERSION}.json")
    try:
        rows = Node(read_json(cached, LogError), f"{cached}: ", LogError).elements() if cached.is_file() else None
        if rows is not None:
            return PosesReport(lidar, tuple(_row(row) for row in rows))
    except LogError:
        pass  # a broken one is made anew
    lags = agreement(log.sweep_frames(lidar), lambda frame: standing(log, lidar, frame), _track(log, lidar))
    write_cached(cached, json.dumps([asdict(row) for row in lags]).encode())
    return PosesReport(lidar, lags)


def _row(node: Node) -> LagAgreement:
    distances = (node.key(member.name).number() for member in fields(LagAgreement)[1:])
    return LagAgreement(node.key("lag").integer(), *distances)


@dataclass(frozen=True)
class PosedLog:
    """A log with the poses that were chosen, and sentences on them."""

    log: Log
    sentences: tuple[str, ...]


def posed_log(log: Log, choice: Choice, progress: Callable[[float], object] = lambda share: None) -> PosedLog:
    """Return a log with its own or refined poses. "auto": refined ones where the log's drift.

    ``progress`` is called with fractions from 0 to 1. Raises `LogError`: where "refined" is impossible, and what a
    sweep's file raises.
    """
    try:
        before = measured(log)
    except LogError as fault:
        if choice == "refined":
            raise
        return PosedLog(log, (f"how well the poses fit is not measured: {fault}",))
    said = [f"{log.path}: {before.doubt or before.words}"] if before.lidar else []
    if choice == "log" or (choice == "auto" and not before.doubt):
        return PosedLog(log, (*said, *(["--poses refined corrects them"] if before.doubt else [])))
    if not before.lidar:
        raise LogError(f"{log.path}: has no two sweeps of a LiDAR to refine poses by")
    result = _refined(log, before.lidar, progress)
    other = on_trajectory(log, ego_trajectory(log, before.lidar, result.correction), REFINED)
    after = measured(other)
    worse = [
        f"{new.lag} frames: {new.apart_m * 100:.0f} cm, {old.apart_m * 100:.0f} cm before"
        for new, old in zip(after.lags, before.lags, strict=True)
        if not new.apart_m <= old.apart_m + WORSE_M
    ]
    if worse:
        said.append(f"refined poses are not used: sweeps agree less ({'; '.join(worse)})")
        return PosedLog(log, tuple(said))
    said.append(
        f"poses are refined: {after.words}; certain to {np.median(result.std_m) * 100:.1f} cm and "
        f"{np.degrees(np.median(result.std_rad)):.2f} degrees (median)"
    )
    bias = heading_bias(log.drive.world_from_ego, other.drive.world_from_ego)
    if bias is not None and abs(bias[0]) > max(SURE * bias[1], LEAST_BIAS_DEG):
        said.append(
            f"the log's heading is turned by {bias[0]:+.2f} ± {bias[1]:.2f} degrees (left is positive) from where it goes, "
            f"beside what {before.lidar}'s sweeps show: a bias of its IMU, or positions that drift sideways"
        )
    return PosedLog(other, tuple(said))


LEAST_MOVE_M = 1.0
"""The ego moves by this much between two poses that tell its heading."""
FEWEST_MOVES = 4
SURE, LEAST_BIAS_DEG = 4.0, 0.2
"""A heading's bias is said where it is this many standard errors from 0, and this large."""
LEAST_ERROR_DEG = 0.05
"""Standard error, at least: refined poses share the sweeps' own errors."""


def heading_bias(recorded: Trajectory, refined: Trajectory) -> tuple[float, float] | None:
    """Return the mean angle, degrees, by which a recorded ego looks further to the left of where it goes than the
    refined one, and its standard error: a bias between what gives the heading and the LiDAR, or positions that drift
    sideways, which a straight drive does not tell apart; None where too little moves."""
    times = refined.times_s[(refined.times_s >= recorded.times_s[0]) & (refined.times_s <= recorded.times_s[-1])]
    if len(times) < 2:
        return None
    steps = np.linalg.norm(np.diff(refined.positions_at(times), axis=0), axis=1)
    chosen = np.unique(np.searchsorted(np.cumsum(steps), np.arange(0, steps.sum(), LEAST_MOVE_M)))
    if len(chosen) <= FEWEST_MOVES:
        return None
    goes = []
    for poses in (track.at(times[chosen]) for track in (recorded, refined)):
        moved = np.einsum("nji,nj->ni", poses[:-1, :3, :3], np.diff(poses[:, :3, 3], axis=0))
        goes.append(np.arctan2(moved[:, 1], moved[:, 0]))
    bias = np.degrees(np.angle(np.exp(1j * (goes[1] - goes[0]))))
    spread = 1.4826 * float(np.median(np.abs(bias - np.median(bias))))
    return float(np.median(bias)), max(spread / float(np.sqrt(len(bias))), LEAST_ERROR_DEG)


def ego_trajectory(log: Log, lidar: str, correction: Trajectory) -> Trajectory:
    """Return the ego's trajectory where its LiDAR's is `corrected`."""
    recorded, ego = _track(log, lidar), log.drive.world_from_ego
    track = corrected(recorded, correction)
    times = np.union1d(ego.times_s, correction.times_s)
    return Trajectory.from_poses(times, track.at(times) @ invert_pose(recorded.at(times)) @ ego.at(times))


def _track(log: Log, lidar: str) -> Trajectory:
    return log.drive.lidars[lidar].world_from_lidar


def _refined(log: Log, lidar: str, progress: Callable[[float], object]) -> Refined:
    cached = cached_file(log, "poses", f"refined-{VERSION}.json")
    if cached.is_file():
        try:
            return _from_json(Node(read_json(cached, LogError), f"{cached}: ", LogError))
        except LogError:
            pass  # a broken one is made anew
    frames, recorded = log.sweep_frames(lidar), _track(log, lidar)
    planes = []
    for number, frame in enumerate(frames):
        planes.append(planes_of(*standing(log, lidar, frame), recorded))
        progress(0.5 * (number + 1) / len(frames))
    planes = [sweep for sweep in planes if len(sweep.points)]
    if len(planes) < 2:
        raise LogError(f"{log.path}: {len(planes)} of {len(frames)} sweeps of {lidar} show planes; poses need two")
    result = refine(planes, recorded, lambda share: progress(0.5 + share / 2))
    correction = result.correction
    document = {
        "times_s": correction.times_s.tolist(),
        "shift_m": correction.positions.tolist(),
        "turn_wxyz": correction.quaternions_wxyz.tolist(),
        "std_m": result.std_m.tolist(),
        "std_rad": result.std_rad.tolist(),
    }
    write_cached(cached, json.dumps(document).encode())
    return result


def _from_json(node: Node) -> Refined:
    times = node.key("times_s").array(-1)
    keys = Trajectory(times, node.key("shift_m").array(len(times), 3), node.key("turn_wxyz").array(len(times), 4))
    return Refined(keys, node.key("std_m").array(len(times)), node.key("std_rad").array(len(times)))
