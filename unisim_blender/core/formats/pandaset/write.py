"""Writes a drive as a log in PandaSet's layout, frame by frame: equal input gives equal bytes.

    writer = PandasetWriter(path, drive)
    writer.write_image("front_camera", frame, rgb)
    writer.write_sweep(frame, {"pandar64": sweep})
    writer.write_cuboids(frame)
    writer.finish()

A log that was never finished has no timestamps, and no reader takes it for a whole one. There is no `meta/gps.json`:
where on earth a drive took place is not known here.

The pickle is put together from its instructions, in the form that pandas 0.25 wrote: a class is only its name there.
Equal tables give equal bytes.
"""

from __future__ import annotations

import gzip
import json
import pickle
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...data.log import Log, Sweep
from ...errors import OutputError
from ...files import write_file
from ...geometry import FloatArray, Trajectory, invert_pose, make_pose, quaternion_from_matrix
from ...sensors.frames import LidarFrame
from ...world.drive import Drive, Lidar
from ..common.class_names import renamed, renamed_sentence
from ..common.image_bytes import encoded_for, image_file, path_kind
from ..common.sensor_file import LidarSetup, LogSetup, write_setup
from ..common.writer import Tick, WritePlan, WriterPart
from .safe_pickle import PickledTable
from .sensors import DEVICES, PANDASET_EGO_FROM_EGO_WXYZ

_RECONSTRUCTED = b"cnumpy.core.multiarray\n_reconstruct\n"
_NDARRAY = b"cnumpy\nndarray\n"
_DTYPE = b"cnumpy\ndtype\n"
_FRAME = b"cpandas.core.frame\nDataFrame\n"
_MANAGER = b"cpandas.core.internals.managers\nBlockManager\n"
_NEW_INDEX = b"cpandas.core.indexes.base\n_new_Index\n"
_INDEX = b"cpandas.core.indexes.base\nIndex\n"
_RANGE = b"cpandas.core.indexes.range\nRangeIndex\n"
_SLICE = b"cbuiltins\nslice\n"
_CALL, _NEW, _BUILD = b"R", b"\x81", b"b"
COMPRESSION = 6


def write_table(path: Path, table: PickledTable) -> None:
    """Write columns (N,) by name: numbers and booleans as they are, everything else as Python objects
    (str, float nan)."""
    write_file(path, gzip.compress(table_pickle(table), COMPRESSION, mtime=0))


def table_pickle(table: PickledTable) -> bytes:
    """The pickle of the table, protocol 3."""
    rows = len(next(iter(table.values()))) if table else 0
    labels = _tuple(_INDEX, _dict({"data": _array(np.array(list(table), object)), "name": _plain(None)}))
    limits = {"name": None, "start": 0, "stop": rows, "step": 1}
    row_index = _tuple(_RANGE, _dict({key: _plain(value) for key, value in limits.items()}))
    axes = _list(_NEW_INDEX + labels + _CALL, _NEW_INDEX + row_index + _CALL)
    blocks = _list(
        *(
            _dict({"values": _array(np.asarray(column)[None]), "mgr_locs": _SLICE + _plain((i, i + 1, 1)) + _CALL})
            for i, column in enumerate(table.values())
        )
    )
    content = _dict({"0.14.1": _dict({"axes": axes, "blocks": blocks})})
    manager = _MANAGER + b")" + _NEW + _tuple(axes, _plain([]), _plain([]), content) + _BUILD
    state = _dict({"_data": manager, "_typ": _plain("dataframe"), "_metadata": _plain([])})
    return b"\x80\x03" + _FRAME + b")" + _NEW + state + _BUILD + b"."


def _array(array: NDArray[Any]) -> bytes:
    """Instructions that leave a numpy array."""
    empty = _RECONSTRUCTED + _tuple(_NDARRAY, _plain((0,)), _plain(b"b")) + _CALL
    if array.dtype.kind in "biuf":
        little = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        order = "|" if little.dtype.itemsize == 1 else "<"
        kind, data = _dtype(little.dtype.kind + str(little.dtype.itemsize), order, 0), _plain(little.tobytes())
    else:
        kind, data = _dtype("O8", "|", 63), _plain(array.ravel().tolist())
    return empty + _tuple(_plain(1), _plain(array.shape), kind, _plain(False), data) + _BUILD


def _dtype(code: str, order: str, flags: int) -> bytes:
    return _DTYPE + _plain((code, False, True)) + _CALL + _plain((3, order, None, None, None, -1, -1, flags)) + _BUILD


def _plain(value: Any) -> bytes:
    """Instructions that leave a value of built-in types alone."""
    return pickle.dumps(value, 3)[2:-1]


def _tuple(*parts: bytes) -> bytes:
    return b"(" + b"".join(parts) + b"t"


def _list(*parts: bytes) -> bytes:
    return b"](" + b"".join(parts) + b"e"


