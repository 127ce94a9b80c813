"""Reader of nuScenes v1.0 (Caesar et al., "nuScenes", CVPR 2020): a `Log`.

Frames are the LiDAR's sweeps, key frames and those between, 20 a second. Images have a rate of their own: those that are nobody's
nearest are numbered on from the last frame. Boxes are of key frames, two a second, and are interpolated between.

A scene that this program wrote has `meta/unisim.json` beside its tables: the numbers of its frames, its cameras' shutters, and
its LiDAR's beam table, which may have any number of beams and turn at any rate.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...data.log import Drops, Sweep
from ...data.values import Intensities, spread
from ...errors import LogError
from ...geometry import FloatArray, Trajectory, TrajectoryError
from ...sensors import lidar as stated
from ...world.box_tracks import TrackedBoxes, actors_of_boxes, passing_times
from ...world.classes import NUSCENES
from ...world.drive import Camera, CameraModel, Drive, Lidar, RollingShutter
from ...world.own_rates import number_captures
from ..common.file_log import FileLog
from ..common.sensor_file import LidarSetup, LogSetup, read_setup, setup_path
from .columns import (
    OWN_FROM_DATASETS,
    RINGS,
    SweepColumns,
    column_azimuths,
    column_times,
    count_columns,
    find_beams,
    read_columns,
    undone,
)
from .results import read_results
from .scene import LIDAR, BoxRows, NuScenesScene, SensorRows, read_scene

BRIGHT = 255.0
"""The layout's intensities are from 0 to this."""
BEAM_SWEEPS = 4
TURN_S = 0.05
LONGEST_TURN_S = 0.06
OWN_ROWS = {"CAM_BACK": 80}
"""Rows at the bottom of an image of 900 that show the vehicle."""
IMAGE_ROWS = 900


