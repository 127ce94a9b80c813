"""Folders of rollouts: where they are written, and what they tell: when it ran, the driver's plans, its scores as rows
of the panel, and moments worth a marker."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...core.errors import OutputError, UnisimError
from ...core.files import write_file
from ...core.geometry import FloatArray
from ...core.json_file import read_json
from ...core.scenario import scenario_to_json
from ...core.scenario.types import Scenario
from ...core.simulation.rollout.steps import SCENARIO_NAME, STEPS_NAME, read_steps
from ...core.simulation.vehicle.actions import Plan
from ...core.simulation.vehicle.parameters import Vehicle
from ...core.world.captures import US_PER_SECOND
from ..edits.lines import metres
from ..reading.scenario import write_scenario
from ..sampled.source import is_rollout
from ..texts import Text, kmh, translatable

SCORES, STEPS, SCENARIO = "scores.json", STEPS_NAME, SCENARIO_NAME
"""Files of a rollout's folder."""
MOST = 10_000


def rollout_name(variant: str, driver: str, number: int) -> str:
    """Return the name of a rollout's folder: "Scene idm 2"."""
    words = [re.sub(r"[^\w. -]+", "_", word) for word in (variant, driver.rpartition(":")[2])]
    return f"{' '.join(words)} {number}"


def folder_for(parent: Path, variant: str, driver: str, options: dict[str, Any]) -> Path:
    """Return the folder of a rollout: the newest one of this variant and driver where that was begun with the same
    options (`options_of`), to be resumed, else the next one that is not there. Raises `OutputError` where there is
    none."""
    newest: Path | None = None
    for number in range(1, MOST):
        folder = parent / rollout_name(variant, driver, number)
        if not folder.exists() and not options_path(folder).exists():
            return newest if newest is not None and _begun_with(newest) == options else folder
        newest = folder
    raise OutputError(f"{parent}: holds {MOST} rollouts of {variant} by {driver}; choose another folder")


def scenario_path(folder: Path) -> Path:
    """Return the file of the scenario that a rollout begins with."""
    return folder.with_name(f"{folder.name}.json")


def options_path(folder: Path) -> Path:
    """Return the file of the options that a rollout was begun with."""
    return folder.with_name(f"{folder.name}.options.json")


def options_of(scenario: Scenario, command: list[str]) -> dict[str, Any]:
    """Return what a rollout is begun with, as JSON has it: the command's options, and a digest of the scenario."""
    edits = []
    for edit in scenario.edits:  # their meshes' files are named after what they hold, and lie in other folders later
        edits.append(replace(edit, **{name: Path(getattr(edit, name)).name for name in edit.meshes}))
    document = json.dumps(scenario_to_json(replace(scenario, edits=tuple(edits))), sort_keys=True)
    return {"options": command, "scenario": hashlib.sha256(document.encode()).hexdigest()}


