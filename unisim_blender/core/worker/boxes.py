"""The worker's jobs about boxes: one that is followed through the sweeps, and the returns about it."""

from __future__ import annotations

import json
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UnisimError
from ..formats.readers import drive_in, open_log
from ..geometry import FloatArray, Trajectory, invert_pose
from ..tracks.follow import DrawnBox, Followed, SweepStore, at_sweep, follow
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
        """Follow a box (`tracks.follow`): of a ``log``, with ``size_m``, ``label``, ``drawn`` boxes as [time_s, pose], of
        which that numbered ``fresh`` was drawn around a sweep, ``before``, an earlier result or None, and ``refine``.

        Yields progress, then arrays: times_s, poses, certainty, returns; with is_moving, size_m and the drawn boxes.
        """
        store, size, label = self._sweeps(request), np.array(request["size_m"], float), str(request["label"])
        shares, results, faults = [0.0], list[Followed](), list[BaseException]()
        cancelled = threading.Event()

        def progress(share: float) -> None:
            shares.append(share)
            if cancelled.is_set():
                raise _Cancelled

        def run() -> None:
            try:
                drawn = [DrawnBox(float(time), np.array(pose, float).reshape(4, 4)) for time, pose in request["drawn"]]
                if request.get("fresh") is not None:
                    drawn[request["fresh"]] = at_sweep(store, size, label, drawn[request["fresh"]])
                before = followed_from_json(request.get("before"))
                results.append(follow(store, size, label, drawn, before, bool(request.get("refine")), progress))
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
        (result,) = results
        yield {"event": "followed", "result": followed_to_json(result)}

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
            scan = store.scan(nearest)
            parts.append(_in_frame(scan.points, scan.time_s, path, reach, time_s).astype(np.float32))
        points = np.concatenate(parts) if parts else np.zeros((0, 3), np.float32)
        yield self.leave({"points": points[:: max(1, -(-len(points) // MOST_SHOWN))]})

    def _sweeps(self, request: WorkerMessage) -> SweepStore:
        if not isinstance(log := request.get("log"), str):
            raise UnisimError("the request has no log: the worker is of another version than the extension")
        path = drive_in(Path(log))
        if self.store is None or self.store[0] != path:
            self.store = path, SweepStore(open_log(path))
        return self.store[1]


def _in_frame(points: FloatArray, times: FloatArray, path: Trajectory, reach: FloatArray, time_s: float) -> FloatArray:
    """Return the returns within ``reach`` (3,) of a box on its path, in its frame."""
    far = float(np.linalg.norm(reach)) + 3.0
    near = np.flatnonzero((np.abs(points - path.positions_at(time_s)) < far).all(1))
    if not len(near):
        return np.zeros((0, 3))
    at, column = np.unique(times[near], return_inverse=True)
    places = invert_pose(path.at(at))[column]
    local = np.einsum("nij,nj->ni", places[:, :3, :3], points[near]) + places[:, :3, 3]
    return np.asarray(local[(np.abs(local) < reach).all(1)])


def followed_to_json(result: Followed) -> dict[str, Any]:
    """Return a result as JSON."""
    return {
        "times_s": result.times_s.tolist(),
        "poses": np.round(result.poses.reshape(-1, 16), 9).tolist(),
        "certainty": np.round(result.certainty, 4).tolist(),
        "returns": result.returns.tolist(),
        "is_moving": result.is_moving,
        "size_m": result.size_m.tolist(),
        "boxes": [[box.time_s, box.pose.ravel().tolist()] for box in result.boxes],
    }


def followed_from_json(values: Any) -> Followed | None:
    """Return a result of its JSON; None of None."""
    if not values:
        return None
    return Followed(
        np.array(values["times_s"], float),
        np.array(values["poses"], float).reshape(-1, 4, 4),
        np.array(values["certainty"], float),
        np.array(values["returns"], np.int64),
        bool(values["is_moving"]),
        np.array(values["size_m"], float),
        tuple(DrawnBox(float(time), np.array(pose, float).reshape(4, 4)) for time, pose in values["boxes"]),
    )


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
