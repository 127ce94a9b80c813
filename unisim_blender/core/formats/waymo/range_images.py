"""Waymo's top LiDAR: a sweep is a range image, rows from the highest beam, columns clockwise from the rear; and a pose image,
which has the vehicle's pose of each return. So every ray's origin is given, and a cell without a return is a drop.

The other four LiDARs' range images are made of points moved to one time. They have no true origins, and are not read.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...data.log import Drops, Sweep
from ...data.sweep_cells import rank_returns
from ...errors import LogError
from ...geometry import FloatArray
from ...sensors.lidar import beam_directions
from ...world.drive import Lidar, LidarModel
from ..common.arrow import Kind, arrow, numbers_of, read_row
from .segment import FARTHEST_M, LASER, Segment

CALIBRATION, RANGES, POSES = "lidar_calibration", "lidar", "lidar_pose"
TOP, NAME = 1, "top"
_IMAGE, _POSE = "[LiDARComponent].range_image_return", "[LiDARPoseComponent].range_image_return1"
MAX_CELLS = 1 << 22
OWN_M = 1.0
"""Returns that lie nearer to the sensor than this along all of its axes are from the vehicle itself."""
MAX_RANGE_M = 75.0
"""How far the top LiDAR is made to see; what is farther is cut off in the dataset."""


@dataclass(frozen=True)
class TopLidar:
    """Mount (4, 4) in the vehicle's frame, and elevations of the beams from the highest, radians."""

    mount: FloatArray
    elevation_rad: FloatArray


def read_calibration(segment: Segment, beams: int) -> TopLidar | None:
    """Return the top LiDAR's calibration, None where there is none. ``beams``: rows of its range images, for even inclinations.

    Raises `LogError`."""
    path, part = segment.file(CALIBRATION), "[LiDARCalibrationComponent]."
    kinds: dict[str, Kind] = {LASER: "whole", part + "extrinsic.transform": "pose"}
    table = segment.read(CALIBRATION, kinds)
    rows = np.flatnonzero(table[LASER] == TOP)
    if not len(rows):
        return None
    values, low, high = (f"{part}beam_inclination.{name}" for name in ("values", "min", "max"))
    cells = read_row(path, int(rows[0]), [values, low, high])
    if getattr(cells[values], "values", None) is None:
        ends = [cells[name].as_py() for name in (low, high)]
        if not all(isinstance(end, float) and np.isfinite(end) for end in ends):
            raise LogError(f"{path}: the top LiDAR's beam_inclination is from {ends[0]} to {ends[1]}")
        rising = ends[0] + (np.arange(beams) + 0.5) / beams * (ends[1] - ends[0])
    else:
        rising = numbers_of(path, values, cells[values])
    if len(rising) != beams:
        raise LogError(f"{path}: has {len(rising)} beam inclinations, but range images have {beams} rows")
    if (np.diff(rising) <= 0).any() or np.abs(rising).max() > np.pi / 2:
        raise LogError(f"{path}: the beam inclinations do not rise, or are no angles")
    return TopLidar(table[part + "extrinsic.transform"][rows[0]], rising[::-1].copy())


def model_of(top: TopLidar, columns: int, turn_s: float) -> LidarModel:
    """Return the beam table: the first column looks to the vehicle's rear, and is fired at the frame's timestamp."""
    yaw = float(np.arctan2(top.mount[1, 0], top.mount[0, 0]))
    return LidarModel(
        elevation_rad=top.elevation_rad,
        azimuth_offset_rad=np.zeros(len(top.elevation_rad)),
        columns=columns,
        sweep_s=turn_s,
        start_azimuth_rad=np.pi - yaw,
        direction=-1,
        time_offset_s=turn_s,
        min_range_m=OWN_M,
        max_range_m=MAX_RANGE_M,
    )


def image_shape(segment: Segment, row: int) -> tuple[int, int]:
    """Return rows and columns of the range image in a row of `RANGES`. Raises `LogError`."""
    path, name = segment.file(RANGES), f"{_IMAGE}1.shape"
    return _shape(path, name, read_row(path, row, [name])[name], 4)


