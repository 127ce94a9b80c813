"""Sensors in layouts with one turning LiDAR and cameras fixed to the vehicle."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ...data.log import Log
from ...errors import OutputError
from ...files import write_file
from ...geometry import FloatArray, Trajectory, invert_pose, mean_pose
from ...sensors.lidar import column_azimuths, column_times
from ...world.drive import Camera, CameraModel, Drive, Lidar, RollingShutter
from ...world.replay import over_whole_frames
from .class_names import renamed, renamed_sentence
from .image_bytes import Rectification, image_file, path_kind, rectification_of
from .writer import Tick, WriterPart

RecordingT = TypeVar("RecordingT", bound="RigRecording")


@dataclass
class LayoutCamera:
    """A camera as a layout has it: its name in the drive, its channel, mount (4, 4) on the vehicle, model, and stamps
    by frame, in the layout's unit."""

    name: str
    channel: str
    mount: FloatArray
    model: CameraModel
    rectification: Rectification | None
    stamps: dict[int, int]


@dataclass(frozen=True)
class RigLayout:
    """A dataset's layout.

    ``title`` stands in sentences, ``dataset`` has the class names. ``headings_deg`` and ``farthest_deg``: see
    `named_by_heading`; ``own_channel`` names the channel of another camera. ``stamp`` makes the layout's stamp of a
    time of the drive in seconds, ``seconds`` the time of a stamp. ``sweep_s`` gives the time by which a frame's sweep
    is stamped.
    """

    title: str
    dataset: str
    headings_deg: Mapping[str, float]
    farthest_deg: float
    own_channel: Callable[[str], str]
    stamp: Callable[[float], int]
    seconds: Callable[[int], float]
    sweep_s: Callable[[Lidar, int], float]


@dataclass
class RigRecording:
    """A log in the terms of a `RigLayout`, to be written below ``root``: the source of all its files.

    ``name`` is the drive's, as a file's; ``mount`` (4, 4) the LiDAR's on the vehicle; ``sweeps``: stamps by frame,
    which follow each other. ``losses`` and ``camera_losses`` have a sentence for each thing that is lost, "" for
    nothing.
    """

    log: Log
    root: Path
    drive: Drive
    name: str
    lidar: Lidar
    mount: FloatArray
    sweeps: dict[int, int]
    losses: list[str]
    cameras: list[LayoutCamera]
    camera_losses: list[str]

    @classmethod
    def plan(cls: type[RecordingT], log: Log, root: Path, layout: RigLayout) -> RecordingT:
        """Plan a log. Raises `OutputError` without a LiDAR that turns, or for one that does not ride on the vehicle."""
        drive, labels = renamed(over_whole_frames(log.drive), layout.dataset)
        lidar, losses = turning_lidar(log, layout.title)
        frames = log.sweep_frames(lidar.sensor_id)
        sweeps = {frame: layout.stamp(layout.sweep_s(lidar, frame)) for frame in frames}
        if any(sweeps[a] >= sweeps[b] for a, b in zip(frames, frames[1:], strict=False)):
            raise OutputError(f"{log.path}: {lidar.sensor_id}'s sweeps do not follow each other in time")
        times = np.array([layout.seconds(stamp) for stamp in sweeps.values()])
        mount, moves = fixed_mount(lidar.sensor_id, lidar.world_from_lidar, drive.world_from_ego, times)
        name = "".join(letter if letter.isalnum() or letter in "-_." else "-" for letter in drive.name)
        cameras, camera_losses = _plan_cameras(log, layout)
        losses += [renamed_sentence(labels), moves]
        return cls(log, root, drive, name, lidar, mount, sweeps, losses, cameras, camera_losses)


