"""Reader of PandaSet's layout (Xiao et al., "PandaSet", ITSC 2021): a `Log` of numpy arrays, read when asked for."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...data.image_files import Notes, files_by_stem, image_header, image_suffixes, what_else
from ...data.log import Sweep
from ...data.sweep_cells import find_cells
from ...data.values import Intensities, spread, time_unit
from ...errors import LogError, in_a_line
from ...geometry import FloatArray, Trajectory, TrajectoryError, make_pose, transform_points
from ...lenses import PINHOLE
from ...world.drive import Camera, CameraModel, Drive, Lidar
from ...world.light import SunPosition, recorded_sun
from ..common.file_log import FileLog, absent_frames, read_text
from ..common.sensor_file import LidarSetup, LogSetup, read_setup
from . import sensors as sensors
from .actors import read_actors
from .safe_pickle import read_table

CLOSEST_S = 1e-6
"""Between two frames' times: between closer ones speeds are beyond numbers."""


def read_json(path: Path) -> Any:
    """The JSON document at ``path``."""
    text = read_text(path)
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise LogError(f"{path}: is not valid JSON ({in_a_line(error)})") from error


def read_times(path: Path) -> FloatArray:
    """Timestamps (T,) in seconds; they must increase strictly from frame to frame."""
    times = _numbers(path, read_json(path), "timestamps")
    if len(times) == 0:
        raise LogError(f"{path}: holds no timestamp")
    late = np.flatnonzero(np.diff(times) < CLOSEST_S)
    if len(late):
        frame = int(late[0]) + 1
        raise LogError(
            f"{path}: frame {frame} at {times[frame]} s is not later than frame {frame - 1} at {times[frame - 1]} s"
        )
    return times


def read_poses(path: Path, count: int) -> tuple[FloatArray, FloatArray]:
    """Positions (count, 3) and unit quaternions wxyz (count, 4), one for each timestamp."""
    poses = read_json(path)
    if not isinstance(poses, list) or len(poses) != count:
        content = f"{len(poses)} poses" if isinstance(poses, list) else "no list of poses"
        raise LogError(f"{path}: holds {content} for {count} timestamps")
    positions, quaternions = np.zeros((count, 3)), np.zeros((count, 4))
    for frame, pose in enumerate(poses):
        try:
            positions[frame] = [float(pose["position"][axis]) for axis in "xyz"]
            quaternions[frame] = [float(pose["heading"][axis]) for axis in "wxyz"]
        except (KeyError, TypeError, ValueError) as error:
            raise LogError(
                f"{path}: the pose of frame {frame} is no position and heading ({in_a_line(error)})"
            ) from error
        values = [*positions[frame], *quaternions[frame]]
        if not np.isfinite(values).all():
            raise LogError(f"{path}: the pose of frame {frame} holds a value that is not finite")
        length = float(np.linalg.norm(quaternions[frame]))
        if abs(length - 1) > 1e-3:
            raise LogError(f"{path}: the heading of frame {frame} has length {length:.6g}, not 1")
        if abs(length - 1) > 1e-12:
            quaternions[frame] /= length
    return positions, quaternions


def read_intrinsics(path: Path) -> dict[str, float]:
    """fx, fy, cx, cy in pixels of the images as stored."""
    values = read_json(path)
    try:
        intrinsics = {name: float(values[name]) for name in ("fx", "fy", "cx", "cy")}
    except (KeyError, TypeError, ValueError) as error:
        raise LogError(f"{path}: does not hold the numbers fx, fy, cx and cy ({in_a_line(error)})") from error
    for name, value in intrinsics.items():
        if not np.isfinite(value) or (name in ("fx", "fy") and value <= 0):
            raise LogError(f"{path}: {name} is {value}")
    return intrinsics


def frame_files(folder: Path, suffixes: tuple[str, ...], count: int, notes: Notes | None = None) -> dict[int, Path]:
    """Files by frame number, which is the name before one of ``suffixes``; a number that has no timestamp is an error."""
    files: dict[int, Path] = {}
    for stem, path in files_by_stem(folder, suffixes, notes).items():
        if not stem.isascii() or not stem.isdigit():
            continue
        frame = int(stem)
        if frame >= count:
            raise LogError(f"{path}: is frame {frame}, but there are {count} timestamps only")
        if frame in files:
            raise LogError(f"{path}: is frame {frame}, and so is {files[frame].name}")
        files[frame] = path
    return files


def _numbers(path: Path, values: Any, what: str) -> FloatArray:
    if not isinstance(values, list) or not all(isinstance(value, int | float) for value in values):
        raise LogError(f"{path}: is no list of {what}")
    array = np.array(values, np.float64)
    if not np.isfinite(array).all():
        raise LogError(f"{path}: entry {int(np.flatnonzero(~np.isfinite(array))[0])} is not finite")
    return array


