"""Writes a drive as an NCore V4 sequence.

    with NcoreWriter(folder, drive) as writer:
        writer.write_image("front_camera", frame, rgb)
        writer.write_sweep("roof_lidar", frame, sweep)

The folder appears under its name when all of it is written, and never where anything failed. `write_ncore` writes a whole log.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from functools import cached_property
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...data.images import SIGNATURES, encoded_image
from ...data.log import Log, Sweep
from ...data.sweep_cells import with_drops
from ...errors import OutputError, in_a_line
from ...files import PARTIAL_SUFFIX, write_file
from ...geometry import Trajectory
from ...sensors.frames import LidarFrame
from ...world.captures import microseconds
from ...world.classes import Motion, motion_of
from ...world.drive import FRAME_MARGIN_S, Camera, Drive, Lidar
from ..common.image_bytes import check_size, encoded_for
from . import cameras, extras
from . import cameras as shutters
from . import sweeps as beams
from .cuboids import observations_of
from .poses import GLOBAL, OWN, RIG, WORLD, Mount, mount_of, sampled
from .sweeps import Bundle, bundle_of, sweep_of_frame

EPOCH_US = 10**15
"""NCore's time, microseconds, of a drive's 0 s, where nothing else is wanted: NCore's times are positive."""
DROPS = "unisim_drops"
MASK = "ego"
SHARED = ""
"""In place of a sensor's name: what sensors share, poses, intrinsics, masks and cuboids."""


