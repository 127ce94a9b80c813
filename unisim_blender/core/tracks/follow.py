"""One actor followed through the sweeps of a log, from boxes that a person drew at one or several moments.

From each drawn box, forward and backward: the motion so far predicts the box at the next sweep, and the returns inside
of it are aligned with those of earlier sweeps. Then all sweeps between two drawn boxes, which stay, are registered together,
as those of a found actor are (`register`).
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import LogError
from ..geometry import FloatArray, Trajectory, first_in_voxels, mean_pose, spread_indices
from ..poses.sweeps import import_scipy
from ..world.box_tracks import CLOSEST_KEYS_S, HALF_FRAME_S, spread_keys
from ..world.classes import motion_of
from .box_file import Track
from .boxes import closest_heading, completed, extent
from .doubtful import UNCERTAIN, worst_of_runs
from .register import (
    ACROSS,
    FAST,
    LAGS,
    MOST_RETURNS,
    ActorReturns,
    PlanarPath,
    Planes,
    align,
    in_box,
    register,
    rotated,
    smoothed,
)
from .scans import SweepStore

MARGIN_M, ABOVE_M = 0.4, 0.3
"""Distance around a box, and above it, within which returns are taken for the actor's."""
CLEARANCE_M = 0.2
"""Height above the ground below which returns are the ground's."""
REACHES_M = (0.6, 0.5, 0.4, 0.3)
VOXEL_M = 0.07
FEWEST_POINTS = 6
LOST_S = 0.9
"""Time without an accepted sweep after which an actor is lost."""
WORST_OVERLAP, CLOSE_M = 0.45, 0.2
"""A sweep of which fewer returns than this part are this close to earlier ones is not accepted."""
HISTORY_S = 0.55
"""Time over which the motion is measured that predicts the next sweep."""
PLACE_M, ACCELERATION, TURN_RAD_S = 0.08, 4.0, 0.15
"""Standard deviations of a prediction: metres, m/s², and radians for each second."""
FASTEST_M_S = 40.0
STANDING_M = 0.45
"""A track stands whose places, nine in ten, lie within this distance of its drawn box."""
LONG_MOVED = 5
"""Number of sweeps in a row that say that an actor moves."""
CHORD_S = 3.0
"""Time between two drawn boxes up to which their distance says how fast an actor is."""
DRAWN_M = 0.01
"""A drawn box is an earlier one where it is no further from it."""
MOST_TURN_RAD = math.radians(12)
"""Largest angle by which a box is turned to lie along its faces."""
GROUND_M = 1.2
"""The ground is searched within this height of a drawn box's bottom, and of the ground in the sweep before."""
HEIGHT_M = 0.1
"""Standard deviation of the ground's height below a box, of one sweep."""


@dataclass(frozen=True)
class DrawnBox:
    """A box that a person drew: its pose (4, 4) in the world of the log at a time, seconds."""

    time_s: float
    pose: FloatArray

    @property
    def planar(self) -> FloatArray:
        """The pose (3,) in the plane: x, y, heading."""
        return np.array([self.pose[0, 3], self.pose[1, 3], math.atan2(self.pose[1, 0], self.pose[0, 0])])

    def at_sweep(self, store: SweepStore) -> DrawnBox:
        """Return the box at the time at which the beams of the sweep nearest to its time passed it: a box that was drawn
        around the returns of a frame's sweep was there then. Without sweeps it stays."""
        if not len(store.refs):
            return self
        nearest = int(np.abs(store.times_s - self.time_s).argmin())
        return replace(self, time_s=store.passing_s(nearest, self.pose[:2, 3]))


@dataclass(frozen=True)
class _Motion:
    """Where an actor is at a time, x, y, heading (3,), and how these change (3,), a second."""

    time_s: float
    pose: FloatArray
    rate: FloatArray

    def at(self, time_s: FloatArray | float) -> FloatArray:
        """Return the poses (..., 3) at times: speed and turn rate are constant."""
        dt = np.asarray(time_s, float)[..., None] - self.time_s
        way = rotated(self.rate[2] * dt[..., 0] / 2, self.rate[:2]) * dt
        return self.pose + np.concatenate([way, self.rate[2] * dt], -1)


