"""A tracker of vehicles: a Kalman filter of constant velocity for each, and the assignment of least cost between tracks and
detections within their gates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from unisim_blender.core.evaluation.autonomy.document import bev_iou
from unisim_blender.core.geometry import FloatArray

from .objects import Detection, Track

ACCELERATION_M_S2 = 1.5
"""Standard deviation of a vehicle's acceleration, white noise."""
FIRST_SPEED_M_S = 6.0
"""Standard deviation of a velocity of which nothing is known."""
GATE = 9.21
"""Squared Mahalanobis distance that 99 % of a track's detections have at most (two degrees of freedom)."""
BEGIN_SCORE, HITS = 0.6, 3
"""A detection of this score begins a track, which is confirmed by so many detections."""
TENTATIVE_S, LOST_S, MOST_LOST_S = 0.25, 0.15, 1.5
"""How long a track lasts without a detection: before it is confirmed, and after that for each detection that it has had, up to
a most."""
SWEPT_S = 0.3
"""So long after a sweep's detection images do not move a track."""
APART_M = 2.0
"""No track begins nearer to another one, in metres or in its detection's deviations."""
MOST_SHARED = 0.1
"""Of two tracks whose boxes have a larger IoU one is left out: two vehicles are not in one place. That of a car parked half a
metre behind another is 0, with boxes that are each a metre too long 0.05."""
MOST_WEIGHT = 10.0
"""Size and yaw are means over so many sweeps' detections at most."""
_FORBIDDEN = 1e6


class Tracker:
    """Follows vehicles through the detections of all sensors, in the order of their times."""

    def __init__(self) -> None:
        self._tracks: list[Track] = []
        self._begun = 0

    @property
    def confirmed(self) -> list[Track]:
        """The tracks of `HITS` detections or more."""
        return [track for track in self._tracks if track.hits >= HITS]

    def update(self, time_s: float, detections: Sequence[Detection]) -> None:
        """Take in what a sensor measured at a time. One that is before the last one's is taken as of the last one's."""
        tracks = [predicted(track, time_s) for track in self._tracks]
        pairs = assigned(tracks, detections)
        for row, column in pairs:
            tracks[row] = corrected(tracks[row], detections[column])
        taken = {column for _, column in pairs}
        for column, detection in enumerate(detections):
            if column not in taken and detection.score >= BEGIN_SCORE and not _is_there(tracks, detection):
                tracks.append(self._begin(time_s, detection))
        self._tracks = distinct([track for track in tracks if not _is_lost(track)])

    def _begin(self, time_s: float, detection: Detection) -> Track:
        self._begun += 1
        covariance = np.zeros((4, 4))
        covariance[:2, :2] = detection.covariance
        covariance[2:, 2:] = np.eye(2) * FIRST_SPEED_M_S**2
        state = np.array([*detection.box[:2], 0.0, 0.0])
        shape = detection.box[2:].copy()
        track = Track(self._begun, time_s, state, covariance, shape, detection.weight, detection.score, time_s)
        return _seen_by(track, detection)


def predicted(track: Track, time_s: float) -> Track:
    """Return a track at a later time."""
    dt = time_s - track.time_s
    if dt <= 0:
        return track
    move = np.eye(4)
    move[0, 2] = move[1, 3] = dt
    gain = np.array([[dt * dt / 2, 0], [0, dt * dt / 2], [dt, 0], [0, dt]])
    covariance = move @ track.covariance @ move.T + ACCELERATION_M_S2**2 * gain @ gain.T
    return replace(track, time_s=time_s, state=move @ track.state, covariance=covariance)


