"""What a rollout's folder tells of what happened: when it ran, the driver's plans, its scores and moments worth a marker."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...core.errors import OutputError, UnisimError, in_a_line
from ...core.geometry import FloatArray
from ...core.json_file import read_json
from ...core.simulation.rollout.steps import RolloutStep
from ...core.simulation.vehicle.actions import Plan
from ...core.simulation.vehicle.parameters import Vehicle
from ...core.world.captures import SECOND_US
from ..texts import Text
from .folders import SCORES, STEPS


class Planned(NamedTuple):
    """A plan: when the driver was asked, and times (K,) in seconds and places (K, 2), world frame, that it answered."""

    asked_s: float
    times_s: FloatArray
    places: FloatArray


class RolloutEvent(NamedTuple):
    """Something that happened at a time: the vehicle met somebody, or nearly did."""

    time_s: float
    text: Text


@dataclass(frozen=True, eq=False)
class RolloutTimes:
    """A rollout: the times of its steps in seconds, the start first, and its plans by when they were asked for."""

    times_s: FloatArray
    plans: tuple[Planned, ...] = ()

    def plan_at(self, time_s: float) -> Planned | None:
        """Return the plan that was asked for last at a time; None before the first, after the rollout's end, and without
        plans."""
        if time_s > self.times_s[-1] + 1e-6:
            return None
        asked = np.array([plan.asked_s for plan in self.plans])
        at = int(np.searchsorted(asked, time_s + 1e-6)) - 1
        return self.plans[at] if at >= 0 else None

    def nearest_step(self, time_s: float) -> float:
        """Return the time of the step that is nearest, after the start and before the end."""
        inside = self.times_s[1:-1]
        return float(inside[np.abs(inside - time_s).argmin()]) if len(inside) else time_s


def read_rollout(folder: Path) -> RolloutTimes:
    """Return what happened in a rollout, from its steps; a last line that is not whole is left out. Raises `OutputError`."""
    path = folder / STEPS
    try:
        content = path.read_bytes()
    except OSError as fault:
        raise OutputError(f"{path}: cannot be read: {fault.strerror}") from fault
    steps = []
    for number, line in enumerate(content[: content.rfind(b"\n") + 1].splitlines(), 1):
        try:
            steps.append(RolloutStep.from_json(json.loads(line)))
        except (ValueError, KeyError, TypeError, AttributeError, RecursionError, UnisimError) as fault:
            raise OutputError(f"{path}: line {number} is no step of a rollout: {in_a_line(fault)}") from fault
    if not steps:
        raise OutputError(f"{path}: holds no step")
    times = np.array([step.time_us for step in steps]) / SECOND_US
    plans = [
        Planned(float(asked), step.action.times_us / SECOND_US, np.stack([step.action.x_m, step.action.y_m], -1))
        for asked, step in zip(times, steps[1:], strict=False)
        if isinstance(step.action, Plan)
    ]
    return RolloutTimes(times, tuple(plans))


def count_steps(folder: Path) -> int:
    """Return how many steps a rollout that may still run has made."""
    try:
        return max(0, (folder / STEPS).read_bytes().count(b"\n") - 1)
    except OSError:
        return 0


def read_scores(folder: Path) -> dict[str, Any]:
    """Return a rollout's scores. Raises `OutputError` where they are not there or none."""
    found = read_json(folder / SCORES, OutputError)
    if not isinstance(found, dict) or not isinstance(found.get("collision"), dict):
        raise OutputError(f"{folder / SCORES}: has no scores of a rollout")
    return found


def moments_of(scores: Mapping[str, Any], names: Mapping[str, str]) -> list[RolloutEvent]:
    """Return what happened in a rollout by its scores, in order of time; ``names`` are the actors' for people, by id."""

    def name(uid: object) -> str:
        return names.get(str(uid), str(uid))

    found = []
    for one in _member(scores, "collision").get("contacts") or ():
        if not one.get("at_start"):
            found.append(RolloutEvent(float(one["time_s"]), Text("Collision: {name}", name=name(one["actor"]))))
    static = _member(scores, "static_collision")
    if static.get("collided") and static.get("first_s") is not None:
        found.append(RolloutEvent(float(static["first_s"]), Text("Collision: static scene")))
    least = _member(scores, "time_to_collision")
    if least.get("minimum_s") is not None:
        words = Text("TTC {seconds:.1f} s: {name}", seconds=least["minimum_s"], name=name(least["actor"]))
        found.append(RolloutEvent(float(least["minimum_at_s"]), words))
    road = _member(scores, "off_road")
    if road.get("off_road") and road.get("first_s") is not None:
        found.append(RolloutEvent(float(road["first_s"]), Text("Off the road")))
    return sorted(found, key=lambda moment: moment.time_s)


def vehicle_of(simulation: Mapping[str, Any] | None) -> Vehicle:
    """Return the vehicle that a simulation moves; the usual one where the parameters are none."""
    try:
        return Vehicle.from_dict(simulation or {})
    except UnisimError:
        return Vehicle()


def _member(scores: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = scores.get(name)
    return found if isinstance(found, dict) else {}
