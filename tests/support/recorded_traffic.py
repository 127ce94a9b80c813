"""A recorded drive of a few boxes in the plane, and a loop of steps in which an ego vehicle does what a test says."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from unisim_blender.core.geometry import FloatArray, Trajectory, quaternion_from_yaw
from unisim_blender.core.simulation.actors.model import ActorModel, ActorMotion, step_all
from unisim_blender.core.simulation.actors.recording import Recording
from unisim_blender.core.simulation.states import ActorState, Footprint, Traffic
from unisim_blender.core.world.classes import motion_of
from unisim_blender.core.world.drive import EGO, Actor, Appearance, Drive

CAR = np.array([4.5, 1.9, 1.5])
PERSON = np.array([0.6, 0.6, 1.8])
EgoAt = Callable[[int], Footprint]
Place = Callable[[FloatArray], tuple[FloatArray, FloatArray, FloatArray]]


def keys(seconds: float = 10.0, every: float = 0.1) -> FloatArray:
    """Times of keys."""
    return np.arange(round(seconds / every) + 1) * every


def straight(
    times: FloatArray, x: float, y: float, speed: float | FloatArray, heading: float = 0.0, z: float = 0.75
) -> Trajectory:
    """A trajectory straight on; ``speed`` is a number or one for each key, the mean until the next."""
    way = np.concatenate([[0.0], np.cumsum(np.broadcast_to(speed, len(times))[:-1] * np.diff(times))])
    places = np.stack([x + way * np.cos(heading), y + way * np.sin(heading), np.full(len(times), z)], -1)
    return Trajectory(times, places, np.broadcast_to(quaternion_from_yaw(heading), (len(times), 4)))


def bend(
    times: FloatArray, x: float, y: float, speed: float, yaw_rate: float, heading: float = 0.0, z: float = 0.75
) -> Trajectory:
    """A trajectory along an arc."""
    yaw, radius = heading + yaw_rate * times, speed / yaw_rate
    places = [x + radius * (np.sin(yaw) - np.sin(heading)), y - radius * (np.cos(yaw) - np.cos(heading))]
    return Trajectory(times, np.stack([*places, np.full(len(times), z)], -1), quaternion_from_yaw(yaw))


def standing(x: float, y: float, heading: float = 0.0) -> Trajectory:
    """A trajectory of one key."""
    return Trajectory(np.zeros(1), np.array([[x, y, 0.75]]), quaternion_from_yaw(np.array([heading])))


def actor(
    uid: str,
    trajectory: Trajectory,
    label: str = "Car",
    size: FloatArray = CAR,
    window: tuple[float, float] | None = None,
) -> Actor:
    """An actor that is there as long as its keys are, or in a window of time."""
    start, end = window or (float(trajectory.times_s[0]), float(trajectory.times_s[-1]))
    if window is None and len(trajectory.times_s) == 1:
        start, end = -np.inf, np.inf
    return Actor(uid, label, size, trajectory, start, end, len(trajectory.times_s) > 1, Appearance(uid))


def recording(ego: Trajectory, *actors: Actor, seconds: float = 10.0, seed: int = 0) -> Recording:
    """What models may know of a drive at 10 Hz."""
    time_s = {frame: 0.1 * frame for frame in range(round(seconds * 10) + 1)}
    drive = Drive("t", tuple(time_s), time_s, ego, {}, {}, {one.uid: one for one in actors})
    return Recording.of(drive, motion_of, seed)


def footprint(one: Actor, state: ActorState) -> Footprint:
    """An actor's box in the plane."""
    x, y, _ = state.position_m
    length, width, _ = one.size_m.tolist()
    return Footprint(one.uid, one.label, x, y, state.heading_rad, length, width, state.speed_m_s)


def ego_box(x: float, y: float, speed: float = 0.0, heading: float = 0.0) -> Footprint:
    """The ego vehicle's box."""
    return Footprint(EGO, "Car", x, y, heading, 4.8, 2.0, speed)


def on_log(world: Recording) -> EgoAt:
    """An ego vehicle that is where it was recorded."""

    def at(time_us: int) -> Footprint:
        found = world.footprint(EGO, time_us, ego_box(0, 0))
        assert found is not None
        return found

    return at


@dataclass(frozen=True)
class Run:
    """Motions and traffic of every step: ``motions[uid][step]``."""

    times_us: list[int]
    motions: dict[str, list[ActorMotion]]
    traffic: list[Traffic]

    def states(self, uid: str) -> list[ActorState]:
        """An actor's states."""
        return [one.state for one in self.motions[uid]]

    def column(self, uid: str, name: str) -> FloatArray:
        """One value of an actor's states, or x, y, z of its positions."""
        if name in "xyz":
            return np.array([state.position_m["xyz".index(name)] for state in self.states(uid)])
        return np.array([getattr(state, name) for state in self.states(uid)])


def run(
    world: Recording,
    models: Mapping[str, ActorModel],
    ego: EgoAt,
    seconds: float = 10.0,
    step_us: int = 100_000,
    start_us: int = 0,
) -> Run:
    """Step all models, each against the traffic before the step."""
    times = [start_us + index * step_us for index in range(round(seconds * 1_000_000 / step_us) + 1)]
    motions = {uid: [model.start(world.actors[uid], world, start_us)] for uid, model in models.items()}
    seen = []
    for time_us in times:
        boxes = [
            footprint(world.actors[uid], some[-1].state) for uid, some in motions.items() if some[-1].state.present
        ]
        seen.append(Traffic(time_us, (ego(time_us), *boxes)))
        if time_us != times[-1]:
            now = {uid: some[-1] for uid, some in motions.items()}
            for uid, motion in step_all(models, world.actors, now, seen[-1], time_us, step_us).items():
                motions[uid].append(motion)
    return Run(times, motions, seen)


def jumps(result: Run, uid: str) -> FloatArray:
    """By how much further an actor moved in each step than the larger of its speeds at the step's ends allows, metres."""
    states = result.states(uid)
    dt = (result.times_us[1] - result.times_us[0]) / 1e6
    over = []
    for before, after in zip(states, states[1:], strict=False):
        if before.present and after.present:
            moved = float(np.linalg.norm(np.subtract(after.position_m, before.position_m)))
            over.append(moved - max(before.speed_m_s, after.speed_m_s) * dt)
    return np.array(over)
