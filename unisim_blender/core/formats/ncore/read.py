"""Reader of NCore V4 sequences (github.com/NVIDIA/ncore): a `Log`, its images and sweeps read when they are asked for."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...data.log import Sweep
from ...data.values import Intensities, spread
from ...errors import LogError, in_a_line
from ...geometry import FloatArray, Trajectory
from ...world.classes import TABLES, Motion, motion_of
from ...world.drive import Actor, Camera, Drive, Lidar, LidarModel
from ...world.own_rates import number_captures
from ..common.file_log import FileLog, cached_image
from . import cameras
from . import cameras as shutters
from . import sweeps as beams
from .components import IMAGE_FORMATS, Components, StoredComponent, as_log_error
from .cuboids import read_actors
from .extras import SensorExtras, read_poses, read_sensor, read_sequence
from .extras import read_actors as read_actor_extras
from .poses import GLOBAL, RIG, WORLD, PoseGraph, read_graph
from .sweeps import read_sweep

BRIGHT = 1.0
"""NCore's intensities are from 0 to this."""
EGO_MASK = "ego"
"""The name of the mask that shows the vehicle itself."""
MARGIN_S = 0.25
"""So far beyond its poses a sensor may have frames without a word."""


class NcoreLog(FileLog):
    """An NCore V4 sequence; see `unisim_blender.core.data.log.Log`."""

    classes: dict[str, Motion]
    """How actors of the sequence's classes move, as far as it is known."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._parts = parts = Components(path)
        self._missing: list[str] = list(parts.left_out)
        place = str(parts.stores[0])
        extras = read_sequence(parts.meta, place)
        stamps = {
            kind: {name: parts.stamps(part, name) for name, part in sensors.items()}
            for kind, sensors in (("cameras", parts.cameras), ("lidars", parts.lidars))
        }
        leading = _leading(stamps, self.path)
        self._epoch_us = extras.epoch_us if extras is not None else int(leading[0])
        self._ends: dict[str, dict[int, int]] = {}
        self._intensities: dict[str, Intensities] = {}
        self._time_s = time_s = (
            extras.time_s if extras is not None else dict(enumerate(self._seconds(leading).tolist()))
        )
        with as_log_error(parts.poses.path, "its poses cannot be read"):
            reader = parts.poses.reader
            static, dynamic = list(reader.get_static_poses()), list(reader.get_dynamic_poses())
        added = read_poses(parts.poses.meta, str(parts.poses.path))
        self._graph = graph = read_graph(static, dynamic, self._epoch_us, str(parts.poses.path), added)
        if WORLD not in graph:
            raise LogError(f"{parts.poses.path}: has no poses in {WORLD!r}")
        self._arcs = extras is None
        vehicle = (
            RIG if RIG in graph else next((name for kind in stamps.values() for name in kind if name in graph), "")
        )
        ego = graph.track(vehicle, WORLD, self._arcs)
        self._origin = origin = np.zeros(3) if extras is not None else ego.positions_at(time_s[min(time_s)])
        of_cameras = {name: self._camera(name, part, stamps["cameras"][name]) for name, part in parts.cameras.items()}
        of_lidars = {name: self._lidar(name, part, stamps["lidars"][name]) for name, part in parts.lidars.items()}
        actors, self.classes = self._actors()
        self.drive = Drive(
            name=parts.name,
            frames=tuple(sorted(time_s)),
            time_s=time_s,
            world_from_ego=_moved(ego, origin),
            cameras={name: camera for name, camera in of_cameras.items() if camera is not None},
            lidars=of_lidars,
            actors=actors,
            world_origin=origin + _shift(graph),
        )
        self.missing = tuple(self._missing)
        self._images = {camera: self._ends[camera] for camera in self.drive.cameras}

    @property
    def files(self) -> tuple[Path, ...]:
        """The stores of the sequence; see `LogExtras`."""
        stores = self._parts.stores
        return tuple(
            file for store in stores for file in (store.rglob("*") if store.is_dir() else [store]) if file.is_file()
        )

    def sweep_frames(self, lidar: str) -> tuple[int, ...]:
        return tuple(sorted(self._ends[lidar])) if lidar in self.drive.lidars else ()

    def image_path(self, camera: str, frame: int) -> Path | None:
        """A copy of the recorded image among the user's cached files, written when it is first asked for; None where there is no
        image."""
        end_us = self._images.get(camera, {}).get(frame)
        if end_us is None:
            return None
        store = self._parts.cameras[camera].path
        return cached_image("ncore", store, camera, str(end_us), lambda: self._parts.encoded_image(camera, end_us))

    def encoded_image(self, camera: str, frame: int) -> bytes:
        """The recorded image's file as the sequence holds it, JPEG or PNG."""
        return self._parts.encoded_image(camera, self._image_place(camera, frame))

    def _image_content(self, camera: str, frame: int) -> tuple[Path | bytes, str]:
        content = self.encoded_image(camera, frame)
        return content, f"{self._parts.cameras[camera].path}: {camera}: its image of frame {frame}"

    def _size_stated(self, camera: str) -> str:
        return "the camera"

    def own_vehicle_mask(self, camera: str) -> NDArray[np.bool_] | None:
        """Where (H, W) a camera's images show the vehicle itself; None where the sequence does not say."""
        if camera not in self.drive.cameras:
            return None
        content = self._parts.mask(camera, EGO_MASK)
        if content is None:
            return None
        assert self._parts.masks is not None
        model = self.drive.cameras[camera].model
        where = f"{self._parts.masks.path}: {camera}: its mask {EGO_MASK!r}"
        return _read_mask(content, where, (model.width, model.height))

    def sweep(self, lidar: str, frame: int) -> Sweep:
        """The recorded returns, and the rays without any that the sequence gives."""
        if lidar not in self.drive.lidars or frame not in self._ends[lidar]:
            raise LogError(f"{self.path}: {lidar} has no sweep of frame {frame}")
        place = f"{self._parts.lidars[lidar].path}: {lidar}: its sweep of frame {frame}"
        bundle = self._parts.bundle(lidar, self._ends[lidar][frame])
        scale = self._intensities.setdefault(
            lidar, Intensities(lidar, BRIGHT, partial(self._bright, lidar), self.notes)
        )
        return read_sweep(bundle, self.drive.lidars[lidar], frame, self._epoch_us, place, scale)

    def _bright(self, lidar: str) -> list[NDArray[np.float32]]:
        ends = self._ends[lidar]
        bright = (self._parts.bundle(lidar, ends[frame]).intensity for frame in spread(ends))
        return [values[np.isfinite(values)] for values in bright]

    def _seconds(self, times_us: NDArray[np.int64]) -> FloatArray:
        return np.asarray((times_us - self._epoch_us) / 1e6)

    def _camera(self, name: str, part: StoredComponent, stamps: NDArray[np.int64]) -> Camera | None:
        try:
            parameters = self._parts.camera_parameters(name)
            model = cameras.model_of(parameters, f"{part.path}: camera {name}")
        except LogError as fault:
            self._missing.append(f"camera {name} is left out: {fault}")
            return None
        extras = read_sensor(part.meta, f"{part.path}: {name}")
        kind, seconds = parameters.shutter_type.name, self._seconds(stamps)
        span_s = float(np.median(np.diff(seconds))) if len(seconds) else 0.0
        shutter = shutters.shutter_of(kind, span_s, model.width, model.height)
        own = np.array([shutters.stamp(kind, start, end) for start, end in seconds])
        readouts = shutters.readouts_of(kind, own, np.diff(seconds)[:, 0], span_s)
        captures = self._numbered(name, stamps, own, extras)
        self._note_missing(f"camera {name}", "image", self._ends[name])
        model = replace(model, shutter=shutter)
        return Camera(
            sensor_id=name,
            model=model if extras is None else extras.camera(model, f"{part.path}: camera {name}"),
            world_from_camera=self._track(name, stamps),
            time_s=captures,
            sees_ego_body=extras is not None and extras.sees_ego_body,
            readouts=readouts if extras is None else extras.readouts,
        )

    def _lidar(self, name: str, part: StoredComponent, stamps: NDArray[np.int64]) -> Lidar:
        parameters = self._parts.lidar_parameters(name)
        extras = read_sensor(part.meta, f"{part.path}: {name}")
        model = None if parameters is None else beams.model_of(parameters, f"{part.path}: LiDAR {name}")
        seconds = self._seconds(stamps)
        if extras is not None and extras.table is not None:
            model = extras.completed(model)
        elif model is None:
            model = LidarModel(np.zeros(0), np.zeros(0), columns=1)
        elif len(seconds):
            # a sweep is as long as its frames say, where they say a turn's time
            span_s = float(np.median(np.diff(seconds)))
            model = replace(model, sweep_s=span_s) if 0.8 < span_s / model.sweep_s < 1.25 else model
        captures = self._numbered(name, stamps, seconds[:, 1], extras)
        self._note_missing(f"LiDAR {name}", "sweep", self._ends[name])
        return Lidar(
            sensor_id=name,
            model=model,
            world_from_lidar=self._track(name, stamps),
            time_s=captures,
            sees_ego_body=extras is not None and extras.sees_ego_body,
            phase=None if extras is None else extras.phase,
        )

    def _numbered(
        self, name: str, stamps: NDArray[np.int64], own_s: FloatArray, extras: SensorExtras | None
    ) -> dict[int, float]:
        """Return a sensor's times by the numbers of its captures, and note by which times NCore names them."""
        named = dict(zip(stamps[:, 1].tolist(), own_s.tolist(), strict=True))
        known = {} if extras is None else {end: number for number, end in extras.ends_us.items() if end in named}
        captures = {} if extras is None else dict(extras.time_s)
        ends = {number: end for end, number in known.items() if number in captures}
        rest = [end for end in named if end not in known]
        if extras is None:
            captures = number_captures(self._time_s, [named[end] for end in rest])
            numbers = sorted(captures, key=captures.__getitem__)
            ends = dict(zip(numbers, sorted(rest, key=named.__getitem__), strict=True))
        elif rest:
            for number, end in enumerate(rest, 1 + max([*captures, *self._time_s])):
                captures[number], ends[number] = named[end], end
        self._ends[name] = ends
        return captures

    def _actors(self) -> tuple[dict[str, Actor], dict[str, Motion]]:
        cuboids, graph = self._parts.cuboids, self._graph
        if cuboids is None:
            self._missing.append("there are no cuboids")
            return {}, {}

        def observations() -> Iterator[Any]:
            with as_log_error(cuboids.path, "its cuboids cannot be read"):
                yield from cuboids.reader.observations()

        given, classes = read_actor_extras(cuboids.meta, str(cuboids.path))
        tracks: dict[str, Trajectory] = {}

        def world_from(frame: str, times: FloatArray) -> FloatArray:
            if frame not in tracks:
                if frame not in graph:
                    raise LogError(
                        f"{cuboids.path}: a cuboid is in the frame {frame!r:.80}, of which there are no poses"
                    )
                tracks[frame] = _moved(graph.track(frame, WORLD, False), self._origin)
            return tracks[frame].at(times)

        times = np.array(sorted(self._time_s.values()))
        margin = float(np.median(np.diff(times))) / 2 if len(times) > 1 else 0.05
        actors = read_actors(observations, str(cuboids.path), world_from, self._epoch_us, margin, given)
        for label in sorted({actor.label for actor in actors.values()}):
            motion = classes.get(label) or _motion(label)
            if motion is not None:
                classes[label] = motion
        return actors, classes

    def _track(self, name: str, stamps: NDArray[np.int64]) -> Trajectory:
        """A sensor's trajectory. It is noted where poses, those of another's sequence, end long before its frames do."""
        track, seconds = self._graph.track(name, WORLD, self._arcs), self._seconds(stamps)
        if self._arcs and len(seconds) and len(track.times_s) > 1:
            before, after = track.times_s[0] - seconds.min(), seconds.max() - track.times_s[-1]
            if max(before, after) > MARGIN_S:
                self._missing.append(
                    f"{name}: there are no poses for {max(before, 0):.2f} s at its beginning and {max(after, 0):.2f} s at its "
                    "end, where it goes on at its speed"
                )
        return _moved(track, self._origin)

    def _note_missing(self, what: str, capture: str, there: Mapping[int, int]) -> None:
        absent = sum(frame not in there for frame in self._time_s)
        if there and absent:
            self._missing.append(f"{what}: no {capture} of {absent} of {len(self._time_s)} frames")


