"""The procedural street as Argoverse 2 would have recorded it: the dataset's axes, units, times and motion compensation, written
without any code of the reader's.

Two LiDARs, the second upside down, spin a little faster than sweeps are cut. Each laser has its own angles and firing delay.
Points are moved to the sweep's start as if everything stood still, and kept as float16.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation
from street_pictures import LOOKS, camera_on, street_picture
from street_rays import street_distances

from unisim_blender.core.world.drive import Camera, CameraModel
from unisim_street.street import Street, build_street

FloatArray = NDArray[np.float64]
START_NS = 315_966_253_660_357_123
SWEEP_NS = 100_200_000
SWEEPS = 4
CYCLE_NS = 221_184
"""A quarter of the real devices' firings."""
TURN_S = 0.0998
CITY = np.array([5172.66, 2419.10, 66.93])
EGO_FROM_REAR = np.array([-1.3, 0.0, 0.25])
"""The dataset's vehicle frame in the street's."""
CAMERA_PLACE = np.array([1.63, 0.0, 1.4])
LABELS = {
    "Car": "REGULAR_VEHICLE",
    "Pickup Truck": "LARGE_VEHICLE",
    "Medium-sized Truck": "BOX_TRUCK",
    "Cones": "CONSTRUCTION_CONE",
}
# what the dataset's order of lasers is like: neither by elevation nor by number
_ORDER = np.random.default_rng(5).permutation(32)
_STEEP_UP, _STEEP_DOWN = [15, 10.3, 7, 4.7, 3.3, 2.3], [-4.7, -5.3, -6.1, -7.3, -8.8, -11.3, -15.6, -25]
_ELEVATION_DEG = np.concatenate([_STEEP_UP, np.arange(1.7, -4.1, -1 / 3), _STEEP_DOWN])
assert len(_ELEVATION_DEG) == 32


