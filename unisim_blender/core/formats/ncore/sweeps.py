"""NCore's ray bundles and sweeps: rays in the sensor's frame at their own times, and each ray's returns.

A ray's returns are NaN where it has none; one without any is a drop.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...data.log import Drops, Sweep
from ...data.sweep_cells import find_cells, rank_returns
from ...data.values import Intensities
from ...errors import LogError, OutputError, in_a_line
from ...geometry import FloatArray
from ...json_file import Node
from ...sensors.beam_tables import ROTATION_SIGNS, beam_table
from ...sensors.frames import LidarFrame
from ...sensors.lidar import column_azimuths
from ...world.drive import Lidar, LidarModel
from .extras import CLASSES, NANOSECONDS, NO_CELL


def parameters_of(model: LidarModel, where: str) -> Any:
    """Return NCore's parameters of a beam table. Raises `OutputError` for a table that NCore cannot hold."""
    from ncore import data

    words: dict[int, Any] = {direction: word for word, direction in ROTATION_SIGNS.items()}
    azimuth = (column_azimuths(model) + np.pi) % (2 * np.pi) - np.pi
    try:
        return data.RowOffsetStructuredSpinningLidarModelParameters(
            spinning_frequency_hz=1 / model.sweep_s,
            spinning_direction=words[model.direction],
            n_rows=model.beams,
            n_columns=model.columns,
            row_elevations_rad=model.elevation_rad.astype(np.float32),
            column_azimuths_rad=azimuth.astype(np.float32),
            row_azimuth_offsets_rad=model.azimuth_offset_rad.astype(np.float32),
        )
    except (AssertionError, ZeroDivisionError) as fault:
        raise OutputError(f"{where}: NCore cannot hold its beam table: {in_a_line(fault)}") from fault


def model_of(parameters: Any, where: str) -> LidarModel:
    """Return the beam table of NCore's parameters. Raises `LogError`."""
    kind = parameters.type()
    if kind != "row-offset-spinning":
        raise LogError(f"{where}: has a beam table of the type {kind!r:.60}, which is not read")
    values = {
        name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(parameters).items()
    }
    return beam_table(Node(values, f"{where}: ", LogError))


FIRED = 0.9
"""Where fewer of a table's columns have rays, and no ray is a drop, the table has more columns than the sensor fires: what has no
ray is then not known to be a drop."""
MOST_RETURNS = 64
UNIT = 1e-3
AGE_S = 1.0
"""A ray whose time is further from its sweep's is an error."""
SAME_RAY = np.cos(1e-4)
"""Returns of one time and direction are of one ray: the cosine of how far apart they may be."""


@dataclass(frozen=True)
class Bundle:
    """A sweep as NCore has it: direction (N, 3), timestamp_us (N,), model_element (N, 2) or None, distance_m, intensity (R, N).
    ``more``: arrays beside them; ``drops_given``: every ray that did not return is there, as far as it is known."""

    direction: NDArray[np.float32]
    timestamp_us: NDArray[np.uint64]
    model_element: NDArray[np.uint16] | None
    distance_m: NDArray[np.float32]
    intensity: NDArray[np.float32]
    more: Mapping[str, NDArray[Any]]
    drops_given: bool = False


def read_sweep(bundle: Bundle, lidar: Lidar, frame: int, epoch_us: int, place: str, intensities: Intensities) -> Sweep:
    """Return the sweep of a bundle. Raises `LogError` naming ``place``."""
    count = len(bundle.direction)
    _check(bundle, count, place)
    time_s = (bundle.timestamp_us.astype(np.int64) - epoch_us) / 1e6
    if NANOSECONDS in bundle.more:
        time_s = time_s + _beside(bundle, NANOSECONDS, (count,), place) / 1e9
    age = np.abs(time_s - lidar.time_s[frame])
    if len(age) and age.max() > AGE_S:
        raise LogError(f"{place}: a ray is {float(age.max()):.3f} s from its sweep's time")
    local = bundle.direction.astype(np.float64)
    length = np.linalg.norm(local, axis=1)
    if not (np.abs(length - 1) < UNIT).all():
        raise LogError(f"{place}: a ray's direction has not the length 1")
    local /= length[:, None]
    moments, which = np.unique(time_s, return_inverse=True)
    poses = lidar.world_from_lidar.at(moments)
    directions, origins = np.einsum("nij,nj->ni", poses[which, :3, :3], local), poses[which, :3, 3]
    ring, column = _cells(bundle, lidar.model_at(lidar.time_s[frame]), local, place)
    number, ray = np.nonzero(np.isfinite(bundle.distance_m))
    distance, bright = (values[number, ray].astype(np.float64) for values in (bundle.distance_m, bundle.intensity))
    if not (np.isfinite(bright).all() and (distance >= 0).all()):
        raise LogError(f"{place}: a return has a negative distance or no intensity")
    intensity = intensities.scaled(bright, place)
    semantic = np.full(len(ray), -1, np.int32)
    if CLASSES in bundle.more:
        semantic = _beside(bundle, CLASSES, bundle.distance_m.shape, place)[number, ray].astype(np.int32)
    lost = np.ones(count, bool)
    lost[ray] = False
    return Sweep(
        points=origins[ray] + directions[ray] * distance[:, None],
        origins=origins[ray],
        time_s=time_s[ray],
        intensity=intensity,
        ring=ring[ray],
        column=column[ray],
        semantic=semantic,
        rank=rank_returns(ray, intensity, distance) if number.any() else None,
        drops=Drops(origins[lost], directions[lost], time_s[lost], ring[lost], column[lost])
        if bundle.drops_given or lost.any() or _has_spare_columns(column, lidar.model)
        else None,
    )


