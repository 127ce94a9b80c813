"""The procedural street as Waymo Open's perception dataset v2 would have recorded it: Parquet components with range images and
pose images, column shutters and distorted lenses, written without any code of the reader's."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation
from street_pictures import LOOKS, camera_on, street_picture
from street_rays import street_distances

from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.world.drive import Camera, CameraModel, RollingShutter
from unisim_street.street import Street, build_street

FloatArray = NDArray[np.float64]
START_US = 1_553_629_304_740_123
SEGMENT = "segment-1000_0_1020_0"
TURNS_US = (100_080, 99_950, 100_010, 100_000)
ROWS, COLUMNS = 24, 220
GLOBAL = np.array([1321.5, -672.25, 31.0])
VEHICLE_PLACE = np.array([-1.4, 0.0, 0.1])
"""The dataset's vehicle frame in the street's."""
TYPES = {"Car": 1, "Pickup Truck": 1, "Medium-sized Truck": 1, "Cones": 3}
MOUNT = Rotation.from_euler("xyz", [0.004, -0.006, 2.58])
MOUNT_PLACE = np.array([1.43, 0.0, 2.184])
INCLINATIONS = np.sort(np.radians(np.concatenate([np.linspace(2.4, -5, 14), np.linspace(-5.8, -17.5, 10)])))


@dataclass
class Lens:
    """A camera: number, mount (x forward, y left, z up), image, when it is triggered after the frame's timestamp, read-out."""

    number: int
    turned: Rotation
    place: FloatArray
    width: int
    height: int
    focal: tuple[float, float]
    centre: tuple[float, float]
    bends: tuple[float, float, float, float, float]
    trigger_s: float
    direction: int = 2
    shutter_s: float = 0.003
    read_out_s: float = 0.047


CAMERAS = (
    Lens(1, Rotation.from_euler("xyz", [0.01, 0.02, -0.01]), np.array([1.54, -0.02, 2.11]), 48, 32, (51.0, 51.5), (23.8, 16.4),
         (0.04, -0.33, 0.0012, -0.0004, 0.02), 0.027),
    Lens(4, Rotation.from_euler("xyz", [-0.01, 0.0, 1.58]), np.array([1.43, 0.12, 2.11]), 48, 22, (50.0, 50.0), (24.5, 10.0),
         (0.03, -0.30, -0.001, 0.0002, 0.0), 0.0015),
)  # fmt: skip


@dataclass
class Turn:
    """What the top LiDAR truly measured in a turn: rays (H, W, 3), times (H, W), distances (H, W), inf for drops."""

    origins: FloatArray
    directions: FloatArray
    time_s: FloatArray
    distance: FloatArray


