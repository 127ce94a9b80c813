"""The procedural street as an NCore sequence: an ideal lens ahead, and a fisheye that sees 150 degrees."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from street_pictures import street_picture

from unisim_blender.core.formats.ncore.write import NcoreWriter
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.sensors.beam_tables import vlp16
from unisim_blender.core.world.drive import CameraModel
from unisim_street.street import Street, build_street
from unisim_street.truth import truth_lidar

FRAMES = 5
FISHEYE = OpenCVFisheye(0.05, -0.01, 0.002, -0.001, 100.0)


def write(path: Path, width: int) -> Street:
    """The whole sequence in a new folder; images are ``width`` pixels wide."""
    street = build_street(seed=11, frames=FRAMES, width=width, height=width * 9 // 16)
    front, lidar = street.drive.cameras["front_camera"], street.drive.lidars["pandar64"]
    focal = width / 2.7
    model = CameraModel(width, width * 2 // 3, focal, focal, width / 2, width / 3, front.model.shutter, FISHEYE)
    cameras = {"front": replace(front, sensor_id="front"), "wide": replace(front, sensor_id="wide", model=model)}
    drive = replace(
        street.drive,
        cameras=cameras,
        lidars={"roof": replace(lidar, sensor_id="roof", model=replace(vlp16(), columns=900))},
    )
    with NcoreWriter(path, drive) as writer:
        for frame in drive.frames:
            for name, camera in cameras.items():
                writer.write_image(name, frame, street_picture(street, camera, frame))
            writer.write_sweep("roof", frame, truth_lidar(street, drive, "roof", frame))
    return replace(street, drive=drive)
