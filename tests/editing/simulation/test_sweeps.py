"""Fields of a scenario that a batch varies, and the sweeps that are made of them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from unisim_blender.core.batch.jobs import read_jobs
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.scenario import scenario_to_json
from unisim_blender.core.scenario.types import Scenario
from unisim_blender.editing.simulation.sweeps import (
    Parameter,
    fields_of,
    parsed_values,
    sweep_document,
    write_jobs,
)

SCENARIO: dict[str, Any] = {
    "format": "unisim-scenario", "version": 1, "name": "late", "log": "street", "frames": [0, 1],
    "edits": [
        {"type": "insert", "actor": "car-01", "id": "new", "pose": {"position": [10.0, 3.5, 0.7], "yaw_deg": 180.0}},
        {"type": "retime", "actor": "car-02", "offset_s": 0.5},
        {"type": "move", "actor": "car-03", "trajectory": [{"time_s": 0.05 * i, "position": [i, 0, 0.7]}
                                                          for i in range(3)]},
    ],
    "simulation": {"seed": 3, "actors": {"a/b~c": {"type": "idm", "headway_s": 1.5}}},
}  # fmt: skip


def test_fields_are_in_words_and_units() -> None:
    found = {one.pointer: one.label for one in fields_of(SCENARIO, {"car-02": "Car 2", "car-03": "Car 3"})}
    models = {"headway_s": "gap in time (s)", "gap_m": "gap at rest (m)", "acceleration_m_s2": "acceleration (m/s²)",
              "braking_m_s2": "braking (m/s²)", "exponent": "exponent"}  # fmt: skip
    assert found == {
        "/edits/0/actor": "new: appearance",
        "/edits/0/pose/position/0": "new: place along x (m)",
        "/edits/0/pose/position/1": "new: place along y (m)",
        "/edits/0/pose/position/2": "new: place along z (m)",
        "/edits/0/pose/yaw_deg": "new: heading (°)",
        "/edits/1/offset_s": "Car 2: later (s)",
        "/simulation/seed": "Simulation: seed",
        **{f"/simulation/actors/a~1b~0c/{name}": f"a/b~c: {words}" for name, words in models.items()},
    }


def test_a_shift_can_be_varied() -> None:
    move = {"type": "move", "actor": "car-01", "offset_m": [0.0, 1.25, 0.0]}
    found = {one.label: one for one in fields_of({"edits": [move]}, {"car-01": "Car 1"})}
    shifts = ["ahead along the path (m)", "later (s)", "forward (m)", "left (m)", "up (m)"]
    assert [*found] == [f"Car 1: {shift}" for shift in shifts]
    assert found["Car 1: left (m)"].range == (0.25, 2.25) and found["Car 1: later (s)"].range == (-1.0, 1.0)


def test_ranges_reach_to_both_sides_of_the_value() -> None:
    found = {one.pointer.rpartition("/")[2]: one for one in fields_of(SCENARIO, {})}
    assert found["headway_s"].range == (0.75, 2.25) and found["gap_m"].range == (0.5, 1.5)
    sensors = {"cameras": [{"id": "front", "mount_offset": {"position": [0.0, 0.0, 0.5]}, "fov_deg": 0.0}]}
    found = {one.label: one for one in fields_of({"sensors": sensors}, {})}
    assert found["front: fov (°)"].range == (0.0, 1.0) and found["front: place along z (m)"].range == (0.3, 0.7)


def test_values_are_numbers_or_texts() -> None:
    assert parsed_values("0, 2.5,car-01 , -1e3,,") == (0, 2.5, "car-01", -1000.0)
    assert parsed_values("NaN") == ("NaN",)


def test_a_sweep_is_read_by_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "late.json").write_text(json.dumps(SCENARIO))
    parameters = [
        Parameter("offset", "/edits/1/offset_s", (), 0.0, 1.0, 3),
        Parameter("headway", "/simulation/actors/a~1b~0c/headway_s", (1, 2.5)),
    ]
    document = sweep_document("late", "late.json", parameters, "idm")
    (tmp_path / "late.sweep.json").write_text(json.dumps(document))
    jobs = read_jobs([tmp_path / "late.sweep.json"])
    assert len(jobs) == parameters[0].variants * parameters[1].variants == 6
    assert [job.parameters for job in jobs][:2] == [{"offset": 0.0, "headway": 1}, {"offset": 0.0, "headway": 2.5}]
    last = scenario_to_json(jobs[-1].scenario)
    assert last["edits"][1]["offset_s"] == 1.0 and last["simulation"]["actors"]["a/b~c"]["headway_s"] == 2.5
    assert {job.driver for job in jobs} == {"idm"}


def test_what_a_scenario_leaves_to_defaults_can_be_varied(tmp_path: Path) -> None:
    move = {"type": "move", "actor": "car-01", "offset_m": [0.0, 1.25, 0.0]}
    (tmp_path / "late.json").write_text(json.dumps({**SCENARIO, "edits": [move]}))
    labels = {one.label: one.pointer for one in fields_of({**SCENARIO, "edits": [move]}, {})}
    parameters = [Parameter(label, labels[label], (2.0,)) for label in ("car-01: later (s)", "a/b~c: gap at rest (m)")]
    (tmp_path / "sweep.json").write_text(json.dumps(sweep_document("late", "late.json", parameters, None)))
    (job,) = read_jobs([tmp_path / "sweep.json"])
    filled = scenario_to_json(job.scenario)
    assert filled["edits"] == [{**move, "later_s": 2.0}]
    assert filled["simulation"]["actors"]["a/b~c"]["gap_m"] == 2.0


@pytest.mark.parametrize("names", [("a", "a"), ("", "b")])
def test_parameters_have_names_of_their_own(names: tuple[str, str]) -> None:
    with pytest.raises(UnisimError, match="each needs a name of its own"):
        sweep_document("s", "s.json", [Parameter(name, "/edits/0/actor", (1,)) for name in names], None)


def test_jobs_are_scenarios_or_their_sweeps(tmp_path: Path) -> None:
    one, two = (Scenario(name=name, log="log", path=tmp_path / f"{name}.json") for name in ("one", "two"))
    sweep = sweep_document("two", "two.json", [Parameter("seed", "/simulation/seed", (1, 2))], None)
    jobs = write_jobs({"one": one, "two": two}, {"two": sweep}, tmp_path / "jobs")
    assert jobs == [tmp_path / "jobs" / "one.json", tmp_path / "jobs" / "two.sweep.json"]
    assert json.loads(jobs[1].read_text()) == sweep
    assert json.loads((tmp_path / "jobs" / "two.json").read_text())["name"] == "two"
