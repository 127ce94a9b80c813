"""States of the ego vehicle and of actors at a moment of a simulation, and the traffic that each of them meets.

World: metres, z up, as in `world.drive`. Headings: radians, counter-clockwise from the world's x. Times: integer microseconds
from the log's first frame.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from ..errors import UnisimError
from ..geometry import FloatArray, Quaternion, Vector3, make_pose
from ..world.drive import EGO, Actor


@dataclass(frozen=True)
class EgoState:
    """The ego vehicle at a moment, by the middle of its rear axle: ``x_m``, ``y_m``, ``heading_rad``.

    ``speed_m_s`` is along the heading and never negative. ``acceleration_m_s2`` and ``steering_rad``, the front wheels' angle
    (left is positive), are what the vehicle does, which lags behind what it was asked for.
    """

    x_m: float
    y_m: float
    heading_rad: float
    speed_m_s: float
    acceleration_m_s2: float = 0.0
    steering_rad: float = 0.0


@dataclass(frozen=True)
class ActorState:
    """An actor at a moment: the pose of its box's centre, world frame; ``speed_m_s`` along its heading, never negative;
    ``present``: whether it is in the world at all."""

    position_m: Vector3
    quaternion_wxyz: Quaternion
    speed_m_s: float
    acceleration_m_s2: float = 0.0
    present: bool = True

    @cached_property
    def pose(self) -> FloatArray:
        """The pose (4, 4) of the box's centre."""
        return make_pose(np.array(self.position_m), np.array(self.quaternion_wxyz))

    @cached_property
    def heading_rad(self) -> float:
        """The heading of the box's x axis in the world's plane."""
        w, x, y, z = self.quaternion_wxyz
        return math.atan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))


@dataclass(frozen=True)
class Footprint:
    """A box seen from above: its centre, heading and size, and how it moves along its heading.

    ``uid`` is the actor's, or `EGO`; ``label`` its class in the log's words.
    """

    uid: str
    label: str
    x_m: float
    y_m: float
    heading_rad: float
    length_m: float
    width_m: float
    speed_m_s: float
    acceleration_m_s2: float = 0.0

    @cached_property
    def corners(self) -> FloatArray:
        """The corners (4, 2), world frame: front left, rear left, rear right, front right."""
        along = np.array([math.cos(self.heading_rad), math.sin(self.heading_rad)]) * (self.length_m / 2)
        across = np.array([-math.sin(self.heading_rad), math.cos(self.heading_rad)]) * (self.width_m / 2)
        return np.array([self.x_m, self.y_m]) + np.stack(
            [along + across, across - along, -along - across, along - across]
        )


def actor_footprint(actor: Actor, state: ActorState) -> Footprint:
    """Return an actor's box seen from above."""
    length, width, _ = actor.size_m.tolist()
    x, y, _ = state.position_m
    return Footprint(
        actor.uid, actor.label, x, y, state.heading_rad, length, width, state.speed_m_s, state.acceleration_m_s2
    )


@dataclass(frozen=True, eq=False)
class FootprintArrays:
    """Footprints as arrays (N,): places and half sizes in metres, headings in radians with their cosines and sines, speeds in
    m/s, and the radius of each box's circle."""

    x_m: FloatArray
    y_m: FloatArray
    heading_rad: FloatArray
    cos: FloatArray
    sin: FloatArray
    half_length_m: FloatArray
    half_width_m: FloatArray
    radius_m: FloatArray
    speed_m_s: FloatArray

    def chosen(self, which: Sequence[int]) -> FootprintArrays:
        """Return some of the boxes, by their indices."""
        at = np.array(which, int)
        return FootprintArrays(*(getattr(self, field.name)[at] for field in fields(self)))


@dataclass(frozen=True)
class Traffic:
    """All that is present at a moment, the ego vehicle included: what models of actors react to."""

    time_us: int
    footprints: tuple[Footprint, ...]

    @cached_property
    def by_uid(self) -> dict[str, Footprint]:
        """The footprints by their identifiers."""
        return {footprint.uid: footprint for footprint in self.footprints}

    @cached_property
    def _places(self) -> dict[str, int]:
        return {footprint.uid: index for index, footprint in enumerate(self.footprints)}

    def places_of(self, uid: str, others: Iterable[str] = ()) -> list[int]:
        """The indices of a footprint and of others, by their identifiers, of those that are present."""
        places = self._places
        return [places[name] for name in (uid, *others) if name in places]

    @cached_property
    def boxes(self) -> FootprintArrays:
        """The footprints as arrays, in their order. Raises `UnisimError` for one with a value that is not finite."""
        names = ("x_m", "y_m", "heading_rad", "length_m", "width_m", "speed_m_s")
        table = np.array(
            [[getattr(footprint, name) for name in names] for footprint in self.footprints], float
        ).reshape(-1, 6)
        finite = np.isfinite(table)
        if not finite.all():
            row, column = np.argwhere(~finite)[0]
            value = table[row, column]
            raise UnisimError(
                f'traffic at {self.time_us} us: "{self.footprints[row].uid}" has {names[column]} {value:g}, which is not finite'
            )
        x, y, heading, length, width, speed = table.T
        radius = np.hypot(length, width) / 2
        return FootprintArrays(x, y, heading, np.cos(heading), np.sin(heading), length / 2, width / 2, radius, speed)

    @property
    def ego(self) -> Footprint:
        """The ego vehicle's footprint."""
        return self.by_uid[EGO]