@dataclass
class Device:
    """A LiDAR: mount (rotation vector, place), direction of its spin in its own frame, azimuth when a log begins."""

    name: str
    turned: Rotation
    place: FloatArray
    spin: int
    azimuth: float
    first_ns: int
    elevation: FloatArray = field(init=False)
    offset: FloatArray = field(init=False)
    delay_ns: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        rng = np.random.default_rng(len(self.name))
        self.elevation = np.radians(_ELEVATION_DEG + rng.uniform(-0.03, 0.03, 32))[_ORDER]
        self.offset = np.radians(np.tile([1.4, -1.4, 4.2, -4.2], 8) + rng.uniform(-0.1, 0.1, 32))[_ORDER]
        self.delay_ns = (np.arange(32) // 2 * 2_304).astype(np.int64)


def devices() -> list[Device]:
    """The up and the down LiDAR."""
    flipped = Rotation.from_euler("xyz", [180.0, 0.3, -169.0], degrees=True)
    level = Rotation.from_euler("xyz", [0.4, -0.6, -0.6], degrees=True)
    return [
        Device("up_lidar", level, np.array([1.35, 0.0, 1.64]), -1, 2.3, 2_654_000),
        Device("down_lidar", flipped, np.array([1.347, 0.005, 1.525]), 1, 0.9, 5_910_000),
    ]


@dataclass
class Returned:
    """What a device truly measured in one sweep: one entry a return, and the rays that did not."""

    laser: NDArray[np.int64]
    offset_ns: NDArray[np.int64]
    points: FloatArray
    origins: FloatArray
    time_s: FloatArray
    local: FloatArray
    drop_directions: FloatArray
    drop_laser: NDArray[np.int64]
    drop_offset_ns: NDArray[np.int64]


class Argoverse2Street:
    """A street with its drive; ``write`` makes a log of it. ``enlarged``: how many times as wide and high images are; those of
    size 1 show nothing."""

    def __init__(self, city: FloatArray = CITY, swapped: bool = False, sweeps: int = SWEEPS, enlarged: int = 1) -> None:
        self.enlarged = enlarged
        self.street: Street = build_street(seed=7, frames=7, width=64, height=48)
        self.city, self.swapped = city, swapped
        self.devices = devices()
        self.stamps_ns = [START_NS + n * SWEEP_NS for n in range(sweeps)]
        self._measured: dict[tuple[str, int], Returned] = {}
        self.image_ns = {"ring_front_center": [START_NS + 7_000_000 + n * 50_000_000 for n in range(8)]}

    def ego(self, time_ns: Any) -> tuple[Rotation, FloatArray]:
        """The dataset's vehicle frame in the drive's world: rotations and places (N, 3) at integer times (N,)."""
        poses = self.street.drive.world_from_ego.at((np.asarray(time_ns) - START_NS) / 1e9)
        turned = Rotation.from_matrix(poses[..., :3, :3])
        return turned, poses[..., :3, 3] + turned.apply(EGO_FROM_REAR)

    def azimuth(self, device: Device, time_ns: Any) -> FloatArray:
        """Where the device's zero looks in its own frame."""
        return np.asarray(device.azimuth + device.spin * 2 * np.pi * (np.asarray(time_ns) - START_NS) / 1e9 / TURN_S)

    def measure(self, device: Device, sweep: int) -> Returned:
        """What the device measured in a sweep."""
        key = device.name, sweep
        if key not in self._measured:
            self._measured[key] = self._fire(device, sweep)
        return self._measured[key]

    def _fire(self, device: Device, sweep: int) -> Returned:
        """Fire all lasers in the sweep's window."""
        stamp, cycles = self.stamps_ns[sweep], SWEEP_NS // CYCLE_NS
        # firing runs on from sweep to sweep
        begin = -(-(sweep * SWEEP_NS) // CYCLE_NS) * CYCLE_NS - sweep * SWEEP_NS + device.first_ns
        offset = begin + CYCLE_NS * np.arange(cycles)[None, :] + device.delay_ns[:, None]
        time_ns = stamp + offset
        azimuth = self.azimuth(device, time_ns) + device.offset[:, None]
        rise = np.broadcast_to(device.elevation[:, None], azimuth.shape)
        local = np.stack([np.cos(rise) * np.cos(azimuth), np.cos(rise) * np.sin(azimuth), np.sin(rise)], -1)
        turned, place = self.ego(time_ns.ravel())
        directions = (turned * device.turned).apply(local.reshape(-1, 3)).reshape(local.shape)
        origins = (place + turned.apply(device.place)).reshape(local.shape)
        time_s = (time_ns - START_NS) / 1e9
        distance = street_distances(self.street, origins, directions, time_s)
        back = (distance > 3.0) & (distance < 120.0)
        laser, column = np.nonzero(back)
        order = np.argsort(offset[laser, column], kind="stable")
        laser, column = laser[order], column[order]
        off, off_column = np.nonzero(~back)
        o = origins[laser, column]
        return Returned(
            laser, offset[laser, column], o + distance[laser, column, None] * directions[laser, column], o,
            time_s[laser, column], local[laser, column], directions[off, off_column], off, offset[off, off_column],
        )  # fmt: skip

    def laser_number(self, device: Device, laser: NDArray[np.int64]) -> NDArray[np.int64]:
        """The number in the file: the second half is the down LiDAR's, or the up one's where they are swapped."""
        second = (device.name == "down_lidar") != self.swapped
        return laser + 32 * second

    def passing_ns(self, point: FloatArray, sweep: int) -> int:
        """When the beams passed a point (3,) of the world in a sweep, mean of the devices: the firing that looks there best."""
        found = []
        for device in self.devices:
            time_ns = self.stamps_ns[sweep] + device.first_ns + np.arange(0, int(TURN_S * 1e9), 100_000)
            turned, place = self.ego(time_ns)
            seen = (turned * device.turned).inv().apply(point - place - turned.apply(device.place))
            beside = np.angle(np.exp(1j * (np.arctan2(seen[:, 1], seen[:, 0]) - self.azimuth(device, time_ns))))
            found.append(int(time_ns[np.abs(beside).argmin()]))
        return sum(found) // len(found)

    def write(self, path: Path) -> None:
        """Write the whole log."""
        self._write_poses(path)
        self._write_calibration(path)
        for sweep, stamp in enumerate(self.stamps_ns):
            parts = [self.measure(device, sweep) for device in self.devices]
            turned, place = self.ego(stamp)
            points = np.concatenate([turned.inv().apply(part.points - place) for part in parts])
            offsets = np.concatenate([part.offset_ns for part in parts])
            order = np.argsort(offsets, kind="stable")
            lasers = np.concatenate([self.laser_number(d, p.laser) for d, p in zip(self.devices, parts, strict=True)])
            table = {axis: points[order, i].astype(np.float16) for i, axis in enumerate("xyz")}
            table |= {"intensity": (lasers[order] * 3).astype(np.uint8), "laser_number": lasers[order].astype(np.uint8)}
            write_feather(
                path / f"sensors/lidar/{stamp}.feather", table | {"offset_ns": offsets[order].astype(np.int32)}
            )
        self._write_boxes(path)
        for name, stamps in self.image_ns.items():
            folder = path / "sensors/cameras" / name
            folder.mkdir(parents=True)
            for number, stamp in enumerate(stamps):
                image = Image.new("RGB", (31, 41), (20 * number, 100, 50))
                if self.enlarged > 1:
                    image = Image.fromarray(street_picture(self.street, self.camera(), number))
                image.save(folder / f"{stamp}.jpg", quality=95)

    def camera(self) -> Camera:
        """The front camera in the drive's world; its images by number."""
        n, times = self.enlarged, np.arange(START_NS - 40_000_000, self.stamps_ns[-1] + 160_000_000, 1_000_000)
        model = CameraModel(31 * n, 41 * n, 35.0 * n, 35.5 * n, 15.2 * n, 20.9 * n)
        turned, place = self.ego(times)
        place = place + turned.apply(CAMERA_PLACE)
        shot_s = {number: (stamp - START_NS) / 1e9 for number, stamp in enumerate(self.image_ns["ring_front_center"])}
        return camera_on("ring_front_center", model, (times - START_NS) / 1e9, turned * LOOKS, place, shot_s)

    def _write_poses(self, path: Path) -> None:
        # the merged clocks of all sensors: uneven, some a nanosecond apart
        every = np.arange(START_NS - 40_000_000, self.stamps_ns[-1] + 160_000_000, 4_999_871)
        knots = START_NS + np.rint(self.street.drive.world_from_ego.times_s * 1e9).astype(np.int64)
        times = np.unique(
            np.concatenate([every, knots, self.stamps_ns, np.array(self.stamps_ns) + 1, *self.image_ns.values()])
        )
        turned, place = self.ego(times)
        write_feather(
            path / "city_SE3_egovehicle.feather", {"timestamp_ns": times, **pose_columns(turned, place + self.city)}
        )

    def _write_calibration(self, path: Path) -> None:
        names = ["ring_front_center", "ring_side_left", *(device.name for device in self.devices)]
        left, n = Rotation.from_euler("z", 90, degrees=True) * LOOKS, self.enlarged
        turned = Rotation.concatenate([LOOKS, left, *(device.turned for device in self.devices)])
        place = np.stack([CAMERA_PLACE, [1.3, 0.3, 1.4], *(device.place for device in self.devices)])
        write_feather(
            path / "calibration/egovehicle_SE3_sensor.feather", {"sensor_name": names, **pose_columns(turned, place)}
        )
        write_feather(
            path / "calibration/intrinsics.feather",
            {
                "sensor_name": names[:2],
                **{name: np.array(values) * (n if name.endswith("px") else 1) for name, values in {
                    "fx_px": [35.0, 33.0], "fy_px": [35.5, 33.0], "cx_px": [15.2, 20.0], "cy_px": [20.9, 15.0],
                    "k1": [-0.24, -0.28], "k2": [-0.21, -0.04], "k3": [0.3, 0.1],
                }.items()},
                "height_px": np.array([41 * n, 31 * n], np.uint16), "width_px": np.array([31 * n, 41 * n], np.uint16),
            },
        )  # fmt: skip

    def _write_boxes(self, path: Path) -> None:
        rows: list[dict[str, Any]] = []
        for sweep, stamp in enumerate(self.stamps_ns):
            turned, place = self.ego(stamp)
            for actor in self.street.drive.actors.values():
                near = actor.world_from_actor.at((stamp - START_NS) / 1e9)[:3, 3]
                then = self.passing_ns(near, sweep)
                # where it was when the beams passed, seen from where the vehicle was at the start
                pose = actor.world_from_actor.at((then - START_NS) / 1e9)
                box = turned.inv() * Rotation.from_matrix(pose[:3, :3])
                values = pose_columns(box, turned.inv().apply(pose[:3, 3] - place))
                size = dict(zip(("length_m", "width_m", "height_m"), actor.size_m.tolist(), strict=True))
                one = {"timestamp_ns": stamp, "track_uuid": actor.uid, "category": LABELS[actor.label]}
                rows.append(one | size | {k: float(v[0]) for k, v in values.items()} | {"num_interior_pts": 9})
        write_feather(path / "annotations.feather", {key: [row[key] for row in rows] for key in rows[0]})


def pose_columns(turned: Rotation, place: FloatArray) -> dict[str, FloatArray]:
    x, y, z, w = np.atleast_2d(turned.as_quat()).T
    tx, ty, tz = np.atleast_2d(place).T
    return {"qw": w, "qx": x, "qy": y, "qz": z, "tx_m": tx, "ty_m": ty, "tz_m": tz}


def write_feather(path: Path, columns: dict[str, Any]) -> None:
    """Write columns as the dataset's files have them: Feather, LZ4."""
    import pyarrow
    from pyarrow import feather

    path.parent.mkdir(parents=True, exist_ok=True)
    feather.write_feather(pyarrow.table(columns), str(path), compression="lz4")
