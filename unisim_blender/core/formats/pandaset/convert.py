"""Writes PandaSet's layout, image by image and sweep by sweep."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ...data.log import Log, Sweep
from ...world.drive import Drive, Lidar
from ..common.class_names import renamed, renamed_sentence
from ..common.image_bytes import image_file, path_kind
from ..common.writer import Tick, WritePlan, WriterPart
from .write import PandasetWriter

UPRIGHT = 1 - float(np.cos(np.radians(2.0)))
"""A box whose axis is off the vertical by more than 2 degrees loses a tilt worth telling."""
STEADY_S = 2e-6
"""A LiDAR's stamps keep step with the frames' where they differ by a number that varies by less than this."""


class PandasetLogWriter:
    """Plans logs in PandaSet's layout."""

    name = "pandaset"
    about = "PandaSet, with lenses, shutters and beam tables in meta/unisim.json"
    version = 1

    def plan(self, log: Log, path: Path) -> WritePlan:
        """Plan the log's files. Raises `OutputError` for a LiDAR that does not ride on the vehicle."""
        drive, losses = _framed(log.drive)
        drive, labels = renamed(drive, "pandaset")
        writer = PandasetWriter(path, drive)
        parts: list[WriterPart] = []
        frames = set(drive.frames)
        losses += _losses(log, drive, renamed_sentence(labels))
        for name in drive.cameras:
            there = log.image_frames(name)
            parts += [_image(log, writer, name, frame) for frame in there if frame in frames]
        of_lidars = {name: set(log.sweep_frames(name)) for name in drive.lidars}
        for frame in drive.frames:
            names = [name for name, there in of_lidars.items() if frame in there]
            if names:
                parts.append(_sweeps(log, writer, names, frame))
            parts.append(_boxes(writer, frame))
        return WritePlan(tuple(losses), parts, writer.finish)


def _image(log: Log, writer: PandasetWriter, camera: str, frame: int) -> WriterPart:
    def write(tick: Tick) -> None:
        writer.write_encoded_image(camera, frame, image_file(log, camera, frame, "jpeg"))
        tick()

    return WriterPart((writer.image_path(camera, frame).relative_to(writer.path).as_posix(),), write)


def _sweeps(log: Log, writer: PandasetWriter, lidars: list[str], frame: int) -> WriterPart:
    def write(tick: Tick) -> None:
        sweeps: dict[str, Sweep] = {}
        for name in lidars:
            sweeps[name] = log.sweep(name, frame)
            tick()
        writer.write_sweep(frame, sweeps)

    return WriterPart((writer.sweep_path(frame).relative_to(writer.path).as_posix(),), write, len(lidars))


def _boxes(writer: PandasetWriter, frame: int) -> WriterPart:
    file = writer.cuboids_path(frame).relative_to(writer.path).as_posix()
    return WriterPart((file,), lambda tick: writer.write_cuboids(frame), 0)


def _framed(drive: Drive) -> tuple[Drive, list[str]]:
    """The drive with LiDARs stamped as the frames are, and what that loses."""
    lidars, losses = {}, []
    for name, lidar in drive.lidars.items():
        frames = [frame for frame in drive.frames if frame in lidar.time_s]
        if not frames:
            continue
        late = np.array([lidar.time_s[frame] - drive.time_s[frame] for frame in frames])
        if np.ptp(late) > STEADY_S:
            losses.append(
                f"{name}: its sweeps' own stamps are not kept, which differ from the frames' by up to "
                f"{1e3 * float(np.abs(late).max()):.1f} ms; its points keep their times"
            )
        lidars[name] = _restamped(lidar, drive, float(np.median(late)))
    return replace(drive, lidars=lidars), losses


def _restamped(lidar: Lidar, drive: Drive, late_s: float) -> Lidar:
    if late_s == 0:
        return lidar
    model = replace(lidar.model, time_offset_s=lidar.model.time_offset_s + late_s)
    phase = None if lidar.phase is None else replace(lidar.phase, times_s=lidar.phase.times_s - late_s)
    time_s = {frame: drive.time_s[frame] for frame in lidar.time_s if frame in drive.time_s}
    return replace(lidar, model=model, phase=phase, time_s=time_s)


def _losses(log: Log, drive: Drive, renamed_labels: str) -> list[str]:
    losses = [renamed_labels] if renamed_labels else []
    frames = set(drive.frames)
    for name in drive.cameras:
        there = log.image_frames(name)
        between = sum(frame not in frames for frame in there)
        if between:
            losses.append(f"{name}: {between} of {len(there)} images lie between frames and are left out")
        kept = [frame for frame in there if frame in frames]
        if kept and path_kind(log.image_path(name, kept[0])) != "jpeg":
            losses.append(f"{name}: its images are packed again, as JPEG")
    for name in drive.lidars:
        between = sum(frame not in frames for frame in log.sweep_frames(name))
        if between:
            losses.append(f"{name}: {between} sweeps lie between frames and are left out")
    up = np.concatenate([a.world_from_actor.poses[:, 2, 2] for a in drive.actors.values()] or [np.ones(1)])
    if float(up.min()) < 1 - UPRIGHT:
        losses.append("boxes keep their heading alone, not their tilt")
    return losses
