"""The procedural street as KITTI would have recorded it: the dataset's axes, units, files and times, written without any code of
the reader's.

The LiDAR has two blocks of lasers above each other, and turns in either direction. Points are where they were in the sensor's
frame as each was fired, to the millimetre, ring by ring from the azimuth 0 on; nothing is written for a ray without a return.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation, Slerp
from street_pictures import camera_on, street_picture
from street_rays import street_distances

from unisim_blender.core.world.drive import Camera, CameraModel
from unisim_street.street import Street, build_street

FloatArray = NDArray[np.float64]
FRAMES = 6
PERIOD_S, TRIGGER_S = 0.1, 0.03
"""Each frame's trigger comes this long after the drive's own frame."""
COLUMNS = 900
ELEVATION_DEG = np.concatenate([np.linspace(2.0, -8.5, 16), np.linspace(-9.2, -24.5, 16)])
HEIGHT_M = np.concatenate([np.full(16, 0.21), np.full(16, 0.12)])
FARTHEST_M = 80.0
LIDAR_PLACE, LIDAR_YAW = np.array([0.7, 0.05, 1.6]), 0.01
"""Of the LiDAR in the IMU's frame, which is the street's ego frame here."""
CAMERA_PLACE = np.array([0.27, -0.01, -0.08])
"""Of the first camera in the LiDAR's frame."""
WIDTH, HEIGHT, FOCAL, CX, CY, BASELINE = 96, 32, 56.0, 47.2, 13.4, -0.06
CLOCK = np.datetime64("2011-09-26T13:02:25.967790592", "ns")
LATITUDE, LONGITUDE, ALTITUDE = 49.015003823272, 8.4342971002335, 116.43
EARTH_M = 6378137.0
LABELS = {"Car": "Car", "Pickup Truck": "Van", "Medium-sized Truck": "Truck", "Cones": "Misc"}
CAMERA_AXES = np.array([[0.0, -1, 0], [0, 0, -1], [1, 0, 0]])
"""The camera's axes in the LiDAR's."""


@dataclass(frozen=True)
class KittiRig:
    """What a drive was recorded with: frames, times, the LiDAR's reach and the camera's projection."""

    frames: int = FRAMES
    trigger_s: float = TRIGGER_S
    turn_s: float = PERIOD_S
    farthest_m: float = FARTHEST_M
    focal: float = FOCAL
    cx: float = CX
    cy: float = CY
    image_lag_s: float = 0.0104
    enlarged: int = 1
    """How many times as wide and high images are; those of size 1 show nothing."""

    def trigger(self, frame: int) -> float:
        """When the LiDAR looks forward, by the drive's clock."""
        return PERIOD_S * frame + self.trigger_s

    def projection(self, number: int) -> FloatArray:
        """P_rect of a camera: those with odd numbers stand to the right of the first."""
        shift = self.focal * (-0.54 if number % 2 else BASELINE)
        plain = np.array([[self.focal, 0, self.cx, shift], [0, self.focal, self.cy, 0.002], [0, 0, 1, 0.0003]])
        return np.asarray(plain * [[self.enlarged], [self.enlarged], [1]], np.float64)


@dataclass
class KittiStreet:
    """A street, the log's path, and what the layout was written from: of each frame's points, in the file's order, the world's
    place, the ray's origin and time, ring, and the share of the turn at which it was fired."""

    street: Street
    path: Path
    direction: int
    rig: KittiRig = KittiRig()
    points: dict[int, FloatArray] = field(default_factory=dict)
    origins: dict[int, FloatArray] = field(default_factory=dict)
    time_s: dict[int, FloatArray] = field(default_factory=dict)
    ring: dict[int, NDArray[np.int64]] = field(default_factory=dict)
    returned: dict[int, NDArray[np.bool_]] = field(default_factory=dict)
    boxes: dict[tuple[str, int], float] = field(default_factory=dict)
    """When the beams passed each actor in each frame."""

    def ego(self, time_s: FloatArray) -> tuple[Rotation, FloatArray]:
        """Rotation and place of the IMU in the drive's world."""
        track = self.street.drive.world_from_ego
        rotation = Rotation.from_quat(np.roll(track.quaternions_wxyz, -1, 1))
        inside = np.clip(time_s, track.times_s[0], track.times_s[-1])
        turned = Slerp(track.times_s, rotation)(inside)
        # the street's vehicle goes on straight beyond its first and last frame
        for ends, at in ((time_s < track.times_s[0], 0), (time_s > track.times_s[-1], len(rotation) - 2)):
            if ends.any():
                step = (rotation[at].inv() * rotation[at + 1]).as_rotvec()
                share = (time_s[ends] - track.times_s[at]) / (track.times_s[at + 1] - track.times_s[at])
                turned[ends] = rotation[at] * Rotation.from_rotvec(share[:, None] * step)
        return turned, track.positions_at(time_s)

    def lidar(self, time_s: FloatArray) -> tuple[Rotation, FloatArray]:
        """Rotation and place of the LiDAR in the drive's world."""
        turned, place = self.ego(time_s)
        return turned * Rotation.from_rotvec([0, 0, LIDAR_YAW]), place + turned.apply(LIDAR_PLACE)


