"""Reader of Waymo Open's perception dataset v2 (Sun et al., "Scalability in Perception for Autonomous Driving", CVPR 2020).

Written from what is documented and was measured by others. It was tried on a layout that tests write, on no real segment.

A box is given in the vehicle's frame of its frame's pose, upright. Moving objects' returns are where the top LiDAR's beams passed
them, and so is the box.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...data.log import Sweep, SweepGrid
from ...data.sweep_cells import make_grid
from ...data.values import check_angles
from ...errors import LogError
from ...geometry import FloatArray, Trajectory, TrajectoryError, make_pose, quaternion_from_yaw
from ...world.drive import Actor, Camera, CameraModel, Drive, Lidar
from ..common.arrow.columns import Kind, read_row, stacked
from ..common.box_tracks import TrackedBoxes, actors_of_boxes, passing_times
from ..common.file_log import FileLog, absent_frames, cached_image
from . import cameras as camera_files
from . import range_images
from .cameras import JPEG, NAMES, ImageRows
from .segment import FRAME, LASER, Segment, rows_of

BOXES = "lidar_box"
TYPES = ("TYPE_UNKNOWN", "TYPE_VEHICLE", "TYPE_PEDESTRIAN", "TYPE_SIGN", "TYPE_CYCLIST")

POSE_DELAY_S = 0.05
"""A frame's pose is the vehicle's so long after the frame's timestamp, in the middle of the turn."""


def read_actors(
    segment: Segment, time_s: dict[int, float], frame_poses: dict[int, FloatArray], lidar: Lidar | None
) -> dict[str, Actor]:
    """Return actors by the ids of the dataset. ``time_s``, ``frame_poses`` (4, 4): of frames by their timestamps; without a
    LiDAR, boxes are keyed in the middle of its turn, when the frame's pose is. Raises `LogError`."""
    path, part = segment.file(BOXES), "[LiDARBoxComponent]."
    uid, kind, heading = "key.laser_object_id", part + "type", part + "box.heading"
    centre, size = (tuple(f"{part}box.{what}.{axis}" for axis in "xyz") for what in ("center", "size"))
    columns: dict[str, Kind] = {FRAME: "whole", uid: "text", kind: "whole"}
    table = segment.read(BOXES, {**columns, **dict.fromkeys((heading, *centre, *size), "number")})
    order = np.argsort(table[FRAME], kind="stable")
    table = {name: values[order] for name, values in table.items()}
    for row, (stamp, number) in enumerate(zip(table[FRAME].tolist(), table[kind].tolist(), strict=True)):
        if stamp not in time_s:
            raise LogError(f"{path}: box {table[uid][row]} is in the frame {stamp}, which has no pose")
        if not 0 <= number < len(TYPES):
            raise LogError(f"{path}: box {table[uid][row]} has the type {number}")
    check_angles(path, "a box's heading", table[heading])
    sizes = stacked(table, size)
    flat = (sizes <= 0).any(1)
    if flat.any():
        row = int(flat.argmax())
        raise LogError(f"{path}: box {table[uid][row]} has the size {tuple(sizes[row].tolist())} m")
    stamps = table[FRAME].tolist()
    frame_times = np.array([time_s[stamp] for stamp in stamps])
    vehicle = np.array([frame_poses[stamp] for stamp in stamps]).reshape(-1, 4, 4)
    poses = vehicle @ make_pose(stacked(table, centre), quaternion_from_yaw(table[heading]))
    if not len(stamps):
        return {}
    keys = frame_times + POSE_DELAY_S if lidar is None else passing_times(lidar, poses[:, :3, 3], frame_times)
    labels = np.array([TYPES[number] for number in table[kind].tolist()], object)
    return actors_of_boxes(path, TrackedBoxes(table[uid], labels, frame_times, poses, sizes, keys))


USUAL_TURN_S = 0.1
LEAST_STEP_S = 1e-3
"""Poses closer together than this are one."""