class NcoreWriter:
    """Writes ``drive`` to a new folder ``path``, which must not be there or be empty: `NAME.ncore4.zarr.itar` and `NAME.json`.

    ``epoch_us`` is NCore's time of the drive's 0 s. ``classes`` says how actors of the
    drive's classes move, where no known table does. A sensor of which nothing is written is left out. Leaving a `with` block
    finishes the sequence, or discards it where it failed. Raises `OutputError` for what NCore has no place for,
    ModuleNotFoundError where `nvidia-ncore` is not installed.

    ``only`` writes one of the stores of a sequence that has a store for each sensor, into a folder that may be there: a sensor's
    (`NAME.ncore4-SENSOR.zarr.itar`), or with SHARED that of all they share. `write_index` then makes the stores a sequence.
    """

    def __init__(
        self,
        path: Path | str,
        drive: Drive,
        epoch_us: int = EPOCH_US,
        classes: Mapping[str, Motion] | None = None,
        only: str | None = None,
    ) -> None:
        from ncore.data import v4

        self.path = Path(path)
        self.drive = drive
        self._epoch_us, self._classes = epoch_us, dict(classes or {})
        self._start_us, self._end_us = self._span()
        self._only = only
        if only is None and self.path.exists() and (not self.path.is_dir() or any(self.path.iterdir())):
            raise OutputError(f"{self.path}: is there already")
        beside = self.path.with_name(f".{self.path.name}") if only is None else self.path / ".store"
        self._partial = beside.with_name(f"{beside.name}.{os.getpid()}{PARTIAL_SUFFIX}")
        self._v4 = v4
        self._ends: dict[str, dict[int, int]] = {name: {} for name in (*drive.cameras, *drive.lidars)}
        self._masks: dict[str, NDArray[np.bool_]] = {}
        self._done = False
        both = set(drive.cameras) & set(drive.lidars)
        reserved = {RIG, WORLD, GLOBAL} & {*drive.cameras, *drive.lidars}
        if both or reserved:
            raise OutputError(
                f"{self.path}: NCore's sensors need names of their own, not {sorted(both | reserved)[0]!r}"
            )
        try:
            self._begin()
        except BaseException:
            self.discard()
            raise

    def __enter__(self) -> NcoreWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None and not self._done:
            self.finish()
        else:
            self.discard()

    def write_image(self, camera: str, frame: int, image: NDArray[np.uint8] | bytes) -> None:
        """Write an image (H, W, 3), sRGB, of the camera's size, or the bytes of a JPEG or PNG file, kept as they are."""
        sensor = self._sensor(self.drive.cameras, camera, frame)
        content = image if isinstance(image, bytes) else encoded_for(sensor, image)
        form = next((form for begin, form in SIGNATURES.items() if content.startswith(begin)), None)
        if form is None:
            raise OutputError(f"{camera}: the image of frame {frame} is neither JPEG nor PNG")
        check_size(content, sensor.model, f"{camera}: the image of frame {frame}")
        start, end = (self._us(time) for time in shutters.exposed(sensor, sensor.time_s[frame]))
        with self._asked(f"{camera}: its image of frame {frame}"):
            self._component(camera, self._v4.CameraSensorComponent.Writer).store_frame(
                content, form, np.array([start, end], np.uint64), {}, {}
            )
        self._ends[camera][frame] = end

    def write_sweep(self, lidar: str, frame: int, sweep: Sweep | LidarFrame) -> None:
        """Write a LiDAR's returns and drops; of a rendered sweep's cells, those that did not return are drops."""
        sensor = self._sensor(self.drive.lidars, lidar, frame)
        given = sweep if isinstance(sweep, Sweep) else sweep_of_frame(sweep)
        where = f"{lidar}: its sweep of frame {frame}"
        try:
            bundle = bundle_of(given, sensor, frame, self._epoch_us)
        except ValueError as fault:
            raise OutputError(f"{self.path}: {where}: {fault}") from fault
        start, end = self._sweep_span(sensor, frame, bundle)
        with self._asked(where):
            self._component(lidar, self._v4.LidarSensorComponent.Writer).store_frame(
                direction=bundle.direction,
                timestamp_us=bundle.timestamp_us,
                model_element=bundle.model_element,
                distance_m=bundle.distance_m,
                intensity=bundle.intensity,
                frame_timestamps_us=np.array([start, end], np.uint64),
                generic_data=dict(bundle.more),
                generic_meta_data={DROPS: bundle.drops_given},
            )
        self._ends[lidar][frame] = end

    def write_mask(self, camera: str, mask: NDArray[np.bool_]) -> None:
        """Write where (H, W) a camera's images show the vehicle itself."""
        model = self.drive.cameras[camera].model
        if mask.dtype != np.bool_ or mask.shape != (model.height, model.width):
            raise OutputError(f"{camera}: a mask of {mask.shape} {mask.dtype} is none of {model.width}x{model.height}")
        self._masks[camera] = mask

    def finish(self) -> None:
        """Write poses, intrinsics, masks and cuboids: now it is a sequence, under its name."""
        try:
            self._finish()
            if self._only is not None:
                self.path.mkdir(parents=True, exist_ok=True)
                for store in self._partial.iterdir():
                    os.replace(store, self.path / store.name)
                return
            if self.path.is_dir():
                self.path.rmdir()
            os.replace(self._partial, self.path)
        except OSError as error:
            raise OutputError(f"{self.path}: cannot be written: {error.strerror}") from error
        finally:
            self.discard()

    def discard(self) -> None:
        """Remove what is not finished."""
        self._done = True
        shutil.rmtree(self._partial, ignore_errors=True)

    def _begin(self) -> None:
        from ncore.impl.common.transformations import HalfClosedInterval
        from upath import UPath

        drive, v4 = self.drive, self._v4
        self._name = sequence_name(drive)
        with self._asked("the sequence"):
            self._writer = v4.SequenceComponentGroupsWriter(
                UPath(self._partial),
                self._name,
                self._name,
                HalfClosedInterval(self._start_us, self._end_us + 1),
                extras.sequence_json(self._epoch_us, {frame: drive.time_s[frame] for frame in drive.frames}),
            )
            add = self._writer.register_component_writer
            self._sensors: dict[str, Any] = {}
            if not self._shares:
                return
            self._poses = add(v4.PosesComponent.Writer, "default")
            self._intrinsics = add(v4.IntrinsicsComponent.Writer, "default")
            self._mask_writer = add(v4.MasksComponent.Writer, "default")
            self._cuboids = add(v4.CuboidsComponent.Writer, "default")
        for name, camera in drive.cameras.items():
            self._intrinsics.store_camera_intrinsics(name, cameras.parameters_of(camera.model, f"{self.path}: {name}"))
        for name, lidar in drive.lidars.items():
            if lidar.model.beams:
                table = beams.parameters_of(lidar.model, f"{self.path}: {name}")
                self._intrinsics.store_lidar_intrinsics(name, table)

    def _finish(self) -> None:
        from PIL import Image

        drive = self.drive
        if not self._sensors and self._only != SHARED:
            raise OutputError(f"{self.path}: neither an image nor a sweep was written")
        with self._asked("what its sensors share"):
            if self._shares:
                self._write_poses()
                for name in drive.cameras:
                    shown = {MASK: Image.fromarray(self._masks[name])} if name in self._masks else {}
                    self._mask_writer.store_camera_masks(name, shown)
                self._write_cuboids()
            for name, component in self._sensors.items():
                sensor: Camera | Lidar
                if name in drive.cameras:
                    sensor = drive.cameras[name]
                    more = extras.camera_json(sensor.model, sensor.readouts)
                else:
                    sensor = drive.lidars[name]
                    more = extras.lidar_json(sensor.model, sensor.phase)
                about = extras.sensor_json(sensor.time_s, self._ends[name], sensor.sees_ego_body, **more)
                component.set_generic_data({}, about)
            self._writer.finalize()
        if self._only is None:
            write_index(self._partial, drive)

    @property
    def _shares(self) -> bool:
        """Whether it writes what sensors share."""
        return self._only in (None, SHARED)

    def _component(self, name: str, kind: Any) -> Any:
        """A sensor's component, which begins with its first frame: NCore reads none without frames."""
        if name not in self._sensors:
            group = None if self._only is None else _as_file(name)
            self._sensors[name] = self._writer.register_component_writer(kind, name, group)
        return self._sensors[name]

    def _write_poses(self) -> None:
        drive = self.drive
        origin = np.eye(4)
        origin[:3, 3] = drive.world_origin
        self._poses.store_static_pose(WORLD, GLOBAL, origin)
        added = {}
        tracks = {RIG: drive.world_from_ego}
        for name, track in self._sensor_tracks.items():
            mount = self.mounts[name]
            if mount is None:
                tracks[name] = track
            else:
                self._poses.store_static_pose(name, RIG, mount.pose)
                if mount.off_m or mount.off_rad:
                    tracks[OWN + name] = track
        for name, track in tracks.items():
            poses, times_us, added[name] = sampled(track, self._start_us, self._end_us, self._epoch_us)
            self._poses.store_dynamic_pose(name, WORLD, poses, times_us)
        self._poses.set_generic_data({}, extras.poses_json(added))

    @cached_property
    def mounts(self) -> dict[str, Mount | None]:
        """Where sensors sit on the vehicle, by name; None for those that do not ride on it, which get poses over time."""
        start, end = ((time - self._epoch_us) / 1e6 for time in (self._start_us, self._end_us))
        ego = self.drive.world_from_ego
        return {
            name: mount_of(sensor.trajectory, ego, start, end, np.array(sorted(sensor.time_s.values())))
            for name, sensor in self.drive.sensors.items()
        }

    @property
    def _sensor_tracks(self) -> dict[str, Trajectory]:
        """The trajectories of all sensors by name."""
        return {name: sensor.trajectory for name, sensor in self.drive.sensors.items()}

    def _write_cuboids(self) -> None:
        from ncore import data

        drive = self.drive
        frames = [drive.time_s[frame] for frame in drive.frames]
        rows: list[dict[str, Any]] = []
        windows = {}
        for actor in drive.labelled_actors:
            there = observations_of(actor, frames, self._start_us, self._end_us, self._epoch_us)
            rows += there
            if there:
                windows[actor.uid] = (actor.start_s, actor.end_s, actor.is_moving)
        source = data.LabelSource.EXTERNAL
        self._cuboids.store_observations(
            [
                data.CuboidTrackObservation(
                    **{**row, "bbox3": data.BBox3(**{key: tuple(value) for key, value in row["bbox3"].items()})},
                    source=source,
                )
                for row in rows
            ]
        )
        labels = {actor.label for actor in drive.labelled_actors}
        motions = {label: motion_of(label, self._classes) for label in sorted(labels)}
        known = {label: motion for label, motion in motions.items() if motion is not None}
        self._cuboids.set_generic_data({}, extras.actors_json(windows, known))

    def _span(self) -> tuple[int, int]:
        """The sequence's first and last microsecond: all that a sensor measures lies between them."""
        drive = self.drive
        captured = [time_s for sensor in drive.sensors.values() for time_s in sensor.time_s.values()]
        times = np.array([*(drive.time_s[frame] for frame in drive.frames), *captured])
        if not len(times) or not np.isfinite(times).all():
            raise OutputError(f"{self.path}: a drive without frames, or with times that are not finite, is no sequence")
        start, end = self._us(times.min() - FRAME_MARGIN_S), self._us(times.max() + FRAME_MARGIN_S)
        if start < 0:
            raise OutputError(
                f"{self.path}: NCore's times are positive, and epoch_us {self._epoch_us} makes one {start}"
            )
        return start, end

    def _us(self, time_s: float) -> int:
        return microseconds(time_s) + self._epoch_us

    def _sensor(self, sensors: Mapping[str, Any], name: str, frame: int) -> Any:
        if self._done:
            raise OutputError(f"{self.path}: is finished")
        if name not in sensors or frame not in sensors[name].time_s:
            raise OutputError(f"{self.path}: the drive has no {name!r} with a time of frame {frame}")
        if frame in self._ends[name]:
            raise OutputError(f"{self.path}: {name} has frame {frame} already")
        return sensors[name]

    def _sweep_span(self, lidar: Lidar, frame: int, bundle: Bundle) -> tuple[int, int]:
        stamp = lidar.time_s[frame] + lidar.model.time_offset_s
        start, end = self._us(stamp - lidar.model.sweep_s), self._us(stamp)
        if len(bundle.timestamp_us):
            start, end = min(start, int(bundle.timestamp_us.min())), max(end, int(bundle.timestamp_us.max()))
        if start < self._start_us or end > self._end_us:
            late = max(self._start_us - start, end - self._end_us) / 1e6
            raise OutputError(
                f"{self.path}: {lidar.sensor_id} has rays in frame {frame} that lie {late:.3f} s outside of the drive"
            )
        return start, end

    def _asked(self, what: str) -> AbstractContextManager[None]:
        return _asked(f"{self.path}: {what}")


