"""A rendered sequence as a log of its own, in PandaSet's layout: what reads a recorded drive reads
the edited one too."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..data.images import rgb_pixels
from ..data.log import Sweep
from ..errors import OutputError, in_a_line
from ..files import read_arrays
from ..formats.pandaset.write import PandasetWriter
from ..geometry import transform_points
from ..output.frame_files import camera_path, lidar_path
from ..world.captures import Moment
from ..world.drive import Camera, Drive, Lidar
from .plan import RenderPlan

LOG_FOLDER = "pandaset"


def write_rendered_log(plan: RenderPlan, out: Path) -> Path:
    """Write the log of what was rendered into ``out`` to ``out``/pandaset, whose path it gives. Raises `OutputError`.

    It is made of the captures' PNG and NPZ files, so both must have been written. Moments that are not all frames of
    the log are counted from 0.
    """
    settings = plan.settings
    for suffix, sensors in (("png", settings.cameras), ("npz", settings.lidars)):
        if sensors and suffix not in settings.formats:
            raise OutputError(
                f"{out}: a log in PandaSet's layout is made of {suffix} files, and the scenario's formats lack them"
            )
    drive = rendered_drive(plan)
    writer = PandasetWriter(out / LOG_FOLDER, drive)
    for frame, moment in zip(drive.frames, plan.moments, strict=True):
        for name in drive.cameras:
            path = camera_path(out, name, moment.name, ".png")
            if path.is_file():
                writer.write_image(name, frame, read_image(path))
        sweeps = {
            name: read_sweep(lidar_path(out, name, moment.name, ".npz"))
            for name in drive.lidars
            if frame in drive.lidars[name].time_s
        }
        if sweeps:
            writer.write_sweep(frame, sweeps)
        writer.write_cuboids(frame)
    writer.finish()
    return out / LOG_FOLDER


def rendered_drive(plan: RenderPlan) -> Drive:
    """The plan's drive with the moments as frames and the sensors that were rendered, at the size they
    were rendered at."""
    drive, settings = plan.drive, plan.settings
    cameras = {name: drive.cameras[name] for name in settings.cameras}
    if settings.width is not None:
        cameras = {
            name: replace(camera, model=camera.model.resized(settings.width)) for name, camera in cameras.items()
        }
    lidars = {name: drive.lidars[name] for name in settings.lidars}
    if len(plan.frames) == len(plan.moments):
        return replace(drive, frames=plan.frames, cameras=cameras, lidars=lidars)
    numbered = sorted(plan.moments, key=lambda moment: moment.time_us)
    if numbered != list(plan.moments):
        raise OutputError(
            f"{drive.name}: sensors with times of their own beside frames make no log in PandaSet's layout"
        )
    return replace(
        drive,
        frames=tuple(range(len(numbered))),
        time_s={i: moment.time_s(drive) for i, moment in enumerate(numbered)},
        cameras={name: replace(camera, time_s=_times(camera, numbered)) for name, camera in cameras.items()},
        lidars={name: replace(lidar, time_s=_times(lidar, numbered)) for name, lidar in lidars.items()},
    )


def _times(sensor: Camera | Lidar, moments: Sequence[Moment]) -> dict[int, float]:
    """Return when a sensor was captured, by the numbers of the moments."""
    found = {}
    for i, moment in enumerate(moments):
        captures = moment.cameras if isinstance(sensor, Camera) else moment.lidars
        own = next((one for one in captures if one.sensor_id == sensor.sensor_id), None)
        if own is not None:
            found[i] = own.time_s(sensor)
    return found


def read_image(path: Path) -> NDArray[np.uint8]:
    """Return a rendered image (H, W, 3), sRGB, from its PNG file. Raises `OutputError`."""
    try:
        with Image.open(path) as image:
            return rgb_pixels(image)
    except (OSError, ValueError, SyntaxError, EOFError, struct.error, Image.DecompressionBombError) as error:
        raise OutputError(f"{path}: is no image: {in_a_line(error)}") from error


def read_sweep(path: Path) -> Sweep:
    """A rendered sweep's returns in the order of firing, from its NPZ file; its origins are the sensor's at
    the frame's time.

    Raises `OutputError` where the file cannot be read or its arrays do not fit together.
    """
    arrays = sweep_arrays(path)
    order = np.argsort(arrays["time"], kind="stable")
    local = np.stack([arrays[axis][order] for axis in "xyz"], -1).astype(np.float64)
    pose = arrays["world_from_lidar"]
    return Sweep(
        points=transform_points(pose, local),
        origins=np.broadcast_to(pose[:3, 3], local.shape).copy(),
        time_s=arrays["time"][order],
        intensity=arrays["intensity"][order],
        ring=arrays["ring"][order],
        column=np.full(len(order), -1, np.int32),
        semantic=np.full(len(order), -1, np.int32),
    )


def sweep_arrays(path: Path, **more: str) -> dict[str, NDArray[Any]]:
    """Return the arrays of a rendered sweep's NPZ file by name. ``more`` names rows beside those that a log needs, and the kinds
    of their numbers ("iu"). Raises `OutputError` where the file cannot be read or its arrays do not fit together."""
    arrays = read_arrays(path, OutputError)
    rows = {"x": "f", "y": "f", "z": "f", "time": "f", "intensity": "f", "ring": "iu", **more}
    for name, kinds in (*rows.items(), ("world_from_lidar", "f")):
        if name not in arrays or arrays[name].dtype.kind not in kinds:
            raise OutputError(f"{path}: {name} is missing or holds no such numbers")
        shape = arrays["x"].shape if name in rows else (4, 4)
        if arrays[name].shape != shape or (name in rows and len(shape) != 1):
            raise OutputError(f"{path}: {name} has shape {arrays[name].shape}, not {shape if name != 'x' else '(N,)'}")
        if not np.isfinite(arrays[name]).all():
            raise OutputError(f"{path}: {name} holds a number that is not finite")
    return arrays