def read_sweep(
    segment: Segment,
    row: int,
    pose_row: int,
    lidar: Lidar,
    mount: FloatArray,
    time_s: float,
    turn_s: float,
    origin: FloatArray,
) -> Sweep:
    """Return the sweep in rows of `RANGES` and `POSES`, at ``time_s``, whose turn takes ``turn_s``; world less ``origin``.

    Intensity is tanh of the file's, which has no bound. Raises `LogError`.
    """
    path, pose_path, model = segment.file(RANGES), segment.file(POSES), lidar.model
    size = model.beams, model.columns
    cells = read_row(path, row, [f"{_IMAGE}1.values", f"{_IMAGE}1.shape", f"{_IMAGE}2.values"])
    images = [_image(path, f"{_IMAGE}1", cells, size, 4)]
    if getattr(cells[f"{_IMAGE}2.values"], "values", None) is not None:
        # where there is none, Arrow cannot read its empty shape
        cells |= read_row(path, row, [f"{_IMAGE}2.shape"])
        images.append(_image(path, f"{_IMAGE}2", cells, size, 4))
    pose_cells = read_row(pose_path, pose_row, [f"{_POSE}.values", f"{_POSE}.shape"])
    poses = _vehicle_poses(pose_path, _image(pose_path, _POSE, pose_cells, size, 6), images[0][..., 0] > 0)
    poses[..., :3, 3] -= origin
    times = time_s + turn_s * (np.arange(model.columns) + 0.5) / model.columns
    sensor = poses @ mount
    directions = np.einsum("bcij,bcj->bci", sensor[..., :3, :3], beam_directions(model))
    ranges = np.stack([image[..., 0] for image in images]).astype(np.float64)
    ranges[1:] *= ranges[0] > 0  # a second return has the first one's pose
    strength = np.tanh(np.maximum(np.stack([image[..., 1] for image in images]), 0)).astype(np.float32)
    own = (np.abs(ranges[..., None] * beam_directions(model)) < OWN_M).all(-1) & (ranges > 0)
    which, ring, column = np.nonzero((ranges > 0) & ~own)
    distance = ranges[which, ring, column]
    origins = sensor[ring, column, :3, 3]
    intensity = strength[which, ring, column]
    dropped = np.nonzero(ranges[0] <= 0)
    # drops have no poses: they have their column's
    at_column, some = lidar.world_from_lidar.at(times), np.flatnonzero((ranges[0] > 0).any(0))
    at_column[some] = sensor[(ranges[0][:, some] > 0).argmax(0), some]
    turned = np.einsum("cij,bcj->bci", at_column[:, :3, :3], beam_directions(model))
    return Sweep(
        points=origins + distance[:, None] * directions[ring, column],
        origins=origins,
        time_s=times[column],
        intensity=intensity,
        ring=ring.astype(np.int32),
        column=column.astype(np.int32),
        semantic=np.full(len(ring), -1, np.int32),
        rank=rank_returns(ring * model.columns + column, intensity, distance) if len(images) > 1 else None,
        drops=Drops(
            at_column[dropped[1], :3, 3],
            turned[dropped],
            times[dropped[1]],
            dropped[0].astype(np.int32),
            dropped[1].astype(np.int32),
        ),
    )


def _vehicle_poses(path: Path, image: NDArray[np.float64], there: NDArray[np.bool_]) -> FloatArray:
    """Poses (H, W, 4, 4) of a pose image: roll, pitch, yaw, turned about z, y and x in this order, and place."""
    if (np.abs(image[there][:, 3:]) > FARTHEST_M).any():
        raise LogError(f"{path}: a return's vehicle is more than {FARTHEST_M:.0e} m from the origin")
    (cr, cp, cy), (sr, sp, sy) = (np.moveaxis(f(image[..., :3]), -1, 0) for f in (np.cos, np.sin))
    poses = np.zeros((*image.shape[:2], 4, 4))
    poses[..., 0, :3] = np.stack([cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr], -1)
    poses[..., 1, :3] = np.stack([sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr], -1)
    poses[..., 2, :3] = np.stack([-sp, cp * sr, cp * cr], -1)
    poses[..., :3, 3] = image[..., 3:]
    poses[..., 3, 3] = 1
    return poses


def _image(path: Path, name: str, cells: dict[str, object], size: tuple[int, int], depth: int) -> NDArray[np.float64]:
    """A range image (H, W, depth)."""
    shape = _shape(path, f"{name}.shape", cells[f"{name}.shape"], depth)
    if shape != size:
        raise LogError(f"{path}: {name} has {shape[0]}x{shape[1]} cells, the first range image {size[0]}x{size[1]}")
    values = numbers_of(path, f"{name}.values", cells[f"{name}.values"])
    if len(values) != shape[0] * shape[1] * depth:
        raise LogError(f"{path}: {name} holds {len(values)} numbers for {shape[0]}x{shape[1]}x{depth}")
    return values.reshape(*shape, depth)


def _shape(path: Path, name: str, cell: object, depth: int) -> tuple[int, int]:
    pa = arrow(path)
    values = getattr(cell, "values", None)
    shape = values.to_pylist() if values is not None and pa.types.is_integer(values.type) else []
    whole = len(shape) == 3 and all(isinstance(side, int) and side > 0 for side in shape)
    if not whole or shape[2] != depth or shape[0] * shape[1] > MAX_CELLS or shape[0] < 2 or shape[1] < 2:
        raise LogError(f"{path}: {name!r} is {shape}, not rows, columns and {depth}")
    return shape[0], shape[1]
