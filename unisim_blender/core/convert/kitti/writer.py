"""Plans a raw drive of KITTI: turns of the LiDAR and images one by one, then calibration, poses and tracklets."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from ...data.kitti.beams import MEET_M
from ...data.kitti.files import IMAGE_LAG_S
from ...data.kitti.reader import LIDAR
from ...data.log import Log, Sweep
from ...data.sensor_file import LidarSetup, LogSetup, write_setup
from ...errors import OutputError
from ...files import write_file
from ...geometry import FloatArray, invert_pose
from ...world.drive import CameraModel, Drive, Lidar, LidarModel, RollingShutter
from ..class_names import renamed, renamed_sentence
from ..images import image_file
from ..rectify import Rectification, rectification_of
from ..rigs import FIXED_RAD, exposure_middle, fixed_mount, turning_lidar
from ..writer import Part, Tick, WritePlan, register
from .files import DAY, Tracklet, oxts_lines, tracklets_xml, write_calibration, write_stamps
from .turns import Cut, cut_turns, points_of, time_in_turn

DRIVE = f"{DAY}/{DAY}_drive_0001_sync"
NUMBERS = ("02", "03", "00", "01")
"""Of cameras, in the order in which they are given: the dataset's colour cameras first."""
BOX_ROUNDS = 6
SWEEPS_HELD = 4


@dataclass
class _Camera:
    """A camera: its name in the drive, its number, mount, model in the calibration, and its image's frame by turn."""

    name: str
    number: str
    mount: FloatArray
    model: CameraModel
    rectification: Rectification | None
    frames: dict[int, int]


@dataclass
class _Raw:
    """All that the files of a raw drive follow from."""

    log: Log
    root: Path
    drive: Drive
    lidar: Lidar
    mount: FloatArray
    cuts: list[Cut]
    cameras: list[_Camera] = field(default_factory=list)

    @property
    def path(self) -> Path:
        """The drive's folder."""
        return self.root / DRIVE


class KittiLogWriter:
    """Plans raw drives in KITTI's layout."""

    name = "kitti"
    about = "KITTI raw with tracklets, one LiDAR, cameras that look ahead"
    version = 1

    def plan(self, log: Log, path: Path) -> WritePlan:
        """Plan the drive. Raises `OutputError` without a LiDAR that turns, or for one that does not ride on the vehicle."""
        drive, labels = renamed(log.drive, "kitti")
        lidar, losses = turning_lidar(log, "KITTI")
        cuts = cut_turns(lidar, log.sweep_frames(lidar.sensor_id))
        if not cuts:
            raise OutputError(f"{log.path}: {lidar.sensor_id}'s sweeps cover no turn from backward to backward")
        times = np.array([cut.turn[1] for cut in cuts])
        mount, moves = fixed_mount(lidar.sensor_id, lidar.world_from_lidar, drive.world_from_ego, times)
        raw = _Raw(log, path, drive, lidar, mount, cuts)
        losses += [renamed_sentence(labels), moves, *_plan_cameras(raw)]
        read = lru_cache(maxsize=SWEEPS_HELD)(lambda frame: log.sweep(lidar.sensor_id, frame))
        parts = []
        for turn in range(len(cuts)):
            parts.append(_turn_part(raw, turn, read))
            parts += [_image_part(raw, camera, turn) for camera in raw.cameras if turn in camera.frames]
        return WritePlan(tuple(filter(None, losses)), parts, lambda: _finish(raw), DRIVE)


def _plan_cameras(raw: _Raw) -> list[str]:
    """Fill in the cameras; gives what they lose. The layout's cameras all look the same way."""
    said: list[str] = []
    log, drive = raw.log, raw.drive
    mounts: dict[str, FloatArray] = {}
    moves: dict[str, str] = {}
    for name, camera in drive.cameras.items():
        there = log.image_frames(name)
        if not there:
            continue
        times = np.array([exposure_middle(camera, frame) for frame in there])
        try:
            mounts[name], moves[name] = fixed_mount(name, camera.world_from_camera, drive.world_from_ego, times)
        except OutputError as fault:
            said.append(f"{fault}: it is left out")
    ahead = sorted(mounts, key=lambda name: -float(mounts[name][0, 2]))
    for name in ahead:
        turned = float(np.abs(mounts[name][:3, :3] - mounts[ahead[0]][:3, :3]).max())
        if turned > FIXED_RAD or len(raw.cameras) == len(NUMBERS):
            said.append(f"{name}: is left out, KITTI's cameras look where {ahead[0]} does")
            continue
        camera = drive.cameras[name]
        said.append(moves[name])
        rectification = rectification_of(camera)
        if rectification is not None:
            said.append(rectification.about)
        model = camera.model if rectification is None else rectification.model
        frames = _of_turns(raw, {frame: exposure_middle(camera, frame) for frame in log.image_frames(name)})
        alone = len(log.image_frames(name)) - len(frames)
        if alone:
            said.append(f"{name}: {alone} images have no turn of the LiDAR of their own and are left out")
        number = NUMBERS[len(raw.cameras)]
        raw.cameras.append(_Camera(name, number, mounts[name], model, rectification, frames))
    return said


def _of_turns(raw: _Raw, times_s: dict[int, float]) -> dict[int, int]:
    """The frame of each turn's image: the nearest to its look ahead, at most half a turn away, each once."""
    pairs = [
        (abs(time - cut.turn[1]), turn, frame)
        for turn, cut in enumerate(raw.cuts)
        for frame, time in times_s.items()
        if abs(time - cut.turn[1]) <= (cut.turn[2] - cut.turn[0]) / 2
    ]
    found: dict[int, int] = {}
    for _, turn, frame in sorted(pairs):
        if turn not in found and frame not in found.values():
            found[turn] = frame
    return found


