"""The folder that a sequence was rendered into, as a `Log`: what converts and measures recorded drives takes rendered ones, too.

`drive.json`, written with the manifest, is the drive as it was rendered: edited, its cameras at the size of the images. The
manifest has the times of what was rendered.
"""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ..data.images import rgb_pixels
from ..data.log import Sweep, SweepGrid
from ..data.sweep_cells import find_cells, make_grid
from ..errors import LogError, OutputError, in_a_line
from ..files import read_arrays
from ..geometry import transform_points
from ..json_file import Node, read_json
from ..world.captures import in_order, key_of, name_of
from ..world.drive import Drive
from ..world.drive_json import read_drive

DRIVE_NAME, MANIFEST = "drive.json", "manifest.json"
FORMAT = "unisim-render"


def camera_path(out: Path, sensor_id: str, name: str, suffix: str) -> Path:
    """Where an image lies: `camera/NAME/000042.png` or `.exr`; ``name`` is its moment's (`Moment.name`)."""
    return out / "camera" / sensor_id / f"{name}{suffix}"


def lidar_path(out: Path, sensor_id: str, name: str, suffix: str) -> Path:
    """Where a sweep lies: `lidar/NAME/000042.ply` or `.npz`; ``name`` is its moment's (`Moment.name`)."""
    return out / "lidar" / sensor_id / f"{name}{suffix}"


def labels_path(out: Path, name: str) -> Path:
    """Where the boxes of a moment lie; ``name`` is the moment's (`Moment.name`)."""
    return out / "labels" / f"{name}.json"


def is_rendered(path: Path) -> bool:
    """Return whether a path is a folder with what `unisim render` leaves."""
    return (path / DRIVE_NAME).is_file() or ((path / MANIFEST).is_file() and (path / "labels").is_dir())


def read_rendered(path: Path) -> tuple[Node, Drive]:
    """Return a finished folder's manifest, and its drive, which has no frames and no times. Raises `LogError`."""
    if not (path / MANIFEST).is_file():
        raise LogError(f"{path}: is not rendered to its end; continue it with unisim render --resume")
    manifest = Node(read_json(path / MANIFEST, LogError), f"{path / MANIFEST}: ", LogError)
    if manifest.key("format").text() != FORMAT:
        manifest.key("format").fail(f'must be "{FORMAT}"')
    if not (path / DRIVE_NAME).is_file():
        raise LogError(
            f"{path / DRIVE_NAME}: is missing: an older program rendered the folder; unisim render --resume writes it"
        )
    return manifest, read_drive(Node(read_json(path / DRIVE_NAME, LogError), f"{path / DRIVE_NAME}: ", LogError))


