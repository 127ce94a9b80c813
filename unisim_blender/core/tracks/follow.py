"""One actor followed through the sweeps of a log, from boxes that a person drew at one or several moments.

From each drawn box, forward and backward: the motion of a constant turn rate predicts the box at the next sweep, the
returns inside of it are registered against those of the earlier sweeps (point-to-plane ICP over x, y and heading, with
the prediction's covariance as prior), and their motion while the LiDAR turned is undone. Two drawn boxes blend the two
passes between them, so that both ends fit.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..data.log import Log
from ..errors import LogError
from ..geometry import FloatArray, Trajectory, first_in_voxels, rotation_from_angles
from ..poses.sweeps import import_scipy
from ..world.box_tracks import spread_keys
from ..world.classes import motion_of
from .scans import Scan, ScanRef, read_scan, scans_of

MARGIN_M = 0.3
"""Distance around a box within which returns are taken for the actor's."""
CLEARANCE_M = 0.2
"""Height above a box's bottom below which returns are the ground's."""
GATES_M = (1.0, 0.7, 0.5, 0.4, 0.3, 0.3, 0.3, 0.3)
"""Largest distances of corresponding points, metres, an iteration each."""
NOISE_M = 0.08
MOST_EVIDENCE = 60.0
"""Number of returns that count as independent, at most."""
ACROSS = 0.05
"""Weight of a correspondence's distance along the surface, relative to that along its normal."""
VOXEL_M = 0.07
"""Edge of the model's cells, which have one point each."""
MOST_POINTS = 400
FEWEST_POINTS = 6
"""Largest and smallest number of a sweep's returns that are registered."""
LOST_S = 0.9
"""Time without an accepted registration after which an actor is lost."""
WORST_OVERLAP = 0.45
"""Share of returns close to the model, below which a registration is not accepted."""
CLOSE_M = 0.2
RIGID_ACCELERATION, DEFORMING_ACCELERATION = 4.0, 2.0
"""Standard deviation of the acceleration, m/s²."""
RIGID_SLIP, DEFORMING_SLIP = 0.03, 1.0
"""Standard deviation of the change of the slip, radians in a second."""
PLACE_NOISE_M = 0.1
"""Of the place, metres in a second."""
TURN_ACCELERATION = 0.5
"""Standard deviation of the change of the turn rate, rad/s²."""
FASTEST_M_S = 40.0
STANDING_M = 0.45
"""A track stands whose places, nine in ten, lie within this distance of its drawn box."""
LONG_MOVED = 5
"""Number of sweeps in a row that say that an actor moves."""
CHORD_S = 3.0
"""Time between two drawn boxes up to which their distance says how fast an actor is."""
STORED_BYTES = 1 << 30
"""Largest sum of sweeps in memory."""


@dataclass(frozen=True)
class DrawnBox:
    """A box that a person drew: its pose (4, 4) in the world of the log at a time, seconds."""

    time_s: float
    pose: FloatArray


@dataclass(frozen=True)
class Followed:
    """Result of `follow`: at ``times_s`` (T,), of the sweeps and of the drawn boxes, poses (T, 4, 4) in the world,
    ``certainty`` (T,), 0..1, and the number of ``returns`` (T,) in the box. An actor that stands has one pose for all.
    ``size_m`` (3,) and ``boxes`` are as drawn, or refined."""

    times_s: FloatArray
    poses: FloatArray
    certainty: FloatArray
    returns: NDArray[np.int64]
    is_moving: bool
    size_m: FloatArray
    boxes: tuple[DrawnBox, ...]

    @property
    def trajectory(self) -> Trajectory:
        """The trajectory; of one key where the actor stands."""
        keys = spread_keys(self.times_s) if self.is_moving else [0]
        return Trajectory.from_poses(self.times_s[keys], self.poses[keys])


class SweepStore:
    """Sweeps of a log in order of time, read once, as long as they fit into memory."""

    def __init__(self, log: Log) -> None:
        self.log, self.refs = log, scans_of(log)
        self.times_s = np.array([ref.time_s for ref in self.refs])
        self._scans: dict[ScanRef, Scan] = {}
        self._bytes = 0

    def scan(self, number: int) -> Scan:
        """Return a sweep."""
        ref = self.refs[number]
        if ref not in self._scans:
            scan = read_scan(self.log, ref)
            self._bytes += scan.points.nbytes + scan.origins.nbytes + scan.time_s.nbytes
            self._scans[ref] = scan
            while self._bytes > STORED_BYTES and len(self._scans) > 1:
                oldest = self._scans.pop(next(iter(self._scans)))
                self._bytes -= oldest.points.nbytes + oldest.origins.nbytes + oldest.time_s.nbytes
        return self._scans[ref]


