"""Simulated motions as a scenario's edits, and the drive with them: what sensors see is what the scenario says."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..geometry import split_trajectories
from ..scenario import in_weather_and_light, select_frames, with_edited
from ..scenario.context import PRESENCE_MARGIN_S, SENSOR_MARGIN_S, EditContext
from ..scenario.edit import Edit
from ..scenario.edits.ego import Ego
from ..scenario.edits.move import Move, moved
from ..scenario.motion.keys import Keyframe, Present
from ..scenario.motion.placement import unit_quaternions
from ..scenario.sensors.select import select_sensors
from ..scenario.time_range import Outside
from ..scenario.times import actors_outside, carried_outside, recording_us
from ..scenario.types import Scenario
from ..world.captures import US_PER_SECOND
from ..world.drive import Actor, Drive
from .world import KEY_HISTORY_S, PoseKeys, World, keys_from, since_rest

BEFORE_S = 0.05
"""Seconds before an exposure from which keys are used: the pose of a sensor on a moving vehicle depends on earlier keys."""
AHEAD_S = 0.25
"""Seconds of recorded trajectories after a world's time that its drive has, beside what lies before it."""


def edits_of(
    scenario_drive: ScenarioDrive, ego: PoseKeys, actors: Mapping[str, PoseKeys], strayed: frozenset[str],
    vanished_s: Mapping[str, float],
) -> list[Edit]:  # fmt: skip
    """Return the edits that say where a simulation has moved the ego vehicle and actors: along these keys. An actor that strayed
    stays after its recorded end, until it vanishes."""
    edits = _ego_edits(ego)
    outside = None if scenario_drive.beyond_s is None else "continue"
    for uid, keys in actors.items():
        present = scenario_drive.present(uid, uid in strayed, vanished_s.get(uid))
        edits.append(Move(actor=uid, trajectory=_keyframes(keys), outside=outside, present=present))
    return edits


def without_driven(edits: tuple[Edit, ...]) -> tuple[Edit, ...]:
    """Return a scenario's edits without the ego vehicle's trajectories, of which a simulation that moves the vehicle gives the
    last one: its sensors then ride on that from where they were recorded, with the same bits in every rollout."""
    return tuple(edit for edit in edits if not (isinstance(edit, Ego) and edit.trajectory is not None))


def _ego_edits(keys: PoseKeys) -> list[Edit]:
    return [Ego(trajectory=_keyframes(keys), outside="continue")] if keys else []


def _keyframes(keys: PoseKeys) -> tuple[Keyframe, ...]:
    return tuple(
        Keyframe(position=key.position_m, quaternion_wxyz=key.quaternion_wxyz, time_s=key.time_s) for key in keys
    )