@contextmanager
def _asked(where: str) -> Iterator[None]:
    """Turn what NCore's writers assert into one sentence."""
    try:
        yield
    except OSError as error:
        raise OutputError(f"{where}: cannot be written: {error.strerror}") from error
    except (AssertionError, ValueError, KeyError) as error:
        raise OutputError(f"{where}: NCore does not take it: {in_a_line(error)}") from error


def sequence_name(drive: Drive) -> str:
    """Return the name of a drive's sequence, which its files have."""
    return _as_file(drive.name)


def store_file(drive: Drive, only: str) -> str:
    """Return the name of the store that `NcoreWriter` writes for ``only``."""
    group = "" if only == SHARED else f"-{_as_file(only)}"
    return f"{sequence_name(drive)}.ncore4{group}.zarr.itar"


def write_index(folder: Path, drive: Drive) -> None:
    """Write the sequence's `NAME.json` beside its stores in a folder. Raises `OutputError`."""
    from ncore.data import v4
    from upath import UPath

    name = sequence_name(drive)
    with _asked(f"{folder}: {name}.json"):
        stores = [UPath(store) for store in sorted(folder.glob("*.zarr.itar"))]
        meta: dict[str, Any] = v4.SequenceComponentGroupsReader(stores).get_sequence_meta().to_dict()
        # they are opened at once, and listed as they come
        meta["component_stores"].sort(key=lambda store: store["path"])
    write_file(folder / f"{name}.json", (json.dumps(meta, indent=1) + "\n").encode())


