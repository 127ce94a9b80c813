"""Logs of streets of a few small frames."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

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


def write_recipe(out: Path, columns: int = 300, **recipe: Any) -> Path:
    """Write what `unisim synth` writes by arguments of `build_street`, but a LiDAR of so many columns; its folder."""

    def write(folder: Path) -> None:
        street = build_street(**recipe)
        _write_street(folder, street, columns)
        write_file(folder / RECIPE_FILE, (json.dumps(recipe_document(street.recipe), indent=2) + "\n").encode())

    name = "-".join(f"{key}-{value}" for key, value in sorted(recipe.items()))
    return written_once(out, f"recipe-{columns}-{name}", write)


def _write(out: Path, frames: int, height: int, columns: int) -> None:
    _write_street(out, build_street(3, frames, 64, height, ("front_camera",), 0.0), columns)


def _write_street(out: Path, made: Street, columns: int) -> None:
    lidar = made.drive.lidars["pandar64"]
    lidar = replace(lidar, model=replace(lidar.model, columns=columns))
    drive = replace(made.drive, lidars={"pandar64": lidar})
    writer = PandasetWriter(out, drive)
    for frame in drive.frames:
        for name in drive.cameras:
            rgb = truth_camera(made, drive, name, frame).rgb
            writer.write_image(name, frame, np.rint(rgb * 255).astype(np.uint8))
        writer.write_sweep(frame, {"pandar64": noisy(truth_lidar(made, drive, "pandar64", frame), made, frame)})
        writer.write_cuboids(frame)
    writer.finish()
