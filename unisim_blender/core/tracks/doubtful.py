"""Doubtful places of tracks: where a person should look, whatever made the boxes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry import FloatArray, convex_intersection_area
from ..world.classes import motion_of
from ..world.drive import Actor
from .box_file import Track

JUMP_M = 0.6
"""Distance, metres, of a key from where its neighbours' motion puts it, above which it is a jump."""
GAP = 2.6
"""Time between two keys of a moving actor, relative to the usual one, above which it is a gap."""
OVERLAP = 0.15
"""Common area of two boxes, relative to the smaller one."""
FASTEST_M_S = {"deforming": 4.5, "rigid": 45.0}
TURNING_RAD_S = 1.2
SIDEWAYS = math.radians(25)
"""Angle between heading and motion of a vehicle."""
SIZES_M = {"deforming": ((0.2, 0.2, 0.6), (2.5, 1.6, 2.4)), "rigid": ((1.0, 0.4, 0.8), (25.0, 3.6, 4.6))}
UNCERTAIN = 0.35
NEAR_S = 0.75
"""Places of one kind of one track that are closer in time are one."""


@dataclass(frozen=True)
class DoubtfulPlace:
    """A place of a track to look at: ``kind`` is "jump", "gap", "overlap", "speed", "turn", "sideways", "size" or
    "uncertain"; ``value`` is what is doubtful, in the unit of the kind (m, s, share of an area, m/s, rad/s, rad, m, 0..1);
    ``other`` the second box of an overlap."""

    uid: str
    time_s: float
    kind: str
    value: float
    other: str = ""


def doubtful_places(tracks: Sequence[Track], times_s: FloatArray) -> tuple[DoubtfulPlace, ...]:
    """Return the doubtful places of tracks that were not dismissed, in order of tracks and times. Overlaps are looked for
    at ``times_s`` (F,)."""
    places = [place for track in tracks for place in _of_track(track)]
    places += [DoubtfulPlace(track.actor.uid, at, "uncertain", value) for track in tracks for at, value in track.unsure]
    places += _overlaps([track.actor for track in tracks], times_s)
    order = {track.actor.uid: n for n, track in enumerate(tracks)}
    left = [place for place in places if not _is_dismissed(place, tracks[order[place.uid]])]
    return tuple(sorted(left, key=lambda place: (order[place.uid], place.time_s, place.kind)))


def _is_dismissed(place: DoubtfulPlace, track: Track) -> bool:
    return any(kind == place.kind and abs(time - place.time_s) < NEAR_S for time, kind in track.dismissed)


def _of_track(track: Track) -> list[DoubtfulPlace]:
    actor, path = track.actor, track.actor.world_from_actor
    kind = "deforming" if motion_of(actor.label) == "deforming" else "rigid"
    uid, places = actor.uid, []
    low, high = SIZES_M[kind]
    beyond = np.maximum(np.subtract(low, actor.size_m), np.subtract(actor.size_m, high))
    if (beyond > 0).any() and motion_of(actor.label) != "still":
        axis = int(beyond.argmax())
        places.append(DoubtfulPlace(uid, float(path.times_s[0]), "size", float(actor.size_m[axis])))
    if not actor.is_moving or len(path.times_s) < 3:
        return places
    times, at = path.times_s, path.positions
    dt = np.diff(times)
    velocity = np.diff(at, axis=0) / dt[:, None]
    speed, middle = np.linalg.norm(velocity[:, :2], axis=1), (times[1:] + times[:-1]) / 2
    share = dt[:-1] / (dt[:-1] + dt[1:])
    off = np.linalg.norm(at[1:-1] - (at[:-2] + share[:, None] * (at[2:] - at[:-2])), axis=1)
    kinds = [
        ("jump", times[1:-1], off, JUMP_M + 2.0 * dt[:-1] * dt[1:]),  # braking and turning explain some
        ("gap", middle, dt, GAP * np.median(dt)),
        ("speed", middle, speed, FASTEST_M_S[kind]),
    ]
    if kind == "rigid":
        heading = np.unwrap(np.arctan2(path.poses[:, 1, 0], path.poses[:, 0, 0]))
        angle = np.arctan2(velocity[:, 1], velocity[:, 0]) - (heading[1:] + heading[:-1]) / 2
        angle = np.abs((angle + np.pi / 2) % np.pi - np.pi / 2)  # backwards is none
        kinds.append(("turn", middle, np.abs(np.diff(heading)) / dt, TURNING_RAD_S))
        kinds.append(("sideways", middle, np.where(speed > 2.0, angle, 0.0), SIDEWAYS))
    for name, at_s, values, limit in kinds:
        rows = np.flatnonzero(values > limit)
        worst = rows[worst_of_runs(at_s[rows], values[rows])]
        places += [DoubtfulPlace(uid, float(at_s[row]), name, float(values[row])) for row in worst]
    return places


def worst_of_runs(times: FloatArray, badness: FloatArray) -> list[int]:
    """Return the number of the worst place of each run of places."""
    runs = np.split(np.arange(len(times)), np.flatnonzero(np.diff(times) > NEAR_S) + 1) if len(times) else []
    return [int(run[badness[run].argmax()]) for run in runs]


def _overlaps(actors: Sequence[Actor], times_s: FloatArray) -> list[DoubtfulPlace]:
    """Return where two boxes are in one place, a place a pair."""
    worst: dict[tuple[str, str], tuple[float, float]] = {}
    for time in np.asarray(times_s).tolist():
        there = [actor for actor in actors if actor.present(time)]
        if len(there) < 2:
            continue
        poses = np.array([actor.world_from_actor.at(time) for actor in there])
        radius = np.array([float(np.linalg.norm(actor.size_m[:2])) / 2 for actor in there])
        for a in range(len(there) - 1):
            apart = np.linalg.norm(poses[a + 1 :, :2, 3] - poses[a, :2, 3], axis=1)
            for b in (a + 1 + np.flatnonzero(apart < radius[a] + radius[a + 1 :])).tolist():
                share = _common_share(poses[a], there[a].size_m, poses[b], there[b].size_m)
                pair = there[a].uid, there[b].uid
                if share > max(OVERLAP, worst.get(pair, (0.0, 0.0))[0]):
                    worst[pair] = share, time
    return [DoubtfulPlace(a, time, "overlap", share, b) for (a, b), (share, time) in worst.items()]


def _common_share(pose: FloatArray, size: FloatArray, other: FloatArray, other_size: FloatArray) -> float:
    """Return the area that is common to two boxes seen from above, relative to the smaller one; 0 where they lie above
    each other."""
    if abs(pose[2, 3] - other[2, 3]) > (size[2] + other_size[2]) / 2:
        return 0.0
    corners = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) / 2
    middle = pose[:2, 3]  # near the origin nothing is lost to large coordinates
    rings = [corners * a[:2] @ p[:2, :2].T + p[:2, 3] - middle for p, a in ((pose, size), (other, other_size))]
    area = convex_intersection_area(rings[0][None], rings[1][None])[0]
    return float(area / min(np.prod(size[:2]), np.prod(other_size[:2])))