def corrected(track: Track, detection: Detection) -> Track:
    """Return a track with a detection of its time taken in. What sweeps have is not moved by images, which all err alike."""
    state, covariance = track.state, track.covariance
    if detection.seen_from is None or track.time_s - track.swept_s > SWEPT_S:
        measured = detection.covariance_at(track.state[:2])
        innovation = track.covariance[:2, :2] + measured
        gain = np.linalg.solve(innovation, track.covariance[:2]).T
        state = track.state + gain @ (detection.box[:2] - track.state[:2])
        # Joseph's form stays positive definite
        kept = np.eye(4)
        kept[:, :2] -= gain
        covariance = kept @ track.covariance @ kept.T + gain @ measured @ gain.T
    share = detection.weight / (track.weight + detection.weight)
    shape = track.shape + share * np.append(
        detection.box[2:4] - track.shape[:2], half_turn(detection.box[4] - track.shape[2])
    )
    return replace(
        _seen_by(track, detection),
        state=state,
        covariance=covariance,
        shape=shape,
        weight=min(track.weight + detection.weight, MOST_WEIGHT),
        score=track.score + 0.3 * (detection.score - track.score),
        seen_s=track.time_s,
        hits=track.hits + 1,
    )


def assigned(tracks: Sequence[Track], detections: Sequence[Detection]) -> list[tuple[int, int]]:
    """Return which track (by its index) has which detection: the pairs within their gates of the least sum of squared
    Mahalanobis distances and logarithms of determinants."""
    if not tracks or not detections:
        return []
    costs = np.full((len(tracks), len(detections)), _FORBIDDEN)
    for row, track in enumerate(tracks):
        for column, detection in enumerate(detections):
            innovation = track.covariance[:2, :2] + detection.covariance_at(track.state[:2])
            distance = squared_distance(detection.box[:2] - track.state[:2], innovation)
            if distance <= GATE:
                costs[row, column] = distance + float(np.linalg.slogdet(innovation)[1])
    rows, columns = linear_sum_assignment(costs)
    return [(int(r), int(c)) for r, c in zip(rows, columns, strict=True) if costs[r, c] < _FORBIDDEN]


def distinct(tracks: Sequence[Track]) -> list[Track]:
    """Return the tracks, in their order, without a camera's second opinions of vehicles that the LiDAR sees: those that stand in
    a track with more weight, and those that may be one (`_is_second_opinion`)."""
    if not tracks:
        return []
    shared = bev_iou(*[np.array([track.box for track in tracks])] * 2)
    kept: list[int] = []
    for index in sorted(range(len(tracks)), key=lambda i: (-tracks[i].weight, -tracks[i].hits, i)):
        if not kept or shared[index, kept].max() <= MOST_SHARED:
            kept.append(index)
    return [tracks[i] for i in sorted(kept) if not any(_is_second_opinion(tracks[i], tracks[of]) for of in kept)]


def _is_second_opinion(track: Track, of: Track) -> bool:
    """Return whether a track that no sweep has had may be a confirmed one that sweeps have had, by the covariance of its last
    image: all images err alike, while the filter's covariance shrinks with each. Two vehicles in one image are two."""
    if np.isfinite(track.swept_s) or track.imaged is None or track.imaged_s == of.imaged_s:
        return False
    if not np.isfinite(of.swept_s) or of.hits < HITS:
        return False
    offset = track.state[:2] - of.state[:2]
    return squared_distance(offset, of.covariance[:2, :2] + track.imaged.covariance_at(of.state[:2])) <= GATE


def _seen_by(track: Track, detection: Detection) -> Track:
    """Return a track that a detection has now seen."""
    if detection.seen_from is None:
        return replace(track, swept_s=track.time_s)
    return replace(track, imaged=detection, imaged_s=track.time_s)


def squared_distance(offset: FloatArray, covariance: FloatArray) -> float:
    """Return the squared Mahalanobis distance of an offset (2,)."""
    return float(offset @ np.linalg.solve(covariance, offset))


def half_turn(angle_rad: float) -> float:
    """Return the angle modulo half a turn, within a quarter turn to either side."""
    return float((angle_rad + np.pi / 2) % np.pi - np.pi / 2)


def _is_there(tracks: Sequence[Track], detection: Detection) -> bool:
    """Return whether a track is so near that a detection is its second one."""
    for track in tracks:
        offset = detection.box[:2] - track.state[:2]
        if np.hypot(*offset) < APART_M or squared_distance(offset, detection.covariance) < APART_M**2:
            return True
    return False


def _is_lost(track: Track) -> bool:
    lasts_s = min(LOST_S * track.hits, MOST_LOST_S) if track.hits >= HITS else TENTATIVE_S
    return track.time_s - track.seen_s > lasts_s