class NuscenesLog(FileLog):
    """A scene of nuScenes; see `unisim_blender.core.data.log.Log`."""

    classes = NUSCENES

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        scene = read_scene(path)
        sweeps, self._samples = scene.sensors[LIDAR], scene.samples
        self._setup = _setup_of(scene)
        self._stated: LidarSetup | None = None if self._setup is None else self._setup.lidars.get(LIDAR)
        self._rings = RINGS if self._stated is None else self._stated.model.beams
        self._origin_us = int(sweeps.stamps_us[0])
        origin = scene.poses[int(np.abs(scene.pose_stamps_us - self._origin_us).argmin()), :3, 3].copy()
        ego = self._trajectory(scene, origin)
        numbers = range(len(sweeps.files)) if self._setup is None else self._setup.frames
        times = {frame: self._seconds(stamp) for frame, stamp in zip(numbers, sweeps.stamps_us.tolist(), strict=True)}
        self._sweeps = {
            frame: file for frame, file, there in zip(numbers, sweeps.files, sweeps.there, strict=True) if there
        }
        self._images: dict[str, dict[int, Path]] = {}
        self._intensities = Intensities(LIDAR, BRIGHT, self._bright, self.notes)
        lidar = self._lidar(sweeps, ego, times)
        cameras = {
            name: self._camera(name, rows, ego, times)
            for name, rows in scene.sensors.items()
            if rows.intrinsics is not None and any(rows.there)
        }
        self.drive = Drive(
            name=scene.name if self._setup is None else self._setup.name,
            frames=tuple(times),
            time_s=times,
            world_from_ego=ego,
            cameras=cameras,
            lidars={} if lidar is None else {LIDAR: lidar},
            actors=actors_of_boxes(scene.tables / "sample_annotation.json", self._tracked(scene.boxes, origin, lidar)),
            world_origin=origin,
        )
        self.missing = tuple(_what_is_missing(scene))

    @property
    def files(self) -> tuple[Path, ...]:
        """The files of images and sweeps; see `LogExtras`."""
        return (*(path for of_camera in self._images.values() for path in of_camera.values()), *self._sweeps.values())

    def own_vehicle_mask(self, camera: str) -> NDArray[np.bool_] | None:
        """Where an image shows the vehicle (H, W); None where it does not."""
        if camera not in OWN_ROWS or camera not in self.drive.cameras or self._setup is not None:
            return None
        model = self.drive.cameras[camera].model
        mask = np.zeros((model.height, model.width), np.bool_)
        mask[model.height - round(OWN_ROWS[camera] * model.height / IMAGE_ROWS) :] = True
        return mask

    def _size_stated(self, camera: str) -> str:
        return "its table says"

    def sweep(self, lidar: str, frame: int) -> Sweep:
        """The recorded returns, less those of the vehicle's own roof, and the firings that did not return.

        Each ray's origin is the file's own; a drop's direction is the beam table's, turned as this sweep's columns are.
        """
        columns, time_s = self._read(lidar, frame)
        sensor = self.drive.lidars[lidar]
        end_s = self.drive.time_s[frame]
        end = sensor.world_from_lidar.at(end_s)
        origins = columns.origins @ end[:3, :3].T + end[:3, 3]
        ring, column = np.nonzero(~columns.dropped & ~columns.own)
        return Sweep(
            points=columns.points[ring, column] @ end[:3, :3].T + end[:3, 3],
            origins=origins[column],
            time_s=time_s[column],
            intensity=self._intensities.scaled(columns.intensity[ring, column], str(self._sweeps[frame])),
            ring=ring.astype(np.int32),
            column=column.astype(np.int32),
            semantic=np.full(len(ring), -1, np.int32),
            drops=self._drops(columns, time_s, origins, sensor, end_s),
        )

    def _bright(self) -> list[NDArray[np.float32]]:
        return [
            read_columns(self._sweeps[frame], rings=self._rings).intensity.ravel() for frame in spread(self._sweeps)
        ]

    def _read(self, lidar: str, frame: int) -> tuple[SweepColumns, FloatArray]:
        """A sweep's columns and their times."""
        path = self._sweep_place(lidar, frame)
        sensor = self.drive.lidars[lidar]
        columns, time_s = self._columns(path, sensor.world_from_lidar, self.drive.time_s[frame], sensor.model.sweep_s)
        if columns.count > sensor.model.columns:
            raise LogError(f"{path}: has {columns.count} columns, the scene's longest sweep had {sensor.model.columns}")
        return columns, time_s

    def _drops(
        self, columns: SweepColumns, time_s: FloatArray, origins: FloatArray, sensor: Lidar, end_s: float
    ) -> Drops:
        model = sensor.model
        if self._stated is None:
            azimuths = column_azimuths(columns, undone(columns, time_s, end_s, sensor.world_from_lidar), model)
        else:
            azimuths = stated.column_azimuths(sensor.model_at(end_s))
        ring, column = np.nonzero(columns.dropped)
        azimuth = azimuths[column] + model.azimuth_offset_rad[ring]
        elevation = model.elevation_rad[ring]
        local = np.stack(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1
        )
        poses = sensor.world_from_lidar.at(time_s[column])
        return Drops(
            origins=origins[column],
            directions=np.einsum("nij,nj->ni", poses[:, :3, :3], local),
            time_s=time_s[column],
            ring=ring.astype(np.int32),
            column=column.astype(np.int32),
        )

    def _columns(self, path: Path, track: Trajectory, end_s: float, turn_s: float) -> tuple[SweepColumns, FloatArray]:
        """A file's columns, and their times, of the sweep that ends at ``end_s``."""
        count = count_columns(path, self._rings)
        if self._stated is None:
            time_s = column_times(count, end_s, turn_s)
        else:
            model = self._stated.model
            if count != model.columns:
                raise LogError(f"{path}: has {count} columns, the LiDAR's beam table {model.columns}")
            time_s = stated.column_times(Lidar(LIDAR, model, track, {}), end_s)
        end = track.at(end_s)
        expected = (track.positions_at(time_s) - end[:3, 3]) @ end[:3, :3]
        return read_columns(path, expected, self._rings), time_s

    def _seconds(self, stamp_us: int) -> float:
        return (int(stamp_us) - self._origin_us) * 1e-6

    def _trajectory(self, scene: NuScenesScene, origin: FloatArray) -> Trajectory:
        poses = scene.poses.copy()
        poses[:, :3, 3] -= origin
        times = (scene.pose_stamps_us - self._origin_us) * 1e-6
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                return Trajectory.from_poses(times, poses)
        except TrajectoryError as error:
            raise LogError(f"{scene.tables / 'ego_pose.json'}: the vehicle's trajectory: {error}") from error

    def _lidar(self, rows: SensorRows, ego: Trajectory, times: dict[int, float]) -> Lidar | None:
        if not self._sweeps:
            return None
        mount = rows.ego_from_sensor.copy()
        mount[:3, :3] = mount[:3, :3] @ OWN_FROM_DATASETS.T
        track = ego.transformed(right=mount)
        if self._stated is not None:
            return Lidar(LIDAR, self._stated.model, track, dict(times), phase=self._stated.phase)
        steps = np.diff(list(times.values()))
        usual = steps[steps < LONGEST_TURN_S]
        turn_s = float(np.median(usual)) if len(usual) else TURN_S
        count = max(count_columns(path) for path in self._sweeps.values())
        chosen = sorted(self._sweeps)
        shown = []
        for frame in {chosen[at] for at in np.linspace(0, len(chosen) - 1, BEAM_SWEEPS).round().astype(int)}:
            columns, time_s = self._columns(self._sweeps[frame], track, times[frame], turn_s)
            shown.append((columns, undone(columns, time_s, times[frame], track)))
        return Lidar(LIDAR, find_beams(shown, count, turn_s), track, dict(times))

    def _camera(self, name: str, rows: SensorRows, ego: Trajectory, times: dict[int, float]) -> Camera:
        assert rows.intrinsics is not None
        stamps = [self._seconds(stamp) for stamp in rows.stamps_us.tolist()]
        numbers = number_captures(times, stamps)
        at = {stamp: index for index, stamp in enumerate(stamps)}
        there = {number: at[stamp] for number, stamp in numbers.items() if rows.there[at[stamp]]}
        self._images[name] = {number: rows.files[index] for number, index in there.items()}
        k = rows.intrinsics
        # the matrix counts pixels from the first one's centre
        shutter = RollingShutter() if self._setup is None else self._setup.shutters.get(name, RollingShutter())
        model = CameraModel(rows.width, rows.height, k[0, 0], k[1, 1], k[0, 2] + 0.5, k[1, 2] + 0.5, shutter)
        return Camera(name, model, ego.transformed(right=rows.ego_from_sensor), numbers)

    def _tracked(self, boxes: BoxRows, origin: FloatArray, lidar: Lidar | None) -> TrackedBoxes:
        """Return boxes, each keyed when the beams of its key frame's sweep passed it."""
        poses = np.array(boxes.pose).reshape(-1, 4, 4)
        poses[:, :3, 3] -= origin
        frame_times = np.array([self._seconds(stamp) for stamp in boxes.stamp_us])
        keys = frame_times if lidar is None else passing_times(lidar, poses[:, :3, 3], frame_times)
        sizes, score = np.array(boxes.size_m).reshape(-1, 3), np.array(boxes.score) if boxes.score else None
        return TrackedBoxes(np.array(boxes.uid), np.array(boxes.label), frame_times, poses, sizes, keys, score)

    def boxes_of(self, path: Path) -> TrackedBoxes:
        """Return the boxes of a file with results of the detection or tracking benchmark. Raises `LogError`."""
        return self._tracked(read_results(path, self._samples), self.drive.world_origin, self.drive.lidars.get(LIDAR))