class RenderedLog:
    """Log of a folder of rendered frames; see `unisim_blender.core.data.log.Log`.

    Frames are the log's where all that was rendered are frames of it; else all moments, numbered in the order of time.
    """

    path: Path
    drive: Drive
    missing: tuple[str, ...]

    def __init__(self, path: Path) -> None:
        self.path = path
        manifest, full = read_rendered(path)
        self._names, self.drive = _numbered(full, manifest.key("times"))
        self.missing = ()
        self.content = json.dumps(manifest.key("frames").value, sort_keys=True)
        """Rendered frames as JSON text, their files' digests included."""

    def image_frames(self, camera: str) -> tuple[int, ...]:
        if camera not in self.drive.cameras:
            return ()
        return tuple(frame for frame in self.drive.cameras[camera].time_s if self.image_path(camera, frame) is not None)

    def sweep_frames(self, lidar: str) -> tuple[int, ...]:
        if lidar not in self.drive.lidars:
            return ()
        return tuple(frame for frame in self.drive.lidars[lidar].time_s if self._sweep_path(lidar, frame).is_file())

    def image_path(self, camera: str, frame: int) -> Path | None:
        """The PNG file of the image; None where there is none."""
        if frame not in self._names:
            return None
        path = camera_path(self.path, camera, self._names[frame], ".png")
        return path if path.is_file() else None

    def image(self, camera: str, frame: int) -> NDArray[np.uint8]:
        """The rendered image (H, W, 3), sRGB."""
        path = self.image_path(camera, frame)
        if path is None:
            raise LogError(f"{self.path}: {camera} has no image of frame {frame}")
        try:
            rgb = read_image(path)
        except OutputError as fault:
            raise LogError(str(fault)) from fault
        model = self.drive.cameras[camera].model
        if rgb.shape[:2] != (model.height, model.width):
            raise LogError(f"{path}: has {rgb.shape[1]}x{rgb.shape[0]} pixels, not {model.width}x{model.height}")
        return rgb

    def sweep(self, lidar: str, frame: int) -> Sweep:
        """The rendered returns, each from where the sensor was at its own time."""
        if frame not in self._names or lidar not in self.drive.lidars:
            raise LogError(f"{self.path}: {lidar} has no sweep of frame {frame}")
        sensor = self.drive.lidars[lidar]
        path = self._sweep_path(lidar, frame)
        try:
            sweep = read_sweep(path)
        except OutputError as fault:
            raise LogError(str(fault)) from fault
        poses = sensor.world_from_lidar.at(sweep.time_s)
        local = np.einsum("nji,nj->ni", poses[:, :3, :3], sweep.points - poses[:, :3, 3])
        model = sensor.model_at(sensor.time_s[frame])
        if len(sweep.ring) and (sweep.ring.min() < 0 or sweep.ring.max() >= model.beams):
            raise LogError(f"{path}: ring holds a beam that {lidar} does not have")
        _, column = find_cells(local, model)
        return replace(sweep, origins=poses[:, :3, 3].copy(), column=column)

    def sweep_grid(self, lidar: str, frame: int) -> SweepGrid:
        """The rendered sweep as beams x columns: what did not return is a drop, what the vehicle blocks is not known."""
        sweep, sensor = self.sweep(lidar, frame), self.drive.lidars[lidar]
        nothing = np.zeros((sensor.model.beams, sensor.model.columns), np.bool_)
        return make_grid(sweep, sensor, frame, nothing if sensor.blocked is None else sensor.blocked)

    def _sweep_path(self, lidar: str, frame: int) -> Path:
        return lidar_path(self.path, lidar, self._names[frame], ".npz")


def _numbered(drive: Drive, place: Node) -> tuple[dict[int, str], Drive]:
    """The names of the moments by frame, and the drive with these frames and the captures' times, which are at ``place``."""
    times = {name: {sensor: at.number() for sensor, at in node.members()} for name, node in place.members()}
    try:
        keys = in_order(key_of(name) for name in times)
    except ValueError as fault:
        place.fail(str(fault))
    if not keys:
        place.fail("holds nothing that was rendered")
    for name, moment_times in times.items():
        if "time_s" not in moment_times:
            place.key(name).fail('"time_s" is missing')
    of_frames = all(isinstance(key, int) for key in keys)
    if not of_frames:
        keys.sort(key=lambda key: times[name_of(key)]["time_s"])
    names = {key if of_frames and isinstance(key, int) else at: name_of(key) for at, key in enumerate(keys)}
    frame_times = {number: times[name]["time_s"] for number, name in names.items()}
    late = [a for a, b in zip(names, list(names)[1:], strict=False) if frame_times[a] >= frame_times[b]]
    if late:
        place.key(names[late[0]]).fail("is not earlier than the moment after it")

    def of(name: str) -> dict[int, float]:
        return {number: times[moment][name] for number, moment in names.items() if name in times[moment]}

    return names, replace(
        drive,
        frames=tuple(names),
        time_s=frame_times,
        cameras={name: replace(camera, time_s=of(f"camera/{name}")) for name, camera in drive.cameras.items()},
        lidars={name: replace(lidar, time_s=of(f"lidar/{name}")) for name, lidar in drive.lidars.items()},
    )


def read_image(path: Path) -> NDArray[np.uint8]:
    """Return a rendered image (H, W, 3), sRGB, from its PNG file. Raises `OutputError`."""
    try:
        with Image.open(path) as image:
            return rgb_pixels(image)
    except (OSError, ValueError, SyntaxError, EOFError, struct.error, Image.DecompressionBombError) as error:
        raise OutputError(f"{path}: is no image: {in_a_line(error)}") from error


def read_sweep(path: Path) -> Sweep:
    """Return a rendered sweep's returns in the order of firing, from its NPZ file; origins are the sensor's at the frame's time.

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