@dataclass
class _State:
    """Where an actor is, and how it moves: mean (x, y, heading, speed, slip, turn rate) and covariance (6, 6), at a time. It
    moves along its heading plus the slip, a constant of the drawn box: how much its heading is off."""

    time_s: float
    mean: FloatArray
    covariance: FloatArray
    is_rigid: bool

    @property
    def velocity(self) -> FloatArray:
        """The velocity (2,), m/s."""
        _, _, heading, speed, slip, _ = self.mean.tolist()
        return speed * np.array([math.cos(heading + slip), math.sin(heading + slip)])

    def at(self, time_s: float) -> _State:
        """Return the prediction for another time, earlier or later: a constant turn rate."""
        dt, speed = time_s - self.time_s, self.mean[3]
        step = np.empty((6, 6))
        for n in range(6):
            away = np.zeros(6)
            away[n] = 1e-4
            step[:, n] = (_moved(self.mean + away, dt) - _moved(self.mean - away, dt)) / 2e-4
        turning = TURN_ACCELERATION * min(1.0, abs(speed) / 4) + 0.01
        course = self.mean[2] + self.mean[4]
        effect = np.zeros((6, 4))
        acceleration = RIGID_ACCELERATION if self.is_rigid else DEFORMING_ACCELERATION
        effect[:2, 0] = 0.5 * dt * dt * acceleration * np.array([math.cos(course), math.sin(course)])
        effect[3, 0], effect[2, 1], effect[5, 1] = dt * acceleration, 0.5 * dt * dt * turning, dt * turning
        effect[4, 2] = math.sqrt(abs(dt)) * (RIGID_SLIP if self.is_rigid else DEFORMING_SLIP)
        noise = effect @ effect.T
        noise[[0, 1], [0, 1]] += (PLACE_NOISE_M * dt) ** 2
        return _State(time_s, _moved(self.mean, dt), step @ self.covariance @ step.T + noise, self.is_rigid)

    def corrected(self, pose: FloatArray, covariance: FloatArray) -> _State:
        """Return the state after its pose (3,) became known with a posterior covariance (3, 3)."""
        gain = self.covariance[:, :3] @ np.linalg.inv(self.covariance[:3, :3])
        left = self.covariance - gain @ (self.covariance[:3, :3] - covariance) @ gain.T
        return _State(self.time_s, self.mean + gain @ (pose - self.mean[:3]), (left + left.T) / 2, self.is_rigid)


def _moved(mean: FloatArray, dt: float) -> FloatArray:
    x, y, heading, speed, slip, rate = mean.tolist()
    course = heading + slip + rate * dt / 2
    return np.array(
        [x + dt * speed * math.cos(course), y + dt * speed * math.sin(course), heading + rate * dt, speed, slip, rate]
    )


@dataclass
class _Model:
    """Points of an actor in its own frame, a point a cell, the first that came; with normals."""

    points: FloatArray
    normals: FloatArray = field(init=False)
    tree: object = field(init=False)

    def __post_init__(self) -> None:
        self.points = self.points[first_in_voxels(self.points, VOXEL_M)]
        self._finish()

    def _finish(self) -> None:
        from scipy.spatial import cKDTree

        self.tree = tree = cKDTree(self.points)
        count = min(8, len(self.points))
        near = self.points[tree.query(self.points, count)[1].reshape(len(self.points), count)]
        apart = near - near.mean(1, keepdims=True)
        self.normals = np.linalg.eigh(np.einsum("nki,nkj->nij", apart, apart))[1][:, :, 0]

    def add(self, points: FloatArray) -> None:
        """Add points where there were none."""
        both = np.concatenate([self.points, points])
        first = first_in_voxels(both, VOXEL_M)
        new = len(first) - len(self.points)
        if new > max(5, 0.03 * len(self.points)):
            self.points = both[first]
            self._finish()


@dataclass(frozen=True)
class _Fit:
    """A registered sweep: the state, the overlap 0..1, the number of returns, their distance, metres, and the returns in
    the actor's frame."""

    state: _State
    overlap: float
    returns: int
    rms_m: float
    points: FloatArray
    origin: FloatArray
    z: float