@dataclass(frozen=True)
class _Sighting:
    """An actor in sweep ``number``: pose (3,), height of the ground below, returns (N, 3) in the world with heights above
    the ground and in the actor's frame, their times (N,), the LiDAR's place (2,), and how well these fit, 0..1."""

    number: int
    time_s: float
    pose: FloatArray
    ground_m: float
    points: FloatArray
    local: FloatArray
    times_s: FloatArray
    origin: FloatArray
    overlap: float = 1.0

    @property
    def certainty(self) -> float:
        """How certain the place is: by its overlap and its number of returns."""
        return self.overlap * len(self.local) / (len(self.local) + 10.0)

    @property
    def weight(self) -> float:
        """Number of returns that it explains."""
        return self.certainty * len(self.local)


class _Follower:
    """Passes of one actor of a size and class over the sweeps."""

    def __init__(self, store: SweepStore, size_m: FloatArray, label: str, boxes: Sequence[DrawnBox]) -> None:
        self.store, self.size, self.boxes = store, np.asarray(size_m, float), boxes
        self.done, self.total = 0, len(store.refs) * (2 if len(boxes) == 1 else 4)
        self.is_rigid = motion_of(label) != "deforming"

    def seen(
        self, number: int, motion: _Motion, ground_m: float, margin: float, is_drawn: bool = False
    ) -> _Sighting | None:
        """Return what a sweep shows in the predicted box, at the time at which the beams passed it, or at the motion's
        own; None where too little is there. ``ground_m``: where no ground is seen."""
        half = self.size / 2
        guess = motion.at(self.store.times_s[number])
        reach = float(np.linalg.norm(half[:2])) + 2.5 + 0.06 * float(np.linalg.norm(motion.rate[:2]))
        scan = self.store.near(number, guess[:2], reach)
        local = in_box(scan.points - [0, 0, ground_m], motion.at(scan.time_s))
        ground = _ground_height(local, half)
        local[:, 2] -= ground
        inside = (np.abs(local[:, :2]) < half[:2] + margin).all(1)
        inside &= (local[:, 2] > CLEARANCE_M) & (local[:, 2] < self.size[2] + ABOVE_M)
        if inside.sum() < FEWEST_POINTS:
            return None
        rows = np.flatnonzero(inside)
        rows = rows[first_in_voxels(local[rows], VOXEL_M)]
        time_s = motion.time_s if is_drawn else float(np.median(scan.time_s[inside]))
        points = np.column_stack([scan.points[rows, :2], local[rows, 2]])
        pose, origin = motion.at(time_s), scan.origins[rows[0], :2]
        return _Sighting(number, time_s, pose, ground_m + ground, points, local[rows], scan.time_s[rows], origin)

    def sightings(
        self, box: DrawnBox, numbers: Sequence[int], rate: FloatArray, stands: bool = False
    ) -> Iterator[_Sighting]:
        """Yield the sightings of sweeps from a drawn box on, until the actor is lost; the first is that at the box.
        ``rate`` (3,): how its pose changes at first; ``stands``: it stays where it is."""
        motion, bottom = _Motion(box.time_s, box.planar, rate), float(box.pose[2, 3] - self.size[2] / 2)
        seen, at = None, 0
        while seen is None:
            if at == len(numbers) or abs(self.store.times_s[numbers[at]] - box.time_s) > LOST_S:
                return
            seen, at = self.seen(numbers[at], motion, bottom, MARGIN_M - 0.1, at == 0), at + 1
        yield seen
        sign = 1.0 if numbers[-1] > numbers[0] else -1.0
        before = [seen.time_s - sign * 0.1 * n for n in (2, 1)]
        history = [(time, motion.at(time)) for time in before] + [(seen.time_s, seen.pose)]
        accepted, last_s = [seen], seen.time_s
        for number in numbers[at:]:
            seen = self.seen(number, motion, accepted[-1].ground_m, MARGIN_M)
            if seen is None or sign * (seen.time_s - last_s) < CLOSEST_KEYS_S / 2:
                time_s = float(self.store.times_s[number])
            else:
                seen = self._aligned(seen, accepted, 0.0 if stands else abs(seen.time_s - last_s))
                time_s = seen.time_s
                if seen.overlap >= WORST_OVERLAP:
                    accepted.append(seen)
                    last_s = time_s
                    if not stands:
                        recent = [at for at in history[:-1] if abs(at[0] - time_s) < HISTORY_S]
                        history = [*recent, history[-1], (time_s, seen.pose)]
                        motion = _motion_of(history)
                    yield seen
            if abs(time_s - last_s) > LOST_S and not stands:
                return

    def _aligned(self, seen: _Sighting, accepted: Sequence[_Sighting], dt: float) -> _Sighting:
        """Return a sighting aligned with earlier ones, ``dt`` seconds after the last; of 0 it stays."""
        chosen = {id(accepted[-lag]): accepted[-lag] for lag in LAGS if lag <= len(accepted)} | {0: accepted[0]}
        model = np.concatenate([_thinned(other.local) for other in chosen.values()])
        local, pose = seen.local, np.zeros(3)
        if dt:
            noise = PLACE_M + ACCELERATION * dt * dt / 2
            planes = Planes(model, np.zeros(len(model), np.int64))
            pose = align(_thinned(local, 400), planes, (noise, noise, TURN_RAD_S * dt))
            local = in_box(local, pose)
        distance, _ = import_scipy("to follow an actor,").cKDTree(model).query(local, distance_upper_bound=CLOSE_M)
        inside = (np.abs(local[:, :2]) < self.size[:2] / 2 + 0.2).all(1)
        moved = seen.pose + np.append(rotated(seen.pose[2], pose[:2]), pose[2])
        values = {"points": seen.points[inside], "local": local[inside], "times_s": seen.times_s[inside]}
        return replace(seen, pose=moved, overlap=float(np.isfinite(distance).mean()), **values)

    def _numbers(self, box: DrawnBox, forward: bool, until_s: float) -> list[int]:
        """Return the numbers of sweeps from a drawn box to a time, that first whose beams passed it then."""
        times = self.store.times_s
        near = np.argsort(np.abs(times - box.time_s), kind="stable")[:6].tolist()
        nearest = min(near, key=lambda n: (abs(self.store.passing_s(n, box.pose[:2, 3]) - box.time_s), n))
        on = range(nearest, len(times)) if forward else range(nearest, -1, -1)
        return [n for n in on if (times[n] <= until_s + 0.15 if forward else times[n] >= until_s - 0.15)]

    def _first_rate(self, box: DrawnBox, numbers: Sequence[int]) -> FloatArray:
        """Return the velocity under which the next sweeps fit best."""
        heading = box.planar[2]
        if self.is_rigid:
            others = [o for o in self.boxes if 0 < abs(o.time_s - box.time_s) < CHORD_S]
            speeds = np.arange(-6.0, FASTEST_M_S, 1.0)
            if others:
                other = min(others, key=lambda one: abs(one.time_s - box.time_s))
                way = (other.pose[:3, 3] - box.pose[:3, 3]) / (other.time_s - box.time_s)
                speeds = float(way @ box.pose[:3, 0]) + np.arange(-4.0, 4.5, 1.0)
            motions = [(float(speed), heading) for speed in speeds]
        else:
            turns = heading + np.arange(0, 2 * math.pi, math.pi / 4)
            motions = [(0.0, heading), *((v, a) for v in (0.8, 1.6, 2.4, 3.2) for a in turns)]
        rates = [np.array([v * math.cos(a), v * math.sin(a), 0.0]) for v, a in motions]
        times = self.store.times_s
        trial = [*numbers[:1], *(n for n in numbers if abs(times[n] - times[numbers[0]]) > 0.06)][:4]

        def score(rate: FloatArray, count: int) -> float:
            seen = [*self.sightings(box, trial[: count + 1], rate)]
            # by what lies on what, how much of the first sweep is met, and a slower motion where both are good
            met = (s.overlap * min(1.0, len(s.local) / len(seen[0].local)) for s in seen[1:])
            return sum(met) - 0.002 * count * float(np.linalg.norm(rate))

        best = sorted(rates, key=lambda rate: -score(rate, 1))[:5]
        seen = [*self.sightings(box, trial, max(best, key=lambda rate: score(rate, 3)))]
        return _motion_of([(s.time_s, s.pose) for s in seen]).rate * [1, 1, 0] if len(seen) > 1 else np.zeros(3)

    def _pass(self, box: DrawnBox | None, until_s: float, stands: bool) -> Generator[float, None, list[_Sighting]]:
        """Return the sightings from a drawn box to a time, in order of time; yields the share of all that is done."""
        if box is None:
            return []
        forward = until_s > box.time_s
        numbers = self._numbers(box, forward, until_s)
        rate = np.zeros(3) if stands else self._first_rate(box, numbers)
        sightings = []
        for seen in self.sightings(box, numbers, rate, stands):
            sightings.append(seen)
            self.done += 1
            yield min(1.0, self.done / self.total)
        return sightings if forward else sightings[::-1]

    def span(
        self, first: DrawnBox | None, last: DrawnBox | None, stands: bool
    ) -> Generator[float, None, list[_Sighting]]:
        """Return the sightings from a drawn box to the next, or before the first or after the last one; registered. Yields
        as `follow`."""
        low, high = -math.inf if first is None else first.time_s, math.inf if last is None else last.time_s
        there = yield from self._pass(first, high, stands)
        back = yield from self._pass(last, low, stands)
        inner = [
            [s for s in part if low + CLOSEST_KEYS_S < s.time_s < high - CLOSEST_KEYS_S]
            for part in (there[1:], back[:-1])
        ]
        nodes = [*there[:1], *_joined(*inner), *back[-1:]]
        return nodes if stands or len(nodes) < 3 else _registered(nodes, len(there[:1]), len(back[-1:]))


