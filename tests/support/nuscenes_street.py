"""The procedural street as nuScenes would have recorded it: the dataset's axes, units, files and times, written without any code
of the reader's.

The LiDAR spins clockwise and does not keep step with its sweeps, which have 361 or 362 columns. Each file holds every firing, in
the sensor's frame (x right, y forward) at the sweep's end; one without a return lies where the sensor was. Some firings hit the
vehicle's own roof.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from nuscenes_tables import Tables
from PIL import Image
from scipy.spatial.transform import Rotation
from street_pictures import LOOKS, camera_on, street_picture
from street_rays import street_distances

from unisim_blender.core.world.drive import Camera, CameraModel
from unisim_street.street import Street, build_street

FloatArray = NDArray[np.float64]
SWEEPS, KEY_EVERY, STREET_FRAMES = 7, 3, 6
TURN_S = 0.05
CYCLE_S = TURN_S / 361.5
FIRST_S = 0.07
START_US = 1_532_402_927_647_951
FARTHEST_M = 70.0
ELEVATION_DEG = -92 / 3 + 4 / 3 * np.arange(32)
"""By the dataset's ring: 0 is the lowest."""
OFFSET_DEG = np.concatenate([np.linspace(0.07, -0.18, 16), np.linspace(0.06, -0.17, 16)])
FIRST_AZIMUTH = np.pi
"""In the dataset's axes: 0 is to the right, and a sweep begins at the left."""
LIDAR_PLACE = np.array([0.94, 0.0, 1.84])
LIDAR_TURN = Rotation.from_euler("zyx", [-np.pi / 2 + 0.002, -0.01, 0.004])
"""Its own axes in the vehicle's."""
MAP = Rotation.from_euler("z", 1.2), np.array([411.3, 1180.9, 0.0])
"""The street's world in the map."""
CAMERAS = {"CAM_FRONT": 0.0, "CAM_BACK": np.pi}
IMAGE_S, IMAGES = 0.083, 5
WIDTH, HEIGHT = 96, 54
INTRINSICS = [[76.0, 0.0, 49.0], [0.0, 76.5, 29.5], [0.0, 0.0, 1.0]]
CAMERA_PLACE = [1.7, 0.02, 1.5]
LABELS = {
    "Car": "vehicle.car",
    "Pickup Truck": "vehicle.truck",
    "Medium-sized Truck": "vehicle.truck",
    "Cones": "movable_object.trafficcone",
}


@dataclass
class NuscenesStreet:
    """A street, the dataset's folder, and what the files were written from: of each sweep and cell (ring, column), ring 0 the
    lowest, the ray's origin and direction in the street's world, its time, distance (inf: no return) and whether the roof is met.

    ``traced``: whether distances are the street's; else all are the same, which costs nothing.
    """

    street: Street
    root: Path
    traced: bool = True
    enlarged: int = 1
    """How many times as wide and high images are; those of size 1 show nothing."""
    stamps_us: list[int] = field(default_factory=list)
    origins: list[FloatArray] = field(default_factory=list)
    directions: list[FloatArray] = field(default_factory=list)
    time_s: list[FloatArray] = field(default_factory=list)
    distance: list[FloatArray] = field(default_factory=list)
    roof: list[NDArray[np.bool_]] = field(default_factory=list)
    lidar_place: FloatArray = field(default_factory=lambda: LIDAR_PLACE)
    lidar_turn: Rotation = LIDAR_TURN
    farthest_m: float = FARTHEST_M
    passed: dict[tuple[str, int], float] = field(default_factory=dict)
    """When the beams of a key frame's sweep passed each actor."""
    instances: dict[str, str] = field(default_factory=dict)

    def ego(self, time_s: FloatArray) -> tuple[Rotation, FloatArray]:
        """Rotation and place of the vehicle in the street's world."""
        poses = self.street.drive.world_from_ego.at(time_s)
        return Rotation.from_matrix(poses[:, :3, :3]), poses[:, :3, 3]

    def lidar(self, time_s: FloatArray) -> tuple[Rotation, FloatArray]:
        """Rotation and place of the LiDAR, its own axes."""
        turned, place = self.ego(time_s)
        return turned * self.lidar_turn, place + turned.apply(self.lidar_place)


