"""Sweeps as KITTI cuts them: each turn from where the LiDAR looks backward to where it does so again.

A drive's own sweeps may begin anywhere, so a turn has returns of two or three of them. The layout gives a point the time at
which the sensor looked where the point lies; points are written as they were in the sensor's frame at that time, so that they
come back to where they were in the world, also where a beam looks beside its column.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....data.log import Sweep
from ....geometry import FloatArray
from ....sensors.lidar import column_times
from ....world.drive import Lidar
from ...common.rigs import looking_time, nearest_rings
from ..spin import Turn, point_times

LEAST_COVERED = 0.5
"""A turn of which sweeps cover less is left out: at the drive's ends, and where sweeps are missing."""
ROUNDS = 3
"""Where the sensor is depends on the time, by so little that a round or two would do."""
SEAM = 0.1
"""Beams look beside their columns by less than this share of a turn."""


@dataclass(frozen=True)
class Cut:
    """A turn: when the LiDAR looked backward, forward and backward again, seconds, and the frames whose sweeps it lies in."""

    turn: Turn
    frames: tuple[int, ...]


def cut_turns(lidar: Lidar, frames: Sequence[int]) -> list[Cut]:
    """Return the turns that the sweeps of some frames, in order, cover."""
    spans = {frame: _span(lidar, frame) for frame in frames}
    backward = {frame: looking_time(lidar, frame, np.pi) for frame in frames}
    forward = sorted(looking_time(lidar, frame, 0.0) for frame in frames)
    sweep_s = lidar.model.sweep_s
    ends: list[tuple[float, float]] = []
    for at, frame in enumerate(frames):
        if not at or backward[frame] - backward[frames[at - 1]] > 1.5 * sweep_s:
            ends.append((backward[frame] - sweep_s, backward[frame]))
        following = frames[at + 1] if at + 1 < len(frames) else None
        after = backward[frame] + sweep_s
        if following is not None and backward[following] - backward[frame] <= 1.5 * sweep_s:
            after = backward[following]
        ends.append((backward[frame], after))
    cuts = []
    for start, end in ends:
        inside = [time for time in forward if start < time < end]
        middle = inside[0] if inside else (start + end) / 2
        shares = {frame: min(end, span[1]) - max(start, span[0]) for frame, span in spans.items()}
        if sum(share for share in shares.values() if share > 0) >= LEAST_COVERED * (end - start):
            # beams that look beside their columns pass the seam in the sweeps before and after
            near = tuple(frame for frame, share in shares.items() if share > -SEAM * sweep_s)
            cuts.append(Cut((start, middle, end), near))
    return cuts


def points_of(cut: Cut, cuts: Sequence[Cut], lidar: Lidar, read: Callable[[int], Sweep]) -> NDArray[np.float32]:
    """Return a turn's file, float32 (N, 4): x, y, z in the sensor's frame at each point's own time, intensity 0..1; ring by ring,
    the upper first, counter-clockwise from ahead. ``read`` gives a frame's sweep; of several returns the strongest is taken."""
    turns = [one.turn for one in cuts if abs(one.turn[1] - cut.turn[1]) < 3 * lidar.model.sweep_s]
    margin = SEAM * lidar.model.sweep_s
    parts, rings = [], []
    for frame in cut.frames:
        sweep = read(frame)
        kept = (sweep.time_s > cut.turn[0] - margin) & (sweep.time_s < cut.turn[2] + margin)
        if sweep.rank is not None:
            kept &= sweep.rank == 0
        local, turn = _placed(sweep.points[kept], sweep.time_s[kept], lidar, turns)
        mine = turn == turns.index(cut.turn)
        parts.append(np.column_stack([local[mine], sweep.intensity[kept][mine]]))
        rings.append(nearest_rings(sweep.ring[kept][mine], local[mine], lidar))
    if not parts:
        return np.zeros((0, 4), np.float32)
    points, ring = np.concatenate(parts), np.concatenate(rings)
    azimuth = np.arctan2(points[:, 1], points[:, 0]) % (2 * np.pi)
    return np.asarray(points[np.lexsort((azimuth, ring))], "<f4")


def time_in_turn(centre: FloatArray, turn: Turn, direction: int) -> float:
    """Return when a turn's beams pass a point (3,) of the sensor's frame."""
    return float(point_times(centre[None], turn, direction)[0])


def _placed(
    points: FloatArray, times: FloatArray, lidar: Lidar, turns: Sequence[Turn]
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Points (N, 3) in the sensor's frame at the times that the layout gives them, each in the turn in which that is nearest to
    when it was measured: (N,), -1 where none is within half a turn."""
    told, turn, rows = times, np.zeros(len(points), np.int64), np.arange(len(points))
    for last in range(ROUNDS, -1, -1):
        poses = lidar.world_from_lidar.at(told)
        local = np.einsum("nji,nj->ni", poses[:, :3, :3], points - poses[:, :3, 3])
        if last:
            ways = np.stack([point_times(local, one, lidar.model.direction) for one in turns], 1)
            turn = np.abs(ways - times[:, None]).argmin(1)
            told = ways[rows, turn]
    near = np.abs(told - times) < lidar.model.sweep_s / 2
    return local, np.where(near, turn, -1)


def _span(lidar: Lidar, frame: int) -> tuple[float, float]:
    times = column_times(lidar, lidar.time_s[frame])
    half = (times[-1] - times[0]) / max(len(times) - 1, 1) / 2
    return float(times[0] - half), float(times[-1] + half)
