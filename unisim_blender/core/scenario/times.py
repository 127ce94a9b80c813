"""A scenario's times: the times that a list or a range names, their check, how the command line writes them; and a
drive carried on before and after its recording, where what stands stays and what moves does what the scenario says."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from ..errors import ScenarioError, UnisimError
from ..geometry import Trajectory
from ..world.captures import US_PER_SECOND, microseconds
from ..world.drive import FRAME_MARGIN_S, Actor, Drive
from .checks import MAX_MEMBERS, MAX_S
from .context import with_riders
from .sensors.document import CameraSpec, LidarSpec
from .time_range import MAX_RATE_HZ, Outside, TimeRange, Times
from .types import Scenario

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_RANGE = re.compile(rf"({_NUMBER})?:({_NUMBER})?:({_NUMBER})")
ABSENT_EGO = (
    'the ego vehicle cannot be absent, its sensors ride on it: write {"actors": "absent", "ego": "hold"}, '
    'or "continue" in place of "hold"'
)


def check_times(scenario: Scenario) -> None:
    """Raise `ScenarioError` for times that are given beside frames, are not in order, or are none or too many."""
    if scenario.times is not None and scenario.frames is not None:
        raise ScenarioError(f"{scenario.path}: has both frames and times, which exclude each other")
    for place, times in _given(scenario):
        if isinstance(times, TimeRange):
            if times.start_s is not None and times.stop_s is not None:
                _check_range(times.start_s, times.stop_s, times.rate_hz, place)
            continue
        for index in range(1, len(times)):
            before, now = times[index - 1], times[index]
            if microseconds(now) <= microseconds(before):
                raise ScenarioError(
                    f"{place}[{index}]: {now:g} s must lie after the time before, {before:g} s, by a microsecond"
                )
    if scenario.outside == "absent":
        raise ScenarioError(f"{scenario.path}: outside: {ABSENT_EGO}")


def times_us(times: Times, drive: Drive, place: str) -> tuple[int, ...]:
    """Return the times that a scenario names, integer microseconds, in order. Raises `ScenarioError`
    naming ``place``."""
    if not isinstance(times, TimeRange):
        return tuple(microseconds(time_s) for time_s in times)
    first, last = recording_us(drive)
    start_us = first if times.start_s is None else microseconds(times.start_s)
    # without a stop the last time is one of them
    stop_us = last + 1 if times.stop_s is None else microseconds(times.stop_s)
    if times.stop_s is None and start_us > last:
        start, end = f"{start_us / US_PER_SECOND:g} s", f"{last / US_PER_SECOND:g} s"
        raise ScenarioError(f"{place}: start_s {start} lies after the recording, which ends at {end}: give a stop_s")
    _check_range(start_us / US_PER_SECOND, stop_us / US_PER_SECOND, times.rate_hz, place)
    step_us = US_PER_SECOND / times.rate_hz
    count = math.ceil((stop_us - start_us) / step_us - 1e-9)
    return tuple(start_us + round(i * step_us) for i in range(count))


def scenario_times_us(scenario: Scenario, drive: Drive) -> tuple[tuple[int, ...] | None, dict[str, tuple[int, ...]]]:
    """Return the times of a scenario, None where it has frames, and those of sensors with times of their own, by
    "camera/NAME" and "lidar/NAME". Raises `ScenarioError`, for times outside the recording, too, where nothing
    says what is there."""
    times_by_place = {place: times_us(times, drive, place) for place, times in _given(scenario)}
    for place, times in times_by_place.items():
        _check_outside(scenario, drive, place, times)
    own = {name: times_by_place[place] for name, place, _ in sensors_with_times(scenario)}
    return times_by_place.get(f"{scenario.path}: times"), own


def recording_us(drive: Drive) -> tuple[int, int]:
    """Return the times of a recording's first and last frame, microseconds."""
    return microseconds(min(drive.time_s.values())), microseconds(max(drive.time_s.values()))


def parse_times(text: str) -> TimeRange:
    """Return the times that START:STOP:RATE names, seconds and a rate a second: "0:8:20", "::30".
    Raises `UnisimError`."""
    match = _RANGE.fullmatch(text.strip())
    start, stop, rate = match.groups() if match else (None, None, None)
    times = TimeRange(float(rate or 0), None if start is None else float(start), None if stop is None else float(stop))
    if not 0 < times.rate_hz <= MAX_RATE_HZ or any(
        abs(x) > MAX_S for x in (times.start_s, times.stop_s) if x is not None
    ):
        raise UnisimError(
            f'--times "{text}": must be START:STOP:RATE, seconds within {MAX_S:g} and a rate above 0 and up to {MAX_RATE_HZ:g} a '
            'second: "0:8:20", or "::20" for the whole recording'
        )
    return times


def with_times(scenario: Scenario, times: TimeRange | None) -> Scenario:
    """Return the scenario with these times, or none, for all sensors in place of its own frames and times."""
    sensors = None if scenario.sensors is None else scenario.sensors.with_times(lambda spec: None)
    return replace(scenario, frames=None if times is not None else scenario.frames, times=times, sensors=sensors)


def ego_outside(scenario: Scenario) -> str | None:
    """Return the ego's motion outside the recording: "hold", "continue", or None where it is not stated."""
    return scenario.outside.ego if isinstance(scenario.outside, Outside) else scenario.outside


def actors_outside(scenario: Scenario) -> str:
    """Return the motion of moving actors outside the recording: "absent", "hold" or "continue"."""
    rule = scenario.outside.actors if isinstance(scenario.outside, Outside) else scenario.outside
    return rule or "absent"