def record(path: Path, direction: int, enlarged: int = 1) -> KittiStreet:
    """The street's sweeps as KITTI's files under ``path``, and what they were written from."""
    made = KittiStreet(build_street(seed=11, frames=FRAMES + 1), path, direction, KittiRig(enlarged=enlarged))
    azimuth = 2 * np.pi * (np.arange(COLUMNS) + 0.5) / COLUMNS  # counter-clockwise, from forward
    share = direction * (np.mod(azimuth + np.pi, 2 * np.pi) - np.pi) / (2 * np.pi)
    elevation = np.radians(ELEVATION_DEG)[:, None]
    local = np.stack(
        np.broadcast_arrays(
            np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)
        ),
        -1,
    )
    for frame in range(FRAMES):
        time = made.rig.trigger(frame) + PERIOD_S * share
        turned, place = made.lidar(time)
        up = turned.as_matrix()[:, :, 2]
        origins = place + HEIGHT_M[:, None, None] * up
        directions = np.einsum("cij,bcj->bci", turned.as_matrix(), local)
        times = np.broadcast_to(time, origins.shape[:2])
        distance = street_distances(made.street, origins, directions, times)
        returned = distance < FARTHEST_M
        ring, column = np.nonzero(returned)
        world = origins[ring, column] + directions[ring, column] * distance[ring, column, None]
        measured = local[ring, column] * distance[ring, column, None] + np.array([0, 0, 1]) * HEIGHT_M[ring, None]
        brightness = 0.99 * column / COLUMNS
        write_sweep(path / "velodyne_points/data" / f"{frame:010d}.bin", measured, brightness)
        made.points[frame], made.origins[frame] = world, origins[ring, column]
        made.time_s[frame], made.ring[frame] = time[column], ring
        made.returned[frame] = returned
    return made


def write_sweep(path: Path, points: FloatArray, brightness: FloatArray) -> None:
    """A sweep's file: millimetres and hundredths."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.column_stack([points.round(3), brightness.round(2)]).astype("<f4").tofile(path)


def write_raw(made: KittiStreet) -> None:
    """All of a raw drive but its sweeps, which are there."""
    path = made.path
    write_calibration(path.parent, made.rig)
    write_all_stamps(made)
    for name in ("image_02", "image_03"):
        write_images(path / name / "data")
        if made.rig.enlarged > 1:
            one = camera(made, int(name[-1]))
            for frame in range(FRAMES):
                Image.fromarray(street_picture(made.street, one, frame)).save(
                    path / name / "data" / f"{frame:010d}.png"
                )
    times = np.arange(FRAMES + 1) * PERIOD_S  # one after the last turn, so that nothing is extrapolated
    lines = oxts_lines(made, times)
    write_oxts(path, lines, times)
    write_tracklets(made, path / "tracklet_labels.xml")


def write_oxts(path: Path, lines: list[str], times_s: FloatArray) -> None:
    """The IMU's records of a raw drive, a file each, and their stamps."""
    (path / "oxts/data").mkdir(parents=True)
    for number, line in enumerate(lines):
        (path / "oxts/data" / f"{number:010d}.txt").write_text(line)
    write_stamps(path / "oxts/timestamps.txt", times_s)


def write_all_stamps(made: KittiStreet) -> None:
    """When the LiDAR looked backward and forward, and when images were stamped."""
    rig = made.rig
    after_s = {
        "velodyne_points/timestamps_start.txt": -rig.turn_s / 2,
        "velodyne_points/timestamps.txt": 0.0,
        "velodyne_points/timestamps_end.txt": rig.turn_s / 2,
        "image_02/timestamps.txt": rig.image_lag_s,
        "image_03/timestamps.txt": rig.image_lag_s,
    }
    for name, late in after_s.items():
        write_stamps(made.path / name, np.array([rig.trigger(frame) + late for frame in range(rig.frames)]))


def write_stamps(path: Path, times_s: FloatArray) -> None:
    """A file of timestamps, a line each."""
    path.parent.mkdir(parents=True, exist_ok=True)
    stamps = [CLOCK + np.timedelta64(int(round(time * 1e9)), "ns") for time in times_s]
    path.write_text("".join(f"{str(stamp).replace('T', ' ')}\n" for stamp in stamps))


