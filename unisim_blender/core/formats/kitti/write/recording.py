"""A drive as KITTI's car would have recorded it: turns of one LiDAR, cameras that look the same way, an image for each turn.

A drive's own sweeps may begin anywhere, so a turn has returns of two or three of them. The layout gives a point the time at
which the sensor looked where the point lies; points are written as they were in the sensor's frame at that time, so that they
come back to where they were in the world, also where a beam looks beside its column.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....data.log import Log, Sweep
from ....errors import OutputError
from ....files import write_file
from ....geometry import FloatArray, invert_pose
from ....sensors.lidar import column_times
from ....world.drive import Actor, CameraModel, Drive, Lidar, LidarModel
from ....world.replay import over_whole_frames
from ...common.class_names import renamed, renamed_sentence
from ...common.image_bytes import Rectification, image_file, rectification_of
from ...common.rigs import (
    FIXED_RAD,
    camera_mounts,
    exposure_middle,
    fixed_mount,
    looking_time,
    mid_exposure_shutter,
    nearest_rings,
    turning_lidar,
)
from ...common.sensor_file import LidarSetup, LogSetup, write_setup
from ...common.writer import Tick, WritePlan, WriterPart
from .. import VELODYNE
from ..beams import MEET_M, Turn, point_times
from ..files import IMAGE_LAG_S
from ..read import LIDAR
from .files import DAY, Tracklet, oxts_lines, tracklets_xml, write_calibration, write_stamps

LEAST_COVERED = 0.5
"""A turn of which sweeps cover less is left out: at the drive's ends, and where sweeps are missing."""
ROUNDS = 3
"""Where the sensor is depends on the time, by so little that a round or two would do."""
SEAM = 0.1
"""Beams look beside their columns by less than this share of a turn."""


@dataclass(frozen=True)
class Cut:
    """A turn: when the LiDAR looked backward, forward and backward again, seconds, and the frames whose sweeps it lies in."""

    turn: Turn
    frames: tuple[int, ...]


def cut_turns(lidar: Lidar, frames: Sequence[int]) -> list[Cut]:
    """Return the turns that the sweeps of some frames, in order, cover."""
    spans = {frame: _span(lidar, frame) for frame in frames}
    backward = {frame: looking_time(lidar, frame, np.pi) for frame in frames}
    forward = sorted(looking_time(lidar, frame, 0.0) for frame in frames)
    sweep_s = lidar.model.sweep_s
    ends: list[tuple[float, float]] = []
    for at, frame in enumerate(frames):
        if not at or backward[frame] - backward[frames[at - 1]] > 1.5 * sweep_s:
            ends.append((backward[frame] - sweep_s, backward[frame]))
        following = frames[at + 1] if at + 1 < len(frames) else None
        after = backward[frame] + sweep_s
        if following is not None and backward[following] - backward[frame] <= 1.5 * sweep_s:
            after = backward[following]
        ends.append((backward[frame], after))
    cuts = []
    for start, end in ends:
        inside = [time for time in forward if start < time < end]
        middle = inside[0] if inside else (start + end) / 2
        shares = {frame: min(end, span[1]) - max(start, span[0]) for frame, span in spans.items()}
        if sum(share for share in shares.values() if share > 0) >= LEAST_COVERED * (end - start):
            # beams that look beside their columns pass the seam in the sweeps before and after
            near = tuple(frame for frame, share in shares.items() if share > -SEAM * sweep_s)
            cuts.append(Cut((start, middle, end), near))
    return cuts


def points_of(cut: Cut, cuts: Sequence[Cut], lidar: Lidar, read: Callable[[int], Sweep]) -> NDArray[np.float32]:
    """Return a turn's file, float32 (N, 4): x, y, z in the sensor's frame at each point's own time, intensity 0..1; ring by ring,
    the upper first, counter-clockwise from ahead. ``read`` gives a frame's sweep; of several returns the strongest is taken."""
    turns = [other.turn for other in cuts if abs(other.turn[1] - cut.turn[1]) < 3 * lidar.model.sweep_s]
    margin = SEAM * lidar.model.sweep_s
    parts, rings = [], []
    for frame in cut.frames:
        sweep = read(frame)
        in_turn = (sweep.time_s > cut.turn[0] - margin) & (sweep.time_s < cut.turn[2] + margin)
        if sweep.rank is not None:
            in_turn &= sweep.rank == 0
        local, turn = _placed(sweep.points[in_turn], sweep.time_s[in_turn], lidar, turns)
        mine = turn == turns.index(cut.turn)
        parts.append(np.column_stack([local[mine], sweep.intensity[in_turn][mine]]))
        rings.append(nearest_rings(sweep.ring[in_turn][mine], local[mine], lidar))
    if not parts:
        return np.zeros((0, 4), np.float32)
    points, ring = np.concatenate(parts), np.concatenate(rings)
    azimuth = np.arctan2(points[:, 1], points[:, 0]) % (2 * np.pi)
    return np.asarray(points[np.lexsort((azimuth, ring))], "<f4")


