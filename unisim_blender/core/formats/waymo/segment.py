"""A segment's files, and which rows of them are which sensor's in which frame."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import LogError
from ...geometry import FloatArray
from ..common.arrow import ArrowColumns, Kind, read_parquet

POSES, SUFFIX = "vehicle_pose", ".parquet"
FRAME, LASER, CAMERA = "key.frame_timestamp_micros", "key.laser_name", "key.camera_name"
FARTHEST_M = 1e7
"""A vehicle farther from the origin than this is nowhere on earth."""


class Segment:
    """The files of one segment: ``root`` is the folder above the components."""

    def __init__(self, path: Path) -> None:
        """Raises `LogError` for a folder of several segments."""
        if path.suffix == SUFFIX:
            self.root, self.name = path.parent.parent, path.stem
            return
        names = sorted(file.stem for file in (path / POSES).glob(f"*{SUFFIX}"))
        if len(names) != 1:
            raise LogError(
                f"{path}: holds {len(names)} segments; name one by its file, as {path / POSES / (names[0] + SUFFIX)}"
            )
        self.root, self.name = path, names[0]

    def file(self, component: str) -> Path:
        """Where the segment's part of a component is."""
        return self.root / component / f"{self.name}{SUFFIX}"

    @property
    def files(self) -> tuple[Path, ...]:
        return tuple(self.root.glob(f"*/{self.name}{SUFFIX}"))

    def has(self, component: str) -> bool:
        return self.file(component).is_file()

    def read(self, component: str, columns: dict[str, Kind]) -> ArrowColumns:
        """Return some columns of a component. Raises `LogError`."""
        return read_parquet(self.file(component), columns)

    def rows(self, component: str, sensor: str, number: int) -> dict[int, int]:
        """Return the row of each frame's timestamp (microseconds), of one sensor: ``sensor`` is the column with its number."""
        table = self.read(component, {FRAME: "whole", sensor: "whole"})
        return rows_of(self.file(component), table[FRAME], table[sensor], number)

    def frame_poses(self) -> tuple[NDArray[np.int64], FloatArray]:
        """Return timestamps (T,), microseconds, increasing, and the vehicle's poses (T, 4, 4) of the frames. The poses are some
        50 ms later than the timestamps, and are what a frame's boxes are given in."""
        path = self.file(POSES)
        name = "[VehiclePoseComponent].world_from_vehicle.transform"
        table = self.read(POSES, {FRAME: "whole", name: "pose"})
        if not len(table[FRAME]):
            raise LogError(f"{path}: holds no frame")
        order = np.argsort(table[FRAME], kind="stable")
        stamps, poses = table[FRAME][order], table[name][order]
        twice = np.flatnonzero(np.diff(stamps) < 1000)
        if len(twice):
            raise LogError(f"{path}: the frames {stamps[twice[0]]} and {stamps[twice[0] + 1]} are less than 1 ms apart")
        check_places(path, poses)
        return stamps, poses


def rows_of(path: Path, stamp_us: NDArray[np.int64], sensor: NDArray[np.int64], number: int) -> dict[int, int]:
    """Return the row of each timestamp where ``sensor`` (N,) is a number. Raises `LogError` for two in a frame."""
    rows: dict[int, int] = {}
    for row in np.flatnonzero(sensor == number).tolist():
        stamp = int(stamp_us[row])
        if stamp in rows:
            raise LogError(f"{path}: sensor {number} stands twice in the frame {stamp}")
        rows[stamp] = row
    return rows


def check_places(path: Path, poses: FloatArray) -> None:
    """Raise `LogError` where a pose (N, 4, 4) is nowhere on earth."""
    far = np.abs(poses[:, :3, 3]).max(1, initial=0.0) > FARTHEST_M
    if far.any():
        row = int(far.argmax())
        raise LogError(f"{path}: a pose is at {tuple(poses[row, :3, 3].tolist())} m")
