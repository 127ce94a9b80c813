"""Reader of PandaSet's layout (Xiao et al., "PandaSet", ITSC 2021): a `Log` of numpy arrays, read when asked for."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..drive import Camera, CameraModel, Drive, Lidar
from ..errors import LogError
from ..geometry import FloatArray, Trajectory, make_pose, transform_points
from ..log import Sweep, SweepGrid
from . import pandaset_sensors as sensors
from .pandaset_actors import read_actors
from .pandaset_files import frame_files, image_size, ranges, read_intrinsics, read_poses, read_times
from .safe_pickle import read_table
from .sweep_cells import find_cells, make_grid, never_returned

SWEEP_COLUMNS = ("x", "y", "z", "i", "t", "d")
MAX_POINT_AGE_S = 1.0
"""A point whose time is further from its sweep's is an error."""
BLOCKED_FRAMES = 8
"""Sweeps, spread over the log, from which the cells are found that the vehicle itself blocks."""


class PandasetLog:
    """A drive in PandaSet's layout; see `unisim_blender.core.log.Log`."""

    path: Path
    drive: Drive
    missing: tuple[str, ...]

    def __init__(self, path: Path) -> None:
        self.path = path
        missing: list[str] = []
        times = read_times(path / "lidar" / "timestamps.json")
        positions, quaternions = read_poses(path / "lidar" / "poses.json", len(times))
        self._start_s, origin = float(times[0]), positions[0].copy()
        frames = range(len(times))
        time_s = {frame: float(times[frame] - self._start_s) for frame in frames}
        turn = make_pose(np.zeros(3), sensors.PANDASET_EGO_FROM_EGO_WXYZ)
        world_from_ego = Trajectory(times - self._start_s, positions - origin, quaternions).transformed(right=turn)
        self._sweeps = frame_files(path / "lidar", ".pkl.gz", len(times))
        self._semantics = frame_files(path / "annotations" / "semseg", ".pkl.gz", len(times))
        cuboids = frame_files(path / "annotations" / "cuboids", ".pkl.gz", len(times))
        for what, files in (("sweeps", self._sweeps), ("cuboids", cuboids), ("semantic classes", self._semantics)):
            _note_missing(missing, "lidar" if files is self._sweeps else "annotations", what, frames, files)
        self._images: dict[str, dict[int, Path]] = {}
        cameras = {}
        for name in sensors.CAMERAS:
            camera = self._open_camera(name, origin, missing)
            if camera is not None:
                cameras[name] = camera
        self._gt_frames: tuple[int, ...] | None = None
        self._blocked: dict[str, NDArray[np.bool_]] = {}
        lidars = {sensors.PANDAR64: self._lidar(sensors.PANDAR64, world_from_ego, time_s)} if self._sweeps else {}
        if self._largest_sweep_has_gt():
            lidars[sensors.PANDAR_GT] = self._lidar(sensors.PANDAR_GT, world_from_ego, time_s)
        self.drive = Drive(
            name=path.resolve().name,
            frames=tuple(frames),
            time_s=time_s,
            world_from_ego=world_from_ego,
            cameras=cameras,
            lidars=lidars,
            actors=read_actors(cuboids, time_s, origin),
            world_origin=origin,
        )
        self.missing = tuple(missing)

    def image_frames(self, camera: str) -> tuple[int, ...]:
        """Frames of which the camera has an image."""
        return tuple(sorted(self._images.get(camera, {})))

    def sweep_frames(self, lidar: str) -> tuple[int, ...]:
        """Frames of which the LiDAR has a sweep. For the PandarGT every sweep is looked into, once."""
        if lidar not in self.drive.lidars:
            return ()
        if lidar == sensors.PANDAR_GT:
            if self._gt_frames is None:
                self._gt_frames = tuple(frame for frame in sorted(self._sweeps) if self._has_gt(self._sweeps[frame]))
            return self._gt_frames
        return tuple(sorted(self._sweeps))

    def image(self, camera: str, frame: int) -> NDArray[np.uint8]:
        """The recorded image (H, W, 3), sRGB. Decoding needs Pillow."""
        from PIL import Image, UnidentifiedImageError

        path = self._images.get(camera, {}).get(frame)
        if path is None:
            raise LogError(f"{self.path}: {camera} has no image of frame {frame}")
        self._check_size(path, self.drive.cameras[camera].model)
        try:
            with Image.open(path) as image:
                return np.asarray(image.convert("RGB"))
        except (OSError, UnidentifiedImageError, Image.DecompressionBombError) as error:
            raise LogError(f"{path}: cannot be decoded ({error})") from error

    def sweep(self, lidar: str, frame: int) -> Sweep:
        """The recorded returns, less those of the vehicle's own body."""
        path = self._sweeps.get(frame)
        if path is None or lidar not in self.drive.lidars:
            raise LogError(f"{self.path}: {lidar} has no sweep of frame {frame}")
        table = read_table(path, SWEEP_COLUMNS)
        semantic = self._semantic(frame, len(table["x"]))
        keep = table["d"] == sensors.DEVICES[lidar]
        points = np.stack([table[axis][keep] for axis in "xyz"], -1).astype(np.float64) - self.drive.world_origin
        time_s = table["t"][keep].astype(np.float64) - self._start_s
        intensity = table["i"][keep].astype(np.float64)
        if not (np.isfinite(points).all() and np.isfinite(time_s).all() and np.isfinite(intensity).all()):
            raise LogError(f"{path}: a point holds a value that is not finite")
        age = time_s - self.drive.time_s[frame]
        if len(age) and np.abs(age).max() > MAX_POINT_AGE_S:
            raise LogError(f"{path}: a point is {float(age[np.abs(age).argmax()]):.3f} s from its sweep's timestamp")
        return self._located(self.drive.lidars[lidar], points, time_s, intensity, semantic[keep])

    def sweep_grid(self, lidar: str, frame: int) -> SweepGrid:
        """The recorded sweep as beams x columns, with drops."""
        if lidar == sensors.PANDAR_GT:
            raise LogError(f"{self.path}: {lidar} does not scan beams x columns, ask for its plain sweep")
        sweep = self.sweep(lidar, frame)
        if lidar not in self._blocked:
            frames = self.sweep_frames(lidar)
            chosen = sorted({frames[i] for i in np.linspace(0, len(frames) - 1, BLOCKED_FRAMES).round().astype(int)})
            self._blocked[lidar] = never_returned([self.sweep(lidar, f) for f in chosen], self.drive.lidars[lidar].model)
        return make_grid(sweep, self.drive.lidars[lidar], frame, self._blocked[lidar])

    def _located(
        self, lidar: Lidar, points: FloatArray, time_s: FloatArray, intensity: FloatArray, semantic: NDArray[np.int32]
    ) -> Sweep:
        """Points with their rays' origins and cells: the recording's motion compensation undone."""
        poses = lidar.world_from_lidar.at(time_s)
        local = np.einsum("nji,nj->ni", poses[:, :3, :3], points - poses[:, :3, 3])
        in_ego = transform_points(sensors.ego_from_lidar(lidar.sensor_id), local)
        own = ((in_ego > sensors.BODY_MIN_M) & (in_ego < sensors.BODY_MAX_M)).all(-1)
        points, local, time_s, poses = points[~own], local[~own], time_s[~own], poses[~own]
        if lidar.model.beams:
            ring, column = find_cells(local, lidar.model)
        else:
            ring = column = np.full(len(points), -1, np.int32)
        brightness = np.clip(intensity[~own] / 255, 0, 1).astype(np.float32)
        return Sweep(points, poses[:, :3, 3].copy(), time_s, brightness, ring, column, semantic[~own])

    def _semantic(self, frame: int, rows: int) -> NDArray[np.int32]:
        path = self._semantics.get(frame)
        if path is None:
            return np.full(rows, -1, np.int32)
        classes = read_table(path, ("class",))["class"]
        if len(classes) != rows:
            raise LogError(f"{path}: holds {len(classes)} classes for the sweep's {rows} points")
        return classes.astype(np.int32)

    def _open_camera(self, name: str, origin: FloatArray, missing: list[str]) -> Camera | None:
        folder = self.path / "camera" / name
        if not folder.is_dir():
            missing.append(f"camera {name} is missing")
            return None
        times = read_times(folder / "timestamps.json")
        positions, quaternions = read_poses(folder / "poses.json", len(times))
        intrinsics = read_intrinsics(folder / "intrinsics.json")
        files = frame_files(folder, ".jpg", len(times))
        if not files:
            missing.append(f"camera {name} has no images")
            return None
        _note_missing(missing, f"camera {name}", "images", range(len(times)), files)
        self._images[name] = files
        width, height = image_size(files[min(files)])
        model = CameraModel(width, height, **intrinsics, shutter=sensors.ROLLING_SHUTTER)
        trajectory = Trajectory(times - self._start_s, positions - origin, quaternions)
        return Camera(name, model, trajectory, {frame: float(times[frame] - self._start_s) for frame in range(len(times))})

    @staticmethod
    def _lidar(name: str, world_from_ego: Trajectory, time_s: dict[int, float]) -> Lidar:
        model = sensors.pandar64() if name == sensors.PANDAR64 else sensors.pandar_gt()
        return Lidar(name, model, world_from_ego.transformed(right=sensors.ego_from_lidar(name)), dict(time_s))

    def _check_size(self, path: Path, model: CameraModel) -> None:
        width, height = image_size(path)
        if (width, height) != (model.width, model.height):
            raise LogError(f"{path}: has {width}x{height} pixels, the camera's first image has {model.width}x{model.height}")

    def _largest_sweep_has_gt(self) -> bool:
        """Whether there are PandarGT points at all: a sweep of both LiDARs is larger than any of the Pandar64 alone."""
        return bool(self._sweeps) and self._has_gt(max(self._sweeps.values(), key=lambda path: path.stat().st_size))

    @staticmethod
    def _has_gt(path: Path) -> bool:
        return bool((read_table(path, SWEEP_COLUMNS)["d"] == sensors.DEVICES[sensors.PANDAR_GT]).any())


def _note_missing(missing: list[str], where: str, what: str, frames: range, files: dict[int, Path]) -> None:
    absent = [frame for frame in frames if frame not in files]
    if absent:
        missing.append(f"{where}: no {what} of frames {ranges(absent)}" if files else f"{where}: no {what}")