def _given(scenario: Scenario) -> Iterator[tuple[str, Times]]:
    """Yield all times that a scenario has, and their places."""
    if scenario.times is not None:
        yield f"{scenario.path}: times", scenario.times
    for _, place, spec in sensors_with_times(scenario):
        assert spec.times is not None
        yield place, spec.times


def sensors_with_times(scenario: Scenario) -> Iterator[tuple[str, str, CameraSpec | LidarSpec]]:
    """Yield sensors with times of their own: "camera/NAME", the times' place, and what the scenario has of it."""
    for kind, at, spec in scenario.sensors.placed() if scenario.sensors is not None else ():
        if spec.times is not None:
            yield f"{kind}/{spec.id}", f"{scenario.path}: sensors.{at}.times", spec


def _check_range(start_s: float, stop_s: float, rate_hz: float, place: str) -> None:
    if start_s >= stop_s:
        raise ScenarioError(f"{place}: stop_s {stop_s:g} must lie beyond start_s {start_s:g}")
    if (stop_s - start_s) * rate_hz > MAX_MEMBERS["times"]:
        count = (stop_s - start_s) * rate_hz
        raise ScenarioError(f"{place}: is {count:.0f} times, more than the {MAX_MEMBERS['times']} that are rendered")


def _check_outside(scenario: Scenario, drive: Drive, place: str, times: tuple[int, ...]) -> None:
    first, last = recording_us(drive)
    beyond = next((time for time in times if not first <= time <= last), None)
    if beyond is not None and ego_outside(scenario) is None:
        span = f"{first / US_PER_SECOND:g} … {last / US_PER_SECOND:g} s"
        raise ScenarioError(
            f"{place}: {beyond / US_PER_SECOND:g} s lies outside the recording ({span}): say what the ego vehicle does there "
            'with "outside": "hold" or "continue"'
        )


SENSOR_REACH_S = 1.0
"""Largest time, seconds, between a capture and its sensor's rays."""


def carried_outside(drive: Drive, scenario: Scenario, times_us: Iterable[int]) -> Drive:
    """Return the edited drive with all that is there at times (integer microseconds) before and after its recording;
    the drive itself where all lie within.

    Parked actors stay where they stand, as static copies do. Moving ones are gone, stand still or go on at the velocity
    of their end; those whose edit says ``outside`` do what that says. So does the vehicle, with its sensors and its
    body. The recording lasts until `FRAME_MARGIN_S` after its last frame, as its sensors look.
    """
    times, (first_us, last_us) = list(times_us), recording_us(drive)
    if not times or first_us <= min(times) <= max(times) <= last_us:
        return drive
    first_s, last_s = first_us / US_PER_SECOND - FRAME_MARGIN_S, last_us / US_PER_SECOND + FRAME_MARGIN_S
    window = (
        min(min(times) / US_PER_SECOND - SENSOR_REACH_S, first_s),
        max(max(times) / US_PER_SECOND + SENSOR_REACH_S, last_s),
    )
    own_rules, ends = _own_rules(scenario)
    rule, ego_rule = actors_outside(scenario), ego_outside(scenario)

    def carried(actor: Actor) -> Actor:
        trajectory, own = actor.world_from_actor, own_rules.get(actor.uid)
        if own == "absent":
            return actor
        if actor.is_ego_body:
            pass  # it goes where the vehicle does
        elif own != "continue" and (not actor.is_moving or (own is None and rule == "hold")):
            trajectory = _holding(trajectory, first_s, last_s)
        elif own is None and rule == "absent":
            return replace(actor, start_s=max(actor.start_s, first_s), end_s=min(actor.end_s, last_s))
        start, end = actor.start_s, actor.end_s
        return replace(
            actor,
            world_from_actor=trajectory,
            start_s=window[0] if start <= first_us / US_PER_SECOND else start,
            end_s=window[1] if end >= last_us / US_PER_SECOND and actor.uid not in ends else end,
        )

    drive = replace(drive, actors={uid: carried(actor) for uid, actor in drive.actors.items()})
    if ego_rule != "hold":
        return drive
    ego = _holding(drive.world_from_ego, first_s, last_s)
    return with_riders(drive, ego, lambda riders: [_holding(rider, first_s, last_s) for rider in riders])


def _own_rules(scenario: Scenario) -> tuple[dict[str, str | None], set[str]]:
    """Return what the last edit of where an actor is says of it outside its keys, by the actors' ids; and the ids of those of
    which it says that and until when they are there."""
    rules: dict[str, str | None] = {}
    ends: set[str] = set()
    for edit in scenario.edits:
        uid, present = getattr(edit, "id", None) or getattr(edit, "actor", None), getattr(edit, "present", None)
        if uid is not None and hasattr(edit, "outside"):
            rules[uid] = edit.outside
            ends.discard(uid)
            if edit.outside is not None and present is not None and present.end_s is not None:
                ends.add(uid)
    return rules, ends


def _holding(trajectory: Trajectory, first_s: float, last_s: float) -> Trajectory:
    """Return a trajectory that stands still before ``first_s`` and after ``last_s``."""
    if len(trajectory.times_s) == 1:
        return trajectory
    inside = trajectory.times_s[(trajectory.times_s > first_s) & (trajectory.times_s < last_s)]
    times = np.array([first_s - 1.0, first_s, *inside, last_s, last_s + 1.0])
    return Trajectory.from_poses(times, trajectory.at(np.clip(times, first_s, last_s)))