def write_images(folder: Path) -> None:
    """Images, each frame's its own."""
    folder.mkdir(parents=True)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    for frame in range(FRAMES):
        rgb = np.stack([2 * u, 7 * v, np.full_like(u, 40 * frame)], -1).astype(np.uint8)
        Image.fromarray(rgb).save(folder / f"{frame:010d}.png")


def camera(made: KittiStreet, number: int) -> Camera:
    """A rectified camera in the drive's world; its images by frame."""
    times = np.arange(-0.02, PERIOD_S * FRAMES + 0.08, 0.001)
    turned, place = made.lidar(times)
    axes = Rotation.from_matrix((rectified() @ CAMERA_AXES).T)  # its axes in the LiDAR's
    seen = made.rig.projection(number)
    centre = CAMERA_PLACE - axes.apply(np.linalg.solve(seen[:, :3], seen[:, 3]))
    width, height = WIDTH * made.rig.enlarged, HEIGHT * made.rig.enlarged
    model = CameraModel(width, height, seen[0, 0], seen[1, 1], seen[0, 2] + 0.5, seen[1, 2] + 0.5)
    # exposed at the trigger, and stamped later
    shot_s = {frame: made.rig.trigger(frame) for frame in range(FRAMES)}
    return camera_on(f"image_{number:02d}", model, times, turned * axes, place + turned.apply(centre), shot_s)


def oxts_lines(made: KittiStreet, times_s: FloatArray) -> list[str]:
    """The IMU's records: the street lies east and north of a place in Karlsruhe."""
    turned, place = made.ego(times_s)
    place = place - made.ego(times_s[:1])[1]
    scale = np.cos(np.radians(LATITUDE)) * EARTH_M
    longitude = LONGITUDE + np.degrees(place[:, 0] / scale)
    north = np.log(np.tan(np.pi / 4 + np.radians(LATITUDE) / 2)) + place[:, 1] / scale
    latitude = np.degrees(2 * np.arctan(np.exp(north)) - np.pi / 2)
    yaw, pitch, roll = turned.as_euler("ZYX").T
    rest = " 0" * 24
    values = zip(latitude, longitude, ALTITUDE + place[:, 2], roll, pitch, yaw, strict=True)
    return [" ".join(f"{value:.14g}" for value in row) + rest + "\n" for row in values]


def write_calibration(folder: Path, rig: KittiRig = KittiRig()) -> None:
    """The day's three files."""
    turn = _lidar_turn().T
    imu = f"R: {_row(turn)}\nT: {_row(-turn @ LIDAR_PLACE)}\n"
    (folder / "calib_imu_to_velo.txt").write_text(f"calib_time: 25-May-2012 16:47:16\n{imu}")
    lidar = f"R: {_row(CAMERA_AXES)}\nT: {_row(-CAMERA_AXES @ CAMERA_PLACE)}\n"
    (folder / "calib_velo_to_cam.txt").write_text(f"calib_time: 15-Mar-2012 11:37:16\n{lidar}delta_f: 0.0 0.0\n")
    lines = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.95e-02"]
    for number in range(4):
        lines += [f"S_{number:02d}: 1392 512", f"R_rect_{number:02d}: {_row(rectified())}"]
        lines += [f"P_rect_{number:02d}: {_row(rig.projection(number))}"]
    (folder / "calib_cam_to_cam.txt").write_text("\n".join(lines) + "\n")


def rectified() -> FloatArray:
    """The rectified camera's axes in the camera's own."""
    return np.asarray(Rotation.from_rotvec([0.01, -0.02, 0.005]).as_matrix())


def projection(number: int) -> FloatArray:
    """P_rect of a camera of the usual rig."""
    return KittiRig().projection(number)


def _lidar_turn() -> FloatArray:
    return np.asarray(Rotation.from_rotvec([0, 0, LIDAR_YAW]).as_matrix())


def _row(values: FloatArray) -> str:
    return " ".join(f"{value:.6e}" for value in np.ravel(values))