def _thinned(points: FloatArray, most: int = MOST_RETURNS) -> FloatArray:
    return points[spread_indices(len(points), most)]


def _motion_of(history: Sequence[tuple[float, FloatArray]]) -> _Motion:
    """Return the motion along poses (3,) at times, from the last one on."""
    times, poses = np.array([time for time, _ in history]), np.array([pose for _, pose in history])
    away = times - times.mean()
    rate = away @ (poses - poses.mean(0)) / (away @ away)
    rate[:2] = rotated(rate[2] * away[-1], rate[:2])  # the mean velocity is that in the middle
    return _Motion(float(times[-1]), poses[-1], rate)


def _joined(there: list[_Sighting], back: list[_Sighting]) -> list[_Sighting]:
    """Return the sightings of two passes: of the first up to where they are nearest to each other, then of the second."""
    at = {seen.number: n for n, seen in enumerate(back)}
    both = [
        (float(np.linalg.norm(seen.pose - back[at[seen.number]].pose)), n)
        for n, seen in enumerate(there)
        if seen.number in at
    ]
    if both:
        n = min(both)[1]
        return there[: n + 1] + back[at[there[n].number] + 1 :]
    return there + [seen for seen in back if not there or seen.time_s > there[-1].time_s + CLOSEST_KEYS_S]