def _leading(stamps: Mapping[str, Mapping[str, NDArray[np.int64]]], path: Path) -> NDArray[np.int64]:
    """Return the times that frames have: the ends of the sweeps of the LiDAR with most of them, or else of a camera's images."""
    for kind in ("lidars", "cameras"):
        there = [times[:, 1] for times in stamps[kind].values() if len(times)]
        if there:
            return max(there, key=len)
    raise LogError(f"{path}: holds neither sweeps nor images")


def _motion(label: str) -> Motion | None:
    """Return how a class moves whose name may be written in other letters than its dataset's."""
    plain = label.lower()
    spelt = (name for table in TABLES for name in table if name.lower() in (plain, plain.partition(".")[0]))
    return motion_of(label) or next((motion_of(name) for name in spelt), None)


def _moved(track: Trajectory, origin: FloatArray) -> Trajectory:
    return track if not origin.any() else Trajectory(track.times_s, track.positions - origin, track.quaternions_wxyz)


def _shift(graph: PoseGraph) -> FloatArray:
    """Return how far the world's origin is from the global one's, (3,): 0 where there is none, or it is turned."""
    pose = graph.still(WORLD, GLOBAL) if GLOBAL in graph else None
    return np.zeros(3) if pose is None or np.abs(pose[:3, :3] - np.eye(3)).max() > 1e-9 else pose[:3, 3].copy()


def _read_mask(content: bytes, where: str, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Return where a mask is not black, at a size: one of another is made as large."""
    from PIL import Image, UnidentifiedImageError

    try:
        with Image.open(io.BytesIO(content), formats=list(IMAGE_FORMATS)) as image:
            shown: Any = image.convert("L")
            return np.asarray(shown if shown.size == size else shown.resize(size, Image.Resampling.NEAREST)) > 0
    except UnidentifiedImageError as fault:
        raise LogError(f"{where}: is no {' or '.join(IMAGE_FORMATS)}") from fault
    except (OSError, Image.DecompressionBombError, ValueError, SyntaxError) as fault:
        raise LogError(f"{where}: cannot be decoded ({in_a_line(fault)})") from fault
