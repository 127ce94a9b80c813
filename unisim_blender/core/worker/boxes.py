"""The worker's jobs about boxes: one that is followed through the sweeps, and the returns about it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from ..errors import UnisimError
from ..formats.readers import drive_in, open_log
from ..geometry import Trajectory, invert_pose, transform_points
from ..tracks.box_file import track_from_json, track_to_json
from ..tracks.follow import DrawnBox, follow
from ..tracks.scans import SweepStore
from .protocol import WorkerMessage

AROUND_M = 1.5
"""Distance around a box up to which its returns are shown."""
MOST_SHOWN = 4000


class BoxJobs:
    """The jobs; sweeps stay in memory between requests. ``leave`` writes arrays and returns their event."""

    def __init__(self, leave: Callable[..., WorkerMessage]) -> None:
        self.leave = leave
        self.store: tuple[Path, SweepStore] | None = None

    def follow(self, request: WorkerMessage) -> Iterator[WorkerMessage]:
        """Follow a box (`tracks.follow`): of a ``log``, the ``track`` so far, ``drawn`` boxes as [time_s, pose], of which
        that numbered ``fresh`` was drawn around a sweep, and ``refine``. Yields progress, then the track."""
        store, track = self._sweeps(request), track_from_json(request["track"], "the request's track")
        drawn = [DrawnBox(float(time), np.array(pose, float).reshape(4, 4)) for time, pose in request["drawn"]]
        if request.get("fresh") is not None:
            drawn[request["fresh"]] = drawn[request["fresh"]].at_sweep(store)
        steps = follow(store, track, drawn, bool(request.get("refine")))
        try:
            while True:
                yield {"event": "progress", "text": "Following the box", "share": next(steps)}
        except StopIteration as end:
            yield {"event": "followed", "track": track_to_json(end.value)}

    def box_points(self, request: WorkerMessage) -> Iterator[WorkerMessage]:
        """Give the returns about a box in its frame at each return's own time: of a ``log`` at ``time_s``, with ``size_m``
        and the trajectory ``times_s``, ``poses``. Yields the array ``points`` (N, 3)."""
        store, time_s = self._sweeps(request), float(request["time_s"])
        poses = np.array(request["poses"], float).reshape(-1, 4, 4)
        path = Trajectory.from_poses(np.array(request["times_s"], float), poses)
        reach = np.array(request["size_m"], float) / 2 + AROUND_M
        parts = [np.zeros((0, 3), np.float32)]
        for number in store.nearest(time_s):
            if abs(store.times_s[number] - time_s) < 0.3:
                far = float(np.linalg.norm(reach)) + 3.0
                scan = store.near(number, path.positions_at(time_s)[:2], far)
                local = transform_points(invert_pose(path.at(scan.time_s)), scan.points[:, None])[:, 0]
                parts.append(local[(np.abs(local) < reach).all(1)].astype(np.float32))
        points = np.concatenate(parts)
        yield self.leave({"points": points[:: max(1, -(-len(points) // MOST_SHOWN))]})

    def _sweeps(self, request: WorkerMessage) -> SweepStore:
        if not isinstance(log := request.get("log"), str):
            raise UnisimError("the request has no log: the worker is of another version than the extension")
        path = drive_in(Path(log))
        if self.store is None or self.store[0] != path:
            self.store = path, SweepStore(open_log(path))
        return self.store[1]