def seconds(stamp_us: int) -> float:
    """A stamp by the street's clock."""
    return (stamp_us - START_US) * 1e-6 + FIRST_S


def to_map(points: FloatArray) -> FloatArray:
    """Points of the street's world in the map."""
    return np.asarray(MAP[0].apply(points) + MAP[1])


def write(root: Path, traced: bool = True, enlarged: int = 1) -> NuscenesStreet:
    """The whole dataset of one scene in ``root``."""
    made = NuscenesStreet(build_street(seed=11, frames=STREET_FRAMES), root, traced, enlarged)
    tables = Tables()
    lidar = tables.sensor("LIDAR_TOP", LIDAR_PLACE.tolist(), _wxyz(LIDAR_TURN))
    end_us, azimuth = START_US, FIRST_AZIMUTH
    samples: list[str] = []
    for sweep in range(SWEEPS):
        count = 361 + sweep % 2
        if sweep:
            end_us += round(count * CYCLE_S * 1e6)
        azimuth = write_sweep(made, sweep, count, end_us, azimuth)
        made.stamps_us.append(end_us)
        key = sweep % KEY_EVERY == 0
        if key:
            samples.append(tables.sample(end_us))
            write_boxes(made, tables, samples[-1], sweep)
        tables.capture(samples[-1], lidar, end_us, sweep_file(sweep), _map_pose(made, end_us), key)
    for name, yaw in CAMERAS.items():
        _write_images(made, tables, name, yaw, samples)
    tables.write(root / "v1.0-mini")
    return made


def sweep_file(sweep: int) -> str:
    """Where a sweep's file lies."""
    folder = "samples" if sweep % KEY_EVERY == 0 else "sweeps"
    return f"{folder}/LIDAR_TOP/n015__LIDAR_TOP__{START_US + sweep}.pcd.bin"


def write_sweep(made: NuscenesStreet, sweep: int, count: int, end_us: int, azimuth: float) -> float:
    """A sweep's file; gives the azimuth at which the next one begins."""
    end = seconds(end_us)
    time = end - CYCLE_S * (count - 1 - np.arange(count))
    turns = azimuth - 2 * np.pi * CYCLE_S / TURN_S * (np.arange(count) + 0.5)
    angle, height = turns + np.radians(OFFSET_DEG)[:, None], np.radians(ELEVATION_DEG)[:, None]
    local = np.stack([np.cos(height) * np.cos(angle), np.cos(height) * np.sin(angle), np.sin(height) + 0 * angle], -1)
    turned, place = made.lidar(time)
    directions = np.einsum("cij,rcj->rci", turned.as_matrix(), local)
    origins = np.broadcast_to(place, directions.shape)
    distance = np.where(height + 0 * angle > np.radians(8), np.inf, 12.0)
    if made.traced:
        distance = street_distances(made.street, origins, directions, np.broadcast_to(time, directions.shape[:2]))
    distance = np.where(distance < FARTHEST_M, distance, np.inf)
    roof = np.zeros(distance.shape, bool)
    roof[4:9, 170:190] = True  # ahead and down, 0.6 m away
    measured = np.where(roof, 0.6, distance)
    points = origins + directions * np.where(np.isfinite(measured), measured, 0)[..., None]
    last, places = made.lidar(np.array([end]))
    then, at = last[0], places[0]
    compensated = then.inv().apply((points - at).reshape(-1, 3)).reshape(points.shape)
    intensity = np.where(np.isfinite(measured), np.broadcast_to(np.arange(count) % 200, measured.shape), 7.0)
    ring = np.broadcast_to(np.arange(32)[:, None], measured.shape)
    table = np.concatenate([compensated, intensity[..., None], ring[..., None]], -1).transpose(1, 0, 2)
    path = made.root / sweep_file(sweep)
    path.parent.mkdir(parents=True, exist_ok=True)
    table.astype("<f4").tofile(path)
    made.origins.append(origins)
    made.directions.append(directions)
    made.time_s.append(time)
    made.distance.append(distance)
    made.roof.append(roof)
    return float(azimuth - 2 * np.pi * CYCLE_S / TURN_S * count)


