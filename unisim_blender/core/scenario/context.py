"""Context of edits: the data that they may read besides the drive that they change, and the checks and conversions that
they share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ..errors import ScenarioError, UnisimError
from ..geometry import FloatArray, Trajectory
from ..meshes.read import mesh_size_m
from ..world.drive import Actor, Appearance, Box, Drive
from ..world.lamps import ActorLamp
from .checks import fail, listed
from .motion.keys import Keyframe, Present, ShiftKey
from .motion.placement import BoxSpec, Placement, pose_of, rotation_of, rotations_of
from .motion.trajectories import holding_ends, is_moving, merged_times, sampled
from .types import Scenario

TIME_TOLERANCE_S = 1e-6
PRESENCE_MARGIN_S = 1.0
"""Time, seconds, by which actors that are always present exist before the first and after the last frame."""
SENSOR_MARGIN_S = 0.25
"""Time, seconds, by which sweeps and shutters may extend before the first and after the last time of a drive."""

SceneActors = Callable[[Path], dict[str, Actor]]
RecordedLamps = Callable[[], Mapping[str, tuple[ActorLamp, ...]]]
"""Function that returns the lamps of a log's actors that its images show in two states, by their ids."""


@dataclass(frozen=True)
class EditContext:
    """The scenario, the drive before any edit, and where other scenes' actors come from, and the log's lamps: None where its
    images cannot be looked at."""

    scenario: Scenario
    recorded: Drive
    scene_actors: SceneActors
    recorded_lamps: RecordedLamps | None = None

    @cached_property
    def _span_s(self) -> tuple[float, float]:
        """First and last time of the log."""
        return min(self.recorded.time_s.values()), max(self.recorded.time_s.values())

    def check_time(self, time_s: float, place: str) -> float:
        """Return ``time_s`` if it lies within the log, or the scenario says what is outside. Raises `ScenarioError`."""
        if self.scenario.outside is not None:
            return float(time_s)
        first, last = self._span_s
        if not first - TIME_TOLERANCE_S <= time_s <= last + TIME_TOLERANCE_S:
            fail(place, f"time {time_s:g} s lies outside the log ({first:g} … {last:g} s)")
        return float(time_s)

    def key_times(self, keys: Sequence[Keyframe | ShiftKey], place: str) -> FloatArray:
        """Return the times (T,) of keys, in seconds, from their times or frames. Raises `ScenarioError` if they
        do not increase."""
        times: list[float] = []
        for index, key in enumerate(keys):
            here = f"{place}[{index}]"
            if key.frame is not None and key.frame not in self.recorded.time_s:
                frames = sorted(self.recorded.time_s)
                fail(f"{here}.frame", f"no frame {key.frame} in the log ({frames[0]} … {frames[-1]})")
            if key.time_s is not None:
                time = self.check_time(key.time_s, f"{here}.time_s")
            else:
                assert key.frame is not None  # one of both is there: the scenario was checked
                time = self.recorded.time_s[key.frame]
            if times and time <= times[-1]:
                fail(here, f"{time:g} s must lie after the key before, {times[-1]:g} s")
            times.append(time)
        return np.array(times)

    def trajectory(
        self, pose: Placement | None, keys: tuple[Keyframe, ...] | None, outside: str | None, place: str
    ) -> Trajectory:
        """Return the trajectory of keyframes, or the constant one of a pose."""
        if pose is not None:
            return Trajectory(np.zeros(1), np.array([pose.position], float), rotation_of(pose)[None])
        assert keys is not None  # pose or keyframes are there: the scenario was checked
        times = self.key_times(keys, f"{place}.trajectory")
        positions = np.array([key.position for key in keys], float)
        trajectory = Trajectory(times, positions, rotations_of(keys))
        return holding_ends(trajectory) if outside == "hold" else trajectory

    def presence(self, present: Present | None, place: str) -> tuple[float, float]:
        """Return when an actor is present (start, end), in seconds; an end that is not given lies outside the drive."""
        start, end = self._span_s[0] - PRESENCE_MARGIN_S, self._span_s[1] + PRESENCE_MARGIN_S
        if present is not None and present.start_s is not None:
            start = self.check_time(present.start_s, f"{place}.present.start_s")
        if present is not None and present.end_s is not None:
            end = self.check_time(present.end_s, f"{place}.present.end_s")
        return start, end

    def appearance_of(self, actor: str, scene: str | None, place: str, member: str) -> Actor:
        """Return the actor that an edit takes an appearance from: of the log, or of another trained ``scene``
        (a folder).

        Raises `ScenarioError` naming the ``member`` at ``place``.
        """
        if scene is None or self.scenario.resolve(scene) == self.scenario.scene_path:
            return actor_of(self.recorded.actors, actor, f"{place}.{member}", "in the log")
        path = self.scenario.resolve(scene)
        try:
            actors = self.scene_actors(path)
        except UnisimError as fault:
            raise ScenarioError(f"{place}.scene: {fault}") from fault
        borrowed = actor_of(actors, actor, f"{place}.{member}", f"in the scene {scene}")
        return replace(
            borrowed, appearance=Appearance(borrowed.appearance.actor, borrowed.appearance.scene or str(path))
        )


