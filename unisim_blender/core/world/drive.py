"""A drive: what the sensors see and when. A recorded log gives one, a scenario's edits turn it into another.

Everything that renders (the neural renderer, the street's exact one) takes a `Drive`, and nothing else of a log.
World: metres, z up, re-centred on the first ego pose. Ego and actor boxes: x forward, y left, z up, origin at the box's
centre for actors. Cameras: OpenCV axes (x right, y down, z forward). LiDARs: x forward, y left, z up in their own frame.
Times: seconds from the log's first frame, float64.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..geometry import BoolArray, FloatArray, Trajectory

FRAME_MARGIN_S = 0.25
"""No sensor of a frame measures further from the frame's time than this."""


@dataclass(frozen=True)
class RollingShutter:
    """When an image's rows are exposed: row r of H at ``time + duration_s * (r / H - reference)``.

    ``reference`` is the fraction of the image's height that the camera's timestamp belongs to (0 top, 1 bottom); a negative
    duration reads from the bottom up; 0 is a global shutter.
    """

    duration_s: float = 0.0
    reference: float = 0.5


@dataclass(frozen=True)
class CameraModel:
    """A pinhole without distortion. Pixel centres lie at half integers: pixel (0, 0) covers [0, 1) x [0, 1)."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    shutter: RollingShutter = RollingShutter()

    @staticmethod
    def from_dict(values: dict[str, Any]) -> CameraModel:
        """The model of what `dataclasses.asdict` made of one."""
        return CameraModel(**{**values, "shutter": RollingShutter(**values["shutter"])})

    def resized(self, width: int) -> CameraModel:
        """The same view at another width, the height rounded to keep the aspect; K scales exactly with each axis."""
        if width == self.width:
            return self
        height = max(1, round(self.height * width / self.width))
        sx, sy = width / self.width, height / self.height
        return replace(self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy)


@dataclass(frozen=True)
class LidarModel:
    """A LiDAR's beam table: of a spinning one, or of a solid-state one whose beams sweep a part of a turn.

    Beam b in column c looks along elevation_rad[b] and azimuth ``start_azimuth_rad + direction * 2 pi * (c + 0.5) / columns +
    azimuth_offset_rad[b]`` (0 along the sensor's x, counter-clockwise), at ``frame time - sweep_s + time_offset_s + sweep_s *
    (c + 0.5) / columns``: by default a sweep ends at its frame's time. Beam 0 is the highest.

    Columns that are not even have tables: ``column_azimuth_rad`` (columns,) in place of the even azimuths, in the order of
    ``direction``, and ``column_time_s`` (columns,), seconds after the frame's time plus ``time_offset_s``, in place of the even
    times. ``beam_time_s`` (beams,) is how long after its column's time a beam is fired. Raises ValueError for a table of another
    length or order.
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
        counts = {"column_azimuth_rad": self.columns, "column_time_s": self.columns, "beam_time_s": self.beams}
        for name, count in counts.items():
            table = getattr(self, name)
            if table is not None and (np.shape(table) != (count,) or not np.isfinite(table).all()):
                raise ValueError(f"{name} must be {count} numbers")
        if self.column_azimuth_rad is not None:
            turned = self.direction * np.diff(np.unwrap(self.column_azimuth_rad))
            if (turned <= 0).any() or turned.sum() >= 2 * np.pi:
                raise ValueError(f"column_azimuth_rad must turn in the direction {self.direction}, by less than a turn in all")

    @property
    def beams(self) -> int:
        """Number of beams."""
        return len(self.elevation_rad)


@dataclass(frozen=True)
class Camera:
    """A camera on its way: ``time_s[frame]`` is the image's timestamp, ``world_from_camera`` its pose at any time.

    ``sees_ego_body``: whether meshes that are the ego vehicle's body are visible to it, as they are to a camera at the roadside.
    ``full_width``: how wide its own images are, where ``model`` is for smaller or larger ones.
    """

    sensor_id: str
    model: CameraModel
    world_from_camera: Trajectory
    time_s: dict[int, float]
    sees_ego_body: bool = False
    full_width: int | None = None

    def resized(self, width: int) -> Camera:
        """Return the camera with images ``width`` pixels wide; see `CameraModel.resized`."""
        return replace(self, model=self.model.resized(width), full_width=self.full_width or self.model.width)


@dataclass(frozen=True)
class SpinPhase:
    """How far the columns of a sweep are turned beside the beam table's, where turns and sweeps do not keep step.

    ``turned_rad`` (K,) of the sweeps stamped ``times_s`` (K,), increasing; linear between them and constant beyond. It does not
    wrap: a phase that goes on turning goes on growing.
    """

    times_s: FloatArray
    turned_rad: FloatArray

    def at(self, time_s: float) -> float:
        """Return by how much the columns of the sweep at ``time_s`` are turned, radians."""
        return float(np.interp(time_s, self.times_s, self.turned_rad))


@dataclass(frozen=True)
class Lidar:
    """A LiDAR on its way: ``time_s[frame]`` is the sweep's timestamp, ``world_from_lidar`` its pose at any time.

    ``blocked`` (beams, columns) marks the cells that the vehicle itself blocks in every frame; None where that is not known.
    ``sees_ego_body`` as for a `Camera`.
    """

    sensor_id: str
    model: LidarModel
    world_from_lidar: Trajectory
    time_s: dict[int, float]
    blocked: BoolArray | None = None
    sees_ego_body: bool = False
    phase: SpinPhase | None = None

    def model_at(self, time_s: float) -> LidarModel:
        """Return the beam table of the sweep at ``time_s``: ``model``, turned by the phase."""
        if self.phase is None:
            return self.model
        turned, azimuth = self.phase.at(time_s), self.model.column_azimuth_rad
        start = self.model.start_azimuth_rad + turned
        return replace(self.model, start_azimuth_rad=start, column_azimuth_rad=None if azimuth is None else azimuth + turned)


@dataclass(frozen=True)
class Appearance:
    """Whose trained appearance and shape: actor ``actor`` of the scene at ``scene`` ("" is the drive's own scene); or, where
    ``mesh`` names a file, that of the mesh in it."""

    actor: str
    scene: str = ""
    mesh: str = ""


@dataclass(frozen=True)
class Actor:
    """An annotated thing, moving or not: a box with a look, present from start_s to end_s (both included).

    ``is_ego_body``: it is a mesh that rides on the ego vehicle, and only sensors with ``sees_ego_body`` see it.
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
    """How many times larger than the look's own box the actor is, along its own axes; ``size_m`` is the scaled box's."""

    @property
    def appearance_size_m(self) -> FloatArray:
        """The edges (3,) of the look's own box, without the scale."""
        return np.asarray(self.size_m / np.array(self.scale))

    @property
    def is_scaled(self) -> bool:
        """Whether the actor has another size than its look."""
        return self.scale != (1.0, 1.0, 1.0)

    def visible_to(self, sensor: Camera | Lidar) -> bool:
        """Return whether a sensor can see it at all."""
        return sensor.sees_ego_body or not self.is_ego_body

    def present(self, time_s: FloatArray | float) -> BoolArray:
        """Whether the actor is there at times (...): (...) bool."""
        time = np.asarray(time_s)
        return np.asarray((time >= self.start_s) & (time <= self.end_s))


@dataclass(frozen=True)
class Box:
    """A box of space that stands still: centre pose (4, 4), edges (3,) along its own axes."""

    world_from_box: FloatArray
    size_m: FloatArray


@dataclass(frozen=True)
class StaticCopy:
    """What stands above the ground inside ``source`` stands also at ``world_from_target`` (4, 4)."""

    uid: str
    source: Box
    world_from_target: FloatArray


@dataclass(frozen=True)
class Drive:
    """A recorded or edited drive."""

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
    """What was subtracted from the log's own world coordinates, float64."""

    def window(self, actor: Actor) -> tuple[float, float]:
        """When an actor is there, finite, seconds. One of the first (last) frame is there before (after) it too: a frame's
        sensors look earlier and later than its time."""
        first, last = self.time_s[self.frames[0]] - FRAME_MARGIN_S, self.time_s[self.frames[-1]] + FRAME_MARGIN_S
        start, end = actor.start_s, actor.end_s
        if start <= self.time_s[self.frames[0]]:
            start = min(first, start) if math.isfinite(start) else first
        if end >= self.time_s[self.frames[-1]]:
            end = max(last, end) if math.isfinite(end) else last
        return start, end

    @property
    def labelled_actors(self) -> list[Actor]:
        """The actors that labels have: all that some sensor of the drive can see."""
        sensors: list[Camera | Lidar] = [*self.cameras.values(), *self.lidars.values()]
        return [
            actor
            for actor in self.actors.values()
            if not actor.is_ego_body or any(actor.visible_to(sensor) for sensor in sensors)
        ]

    @property
    def duration_s(self) -> float:
        """From the first frame's time to the last one's."""
        return self.time_s[self.frames[-1]] - self.time_s[self.frames[0]]
