"""Reader of KITTI's raw drives and tracking sequences (Geiger et al., "Vision meets robotics", IJRR 2013): a `Log`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...data.image_files import image_header
from ...data.log import Sweep, SweepGrid
from ...data.sweep_cells import make_grid
from ...data.values import Intensities, spread
from ...errors import LogError
from ...geometry import FloatArray, Trajectory, TrajectoryError, invert_pose, make_pose
from ...sensors.lidar import column_azimuths
from ...world.box_tracks import TrackedBoxes, actors_of_boxes
from ...world.classes import KITTI
from ...world.drive import Camera, CameraModel, Drive, Lidar, RollingShutter
from ...world.light import SunPosition, recorded_sun
from ..common.file_log import FileLog, absent_frames
from ..common.sensor_file import read_setup
from . import VELODYNE, beside_tracking, tracking_sequence
from .beams import assign_columns, assign_rings, point_times
from .files import BoxRecord, intrinsics, read_points
from .folders import imu_poses, raw_files, read_labels, tracking_files
from .registration import LidarCalibration, find

LIDAR = "velodyne"
BRIGHTEST = 1.0
"""The layout's intensities are from 0 to this."""
BODY_MIN_M, BODY_MAX_M = np.array([-2.6, -1.1, -1.8]), np.array([1.6, 1.1, 0.3])
"""Box in the LiDAR's frame in which a return comes from the vehicle itself."""
MARGIN_S = 0.25
"""So far beyond its poses a drive may have frames."""
DAYS = tuple(np.array(["2011-09-26", "2011-10-04"], "datetime64[ns]").astype(np.int64))
"""From and until when the dataset was recorded; of other drives the clock is not known."""
UTC_LAG_S = 7200
"""The dataset's timestamps are in Karlsruhe's summer time."""
UNFIRED_STEPS = 0.6
"""An empty cell nearer to a return of its ring than this many columns was not fired at: the sensor's steps are not even."""


