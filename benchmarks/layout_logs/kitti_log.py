"""The recording as a raw drive of KITTI: images without loss, points to the millimetre, ring by ring, times from stamps."""

from __future__ import annotations

from pathlib import Path

import kitti_street as kitti
import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from .recording import LIDAR, Recording, decoded

CLOCKWISE = -1


def write_kitti(recording: Recording, day: Path) -> Path:
    """Write the recording below the day's folder; gives the drive's path."""
    made = kitti.KittiStreet(recording.street, day / "2011_09_26_drive_0001_sync", CLOCKWISE, recording.size.rig)
    day.mkdir(parents=True)
    kitti.write_calibration(day, made.rig)
    kitti.write_all_stamps(made)
    folder = made.path / "image_02/data"
    folder.mkdir(parents=True)
    for frame in recording.drive.frames:
        Image.fromarray(decoded(recording.images[frame])).save(folder / f"{frame:010d}.png")
        kitti.write_sweep(made.path / "velodyne_points/data" / f"{frame:010d}.bin", *_points(recording, frame))
    # the IMU's records are the drive's own keys, between which it goes straight; it stands level
    times = recording.drive.world_from_ego.times_s
    kitti.write_oxts(made.path, kitti.oxts_lines(made, times), times)
    kitti.write_tracklets(made, made.path / "tracklet_labels.xml")
    return made.path


def _points(recording: Recording, frame: int) -> tuple[np.ndarray, np.ndarray]:  # type: ignore[type-arg]
    """Points (N, 3) in the sensor's frame as each was fired, each ring from forward on, counter-clockwise; brightness (N,)."""
    sweep = recording.sweeps[frame]
    poses = recording.drive.lidars[LIDAR].world_from_lidar.at(sweep.time_s[0])
    world = sweep.directions * sweep.depth_m[..., None].astype(np.float64)
    local = Rotation.from_matrix(poses[:, :3, :3]).inv()
    measured = np.stack([local.apply(ring) for ring in world])
    azimuth = np.mod(np.arctan2(measured[..., 1], measured[..., 0]), 2 * np.pi)
    parts, brightness = [], []
    for ring in range(len(measured)):
        back = np.flatnonzero(sweep.returned[ring])
        back = back[np.argsort(azimuth[ring, back])]
        parts.append(measured[ring, back])
        brightness.append(sweep.intensity[ring, back])
    return np.concatenate(parts), np.concatenate(brightness)