def _turn_part(raw: _Raw, turn: int, read: Callable[[int], Sweep]) -> Part:
    file = f"{DRIVE}/velodyne_points/data/{turn:010d}.bin"

    def write(tick: Tick) -> None:
        cut = raw.cuts[turn]
        points = points_of(cut, raw.cuts, raw.lidar, read)
        write_file(raw.root / file, points.tobytes())
        tick()

    return Part((file,), write)


def _image_part(raw: _Raw, camera: _Camera, turn: int) -> Part:
    file = f"{DRIVE}/image_{camera.number}/data/{turn:010d}.png"

    def write(tick: Tick) -> None:
        content = image_file(raw.log, camera.name, camera.frames[turn], "png", camera.rectification)
        write_file(raw.root / file, content)
        tick()

    return Part((file,), write)


def _finish(raw: _Raw) -> None:
    path, drive = raw.path, raw.drive
    turns = [cut.turn for cut in raw.cuts]
    for end, name in enumerate(("timestamps_start.txt", "timestamps.txt", "timestamps_end.txt")):
        write_stamps(path / "velodyne_points" / name, [turn[end] for turn in turns])
    shutters = {}
    for camera in raw.cameras:
        own = drive.cameras[camera.name]
        times = [
            exposure_middle(own, camera.frames[turn]) if turn in camera.frames else turns[turn][1]
            for turn in range(len(turns))
        ]
        write_stamps(path / f"image_{camera.number}/timestamps.txt", [time + IMAGE_LAG_S for time in times])
        shutters[f"image_{camera.number}"] = RollingShutter(own.model.shutter.duration_s, 0.5, own.model.shutter.axis)
    ahead = np.array([turn[1] for turn in turns])
    for number, line in enumerate(oxts_lines(drive.world_from_ego, ahead)):
        write_file(path / f"oxts/data/{number:010d}.txt", line.encode())
    write_stamps(path / "oxts/timestamps.txt", ahead.tolist())
    _write_calibration(raw)
    write_file(path / "tracklet_labels.xml", tracklets_xml(_tracklets(raw)).encode())
    # what the layout leaves to be fitted, which way the LiDAR turns and its beams, and shutters
    setup = LidarSetup(0, raw.mount, _stated_table(raw))
    write_setup(
        path, LogSetup(drive.name, tuple(range(len(turns))), float(ahead[0]), np.zeros(3), shutters, {LIDAR: setup})
    )


def _stated_table(raw: _Raw) -> LidarModel:
    """The beam table of turns that begin backward; without beams where those of the drive do not meet in a point, or its columns
    are not even: then they are fitted to the points."""
    model, sweep = raw.lidar.model, raw.log.sweep(raw.lidar.sensor_id, raw.cuts[0].frames[0])
    apart = sweep.origins - raw.lidar.world_from_lidar.positions_at(sweep.time_s)
    even = model.column_azimuth_rad is None and raw.lidar.phase is None
    if not even or np.abs(apart).max(initial=0) > MEET_M:
        return replace(model, elevation_rad=np.zeros(0), azimuth_offset_rad=np.zeros(0), **_NO_TABLES)
    step = 2 * np.pi / model.columns
    beside = (model.start_azimuth_rad - np.pi + step / 2) % step - step / 2
    return replace(
        model,
        start_azimuth_rad=float(np.pi),
        azimuth_offset_rad=model.azimuth_offset_rad + beside,
        time_offset_s=model.sweep_s / 2,
        **_NO_TABLES,
    )


_NO_TABLES: dict[str, Any] = {"column_azimuth_rad": None, "column_time_s": None, "beam_time_s": None}


def _write_calibration(raw: _Raw) -> None:
    first = raw.cameras[0].mount if raw.cameras else raw.mount
    models = {camera.number: camera.model for camera in raw.cameras}
    shifts = {camera.number: (invert_pose(first) @ camera.mount)[:3, 3] for camera in raw.cameras}
    spare = next(iter(models.values()), CameraModel(1242, 375, 721.5, 721.5, 621.0, 187.5))
    write_calibration(
        raw.root / DAY,
        invert_pose(raw.mount),
        invert_pose(first) @ raw.mount,
        {number: models.get(number, spare) for number in sorted(NUMBERS)},
        {number: shifts.get(number, np.zeros(3)) for number in NUMBERS},
    )


def _tracklets(raw: _Raw) -> list[Tracklet]:
    """The drive's boxes, each where it was as the beams of a turn passed it."""
    tracklets = []
    track, direction = raw.lidar.world_from_lidar, raw.lidar.model.direction
    for actor in raw.drive.labelled_actors:
        current: Tracklet | None = None
        for number, cut in enumerate(raw.cuts):
            time = cut.turn[1]
            for _ in range(BOX_ROUNDS):
                pose = invert_pose(track.at(time)) @ actor.world_from_actor.at(time)
                time = time_in_turn(pose[:3, 3], cut.turn, direction)
            pose = invert_pose(track.at(time)) @ actor.world_from_actor.at(time)
            if not actor.present(time):
                current = None
                continue
            if current is None:
                current = Tracklet(actor.label, actor.size_m, number, [])
                tracklets.append(current)
            bottom = pose[:3, 3] - [0, 0, float(actor.size_m[2]) / 2]
            current.boxes.append((bottom, float(np.arctan2(pose[1, 0], pose[0, 0]))))
    return tracklets


register(KittiLogWriter())