def _setup_of(scene: NuScenesScene) -> LogSetup | None:
    """Return the setup that this program wrote beside the tables of the scene; None where it is another's. Raises
    `LogError`."""
    root = scene.tables.parent
    setup = read_setup(root)
    # a drive's scene may have a name that splits list
    if setup is None or setup.name not in (scene.name, scene.description):
        return None
    sweeps = scene.sensors[LIDAR]
    if len(setup.frames) != len(sweeps.files) or not setup.lidars.get(LIDAR):
        raise LogError(
            f"{setup_path(root)}: names {len(setup.frames)} frames of {LIDAR}, the tables {len(sweeps.files)} sweeps"
        )
    if not setup.lidars[LIDAR].model.beams:
        raise LogError(f"{setup_path(root)}: {LIDAR} has no beams")
    return setup


def _what_is_missing(scene: NuScenesScene) -> list[str]:
    said = []
    for name, rows in scene.sensors.items():
        absent = [file for file, there in zip(rows.files, rows.there, strict=True) if not there]
        if absent:
            what = "images" if rows.intrinsics is not None else "sweeps"
            said.append(f"{name}: {len(absent)} of {len(rows.files)} {what} are missing, {absent[0].name} the first")
    if not scene.boxes.uid:
        said.append(f"{scene.tables / 'sample_annotation.json'}: no boxes of {scene.name}")
    return said