def boxes_of(made: KittiStreet, frame: int) -> list[tuple[str, str, FloatArray, float, FloatArray]]:
    """Boxes as annotators saw them in a sweep: uid, class, centre and heading in the LiDAR's frame as its beams passed, size."""
    boxes = []
    for uid, actor in sorted(made.street.drive.actors.items()):
        time = made.rig.trigger(frame)
        for _ in range(8):
            turned, place = made.lidar(np.array([time]))
            pose = actor.world_from_actor.at(time)
            centre = turned.inv().apply(pose[:3, 3] - place)[0]
            azimuth = float(np.arctan2(centre[1], centre[0]))
            time = made.rig.trigger(frame) + made.rig.turn_s * made.direction * azimuth / (2 * np.pi)
        ahead = turned.inv().apply(pose[:3, 0])[0]
        if not actor.present(time) or np.hypot(*centre[:2]) > made.rig.farthest_m:
            continue
        made.boxes[uid, frame] = time
        boxes.append((uid, LABELS[actor.label], centre, float(np.arctan2(ahead[1], ahead[0])), actor.size_m))
    return boxes


def write_tracklets(made: KittiStreet, path: Path) -> list[str]:
    """The raw drive's boxes; gives the street's uids in the order of the file."""
    tracks: dict[str, list[str]] = {}
    heads: dict[str, str] = {}
    for frame in range(made.rig.frames):
        for uid, label, centre, yaw, (length, width, height) in boxes_of(made, frame):
            if uid not in heads:
                size = f"<h>{height:.9f}</h><w>{width:.9f}</w><l>{length:.9f}</l>"
                heads[uid] = f"<objectType>{label}</objectType>{size}<first_frame>{frame}</first_frame>"
            place = f"<tx>{centre[0]:.9f}</tx><ty>{centre[1]:.9f}</ty><tz>{centre[2] - height / 2:.9f}</tz>"
            turn = f"<rx>0</rx><ry>0</ry><rz>{yaw:.9f}</rz><state>2</state><occlusion>0</occlusion>"
            tracks.setdefault(uid, []).append(f"<item>{place}{turn}</item>")
    items = [f"<item>{heads[uid]}<poses>{''.join(poses)}</poses></item>" for uid, poses in tracks.items()]
    body = f"<tracklets class_id='0'><count>{len(items)}</count>{''.join(items)}</tracklets>"
    head = "<?xml version='1.0' encoding='UTF-8' standalone='yes' ?>\n<!DOCTYPE boost_serialization>\n"
    path.write_text(f"{head}<boost_serialization version='9'>{body}</boost_serialization>\n")
    return list(tracks)


def write_tracking(made: KittiStreet, split: Path, sequence: str = "0003") -> Path:
    """The same sweeps as a tracking sequence; gives its calibration's path, which stands for it."""
    (split / "calib").mkdir(parents=True)
    (split / "oxts").mkdir()
    (split / "label_02").mkdir()
    (split / "velodyne" / sequence).mkdir(parents=True)
    for frame in range(FRAMES):
        name = f"{frame:010d}.bin"
        (split / "velodyne" / sequence / f"{frame:06d}.bin").symlink_to(made.path / "velodyne_points/data" / name)
    write_images(split / "image_02" / sequence)
    turn = _lidar_turn().T
    poses = {
        "Tr_velo_cam": np.column_stack([CAMERA_AXES, -CAMERA_AXES @ CAMERA_PLACE]),
        "Tr_imu_velo": np.column_stack([turn, -turn @ LIDAR_PLACE]),
    }
    lines = [f"P{number}: {_row(projection(number))}" for number in range(4)]
    lines += [f"R_rect {_row(rectified())}", *(f"{name} {_row(pose)}" for name, pose in poses.items())]
    path = split / "calib" / f"{sequence}.txt"
    path.write_text("\n".join(lines) + "\n")
    times = np.array([made.rig.trigger(frame) for frame in range(FRAMES + 1)])
    (split / "oxts" / f"{sequence}.txt").write_text("".join(oxts_lines(made, times)))
    labels = []
    numbers: dict[str, int] = {}
    for frame in range(FRAMES):
        labels.append(f"{frame} -1 DontCare -1 -1 -10 219.31 188.49 245.50 218.56 -1000 -1000 -1000 -10 -1 -1 -1")
        for uid, label, centre, yaw, size in boxes_of(made, frame):
            length, width, height = size
            x, y, z = rectified() @ CAMERA_AXES @ (centre - CAMERA_PLACE) + [0, height / 2, 0]
            ahead = rectified() @ CAMERA_AXES @ [np.cos(yaw), np.sin(yaw), 0]
            turned = np.arctan2(-ahead[2], ahead[0])
            number = numbers.setdefault(uid, len(numbers))
            numerals = " ".join(f"{value:.9f}" for value in (height, width, length, x, y, z, turned))
            labels.append(f"{frame} {number} {label} 0 0 -1.5 296.7 161.7 455.2 292.3 {numerals}")
    (split / "label_02" / f"{sequence}.txt").write_text("\n".join(labels) + "\n")
    return path