SWEEP_COLUMNS = ("x", "y", "z", "i", "t", "d")
IMAGES = image_suffixes(".jpg")
TABLES = (".pkl.gz", ".pkl")
"""Endings of tables; a copy of the dataset that others publish has them unpacked."""
BRIGHT = 255.0
"""The layout's intensities are from 0 to this."""
FARTHEST_M, BRIGHTEST = 1e7, 1e9
"""From the drive's origin; what lies beyond is an error, as is a point that is brighter."""
MAX_POINT_AGE_S = 1.0
"""A point whose time is further from its sweep's is an error."""
ROAD: Mapping[int, bool] = {
    **dict.fromkeys((7, 8, 9, 10), True),  # road, and markings of lanes, stop lines and others
    **dict.fromkeys((5, 6, 11, 12, 41), False),  # vegetation, ground, sidewalk, driveway, building
}
"""PandaSet's semantic classes that tell where the road is."""


class PandasetLog(FileLog):
    """A drive in PandaSet's layout; see `unisim_blender.core.data.log.Log`."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        missing: list[str] = []
        stated = read_setup(path)
        self._unit_s = 1.0
        self._is_pandasets_own = stated is None
        times = self._read_times(path / "lidar")
        positions, quaternions = read_poses(path / "lidar" / "poses.json", len(times))
        setup = stated or _pandaset_setup(path, float(times[0]), positions[0], len(times))
        if setup.frames[-1] >= len(times):
            raise LogError(f"{path}: names frame {setup.frames[-1]}, but the lidar has {len(times)} timestamps only")
        self._setup = setup
        turn = make_pose(np.zeros(3), sensors.PANDASET_EGO_FROM_EGO_WXYZ)
        ego = self._trajectory("the vehicle", times, positions, quaternions).transformed(right=turn)
        time_s = {frame: float(times[frame] - setup.time_origin_s) for frame in setup.frames}
        self._sweeps = self._files(path / "lidar", TABLES, len(times))
        self._intensities = Intensities("lidar", BRIGHT, self._bright, self.notes)
        self._semantics = self._files(path / "annotations" / "semseg", TABLES, len(times))
        cuboids = self._files(path / "annotations" / "cuboids", TABLES, len(times))
        self._note_missing(missing, "lidar", "sweeps", self._sweeps)
        self._note_missing(missing, "annotations", "cuboids", cuboids)
        self._note_missing(missing, "annotations", "semantic classes", self._semantics)
        self._images: dict[str, dict[int, Path]] = {}
        cameras = {name: self._open_camera(name, missing) for name in setup.shutters}
        self._gt_frames: tuple[int, ...] | None = None
        lidars = {name: self._lidar(name, ego, time_s) for name in setup.lidars if self._has_lidar(name)}
        passing = self._lidar(sensors.PANDAR64, ego, time_s) if self._is_pandasets_own else None
        self.drive = Drive(
            name=setup.name,
            frames=setup.frames,
            time_s=time_s,
            world_from_ego=ego,
            cameras={name: camera for name, camera in cameras.items() if camera is not None},
            lidars=lidars,
            actors=read_actors(cuboids, time_s, setup.world_origin, passing),
            world_origin=setup.world_origin,
        )
        self.missing = tuple(missing)

    @property
    def sun(self) -> SunPosition | None:
        """Where the sun stood at the middle frame; None without positions on the Earth for every frame, or for a log that
        another program wrote: its times may begin anywhere."""
        path = self.path / "meta" / "gps.json"
        if not self._is_pandasets_own or not path.is_file():
            return None
        records, times = read_json(path), self._read_times(self.path / "lidar")
        try:
            degrees = np.array([(record["lat"], record["long"]) for record in records], np.float64)
        except (TypeError, KeyError, ValueError):
            return None
        positions, _ = read_poses(self.path / "lidar" / "poses.json", len(times))
        if degrees.shape != (len(times), 2) or not np.isfinite(degrees).all():
            return None
        return recorded_sun(degrees, positions, float(times[len(times) // 2]))

    @property
    def road(self) -> Mapping[int, bool]:
        return ROAD if self._semantics else {}

    def sweep_frames(self, lidar: str) -> tuple[int, ...]:
        """Frames of which the LiDAR has a sweep. For the PandarGT every sweep is looked into, once."""
        if lidar == sensors.PANDAR_GT and lidar in self.drive.lidars:
            if self._gt_frames is None:
                self._gt_frames = tuple(frame for frame in sorted(self._sweeps) if self._has_gt(self._sweeps[frame]))
            return self._gt_frames
        return super().sweep_frames(lidar)

    def _size_stated(self, camera: str) -> str:
        return "the camera's first image has"

    def sweep(self, lidar: str, frame: int) -> Sweep:
        """The recorded returns, less those of the vehicle's own body."""
        path = self._sweep_place(lidar, frame)
        table = read_table(path, SWEEP_COLUMNS)
        semantic = self._semantic(frame, len(table["x"]))
        keep = np.asarray(table["d"] == self._setup.lidars[lidar].device, bool)
        empty = np.logical_and.reduce([table[axis] == 0 for axis in "xyz"])
        if empty.any():
            self.notes.say(
                "empty", f"{path}: {int(empty.sum())} of {len(empty)} points are at 0, 0, 0: they are no returns"
            )
            keep &= ~empty
        try:
            points = np.stack([table[axis][keep] for axis in "xyz"], -1).astype(np.float64) - self.drive.world_origin
            time_s = table["t"][keep].astype(np.float64) * self._unit_s - self._setup.time_origin_s
            intensity = table["i"][keep].astype(np.float64)
        except (TypeError, ValueError, OverflowError) as error:
            raise LogError(f"{path}: a point's numbers are none ({in_a_line(error)})") from error
        if not (np.isfinite(points).all() and np.isfinite(time_s).all() and np.isfinite(intensity).all()):
            raise LogError(f"{path}: a point holds a value that is not finite")
        if np.abs(points).max(initial=0.0) > FARTHEST_M or np.abs(intensity).max(initial=0.0) > BRIGHTEST:
            raise LogError(
                f"{path}: a point lies more than {FARTHEST_M:.0e} m away, or its intensity is above {BRIGHTEST:.0e}"
            )
        age = time_s - self.drive.time_s[frame]
        if len(age) and np.abs(age).max() > MAX_POINT_AGE_S:
            raise LogError(f"{path}: a point is {float(age[np.abs(age).argmax()]):.3f} s from its sweep's timestamp")
        stamp_s = self.drive.time_s[frame]
        bright = self._intensities.scaled(intensity, str(path))
        return self._located(self.drive.lidars[lidar], stamp_s, points, time_s, bright, semantic[keep])

    def _bright(self) -> list[FloatArray]:
        tables = (read_table(self._sweeps[frame], SWEEP_COLUMNS) for frame in spread(self._sweeps))
        return [table["i"].astype(np.float64) for table in tables]

    def _located(
        self,
        lidar: Lidar,
        stamp_s: float,
        points: FloatArray,
        time_s: FloatArray,
        intensity: NDArray[np.float32],
        semantic: NDArray[np.int32],
    ) -> Sweep:
        """Points of the sweep stamped ``stamp_s`` with their rays' origins and cells: its motion compensation undone."""
        poses = lidar.world_from_lidar.at(time_s)
        local = np.einsum("nji,nj->ni", poses[:, :3, :3], points - poses[:, :3, 3])
        if self._is_pandasets_own:
            in_ego = transform_points(self._setup.lidars[lidar.sensor_id].ego_from_lidar, local)
            keep = ~((in_ego > sensors.BODY_MIN_M) & (in_ego < sensors.BODY_MAX_M)).all(-1)
            points, local, time_s, poses = points[keep], local[keep], time_s[keep], poses[keep]
            intensity, semantic = intensity[keep], semantic[keep]
        if lidar.model.beams:
            ring, column = find_cells(local, lidar.model_at(stamp_s))
        else:
            ring = column = np.full(len(points), -1, np.int32)
        return Sweep(points, poses[:, :3, 3].copy(), time_s, intensity, ring, column, semantic)

    def _semantic(self, frame: int, rows: int) -> NDArray[np.int32]:
        path = self._semantics.get(frame)
        if path is None:
            return np.full(rows, -1, np.int32)
        classes = read_table(path, ("class",))["class"]
        if len(classes) != rows:
            raise LogError(f"{path}: holds {len(classes)} classes for the sweep's {rows} points")
        try:
            return classes.astype(np.int32)
        except (TypeError, ValueError, OverflowError) as error:
            raise LogError(f"{path}: a class is no number ({in_a_line(error)})") from error

    def _open_camera(self, name: str, missing: list[str]) -> Camera | None:
        folder = self.path / "camera" / name
        if not folder.is_dir():
            missing.append(f"camera {name} is missing")
            return None
        times = self._read_times(folder)
        positions, quaternions = read_poses(folder / "poses.json", len(times))
        intrinsics = read_intrinsics(folder / "intrinsics.json")
        read = Notes()
        files = self._of_frames(frame_files(folder, IMAGES, len(times), read))
        missing.extend(read.values())
        if not files:
            missing.append(f"camera {name} has no images{what_else(folder)}")
            return None
        self._note_missing(missing, f"camera {name}", "images", files)
        self._images[name] = files
        width, height = image_header(files[min(files)]).size(intrinsics["cx"], intrinsics["cy"])
        start_s = self._setup.time_origin_s
        return Camera(
            sensor_id=name,
            model=CameraModel(
                width,
                height,
                **intrinsics,
                shutter=self._setup.shutters[name],
                lens=self._setup.lenses.get(name, PINHOLE),
            ),
            world_from_camera=self._trajectory(name, times, positions, quaternions),
            time_s={frame: float(times[frame] - start_s) for frame in self._setup.frames if frame < len(times)},
            readouts=self._setup.readouts.get(name),
        )

    def _read_times(self, folder: Path) -> FloatArray:
        """A sensor's timestamps (T,) in seconds; the points' times are in the LiDAR's unit."""
        path = folder / "timestamps.json"
        times = read_times(path)
        unit_s = time_unit(times) if self._is_pandasets_own else 1.0
        if unit_s != 1:
            step = float(np.median(np.diff(times)))
            self.notes.say(
                "times",
                f"{path}: frames are {step:.4g} s apart, if the times are in seconds: {unit_s:g} s are taken as their unit",
            )
        if folder.name == "lidar":
            self._unit_s = unit_s
        return times * unit_s

    def _files(self, folder: Path, suffixes: tuple[str, ...], count: int) -> dict[int, Path]:
        """Files by frame, of the log's frames: it may name fewer than it has files of. Those with the first suffix of which there
        are any."""
        return self._of_frames(
            next((files for suffix in suffixes if (files := frame_files(folder, (suffix,), count))), {})
        )

    def _of_frames(self, files: dict[int, Path]) -> dict[int, Path]:
        return {frame: files[frame] for frame in self._setup.frames if frame in files}

    def _trajectory(self, what: str, times: FloatArray, positions: FloatArray, quaternions: FloatArray) -> Trajectory:
        """A trajectory of the log's times and places, by the drive's clock and from its origin."""
        with np.errstate(over="ignore"):
            places = positions - self._setup.world_origin
        far_m = float(np.abs(places).max(initial=0.0))
        if far_m > FARTHEST_M:
            raise LogError(f"{self.path}: the trajectory of {what} goes {far_m:.3g} m from the drive's origin")
        try:
            return Trajectory(times - self._setup.time_origin_s, places, quaternions)
        except TrajectoryError as error:
            raise LogError(f"{self.path}: the trajectory of {what}: {error}") from error

    def _lidar(self, name: str, world_from_ego: Trajectory, time_s: dict[int, float]) -> Lidar:
        setup = self._setup.lidars[name]
        track = world_from_ego.transformed(right=setup.ego_from_lidar)
        return Lidar(name, setup.model, track, dict(time_s), phase=setup.phase)

    def _has_lidar(self, name: str) -> bool:
        """Whether there are points of it; a sweep with the PandarGT's is larger than any of the Pandar64 alone."""
        if not self._sweeps or name != sensors.PANDAR_GT:
            return bool(self._sweeps)
        return self._has_gt(max(self._sweeps.values(), key=lambda path: path.stat().st_size))

    @staticmethod
    def _has_gt(path: Path) -> bool:
        return bool((read_table(path, SWEEP_COLUMNS)["d"] == sensors.DEVICES[sensors.PANDAR_GT]).any())

    def _note_missing(self, missing: list[str], where: str, what: str, files: dict[int, Path]) -> None:
        absent = absent_frames(self._setup.frames, files)
        if absent:
            missing.append(f"{where}: no {what} of {absent}" if files else f"{where}: no {what}")


def _pandaset_setup(path: Path, start_s: float, origin: FloatArray, frames: int) -> LogSetup:
    """Return the setup that a log of PandaSet's own does not state."""
    models = {sensors.PANDAR64: sensors.pandar64(), sensors.PANDAR_GT: sensors.pandar_gt()}
    return LogSetup(
        name=path.resolve().name,
        frames=tuple(range(frames)),
        time_origin_s=start_s,
        world_origin=origin.copy(),
        shutters=dict.fromkeys(sensors.CAMERAS, sensors.ROLLING_SHUTTER),
        lidars={
            name: LidarSetup(sensors.DEVICES[name], sensors.ego_from_lidar(name), model)
            for name, model in models.items()
        },
    )