def time_in_turn(centre: FloatArray, turn: Turn, direction: int) -> float:
    """Return when a turn's beams pass a point (3,) of the sensor's frame."""
    return float(point_times(centre[None], turn, direction)[0])


def _placed(
    points: FloatArray, times: FloatArray, lidar: Lidar, turns: Sequence[Turn]
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Points (N, 3) in the sensor's frame at the times that the layout gives them, each in the turn in which that is nearest to
    when it was measured: (N,), -1 where none is within half a turn."""
    stated, turn, rows = times, np.zeros(len(points), np.int64), np.arange(len(points))
    for last in range(ROUNDS, -1, -1):
        poses = lidar.world_from_lidar.at(stated)
        local = np.einsum("nji,nj->ni", poses[:, :3, :3], points - poses[:, :3, 3])
        if last:
            ways = np.stack([point_times(local, candidate, lidar.model.direction) for candidate in turns], 1)
            turn = np.abs(ways - times[:, None]).argmin(1)
            stated = ways[rows, turn]
    near = np.abs(stated - times) < lidar.model.sweep_s / 2
    return local, np.where(near, turn, -1)


def _span(lidar: Lidar, frame: int) -> tuple[float, float]:
    times = column_times(lidar, lidar.time_s[frame])
    half = (times[-1] - times[0]) / max(len(times) - 1, 1) / 2
    return float(times[0] - half), float(times[-1] + half)


BOX_ROUNDS = 6
CACHED_SWEEPS = 4


@dataclass
class RecordingCamera:
    """A camera: its name in the drive, its number ("02"), mount, model in the calibration, and its image's frame by turn."""

    name: str
    number: str
    mount: FloatArray
    model: CameraModel
    rectification: Rectification | None
    frames: dict[int, int]


@dataclass
class KittiRecording:
    """Data that the files of a drive are derived from. ``losses``: a sentence for each thing of the log that they
    cannot say."""

    log: Log
    drive: Drive
    lidar: Lidar
    mount: FloatArray
    cuts: list[Cut]
    cameras: list[RecordingCamera] = field(default_factory=list)
    losses: list[str] = field(default_factory=list)

    @property
    def ahead_s(self) -> FloatArray:
        """When the LiDAR looked ahead, by turn (T,)."""
        return np.array([cut.turn[1] for cut in self.cuts])

    @property
    def first_mount(self) -> FloatArray:
        """The pose (4, 4) on the vehicle of the camera in whose frame the calibration is; the LiDAR's where there is none."""
        return self.cameras[0].mount if self.cameras else self.mount

    def image_time_s(self, camera: RecordingCamera, turn: int) -> float:
        """Return the middle of the exposure of a turn's image; where it has none, when the LiDAR looked ahead."""
        if turn not in camera.frames:
            return float(self.cuts[turn].turn[1])
        return exposure_middle(self.drive.cameras[camera.name], camera.frames[turn])

    def lidar_from_box(self, actor: Actor, turn: int) -> FloatArray | None:
        """Return an actor's pose (4, 4) in the LiDAR's frame as the beams of a turn passed it; None where it was not there."""
        cut, track = self.cuts[turn], self.lidar.world_from_lidar
        if actor.end_s < cut.turn[0] or actor.start_s > cut.turn[2]:
            return None
        time = cut.turn[1]
        for _ in range(BOX_ROUNDS):
            pose = invert_pose(track.at(time)) @ actor.world_from_actor.at(time)
            time = time_in_turn(pose[:3, 3], cut.turn, self.lidar.model.direction)
        return invert_pose(track.at(time)) @ actor.world_from_actor.at(time) if actor.present(time) else None

    def camera_models(self, numbers: Sequence[str]) -> dict[str, CameraModel]:
        """Return models by number; of numbers that no camera has, the first camera's, or the dataset's own."""
        models = {camera.number: camera.model for camera in self.cameras}
        spare = next(iter(models.values()), CameraModel(1242, 375, 721.5, 721.5, 621.0, 187.5))
        return {number: models.get(number, spare) for number in sorted(numbers)}

    def camera_shifts_m(self, numbers: Sequence[str]) -> dict[str, FloatArray]:
        """Return cameras' places (3,) in the first one's frame by number; of numbers that no camera has, zeros."""
        places = {camera.number: (invert_pose(self.first_mount) @ camera.mount)[:3, 3] for camera in self.cameras}
        return {number: places.get(number, np.zeros(3)) for number in numbers}


def plan_recording(log: Log, numbers: Sequence[str]) -> KittiRecording:
    """Return what is written of a log, by cameras numbered in that order.

    Raises `OutputError` without a LiDAR that turns, or for one that does not ride on the vehicle.
    """
    drive, labels = renamed(over_whole_frames(log.drive), "kitti")
    lidar, losses = turning_lidar(log, "KITTI")
    cuts = cut_turns(lidar, log.sweep_frames(lidar.sensor_id))
    if not cuts:
        raise OutputError(f"{log.path}: {lidar.sensor_id}'s sweeps cover no turn from backward to backward")
    times = np.array([cut.turn[1] for cut in cuts])
    mount, moves = fixed_mount(lidar.sensor_id, lidar.world_from_lidar, drive.world_from_ego, times)
    recording = KittiRecording(log, drive, lidar, mount, cuts)
    said = [*losses, renamed_sentence(labels), moves, *_plan_cameras(recording, numbers)]
    recording.losses = list(filter(None, said))
    return recording


def recording_parts(
    recording: KittiRecording,
    root: Path,
    sweep_file: Callable[[int], str],
    image_file_of: Callable[[str, int], str],
    turns: Sequence[int] | None = None,
) -> list[WriterPart]:
    """Return the parts of turns, all or ``turns``, and images; files below ``root`` are named by turn, images' by camera's number
    and turn."""
    log, lidar = recording.log, recording.lidar.sensor_id
    read = lru_cache(maxsize=CACHED_SWEEPS)(lambda frame: log.sweep(lidar, frame))
    parts = []
    for turn in range(len(recording.cuts)) if turns is None else turns:
        parts.append(_turn_part(recording, turn, root, sweep_file(turn), read))
        for camera in recording.cameras:
            if turn in camera.frames:
                parts.append(_image_part(recording, camera, turn, root, image_file_of(camera.number, turn)))
    return parts


def write_beside(recording: KittiRecording, folder: Path) -> None:
    """Write what all of KITTI's layouts leave to be guessed into a folder: `meta/unisim.json` with which way the LiDAR turns, its
    beams, and cameras' shutters."""
    shutters = {
        f"image_{camera.number}": mid_exposure_shutter(recording.drive.cameras[camera.name])
        for camera in recording.cameras
    }
    setup = LidarSetup(0, recording.mount, _stated_table(recording))
    ahead = recording.ahead_s
    frames = tuple(range(len(ahead)))
    lidars = {LIDAR: setup}
    write_setup(folder, LogSetup(recording.drive.name, frames, float(ahead[0]), np.zeros(3), shutters, lidars))


def write_all_stamps(recording: KittiRecording, folder: Path) -> None:
    """Write when turns began, looked ahead and ended, when images were stamped and when the IMU's records are of."""
    turns = [cut.turn for cut in recording.cuts]
    for end, name in enumerate(("timestamps_start.txt", "timestamps.txt", "timestamps_end.txt")):
        write_stamps(folder / VELODYNE / name, [turn[end] for turn in turns])
    for camera in recording.cameras:
        times = [recording.image_time_s(camera, turn) + IMAGE_LAG_S for turn in range(len(turns))]
        write_stamps(folder / f"image_{camera.number}/timestamps.txt", times)
    write_stamps(folder / "oxts/timestamps.txt", recording.ahead_s.tolist())


def _plan_cameras(recording: KittiRecording, numbers: Sequence[str]) -> list[str]:
    """Fill in the cameras; gives what they lose. The layout's cameras all look the same way."""
    said: list[str] = []
    log, drive = recording.log, recording.drive
    mounts: dict[str, FloatArray] = {}
    moves: dict[str, str] = {}
    for name, (mount, sentence) in camera_mounts(log).items():
        if mount is None:
            said.append(sentence)
        else:
            mounts[name], moves[name] = mount, sentence
    ahead = sorted(mounts, key=lambda name: -float(mounts[name][0, 2]))
    for name in ahead:
        turned = float(np.abs(mounts[name][:3, :3] - mounts[ahead[0]][:3, :3]).max())
        if turned > FIXED_RAD:
            said.append(f"{name}: is left out, KITTI's cameras look where {ahead[0]} does")
            continue
        if len(recording.cameras) == len(numbers):
            said.append(f"{name}: is left out, the layout has {len(numbers)} cameras")
            continue
        camera = drive.cameras[name]
        said.append(moves[name])
        rectification = rectification_of(camera)
        if rectification is not None:
            said.append(rectification.about)
        model = camera.model if rectification is None else rectification.model
        frames = _of_turns(recording, {frame: exposure_middle(camera, frame) for frame in log.image_frames(name)})
        alone = len(log.image_frames(name)) - len(frames)
        if alone:
            said.append(f"{name}: {alone} images have no turn of the LiDAR of their own and are left out")
        number = numbers[len(recording.cameras)]
        recording.cameras.append(RecordingCamera(name, number, mounts[name], model, rectification, frames))
    return said


def _of_turns(recording: KittiRecording, times_s: dict[int, float]) -> dict[int, int]:
    """The frame of each turn's image: the nearest to its look ahead, at most half a turn away, each once."""
    pairs = [
        (abs(time - cut.turn[1]), turn, frame)
        for turn, cut in enumerate(recording.cuts)
        for frame, time in times_s.items()
        if abs(time - cut.turn[1]) <= (cut.turn[2] - cut.turn[0]) / 2
    ]
    images: dict[int, int] = {}
    for _, turn, frame in sorted(pairs):
        if turn not in images and frame not in images.values():
            images[turn] = frame
    return images


def _turn_part(recording: KittiRecording, turn: int, root: Path, file: str, read: Callable[[int], Sweep]) -> WriterPart:
    def write(tick: Tick) -> None:
        points = points_of(recording.cuts[turn], recording.cuts, recording.lidar, read)
        write_file(root / file, points.tobytes())
        tick()

    return WriterPart((file,), write)


def _image_part(recording: KittiRecording, camera: RecordingCamera, turn: int, root: Path, file: str) -> WriterPart:
    def write(tick: Tick) -> None:
        content = image_file(recording.log, camera.name, camera.frames[turn], "png", camera.rectification)
        write_file(root / file, content)
        tick()

    return WriterPart((file,), write)


def _stated_table(recording: KittiRecording) -> LidarModel:
    """The beam table of turns that begin backward; without beams where those of the drive do not meet in a point, or its columns
    are not even: then they are fitted to the points."""
    lidar = recording.lidar
    model, sweep = lidar.model, recording.log.sweep(lidar.sensor_id, recording.cuts[0].frames[0])
    apart = sweep.origins - lidar.world_from_lidar.positions_at(sweep.time_s)
    even = model.column_azimuth_rad is None and lidar.phase is None
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
DRIVE = f"{DAY}/{DAY}_drive_0001_sync"
NUMBERS = ("02", "03", "00", "01")
"""Of cameras, in the order in which they are given: the dataset's colour cameras first."""


class KittiLogWriter:
    """Plans raw drives in KITTI's layout."""

    name = "kitti"
    about = "KITTI raw with tracklets, one LiDAR, cameras that look ahead"
    version = 2

    def plan(self, log: Log, path: Path) -> WritePlan:
        """Plan the drive. Raises `OutputError` without a LiDAR that turns, or for one that does not ride on the vehicle."""
        recording = plan_recording(log, NUMBERS)
        parts = recording_parts(
            recording,
            path,
            lambda turn: f"{DRIVE}/{VELODYNE}/data/{turn:010d}.bin",
            lambda number, turn: f"{DRIVE}/image_{number}/data/{turn:010d}.png",
        )
        return WritePlan(tuple(recording.losses), parts, lambda: _finish(recording, path), DRIVE)


def _finish(recording: KittiRecording, root: Path) -> None:
    path = root / DRIVE
    write_all_stamps(recording, path)
    for number, line in enumerate(oxts_lines(recording.drive.world_from_ego, recording.ahead_s)):
        write_file(path / f"oxts/data/{number:010d}.txt", line.encode())
    write_calibration(
        root / DAY,
        invert_pose(recording.mount),
        invert_pose(recording.first_mount) @ recording.mount,
        recording.camera_models(NUMBERS),
        recording.camera_shifts_m(NUMBERS),
    )
    write_file(path / "tracklet_labels.xml", tracklets_xml(_tracklets(recording)).encode())
    write_beside(recording, path)


def _tracklets(recording: KittiRecording) -> list[Tracklet]:
    """The drive's boxes, each where it was as the beams of a turn passed it."""
    tracklets = []
    for actor in recording.drive.labelled_actors:
        current: Tracklet | None = None
        for turn in range(len(recording.cuts)):
            pose = recording.lidar_from_box(actor, turn)
            if pose is None:
                current = None
                continue
            if current is None:
                current = Tracklet(actor.label, actor.size_m, turn, [])
                tracklets.append(current)
            bottom = pose[:3, 3] - [0, 0, float(actor.size_m[2]) / 2]
            current.boxes.append((bottom, float(np.arctan2(pose[1, 0], pose[0, 0]))))
    return tracklets