def bundle_of(sweep: Sweep, lidar: Lidar, frame: int, epoch_us: int) -> Bundle:
    """Return a sweep as NCore has it, its rays in the order of time; returns without a distance are left out."""
    offset = sweep.points - sweep.origins
    distance = np.linalg.norm(offset, axis=1)
    returned = np.flatnonzero(distance > 0)
    offset, distance = offset[returned], distance[returned]
    directions = offset / distance[:, None]
    rank = np.zeros(len(returned), np.int32) if sweep.rank is None else sweep.rank[returned]
    first = np.flatnonzero(rank == 0)
    ray = _rays(rank, sweep.time_s[returned], directions)
    drops = sweep.drops if sweep.drops is not None else _NO_DROPS
    time_s = np.concatenate([sweep.time_s[returned][first], drops.time_s])
    world = np.concatenate([directions[first], drops.directions])
    ring, column = (
        np.concatenate([getattr(sweep, name)[returned][first], getattr(drops, name)]) for name in ("ring", "column")
    )
    order = np.lexsort((ring, time_s))
    ray = np.argsort(order)[ray]
    time_s, world, ring, column = time_s[order], world[order], ring[order], column[order]
    moments, which = np.unique(time_s, return_inverse=True)
    axes = lidar.world_from_lidar.at(moments)[:, :3, :3]
    local = np.einsum("nji,nj->ni", axes[which], world)
    whole = np.rint(time_s * 1e6)
    returns = int(rank.max(initial=0)) + 1
    shape = returns, len(time_s)
    depth, bright = np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32)
    depth[rank, ray] = distance
    bright[rank, ray] = np.clip(np.nan_to_num(sweep.intensity[returned]), 0, 1)
    more: dict[str, NDArray[Any]] = {NANOSECONDS: np.rint((time_s * 1e6 - whole) * 1e3).astype(np.int16)}
    if (sweep.semantic >= 0).any():
        more[CLASSES] = np.full(shape, -1, np.int32)
        more[CLASSES][rank, ray] = sweep.semantic[returned]
    element = None
    model = lidar.model_at(lidar.time_s[frame])
    if model.beams:
        outside = np.flatnonzero(ring < 0)
        if len(outside):
            ring[outside], column[outside] = _nearest(local[outside], model)
            more[NO_CELL] = outside.astype(np.int32)
        element = np.stack([ring, column], -1).astype(np.uint16)
    times_us = (whole.astype(np.int64) + epoch_us).astype(np.uint64)
    return Bundle(local.astype(np.float32), times_us, element, depth, bright, more, sweep.drops is not None)


def sweep_of_frame(frame: LidarFrame) -> Sweep:
    """Return a rendered sweep with its drops; the semantic class is unknown."""
    parts = []
    for there in (frame.returned, ~frame.returned):
        column, ring = np.nonzero(there.T)
        parts.append((ring, column))
    (ring, column), lost = parts
    origins, directions = frame.origins[ring, column], frame.directions[ring, column]
    drops = Drops(
        frame.origins[lost],
        frame.directions[lost],
        frame.time_s[lost],
        lost[0].astype(np.int32),
        lost[1].astype(np.int32),
    )
    return Sweep(
        points=origins + directions * frame.depth_m[ring, column].astype(np.float64)[:, None],
        origins=origins,
        time_s=frame.time_s[ring, column],
        intensity=frame.intensity[ring, column],
        ring=ring.astype(np.int32),
        column=column.astype(np.int32),
        semantic=np.full(len(ring), -1, np.int32),
        drops=drops,
    )