def _as_file(name: str) -> str:
    return "".join("-" if letter in '/\\:*?"<>|' else letter for letter in name).strip(". ") or "drive"


def write_ncore(
    path: Path | str, log: Log, epoch_us: int = EPOCH_US, on_capture: Callable[[str, int], None] | None = None
) -> None:
    """Write a whole log as an NCore sequence in a new folder: images as they are, sweeps with drops, poses, cuboids, masks.

    Drops that the log does not give are those that its beam tables say. ``on_capture`` is called with sensor and frame after
    each image and sweep. Raises `OutputError`, `LogError`.
    """
    with NcoreWriter(path, log.drive, epoch_us, classes=getattr(log, "classes", None)) as writer:
        mask_of = getattr(log, "own_vehicle_mask", None)
        for name in log.drive.cameras:
            mask = None if mask_of is None else mask_of(name)
            if mask is not None:
                writer.write_mask(name, mask)
            for frame in log.image_frames(name):
                writer.write_image(name, frame, encoded_image(log, name, frame))
                if on_capture is not None:
                    on_capture(name, frame)
        for name in log.drive.lidars:
            for frame in log.sweep_frames(name):
                writer.write_sweep(name, frame, with_drops(log, name, frame))
                if on_capture is not None:
                    on_capture(name, frame)
