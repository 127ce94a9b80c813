"""What the parts of the stack hand on: detections, tracks, forecasts. World frame, metres, seconds, radians, from above."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unisim_blender.core.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class Detection:
    """A vehicle in one measurement: its box ``box`` (5,) x, y, length, width, yaw (modulo half a turn), the covariance
    (2, 2) of its place, and its score. ``weight`` says how much size and yaw are worth beside those of a sweep's, 1.

    ``seen_from`` (2,) is where the camera stands that saw it: how far it is from there is uncertain. None of a sweep.
    """

    box: FloatArray
    covariance: FloatArray
    score: float
    weight: float = 1.0
    seen_from: FloatArray | None = None

    def covariance_at(self, place: FloatArray) -> FloatArray:
        """Return the covariance (2, 2) if the vehicle is at a place (2,): along a camera's ray the standard deviation grows with
        the square of the distance, as a pixel's share of it does."""
        if self.seen_from is None:
            return self.covariance
        ray = self.box[:2] - self.seen_from
        stretch = float((place - self.seen_from) @ (place - self.seen_from) / (ray @ ray))
        along: FloatArray = np.eye(2) + (stretch - 1) * np.outer(ray, ray) / (ray @ ray)
        return np.asarray(along @ self.covariance @ along)


@dataclass(frozen=True, eq=False)
class Track:
    """A vehicle over time: ``state`` (4,) x, y and their rates, its ``covariance`` (4, 4), and ``shape`` (3,) length, width
    and yaw, with the ``weight`` that these have gathered.

    ``time_s`` is the time of the state, ``seen_s`` of the last detection; ``hits`` counts the detections. ``imaged`` is the last
    one in an image, ``imaged_s`` its time; ``swept_s`` is the time of the last one in a sweep.
    """

    number: int
    time_s: float
    state: FloatArray
    covariance: FloatArray
    shape: FloatArray
    weight: float
    score: float
    seen_s: float
    hits: int = 1
    imaged: Detection | None = None
    imaged_s: float = -np.inf
    swept_s: float = -np.inf

    @property
    def box(self) -> FloatArray:
        """x, y, length, width, yaw (5,)."""
        return np.concatenate([self.state[:2], self.shape])

    @property
    def speed_m_s(self) -> float:
        """Its speed."""
        return float(np.hypot(*self.state[2:]))

    @property
    def speed_deviation_m_s(self) -> float:
        """The standard deviation of the velocity along its most uncertain direction."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[2:, 2:])[-1]))


@dataclass(frozen=True, eq=False)
class Mode:
    """One forecast of a track: boxes (T, 5) at the times that were asked for, and its probability. Only the boxes of the first
    ``trusted`` times are near enough to plan by."""

    boxes: FloatArray
    probability: float
    trusted: int
