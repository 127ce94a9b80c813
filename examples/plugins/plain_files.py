"""A writer of logs: images and returns as plain files."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from unisim_blender.core.data.log import Log
from unisim_blender.core.files import write_file
from unisim_blender.core.formats.common.image_bytes import image_file
from unisim_blender.core.formats.common.writer import Tick, WritePlan, WriterPart
from unisim_blender.core.json_file import json_bytes
from unisim_blender.core.world.drive_json import drive_to_json


class PlainFiles:
    """Writes drive.json, CAMERA/000000.png and LIDAR/000000.npy."""

    name = "plain"
    about = "PNG images, NPY sweeps and the drive as JSON"
    version = 1  # counted up when the same log gives other files

    @staticmethod
    def plan(log: Log, path: Path) -> WritePlan:
        def image(camera: str, frame: int) -> WriterPart:
            file = f"{camera}/{frame:06d}.png"

            def write(tick: Tick) -> None:
                write_file(path / file, image_file(log, camera, frame, "png"))
                tick()

            return WriterPart((file,), write)

        def sweep(lidar: str, frame: int) -> WriterPart:
            file = f"{lidar}/{frame:06d}.npy"

            def write(tick: Tick) -> None:
                buffer = io.BytesIO()
                np.save(buffer, log.sweep(lidar, frame).points)
                write_file(path / file, buffer.getvalue())
                tick()

            return WriterPart((file,), write)

        parts = [image(name, frame) for name in log.drive.cameras for frame in log.image_frames(name)]
        parts += [sweep(name, frame) for name in log.drive.lidars for frame in log.sweep_frames(name)]
        losses = tuple(f"{name}: its drops are left out" for name in log.drive.lidars)
        return WritePlan(losses, parts, lambda: write_file(path / "drive.json", json_bytes(drive_to_json(log.drive))))
