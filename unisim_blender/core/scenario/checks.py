"""What makes a scenario valid, beyond what its schema says and without its log."""

from __future__ import annotations

from .faults import require
from .motion.placement import check_rotation
from .sensors.document import check_sensors
from .simulation.document import check_simulation
from .times.ranges import check_times
from .types import FrameRange, Scenario


def check_scenario(scenario: Scenario) -> None:
    """Raise `ScenarioError` for what contradicts itself: ids, rotations, times, choices that exclude each other."""
    path = scenario.path
    if isinstance(scenario.frames, FrameRange):
        start, stop = scenario.frames.start or 0, scenario.frames.stop
        require(stop is None or start < stop, f"{path}: frames", f"stop {stop} must lie beyond start {start}")
    check_times(scenario)
    for key, box in (scenario.boxes or {}).items():
        check_rotation(box, f"{path}: boxes.{key}")
        require(min(box.size_m) > 0, f"{path}: boxes.{key}.size_m", f"must be above 0, not {list(box.size_m)}")
    taken = {key: f"boxes.{key}" for key in scenario.boxes or {}}
    for index, edit in enumerate(scenario.edits):
        place = f"{path}: edits[{index}]"
        edit.check(scenario, place)
        new = getattr(edit, "id", None)
        if new is not None:
            require(new not in taken, f"{place}.id", f'"{new}" is taken by {taken.get(new)}')
            taken[new] = f"edits[{index}]"
    if scenario.sensors is not None:
        check_sensors(scenario.sensors, f"{path}: sensors")
    if scenario.simulation is not None:
        check_simulation(scenario.simulation, f"{path}: simulation")
