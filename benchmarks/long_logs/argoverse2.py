"""A long log of Argoverse 2: six of its cameras, both LiDARs at full size."""

from __future__ import annotations

from pathlib import Path

import argoverse2_street as street
import numpy as np
from scipy.spatial.transform import Rotation
from street_pictures import LOOKS

from .pictures import SIZE, link, picture
from .traffic import SIZE_M, boxes_of

CYCLE_NS = 55_296
DRAWN = 6
POSES_HZ = 170
CAMERAS = ("front_center", "front_right", "side_right", "rear_right", "rear_left", "side_left")


def write(root: Path, frames: int) -> Path:
    """Write the log, an image of each camera beside each sweep; gives the path that opens it."""
    street.CYCLE_NS = CYCLE_NS
    drawn = street.Argoverse2Street(sweeps=DRAWN)
    drawn.write(root / "drawn")
    path = root / "log"
    stamps = [street.START_NS + n * street.SWEEP_NS for n in range(frames)]
    image = root / "image.jpg"
    image.write_bytes(picture("JPEG"))
    for frame, stamp in enumerate(stamps):
        name = f"{drawn.stamps_ns[frame % DRAWN]}.feather"
        link(root / "drawn" / "sensors" / "lidar" / name, path / "sensors" / "lidar" / f"{stamp}.feather")
        for number, camera in enumerate(CAMERAS):
            link(image, path / "sensors" / "cameras" / f"ring_{camera}" / f"{stamp + 7_000_000 * number}.jpg")
    times = np.arange(stamps[0] - 10_000_000, stamps[-1] + 200_000_000, 10**9 // POSES_HZ)
    turned, place = drawn.ego(times)
    poses = street.pose_columns(turned, place + drawn.city)
    street.write_feather(path / "city_SE3_egovehicle.feather", {"timestamp_ns": times, **poses})
    _write_calibration(path / "calibration", drawn)
    _write_boxes(path / "annotations.feather", stamps)
    return path


def _write_calibration(folder: Path, drawn: street.Argoverse2Street) -> None:
    names = [f"ring_{name}" for name in CAMERAS]
    looks = [Rotation.from_euler("z", -60 * number, degrees=True) * LOOKS for number in range(len(CAMERAS))]
    mounts = Rotation.concatenate([*looks, *(device.turned for device in drawn.devices)])
    places = np.stack([*[street.CAMERA_PLACE] * len(CAMERAS), *(device.place for device in drawn.devices)])
    street.write_feather(
        folder / "egovehicle_SE3_sensor.feather",
        {"sensor_name": [*names, *(device.name for device in drawn.devices)], **street.pose_columns(mounts, places)},
    )
    width, height = SIZE
    values = {
        "fx_px": 1700.0,
        "fy_px": 1700.0,
        "cx_px": width / 2,
        "cy_px": height / 2,
        "k1": 0.0,
        "k2": 0.0,
        "k3": 0.0,
    }
    columns = {name: np.full(len(names), value) for name, value in values.items()}
    sides = {"height_px": np.full(len(names), height, np.uint16), "width_px": np.full(len(names), width, np.uint16)}
    street.write_feather(folder / "intrinsics.feather", {"sensor_name": names, **columns, **sides})


def _write_boxes(path: Path, stamps: list[int]) -> None:
    boxes = [(stamp, box) for frame, stamp in enumerate(stamps) for box in boxes_of(frame, len(stamps))]
    places = np.stack([box.place_m for _, box in boxes])
    columns = {
        "timestamp_ns": np.array([stamp for stamp, _ in boxes]),
        "track_uuid": [f"{box.uid:08x}" for _, box in boxes],
        "category": ["REGULAR_VEHICLE"] * len(boxes),
        **{
            name: np.full(len(boxes), side)
            for name, side in zip(("length_m", "width_m", "height_m"), SIZE_M, strict=True)
        },
        **street.pose_columns(Rotation.identity(len(boxes)), places),
        "num_interior_pts": np.full(len(boxes), 9),
    }
    street.write_feather(path, columns)
