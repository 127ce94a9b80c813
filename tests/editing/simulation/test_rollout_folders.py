"""Rollouts' folders: numbered, resumed where they are of the same, and read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from unisim_blender.core.errors import OutputError
from unisim_blender.core.scenario.edits import InsertMesh
from unisim_blender.core.scenario.types import Scenario
from unisim_blender.core.simulation.rollout.steps import RolloutStep, append_step
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.simulation.vehicle.actions import Control, Plan
from unisim_blender.editing.layout.trails import plan_lines
from unisim_blender.editing.sampled.source import is_rollout
from unisim_blender.editing.simulation.rollouts import (
    count_steps,
    folder_for,
    folder_of,
    moments_of,
    options_of,
    options_path,
    read_rollout,
    read_scores,
    scenario_path,
    score_rows,
    write_inputs,
)

SCENARIO = Scenario(name="a", log="log")


def test_the_same_is_resumed_and_another_gets_the_next_number(tmp_path: Path) -> None:
    one, two = (options_of(SCENARIO, ["--driver", name]) for name in ("idm", "log"))
    folder = folder_for(tmp_path, "Scene", "my.module:Make_1", one)
    assert folder == tmp_path / "Scene Make_1 1"
    options_path(folder).write_text(json.dumps(one))
    assert folder_for(tmp_path, "Scene", "my.module:Make_1", one) == folder
    assert folder_for(tmp_path, "Scene", "my.module:Make_1", two) == tmp_path / "Scene Make_1 2"
    assert folder_for(tmp_path, "a/b", "log", two) == tmp_path / "a_b log 1"


def test_options_tell_meshes_by_their_names() -> None:
    """Each process of Blender has another folder for them."""
    edits = [
        InsertMesh(id="m", mesh=f"/tmp/{place}/abc.ply", label="Car", pose=None, trajectory=None)
        for place in ("one", "two")
    ]
    first, second = (options_of(Scenario(name="a", log="log", edits=(edit,)), []) for edit in edits)
    assert first == second != options_of(SCENARIO, [])


@pytest.fixture
def rolled(tmp_path: Path) -> Path:
    """Three steps: a plan, then a control."""
    ego = EgoState(0.0, 0.0, 0.0, 5.0)
    x, y, heading = (np.array(values) for values in ([0.0, 5.0, 10.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.2]))
    plan = Plan(np.array([0, 1_000_000, 2_000_000]), x, y, heading)
    for time_us, action in ((0, None), (100_000, plan), (200_000, Control(-1.0, 0.0))):
        append_step(tmp_path, RolloutStep(time_us, ego, {}, action))
    return tmp_path


def test_steps_and_plans_are_read(rolled: Path) -> None:
    with (rolled / "steps.jsonl").open("a") as file:
        file.write('{"time_us": 4')  # it is being written
    found = read_rollout(rolled)
    assert found.times_s.tolist() == [0.0, 0.1, 0.2] and count_steps(rolled) == 2
    plan = found.plan_at(0.05)
    assert plan is not None and plan.asked_s == 0.0 and plan.places.tolist() == [[0, 0], [5, 0], [10, 1]]
    assert found.plan_at(-0.1) is None and found.plan_at(0.3) is None
    assert found.nearest_step(0.0) == 0.1 == found.nearest_step(0.2)
    lines = plan_lines(plan, 1.0)
    assert len(lines.points) == 2 * 2 + 2 * 2 and np.ptp(lines.points[:, 2]) == 0
    tick = lines.points[4:6]
    assert tick.mean(0)[:2] == pytest.approx((5, 0)) and np.linalg.norm(tick[1] - tick[0]) == pytest.approx(1.0)
    assert len(plan_lines(None, 0.0).points) == 0


@pytest.mark.parametrize("content", ["", "{}\n", "nothing\n"])
def test_what_is_no_rollout_is_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "steps.jsonl").write_text(content)
    with pytest.raises(OutputError, match="step"):
        read_rollout(tmp_path)
    (tmp_path / "scores.json").write_text("{}")
    with pytest.raises(OutputError, match="has no scores"):
        read_scores(tmp_path)
    with pytest.raises(OutputError, match="cannot be read"):
        read_rollout(tmp_path / "nowhere")
    assert count_steps(tmp_path / "nowhere") == 0


def test_a_folder_is_told_by_its_files(rolled: Path) -> None:
    assert not is_rollout(rolled)
    (rolled / "scenario.json").write_text("{}")
    assert folder_of(rolled) == rolled == folder_of(rolled / "scenario.json")
    assert folder_of(rolled / "simulated.json") is None and folder_of(rolled.parent) is None


SCORES = {
    "collision": {
        "count": 1, "at_fault_count": 0,
        "contacts": [{"actor": "a", "time_s": 1.25, "at_start": False, "relative_speed_m_s": 3.0},
                     {"actor": "b", "time_s": 0.0, "at_start": True, "relative_speed_m_s": 0.0}],
    },
    "time_to_collision": {"minimum_s": 0.4, "minimum_at_s": 1.0, "actor": "b"},
    "static_collision": {"collided": True, "first_s": 0.5},
    "off_road": {"off_road": True, "first_s": 2.0},
    "pdms": {"score": None}, "progress": {"share": 0.5}, "comfort": {"comfortable": False},
}  # fmt: skip


def test_what_happened_is_told_in_order() -> None:
    found = [(moment.time_s, str(moment.text)) for moment in moments_of(SCORES, {"a": "Car 1"})]
    assert found == [
        (0.5, "Collision: static scene"), (1.0, "TTC 0.4 s: b"), (1.25, "Collision: Car 1"), (2.0, "Off the road"),
    ]  # fmt: skip
    assert moments_of({}, {}) == []


def test_scores_are_rows() -> None:
    rows = {str(name): (str(value), warns) for name, value, warns in score_rows(SCORES, {"a": "Car 1"})}
    assert rows["Collisions"] == ("1, at fault: 0", True) and rows["At 1.2 s"] == ("Car 1, 11 km/h", True)
    assert rows["Least TTC"] == ("0.4 s at 1.0 s", True) and rows["PDMS"] == ("–", False)
    assert rows["Progress"] == ("50 %", False) and rows["Road"] == ("left it", True)
    for method, farthest_m, said in (
        ("road_labels", None, "left it, by the log's labels"),
        ("", 0.04, "left it by 0.04 m"),
    ):
        road = {"off_road": True, "first_s": 2.0, "method": method, "farthest_m": farthest_m}
        shown = score_rows({**SCORES, "off_road": road, "deviation": {"across_max_m": 0.04}}, {})
        assert ("Road", said, True) in shown and ("Off the log", "0.04 m at most", False) in shown
    assert rows["Comfort"][0] == "limits exceeded" and rows["NCAP stars"][0] == "–"


def test_a_rollout_begins_with_its_scenario_and_options(tmp_path: Path) -> None:
    command = ["--driver", "idm"]
    folder = write_inputs(SCENARIO, command, tmp_path / "new", "Scene", "idm")
    assert folder == tmp_path / "new" / "Scene idm 1" and not folder.exists()
    assert json.loads(scenario_path(folder).read_text())["log"] == "log"
    assert json.loads(options_path(folder).read_text()) == options_of(SCENARIO, command)
    assert write_inputs(SCENARIO, command, tmp_path / "new", "Scene", "idm") == folder, "it is resumed"