def write_boxes(made: NuscenesStreet, tables: Tables, sample: str, sweep: int) -> None:
    """Boxes around the points of a key frame's sweep: where objects were as its beams passed."""
    times = made.time_s[sweep]
    for uid, actor in sorted(made.street.drive.actors.items()):
        turned, place = made.lidar(times)
        poses = actor.world_from_actor.at(times)
        local = turned.inv().apply(poses[:, :3, 3] - place)
        ahead = turned.inv().apply(made.directions[sweep][0])
        off = np.angle(np.exp(1j * (np.arctan2(local[:, 1], local[:, 0]) - np.arctan2(ahead[:, 1], ahead[:, 0]))))
        at = int(np.abs(off).argmin())
        if not actor.present(float(times[at])) or np.hypot(*local[at, :2]) > made.farthest_m:
            continue
        made.passed[uid, sweep] = float(times[at])
        if uid not in made.instances:
            made.instances[uid] = tables.instance(LABELS[actor.label])
        length, width, height = actor.size_m.tolist()
        rotation = MAP[0] * Rotation.from_matrix(poses[at, :3, :3])
        tables.box(
            sample, made.instances[uid], to_map(poses[at, :3, 3]).tolist(), _wxyz(rotation), [width, length, height]
        )


def _write_images(made: NuscenesStreet, tables: Tables, name: str, yaw: float, samples: list[str]) -> None:
    """A camera's images, twelve a second; those nearest to key frames lie in samples/."""
    n = made.enlarged
    intrinsics = (np.array(INTRINSICS) * [[n], [n], [1]]).tolist()
    sensor = tables.sensor(name, CAMERA_PLACE, _wxyz(Rotation.from_euler("z", yaw) * LOOKS), intrinsics)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    for number in range(IMAGES):
        stamp = image_stamp(number)
        key = number % 3 == 0
        file = f"{'samples' if key else 'sweeps'}/{name}/n015__{name}__{stamp}.jpg"
        path = made.root / file
        path.parent.mkdir(parents=True, exist_ok=True)
        rgb = np.stack([2 * u, 4 * v, np.full_like(u, 40 * number)], -1).astype(np.uint8)
        if n > 1:
            rgb = street_picture(made.street, camera(made, name), number)
        Image.fromarray(rgb).save(path, quality=95)
        sample = samples[min(number // 3, len(samples) - 1)]
        tables.capture(sample, sensor, stamp, file, _map_pose(made, stamp), key, (n * WIDTH, n * HEIGHT))


def image_stamp(number: int) -> int:
    """A camera's image's stamp."""
    return START_US - 12_000 + round(number * IMAGE_S * 1e6)


def camera(made: NuscenesStreet, name: str) -> Camera:
    """A camera in the street's world; its images by number."""
    n, times = made.enlarged, np.arange(0.03, 0.45, 0.001)
    (fx, _, cx), (_, fy, cy), _ = INTRINSICS
    model = CameraModel(n * WIDTH, n * HEIGHT, n * fx, n * fy, n * cx + 0.5, n * cy + 0.5)
    turned, place = made.ego(times)
    axes = turned * Rotation.from_euler("z", CAMERAS[name]) * LOOKS
    shot_s = {number: seconds(image_stamp(number)) for number in range(IMAGES)}
    return camera_on(name, model, times, axes, place + turned.apply(CAMERA_PLACE), shot_s)


def _map_pose(made: NuscenesStreet, stamp_us: int) -> tuple[list[float], list[float]]:
    turned, place = made.ego(np.array([seconds(stamp_us)]))
    return to_map(place[0]).tolist(), _wxyz(MAP[0] * turned[0])


def _wxyz(rotation: Rotation) -> list[float]:
    return [float(value) for value in np.roll(rotation.as_quat(), 1)]
