"""The log of a street of a few small frames."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from written_once import written_once

from unisim_blender.core.formats.pandaset.write import PandasetWriter
from unisim_street.street import build_street
from unisim_street.truth import truth_camera, truth_lidar


def write_street(out: Path, frames: int, height: int = 36, columns: int = 1800) -> Path:
    """Write a street's log with one camera and a LiDAR of so many columns; its folder."""
    return written_once(
        out, f"street-{frames}-{height}-{columns}", lambda folder: _write(folder, frames, height, columns)
    )


def _write(out: Path, frames: int, height: int, columns: int) -> None:
    made = build_street(3, frames, 64, height, ("front_camera",), 0.0)
    lidar = made.drive.lidars["pandar64"]
    lidar = replace(lidar, model=replace(lidar.model, columns=columns))
    drive = replace(made.drive, lidars={"pandar64": lidar})
    writer = PandasetWriter(out, drive)
    for frame in drive.frames:
        rgb = truth_camera(made, drive, "front_camera", frame).rgb
        writer.write_image("front_camera", frame, np.rint(rgb * 255).astype(np.uint8))
        writer.write_sweep(frame, {"pandar64": truth_lidar(made, drive, "pandar64", frame)})
        writer.write_cuboids(frame)
    writer.finish()
