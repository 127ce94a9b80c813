"""A folder that a sequence was rendered into, as a `Log`: what converts and measures recorded drives takes rendered ones, too.

`drive.json`, written with the manifest, is the drive as it was rendered: edited, its cameras at the size of the images. The
manifest has the times of what was rendered.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..data.log import Sweep, SweepGrid
from ..data.sweep_cells import find_cells, make_grid
from ..errors import LogError, OutputError
from ..files import write_file
from ..json_file import Node, json_bytes, read_json
from ..output.frame_files import camera_path, lidar_path
from ..world.captures import in_order, key_of, name_of
from ..world.drive import Appearance, Drive
from ..world.drive_json import drive_to_json, read_drive
from .plan import RenderPlan
from .rendered_log import read_image, read_sweep

DRIVE_NAME, MANIFEST = "drive.json", "manifest.json"
FORMAT = "unisim-render"


def write_drive(plan: RenderPlan, out: Path) -> None:
    """Write the plan's drive with the sensors that are rendered, at the size they are rendered at. Raises `OutputError`.

    It has no times of captures, which the manifest has: so it is the same whichever are rendered.
    """
    drive, settings = plan.drive, plan.settings
    cameras, lidars = {}, {}
    for name in settings.cameras:
        camera = drive.cameras[name]
        model = camera.model if settings.width is None else camera.model.resized(settings.width)
        cameras[name] = replace(camera, model=model, time_s={})
    for name in settings.lidars:
        lidars[name] = replace(drive.lidars[name], time_s={})
    # what actors look like is a matter of scenes and meshes, which lie elsewhere
    actors = {uid: replace(actor, appearance=Appearance(uid)) for uid, actor in drive.actors.items()}
    rendered = replace(drive, frames=(), time_s={}, cameras=cameras, lidars=lidars, actors=actors)
    write_file(out / DRIVE_NAME, json_bytes(drive_to_json(rendered)))


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
    """What was rendered into a folder; see `unisim_blender.core.data.log.Log`.

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
        """What was rendered, its files' digests included."""

    def image_frames(self, camera: str) -> tuple[int, ...]:
        """Frames of which the camera has an image."""
        if camera not in self.drive.cameras:
            return ()
        return tuple(frame for frame in self.drive.cameras[camera].time_s if self.image_path(camera, frame) is not None)

    def sweep_frames(self, lidar: str) -> tuple[int, ...]:
        """Frames of which the LiDAR has a sweep."""
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
    times = {name: {one: at.number() for one, at in node.members()} for name, node in place.members()}
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
        cameras={name: replace(one, time_s=of(f"camera/{name}")) for name, one in drive.cameras.items()},
        lidars={name: replace(one, time_s=of(f"lidar/{name}")) for name, one in drive.lidars.items()},
    )
