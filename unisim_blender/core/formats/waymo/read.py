"""Reader of Waymo Open's perception dataset v2 (Sun et al., "Scalability in Perception for Autonomous Driving", CVPR 2020).

Written from what is documented and was measured by others. It was tried on a layout that tests write, on no real segment.

A box is given in the vehicle's frame of its frame's pose, upright. Moving objects' returns are where the top LiDAR's beams passed
them, and so is the box. A camera's frame is x forward, y left, z up; ours is OpenCV's. Pixel (0, 0) begins at the image's
corner, as ours does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...data.log import Sweep, SweepGrid
from ...data.sweep_cells import make_grid
from ...data.values import check_angles
from ...errors import LogError
from ...geometry import FloatArray, Trajectory, TrajectoryError, make_pose, quaternion_from_yaw
from ...lenses import PINHOLE
from ...lenses.lens import Lens, LensError
from ...lenses.opencv_pinhole import OpenCVPinhole
from ...world.box_tracks import TrackedBoxes, actors_of_boxes, passing_times
from ...world.drive import Actor, Camera, CameraModel, Drive, Lidar, Readouts, RollingShutter
from ..common.arrow import Kind, read_row, stacked
from ..common.file_log import FileLog, absent_frames, cached_image
from . import range_images
from .segment import CAMERA, FRAME, LASER, Segment, check_places, rows_of

CALIBRATION, IMAGES = "camera_calibration", "camera_image"
NAMES = {1: "front", 2: "front_left", 3: "front_right", 4: "side_left", 5: "side_right"}
JPEG = "[CameraImageComponent].image"
VEHICLE_FROM_OPENCV = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""OpenCV's axes in the camera's own."""
READ_OUT = {0: ("rows", False), 1: ("rows", False), 2: ("columns", False), 3: ("rows", True), 4: ("columns", True)}
"""Which lines a shutter reads and whether from the last: top to bottom, left to right, and their opposites. Number 5, and an
unknown direction (0), count as a global shutter."""
MAX_SIDE = 1 << 15
MOST_EXPOSURE_S = 0.2
SAME_S = 1e-6
"""Exposures that differ by less are equally long."""


@dataclass(frozen=True)
class WaymoCalibration:
    """A camera's model, without a shutter's times; its mount (4, 4), OpenCV's axes in the vehicle's; its read-out's number."""

    model: CameraModel
    mount: FloatArray
    read_out: int


@dataclass(frozen=True)
class ImageRows:
    """The rows of `IMAGES`: camera (N,) numbers, stamp_us (N,) of their frames, and in Unix seconds: when the vehicle was at
    pose (N, 4, 4), and the middles of exposure of the first and the last line to be read."""

    camera: NDArray[np.int64]
    stamp_us: NDArray[np.int64]
    pose: FloatArray
    pose_s: FloatArray
    first_s: FloatArray
    last_s: FloatArray


def read_calibrations(segment: Segment) -> dict[int, WaymoCalibration]:
    """Return the cameras by their numbers. Raises `LogError`."""
    part, path = "[CameraCalibrationComponent].", segment.file(CALIBRATION)
    pixels, bends = ("f_u", "f_v", "c_u", "c_v"), ("k1", "k2", "p1", "p2", "k3")
    columns: dict[str, Kind] = {
        **dict.fromkeys((CAMERA, part + "width", part + "height", part + "rolling_shutter_direction"), "whole"),
        **dict.fromkeys((f"{part}intrinsic.{name}" for name in pixels + bends), "number"),
        part + "extrinsic.transform": "pose",
    }
    table = segment.read(CALIBRATION, columns)
    calibrations: dict[int, WaymoCalibration] = {}
    for row, number in enumerate(table[CAMERA].tolist()):
        if number in calibrations or number not in NAMES:
            raise LogError(
                f"{path}: camera {number} {'stands there twice' if number in calibrations else 'is none of 1 to 5'}"
            )
        width, height = int(table[part + "width"][row]), int(table[part + "height"][row])
        fx, fy, cx, cy = (float(table[f"{part}intrinsic.{name}"][row]) for name in pixels)
        if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE and fx > 0 and fy > 0):
            raise LogError(f"{path}: camera {number} has {width}x{height} pixels and focal lengths {fx}, {fy}")
        try:
            lens: Lens = OpenCVPinhole(**{name: float(table[f"{part}intrinsic.{name}"][row]) for name in bends})
        except LensError as error:
            raise LogError(f"{path}: camera {number}: {error}") from error
        model = CameraModel(width, height, fx, fy, cx, cy, lens=PINHOLE if lens == OpenCVPinhole() else lens)
        mount = table[part + "extrinsic.transform"][row] @ VEHICLE_FROM_OPENCV
        calibrations[number] = WaymoCalibration(model, mount, int(table[part + "rolling_shutter_direction"][row]))
    return calibrations