def _returns(nodes: Sequence[_Sighting]) -> tuple[ActorReturns, PlanarPath]:
    """Return the returns of sightings, and the path."""
    rows = [spread_indices(len(node.points), MOST_RETURNS) for node in nodes]
    points = np.concatenate([node.points[at] for node, at in zip(nodes, rows, strict=True)])
    later = np.concatenate([node.times_s[at] - node.time_s for node, at in zip(nodes, rows, strict=True)])
    poses = np.array([node.pose for node in nodes])
    path = PlanarPath(np.array([node.time_s for node in nodes]), poses[:, :2], np.unwrap(poses[:, 2]))
    return ActorReturns(points, later, np.repeat(np.arange(len(nodes)), [len(at) for at in rows])), path


def _registered(nodes: Sequence[_Sighting], first: int, last: int) -> list[_Sighting]:
    """Return sightings registered together; as many at the ends stay."""
    returns, path = _returns(nodes)
    at = np.arange(len(nodes))
    path = register(returns, path, None, REACHES_M, (at < first) | (at >= len(nodes) - last), ACROSS)
    poses = np.column_stack([path.positions, path.yaw_rad])
    return [replace(node, pose=pose) for node, pose in zip(nodes, poses, strict=True)]


def _ground_height(local: FloatArray, half: FloatArray) -> float:
    """Return the ground's height below a box's middle, in its frame, of returns (N, 3) around it: a plane through the
    lowest returns of cells 1 m wide; 0 where fewer than four are seen."""
    low = local[~(np.abs(local[:, :2]) < half[:2] + 0.2).all(1) & (np.abs(local[:, 2]) < GROUND_M)]
    if not len(low):
        return 0.0
    low = low[np.argsort(low[:, 2], kind="stable")]
    low = low[first_in_voxels(low * [1.0, 1.0, 0.0], 1.0)]
    low = low[np.abs(low[:, 2] - np.median(low[:, 2])) < 0.4]
    if len(low) < 4:
        return 0.0
    matrix, weight = np.column_stack([low[:, :2], np.ones(len(low))]), np.ones(len(low))
    for _ in range(4):  # a level plane, where returns do not say otherwise
        weighted = (matrix * weight[:, None]).T
        plane = np.linalg.solve(weighted @ matrix + np.diag([4.0, 4.0, 0.0]), weighted @ low[:, 2])
        weight = 1 / np.maximum(1.0, np.abs(low[:, 2] - matrix @ plane) / 0.05)
    return float(plane[2])


