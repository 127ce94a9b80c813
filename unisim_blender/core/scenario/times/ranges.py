"""A scenario's times: which a list or a range of them names, what is wrong with them, and how the command
line writes them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import replace

from ...errors import ScenarioError, UnisimError
from ...world.captures import SECOND_US, microseconds
from ...world.drive import Drive
from ..limits import MOST_MEMBERS, MOST_S
from ..sensors.document import CameraSpec, LidarSpec
from ..types import Scenario
from .document import MOST_HZ, Outside, TimeRange, Times

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
        start, end = f"{start_us / SECOND_US:g} s", f"{last / SECOND_US:g} s"
        raise ScenarioError(f"{place}: start_s {start} lies after the recording, which ends at {end}: give a stop_s")
    _check_range(start_us / SECOND_US, stop_us / SECOND_US, times.rate_hz, place)
    step_us = SECOND_US / times.rate_hz
    count = math.ceil((stop_us - start_us) / step_us - 1e-9)
    return tuple(start_us + round(i * step_us) for i in range(count))


def scenario_times_us(scenario: Scenario, drive: Drive) -> tuple[tuple[int, ...] | None, dict[str, tuple[int, ...]]]:
    """Return the times of a scenario, None where it has frames, and those of sensors with times of their own, by
    "camera/NAME" and "lidar/NAME". Raises `ScenarioError`, for times outside the recording, too, where nothing
    says what is there."""
    found = {place: times_us(times, drive, place) for place, times in _given(scenario)}
    for place, times in found.items():
        _check_outside(scenario, drive, place, times)
    own = {name: found[place] for name, place, _ in sensors_with_times(scenario)}
    return found.get(f"{scenario.path}: times"), own


def recording_us(drive: Drive) -> tuple[int, int]:
    """Return the times of a recording's first and last frame, microseconds."""
    return microseconds(min(drive.time_s.values())), microseconds(max(drive.time_s.values()))


def parse_times(text: str) -> TimeRange:
    """Return the times that START:STOP:RATE names, seconds and a rate a second: "0:8:20", "::30".
    Raises `UnisimError`."""
    match = _RANGE.fullmatch(text.strip())
    start, stop, rate = match.groups() if match else (None, None, None)
    times = TimeRange(float(rate or 0), None if start is None else float(start), None if stop is None else float(stop))
    if not 0 < times.rate_hz <= MOST_HZ or any(abs(x) > MOST_S for x in (times.start_s, times.stop_s) if x is not None):
        raise UnisimError(
            f'--times "{text}": must be START:STOP:RATE, seconds within {MOST_S:g} and a rate above 0 and up to {MOST_HZ:g} a '
            'second: "0:8:20", or "::20" for the whole recording'
        )
    return times


def with_times(scenario: Scenario, times: TimeRange | None) -> Scenario:
    """Return the scenario with these times, or none, for all sensors in place of its own frames and times."""
    sensors = scenario.sensors
    if sensors is not None:
        cameras, lidars = sensors.cameras, sensors.lidars
        sensors = replace(
            sensors,
            cameras=None if cameras is None else tuple(replace(spec, times=None) for spec in cameras),
            lidars=None if lidars is None else tuple(replace(spec, times=None) for spec in lidars),
        )
    return replace(scenario, frames=None if times is not None else scenario.frames, times=times, sensors=sensors)


def ego_outside(scenario: Scenario) -> str | None:
    """Return what the ego does outside the recording: "hold", "continue", or None where nothing says it."""
    return scenario.outside.ego if isinstance(scenario.outside, Outside) else scenario.outside


def actors_outside(scenario: Scenario) -> str:
    """Return what moving actors do outside the recording: "absent", "hold" or "continue"."""
    told = scenario.outside.actors if isinstance(scenario.outside, Outside) else scenario.outside
    return told or "absent"


def _given(scenario: Scenario) -> Iterator[tuple[str, Times]]:
    """Yield all times that a scenario has, and their places."""
    if scenario.times is not None:
        yield f"{scenario.path}: times", scenario.times
    for _, place, spec in sensors_with_times(scenario):
        assert spec.times is not None
        yield place, spec.times


def sensors_with_times(scenario: Scenario) -> Iterator[tuple[str, str, CameraSpec | LidarSpec]]:
    """Yield sensors with times of their own: "camera/NAME", the times' place, and what the scenario has of it."""
    if scenario.sensors is None:
        return
    for i, camera in enumerate(scenario.sensors.cameras or ()):
        if camera.times is not None:
            yield f"camera/{camera.id}", f"{scenario.path}: sensors.cameras[{i}].times", camera
    for i, lidar in enumerate(scenario.sensors.lidars or ()):
        if lidar.times is not None:
            yield f"lidar/{lidar.id}", f"{scenario.path}: sensors.lidars[{i}].times", lidar


def _check_range(start_s: float, stop_s: float, rate_hz: float, place: str) -> None:
    if start_s >= stop_s:
        raise ScenarioError(f"{place}: stop_s {stop_s:g} must lie beyond start_s {start_s:g}")
    if (stop_s - start_s) * rate_hz > MOST_MEMBERS["times"]:
        count = (stop_s - start_s) * rate_hz
        raise ScenarioError(f"{place}: is {count:.0f} times, more than the {MOST_MEMBERS['times']} that are rendered")


def _check_outside(scenario: Scenario, drive: Drive, place: str, times: tuple[int, ...]) -> None:
    first, last = recording_us(drive)
    beyond = next((time for time in times if not first <= time <= last), None)
    if beyond is not None and ego_outside(scenario) is None:
        span = f"{first / SECOND_US:g} … {last / SECOND_US:g} s"
        raise ScenarioError(
            f"{place}: {beyond / SECOND_US:g} s lies outside the recording ({span}): say what the ego vehicle does there with "
            '"outside": "hold" or "continue"'
        )
