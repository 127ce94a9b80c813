"""Beam and column of each return of a spinning LiDAR, and sweeps as beams x columns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from ..sensors.lidar import beam_directions, lidar_rays
from ..world.drive import Lidar, LidarModel
from .log import Drops, Log, OtherReturns, Sweep, SweepGrid, SweepRays

MAX_ELEVATION_ERROR_RAD = np.radians(0.5)
"""Largest angle, radians, between a return and its beam."""
BLOCKED_BELOW_RAD = np.radians(-10.0)
"""Elevation, radians, below which beams hit the road within some ten metres: one that never returns is blocked."""


def find_cells(local: FloatArray, model: LidarModel) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return beam and column (N,), both -1 where no beam fits, of points (N, 3) in the sensor's frame at their own
    time."""
    elevation = np.arctan2(local[:, 2], np.hypot(local[:, 0], local[:, 1]))
    azimuth = np.arctan2(local[:, 1], local[:, 0])
    rising = np.argsort(model.elevation_rad, kind="stable")
    levels = model.elevation_rad[rising]
    ring = rising[np.searchsorted((levels[1:] + levels[:-1]) / 2, elevation)]
    fits = np.abs(model.elevation_rad[ring] - elevation) <= MAX_ELEVATION_ERROR_RAD
    if model.column_azimuth_rad is None:
        turn = model.direction * (azimuth - model.start_azimuth_rad - model.azimuth_offset_rad[ring])
        column = np.floor(turn / (2 * np.pi) * model.columns).astype(np.int64) % model.columns
    else:
        column, near = _nearest_column(
            azimuth - model.azimuth_offset_rad[ring], model.column_azimuth_rad, model.direction
        )
        fits &= near
    return np.where(fits, ring, -1).astype(np.int32), np.where(fits, column, -1).astype(np.int32)