def follow(
    store: SweepStore, track: Track, drawn: Sequence[DrawnBox], refine: bool = False
) -> Generator[float, None, Track]:
    """Return the track of an actor followed from the boxes that a person drew, over all sweeps in which it is seen; yields
    the share that is done.

    ``track`` tells its id, class and size; where it moves, spans between neighbours of its ``drawn_s`` that are among
    ``drawn`` stay as they are. ``refine``: move, turn and resize the box so that it encloses the returns of all sweeps.
    Raises `LogError` where the log has no sweeps, or no box is given.
    """
    import_scipy("to follow an actor,")
    if not drawn:
        raise LogError("a box has to be drawn before it can be followed")
    if not len(store.refs):
        raise LogError(f"{store.log.path}: has no sweeps, by which a box could be followed")
    boxes = sorted(drawn, key=lambda box: box.time_s)
    follower = _Follower(store, track.actor.size_m, track.actor.label, boxes)
    spans = [*zip([None, *boxes], [*boxes, None], strict=True)]
    stays = [_unchanged(track, *ends) for ends in spans]
    nodes = list[_Sighting]()
    for ends, keys in zip(spans, stays, strict=True):
        if keys is None:
            nodes += yield from follower.span(*ends, False)
    earlier = {time: pose for keys in stays for time, pose in (keys or {}).items()}
    if is_moving := any(keys is not None for keys in stays):
        nodes = [node for node in nodes if node.time_s not in {box.time_s for box in boxes}]
    else:
        still = list[_Sighting]()
        for ends in spans:
            still += yield from follower.span(*ends, True)
        is_moving = _moves(boxes, nodes, still)
        nodes = nodes if is_moving else still
    yield 1.0
    return _finished(track, boxes, nodes, earlier, refine, is_moving)


def _unchanged(track: Track, first: DrawnBox | None, last: DrawnBox | None) -> dict[float, FloatArray] | None:
    """Return the keys (4, 4) of a moving track between two drawn boxes, by time; None where these were no neighbours."""
    path = track.actor.world_from_actor
    ends = list(zip((None, *track.drawn_s), (*track.drawn_s, None), strict=True))

    def same(own_s: float | None, box: DrawnBox | None) -> bool:
        if own_s is None or box is None:
            return own_s is None and box is None
        return abs(own_s - box.time_s) < 1e-3 and bool(np.abs(path.at(own_s) - box.pose).max() < DRAWN_M)

    if not track.actor.is_moving or not any(same(a, first) and same(b, last) for a, b in ends):
        return None
    low, high = -math.inf if first is None else first.time_s, math.inf if last is None else last.time_s
    rows = (path.times_s > low + CLOSEST_KEYS_S) & (path.times_s < high - CLOSEST_KEYS_S)
    return dict(zip(path.times_s[rows].tolist(), path.poses[rows], strict=True))


def _moves(boxes: Sequence[DrawnBox], moving: Sequence[_Sighting], standing: Sequence[_Sighting]) -> bool:
    """Return whether an actor moves: its drawn boxes lie apart, or following it explains more returns than letting it
    stand, in all or for some time."""
    drawn = np.array([box.pose[:2, 3] for box in boxes])
    if np.linalg.norm(drawn - drawn[0], axis=1).max() > STANDING_M:
        return True
    strayed = [float(np.linalg.norm(seen.pose[:2] - drawn[0])) for seen in moving]
    if not strayed or np.quantile(strayed, 0.9) < STANDING_M:
        return False
    still = {seen.number: seen.weight for seen in standing}
    explained = np.array([still.get(seen.number, 0.0) for seen in moving])
    weight = np.array([seen.weight for seen in moving])
    fewer = np.convolve(explained < 0.5 * weight, np.ones(LONG_MOVED))
    return bool(fewer.max() >= LONG_MOVED or explained.sum() < 0.8 * weight.sum())