def read_images(segment: Segment) -> ImageRows:
    """Return what is known of all images, without the images. Raises `LogError`."""
    part, path = "[CameraImageComponent].", segment.file(IMAGES)
    shutter, trigger, done = (
        f"{part}rolling_shutter_params.{name}"
        for name in ("shutter", "camera_trigger_time", "camera_readout_done_time")
    )
    columns: dict[str, Kind] = {
        **dict.fromkeys((FRAME, CAMERA), "whole"),
        part + "pose.transform": "pose",
        **dict.fromkeys((part + "pose_timestamp", shutter, trigger, done), "number"),
    }
    table = segment.read(IMAGES, columns)
    first, last = table[trigger] + table[shutter] / 2, table[done] - table[shutter] / 2
    wrong = (last < first) | (last - first > MOST_EXPOSURE_S) | (table[shutter] < 0)
    if wrong.any():
        row = int(wrong.argmax())
        raise LogError(
            f"{path}: row {row} is triggered at {table[trigger][row]} s and read out at {table[done][row]} s, "
            f"exposed for {table[shutter][row]} s"
        )
    check_places(path, table[part + "pose.transform"])
    return ImageRows(
        table[CAMERA], table[FRAME], table[part + "pose.transform"], table[part + "pose_timestamp"], first, last
    )


def with_shutter(calibration: WaymoCalibration, exposure_s: float) -> CameraModel:
    """Return the model whose images are stamped with the middle of exposure, which takes ``exposure_s`` from line to line."""
    if calibration.read_out not in READ_OUT or calibration.read_out == 0:
        return calibration.model
    axis, reverse = READ_OUT[calibration.read_out]
    return replace(
        calibration.model,
        shutter=RollingShutter.of_exposure(-exposure_s / 2, exposure_s / 2, 0.0, axis=axis, reverse=reverse),
    )


def readouts_of(stamps_s: FloatArray, exposures_s: FloatArray, exposure_s: float) -> Readouts | None:
    """Return how images stamped ``stamps_s`` (K,) differ that take ``exposures_s`` (K,) in place of ``exposure_s``; None where
    that is less than a microsecond, or nothing."""
    if np.ptp(exposures_s) < SAME_S or (exposures_s <= 0).any():
        return None
    times, first = np.unique(stamps_s, return_index=True)
    return Readouts(times, exposures_s[first] / exposure_s)


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
        images = read_images(segment) if segment.has(IMAGES) else None
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
        path = self._segment.file(IMAGES)
        return cached_image("waymo", path, camera, f"{frame:06d}", lambda: self.encoded_image(camera, frame))

    def encoded_image(self, camera: str, frame: int) -> bytes:
        """The recorded image's JPEG as the table holds it."""
        row = self._image_place(camera, frame)
        path = self._segment.file(IMAGES)
        data = read_row(path, row, [JPEG])[JPEG].as_py()
        if not isinstance(data, bytes):
            raise LogError(f"{path}: row {row} holds no image")
        return data

    def _image_content(self, camera: str, frame: int) -> tuple[Path | bytes, str]:
        content = self.encoded_image(camera, frame)
        return content, f"{self._segment.file(IMAGES)}: the image in row {self._images[camera][frame]}"

    def _size_stated(self, camera: str) -> str:
        return f"the calibration gives {camera}"

    def sweep(self, lidar: str, frame: int) -> Sweep:
        """The recorded returns and drops, less those of the vehicle's own body."""
        row, pose_row = self._sweep_place(lidar, frame)
        ours = self.drive.lidars[lidar]
        time_s, turn_s = self.drive.time_s[frame], self._turn_s[frame]
        return range_images.read_sweep(self._segment, row, pose_row, ours, self._mount, time_s, turn_s, self._origin)

    def sweep_grid(self, lidar: str, frame: int) -> SweepGrid:
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
        path = self._segment.file(IMAGES if images is not None else "vehicle_pose")
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
        rows = [0]
        for row in range(1, len(seconds)):
            if seconds[row] - seconds[rows[-1]] >= LEAST_STEP_S:
                rows.append(row)
        try:
            track = Trajectory.from_poses(seconds[rows], poses[rows])
            origin = track.positions_at(0.0)
            return Trajectory(track.times_s, track.positions - origin, track.quaternions_wxyz), origin
        except TrajectoryError as error:
            raise LogError(f"{path}: {error}") from error

    def _find_cameras(
        self, images: ImageRows | None, ego: Trajectory, time_s: dict[int, float], missing: list[str]
    ) -> dict[str, Camera]:
        if images is None or not self._segment.has(CALIBRATION):
            lacking = IMAGES if images is None else CALIBRATION
            missing.append(f"cameras: there is no {lacking}")
            return {}
        cameras = {}
        for number, calibration in sorted(read_calibrations(self._segment).items()):
            name = NAMES[number]
            rows = rows_of(self._segment.file(IMAGES), images.stamp_us, images.camera, number)
            strange = next((stamp for stamp in rows if stamp not in self._frame_of), None)
            if strange is not None:
                path = self._segment.file(IMAGES)
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
            model: CameraModel = with_shutter(calibration, exposure)
            stamps = dict(zip(sorted(of_frame), middles.tolist(), strict=True))
            readouts = readouts_of(middles, images.last_s[chosen] - images.first_s[chosen], exposure)
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