class _Follower:
    """Passes of one actor over the sweeps. ``above_m``: height of the box's centre over the ground, which is read from the
    sweeps."""

    def __init__(self, store: SweepStore, size_m: FloatArray, label: str) -> None:
        self.store, self.size = store, np.asarray(size_m, float)
        self.is_rigid = motion_of(label) != "deforming"

    # ---- one sweep

    def seen(self, number: int, state: _State, z: float, margin: float) -> tuple[_State, FloatArray, FloatArray, float]:
        """Return the state at the time at which the beams passed the box; the returns (N, 3) in the box, in its frame,
        their motion undone; the LiDAR's place in that frame; and the ground's height, NaN where none is seen."""
        scan = self.store.scan(number)
        reach = float(np.linalg.norm(self.size[:2])) / 2 + 2.5
        for _ in range(2):
            near = np.flatnonzero((np.abs(scan.points[:, :2] - state.mean[:2]) < reach).all(1))
            times = scan.time_s[near]
            local = self._local(scan.points[near], state, z) - self._moved(state, times - state.time_s)
            half = self.size / 2
            inside = (np.abs(local[:, :2]) < half[:2] + margin).all(1) & (np.abs(local[:, 2]) < half[2] + 0.3)
            if not inside.any():
                break
            time_s = float(np.median(times[inside]))
            if abs(time_s - state.time_s) < 1e-3:
                break
            state = state.at(time_s)
        ground = _ground_height(local, half)
        floor = -half[2] + CLEARANCE_M if math.isnan(ground) else ground + CLEARANCE_M
        points = local[inside & (local[:, 2] > floor)]
        origin = np.zeros(3)
        if len(near):
            origin = self._local(scan.origins[near[:1]], state, z)[0]
        return state, points, origin, ground

    def _local(self, points: FloatArray, state: _State, z: float) -> FloatArray:
        return _planar(points - [0.0, 0.0, z], state.mean)

    def _moved(self, state: _State, dt: FloatArray) -> FloatArray:
        """Return the motion (N, 3) since the state's time, in the actor's frame."""
        c, s = math.cos(state.mean[2]), math.sin(state.mean[2])
        vx, vy = state.velocity.tolist()
        return dt[:, None] * np.array([c * vx + s * vy, c * vy - s * vx, 0.0])

    def registered(self, state: _State, points: FloatArray, model: _Model) -> tuple[_State, float, float]:
        """Return the state that returns (N, 3) of the predicted box's frame give, their overlap with the model, and
        their distance, metres."""
        tree: object = model.tree
        c, s = math.cos(state.mean[2]), math.sin(state.mean[2])
        turn = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]])  # from world to the predicted box's axes
        prior = np.linalg.inv(turn @ state.covariance[:3, :3] @ turn.T)
        shift = np.zeros(3)  # of the box against its prediction: x, y, heading, in its own axes
        information = prior
        for gate in GATES_M:
            moved = _planar(points, shift)
            distance, at = tree.query(moved, distance_upper_bound=gate)  # type: ignore[attr-defined]
            there = np.isfinite(distance)
            if there.sum() < FEWEST_POINTS:
                break
            p, apart, normal = moved[there], (moved[there] - model.points[at[there]]), model.normals[at[there]]
            # moving the box by (x, y, heading) moves its returns in its frame the other way
            jacobian = np.zeros((3, len(p), 3))
            jacobian[0, :, 0] = jacobian[1, :, 1] = -1.0
            jacobian[0, :, 2], jacobian[1, :, 2] = p[:, 1], -p[:, 0]
            along = np.einsum("ni,ink->nk", normal, jacobian)
            off = (normal * apart).sum(1)
            weight = 1 / np.maximum(1.0, np.abs(off) / NOISE_M)
            scale = min(1.0, MOST_EVIDENCE / weight.sum()) / NOISE_M**2
            matrix = np.einsum("n,nk,nl->kl", weight, along, along)
            vector = -np.einsum("n,nk,n->k", weight, along, off)
            for axis in range(2):
                loose = ACROSS / np.maximum(1.0, np.abs(apart[:, axis]) / NOISE_M)
                matrix += np.einsum("n,nk,nl->kl", loose, jacobian[axis], jacobian[axis])
                vector -= np.einsum("n,nk,n->k", loose, jacobian[axis], apart[:, axis])
            information = prior + scale * matrix
            step = np.linalg.solve(information, scale * vector - prior @ shift)
            shift = shift + step
        moved = _planar(points, shift)
        distance, at = tree.query(moved, distance_upper_bound=CLOSE_M)  # type: ignore[attr-defined]
        there = np.isfinite(distance)
        overlap = float(there.mean()) if len(points) else 0.0
        off = ((moved[there] - model.points[at[there]]) * model.normals[at[there]]).sum(1)
        rms = float(np.sqrt((off**2).mean())) if there.any() else CLOSE_M
        pose = state.mean[:3] + turn.T @ shift
        covariance = turn.T @ np.linalg.inv(information) @ turn
        return state.corrected(pose, covariance), overlap, rms

    def fitted(self, number: int, state: _State, z: float, above_m: float, model: _Model) -> _Fit | None:
        """Return the fit of a sweep; None where too few returns are in the box."""
        spread = math.sqrt(max(state.covariance[0, 0], state.covariance[1, 1]))
        state, points, origin, ground = self.seen(number, state, z, MARGIN_M + min(0.6, spread))
        if len(points) < FEWEST_POINTS:
            return None
        thin = _thinned(points)
        shift_z = 0.0 if math.isnan(ground) else ground + above_m
        lifted = thin - [0, 0, shift_z]
        after, overlap, rms = self.registered(state, lifted, model)
        move = self._local(np.array([[*after.mean[:2], 0.0]]), state, 0.0)[0]
        shift = np.array([move[0], move[1], after.mean[2] - state.mean[2]])
        own = _planar(lifted, shift)
        inside = (np.abs(own) < self.size / 2 + 0.1).all(1)
        return _Fit(after, overlap, int(inside.sum()), rms, own, origin - [move[0], move[1], 0], z + shift_z)

    # ---- a pass

    def model_at(self, number: int, state: _State, z: float) -> tuple[_Model | None, float]:
        """Return a model of the returns in a box of one sweep, and the height of the box's centre above the ground."""
        _, points, _, ground = self.seen(number, state, z, MARGIN_M)
        above = self.size[2] / 2 if math.isnan(ground) else -ground
        return (_Model(points) if len(points) >= FEWEST_POINTS else None), above

    def start(self, box: DrawnBox) -> _State:
        """Return the state at a drawn box; it is taken to stand."""
        heading = math.atan2(box.pose[1, 0], box.pose[0, 0])
        mean = np.array([box.pose[0, 3], box.pose[1, 3], heading, 0.0, 0.0, 0.0])
        spread = np.array([0.05, 0.05, 0.02, 1.0, 0.1 if self.is_rigid else 2.0, 0.1])
        return _State(box.time_s, mean, np.diag(spread**2), self.is_rigid)

    def steps(self, box: DrawnBox, forward: bool, until_s: float, stands: bool, speed: float | None) -> Iterator[_Fit]:
        """Yield the fits of the sweeps after a drawn box, or before it, up to a time or until the actor is lost.
        ``stands``: it stays where it is. ``speed``: about its speed along its heading, where it is known."""
        state, z = self.start(box), float(box.pose[2, 3])
        order = self._order(box, forward, until_s)
        model, above = None, float(self.size[2]) / 2
        while order and abs(self.store.times_s[order[0]] - box.time_s) < LOST_S:
            model, above = self.model_at(order[0], state.at(self._time(order[0], state)), z)
            if model is not None:
                break
            del order[0]
        if model is None:
            return
        if stands:
            state.covariance[:] = np.diag([1e-6] * 6)
        else:
            state = self._first_motion(state, order, z, above, model, speed)
            again, above = self.model_at(order[0], state.at(self._time(order[0], state)), z)
            model = again or model
        last_s = box.time_s
        for number in order:
            time_s = self._time(number, state)
            predicted = _State(time_s, state.mean, state.covariance, state.is_rigid) if stands else state.at(time_s)
            fit = self.fitted(number, predicted, z, above, model)
            if fit is not None and fit.overlap >= WORST_OVERLAP:
                last_s = fit.state.time_s
                if not stands:
                    state, z = fit.state, fit.z
                model.add(fit.points[(np.abs(fit.points) < self.size / 2 + MARGIN_M).all(1)])
                yield fit
            elif abs(time_s - last_s) > (math.inf if stands else LOST_S):
                return

    def _order(self, box: DrawnBox, forward: bool, until_s: float) -> list[int]:
        """Return the numbers of sweeps from a drawn box to a time, that first whose beams passed it then."""
        times, state = self.store.times_s, self.start(box)
        near = np.argsort(np.abs(times - box.time_s), kind="stable")[:6].tolist()
        nearest = min(near, key=lambda n: (abs(self._time(n, state) - box.time_s), n))
        on = range(nearest, len(times)) if forward else range(nearest, -1, -1)
        return [n for n in on if (times[n] <= until_s + 0.15 if forward else times[n] >= until_s - 0.15)]

    def _time(self, number: int, state: _State) -> float:
        """Return about when a sweep's beams pass the actor."""
        scan = self.store.scan(number)
        near = (np.abs(scan.points[:, :2] - state.mean[:2]) < 3.0).all(1)
        return float(np.median(scan.time_s[near])) if near.any() else float(self.store.times_s[number])

    def _first_motion(
        self, start: _State, order: list[int], z: float, above: float, model: _Model, speed: float | None
    ) -> _State:
        """Return the start with the velocity along its heading under which the next sweeps fit best."""
        times = self.store.times_s
        later = [n for n in order[1:] if abs(times[n] - times[order[0]]) > 0.06][:3]
        if not later:
            return start
        if not self.is_rigid:
            motions = [(v, a) for v in (0.0, 0.8, 1.6, 2.4, 3.2) for a in np.arange(0, 2 * math.pi, math.pi / 4)]
        elif speed is None:
            motions = [(v, 0.0) for v in np.arange(-6.0, FASTEST_M_S, 1.0)]
        else:
            motions = [(v, 0.0) for v in speed + np.arange(-4.0, 4.5, 1.0)]
        starts = []
        for motion in motions:
            mean, covariance = start.mean.copy(), start.covariance.copy()
            mean[3:5], covariance[3, 3] = motion, 0.7**2
            starts.append(_State(start.time_s, mean, covariance, self.is_rigid))
        score = {}
        for at, state in enumerate(starts):
            score[at] = self._score(state, later[:1], z, above, model)
        best = sorted(score, key=lambda at: -score[at])[:5]
        total = {at: self._score(starts[at], later, z, above, model) for at in best}
        return starts[max(best, key=lambda at: (total[at], -abs(at)))]

    def _score(self, state: _State, numbers: list[int], z: float, above: float, model: _Model) -> float:
        """Return how well sweeps fit a state: the share of the model that is met, less what meets nothing."""
        total = 0.0
        for number in numbers:
            state = state.at(self._time(number, state))
            fit = self.fitted(number, state, z, above, model)
            if fit is None:
                continue
            state = fit.state
            away = abs(fit.state.mean[3])
            met = min(1.0, fit.returns / min(MOST_POINTS, len(model.points)))
            total += fit.overlap * met - 2.0 * fit.rms_m - 0.002 * away
        return total


