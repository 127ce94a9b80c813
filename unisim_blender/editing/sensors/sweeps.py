"""Sweeps to look at: recorded and simulated returns and drops, whose points they are, and how far they are apart beam by
beam."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...core.data.sweep_cells import with_drops
from ...core.evaluation.lidar_metrics import lidar_metrics
from ...core.geometry import BoolArray, FloatArray, invert_pose
from ...core.world.drive import Actor, Drive, Lidar
from ...core.world.drive_json import arrays_to_json
from ..sampled.source import DriveSource
from .mounts import sees_the_same

RECORDED, SIMULATED = "recorded", "simulated"
DROPS = {RECORDED: "recorded drops", SIMULATED: "simulated drops"}
DROP_M = 15.0
"""Range at which beams that did not return are shown."""
SAME_TIME_S = 1e-6
Attributes = Mapping[str, NDArray[np.generic]]


@dataclass(frozen=True)
class ViewedSweep:
    """Points (N, 3) of the world of one LiDAR: returns, or beams that did not return at `DROP_M`, by ``kind``.

    ``attributes`` (N,) by name: ``intensity``; ``depth``, the range in metres; ``ring``; ``cell``, column * beams +
    ring; ``instance``, a number for each actor; ``class``, an index into ``classes`` plus 1. Rings and cells are -1
    where no beam is known, instances and classes 0 off the actors. Of the returns of one beam only the strongest has a
    cell. ``frame`` is the one that was measured.
    """

    lidar: str
    kind: str
    points: NDArray[np.floating[Any]]
    attributes: Attributes = field(default_factory=dict)
    classes: tuple[str, ...] = ()
    frame: float = 0.0

    @property
    def cells(self) -> NDArray[np.int64]:
        """The cell of each point (N,), -1 where no beam is known."""
        return np.asarray(self.attributes.get("cell", np.full(len(self.points), -1)), np.int64)


def recorded_sweeps(source: DriveSource, frame: int, drops: bool = False) -> list[ViewedSweep]:
    """Read the recorded returns of a frame, of every LiDAR, from the log's files, with ``drops`` also beams that did not
    return; in any thread."""
    log, sweeps = source.log, list[ViewedSweep]()
    if log is None:
        return sweeps
    for name, lidar in source.drive.lidars.items():
        if frame not in log.sweep_frames(name):
            kinds = (RECORDED, DROPS[RECORDED]) if drops else (RECORDED,)
            sweeps += [ViewedSweep(name, kind, np.zeros((0, 3)), frame=frame) for kind in kinds]
            continue
        sweep, beams = log.sweep(name, frame), lidar.model.beams
        known = (sweep.ring >= 0) & (sweep.column >= 0) & (beams > 0)
        strongest = known if sweep.rank is None else known & (sweep.rank == 0)
        attributes = {
            "intensity": sweep.intensity,
            "depth": np.linalg.norm(sweep.points - sweep.origins, axis=1),
            "ring": np.where(known, sweep.ring, -1),
            "cell": np.where(strongest, sweep.column * beams + sweep.ring, -1),
        }
        numbers, actors = actors_of_points(source.drive, sweep.points, sweep.time_s)
        sweeps.append(ViewedSweep(name, RECORDED, sweep.points, *_with_actors(attributes, numbers, actors), frame))
        if drops and (known_drops := with_drops(log, name, frame).drops) is not None:
            cells = np.where(known_drops.ring >= 0, known_drops.column * beams + known_drops.ring, -1)
            points = known_drops.origins + DROP_M * known_drops.directions
            sweeps.append(ViewedSweep(name, DROPS[RECORDED], points, {"cell": cells}, (), frame))
    return sweeps


def simulated_sweeps(
    lidar: str,
    arrays: Mapping[str, NDArray[np.generic]],
    beams: int,
    actors: Sequence[tuple[str, str]],
    same: bool,
    frame: float = 0.0,
) -> list[ViewedSweep]:
    """Return the sweep that the worker simulated: ``arrays`` and id and class of the ``actors`` are its own.

    ``same``: its beams are the recorded ones (`same_beams`), and can be compared with them.
    """
    cell = arrays["cell"].astype(np.int64)
    assert cell.ndim == 1, f"cells of shape {cell.shape}"
    measured = {"intensity": arrays["intensity"], "depth": arrays["depth"], "ring": cell % beams}
    measured["cell"] = cell if same else np.full_like(cell, -1)
    dropped = arrays["dropped_cell"] if same else np.full_like(arrays["dropped_cell"], -1)
    points = arrays["dropped_origins"].astype(float) + DROP_M * arrays["dropped_directions"].astype(float)
    attributes, classes = _with_actors(measured, arrays["instance"].astype(np.int64), actors)
    return [
        ViewedSweep(lidar, SIMULATED, arrays["points"].astype(float), attributes, classes, frame),
        ViewedSweep(lidar, DROPS[SIMULATED], points, {"cell": dropped}, (), frame),
    ]


def same_beams(lidar: Lidar, time_s: float, drive: Drive, frame: float) -> bool:
    """Return whether a sweep of a LiDAR at ``time_s`` has the beams, from the place, of the recorded one of a frame."""
    recorded = drive.lidars.get(lidar.sensor_id)
    if recorded is None or abs(recorded.time_s.get(int(frame), np.inf) - time_s) > SAME_TIME_S:
        return False
    models = [arrays_to_json(sensor.model_at(time_s)) for sensor in (lidar, recorded)]
    return models[0] == models[1] and sees_the_same(
        lidar.world_from_lidar.at(time_s), recorded.world_from_lidar.at(time_s)
    )


def actors_of_points(
    drive: Drive, points: FloatArray, time_s: FloatArray
) -> tuple[NDArray[np.int64], list[tuple[str, str]]]:
    """Return for points (N, 3) measured at times (N,) the number (N,) of the actor in whose box each lies, from 1, 0 for
    none; and the actors' ids and classes. Of overlapping boxes the first one counts."""
    numbers, by_x = np.zeros(len(points), np.int64), np.argsort(points[:, 0])
    x = points[by_x, 0]
    actors: list[Actor] = sorted(drive.actors.values(), key=lambda actor: actor.uid)
    for number, actor in enumerate(actors if len(points) else (), 1):
        first, last = max(actor.start_s, float(time_s.min())), min(actor.end_s, float(time_s.max()))
        if first > last:
            continue
        ends = actor.world_from_actor.positions_at(np.array([first, last]))
        reach = np.linalg.norm(actor.size_m) / 2 + np.linalg.norm(ends[1] - ends[0])
        low, high = np.searchsorted(x, ends[0, 0] + reach * np.array([-1.0, 1.0]))
        near = by_x[low:high][(np.abs(points[by_x[low:high], 1] - ends[0, 1]) <= reach)]
        near = near[numbers[near] == 0]
        times, column = np.unique(np.clip(time_s[near], first, last), return_inverse=True)
        poses = invert_pose(actor.world_from_actor.at(times))[column]
        local = np.einsum("nij,nj->ni", poses[:, :3, :3], points[near]) + poses[:, :3, 3]
        numbers[near[(np.abs(local) <= np.asarray(actor.size_m) / 2).all(1)]] = number
    return numbers, [(actor.uid, actor.label) for actor in actors]