def actor_of(actors: dict[str, Actor], uid: str, place: str, where: str) -> Actor:
    """Return the actor ``uid``. Raises `ScenarioError`, which lists those there are."""
    if uid not in actors:
        fail(place, f'no actor "{uid}" {where} {listed(actors)}')
    return actors[uid]


def current(drive: Drive, uid: str, place: str, context: EditContext) -> Actor:
    """Return the actor after the edits so far. Raises `ScenarioError`, also for one that an earlier edit removed."""
    if uid not in drive.actors:
        for index, edit in enumerate(context.scenario.edits):
            if edit.removes(uid) and uid in context.recorded.actors:
                fail(place, f'"{uid}" was removed by edits[{index}]')
    actor = actor_of(drive.actors, uid, place, "in the log")
    if actor.is_ego_body:
        fail(place, f'"{uid}" is an ego body: it rides on the ego vehicle and takes no other edit')
    return actor


def check_new(drive: Drive, uid: str, place: str, context: EditContext) -> None:
    """Raise `ScenarioError` where an actor has the id already."""
    if uid in context.recorded.actors:
        fail(f"{place}.id", f'"{uid}" is an actor of the log already')
    if uid in drive.actors:
        fail(f"{place}.id", f'"{uid}" is an actor already')


def with_actor(drive: Drive, actor: Actor) -> Drive:
    """Return the drive with an actor, in place of one with its id."""
    return replace(drive, actors={**drive.actors, actor.uid: actor})


def newcomer(source: Actor, uid: str, trajectory: Trajectory, start_s: float, end_s: float) -> Actor:
    """Return a new actor with the appearance, class and size of ``source``, present from ``start_s`` to ``end_s``,
    seconds."""
    moving = is_moving(trajectory)
    return replace(
        source, uid=uid, world_from_actor=trajectory, start_s=start_s, end_s=end_s, is_moving=moving, inserted=True
    )


def mesh_of(name: str, place: str, context: EditContext) -> tuple[Path, FloatArray]:
    """Return the file of a mesh that a scenario names, and its extent (3,), metres. Raises `ScenarioError`."""
    path = context.scenario.resolve(name)
    try:
        return path, mesh_size_m(path)
    except UnisimError as fault:
        raise ScenarioError(f"{place}.mesh: {fault}") from fault


def check_box(key: str, scenario: Scenario, place: str) -> None:
    """Raise `ScenarioError` where the scenario has no such box."""
    if key not in (scenario.boxes or {}):
        fail(f"{place}.box", f'no box "{key}" {listed(scenario.boxes or {})}')


def box_of(key: str, scenario: Scenario) -> Box:
    """Return a box of a checked scenario."""
    box: BoxSpec = (scenario.boxes or {})[key]
    return Box(pose_of(box), np.array(box.size_m, float))


def sensor_span_s(drive: Drive) -> tuple[float, float]:
    """Return the first and the last time at which any sensor may look."""
    return min(drive.time_s.values()) - SENSOR_MARGIN_S, max(drive.time_s.values()) + SENSOR_MARGIN_S


def riding(drive: Drive, ego_from_rider: FloatArray) -> Trajectory:
    """Return the trajectory of what rides on the vehicle at a pose (4, 4)."""
    ego = drive.world_from_ego
    return sampled(lambda t: ego.at(t) @ ego_from_rider, merged_times(ego.times_s, np.array(sensor_span_s(drive))))


def with_riders(
    drive: Drive, world_from_ego: Trajectory, carried: Callable[[list[Trajectory]], list[Trajectory]]
) -> Drive:
    """Return the drive with the vehicle on a trajectory, and all that rides on it, sensors and its body, on those that
    ``carried`` returns for theirs."""
    bodies = {key: actor for key, actor in drive.actors.items() if actor.is_ego_body}
    riders = [sensor.trajectory for sensor in drive.sensors.values()]
    riders += [body.world_from_actor for body in bodies.values()]
    there = iter(carried(riders) if riders else [])
    return replace(
        drive.with_sensors(lambda sensor: sensor.along(next(there))),
        world_from_ego=world_from_ego,
        actors={**drive.actors, **{key: replace(body, world_from_actor=next(there)) for key, body in bodies.items()}},
    )