def _plan_cameras(log: Log, layout: RigLayout) -> tuple[list[LayoutCamera], list[str]]:
    """Return the cameras of a log that have images, and what they lose. Raises `OutputError` for two images at one
    time."""
    said: list[str] = []
    mounts: dict[str, FloatArray] = {}
    for name, (mount, sentence) in camera_mounts(log).items():
        said.append(sentence)
        if mount is not None:
            mounts[name] = mount
    channels = named_by_heading(mounts, layout.headings_deg, layout.farthest_deg)
    cameras = []
    for name, mount in mounts.items():
        camera, there = log.drive.cameras[name], log.image_frames(name)
        rectification = rectification_of(camera)
        if rectification is not None:
            said.append(rectification.about)
        elif path_kind(log.image_path(name, there[0])) != "jpeg":
            said.append(f"{name}: its images are packed again, as JPEG")
        model = camera.model if rectification is None else rectification.model
        stamps = {frame: layout.stamp(exposure_middle(camera, frame)) for frame in there}
        if len(set(stamps.values())) < len(stamps):
            raise OutputError(f"{log.path}: {name} has two images at one time")
        channel = channels.get(name) or layout.own_channel(name)
        cameras.append(LayoutCamera(name, channel, mount, model, rectification, stamps))
    return cameras, said


def image_part(log: Log, camera: LayoutCamera, frame: int, root: Path, file: str) -> WriterPart:
    """Return the part that writes an image as the JPEG ``file`` below the folder ``root``."""

    def write(tick: Tick) -> None:
        write_file(root / file, image_file(log, camera.name, frame, "jpeg", camera.rectification))
        tick()

    return WriterPart((file,), write)


RIDES_M, RIDES_RAD = 0.3, 0.1
"""Largest movement beside the vehicle, metres and radians, of a sensor that rides on it."""
FIXED_M, FIXED_RAD = 1e-3, 1e-3
"""Largest movement of a mount, metres and radians, at which its mean leaves a sensor where it was."""
ALL_ROUND_RAD = np.radians(350.0)


def turning_lidar(log: Log, layout: str) -> tuple[Lidar, list[str]]:
    """Return the LiDAR of a layout that has one: of those that turn all round and have sweeps, the one with most beams,
    of equal ones the highest; and a sentence for each of the others. Raises `OutputError` where there is none."""
    drive = log.drive
    turning = [lidar for name, lidar in drive.lidars.items() if log.sweep_frames(name) and _turns(lidar)]
    if not turning:
        raise OutputError(
            f"{log.path}: has no sweeps of a LiDAR that turns all round, and {layout}'s layout needs them"
        )
    chosen = max(turning, key=lambda lidar: (lidar.model.beams, _height(lidar, drive)))
    others = [name for name in drive.lidars if name != chosen.sensor_id and log.sweep_frames(name)]
    return chosen, [f"{name}: is left out, {layout} has one LiDAR" for name in others]


def _turns(lidar: Lidar) -> bool:
    azimuth = lidar.model.column_azimuth_rad
    return lidar.model.beams > 0 and (azimuth is None or abs(float(np.ptp(np.unwrap(azimuth)))) > ALL_ROUND_RAD)


def _height(lidar: Lidar, drive: Drive) -> float:
    start = drive.time_s[drive.frames[0]]
    return float((invert_pose(drive.world_from_ego.at(start)) @ lidar.world_from_lidar.at(start))[2, 3])


def looking_time(lidar: Lidar, frame: int, azimuth_rad: float) -> float:
    """Return when the columns of a frame's sweep look along an azimuth of the sensor's frame, seconds; up to half of a
    column before the sweep or after it."""
    model = lidar.model_at(lidar.time_s[frame])
    columns, times = np.unwrap(column_azimuths(model)), column_times(lidar, lidar.time_s[frame])
    turned = model.direction * (columns - columns[0])
    wanted = model.direction * (azimuth_rad - columns[0]) % (2 * np.pi)
    step = turned[-1] / (len(turned) - 1)
    if wanted > (turned[-1] + 2 * np.pi) / 2 + step / 2:
        wanted -= 2 * np.pi  # before the first column's middle
    before, after = turned[0] - step, turned[-1] + step
    late = (times[-1] - times[0]) / (len(times) - 1)
    return float(np.interp(wanted, [before, *turned, after], [times[0] - late, *times, times[-1] + late]))