def _with_actors(
    attributes: Attributes, numbers: NDArray[np.int64], actors: Sequence[tuple[str, str]]
) -> tuple[Attributes, tuple[str, ...]]:
    """Return attributes with instance and class of points by the numbers (N,) of their actors, from 1, and the
    classes. An actor's instance is the same number in every sweep."""
    classes = tuple(sorted({label for _, label in actors}))
    instances = [0, *(zlib.crc32(uid.encode()) & 0x7FFFFFFF for uid, _ in actors)]
    labels = [0, *(classes.index(label) + 1 for _, label in actors)]
    return {**attributes, "instance": np.array(instances)[numbers], "class": np.array(labels)[numbers]}, classes


class BeamRanges(NamedTuple):
    """Ranges in metres and intensities of one LiDAR (2, C) by kind of sweep and cell, NaN where a beam did not return;
    ``known`` (C,): cells of recorded returns and drops. ``drops``: whether recorded drops are known."""

    measured: Mapping[str, FloatArray]
    known: BoolArray
    drops: bool


def beam_ranges(sweeps: Sequence[ViewedSweep]) -> dict[str, BeamRanges]:
    """Return the ranges of each LiDAR of which some recorded and some simulated beams are the same, of one frame."""
    ranges = {}
    for lidar in {sweep.lidar for sweep in sweeps}:
        own = {sweep.kind: sweep for sweep in sweeps if sweep.lidar == lidar}
        compared = [own[kind] for kind in (RECORDED, SIMULATED) if kind in own and (own[kind].cells >= 0).any()]
        if len(compared) < 2 or compared[0].frame != compared[1].frame:
            continue
        count = 1 + max(int(sweep.cells.max(initial=-1)) for sweep in own.values())
        measured = {sweep.kind: _by_cell(sweep, count) for sweep in compared}
        known = np.isfinite(measured[RECORDED][0])
        dropped = own.get(DROPS[RECORDED])
        if dropped is not None:
            known[dropped.cells[dropped.cells >= 0]] = True
        ranges[lidar] = BeamRanges(measured, known, dropped is not None)
    return ranges


