"""Logs of streets of a few small frames."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from written_once import written_once

from unisim_blender.core.files import write_file
from unisim_blender.core.formats.pandaset.write import PandasetWriter
from unisim_street.street import RECIPE_FILE, Street, build_street, recipe_document
from unisim_street.truth import truth_camera, truth_lidar
from unisim_street.write import noisy


def write_street(out: Path, frames: int, height: int = 36, columns: int = 1800) -> Path:
    """Write a street's log with one camera and a LiDAR of so many columns; its folder."""
    return written_once(
        out, f"street-{frames}-{height}-{columns}", lambda folder: _write(folder, frames, height, columns)
    )


def write_sample(out: Path, columns: int = 180) -> Path:
    """Write the sample's log, its images small and its LiDAR of so many columns, with the street's recipe; its folder."""

    def write(folder: Path) -> None:
        street = build_street(frames=20, width=64, height=36)
        _write_street(folder, street, columns)
        write_file(folder / RECIPE_FILE, json.dumps(recipe_document(street.recipe)).encode())

    return written_once(out, f"sample-{columns}", write)


def _write(out: Path, frames: int, height: int, columns: int) -> None:
    _write_street(out, build_street(3, frames, 64, height, ("front_camera",), 0.0), columns)


def _write_street(out: Path, made: Street, columns: int) -> None:
    lidar = made.drive.lidars["pandar64"]
    lidar = replace(lidar, model=replace(lidar.model, columns=columns))
    drive = replace(made.drive, lidars={"pandar64": lidar})
    writer = PandasetWriter(out, drive)
    for frame in drive.frames:
        rgb = truth_camera(made, drive, "front_camera", frame).rgb
        writer.write_image("front_camera", frame, np.rint(rgb * 255).astype(np.uint8))
        writer.write_sweep(frame, {"pandar64": noisy(truth_lidar(made, drive, "pandar64", frame), made, frame)})
        writer.write_cuboids(frame)
    writer.finish()