@dataclass(frozen=True, eq=False)
class ScenarioDrive:
    """A scenario's drive before its sensors are chosen (``base``), to which a simulation's edits are applied.

    ``context`` is the scenario's: its log's drive, and where other scenes' actors come from. ``beyond_s``: the end of a
    simulation that goes on after the recording.
    """

    base: Drive
    context: EditContext
    beyond_s: float | None = None

    @staticmethod
    def of(scenario: Scenario, context: EditContext, start_us: int, stop_us: int) -> ScenarioDrive:
        """Return that of a scenario that is simulated between two times. Raises `ScenarioError`."""
        drive = context.recorded
        for index, edit in enumerate(scenario.edits):
            drive = edit.apply(drive, f"{scenario.path}: edits[{index}]", context)
        # the vehicle's own trajectory is the simulation's
        rules = replace(scenario, outside=Outside(actors_outside(scenario), "continue"))
        drive = in_weather_and_light(select_frames(drive, scenario), scenario, context.recorded)
        drive = carried_outside(drive, rules, (start_us, stop_us))
        beyond_s = stop_us / US_PER_SECOND if stop_us > recording_us(drive)[1] else None
        return ScenarioDrive(drive, context, beyond_s)

    def drive(self) -> Drive:
        """Return the scenario's drive before anything is simulated."""
        return select_sensors(self.base, self.context)

    def with_edits(self, edits: list[Edit]) -> Drive:
        """Return the drive with edits after the scenario's own."""
        drive = self.base
        for index, edit in enumerate(edits):
            drive = edit.apply(drive, f"simulation: edits[{index}]", self.context)
        return select_sensors(with_edited(drive, self.context.recorded), self.context)

    def drive_at(self, world: World, since_us: int | None = None) -> Drive:
        """Return the drive of a world, which is that with the edits `edits_of` it.

        It holds for exposures that begin at ``since_us`` or later, by default `KEY_HISTORY_S` before the world's time, and end at
        that: only keys around these are worked with, and the one at which a vehicle that stands came to rest.
        """
        time_s = world.time_us / US_PER_SECOND
        since_s = (
            time_s - KEY_HISTORY_S
            if since_us is None
            else max(since_us / US_PER_SECOND, time_s - KEY_HISTORY_S) - BEFORE_S
        )
        ego = since_rest(world.ego_keys, keys_from(world.ego_keys, since_s))
        # sensors on a vehicle that stands are where they were when it came to rest; without keys it is where it was recorded
        reached_s = min([since_s, *(key.time_s for key in ego[:1])])
        near = _cropped(self.base, reached_s - BEFORE_S, time_s + AHEAD_S)
        near = replace(near, actors={**near.actors, **self._moved(world, since_s)})
        edited = ScenarioDrive(near, self.context).with_edits(_ego_edits(ego))
        times = self._times_s
        return replace(
            edited,
            time_s=self.base.time_s,
            cameras={name: replace(sensor, time_s=times[name]) for name, sensor in edited.cameras.items()},
            lidars={name: replace(sensor, time_s=times[name]) for name, sensor in edited.lidars.items()},
        )

    def present(self, uid: str, strayed: bool, vanished_s: float | None) -> Present | None:
        """Return when an actor is there that is moved, as its edit says it; None for when the recording has it."""
        if not strayed and self.beyond_s is None:
            return None
        actor = self.base.actors[uid]
        start = actor.start_s if actor.start_s > self._first_s else None
        if vanished_s is not None or self.beyond_s is None:
            return Present(start, vanished_s)
        return Present(start, self.beyond_s + PRESENCE_MARGIN_S if strayed else self.base.window(actor)[1])

    def _moved(self, world: World, since_s: float) -> dict[str, Actor]:
        """Return what the edits `move` of a world make of the actors, with the keys around what follows a time: for many of them,
        sooner."""
        recent = [keys_from(keys, since_s) for keys in world.keys.values()]
        every = [key for keys in recent for key in keys]
        if not every:
            return {}
        quaternions = unit_quaternions(np.array([key.quaternion_wxyz for key in every]))
        times, positions = np.array([key.time_s for key in every]), np.array([key.position_m for key in every])
        actors = {}
        lengths, walked = [len(keys) for keys in recent], [keys[0].walked_m for keys in recent]
        parts = split_trajectories(times, positions, quaternions, lengths, walked)
        for (uid, keys), trajectory in zip(world.keys.items(), parts, strict=True):
            actor = self.base.actors[uid]
            present = self.present(uid, uid in world.strayed, world.vanished_s.get(uid))
            window = actor.start_s, actor.end_s
            if present is not None:
                window = self.context.presence(present, f"simulation: {uid}")
            actors[uid] = moved(actor, trajectory, window, len(keys) > 1)
        return actors

    @cached_property
    def _first_s(self) -> float:
        return min(self.base.time_s.values())

    @cached_property
    def _times_s(self) -> dict[str, dict[int, float]]:
        return {name: sensor.time_s for name, sensor in self.drive().sensors.items()}


def _cropped(drive: Drive, start_s: float, end_s: float) -> Drive:
    """Return a drive with the keys alone that poses between two times depend on, and two frames: one for the first of these
    times, and the last that the drive has by the second."""
    drive = drive.with_sensors(lambda sensor: sensor.along(sensor.trajectory.between(start_s, end_s)))
    ego = drive.world_from_ego.between(start_s, end_s)
    last = max((time_s for time_s in drive.time_s.values() if time_s <= end_s), default=end_s)
    # edits add keys as far before the first frame as sensors look: these lie before any exposure, and not long before
    first = min(start_s + SENSOR_MARGIN_S, last)
    number = drive.frames[0]
    return replace(drive, time_s={number: first, number + 1: last}, world_from_ego=ego)