def nearest_rings(ring: NDArray[np.int32], local: FloatArray, lidar: Lidar) -> NDArray[np.int64]:
    """Return the beam of each point (N,): where ``ring`` (N,) is -1 the one whose elevation is nearest. ``local`` (N,
    3) is in the sensor's frame."""
    elevation = np.arctan2(local[:, 2], np.hypot(local[:, 0], local[:, 1]))
    rising = lidar.model.elevation_rad[::-1]
    nearest = len(rising) - 1 - np.searchsorted((rising[1:] + rising[:-1]) / 2, elevation)
    return np.where(ring >= 0, ring, nearest)


def mid_exposure_shutter(camera: Camera) -> RollingShutter:
    """Return a camera's shutter where its images are stamped in the middle of their exposure."""
    shutter = camera.model.shutter
    return RollingShutter(shutter.duration_s, 0.5, shutter.axis)


def exposure_middle(camera: Camera, frame: int) -> float:
    """Return the middle of an image's exposure, seconds: where a layout has one time and pose for an image, those are
    taken."""
    start, end = camera.model.shutter.exposure_s(camera.time_s[frame])
    return (start + end) / 2


def fixed_mount(name: str, track: Trajectory, ego: Trajectory, times_s: FloatArray) -> tuple[FloatArray, str]:
    """Return the pose (4, 4) of a sensor on the vehicle, the mean over some times, and a sentence where it is not
    always that.

    Raises `OutputError` for a sensor that does not ride on the vehicle.
    """
    mounts = invert_pose(ego.at(times_s)) @ track.at(times_s)
    if np.ptp(mounts, axis=0).max() < 1e-12:
        return mounts[0], ""
    mount, off_m, off_rad = mean_pose(mounts)
    if off_m > RIDES_M or off_rad > RIDES_RAD:
        raise OutputError(f"{name}: does not ride on the vehicle, and the layout has no place for that")
    if off_m > FIXED_M or off_rad > FIXED_RAD:
        return mount, f"{name}: its mount, which moves by up to {moved(off_m, off_rad)} beside the vehicle, is its mean"
    return mount, ""


def moved(off_m: float, off_rad: float) -> str:
    """Return a movement of ``off_m``, metres, and ``off_rad``, radians, in words."""
    return f"{1e3 * off_m:.1f} mm and {np.degrees(off_rad):.2f} degrees"


def camera_mounts(log: Log) -> dict[str, tuple[FloatArray | None, str]]:
    """Return `fixed_mount` of each camera that has images, by name; None and why, where it does not ride on the
    vehicle."""
    mounts: dict[str, tuple[FloatArray | None, str]] = {}
    for name, camera in log.drive.cameras.items():
        frames = log.image_frames(name)
        if not frames:
            continue
        times = np.array([exposure_middle(camera, frame) for frame in frames])
        try:
            mounts[name] = fixed_mount(name, camera.world_from_camera, log.drive.world_from_ego, times)
        except OutputError as fault:
            mounts[name] = None, f"{fault}: it is left out"
    return mounts


def named_by_heading(
    mounts: Mapping[str, FloatArray], headings_deg: Mapping[str, float], farthest_deg: float
) -> dict[str, str]:
    """Return the name in a dataset of each camera that looks at most so far from where one of the dataset's does: each
    once, that of the nearest. ``mounts`` are poses (4, 4) on the vehicle, by the cameras' own names."""
    off = {}
    for name, mount in mounts.items():
        heading = np.degrees(np.arctan2(mount[1, 2], mount[0, 2]))
        for channel, wanted in headings_deg.items():
            off[name, channel] = abs((heading - wanted + 180) % 360 - 180)
    names: dict[str, str] = {}
    for (name, channel), apart in sorted(off.items(), key=lambda item: item[1]):
        if apart <= farthest_deg and name not in names and channel not in names.values():
            names[name] = channel
    return names