class KittiLog(FileLog):
    """A raw drive or tracking sequence; see `unisim_blender.core.data.log.Log`.

    The ego frame is the IMU's where it is calibrated, else the LiDAR's. Frames keep the files' numbers, and are as many as have a
    sweep or an image.
    """

    classes = KITTI

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        tracking = None if (path / VELODYNE).is_dir() else tracking_sequence(path)
        files = raw_files(path) if tracking is None else tracking_files(*tracking)
        self._files = files
        self._images, self._sweeps = files.images, files.sweeps
        self._intensities = Intensities(LIDAR, BRIGHTEST, self._bright, self.notes)
        # of a drive that this program wrote
        setup = read_setup(path if tracking is None else beside_tracking(*tracking))
        self._shutters = {} if setup is None else setup.shutters
        stated = setup.lidars[LIDAR].model if setup is not None and LIDAR in setup.lidars else None
        ego_from_lidar = np.eye(4)
        if files.calibration.lidar_from_imu is not None:
            ego_from_lidar = invert_pose(files.calibration.lidar_from_imu)
        recorded, origin = self._recorded_poses()
        calibration = find(
            path, files, None if recorded is None else recorded.transformed(right=ego_from_lidar), stated
        )
        world_from_ego = recorded
        if world_from_ego is None and calibration is not None and calibration.trajectory is not None:
            world_from_ego = _from_first(calibration.trajectory, files.time_s).transformed(
                right=invert_pose(ego_from_lidar)
            )
            world_from_ego, origin = _centred(world_from_ego, files.time_s)
        if world_from_ego is None:
            raise LogError(f"{path}: has no poses (oxts), and no sweeps to find them by")
        frames = tuple(sorted(files.time_s))
        self._calibration, self._world_from_lidar = calibration, world_from_ego.transformed(right=ego_from_lidar)
        lidars = {} if calibration is None else {LIDAR: self._lidar(calibration, self._world_from_lidar)}
        self._beams = None if calibration is None else calibration.beams
        self.drive = Drive(
            name=files.name,
            frames=frames,
            time_s=dict(files.time_s),
            world_from_ego=world_from_ego,
            cameras=self._cameras(world_from_ego, ego_from_lidar),
            lidars=lidars,
            actors=actors_of_boxes(self.path, self._tracked(files.boxes)),
            world_origin=origin,
        )
        self.missing = tuple(self._what_is_missing(calibration))

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of images and sweeps; see `LogExtras`."""
        images = (path for of_camera in self._files.images.values() for path in of_camera.values())
        return (*images, *self._files.sweeps.values())

    @property
    def sun(self) -> SunPosition | None:
        """Where the sun stood at the first frame; None for a drive that is not one of the dataset's raw ones."""
        files = self._files
        if files.oxts is None or files.clock_ns is None or not DAYS[0] <= files.clock_ns < DAYS[1]:
            return None
        return recorded_sun(files.oxts[:, :2], imu_poses(files.oxts)[:, :3, 3], files.clock_ns * 1e-9 - UTC_LAG_S)

    def _size_stated(self, camera: str) -> str:
        return (
            "calib_cam_to_cam.txt gives" if camera in self._files.calibration.sizes else "the camera's first image has"
        )

    def sweep(self, lidar: str, frame: int) -> Sweep:
        """The recorded returns, less those of the vehicle's own body: each at its own time, from its own beam's origin."""
        path = self._files.sweeps.get(frame)
        if path is None or lidar not in self.drive.lidars or self._beams is None:
            raise LogError(f"{self.path}: {lidar} has no sweep of frame {frame}")
        sensor, beams = self.drive.lidars[lidar], self._beams
        points = read_points(path)
        ring = assign_rings(points, beams)  # of the whole file: rings are told by its order
        outside = ~((points[:, :3] > BODY_MIN_M) & (points[:, :3] < BODY_MAX_M)).all(1)
        points, ring = points[outside], ring[outside]
        time_s = point_times(points, self._files.turns[frame], sensor.model.direction)
        poses = sensor.world_from_lidar.at(time_s)
        height = np.where(ring >= 0, beams.height_m[ring], 0.0)
        origins = poses[:, :3, 3] + poses[:, :3, 2] * height[:, None]
        world = np.einsum("nij,nj->ni", poses[:, :3, :3], points[:, :3]) + poses[:, :3, 3]
        return Sweep(
            points=world,
            origins=origins,
            time_s=time_s,
            intensity=self._intensities.scaled(points[:, 3], str(path)),
            ring=ring,
            column=assign_columns(points, ring, sensor.model),
            semantic=np.full(len(points), -1, np.int32),
        )

    def _bright(self) -> list[FloatArray]:
        return [read_points(self._files.sweeps[frame])[:, 3] for frame in spread(self._files.sweeps)]

    def sweep_grid(self, lidar: str, frame: int) -> SweepGrid:
        """The recorded sweep as beams x columns, with drops; of cells between two firings nothing is known."""
        sweep = self.sweep(lidar, frame)
        sensor = self.drive.lidars[lidar]
        grid = make_grid(sweep, sensor, frame, self._find_never_returned(lidar) | self._unfired(sweep, sensor))
        return self._raised(grid, sensor)

    def _raised(self, grid: SweepGrid, sensor: Lidar) -> SweepGrid:
        """The grid with the rays of empty cells starting from their own beams' heights, as returns' do."""
        assert self._beams is not None
        empty = np.nonzero(~grid.returned)
        up = sensor.world_from_lidar.at(grid.time_s[empty])[:, :3, 2]
        origins = grid.origins.copy()
        origins[empty] += up * self._beams.height_m[empty[0]][:, None]
        return replace(grid, origins=origins)

    @staticmethod
    def _unfired(sweep: Sweep, sensor: Lidar) -> NDArray[np.bool_]:
        """Empty cells (beams, columns) that lie so near to a return of their ring that none was fired there."""
        model = sensor.model
        poses = sensor.world_from_lidar.at(sweep.time_s)
        local = np.einsum("nji,nj->ni", poses[:, :3, :3], sweep.points - poses[:, :3, 3])
        step = 2 * np.pi / model.columns
        middle = column_azimuths(model)[sweep.column] + model.azimuth_offset_rad[sweep.ring]
        off = np.angle(np.exp(1j * (np.arctan2(local[:, 1], local[:, 0]) - middle))) / step * model.direction
        unfired = np.zeros((model.beams, model.columns), np.bool_)
        known = sweep.ring >= 0
        for side in (-1, 1):  # a return is within half a column of its own cell's middle
            near = known & (np.abs(off - side) < UNFIRED_STEPS)
            unfired[sweep.ring[near], (sweep.column[near] + side) % model.columns] = True
        unfired[sweep.ring[known], sweep.column[known]] = False
        return unfired

    def _recorded_poses(self) -> tuple[Trajectory | None, FloatArray]:
        """The IMU's trajectory less the world's origin, and the origin; None where there is no IMU, or none calibrated."""
        files = self._files
        if files.oxts is None or files.oxts_times_s is None or not len(files.oxts):
            return None, np.zeros(3)
        if files.calibration.lidar_from_imu is None:
            files.notes.append("calib_imu_to_velo.txt is missing: the poses of oxts cannot be used")
            return None, np.zeros(3)
        for time in (min(files.time_s.values()), max(files.time_s.values())):
            first, last = float(files.oxts_times_s[0]), float(files.oxts_times_s[-1])
            if not first - MARGIN_S <= time <= last + MARGIN_S:
                raise LogError(
                    f"{self.path}: oxts has poses from {first:.3f} to {last:.3f} s, but there is a frame at {time:.3f} s"
                )
        poses = imu_poses(files.oxts)
        origin = poses[0, :3, 3].copy()
        poses[:, :3, 3] -= origin
        try:
            return Trajectory.from_poses(files.oxts_times_s, poses), origin
        except TrajectoryError as error:
            raise LogError(f"{self.path}: the trajectory of oxts: {error}") from error

    def _lidar(self, calibration: LidarCalibration, track: Trajectory) -> Lidar:
        turns = self._files.turns
        sweep_s = float(np.median([end - start for start, _, end in turns.values()]))
        model = calibration.beams.model(calibration.spin.direction, sweep_s)
        return Lidar(LIDAR, model, track, {frame: turns[frame][1] for frame in sorted(turns)})

    def _cameras(self, world_from_ego: Trajectory, ego_from_lidar: FloatArray) -> dict[str, Camera]:
        files, cameras = self._files, {}
        lidar_from_camera0 = invert_pose(files.calibration.camera0_from_lidar)
        for name, images in files.images.items():
            if not images:
                continue
            values, camera_from_camera0 = intrinsics(files.calibration.projections[name])
            width, height = image_header(images[min(images)]).size(*values[2:])
            width, height = files.calibration.sizes.get(name, (width, height))
            mount = ego_from_lidar @ lidar_from_camera0 @ invert_pose(camera_from_camera0)
            cameras[name] = Camera(
                sensor_id=name,
                model=CameraModel(width, height, *values, shutter=self._shutters.get(name, RollingShutter())),
                world_from_camera=world_from_ego.transformed(right=mount),
                time_s={**dict(sorted(files.time_s.items())), **files.image_times.get(name, {})},
            )
        return cameras

    def _tracked(self, records: list[BoxRecord]) -> TrackedBoxes:
        """Return boxes, each keyed when the beams passed its centre, and placed by where the sensor was then."""
        files, calibration = self._files, self._calibration
        boxes = sorted((box for box in records if box.frame in files.time_s), key=lambda box: box.frame)
        frame_times = np.array([files.time_s[box.frame] for box in boxes])
        places = np.array([box.lidar_from_box for box in boxes]).reshape(-1, 4, 4)
        passed = frame_times.copy()
        swept = np.flatnonzero([calibration is not None and box.frame in files.turns for box in boxes])
        if calibration is not None and len(swept):
            start, forward, end = np.array([files.turns[boxes[at].frame] for at in swept]).T
            passed[swept] = point_times(places[swept, :3, 3], (start, forward, end), calibration.spin.direction)
        uids, labels = np.array([box.uid for box in boxes]), np.array([box.label for box in boxes])
        sizes = np.array([box.size_m for box in boxes]).reshape(-1, 3)
        scores = np.array([1.0 if box.score is None else box.score for box in boxes])
        return TrackedBoxes(
            uids, labels, frame_times, self._world_from_lidar.at(passed) @ places, sizes, passed, scores
        )

    def boxes_of(self, path: Path) -> TrackedBoxes:
        """Return the boxes of a file with labels or results of the tracking benchmark: in the first rectified camera's
        frame. Raises `LogError`."""
        records = read_labels(path, self._files.calibration.camera0_from_lidar)
        if records and not any(box.frame in self._files.time_s for box in records):
            frames = sorted({box.frame for box in records})
            raise LogError(f"{path}: has frames {frames[0]} to {frames[-1]}, none of which {self.drive.name} has")
        return self._tracked(records)

    def _what_is_missing(self, calibration: LidarCalibration | None) -> list[str]:
        files = self._files
        said = list(files.notes)
        if calibration is not None:
            said += [calibration.spin.sentence, *([calibration.sentence] if calibration.sentence else [])]
        for name, there in {VELODYNE: files.sweeps, **files.images}.items():
            absent = absent_frames(self.drive.frames, there)
            if there and absent:
                said.append(f"{name}: no {'sweeps' if name == VELODYNE else 'images'} of {absent}")
        if not files.sweeps:
            said.append(f"{VELODYNE}: no sweeps")
        empty = [name for name, there in files.images.items() if not there]
        if empty:
            said.append(f"{', '.join(empty)}: no images")
        return said


def _from_first(trajectory: Trajectory, time_s: dict[int, float]) -> Trajectory:
    """The trajectory from where the sensor was at the drive's first frame."""
    return trajectory.transformed(left=invert_pose(trajectory.at(time_s[min(time_s)])))


def _centred(trajectory: Trajectory, time_s: dict[int, float]) -> tuple[Trajectory, FloatArray]:
    """The trajectory less its place at the first frame, and an origin of zeros: there is no world that the log knows."""
    place = make_pose(-trajectory.at(time_s[min(time_s)])[:3, 3], np.array([1.0, 0.0, 0.0, 0.0]))
    return trajectory.transformed(left=place), np.zeros(3)
