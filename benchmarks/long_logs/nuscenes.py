"""A long scene of nuScenes: six cameras, an HDL-32E at full size, two key frames a second."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import nuscenes_street as street
from nuscenes_tables import Tables
from scipy.spatial.transform import Rotation
from street_pictures import LOOKS

from unisim_street.street import build_street

from .pictures import link, picture
from .traffic import SIZE_M, boxes_of

IMAGE = (1600, 900)
COLUMNS, DRAWN, KEY_EVERY = 1085, 8, 10
TURN_US = 50_000
CAMERAS = ("CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_FRONT_LEFT")
MATRIX = [[1266.0, 0.0, 816.0], [0.0, 1266.0, 491.0], [0.0, 0.0, 1.0]]


def write(root: Path, frames: int) -> Path:
    """Write the scene, an image of each camera beside each sweep; gives the path that opens it."""
    street.CYCLE_S = street.TURN_S / COLUMNS
    made = street.NuscenesStreet(build_street(seed=11, frames=street.STREET_FRAMES), root / "drawn")
    azimuth = street.FIRST_AZIMUTH
    for sweep in range(DRAWN):
        azimuth = street.write_sweep(made, sweep, COLUMNS, street.START_US + sweep * TURN_US, azimuth)
    image = root / "image.jpg"
    image.write_bytes(picture("JPEG", IMAGE))
    tables, wxyz = Tables(), [1.0, 0.0, 0.0, 0.0]
    lidar = tables.sensor("LIDAR_TOP", street.LIDAR_PLACE.tolist(), _wxyz(street.LIDAR_TURN))
    turns = [Rotation.from_euler("z", -60 * number, degrees=True) * LOOKS for number in range(len(CAMERAS))]
    cameras = [
        tables.sensor(name, street.CAMERA_PLACE, _wxyz(turn), MATRIX) for name, turn in zip(CAMERAS, turns, strict=True)
    ]
    cars: dict[int, str] = {}
    sample = ""
    for frame in range(frames):
        stamp, key = street.START_US + frame * TURN_US, frame % KEY_EVERY == 0 or frame == frames - 1
        folder = "samples" if key else "sweeps"
        place = made.ego(np.array([street.seconds(stamp)]))[1][0]
        if key:
            sample = tables.sample(stamp)
            for box in boxes_of(frame // 2, frames // 2):
                car = cars.setdefault(box.uid, tables.instance("vehicle.car")) if box.uid not in cars else cars[box.uid]
                length, width, height = SIZE_M
                tables.box(sample, car, (place + box.place_m).tolist(), wxyz, [width, length, height])
        file = f"{folder}/LIDAR_TOP/n015__LIDAR_TOP__{stamp}.pcd.bin"
        link(made.root / street.sweep_file(frame % DRAWN), root / file)
        tables.capture(sample, lidar, stamp, file, (place.tolist(), wxyz), key)
        for number, name in enumerate(CAMERAS):
            seen = stamp + 5_000 * number
            file = f"{folder}/{name}/n015__{name}__{seen}.jpg"
            link(image, root / file)
            there = made.ego(np.array([street.seconds(seen)]))[1][0]
            tables.capture(sample, cameras[number], seen, file, (there.tolist(), wxyz), key, IMAGE)
    tables.write(root / "v1.0-mini")
    return root


def _wxyz(rotation: Rotation) -> list[float]:
    return [float(value) for value in np.roll(rotation.as_quat(), 1)]
