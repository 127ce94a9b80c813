"""KITTI's text files: calibration, timestamps, the IMU's records, a raw drive's tracklets."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from ....files import write_file
from ....geometry import FloatArray, Trajectory
from ....world.drive import CameraModel

DAY = "2000_01_01"
"""Of the drive's folder and its timestamps: nobody knows when a drive took place."""
EARTH_M = 6378137.0
LATITUDE_DEG, LONGITUDE_DEG = 49.0, 8.43
"""Where the drive begins: Karlsruhe, as nobody knows where it took place."""
STEP_S = 0.01
"""Velocities and rates are those over so long."""


@dataclass
class Tracklet:
    """An actor's boxes in frames that follow each other: centre of the bottom (3,) and heading in the LiDAR's frame."""

    label: str
    size_m: FloatArray
    first: int
    boxes: list[tuple[FloatArray, float]]


def write_stamps(path: Path, times_s: Sequence[float]) -> None:
    """Write seconds of the drive as timestamps, a line each; the drive's 0 s is noon. Raises `OutputError`."""
    start = np.datetime64(f"{DAY.replace('_', '-')}T12:00:00", "ns")
    stamps = [start + np.timedelta64(round(time * 1e9), "ns") for time in times_s]
    write_file(path, "".join(f"{str(stamp).replace('T', ' ')}\n" for stamp in stamps).encode())


def write_calibration(
    folder: Path,
    lidar_from_imu: FloatArray,
    camera_from_lidar: FloatArray,
    models: Mapping[str, CameraModel],
    shifts_m: Mapping[str, FloatArray],
) -> None:
    """Write the day's three files. ``camera_from_lidar`` is of the camera numbered 0; ``models`` and ``shifts_m`` (3,), the
    places of cameras in its frame, are by number, "02"; all four numbers have an entry. Raises `OutputError`."""
    write_file(folder / "calib_imu_to_velo.txt", f"{_TIME}{_pose(lidar_from_imu)}".encode())
    write_file(
        folder / "calib_velo_to_cam.txt", f"{_TIME}{_pose(camera_from_lidar)}delta_f: 0 0\ndelta_c: 0 0\n".encode()
    )
    lines = [_TIME.strip(), "corner_dist: 1.000000e-01"]
    same = text_row(np.eye(3))
    for number, model in models.items():
        projection = projection_matrix(model, shifts_m[number])
        matrix = projection[:, :3]
        size = f"{float(model.width):e} {float(model.height):e}"
        lines += [f"S_{number}: {size}", f"K_{number}: {text_row(matrix)}", f"D_{number}: {text_row(np.zeros(5))}"]
        lines += [f"R_{number}: {same}", f"T_{number}: {text_row(-shifts_m[number])}", f"S_rect_{number}: {size}"]
        lines += [f"R_rect_{number}: {same}", f"P_rect_{number}: {text_row(projection)}"]
    write_file(folder / "calib_cam_to_cam.txt", ("\n".join(lines) + "\n").encode())


def projection_matrix(model: CameraModel, shift_m: FloatArray) -> FloatArray:
    """Return the projection (3, 4) of a pinhole at a place (3,) in the first camera's frame; pixels are counted from the first
    one's centre."""
    matrix = np.array([[model.fx, 0, model.cx - 0.5], [0, model.fy, model.cy - 0.5], [0, 0, 1]])
    return np.column_stack([matrix, -matrix @ shift_m])


_TIME = "calib_time: 01-Jan-2000 12:00:00\n"


def oxts_lines(track: Trajectory, times_s: FloatArray) -> list[str]:
    """Return the IMU's records at times (T,), thirty numbers each: Mercator about the first place, accelerations 0."""
    poses = track.at(times_s)
    place = poses[:, :3, 3] - poses[0, :3, 3]
    scale = np.cos(np.radians(LATITUDE_DEG)) * EARTH_M
    longitude = LONGITUDE_DEG + np.degrees(place[:, 0] / scale)
    north = np.log(np.tan(np.pi / 4 + np.radians(LATITUDE_DEG) / 2)) + place[:, 1] / scale
    latitude = np.degrees(2 * np.arctan(np.exp(north)) - np.pi / 2)
    turned = poses[:, :3, :3]
    yaw = np.arctan2(turned[:, 1, 0], turned[:, 0, 0])
    pitch = np.arcsin(np.clip(-turned[:, 2, 0], -1, 1))
    roll = np.arctan2(turned[:, 2, 1], turned[:, 2, 2])
    before, after = track.at(times_s - STEP_S / 2), track.at(times_s + STEP_S / 2)
    velocity = (after[:, :3, 3] - before[:, :3, 3]) / STEP_S
    own = np.einsum("tji,tj->ti", turned, velocity)
    spin = np.einsum("tji,tjk->tik", before[:, :3, :3], after[:, :3, :3]) / STEP_S
    rate = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], -1)  # small turns alone
    zeros = np.zeros((len(times_s), 6))
    rows = np.column_stack(
        [latitude, longitude, place[:, 2], roll, pitch, yaw, velocity[:, 1], velocity[:, 0], own, zeros, rate, rate]
    )
    return [" ".join(f"{value:.17g}" for value in row) + " 0.01 0.01 4 10 4 4 0\n" for row in rows]


def tracklets_xml(tracklets: Sequence[Tracklet]) -> str:
    """Return a raw drive's boxes as `tracklet_labels.xml` has them; what of them is hidden is not said (-1)."""
    items = []
    for tracklet in tracklets:
        length, width, height = np.asarray(tracklet.size_m).tolist()
        poses = "".join(
            f"<item><tx>{float(at[0])!r}</tx><ty>{float(at[1])!r}</ty><tz>{float(at[2])!r}</tz><rx>0</rx><ry>0</ry>"
            f"<rz>{yaw!r}</rz><state>2</state><occlusion>-1</occlusion><occlusion_kf>0</occlusion_kf>"
            "<truncation>-1</truncation><amt_occlusion>-1</amt_occlusion><amt_occlusion_kf>0</amt_occlusion_kf>"
            "<amt_border_l>-1</amt_border_l><amt_border_r>-1</amt_border_r><amt_border_kf>-1</amt_border_kf></item>\n"
            for at, yaw in tracklet.boxes
        )
        items.append(
            f"<item><objectType>{escape(tracklet.label)}</objectType><h>{height!r}</h><w>{width!r}</w><l>{length!r}</l>"
            f"<first_frame>{tracklet.first}</first_frame>\n<poses><count>{len(tracklet.boxes)}</count><item_version>2</item_version>"
            f"\n{poses}</poses><finished>1</finished></item>\n"
        )
    head = '<?xml version="1.0" encoding="UTF-8" standalone="yes" ?>\n<!DOCTYPE boost_serialization>\n'
    body = f"<count>{len(items)}</count><item_version>1</item_version>\n{''.join(items)}"
    return (
        f'{head}<boost_serialization signature="serialization::archive" version="9">\n<tracklets version="0">'
        f"{body}</tracklets>\n</boost_serialization>\n"
    )


def _pose(pose: FloatArray) -> str:
    return f"R: {text_row(pose[:3, :3])}\nT: {text_row(pose[:3, 3])}\n"


def text_row(values: FloatArray) -> str:
    """Return numbers as calibration files have them, row by row in one line."""
    return " ".join(f"{value:.12e}" for value in np.ravel(values))