class WaymoStreet:
    """A street with its drive; ``write`` makes a segment of it. ``enlarged``: how many times as wide and high images are; those
    of size 1 show nothing."""

    def __init__(self, frames: int = 4, enlarged: int = 1) -> None:
        self.enlarged = enlarged
        self.cameras = tuple(
            replace(
                lens,
                width=enlarged * lens.width,
                height=enlarged * lens.height,
                focal=(enlarged * lens.focal[0], enlarged * lens.focal[1]),
                centre=(enlarged * lens.centre[0], enlarged * lens.centre[1]),
            )
            for lens in CAMERAS
        )
        self.street: Street = build_street(seed=7, frames=7, width=64, height=48)
        self.stamps_us = [START_US + sum(TURNS_US[:n]) for n in range(frames)]

    def vehicle(self, time_s: Any) -> tuple[Rotation, FloatArray]:
        """The dataset's vehicle frame in the drive's world, rotations and places (N, 3), at seconds from the first frame."""
        poses = self.street.drive.world_from_ego.at(np.asarray(time_s, np.float64))
        turned = Rotation.from_matrix(poses[..., :3, :3])
        return turned, poses[..., :3, 3] + turned.apply(VEHICLE_PLACE)

    def seconds(self, frame: int) -> float:
        """A frame's timestamp, from the first."""
        return (self.stamps_us[frame] - START_US) / 1e6

    def azimuth(self) -> FloatArray:
        """Where columns look in the LiDAR's frame: the first one to the vehicle's rear, then clockwise."""
        yaw = MOUNT.as_euler("ZYX")[0]
        return np.asarray(np.pi - 2 * np.pi * (np.arange(COLUMNS) + 0.5) / COLUMNS - yaw)

    def column_times(self, frame: int) -> FloatArray:
        """When columns are fired."""
        return self.seconds(frame) + TURNS_US[frame] / 1e6 * (np.arange(COLUMNS) + 0.5) / COLUMNS

    def measure(self, frame: int) -> Turn:
        """Fire all beams of a turn."""
        rise = INCLINATIONS[::-1][:, None]
        azimuth = np.broadcast_to(self.azimuth(), (ROWS, COLUMNS))
        local = np.stack(
            [np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth), np.sin(rise) + 0 * azimuth], -1
        )
        times = np.broadcast_to(self.column_times(frame), (ROWS, COLUMNS))
        turned, place = self.vehicle(times.ravel())
        directions = (turned * MOUNT).apply(local.reshape(-1, 3)).reshape(local.shape)
        origins = (place + turned.apply(MOUNT_PLACE)).reshape(local.shape)
        distance = street_distances(self.street, origins, directions, np.ascontiguousarray(times))
        return Turn(origins, directions, times, np.where((distance > 2) & (distance < 75), distance, np.inf))

    def second(self, frame: int, turn: Turn) -> tuple[NDArray[np.bool_], FloatArray, FloatArray]:
        """Cells with a second return, and the intensities of both: every other second one is the stronger."""
        cells = np.isfinite(turn.distance) & (np.arange(COLUMNS) % 7 == 0)
        first = np.where(
            np.isfinite(turn.distance), 0.2 + 0.01 * np.arange(ROWS)[:, None], -1.0
        ) + 0 * turn.distance.clip(0, 1)
        stronger = (np.arange(ROWS)[:, None] + frame) % 2 == 0
        return cells, first, np.where(cells, np.where(stronger, 1.8, 0.05), -1.0)

    def passing_s(self, point: FloatArray, frame: int) -> float:
        """When the beams passed a point of the world in a turn."""
        part = np.linspace(0, 1, 4001)[:-1]
        times = self.seconds(frame) + TURNS_US[frame] / 1e6 * part
        turned, place = self.vehicle(times)
        seen = (turned * MOUNT).inv().apply(point - place - turned.apply(MOUNT_PLACE))
        looks = np.pi - 2 * np.pi * part - MOUNT.as_euler("ZYX")[0]
        return float(times[np.abs(np.angle(np.exp(1j * (np.arctan2(seen[:, 1], seen[:, 0]) - looks)))).argmin()])

    def shutter(self, camera: Lens, frame: int) -> tuple[float, float]:
        """The middles of exposure of the first and the last column."""
        trigger = self.seconds(frame) + camera.trigger_s
        return trigger + camera.shutter_s / 2, trigger + camera.read_out_s - camera.shutter_s / 2

    def camera(self, lens: Lens) -> Camera:
        """A camera in the drive's world; its images by frame, at the middle of the exposure."""
        times = np.arange(-0.05, self.seconds(len(self.stamps_us) - 1) + 0.15, 0.001)
        turned, place = self.vehicle(times)
        shots = {frame: self.shutter(lens, frame) for frame in range(len(self.stamps_us))}
        # columns are read from the right where the direction is 4
        (start, end), reverse = shots[0], lens.direction == 4
        shutter = RollingShutter.of_exposure(start, end, (start + end) / 2, "columns", reverse)
        bends = OpenCVPinhole(**dict(zip(("k1", "k2", "p1", "p2", "k3"), lens.bends, strict=True)))
        model = CameraModel(lens.width, lens.height, *lens.focal, *lens.centre, shutter, bends)
        shot_s = {frame: sum(shot) / 2 for frame, shot in shots.items()}
        place = place + turned.apply(lens.place)
        return camera_on(f"camera {lens.number}", model, times, turned * lens.turned * LOOKS, place, shot_s)

    def write(self, root: Path) -> None:
        """Write the components of the segment."""
        frames = range(len(self.stamps_us))
        turned, place = self.vehicle([self.seconds(frame) + 0.05 for frame in frames])
        self._put(root, "vehicle_pose", [
            {"key.frame_timestamp_micros": self.stamps_us[frame],
             "[VehiclePoseComponent].world_from_vehicle.transform": _matrix(turned[frame], place[frame] + GLOBAL)}
            for frame in frames
        ])  # fmt: skip
        self._write_cameras(root)
        self._write_lidar(root)
        self._write_boxes(root)

    def _write_cameras(self, root: Path) -> None:
        part = "[CameraCalibrationComponent]."
        self._put(root, "camera_calibration", [
            {"key.camera_name": np.int8(camera.number),
             **{f"{part}intrinsic.{name}": value for name, value in zip(
                 ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3"),
                 (*camera.focal, *camera.centre, *camera.bends), strict=True)},
             f"{part}extrinsic.transform": _matrix(camera.turned, camera.place),
             f"{part}width": np.int32(camera.width), f"{part}height": np.int32(camera.height),
             f"{part}rolling_shutter_direction": np.int8(camera.direction)}
            for camera in self.cameras
        ])  # fmt: skip
        part, rows = "[CameraImageComponent].", []
        for frame, stamp in enumerate(self.stamps_us):
            for camera in self.cameras:
                trigger = self.seconds(frame) + camera.trigger_s
                turned, place = self.vehicle([trigger + 0.025])
                buffer = io.BytesIO()
                image = Image.new("RGB", (camera.width, camera.height), (40 * frame, 30 * camera.number, 9))
                if self.enlarged > 1:
                    image = Image.fromarray(street_picture(self.street, self.camera(camera), frame))
                image.save(buffer, "JPEG", quality=95)
                unix = START_US / 1e6
                rows.append({
                    "key.frame_timestamp_micros": stamp, "key.camera_name": np.int8(camera.number),
                    f"{part}image": buffer.getvalue(),
                    f"{part}pose.transform": _matrix(turned[0], place[0] + GLOBAL),
                    f"{part}pose_timestamp": unix + trigger + 0.025,
                    f"{part}rolling_shutter_params.shutter": camera.shutter_s,
                    f"{part}rolling_shutter_params.camera_trigger_time": unix + trigger,
                    f"{part}rolling_shutter_params.camera_readout_done_time": unix + trigger + camera.read_out_s,
                })  # fmt: skip
        self._put(root, "camera_image", rows[::-1])

    def _write_lidar(self, root: Path) -> None:
        part = "[LiDARCalibrationComponent]."
        other = {
            f"{part}beam_inclination.values": None,
            f"{part}beam_inclination.min": -1.5,
            f"{part}beam_inclination.max": 0.5,
        }
        self._put(root, "lidar_calibration", [
            {"key.laser_name": np.int8(2), f"{part}extrinsic.transform": _matrix(Rotation.identity(), MOUNT_PLACE), **other},
            {"key.laser_name": np.int8(1), f"{part}extrinsic.transform": _matrix(MOUNT, MOUNT_PLACE),
             f"{part}beam_inclination.values": INCLINATIONS.tolist(),
             f"{part}beam_inclination.min": -0.31, f"{part}beam_inclination.max": 0.05},
        ])  # fmt: skip
        ranges, poses = [], []
        for frame, stamp in enumerate(self.stamps_us):
            turn = self.measure(frame)
            cells, first, second = self.second(frame, turn)
            back = np.isfinite(turn.distance)
            image = np.zeros((2, ROWS, COLUMNS, 4), np.float32)
            image[0, ..., 0], image[1, ..., 0] = (
                np.where(back, turn.distance, -1),
                np.where(cells, turn.distance + 1.5, -1),
            )
            image[0, ..., 1], image[1, ..., 1] = first, second
            turned, place = self.vehicle(turn.time_s.ravel())
            pose = (
                np.concatenate([turned.as_euler("xyz"), place + GLOBAL], 1).reshape(ROWS, COLUMNS, 6).astype(np.float32)
            )
            pose[~back] = 0
            for number in (3, 1):
                values = [part.ravel() if number == 1 else np.ones(8, np.float32) for part in image]
                shape = [ROWS, COLUMNS, 4] if number == 1 else [1, 2, 4]
                key = {"key.frame_timestamp_micros": stamp, "key.laser_name": np.int8(number)}
                ranges.append(key | {
                    f"[LiDARComponent].range_image_return{n + 1}.{name}": what
                    for n in (0, 1) for name, what in (("values", values[n]), ("shape", np.array(shape, np.int32)))
                })  # fmt: skip
                if number == 1:
                    poses.append(key | {
                        "[LiDARPoseComponent].range_image_return1.values": pose.ravel(),
                        "[LiDARPoseComponent].range_image_return1.shape": np.array([ROWS, COLUMNS, 6], np.int32),
                    })  # fmt: skip
        self._put(root, "lidar", ranges)
        self._put(root, "lidar_pose", poses[::-1])

    def _write_boxes(self, root: Path) -> None:
        rows = []
        for frame, stamp in enumerate(self.stamps_us):
            turned, place = self.vehicle([self.seconds(frame) + 0.05])
            for actor in self.street.drive.actors.values():
                then = self.passing_s(actor.world_from_actor.at(self.seconds(frame) + 0.05)[:3, 3], frame)
                pose = actor.world_from_actor.at(then)
                centre = turned[0].inv().apply(pose[:3, 3] - place[0])
                ahead = turned[0].inv().apply(pose[:3, 0])
                rows.append({
                    "key.frame_timestamp_micros": stamp, "key.laser_object_id": actor.uid,
                    **{f"[LiDARBoxComponent].box.center.{axis}": float(centre[i]) for i, axis in enumerate("xyz")},
                    **{f"[LiDARBoxComponent].box.size.{axis}": float(actor.size_m[i]) for i, axis in enumerate("xyz")},
                    "[LiDARBoxComponent].box.heading": float(np.arctan2(ahead[1], ahead[0])),
                    "[LiDARBoxComponent].type": np.int8(TYPES[actor.label]),
                })  # fmt: skip
        self._put(root, "lidar_box", rows)

    @staticmethod
    def _put(root: Path, component: str, rows: list[dict[str, Any]]) -> None:
        write_parquet(root / component / f"{SEGMENT}.parquet", {key: [row[key] for row in rows] for key in rows[0]})


def _matrix(turned: Rotation, place: FloatArray) -> list[float]:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turned.as_matrix(), place
    return [float(value) for value in matrix.ravel()]


def write_parquet(path: Path, columns: dict[str, Any]) -> None:
    """Write columns as the dataset's files have them, of its own types (v2/perception), with several groups of rows."""
    import pyarrow
    from pyarrow import parquet

    kinds = {
        ".transform": pyarrow.list_(pyarrow.float64(), 16),
        ".shape": pyarrow.list_(pyarrow.int32(), 3),
        "inclination.values": pyarrow.list_(pyarrow.float64()),
        "1.values": pyarrow.list_(pyarrow.float32()),
        "2.values": pyarrow.list_(pyarrow.float32()),
    }

    def typed(name: str, values: Any) -> Any:
        return pyarrow.array(values, next((kind for end, kind in kinds.items() if name.endswith(end)), None))

    path.parent.mkdir(parents=True, exist_ok=True)
    table = pyarrow.table({name: typed(name, values) for name, values in columns.items()})
    parquet.write_table(
        table.append_column("key.segment_context_name", [[SEGMENT] * len(table)]), str(path), row_group_size=3
    )