def _nearest_column(
    azimuth: FloatArray, columns_rad: FloatArray, direction: int
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the column (N,) of the nearest azimuth, and whether (N,) it is no further off than columns are apart
    there."""
    along = direction * np.unwrap(columns_rad)
    steps = np.diff(along) if len(along) > 1 else np.array([2 * np.pi])
    before = (
        min(steps[0], 2 * np.pi - (along[-1] - along[0])) / 2
    )  # what lies a little before the first column is the first's
    turn = (direction * azimuth - along[0] + before) % (2 * np.pi) - before
    column = np.searchsorted((along[1:] + along[:-1]) / 2 - along[0], turn)
    reach = np.maximum(np.append(steps, 0.0), np.append(0.0, steps))[column]
    return column, np.abs(turn - (along[column] - along[0])) <= reach


def rank_returns(ray: NDArray[np.int64], intensity: NDArray[np.float32], distance_m: FloatArray) -> NDArray[np.int32]:
    """Return the rank (N,) of each return among those of its ``ray`` (N,), any numbers: 0 is the strongest, of equal
    ones the nearer."""
    order = np.lexsort((distance_m, -np.asarray(intensity, np.float64), ray))
    ordered = ray[order]
    begins = np.flatnonzero(np.append(True, ordered[1:] != ordered[:-1])[: len(ordered)])
    rank = np.empty(len(ray), np.int32)
    rank[order] = np.arange(len(ray)) - np.repeat(begins, np.diff(np.append(begins, len(ray))))
    return rank


def make_grid(sweep: Sweep, lidar: Lidar, frame: int, blocked: NDArray[np.bool_]) -> SweepGrid:
    """Return the sweep as beams x columns, with returns' own exact rays, and in other cells the log's rays or the beam
    table's. ``blocked`` (beams, columns): cells that the vehicle blocks.

    Of two returns in a cell the stronger is taken where the sweep ranks them, else the nearer.
    """
    model = lidar.model_at(lidar.time_s[frame])
    rays = lidar_rays(lidar, lidar.time_s[frame])
    directions, origins, time_s = rays.directions, rays.origins, rays.time_s
    depth, intensity = np.zeros(time_s.shape, np.float32), np.zeros(time_s.shape, np.float32)
    returned = np.zeros(time_s.shape, np.bool_)
    offset = sweep.points - sweep.origins
    distance = np.linalg.norm(offset, axis=1)
    first = np.ones(len(distance), np.bool_) if sweep.rank is None else sweep.rank == 0
    known = (sweep.ring >= 0) & (distance > 0)
    index = np.flatnonzero(known & first)
    index = index[np.argsort(-distance[index], kind="stable")]  # of two in a cell the last written stays: the nearer
    cell = (sweep.ring[index], sweep.column[index])
    recorded_time = np.full(time_s.shape, np.nan)
    recorded_time[cell] = sweep.time_s[index]
    turns = _turns(recorded_time - time_s, model.sweep_s)
    ring, column = np.nonzero(turns)
    time_s[ring, column] += turns[ring, column] * model.sweep_s
    poses = lidar.world_from_lidar.at(time_s[ring, column])
    origins[ring, column] = poses[:, :3, 3]
    directions[ring, column] = np.einsum("nij,nj->ni", poses[:, :3, :3], beam_directions(model)[ring, column])
    if sweep.drops is not None:
        drops, there = sweep.drops, sweep.drops.ring >= 0
        dropped = (drops.ring[there], drops.column[there])
        directions[dropped], origins[dropped] = drops.directions[there], drops.origins[there]
        time_s[dropped] = drops.time_s[there]
        given = np.zeros_like(blocked)
        given[dropped] = True
        blocked = blocked | ~given  # of a cell that is neither nothing is known
    directions[cell] = offset[index] / distance[index, None]
    origins[cell], time_s[cell] = sweep.origins[index], sweep.time_s[index]
    depth[cell], intensity[cell], returned[cell] = distance[index], sweep.intensity[index], True
    others = None if sweep.rank is None else _others(sweep, np.flatnonzero(known & ~first), distance, sweep.rank)
    return SweepGrid(model, origins, directions, time_s, depth, intensity, returned, blocked & ~returned, others)


def _others(sweep: Sweep, index: NDArray[np.int64], distance: FloatArray, rank: NDArray[np.int32]) -> OtherReturns:
    measured = distance[index].astype(np.float32)
    return OtherReturns(sweep.ring[index], sweep.column[index], rank[index], measured, sweep.intensity[index])


def with_drops(log: Log, lidar: str, frame: int) -> Sweep:
    """Return a log's sweep with drops: the log's own, or where it gives none, cells that did not return and are not
    blocked."""
    sweep = log.sweep(lidar, frame)
    if sweep.drops is not None or not log.drive.lidars[lidar].model.beams:
        return sweep
    grid = log.sweep_grid(lidar, frame)
    ring, column = np.nonzero(~grid.returned & ~grid.blocked)
    cell = ring, column
    drops = Drops(
        grid.origins[cell], grid.directions[cell], grid.time_s[cell], ring.astype(np.int32), column.astype(np.int32)
    )
    return replace(sweep, drops=drops)


def known_rays(log: Log, lidar: str, frame: int) -> SweepRays:
    """Return the rays of a sweep of which something is known, drops included."""
    if not log.drive.lidars[lidar].model.beams:
        return sweep_rays(log.sweep(lidar, frame))
    grid = log.sweep_grid(lidar, frame)
    keep = ~grid.blocked
    return SweepRays(
        grid.origins[keep], grid.directions[keep], grid.time_s[keep],
        grid.depth_m[keep], grid.intensity[keep], grid.returned[keep],
    )  # fmt: skip


def sweep_rays(sweep: Sweep) -> SweepRays:
    """Return the rays of a sweep whose LiDAR has no beam table: strongest returns and the drops that the log gives."""
    offset = sweep.points - sweep.origins
    distance = np.linalg.norm(offset, axis=1)
    index = np.flatnonzero((distance > 0) & (True if sweep.rank is None else sweep.rank == 0))
    empty = np.zeros((0, 3))
    origins, directions, times = (
        (empty, empty, empty[:, 0])
        if sweep.drops is None
        else (sweep.drops.origins, sweep.drops.directions, sweep.drops.time_s)
    )
    nothing = np.zeros(len(times), np.float32)
    return SweepRays(
        origins=np.concatenate([sweep.origins[index], origins]),
        directions=np.concatenate([offset[index] / distance[index, None], directions]),
        time_s=np.concatenate([sweep.time_s[index], times]),
        depth_m=np.concatenate([distance[index].astype(np.float32), nothing]),
        intensity=np.concatenate([sweep.intensity[index], nothing]),
        returned=np.concatenate([np.ones(len(index), np.bool_), np.zeros(len(times), np.bool_)]),
    )


def _turns(late_s: FloatArray, sweep_s: float) -> NDArray[np.int64]:
    """Return how many turns of the sensor to add to the beam table's times so that they fit the recording: whole
    numbers (beams, columns), mostly 0.

    ``late_s`` (beams, columns) is by how many seconds each return was recorded later than the table says, NaN for
    cells without a return; these get the number of the returns beside them.

    Turns differ because a sweep ends where a beam passes a certain azimuth. The beams of one column look in slightly
    different directions, so near the end some have passed that azimuth, and begin the next sweep, while others have
    not.
    """
    turns = np.zeros(late_s.shape, np.int64)
    if sweep_s == 0:
        return turns
    columns = np.arange(late_s.shape[1])
    for beam, late in enumerate(late_s):
        known = np.flatnonzero(np.isfinite(late))
        if len(known):
            turns[beam] = np.rint(np.interp(columns, known, np.rint(late[known] / sweep_s)))
    return turns


def never_returned(sweeps: list[Sweep], model: LidarModel) -> NDArray[np.bool_]:
    """Return the cells (beams, columns) bool that look down and return in none of the sweeps: the vehicle blocks
    them."""
    seen = np.zeros((model.beams, model.columns), np.bool_)
    for sweep in sweeps:
        known = sweep.ring >= 0
        seen[sweep.ring[known], sweep.column[known]] = True
    return np.asarray(~seen & (model.elevation_rad < BLOCKED_BELOW_RAD)[:, None])