def _by_cell(sweep: ViewedSweep, count: int) -> FloatArray:
    """Return ranges and intensities of a sweep's points by their cells (2, C), NaN for others; of two in a cell, the
    nearer's."""
    depth, points = sweep.attributes["depth"].astype(float), np.flatnonzero(sweep.cells >= 0)
    if np.bincount(sweep.cells[points]).max(initial=0) > 1:
        points = points[np.argsort(-depth[points], kind="stable")]
    values = np.full((2, count), np.nan)
    values[:, sweep.cells[points]] = depth[points], sweep.attributes["intensity"][points]
    return values


def _of_beams(
    sweep: ViewedSweep, ranges: Mapping[str, BeamRanges], table: Callable[[BeamRanges], Any], nothing: float
) -> NDArray[Any]:
    """Return what a table (C,) says of the beam of each point (N,), ``nothing`` where beams are not compared."""
    if sweep.lidar not in ranges:
        return np.full(len(sweep.points), nothing)
    return np.append(table(ranges[sweep.lidar]), nothing)[sweep.cells]


def range_differences(sweep: ViewedSweep, ranges: Mapping[str, BeamRanges]) -> FloatArray:
    """Return the recorded minus the simulated range (N,) of the beam of each point, in metres; NaN where only one
    returns, or they are not the same beams."""
    return _of_beams(sweep, ranges, lambda both: both.measured[RECORDED][0] - both.measured[SIMULATED][0], np.nan)


def returns_in_the_other(sweep: ViewedSweep, ranges: Mapping[str, BeamRanges]) -> BoolArray:
    """Return whether the beam of each point (N,), of a recorded or simulated sweep, returned in the other one."""
    other = SIMULATED if sweep.kind in (RECORDED, DROPS[RECORDED]) else RECORDED
    return _of_beams(sweep, ranges, lambda both: np.isfinite(both.measured[other][0]), False)


def returns_alone(sweep: ViewedSweep, ranges: Mapping[str, BeamRanges]) -> BoolArray:
    """Return which points (N,) are of beams that did not return in the other sweep."""
    known = _of_beams(sweep, ranges, lambda both: both.known | (sweep.kind == RECORDED), False)
    return known & ~returns_in_the_other(sweep, ranges)


STRAY_M = 1.0


def stray_points(sweeps: Sequence[ViewedSweep], ranges: Mapping[str, BeamRanges]) -> int:
    """Return how many simulated points off the actors lie more than `STRAY_M` in front of the recorded return of their
    beam: where the recorded beam passed, there was nothing."""
    return sum(
        int(((range_differences(sweep, ranges) > STRAY_M) & (sweep.attributes["class"].astype(int) == 0)).sum())
        for sweep in sweeps
        if sweep.kind == SIMULATED and "class" in sweep.attributes and ranges
    )


def sweep_metrics(ranges: Mapping[str, BeamRanges]) -> dict[str, float] | None:
    """Return the metrics of `unisim eval` over the beams that were recorded, of all LiDARs; None where recorded drops
    are not known."""
    sets = [both for both in ranges.values() if both.drops]
    if not sets:
        return None
    recorded, simulated = (
        np.concatenate([both.measured[kind][:, both.known] for both in sets], 1).astype(np.float32)
        for kind in (RECORDED, SIMULATED)
    )
    return lidar_metrics(*simulated, np.isfinite(simulated[0]), *recorded, np.isfinite(recorded[0]))
