"""Cameras and their images as layouts have them whose cameras are fixed to the vehicle, with one time for an image, as JPEG."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from ...data.log import Log
from ...errors import OutputError
from ...files import write_file
from ...geometry import FloatArray
from ...world.drive import CameraModel
from .image_bytes import image_file, path_kind
from .rectify import Rectification, rectification_of
from .rigs import camera_mounts, exposure_middle, named_by_heading
from .writer import Tick, WriterPart


@dataclass
class LayoutCamera:
    """A camera as a layout has it: its name in the drive, its channel, mount (4, 4) on the vehicle, model, and stamps by
    frame, in the layout's unit."""

    name: str
    channel: str
    mount: FloatArray
    model: CameraModel
    rectification: Rectification | None
    stamps: dict[int, int]


def rig_cameras(
    log: Log,
    headings_deg: Mapping[str, float],
    farthest_deg: float,
    own_channel: Callable[[str], str],
    stamp: Callable[[float], int],
) -> tuple[list[LayoutCamera], list[str]]:
    """Return the cameras of a log that have images, and a sentence for each thing that they lose, "" for nothing.

    ``headings_deg`` and ``farthest_deg``: see `named_by_heading`; ``own_channel`` names the channel of another camera; ``stamp``
    makes the layout's stamp of a time in seconds. Raises `OutputError` for two images at one time.
    """
    said: list[str] = []
    mounts: dict[str, FloatArray] = {}
    for name, (mount, sentence) in camera_mounts(log).items():
        said.append(sentence)
        if mount is not None:
            mounts[name] = mount
    channels = named_by_heading(mounts, headings_deg, farthest_deg)
    cameras = []
    for name, mount in mounts.items():
        camera, there = log.drive.cameras[name], log.image_frames(name)
        rectification = rectification_of(camera)
        if rectification is not None:
            said.append(rectification.about)
        elif path_kind(log.image_path(name, there[0])) != "jpeg":
            said.append(f"{name}: its images are packed again, as JPEG")
        model = camera.model if rectification is None else rectification.model
        stamps = {frame: stamp(exposure_middle(camera, frame)) for frame in there}
        if len(set(stamps.values())) < len(stamps):
            raise OutputError(f"{log.path}: {name} has two images at one time")
        channel = channels.get(name) or own_channel(name)
        cameras.append(LayoutCamera(name, channel, mount, model, rectification, stamps))
    return cameras, said


def image_part(log: Log, camera: LayoutCamera, frame: int, root: Path, file: str) -> WriterPart:
    """Return the part that writes an image as the JPEG ``file`` below the folder ``root``."""

    def write(tick: Tick) -> None:
        write_file(root / file, image_file(log, camera.name, frame, "jpeg", camera.rectification))
        tick()

    return WriterPart((file,), write)
