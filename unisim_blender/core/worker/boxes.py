"""The worker's jobs about boxes: one that is followed through the sweeps, and the returns about it."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import UnisimError
from ..formats.readers import drive_in, open_log
from ..geometry import FloatArray, Trajectory, invert_pose
from ..tracks.box_file import Track, track_from_json, track_to_json
from ..tracks.follow import DrawnBox, SweepStore, follow
from .protocol import WorkerMessage

POLL_S = 0.1
AROUND_M = 1.5
"""Distance around a box up to which its returns are shown."""
MOST_SHOWN = 4000
STAGES = {"ground": 0.3, "clusters": 0.4, "registration": 0.25, "standing": 0.05}
"""Shares of the time that the stages of finding actors take."""


class _Cancelled(Exception):
    """Ends a thread whose request nobody waits for."""


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
        shares, results, faults = [0.0], list[Track](), list[BaseException]()
        cancelled = threading.Event()

        def progress(share: float) -> None:
            shares.append(share)
            if cancelled.is_set():
                raise _Cancelled

        def run() -> None:
            try:
                if request.get("fresh") is not None:
                    drawn[request["fresh"]] = store.at_sweep(drawn[request["fresh"]])
                results.append(follow(store, track, drawn, bool(request.get("refine")), progress))
            except BaseException as fault:
                faults.append(fault)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        try:
            while thread.is_alive():
                thread.join(POLL_S)
                yield {"event": "progress", "text": "Following the box", "share": shares[-1]}
        finally:
            cancelled.set()
        if faults:
            raise faults[0]
        yield {"event": "followed", "track": track_to_json(results[0])}

    def box_points(self, request: WorkerMessage) -> Iterator[WorkerMessage]:
        """Give the returns about a box in its frame at each return's own time: of a ``log`` at ``time_s``, with ``size_m``
        and the trajectory ``times_s``, ``poses``. Yields the array ``points`` (N, 3)."""
        store, time_s = self._sweeps(request), float(request["time_s"])
        poses = np.array(request["poses"], float).reshape(-1, 4, 4)
        path = Trajectory.from_poses(np.array(request["times_s"], float), poses)
        reach = np.array(request["size_m"], float) / 2 + AROUND_M
        parts: list[NDArray[np.float32]] = []
        for lidar in {ref.lidar for ref in store.refs}:
            numbers = [n for n, ref in enumerate(store.refs) if ref.lidar == lidar]
            nearest = min(numbers, key=lambda n: abs(store.times_s[n] - time_s))
            if abs(store.times_s[nearest] - time_s) > 0.3:
                continue
            far = float(np.linalg.norm(reach)) + 3.0
            scan = store.near(nearest, path.positions_at(time_s)[:2], far)
            local = _in_frame(scan.points, scan.time_s, path)
            parts.append(local[(np.abs(local) < reach).all(1)].astype(np.float32))
        points = np.concatenate(parts) if parts else np.zeros((0, 3), np.float32)
        yield self.leave({"points": points[:: max(1, -(-len(points) // MOST_SHOWN))]})

    def _sweeps(self, request: WorkerMessage) -> SweepStore:
        if not isinstance(log := request.get("log"), str):
            raise UnisimError("the request has no log: the worker is of another version than the extension")
        path = drive_in(Path(log))
        if self.store is None or self.store[0] != path:
            self.store = path, SweepStore(open_log(path))
        return self.store[1]


def _in_frame(points: FloatArray, times: FloatArray, path: Trajectory) -> FloatArray:
    """Return returns (N, 3) in the frame of a box on its path at their times (N,)."""
    at, column = np.unique(times, return_inverse=True)
    places = invert_pose(path.at(at))[column]
    return np.asarray(np.einsum("nij,nj->ni", places[:, :3, :3], points) + places[:, :3, 3])


def tell_tracks(path: Path, out: Path) -> None:
    """Find the actors of a log, write them to a file of boxes, and print the share that is done as lines of JSON. A
    `UnisimError` is printed as the command line prints it, and ends the process."""
    from ..tracks.box_file import write_boxes
    from ..tracks.find import find_tracks, in_own_world

    stages = list[str]()

    def progress(stage: str, done: float) -> None:
        if stage not in stages:
            stages.append(stage)
        shares = [STAGES.get(name, 0.0) for name in stages]
        print(json.dumps({"share": min(1.0, sum(shares[:-1]) + done * shares[-1]), "stage": stage}), flush=True)

    try:
        log = open_log(drive_in(path))
        write_boxes(out, log, in_own_world(find_tracks(log, progress), log.drive, log.drive), "unisim track")
    except UnisimError as fault:
        sys.exit(f"Error: {fault}")
