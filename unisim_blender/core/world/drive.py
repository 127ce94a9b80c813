"""A drive: sensors, actors and their trajectories over time. A log gives the recorded one; a scenario's edits
make another of it.

Renderers (neural, surfels, a street's exact one) take a `Drive` or states of it, and nothing else of a log.
World: metres, z up, re-centred on the first ego pose. Ego and actor boxes: x forward, y left, z up, origin at the box's
centre for actors. Cameras: OpenCV axes (x right, y down, z forward). LiDARs: x forward, y left, z up in their own
frame. Times: seconds from the log's first frame, float64.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from ..errors import LogError
from ..geometry import BoolArray, FloatArray, Trajectory
from ..lenses import PINHOLE, lens_from_dict
from ..lenses.lens import Lens, LensError
from .lamps import ActorLamp
from .light import SunKeys
from .weather import WeatherKeys

EGO = "ego"
"""The ego vehicle, where it is named beside actors. No actor of a log has this identifier."""
FRAME_MARGIN_S = 0.25
"""Largest time between a frame's time and a measurement of one of its sensors, seconds."""


@dataclass(frozen=True)
class RollingShutter:
    """Exposure times of an image's lines: line r of H is exposed at ``time + duration_s * (r / H - reference)``.

    ``axis`` says what a line is: one of the "rows", from the top, or of the "columns", from the left. ``reference`` is
    the fraction of the image that the camera's timestamp belongs to (0 the first line, 1 behind the last); a negative
    duration reads from the last line to the first; 0 is a global shutter.
    """

    duration_s: float = 0.0
    reference: float = 0.5
    axis: str = "rows"

    @staticmethod
    def of_exposure(
        start_s: float, end_s: float, time_s: float, axis: str = "rows", reverse: bool = False
    ) -> RollingShutter:
        """Return the shutter of an image with timestamp ``time_s`` whose first line to be read is exposed at
        ``start_s`` and the last at ``end_s``; ``reverse``: lines are read from the bottom up, or from the right."""
        duration = end_s - start_s
        if duration == 0:
            return RollingShutter(0.0, 0.5, axis)
        reference = (time_s - start_s) / duration
        return RollingShutter(-duration, 1 - reference, axis) if reverse else RollingShutter(duration, reference, axis)

    def exposure_s(self, time_s: float) -> tuple[float, float]:
        """Return when the exposure of an image with timestamp ``time_s`` starts and ends, by its lines' middles."""
        ends = time_s - self.duration_s * self.reference, time_s + self.duration_s * (1 - self.reference)
        return min(ends), max(ends)

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form; ``axis`` is left out where lines are rows."""
        return {
            "duration_s": self.duration_s,
            "reference": self.reference,
            **({} if self.axis == "rows" else {"axis": self.axis}),
        }


@dataclass(frozen=True)
class CameraModel:
    """An image's size and its projection of directions to pixels: the lens's plane, scaled by fx, fy (pixels) and moved
    by cx, cy.

    Pixel centres lie at half integers: pixel (0, 0) covers [0, 1) x [0, 1). Raises `LensError` where fx or fy is not
    above 0.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    shutter: RollingShutter = RollingShutter()
    lens: Lens = PINHOLE

    def __post_init__(self) -> None:
        for name in ("fx", "fy", "cx", "cy"):
            value = getattr(self, name)
            if not math.isfinite(value) or (name in ("fx", "fy") and value <= 0):
                what = "a finite number" if name in ("cx", "cy") else "a finite number above 0"
                raise LensError(f"a camera's {name} must be {what}, not {value:g}")

    def to_dict(self) -> dict[str, Any]:
        """Return the JSON form; ``lens`` is left out where it is an ideal pinhole."""
        values: dict[str, Any] = {name: getattr(self, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
        values["shutter"] = self.shutter.to_dict()
        return values if self.is_pinhole else {**values, "lens": self.lens.to_dict()}

    @staticmethod
    def from_dict(values: dict[str, Any]) -> CameraModel:
        """Return the model of `to_dict`. Raises `lenses.LensError`."""
        lens = lens_from_dict(values["lens"]) if "lens" in values else PINHOLE
        return CameraModel(**{**values, "shutter": RollingShutter(**values["shutter"]), "lens": lens})

    @property
    def is_pinhole(self) -> bool:
        """Whether the lens has no distortion."""
        return self.lens == PINHOLE

    @cached_property
    def pixels_per_rad(self) -> float:
        """Number of pixels per radian at the optical axis, along u."""
        return self.fx * self.lens.axis_slope

    def project(self, points: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return the image points u, v (...), pixels, of points (..., 3) of the camera's frame, inside the image or
        not; and whether (...) they lie in the lens's valid domain: elsewhere u and v are NaN."""
        if self.is_pinhole:
            x, y, z = points[..., 0], points[..., 1], points[..., 2]
            valid = z > 0
            safe = np.where(valid, z, np.nan)
            return self.fx * x / safe + self.cx, self.fy * y / safe + self.cy, valid
        plane, valid = self.lens.project(points)
        return self.fx * plane[..., 0] + self.cx, self.fy * plane[..., 1] + self.cy, valid

    def unproject(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return unit directions (..., 3) of the camera's frame through image points u, v (...) in pixels; NaN where
        the lens has none. `sensors.unprojection` caches them for whole images."""
        x, y = np.broadcast_arrays((u - self.cx) / self.fx, (v - self.cy) / self.fy)
        return self.lens.unproject(np.stack([x, y], -1))

    def resized(self, width: int) -> CameraModel:
        """Return the model at another image width. The height is rounded to keep the aspect ratio; focal lengths and
        principal point scale by the exact ratio of each axis."""
        if width == self.width:
            return self
        height = max(1, round(self.height * width / self.width))
        sx, sy = width / self.width, height / self.height
        return replace(
            self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy
        )


MAX_LIDAR_CELLS = 1 << 23
"""Largest number of cells, beams x columns, of a LiDAR. One of 128 beams and 36 000 columns has half as many."""


@dataclass(frozen=True)
class LidarModel:
    """A LiDAR's beam table: of a spinning one, or of a solid-state one whose beams sweep a part of a turn.

    Beam b in column c looks along elevation_rad[b] and azimuth ``start_azimuth_rad + direction * 2 pi * (c + 0.5) /
    columns + azimuth_offset_rad[b]`` (0 along the sensor's x, counter-clockwise), at ``frame time - sweep_s +
    time_offset_s + sweep_s * (c + 0.5) / columns``: by default a sweep ends at its frame's time. Beam 0 is the highest.

    Columns that are not even have tables: ``column_azimuth_rad`` (columns,) in place of the even azimuths, in the order
    of ``direction``, and ``column_time_s`` (columns,), seconds after the frame's time plus ``time_offset_s``, in place
    of the even times. ``beam_time_s`` (beams,) is how long after its column's time a beam is fired. Raises ValueError
    for a table of another length or order, and for more than `MAX_LIDAR_CELLS` beams x columns.
    """

    elevation_rad: FloatArray
    azimuth_offset_rad: FloatArray
    columns: int = 1800
    sweep_s: float = 0.1
    start_azimuth_rad: float = np.pi
    direction: int = -1
    time_offset_s: float = 0.0
    min_range_m: float = 0.5
    max_range_m: float = 200.0
    column_azimuth_rad: FloatArray | None = None
    column_time_s: FloatArray | None = None
    beam_time_s: FloatArray | None = None

    def __post_init__(self) -> None:
        if self.beams * self.columns > MAX_LIDAR_CELLS:
            raise ValueError(f"{self.beams} beams x {self.columns} columns are more than {MAX_LIDAR_CELLS} cells")
        counts = {"column_azimuth_rad": self.columns, "column_time_s": self.columns, "beam_time_s": self.beams}
        for name, count in counts.items():
            table = getattr(self, name)
            if table is not None and (np.shape(table) != (count,) or not np.isfinite(table).all()):
                raise ValueError(f"{name} must be {count} numbers")
        if self.column_azimuth_rad is not None:
            with np.errstate(over="ignore", invalid="ignore"):
                turned = self.direction * np.diff(np.unwrap(self.column_azimuth_rad))
            if not ((turned > 0).all() and turned.sum() < 2 * np.pi):
                raise ValueError(
                    f"column_azimuth_rad must turn in the direction {self.direction}, by less than a turn in all"
                )

    @property
    def beams(self) -> int:
        return len(self.elevation_rad)


@dataclass(frozen=True)
class Readouts:
    """Readout times of a camera's images where these differ: ``stretch`` (K,) times the model's ``shutter.duration_s``
    for images stamped ``times_s`` (K,), increasing; linear between them and constant beyond."""

    times_s: FloatArray
    stretch: FloatArray

    def at(self, time_s: float | FloatArray) -> FloatArray:
        """Return the factor of images stamped ``time_s`` (...)."""
        return np.asarray(np.interp(time_s, self.times_s, self.stretch))


@dataclass(frozen=True)
class Camera:
    """A camera and its trajectory: ``time_s[frame]`` is the image's timestamp, ``world_from_camera`` its
    pose at any time.

    ``sees_ego_body``: whether it sees meshes of the ego vehicle's body, as a camera at the roadside does.
    ``full_width``: width of the recorded images where ``model`` is of another width; None where both are the same.
    ``readouts``: None where all images take as long as the model's shutter says.
    """

    sensor_id: str
    model: CameraModel
    world_from_camera: Trajectory
    time_s: dict[int, float]
    sees_ego_body: bool = False
    full_width: int | None = None
    readouts: Readouts | None = None

    def model_at(self, time_s: float) -> CameraModel:
        """Return the model of the image stamped ``time_s``: ``model``, with that image's own shutter."""
        if self.readouts is None:
            return self.model
        shutter = self.model.shutter
        own = replace(shutter, duration_s=shutter.duration_s * float(self.readouts.at(time_s)))
        return replace(self.model, shutter=own)

    @property
    def trajectory(self) -> Trajectory:
        """Its poses, as those of a `Lidar`."""
        return self.world_from_camera

    def along(self, trajectory: Trajectory) -> Camera:
        """Return the camera on another trajectory."""
        return replace(self, world_from_camera=trajectory)

    def resized(self, width: int) -> Camera:
        """Return the camera with images ``width`` pixels wide; see `CameraModel.resized`."""
        return replace(self, model=self.model.resized(width), full_width=self.full_width or self.model.width)


@dataclass(frozen=True)
class SpinPhase:
    """Rotation of a sweep's columns relative to the beam table's, where a LiDAR's turns and sweeps are not synchronous.

    ``turned_rad`` (K,), radians, of the sweeps stamped ``times_s`` (K,), seconds, increasing; linear between them and
    constant beyond. It does not wrap: a phase that goes on turning goes on growing.
    """

    times_s: FloatArray
    turned_rad: FloatArray

    def at(self, time_s: float) -> float:
        """Return the rotation of the columns of the sweep at ``time_s``, radians."""
        return float(np.interp(time_s, self.times_s, self.turned_rad))


@dataclass(frozen=True)
class Lidar:
    """A LiDAR and its trajectory: ``time_s[frame]`` is the sweep's timestamp, ``world_from_lidar`` its
    pose at any time.

    ``blocked`` (beams, columns) marks the cells that the vehicle itself blocks in every frame; None where that is not
    known. ``sees_ego_body`` as for a `Camera`.
    """

    sensor_id: str
    model: LidarModel
    world_from_lidar: Trajectory
    time_s: dict[int, float]
    blocked: BoolArray | None = None
    sees_ego_body: bool = False
    phase: SpinPhase | None = None

    @property
    def trajectory(self) -> Trajectory:
        """Its poses, as those of a `Camera`."""
        return self.world_from_lidar

    def along(self, trajectory: Trajectory) -> Lidar:
        """Return the LiDAR on another trajectory."""
        return replace(self, world_from_lidar=trajectory)

    def model_at(self, time_s: float) -> LidarModel:
        """Return the beam table of the sweep at ``time_s``: ``model``, turned by the phase."""
        if self.phase is None:
            return self.model
        turned, azimuth = self.phase.at(time_s), self.model.column_azimuth_rad
        start = self.model.start_azimuth_rad + turned
        return replace(
            self.model, start_azimuth_rad=start, column_azimuth_rad=None if azimuth is None else azimuth + turned
        )


@dataclass(frozen=True)
class Appearance:
    """Source of an actor's appearance and shape: actor ``actor`` of the trained scene in folder ``scene`` ("" is the
    drive's own scene), or the mesh in file ``mesh``, if it is given."""

    actor: str
    scene: str = ""
    mesh: str = ""


@dataclass(frozen=True)
class Actor:
    """An annotated object, moving or not: a box of edges ``size_m`` (3,), metres, with an appearance, present from
    start_s to end_s (both included).

    ``is_ego_body``: it is a mesh fixed to the ego vehicle, which only sensors with ``sees_ego_body`` see.
    """

    uid: str
    label: str
    size_m: FloatArray
    world_from_actor: Trajectory
    start_s: float
    end_s: float
    is_moving: bool
    appearance: Appearance
    inserted: bool = False
    is_ego_body: bool = False
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Size of the actor relative to its appearance, along its own axes; ``size_m`` is the scaled size."""
    lamps: tuple[ActorLamp, ...] = ()
    """Lamps that an edit switches, in the states that they show; others look as the scene has them."""

    @property
    def appearance_size_m(self) -> FloatArray:
        """Size (3,) of the unscaled box, in metres: that of the appearance."""
        return np.asarray(self.size_m / np.array(self.scale))

    @property
    def is_scaled(self) -> bool:
        """Whether the actor and its appearance differ in size."""
        return self.scale != (1.0, 1.0, 1.0)

    def visible_to(self, sensor: Camera | Lidar) -> bool:
        """Return whether a sensor can see the actor: ego bodies are seen by sensors with ``sees_ego_body`` alone."""
        return sensor.sees_ego_body or not self.is_ego_body

    def present(self, time_s: FloatArray | float) -> BoolArray:
        """Return whether the actor is present at times (...), seconds: (...) bool."""
        time = np.asarray(time_s)
        return np.asarray((time >= self.start_s) & (time <= self.end_s))


@dataclass(frozen=True)
class Box:
    """A static box of space: pose (4, 4) of its centre, size (3,) in metres along its own axes."""

    world_from_box: FloatArray
    size_m: FloatArray

    def content(self) -> bytes:
        """Return the box as bytes, for digests."""
        return _float_bytes(self.world_from_box) + _float_bytes(self.size_m)


@dataclass(frozen=True)
class StaticCopy:
    """A copy of what stands above the ground inside ``source``, placed at ``world_from_target`` (4, 4), the
    pose of its box."""

    uid: str
    source: Box
    world_from_target: FloatArray

    def content(self) -> bytes:
        """Return the copy as bytes, for digests."""
        return json.dumps(self.uid).encode() + self.source.content() + _float_bytes(self.world_from_target)


@dataclass(frozen=True)
class Drive:
    """A recorded or edited drive. ``frames`` are the log's numbers of its frames, in order; ``time_s`` their times.

    Raises `LogError` where a camera and a LiDAR share a name: captures, seeds and requests name sensors by it.
    """

    name: str
    frames: tuple[int, ...]
    time_s: dict[int, float]
    world_from_ego: Trajectory
    cameras: dict[str, Camera]
    lidars: dict[str, Lidar]
    actors: dict[str, Actor]
    static_copies: tuple[StaticCopy, ...] = ()
    static_removals: tuple[Box, ...] = ()
    world_origin: FloatArray = field(default_factory=lambda: np.zeros(3))
    """Offset (3,) that was subtracted from the log's own world coordinates, float64."""
    weather: WeatherKeys | None = None
    sun: SunKeys | None = None
    edited: frozenset[str] = frozenset()
    """Ids of the actors that edits made or changed, where there is a ``sun``."""

    def __post_init__(self) -> None:
        if shared := sorted(self.cameras.keys() & self.lidars.keys()):
            raise LogError(f"{self.name}: {shared[0]!r} is a camera and a LiDAR: give each a name of its own")

    @property
    def sensors(self) -> dict[str, Camera | Lidar]:
        """Cameras, then LiDARs, by their names."""
        return {**self.cameras, **self.lidars}

    def with_sensors(self, change: Callable[[Any], Any]) -> Drive:
        """Return the drive with ``change`` of each camera, and then of each LiDAR."""
        cameras = {name: change(camera) for name, camera in self.cameras.items()}
        return replace(self, cameras=cameras, lidars={name: change(lidar) for name, lidar in self.lidars.items()})

    def window(self, actor: Actor) -> tuple[float, float]:
        """Return when an actor is present (start, end), finite, in seconds. One that is present at the first (last)
        frame is also present shortly before (after) it: sensors of a frame measure earlier and later than
        the frame's time."""
        first, last = self.time_s[self.frames[0]] - FRAME_MARGIN_S, self.time_s[self.frames[-1]] + FRAME_MARGIN_S
        start, end = actor.start_s, actor.end_s
        if start <= self.time_s[self.frames[0]]:
            start = min(first, start) if math.isfinite(start) else first
        if end >= self.time_s[self.frames[-1]]:
            end = max(last, end) if math.isfinite(end) else last
        return start, end

    @property
    def labelled_actors(self) -> list[Actor]:
        """The actors that labels list: those that some sensor of the drive can see."""
        sensors = self.sensors.values()
        return [
            actor
            for actor in self.actors.values()
            if not actor.is_ego_body or any(actor.visible_to(sensor) for sensor in sensors)
        ]

    @property
    def duration_s(self) -> float:
        """Seconds from the first frame to the last."""
        return self.time_s[self.frames[-1]] - self.time_s[self.frames[0]]


def _float_bytes(array: FloatArray) -> bytes:
    return np.ascontiguousarray(array, np.float64).tobytes()
