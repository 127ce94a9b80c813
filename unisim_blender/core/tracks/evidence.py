"""What a log's sweeps show, in two passes over them: the ground, clusters of what moves, and a map of what stays.

The result is cached among the user's files: another search of the same log begins with it.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from ..data.log import Log, cached_file
from ..errors import LogError
from ..files import write_cached
from ..geometry import FloatArray
from .clusters import Cluster, moving_clusters
from .free_space import range_image, windows
from .ground import GroundBuilder, GroundHeights
from .scans import read_scan, scans_of
from .standing import StandingMap

VERSION = 5
"""Counted on whenever a stage here changes: what an older program cached is made anew."""
SearchProgress = Callable[[str, float], object]
"""Called with the name of a stage and the fraction of the whole that is done; what it raises cancels the search."""
SHARES = {"ground": (0.0, 0.3), "clusters": (0.3, 0.7), "registration": (0.7, 0.95), "standing": (0.95, 1.0)}
"""Fractions of the whole at which stages begin and end, by the time that they take."""


@dataclass(frozen=True)
class Evidence:
    """The ground, the clusters of each sweep of what moves, what stays, and the sweeps' times (S,), seconds."""

    ground: GroundHeights
    clusters: tuple[tuple[Cluster, ...], ...]
    stays: StandingMap
    times_s: FloatArray


def evidence_of(log: Log, progress: SearchProgress = lambda stage, done: None) -> Evidence:
    """Return what a log's sweeps show, from the cache where they were searched before.

    Raises `LogError` where no LiDAR has two sweeps, scipy is not installed, or a sweep cannot be read.
    """
    refs = scans_of(log)
    if len(refs) < 2:
        raise LogError(
            f"{log.path}: has no two sweeps of a LiDAR, in which actors are searched: take boxes from a file"
        )
    cached = cached_file(log, "tracks", f"evidence-{VERSION}.npz")
    try:
        return _read(cached)
    except (OSError, BadZipFile, ValueError, KeyError):
        pass  # there is none, or a broken one
    builder, images = GroundBuilder(log.drive.world_from_ego), {}
    for number, ref in enumerate(refs):
        scan = read_scan(log, ref)
        builder.add(scan.points)
        images[number] = range_image(scan)
        tell("ground", (number + 1) / len(refs), progress)
    ground, stays, sweeps = builder.ground(), StandingMap(), []
    for number, ref in enumerate(refs):
        scan = read_scan(log, ref)
        clusters, standing = moving_clusters(scan, ground, images, windows(refs, number))
        sweeps.append(tuple(clusters))
        if len(standing):
            stays.add(standing, np.median(scan.origins, 0), ref.time_s)
        tell("clusters", (number + 1) / len(refs), progress)
    evidence = Evidence(ground, tuple(sweeps), stays, np.array([ref.time_s for ref in refs]))
    _write(cached, evidence)
    return evidence


def tell(stage: str, done: float, progress: SearchProgress) -> None:
    """Tell ``progress`` that the fraction ``done`` of a stage is."""
    begin, end = SHARES[stage]
    progress(stage, begin + done * (end - begin))


def _write(path: Path, evidence: Evidence) -> None:
    clusters = [(number, cluster) for number, sweep in enumerate(evidence.clusters) for cluster in sweep]
    about = [(number, cluster.is_weak, *cluster.origin, len(cluster.points)) for number, cluster in clusters]
    returns = [np.column_stack([cluster.points, cluster.time_s]) for _, cluster in clusters]
    keys, values = evidence.stays.content()
    file = io.BytesIO()
    np.savez_compressed(
        file,
        corner=evidence.ground.corner,
        heights=evidence.ground.heights,
        times_s=evidence.times_s,
        clusters=np.array(about, float).reshape(-1, 6),
        returns=np.concatenate([np.zeros((0, 4)), *returns]),
        keys=keys,
        values=values,
    )
    write_cached(path, file.getvalue())


def _read(path: Path) -> Evidence:
    with np.load(path) as file:
        content = dict(file)
    sweeps: list[list[Cluster]] = [[] for _ in content["times_s"]]
    about = content["clusters"]
    parts = np.split(content["returns"], np.cumsum(about[:, 5]).astype(np.int64))
    for (number, is_weak), origin, part in zip(about[:, :2], about[:, 2:5], parts, strict=False):
        sweeps[int(number)].append(Cluster(part[:, :3], part[:, 3], origin, bool(is_weak)))
    stays = StandingMap(content["keys"], content["values"])
    ground = GroundHeights(content["corner"], content["heights"])
    return Evidence(ground, tuple(map(tuple, sweeps)), stays, content["times_s"])