def _finished(
    track: Track, boxes: Sequence[DrawnBox], sightings: list[_Sighting], earlier: dict[float, FloatArray], refine: bool,
    is_moving: bool,
) -> Track:  # fmt: skip
    nodes = sorted({seen.time_s: seen for seen in sightings}.values(), key=lambda seen: seen.time_s)
    size, drawn_s = np.array(track.actor.size_m, float), np.array([box.time_s for box in boxes])
    keys: dict[float, FloatArray] = {} if refine and nodes else {box.time_s: box.pose for box in boxes}
    if nodes:
        returns, path = _returns(nodes)
        heights = np.array([(node.ground_m, 0.0) for node in nodes])
        ground = smoothed(path.times_s, heights, heights[:, 1], HEIGHT_M).positions[:, 0]
        if refine:
            origins = np.array([node.origin for node in nodes])
            path, size = _refined(returns, path, origins, size, track.actor.label, is_moving)
            bottom = ground
        else:  # its bottom is as far from the ground as where it was drawn
            lift = [box.pose[2, 3] - size[2] / 2 - np.interp(box.time_s, path.times_s, ground) for box in boxes]
            bottom = ground + np.interp(path.times_s, drawn_s, lift)
        poses = path.trajectory(bottom + size[2] / 2).poses
        keys = {**dict(zip(path.times_s.tolist(), poses, strict=True)), **keys}
    keys |= earlier
    times, poses = np.array(sorted(keys)), np.array([keys[time] for time in sorted(keys)])
    if is_moving:
        rows = spread_keys(times)
        path_3d = Trajectory.from_poses(times[rows], poses[rows])
    else:
        own = poses[np.isin(times, drawn_s)] if drawn_s[0] in keys else poses
        path_3d = Trajectory.from_poses(times[:1], mean_pose(own)[0][None])
    present = float(times[0]) - HALF_FRAME_S, float(times[-1]) + HALF_FRAME_S
    actor = replace(
        track.actor, size_m=size, world_from_actor=path_3d, start_s=present[0], end_s=present[1], is_moving=is_moving
    )
    share = len(earlier) / len(track.actor.world_from_actor.times_s)
    low = np.array([(n.time_s, n.certainty) for n in nodes if n.certainty < UNCERTAIN]).reshape(-1, 2)
    unsure = [(float(low[n, 0]), float(low[n, 1])) for n in worst_of_runs(low[:, 0], -low[:, 1])]
    unsure += [at for at in track.unsure if any(abs(at[0] - time) < 0.1 for time in earlier)]
    return replace(
        track,
        actor=actor,
        certainty=1.0,
        returns=sum(len(node.local) for node in nodes) + round(share * track.returns),
        sweeps=len(nodes) + round(share * track.sweeps),
        drawn_s=tuple(drawn_s.tolist()),
        unsure=tuple(sorted(unsure)),
    )


def _refined(
    returns: ActorReturns, path: PlanarPath, origins: FloatArray, size: FloatArray, label: str, is_moving: bool
) -> tuple[PlanarPath, FloatArray]:
    """Return the path and the size (3,) with which a box encloses the returns of all sweeps, seen from ``origins`` (K, 2),
    and looks where it goes, or where that is not seen along its faces: a face that was seen lies at their end."""
    rigid = motion_of(label) != "deforming"
    if is_moving:
        path = register(returns, path, float(size[0]) if rigid else None, REACHES_M, across=ACROSS)
    points = returns.in_actor(path)
    points = points[first_in_voxels(points, VOXEL_M)]
    if not is_moving or np.quantile(path.speed, 0.9) < FAST:
        low, high = np.quantile(points[:, 2], [0.1, 0.7])
        turn = closest_heading(points[(points[:, 2] >= low) & (points[:, 2] <= high), :2])
        turn = (turn + math.pi / 4) % (math.pi / 2) - math.pi / 4
        if abs(turn) < MOST_TURN_RAD:
            points, path = in_box(points, np.array([0.0, 0.0, turn])), replace(path, yaw_rad=path.yaw_rad + turn)
    views, half, (low, high) = rotated(-path.yaw_rad, origins - path.positions), size[:2] / 2, extent(points)
    sees_low = (views < -half).any(0) & (low[:2] < -half + 0.6)
    sees_high = (views > half).any(0) & (high[:2] > half - 0.6)
    least = np.where(sees_low & sees_high, 0.0, size[:2])
    middle, edges = completed(np.stack([low, high])[:, :2], least, np.where(sees_high, 1.0, -1.0))
    is_seen, top = sees_low | sees_high, high[2] if high[2] > size[2] - 0.5 else size[2]
    return path.shifted(np.where(is_seen, middle, 0.0)), np.append(np.where(is_seen, edges, size[:2]), top)
