"""Writes NCore V4, a store for each sensor: an interrupted conversion goes on with the first sensor that is not complete."""

from __future__ import annotations

from pathlib import Path

from ...data.images import encoded_image
from ...data.log import Log, extras_of
from ...data.sweep_cells import with_drops
from ..common.rigs import moved
from ..common.writer import Tick, WritePlan, WriterPart
from .poses import OWN
from .write import SHARED, NcoreWriter, store_file, write_index


class NcoreLogWriter:
    """Plans NCore sequences."""

    name = "ncore"
    about = "NVIDIA NCore V4 (needs nvidia-ncore)"
    version = 2

    def plan(self, log: Log, path: Path) -> WritePlan:
        """Plan the stores. Raises `OutputError`, ModuleNotFoundError where `nvidia-ncore` is not installed."""
        drive = log.drive
        # what NCore has no place for is said before anything is written
        writer = NcoreWriter(path, drive, only=SHARED)
        writer.discard()
        losses = [
            f"{name}: its mount, which moves by up to {moved(mount.off_m, mount.off_rad)} beside the vehicle, is its mean; its "
            f"own poses are those of the frame {OWN}{name}"
            if mount is not None
            else f"{name}: does not ride on the vehicle and has poses over time: NCore's T_sensor_rig is not there for it"
            for name, mount in writer.mounts.items()
            if mount is None or mount.off_m > 0 or mount.off_rad > 0
        ]
        parts = [WriterPart((store_file(drive, SHARED),), lambda tick: _write_shared(log, path), 0)]
        for name in drive.cameras:
            if frames := log.image_frames(name):
                parts.append(WriterPart((store_file(drive, name),), _Sensor(log, path, name, frames), len(frames)))
        for name in drive.lidars:
            if frames := log.sweep_frames(name):
                parts.append(WriterPart((store_file(drive, name),), _Sensor(log, path, name, frames), len(frames)))
        return WritePlan(tuple(losses), parts, lambda: write_index(path, drive))


class _Sensor:
    """Writes a sensor's store."""

    def __init__(self, log: Log, path: Path, name: str, frames: tuple[int, ...]) -> None:
        self._log, self._path, self._name, self._frames = log, path, name, frames

    def __call__(self, tick: Tick) -> None:
        log, name = self._log, self._name
        with NcoreWriter(self._path, log.drive, classes=extras_of(log).classes, only=name) as writer:
            for frame in self._frames:
                if name in log.drive.cameras:
                    writer.write_image(name, frame, encoded_image(log, name, frame))
                else:
                    writer.write_sweep(name, frame, with_drops(log, name, frame))
                tick()


def _write_shared(log: Log, path: Path) -> None:
    extras = extras_of(log)
    with NcoreWriter(path, log.drive, classes=extras.classes, only=SHARED) as writer:
        for name in log.drive.cameras:
            mask = extras.own_vehicle_mask(name)
            if mask is not None:
                writer.write_mask(name, mask)
