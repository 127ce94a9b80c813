"""A long raw drive of KITTI: four cameras, as the layout has, and an HDL-64E at full size."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import kitti_street as street
import numpy as np

from .pictures import link, picture
from .traffic import SIZE_M, boxes_of

IMAGE = (1242, 375)
COLUMNS, BEAMS = 2000, 64
COUNTER_CLOCKWISE = 1


def write(root: Path, frames: int) -> Path:
    """Write the drive; gives the path that opens it."""
    street.COLUMNS = COLUMNS
    half = BEAMS // 2
    street.ELEVATION_DEG = np.concatenate([np.linspace(2.0, -8.5, half), np.linspace(-9.0, -24.5, half)])
    street.HEIGHT_M = np.repeat([0.21, 0.12], half)
    path = root / "2011_09_26" / "2011_09_26_drive_0001_sync"
    made = street.record(path, COUNTER_CLOCKWISE)
    made = replace(made, rig=replace(made.rig, frames=frames))
    street.write_calibration(path.parent, made.rig)
    street.write_all_stamps(made)
    times = np.arange(frames + 1) * street.PERIOD_S
    street.write_oxts(path, street.oxts_lines(made, times), times)
    sweeps = path / "velodyne_points" / "data"
    for frame in range(street.FRAMES, frames):
        link(sweeps / f"{frame % street.FRAMES:010d}.bin", sweeps / f"{frame:010d}.bin")
    image = root / "image.png"
    image.write_bytes(picture("PNG", IMAGE))
    for number in range(4):
        for frame in range(frames):
            link(image, path / f"image_{number:02d}" / "data" / f"{frame:010d}.png")
    _write_tracklets(path / "tracklet_labels.xml", frames)
    return path


def _write_tracklets(path: Path, frames: int) -> None:
    tracks: dict[int, list[str]] = {}
    length, width, height = SIZE_M
    for frame in range(frames):
        for box in boxes_of(frame, frames):
            head = f"<objectType>Car</objectType><h>{height}</h><w>{width}</w><l>{length}</l>"
            x, y, z = box.place_m - street.LIDAR_PLACE - [0, 0, height / 2]
            place = f"<tx>{x:.6f}</tx><ty>{y:.6f}</ty><tz>{z:.6f}</tz><rx>0</rx><ry>0</ry><rz>0</rz>"
            parts = tracks.setdefault(box.uid, [f"{head}<first_frame>{frame}</first_frame><poses>"])
            parts.append(f"<item>{place}<state>2</state><occlusion>0</occlusion></item>")
    items = "".join(f"<item>{''.join(parts)}</poses></item>" for parts in tracks.values())
    body = f"<tracklets><count>{len(tracks)}</count>{items}</tracklets>"
    path.write_text(f"<?xml version='1.0' encoding='UTF-8'?>\n<boost_serialization>{body}</boost_serialization>\n")