def _dict(parts: dict[str, bytes]) -> bytes:
    return b"}(" + b"".join(_plain(key) + part for key, part in parts.items()) + b"u"


MOUNT_TOLERANCE_M = 1e-3
"""A LiDAR further from its mount than this, at any frame, does not ride on the vehicle."""


class PandasetWriter:
    """Writes ``drive`` to the folder ``path``.

    ``start_s`` is added to every time: PandaSet's are Unix seconds, and from 0 on they keep all their digits.
    """

    def __init__(self, path: Path, drive: Drive, start_s: float = 0.0) -> None:
        self.path = Path(path)
        self.drive = drive
        self._start_s = start_s
        self._count = max(drive.frames) + 1
        self._mounts = {name: self._mount(name) for name in drive.lidars}
        free = (n for n in range(len(DEVICES) + len(drive.lidars)) if n not in DEVICES.values())
        self._devices = {name: DEVICES[name] if name in DEVICES else next(free) for name in drive.lidars}

    def write_image(self, camera: str, frame: int, rgb: NDArray[np.uint8]) -> None:
        """An image (H, W, 3), sRGB, of the size of the camera's model."""
        self.write_encoded_image(camera, frame, encoded_for(self.drive.cameras[camera], rgb))

    def write_encoded_image(self, camera: str, frame: int, jpeg: bytes) -> None:
        """The bytes of a JPEG file of the camera's size, kept as they are."""
        write_file(self.image_path(camera, frame), jpeg)

    def image_path(self, camera: str, frame: int) -> Path:
        return self.path / "camera" / camera / f"{frame:02d}.jpg"

    def write_sweep(self, frame: int, sweeps: Mapping[str, Sweep | LidarFrame]) -> None:
        """All LiDARs' returns of a frame; semantic classes are written where every sweep has them."""
        parts = {name: sweep if isinstance(sweep, Sweep) else returns_of(sweep) for name, sweep in sweeps.items()}
        points = np.concatenate([sweep.points for sweep in parts.values()]) + self.drive.world_origin
        table: PickledTable = {axis: points[:, i] for i, axis in enumerate("xyz")}
        table["i"] = np.concatenate([sweep.intensity for sweep in parts.values()]).astype(np.float64) * 255
        table["t"] = np.concatenate([sweep.time_s for sweep in parts.values()]) + self._start_s
        table["d"] = np.concatenate([np.full(len(sweep.points), self._devices[name]) for name, sweep in parts.items()])
        classes = np.concatenate([sweep.semantic for sweep in parts.values()])
        if (classes >= 0).all():
            write_table(
                self.path / "annotations" / "semseg" / f"{frame:02d}.pkl.gz", {"class": classes.astype(np.int64)}
            )
        write_table(self.sweep_path(frame), table)  # the last: when it is there, so are the classes

    def sweep_path(self, frame: int) -> Path:
        return self.path / "lidar" / f"{frame:02d}.pkl.gz"

    def write_cuboids(self, frame: int) -> None:
        """The boxes of the actors that are there at the frame's time; PandaSet knows their yaw alone."""
        time_s = self.drive.time_s[frame]
        actors = [actor for actor in self.drive.labelled_actors if actor.present(time_s)]
        poses = np.array([actor.world_from_actor.at(time_s) for actor in actors]).reshape(-1, 4, 4)
        sizes = np.array([actor.size_m for actor in actors]).reshape(-1, 3)
        table: PickledTable = {
            "uuid": _objects([actor.uid for actor in actors]),
            "label": _objects([actor.label for actor in actors]),
            "yaw": np.arctan2(poses[:, 1, 0], poses[:, 0, 0]) - np.pi / 2,
            "stationary": np.array([not actor.is_moving for actor in actors], np.bool_),
            "camera_used": np.full(len(actors), -1),
        }
        for i, axis in enumerate("xyz"):
            table[f"position.{axis}"] = poses[:, i, 3] + self.drive.world_origin[i]
        for axis, column in (("x", 1), ("y", 0), ("z", 2)):
            table[f"dimensions.{axis}"] = sizes[:, column]
        table["attributes.object_motion"] = _objects(["Moving" if actor.is_moving else "Parked" for actor in actors])
        table["cuboids.sibling_id"] = _objects(["-"] * len(actors))
        table["cuboids.sensor_id"] = np.full(len(actors), -1)
        write_table(self.cuboids_path(frame), table)

    def cuboids_path(self, frame: int) -> Path:
        return self.path / "annotations" / "cuboids" / f"{frame:02d}.pkl.gz"

    def finish(self) -> None:
        """Write poses, timestamps, intrinsics and the setup: now it is a log."""
        drive = self.drive
        turn = make_pose(np.zeros(3), PANDASET_EGO_FROM_EGO_WXYZ * np.array([1.0, 1.0, 1.0, -1.0]))
        for name, camera in drive.cameras.items():
            model = camera.model
            folder = self.path / "camera" / name
            self._write_json(folder / "intrinsics.json", {key: getattr(model, key) for key in ("fx", "fy", "cx", "cy")})
            self._write_track(folder, camera.world_from_camera, self._times(camera.time_s))
        times = self._times(drive.time_s)
        self._write_json(self.path / "meta" / "timestamps.json", (times + self._start_s).tolist())
        devices = {
            name: LidarSetup(self._devices[name], self._mounts[name], lidar.model, lidar.phase)
            for name, lidar in drive.lidars.items()
        }
        shutters = {name: camera.model.shutter for name, camera in drive.cameras.items()}
        lenses = {name: camera.model.lens for name, camera in drive.cameras.items()}
        readouts = {name: camera.readouts for name, camera in drive.cameras.items() if camera.readouts is not None}
        origin = drive.world_origin
        setup = LogSetup(drive.name, drive.frames, self._start_s, origin, shutters, devices, lenses, readouts)
        write_setup(self.path, setup)
        self._write_track(self.path / "lidar", drive.world_from_ego.transformed(right=turn), times)

    def _write_track(self, folder: Path, world_from_sensor: Trajectory, times: FloatArray) -> None:
        poses = world_from_sensor.at(times)
        quaternions = quaternion_from_matrix(poses[:, :3, :3])
        entries = [
            {
                "position": dict(zip("xyz", (pose[:3, 3] + self.drive.world_origin).tolist(), strict=True)),
                "heading": dict(zip("wxyz", quaternion.tolist(), strict=True)),
            }
            for pose, quaternion in zip(poses, quaternions, strict=True)
        ]
        self._write_json(folder / "poses.json", entries)
        self._write_json(folder / "timestamps.json", (times + self._start_s).tolist())

    def _times(self, time_s: Mapping[int, float]) -> FloatArray:
        """A time for every frame number from 0, as the layout wants it; those not in ``time_s`` are interpolated."""
        frames = np.array(sorted(time_s), np.float64)
        times = np.array([time_s[frame] for frame in sorted(time_s)])
        if len(frames) == 1:
            frames, times = np.append(frames, frames[0] + 1), np.append(times, times[0] + 0.1)
        numbers = np.arange(self._count, dtype=np.float64)
        upper = np.clip(np.searchsorted(frames, numbers), 1, len(frames) - 1)
        rate = (times[upper] - times[upper - 1]) / (frames[upper] - frames[upper - 1])
        filled = times[upper - 1] + (numbers - frames[upper - 1]) * rate
        known = [frame for frame in time_s if frame < self._count]
        filled[known] = [time_s[frame] for frame in known]
        return np.asarray(filled)

    def _mount(self, name: str) -> FloatArray:
        """Where the LiDAR sits on the vehicle (4, 4)."""
        lidar = self.drive.lidars[name]
        times = np.array([lidar.time_s[frame] for frame in self.drive.frames if frame in lidar.time_s])
        mounts = invert_pose(self.drive.world_from_ego.at(times)) @ lidar.world_from_lidar.at(times)
        if np.abs(mounts - mounts[0]).max() > MOUNT_TOLERANCE_M:
            raise OutputError(
                f"{self.path}: {name} does not ride on the vehicle, and PandaSet's layout has no place for that"
            )
        return np.asarray(mounts[0])

    @staticmethod
    def _write_json(path: Path, value: Any) -> None:
        write_file(path, (json.dumps(value, allow_nan=False) + "\n").encode())