def _begun_with(folder: Path) -> Any:
    try:
        return json.loads(options_path(folder).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def rollout_state(folder: Path) -> str:
    """Return a text that changes when a rollout's files do."""
    files = (folder / name for name in (SCENARIO, STEPS, SCORES))
    return " ".join(str(file.stat().st_mtime_ns) if file.is_file() else "-" for file in files)


def variant_of(folder: Path) -> str:
    """Return the name of the variant that a rollout was driven in; that of its folder where this was not named by
    `rollout_name`."""
    named = re.fullmatch(r"(.+) \S+ \d+", folder.name)
    return named[1] if named and options_path(folder).is_file() else folder.name


def folder_of(path: Path) -> Path | None:
    """Return the rollout's folder that a chosen folder or file is, or lies in; None where there is none."""
    folder = path if path.is_dir() else path.parent
    return folder if is_rollout(folder) and (path.is_dir() or path.name == SCENARIO) else None


def write_inputs(scenario: Scenario, command: list[str], parent: Path, variant: str, driver: str) -> Path:
    """Write a scenario and a command's options beside the folder of their rollout, and return that. Raises
    `UnisimError`."""
    options = options_of(scenario, command)
    folder = folder_for(parent, variant, driver, options)
    parent.mkdir(parents=True, exist_ok=True)
    write_scenario(replace(scenario, path=scenario_path(folder)), scenario_path(folder))
    write_file(options_path(folder), json.dumps(options, indent=1).encode())
    return folder


class PlannedPath(NamedTuple):
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
    plans: tuple[PlannedPath, ...] = ()

    def plan_at(self, time_s: float) -> PlannedPath | None:
        """Return the plan that was asked for last at a time; None before the first, after the rollout's end, and
        without plans."""
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
    """Return what happened in a rollout, from its steps; a last line that is not whole is left out. Raises
    `OutputError`."""
    steps = read_steps(folder, mends=False)
    if not steps:
        raise OutputError(f"{folder / STEPS}: cannot be read: it is missing, or holds no step")
    times = np.array([step.time_us for step in steps]) / US_PER_SECOND
    plans = [
        PlannedPath(float(asked), plan.times_us / US_PER_SECOND, np.stack([plan.x_m, plan.y_m], -1))
        for asked, step in zip(times, steps[1:], strict=False)
        if isinstance(plan := step.action, Plan)
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
    scores = read_json(folder / SCORES, OutputError)
    if not isinstance(scores, dict) or not isinstance(scores.get("collision"), dict):
        raise OutputError(f"{folder / SCORES}: has no scores of a rollout")
    return scores


def moments_of(scores: Mapping[str, Any], names: Mapping[str, str]) -> list[RolloutEvent]:
    """Return what happened in a rollout by its scores, in order of time; ``names`` are the actors' for people, by
    id."""

    events = []
    for contact in _member(scores, "collision").get("contacts") or ():
        if not contact.get("at_start"):
            who = names.get(str(contact["actor"]), str(contact["actor"]))
            events.append((contact["time_s"], Text("Collision: {name}", name=who)))
    static, road = _member(scores, "static_collision"), _member(scores, "off_road")
    if static.get("collided"):
        events.append((static.get("first_s"), Text("Collision: static scene")))
    if road.get("off_road"):
        events.append((road.get("first_s"), Text("Off the road")))
    least = _member(scores, "time_to_collision")
    if (seconds := least.get("minimum_s")) is not None:
        who = names.get(str(least["actor"]), str(least["actor"]))
        events.append((least["minimum_at_s"], Text("TTC {seconds:.1f} s: {name}", seconds=seconds, name=who)))
    timed = [RolloutEvent(float(time_s), text) for time_s, text in events if time_s is not None]
    return sorted(timed, key=lambda event: event.time_s)


ScoreRow = tuple[str, str, bool]
"""Name, value, and whether it is a warning."""


def score_rows(scores: Mapping[str, Any], names: Mapping[str, str]) -> list[ScoreRow]:
    """Return the rows of what `read_scores` returned; ``names`` are the actors' for people, by id. What could not be
    computed is a dash."""
    rows: list[ScoreRow] = []

    def add(name: str, value: str | None, warns: bool = False) -> None:
        rows.append((name, "–" if value is None else value, warns))

    hits = _member(scores, "collision")
    count = hits.get("count")
    collisions = Text("{count}, at fault: {fault}", count=count, fault=hits.get("at_fault_count") or 0)
    add(translatable("Collisions"), None if count is None else collisions, bool(count))
    for contact in hits.get("contacts") or ():
        who = names.get(contact["actor"], contact["actor"])
        words = Text("{name}, {speed}", name=who, speed=kmh(contact["relative_speed_m_s"]))
        rows.append((Text("At {time:.1f} s", time=contact["time_s"]), words, True))
    least = _member(scores, "time_to_collision")
    seconds = least.get("minimum_s")
    soonest = seconds is not None and Text(
        "{seconds:.1f} s at {time:.1f} s", seconds=seconds, time=least["minimum_at_s"]
    )
    add(translatable("Least TTC"), soonest or None, seconds is not None and seconds < 1)
    for column in PLAIN:
        add(column.title, column.text(_member(scores, column.member).get(column.key)))
    away = _member(scores, "deviation").get("across_max_m")
    add(translatable("Off the log"), None if away is None else Text("{length} at most", length=metres(away)))
    road = _member(scores, "off_road")
    if road.get("off_road") is not None:
        left = Text("left it, by the log's labels") if road.get("method") == "road_labels" else Text("left it")
        if road.get("farthest_m"):
            left = Text("left it by {length}", length=metres(road["farthest_m"]))
        add(translatable("Road"), left if road["off_road"] else Text("kept to it"), bool(road["off_road"]))
    smooth = _member(scores, "comfort").get("comfortable")
    comfort = Text("within limits") if smooth else Text("limits exceeded")
    add(translatable("Comfort"), None if smooth is None else comfort)
    unseen = _member(scores, "unsupported").get("mean_share")
    add(translatable("Unsupported"), None if unseen is None else f"{100 * unseen:.0f} %", bool(unseen and unseen > 0.2))
    return rows


class ScoreColumn(NamedTuple):
    """A column of a list of rollouts: its title, what the score means, where it is in `read_scores`, how a value is
    written, and whether more is better."""

    title: str
    about: str
    member: str
    key: str
    form: str
    rises: bool

    def text(self, value: float | None) -> str:
        """Return a value as it is written; a dash for none."""
        return "–" if value is None else self.form.format(value).replace("%", " %")


COLUMNS = (
    ScoreColumn(translatable("Collisions"), translatable("Actors that the vehicle touches; fewer are better"),
                "collision", "count", "{:.0f}", False),
    ScoreColumn(translatable("Least TTC"),
                translatable("Least time to collision in seconds, if both keep velocity and heading; longer is better"),
                "time_to_collision", "minimum_s", "{:.1f} s", True),
    ScoreColumn("PDMS", translatable("NAVSIM's score, 0 to 1, of no collision at fault, progress, time to collision and "
                                     "comfort; higher is better"), "pdms", "score", "{:.2f}", True),
    ScoreColumn("HD-score", translatable("HUGSIM's score, 0 to 1, of the driver's plans, times progress; higher is better"),
                "hd_score", "score", "{:.2f}", True),
    ScoreColumn(translatable("NCAP stars"), translatable("NeuroNCAP's stars, 0 to 5: 5 without a collision, fewer the "
                "faster it is; more are better"), "ncap", "stars", "{:.1f} / 5", True),
    ScoreColumn(translatable("Progress"), translatable("Distance along the recorded path as a fraction of the recorded "
                "vehicle's; higher is better"), "progress", "share", "{:.0%}", True),
    ScoreColumn(translatable("Off the log"), translatable("Greatest distance to the side of the recorded path, in metres; "
                "less is better"), "deviation", "across_max_m", "{:.1f} m", False),
    ScoreColumn(translatable("Unsupported"), translatable("Fraction of the driver's pixels that no recorded data "
                "supports; less is better"), "unsupported", "mean_share", "{:.0%}", False),
)  # fmt: skip
PLAIN = COLUMNS[2:6]
"""Those whose values alone are a row of the panel."""


class ListedRollout(NamedTuple):
    """A rollout in a list: its folder, its driver, how it ended, and its values in `COLUMNS`, None where it has none."""

    folder: Path
    driver: str
    end: str
    values: tuple[float | None, ...]


def listed_rollouts(folders: Iterable[Path]) -> list[ListedRollout]:
    """Return the rollouts among some folders; those that were not scored have no values."""
    return [_listed(folder, rollout_state(folder)) for folder in folders if (folder / STEPS).is_file()]


@lru_cache(maxsize=1000)  # a list asks at every redraw
def _listed(folder: Path, state: str) -> ListedRollout:
    try:
        scores = read_scores(folder)
    except UnisimError:
        end = Text("Stopped after {count} steps", count=count_steps(folder))
        return ListedRollout(folder, "", end, (None,) * len(COLUMNS))
    end = Text("To its end: {seconds:.1f} s", seconds=float(scores.get("duration_s") or 0.0))
    first = _member(scores, "collision").get("first_s")
    if first is not None:
        end = Text("Collision at {seconds:.1f} s", seconds=float(first))
    values = [_member(scores, column.member).get(column.key) for column in COLUMNS]
    numbers = (float(value) if isinstance(value, int | float) else None for value in values)
    return ListedRollout(folder, str(scores.get("driver", "")), end, tuple(numbers))


def best_values(rollouts: Sequence[ListedRollout]) -> list[str]:
    """Return the best value of each column as it is written; "" where no two rollouts differ in it."""
    best = []
    for column, values in zip(COLUMNS, zip(*(rollout.values for rollout in rollouts), strict=True), strict=False):
        known = sorted((value for value in values if value is not None), reverse=column.rises)
        texts = [column.text(value) for value in known]
        best.append(texts[0] if len(set(texts)) > 1 else "")
    return best


def in_order(rollouts: Sequence[ListedRollout], column: int) -> list[ListedRollout]:
    """Return rollouts in the order of a column, the best first and those without a value last; of a negative one, in the
    order of their names."""

    def key(rollout: ListedRollout) -> tuple[Any, ...]:
        value = rollout.values[column] if column >= 0 else None
        name = [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", rollout.folder.name)]
        return (value is None, (-value if COLUMNS[column].rises else value) if value is not None else 0.0, name)

    return sorted(rollouts, key=key)


def vehicle_of(simulation: Mapping[str, Any] | None) -> Vehicle:
    """Return the vehicle that a simulation moves; the usual one where the parameters are none."""
    try:
        return Vehicle.from_dict(simulation or {})
    except UnisimError:
        return Vehicle()


def _member(scores: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    member = scores.get(name)
    return member if isinstance(member, dict) else {}