def _thinned(points: FloatArray, most: int = MOST_POINTS) -> FloatArray:
    """Return at most so many points, a cell's first each, every second one, third one and so on."""
    if len(points) <= most:
        return points
    first = points[first_in_voxels(points, VOXEL_M)]
    return first[:: -(-len(first) // most)]


def _planar(points: FloatArray, shift: FloatArray) -> FloatArray:
    """Return points (N, 3) of a box's frame in the frame of the box moved by (x, y, heading)."""
    c, s = math.cos(shift[2]), math.sin(shift[2])
    x, y = points[:, 0] - shift[0], points[:, 1] - shift[1]
    return np.stack([c * x + s * y, c * y - s * x, points[:, 2]], -1)


def _ground_height(local: FloatArray, half: FloatArray) -> float:
    """Return the ground's height below a box's centre, in its frame, of returns (N, 3) around it: a plane through the
    lowest returns of cells 1 m wide; NaN where fewer than four are seen."""
    around = ~(np.abs(local[:, :2]) < half[:2] + 0.2).all(1) & (np.abs(local[:, 2] + half[2]) < 1.2)
    low = local[around]
    if not len(low):
        return math.nan
    cells = np.floor(low[:, :2]).astype(np.int64)
    order = np.lexsort((low[:, 2], cells[:, 1], cells[:, 0]))
    _, first = np.unique(cells[order], axis=0, return_index=True)
    lowest = low[order][first]
    lowest = lowest[np.abs(lowest[:, 2] - np.median(lowest[:, 2])) < 0.4]
    if len(lowest) < 4:
        return math.nan
    matrix = np.column_stack([lowest[:, :2], np.ones(len(lowest))])
    weight = np.ones(len(lowest))
    ridge = np.diag([4.0, 4.0, 0.0])  # a level plane, where returns do not say otherwise
    for _ in range(4):
        plane = np.linalg.solve(
            (matrix * weight[:, None]).T @ matrix + ridge, (matrix * weight[:, None]).T @ lowest[:, 2]
        )
        off = lowest[:, 2] - matrix @ plane
        weight = 1 / np.maximum(1.0, np.abs(off) / 0.05)
    return float(plane[2])


@dataclass(frozen=True)
class _Place:
    """A box of a sweep: its time, (x, y, heading) and height in the world, certainty and number of returns."""

    time_s: float
    pose: FloatArray
    z: float
    certainty: float
    returns: int


def at_sweep(store: SweepStore, size_m: FloatArray, label: str, box: DrawnBox) -> DrawnBox:
    """Return a box at the time at which the beams of the sweep nearest to its time passed it: a box that was drawn around
    the returns of a frame's sweep was there then."""
    follower = _Follower(store, np.asarray(size_m, float), label)
    if not len(store.refs):
        return box
    nearest = int(np.abs(store.times_s - box.time_s).argmin())
    return DrawnBox(follower._time(nearest, follower.start(box)), box.pose)


def follow(
    store: SweepStore,
    size_m: FloatArray,
    label: str,
    drawn: Sequence[DrawnBox],
    before: Followed | None = None,
    refine: bool = False,
    progress: Callable[[float], None] = lambda share: None,
) -> Followed:
    """Follow an actor from the boxes that a person drew, over all sweeps in which it is seen.

    ``before``: an earlier result; spans whose ends were drawn boxes of it, too, are taken from it. ``refine``: move, turn
    and resize the box so that it encloses the returns of all sweeps. ``progress`` gets the share that is done, and may
    raise to end it. Raises `LogError` where the log has no sweeps, or no box is given.
    """
    import_scipy("to follow an actor,")
    if not drawn:
        raise LogError("a box has to be drawn before it can be followed")
    if not len(store.refs):
        raise LogError(f"{store.log.path}: has no sweeps, by which a box could be followed")
    boxes = sorted(drawn, key=lambda box: box.time_s)
    if before is not None and (abs(before.size_m - size_m) > 1e-3).any():
        before = None
    follower, ends = _Follower(store, np.asarray(size_m, float), label), [None, *boxes, None]
    fits: list[_Fit] = []
    places: list[_Place] = []
    for done, (first, last) in enumerate(zip(ends, ends[1:], strict=False)):
        earlier = None if before is None else _earlier_span(before, first, last)
        places += _span(follower, boxes, first, last, fits, False) if earlier is None else earlier
        progress((done + 1) / (len(ends) + 1))
    is_moving = True
    if before is None or not before.is_moving:
        still: list[_Fit] = []
        standing = [
            p
            for first, last in zip(ends, ends[1:], strict=False)
            for p in _span(follower, boxes, first, last, still, True)
        ]
        if not _moves(boxes, places, standing):
            is_moving, places, fits = False, standing, still
    progress(1.0)
    places += [_Place(box.time_s, _flat(box.pose), float(box.pose[2, 3]), 1.0, 0) for box in boxes]
    places.sort(key=lambda place: place.time_s)
    return _finished(follower, places, boxes, fits if refine else None, is_moving)


def _flat(pose: FloatArray) -> FloatArray:
    return np.array([pose[0, 3], pose[1, 3], math.atan2(pose[1, 0], pose[0, 0])])


def _earlier_span(before: Followed, first: DrawnBox | None, last: DrawnBox | None) -> list[_Place] | None:
    """Return the places of an earlier result between two drawn boxes; None where they were not neighbours in it."""
    ends = [None, *before.boxes, None]
    same = [_is_same(a, first) and _is_same(b, last) for a, b in zip(ends, ends[1:], strict=False)]
    if not any(same):
        return None
    low, high = -math.inf if first is None else first.time_s, math.inf if last is None else last.time_s
    inside = np.flatnonzero((before.times_s > low + 1e-6) & (before.times_s < high - 1e-6))
    return [
        _Place(
            float(before.times_s[n]), _flat(pose), float(pose[2, 3]), float(before.certainty[n]), int(before.returns[n])
        )
        for n, pose in zip(inside, before.poses[inside], strict=True)
    ]


def _is_same(a: DrawnBox | None, b: DrawnBox | None) -> bool:
    if a is None or b is None:
        return a is b
    return abs(a.time_s - b.time_s) < 1e-6 and bool(np.abs(a.pose - b.pose).max() < 1e-5)


def _speed_at(box: DrawnBox, boxes: Sequence[DrawnBox]) -> float | None:
    """Return the speed along a box's heading to its nearest neighbour; None where none was drawn within `CHORD_S`."""
    others = [other for other in boxes if 0 < abs(other.time_s - box.time_s) < CHORD_S]
    if not others:
        return None
    other = min(others, key=lambda one: abs(one.time_s - box.time_s))
    return float((other.pose[:3, 3] - box.pose[:3, 3]) @ box.pose[:3, 0] / (other.time_s - box.time_s))


def _span(
    follower: _Follower,
    boxes: Sequence[DrawnBox],
    first: DrawnBox | None,
    last: DrawnBox | None,
    fits: list[_Fit],
    stands: bool,
) -> list[_Place]:
    """Return the places between two drawn boxes, or beyond the first or the last; appends to ``fits``."""

    def one(box: DrawnBox | None, forward: bool, until_s: float) -> list[_Place]:
        if box is None:
            return []
        steps = list(follower.steps(box, forward, until_s, stands, _speed_at(box, boxes)))
        fits.extend(steps)
        return [
            _Place(f.state.time_s, f.state.mean[:3], f.z, f.overlap * f.returns / (f.returns + 10.0), f.returns)
            for f in steps
        ]

    low, high = -math.inf if first is None else first.time_s, math.inf if last is None else last.time_s
    there, back = one(first, True, high), one(last, False, low)
    there = [place for place in there if low + 1e-3 < place.time_s < high - 1e-3]
    back = [place for place in reversed(back) if low + 1e-3 < place.time_s < high - 1e-3]
    if not there or not back or there[-1].time_s < back[0].time_s:
        return there + back
    start_s, end_s = (low, high)
    if there[-1].time_s < high - LOST_S or back[0].time_s > low + LOST_S:
        start_s, end_s = back[0].time_s, there[-1].time_s
    places = [place for place in there if place.time_s < back[0].time_s - 0.02]
    times, pairs = np.array([place.time_s for place in back]), []
    for place in there[len(places) :]:
        at = int(np.abs(times - place.time_s).argmin())
        if abs(times[at] - place.time_s) < 0.02:  # both of the passes accepted it
            pairs.append((place, back[at]))
    late = [place for place in back if place.time_s > there[-1].time_s + 0.02]
    if not pairs:
        return places + late
    # each pass drifts from its own box on: at the other one it is off by all of that
    drift, drift_back = _apart(*pairs[-1]), _apart(*pairs[0])
    for place, other in pairs:
        share = min(1.0, max(0.0, (place.time_s - start_s) / max(1e-6, end_s - start_s)))
        apart = _apart(place, other)
        shift = (1 - share) * share * drift + share * (apart - (1 - share) * drift_back)
        certainty = (1 - share) * place.certainty + share * other.certainty
        certainty *= math.exp(-float(np.linalg.norm(apart[:2])))
        z = (1 - share) * place.z + share * other.z
        places.append(_Place(place.time_s, place.pose + shift, z, certainty, max(place.returns, other.returns)))
    return places + late


def _apart(place: _Place, other: _Place) -> FloatArray:
    """Return x, y, heading (3,) from a place to another."""
    turn = (other.pose[2] - place.pose[2] + math.pi) % (2 * math.pi) - math.pi
    return np.array([*(other.pose[:2] - place.pose[:2]), turn])


SMOOTH_S = 0.35
"""Time about each sweep over which places are smoothed, by a parabola."""


def _finished(
    follower: _Follower, places: list[_Place], boxes: list[DrawnBox], fits: list[_Fit] | None, is_moving: bool
) -> Followed:
    times = np.array([place.time_s for place in places])
    values = np.array([[*place.pose, place.z] for place in places])
    values[:, 2] = np.unwrap(values[:, 2])
    certainty = np.array([place.certainty for place in places])
    returns = np.array([place.returns for place in places], np.int64)
    is_drawn = np.isin(times, [box.time_s for box in boxes]) & (returns == 0)
    if is_moving:
        values = _smoothed(times, values, np.where(is_drawn, 30.0, certainty + 0.02), is_drawn)
    else:
        values = np.broadcast_to(values[is_drawn].mean(0), values.shape).copy()
    size = follower.size
    if fits:
        offset, size = _refined(fits, times, values, follower.size, is_moving)
        c, s = np.cos(values[:, 2]), np.sin(values[:, 2])
        values = values + np.column_stack(
            [
                c * offset[0] - s * offset[1],
                s * offset[0] + c * offset[1],
                np.full(len(c), offset[2]),
                np.full(len(c), offset[3]),
            ]
        )
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, :3, :3] = rotation_from_angles(values[:, 2], np.zeros(len(times)), np.zeros(len(times)))
    poses[:, :3, 3] = values[:, [0, 1, 3]]
    if fits or not is_moving:
        boxes = [DrawnBox(box.time_s, poses[int(np.abs(times - box.time_s).argmin())]) for box in boxes]
    return Followed(times, poses, certainty, returns, is_moving, size, tuple(boxes))


def _moves(boxes: list[DrawnBox], moving: list[_Place], standing: list[_Place]) -> bool:
    """Return whether an actor moves: its drawn boxes lie apart, or following it explains more returns than letting it
    stand, in all or for some time."""
    drawn = np.array([box.pose[:2, 3] for box in boxes])
    if np.linalg.norm(drawn - drawn[0], axis=1).max() > STANDING_M:
        return True
    strayed = [float(np.linalg.norm(place.pose[:2] - drawn[0])) for place in moving]
    if not strayed or np.quantile(strayed, 0.9) < STANDING_M:
        return False
    times = np.array([place.time_s for place in standing])
    fewer, weights, explained = 0, [], []
    for place in moving:
        weights.append(place.returns * place.certainty)
        at = int(np.abs(times - place.time_s).argmin()) if len(times) else -1
        there = at >= 0 and abs(times[at] - place.time_s) < 0.06
        explained.append(standing[at].returns * standing[at].certainty if there else 0.0)
        fewer = fewer + 1 if explained[-1] < 0.5 * weights[-1] else 0
        if fewer >= LONG_MOVED:
            return True
    return sum(explained) < 0.8 * sum(weights)


def _smoothed(times: FloatArray, values: FloatArray, weights: FloatArray, is_drawn: NDArray[np.bool_]) -> FloatArray:
    """Return values (T, C) smoothed over `SMOOTH_S`; drawn ones stay, and their neighbours keep their distance."""
    out = values.copy()
    for n, time in enumerate(times):
        dt = (times - time) / SMOOTH_S
        near = np.flatnonzero(np.abs(dt) < 1)
        w = weights[near] * (1 - np.abs(dt[near]) ** 3) ** 3
        degree = 2 if len(near) > 5 else 1 if len(near) > 2 else 0
        powers = dt[near, None] ** np.arange(degree + 1)
        matrix = (powers * w[:, None]).T @ powers + 1e-6 * np.eye(degree + 1)
        out[n] = np.linalg.solve(matrix, (powers * w[:, None]).T @ values[near])[0]
    for n in np.flatnonzero(is_drawn):
        fade = np.maximum(0.0, 1 - np.abs(times - times[n]) / SMOOTH_S)[:, None]
        out += fade * (values[n] - out[n])
    return out


def _refined(
    fits: list[_Fit], times: FloatArray, values: FloatArray, size: FloatArray, is_moving: bool
) -> tuple[FloatArray, FloatArray]:
    """Return the offset (x, y, heading, z) of the box in its own frame, and its size (3,), with which it encloses the
    returns of all sweeps: a face that was seen lies at their end."""
    points = np.concatenate([fit.points for fit in fits])
    points = points[first_in_voxels(points, VOXEL_M)]
    turn = _path_heading(times, values) if is_moving else None
    turn = _face_heading(points) if turn is None else turn
    points = _planar(points, np.array([0.0, 0.0, turn]))
    origins = _planar(np.array([fit.origin for fit in fits]), np.array([0.0, 0.0, turn]))
    offset, new = np.zeros(3), size.copy()
    for axis in range(3):
        low, high = np.quantile(points[:, axis], [0.005, 0.995])
        half = size[axis] / 2
        if axis == 2:  # it stands on the ground: the roof alone is moved
            if high > half - 0.5:
                new[2], offset[2] = size[2] + (high - half), (high - half) / 2
            continue
        sees_high = (origins[:, axis] > half).any() and high > half - 0.6
        sees_low = (origins[:, axis] < -half).any() and low < -half + 0.6
        if sees_high and sees_low:
            new[axis], offset[axis] = high - low, (high + low) / 2
        elif sees_high or sees_low:
            new[axis] = max(size[axis], high - low)
            offset[axis] = high - new[axis] / 2 if sees_high else low + new[axis] / 2
    c, s = math.cos(turn), math.sin(turn)
    return np.array([c * offset[0] - s * offset[1], s * offset[0] + c * offset[1], turn, offset[2]]), new


def _path_heading(times: FloatArray, values: FloatArray) -> float | None:
    """Return the median angle from the heading to the path where that is straight and fast; None without such places."""
    turns = []
    for n in range(len(times)):
        near = np.flatnonzero(np.abs(times - times[n]) < 0.4)
        dt = times[near[-1]] - times[near[0]]
        way = values[near[-1]] - values[near[0]]
        if dt > 0.3 and np.linalg.norm(way[:2]) > 2.0 * dt and abs(way[2]) < 0.1 * dt:
            angle = math.atan2(way[1], way[0]) - values[n, 2]
            turns.append((angle + math.pi) % (2 * math.pi) - math.pi)
    if len(turns) < 5:
        return None
    turn = float(np.median(turns))
    return turn if abs(turn) < math.radians(20) else None  # backwards, or no vehicle


def _face_heading(points: FloatArray) -> float:
    """Return the angle of up to 12 degrees under which returns lie closest to the sides of their bounds (Zhang et al.,
    "Efficient L-shape fitting for vehicle detection using laser scanners", 2017)."""
    low, high = np.quantile(points[:, 2], [0.1, 0.7])
    flat = points[(points[:, 2] > low) & (points[:, 2] < high)]
    if len(flat) < 20:
        return 0.0
    angles = np.radians(np.arange(-12.0, 12.1, 0.5))
    scores = []
    for angle in angles:
        at = _planar(flat, np.array([0.0, 0.0, angle]))[:, :2]
        ends = np.quantile(at, [0.01, 0.99], axis=0)
        away = np.minimum(np.abs(at - ends[0]), np.abs(at - ends[1])).min(1)
        scores.append(float((1 / np.maximum(away, 0.08)).sum()))
    return float(angles[int(np.argmax(scores))])