_EMPTY, _NONE = np.zeros((0, 3)), np.zeros(0, np.int32)
_NO_DROPS = Drops(_EMPTY, _EMPTY, np.zeros(0), _NONE, _NONE)


def _check(bundle: Bundle, count: int, place: str) -> None:
    shapes = {
        "direction": (bundle.direction.shape, (count, 3)),
        "timestamp_us": (bundle.timestamp_us.shape, (count,)),
        "intensity": (bundle.intensity.shape, bundle.distance_m.shape),
    }
    if bundle.model_element is not None:
        shapes["model_element"] = (bundle.model_element.shape, (count, 2))
    for name, (shape, wanted) in shapes.items():
        if shape != wanted:
            raise LogError(f"{place}: {name} is {shape}, not {wanted}")
    if bundle.distance_m.ndim != 2 or bundle.distance_m.shape[1] != count or len(bundle.distance_m) > MOST_RETURNS:
        raise LogError(f"{place}: distance_m is {bundle.distance_m.shape}, not returns x {count}")


def _beside(bundle: Bundle, name: str, shape: tuple[int, ...], place: str) -> NDArray[Any]:
    values = bundle.more[name]
    if values.shape != shape:
        raise LogError(f"{place}: {name} is {values.shape}, not {shape}")
    return values


def _cells(
    bundle: Bundle, model: LidarModel, local: FloatArray, place: str
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Beam and column (N,) of rays, -1 where they have none."""
    if not model.beams:
        none = np.full(len(local), -1, np.int32)
        return none, none.copy()
    if bundle.model_element is None:
        return find_cells(local, model)
    ring, column = bundle.model_element.astype(np.int32).T
    if len(ring) and (ring.max() >= model.beams or column.max() >= model.columns):
        raise LogError(f"{place}: a ray is of row {ring.max()} or column {column.max()}, which the table lacks")
    ring, column = ring.copy(), column.copy()
    if NO_CELL in bundle.more:
        outside = bundle.more[NO_CELL]
        if outside.ndim != 1 or (outside < 0).any() or (outside >= len(ring)).any():
            raise LogError(f"{place}: {NO_CELL} names a ray that is not there")
        ring[outside] = column[outside] = -1
    return ring, column


def _has_spare_columns(column: NDArray[np.int32], model: LidarModel) -> bool:
    """Whether the rays leave so many columns out that what has no ray is not known to be a drop."""
    return bool(model.beams and len(column) and len(np.unique(column[column >= 0])) < FIRED * model.columns)


def _rays(rank: NDArray[np.int32], time_s: FloatArray, directions: FloatArray) -> NDArray[np.int64]:
    """The ray (N,) of each return, numbered as the returns of rank 0 are. Others' ray is that of the same time whose direction is
    nearest."""
    first = np.flatnonzero(rank == 0)
    ray = np.zeros(len(rank), np.int64)
    ray[first] = np.arange(len(first))
    others = np.flatnonzero(rank > 0)
    if not len(others):
        return ray
    order = np.argsort(time_s[first], kind="stable")
    stamps = time_s[first][order]
    low, high = (np.searchsorted(stamps, time_s[others], side=side) for side in ("left", "right"))
    counts = high - low
    if not counts.all():
        raise ValueError("a return of rank 1 or more has no return of rank 0 at its time")
    begins = np.cumsum(counts) - counts
    candidate = order[np.arange(counts.sum()) - np.repeat(begins - low, counts)]
    cosine = (directions[first[candidate]] * np.repeat(directions[others], counts, axis=0)).sum(1)
    best = np.maximum.reduceat(cosine, begins)
    if best.min() < SAME_RAY:
        raise ValueError("a return of rank 1 or more lies on no ray of a return of rank 0")
    hit = np.flatnonzero(cosine == np.repeat(best, counts))
    group = np.repeat(np.arange(len(others)), counts)[hit]
    ray[others[group]] = candidate[hit]
    return ray


def _nearest(local: FloatArray, model: LidarModel) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The nearest beam and column (N,) of directions outside of the table."""
    elevation = np.arctan2(local[:, 2], np.hypot(local[:, 0], local[:, 1]))
    ring = np.abs(model.elevation_rad[None] - elevation[:, None]).argmin(1)
    level = model.elevation_rad[ring]
    azimuth = np.arctan2(local[:, 1], local[:, 0])
    flat = np.stack([np.cos(level) * np.cos(azimuth), np.cos(level) * np.sin(azimuth), np.sin(level)], -1)
    ring, column = find_cells(flat, replace(model))
    return ring.astype(np.int32), np.where(ring >= 0, column, 0).astype(np.int32)