def returns_of(frame: LidarFrame) -> Sweep:
    """A rendered sweep's returns, column by column as a LiDAR fires them; the semantic class is unknown."""
    column, ring = np.nonzero(frame.returned.T)
    depth = frame.depth_m[ring, column].astype(np.float64)
    origins = frame.origins[ring, column]
    return Sweep(
        points=origins + frame.directions[ring, column] * depth[:, None],
        origins=origins,
        time_s=frame.time_s[ring, column],
        intensity=frame.intensity[ring, column],
        ring=ring.astype(np.int32),
        column=column.astype(np.int32),
        semantic=np.full(len(ring), -1, np.int32),
    )


def _objects(values: list[str]) -> NDArray[Any]:
    array = np.empty(len(values), object)
    array[:] = values
    return array


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
        written = [frame for frame in there if frame in frames]
        if written and path_kind(log.image_path(name, written[0])) != "jpeg":
            losses.append(f"{name}: its images are packed again, as JPEG")
    for name in drive.lidars:
        between = sum(frame not in frames for frame in log.sweep_frames(name))
        if between:
            losses.append(f"{name}: {between} sweeps lie between frames and are left out")
    up = np.concatenate([a.world_from_actor.poses[:, 2, 2] for a in drive.actors.values()] or [np.ones(1)])
    if float(up.min()) < 1 - UPRIGHT:
        losses.append("boxes keep their heading alone, not their tilt")
    return losses