class WaymoLog(FileLog):
    """A drive in Waymo Open's layout; see `unisim_blender.core.data.log.Log`. Images lie inside one file: they have no paths."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._segment = segment = Segment(path)
        stamps, frame_poses = segment.frame_poses()
        self._frame_of = {int(stamp): frame for frame, stamp in enumerate(stamps)}
        self._start_us = int(stamps[0])
        time_s = {frame: (int(stamp) - self._start_us) / 1e6 for frame, stamp in enumerate(stamps)}
        self._turn_s = self._turns(list(time_s.values()))
        missing: list[str] = []
        images = camera_files.read_images(segment) if segment.has(camera_files.IMAGES) else None
        ego, self._origin = self._find_ego(frame_poses, np.array(list(time_s.values())), images)
        self._images: dict[str, dict[int, int]] = {}
        cameras = self._find_cameras(images, ego, time_s, missing)
        self._sweeps: dict[int, tuple[int, int]] = {}
        lidar = self._find_lidar(ego, time_s, missing)
        actors = {}
        if segment.has(BOXES):
            shift = np.zeros((4, 4))
            shift[:3, 3] = self._origin
            by_stamp = {stamp: frame_poses[frame] - shift for stamp, frame in self._frame_of.items()}
            actors = read_actors(segment, {s: time_s[f] for s, f in self._frame_of.items()}, by_stamp, lidar)
        else:
            missing.append(f"{BOXES}: there are no boxes")
        self.drive = Drive(
            name=segment.name,
            frames=tuple(time_s),
            time_s=time_s,
            world_from_ego=ego,
            cameras=cameras,
            lidars={} if lidar is None else {lidar.sensor_id: lidar},
            actors=actors,
            world_origin=self._origin,
        )
        self.missing = tuple(missing)

    @property
    def files(self) -> tuple[Path, ...]:
        """The segment's files; see `LogExtras`."""
        return self._segment.files

    def image_path(self, camera: str, frame: int) -> Path | None:
        """A copy of the recorded image among the user's cached files, written when it is first asked for: images lie in a table.
        None where there is no image."""
        if frame not in self._images.get(camera, {}):
            return None
        path = self._segment.file(camera_files.IMAGES)
        return cached_image("waymo", path, camera, f"{frame:06d}", lambda: self.encoded_image(camera, frame))

    def encoded_image(self, camera: str, frame: int) -> bytes:
        """The recorded image's JPEG as the table holds it."""
        row = self._image_place(camera, frame)
        path = self._segment.file(camera_files.IMAGES)
        data = read_row(path, row, [JPEG])[JPEG].as_py()
        if not isinstance(data, bytes):
            raise LogError(f"{path}: row {row} holds no image")
        return data

    def _image_content(self, camera: str, frame: int) -> tuple[Path | bytes, str]:
        content = self.encoded_image(camera, frame)
        return content, f"{self._segment.file(camera_files.IMAGES)}: the image in row {self._images[camera][frame]}"

    def _size_stated(self, camera: str) -> str:
        return f"the calibration gives {camera}"

    def sweep(self, lidar: str, frame: int) -> Sweep:
        """The recorded returns and drops, less those of the vehicle's own body."""
        if lidar not in self.drive.lidars or frame not in self._sweeps:
            raise LogError(f"{self.path}: {lidar} has no sweep of frame {frame}")
        ours, (row, pose_row) = self.drive.lidars[lidar], self._sweeps[frame]
        time_s, turn_s = self.drive.time_s[frame], self._turn_s[frame]
        return range_images.read_sweep(self._segment, row, pose_row, ours, self._mount, time_s, turn_s, self._origin)

    def sweep_grid(self, lidar: str, frame: int) -> SweepGrid:
        """The recorded sweep as beams x columns, with drops."""
        sweep, ours = self.sweep(lidar, frame), self.drive.lidars[lidar]
        return make_grid(sweep, ours, frame, self._find_never_returned(lidar))

    @staticmethod
    def _turns(times_s: list[float]) -> dict[int, float]:
        """How long each sweep's turn takes: until the next frame's time, where that is no pause of several turns."""
        steps = np.diff(times_s)
        usual = float(np.median(steps)) if len(steps) else USUAL_TURN_S
        usual = usual if 0.5 * USUAL_TURN_S < usual < 2 * USUAL_TURN_S else USUAL_TURN_S
        near = [step if 0.8 * usual < step < 1.2 * usual else usual for step in steps.tolist()]
        return dict(enumerate([*near, usual]))

    def _find_ego(
        self, frame_poses: FloatArray, times_s: FloatArray, images: ImageRows | None
    ) -> tuple[Trajectory, FloatArray]:
        """The vehicle's trajectory by the drive's clock, and its origin: where it is at the first frame's time.

        The images' poses have times of their own. Without images there are the frames' poses, whose times are known to some
        milliseconds alone.
        """
        path = self._segment.file(camera_files.IMAGES if images is not None else "vehicle_pose")
        if images is not None and len(images.pose_s):
            # float64 Unix seconds keep a quarter of a microsecond
            order = np.argsort(images.pose_s, kind="stable")
            seconds, poses = (images.pose_s - self._start_us / 1e6)[order], images.pose[order]
            if seconds[0] > times_s[-1] or seconds[-1] < times_s[0]:
                raise LogError(
                    f"{path}: the poses' times, {seconds[0]:.3f} to {seconds[-1]:.3f} s, are not the frames'"
                )
        else:
            seconds, poses = times_s + POSE_DELAY_S, frame_poses
        kept = [0]
        for row in range(1, len(seconds)):
            if seconds[row] - seconds[kept[-1]] >= LEAST_STEP_S:
                kept.append(row)
        try:
            track = Trajectory.from_poses(seconds[kept], poses[kept])
            origin = track.positions_at(0.0)
            return Trajectory(track.times_s, track.positions - origin, track.quaternions_wxyz), origin
        except TrajectoryError as error:
            raise LogError(f"{path}: {error}") from error

    def _find_cameras(
        self, images: ImageRows | None, ego: Trajectory, time_s: dict[int, float], missing: list[str]
    ) -> dict[str, Camera]:
        if images is None or not self._segment.has(camera_files.CALIBRATION):
            lacking = camera_files.IMAGES if images is None else camera_files.CALIBRATION
            missing.append(f"cameras: there is no {lacking}")
            return {}
        cameras = {}
        for number, calibration in sorted(camera_files.read_calibrations(self._segment).items()):
            name = NAMES[number]
            rows = rows_of(self._segment.file(camera_files.IMAGES), images.stamp_us, images.camera, number)
            strange = next((stamp for stamp in rows if stamp not in self._frame_of), None)
            if strange is not None:
                path = self._segment.file(camera_files.IMAGES)
                raise LogError(f"{path}: {name} has an image of the frame {strange}, which has no pose")
            if not rows:
                missing.append(f"camera {name} has no images")
                continue
            of_frame = {self._frame_of[stamp]: row for stamp, row in rows.items()}
            self._images[name] = of_frame
            absent = absent_frames(time_s, of_frame)
            if absent:
                missing.append(f"camera {name}: no images of {absent}")
            chosen = np.array([of_frame[frame] for frame in sorted(of_frame)])
            exposure = float(np.median(images.last_s[chosen] - images.first_s[chosen]))
            middles = (images.first_s[chosen] + images.last_s[chosen]) / 2 - self._start_us / 1e6
            model: CameraModel = camera_files.with_shutter(calibration, exposure)
            stamps = dict(zip(sorted(of_frame), middles.tolist(), strict=True))
            readouts = camera_files.readouts_of(middles, images.last_s[chosen] - images.first_s[chosen], exposure)
            track = ego.transformed(right=calibration.mount)
            cameras[name] = Camera(name, model, track, stamps, readouts=readouts)
        return cameras

    def _find_lidar(self, ego: Trajectory, time_s: dict[int, float], missing: list[str]) -> Lidar | None:
        """The top LiDAR; None where a component of it is absent."""
        parts = (range_images.RANGES, range_images.POSES, range_images.CALIBRATION)
        lacking = [part for part in parts if not self._segment.has(part)]
        if lacking:
            missing.append(f"lidar {range_images.NAME}: there is no {' and no '.join(lacking)}")
            return None
        rows, pose_rows = (self._segment.rows(part, LASER, range_images.TOP) for part in parts[:2])
        both = [stamp for stamp in rows if stamp in pose_rows and stamp in self._frame_of]
        self._sweeps = {self._frame_of[stamp]: (rows[stamp], pose_rows[stamp]) for stamp in both}
        absent = absent_frames(time_s, self._sweeps)
        if absent:
            missing.append(f"lidar {range_images.NAME}: no sweeps{f' of {absent}' if self._sweeps else ''}")
        if not self._sweeps:
            return None
        beams, columns = range_images.image_shape(self._segment, self._sweeps[min(self._sweeps)][0])
        top = range_images.read_calibration(self._segment, beams)
        if top is None:
            missing.append(f"lidar {range_images.NAME}: {range_images.CALIBRATION} has no row of it")
            self._sweeps = {}
            return None
        self._mount = top.mount
        model = range_images.model_of(top, columns, float(np.median(list(self._turn_s.values()))))
        return Lidar(range_images.NAME, model, ego.transformed(right=top.mount), dict(time_s))
