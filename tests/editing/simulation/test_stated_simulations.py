"""Simulations as text: what settings show and change of it, and what they leave as it is stated."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.scenario.edits import Duplicate, Remove
from unisim_blender.core.scenario.simulation import Jitter, SimulationSpec
from unisim_blender.core.scenario.times import recording_us
from unisim_blender.core.scenario.types import FrameRange, Outputs, Scenario
from unisim_blender.core.simulation.actors.model import MODELS
from unisim_blender.core.simulation.drivers import DRIVERS
from unisim_blender.core.world.captures import US_PER_SECOND
from unisim_blender.editing.sampled.source import DriveSource
from unisim_blender.editing.simulation import stated
from unisim_blender.editing.simulation.menus import OWN, driver_items, is_function

TEXT = json.dumps({"start_s": 0.1234567890123, "seed": 2**40, "delay_s": 0.2, "jitter": {"actors_s": 0.5}})


def test_a_simulation_comes_back() -> None:
    spec = SimulationSpec(0.1, seed=3, vehicle={"width_m": 2.0}, actors={"x": {"type": "fly"}}, jitter=Jitter(1.0))
    assert stated.simulation_of(stated.simulation_text(spec), {}, ()) == spec
    assert stated.simulation_text(None) == "" and stated.simulation_of("", {}, ()) is None


def test_what_is_shown_already_changes_nothing() -> None:
    """Settings are float32, and their ranges are narrower than the schema's."""
    assert stated.with_number(TEXT, "start_s", 0.12345679104328156) == TEXT
    assert stated.number_of(TEXT, "seed") == 2**31 - 1 and stated.with_number(TEXT, "seed", 2**31 - 1) == TEXT
    assert json.loads(stated.with_number(TEXT, "start_s", 0.30000001192092896))["start_s"] == 0.3
    assert stated.with_number(TEXT, "jitter.actors_s", 0.5000000001) == TEXT
    assert stated.hidden_members(json.dumps({"jitter": {}, "rates": {}})) == ["rates"]


@pytest.mark.parametrize(("step", "delay"), [(0.05, 0.2), (0.3, 0.3), (0.15, 0.15)])
def test_a_delay_follows_its_step(step: float, delay: float) -> None:
    found = json.loads(stated.with_number(TEXT, "step_s", step))
    assert found["step_s"] == step and found["delay_s"] == pytest.approx(delay)


def test_starts_are_drawn_where_a_setting_is_not_zero() -> None:
    found = stated.with_number(TEXT, "jitter.ego_yaw_deg", 2.0)
    assert json.loads(found)["jitter"] == {"actors_s": 0.5, "ego_yaw_deg": 2.0}
    assert stated.number_of(found, "jitter.ego_yaw_deg") == 2.0 and stated.number_of("", "jitter.ego_yaw_deg") == 0.0
    assert "jitter" not in json.loads(stated.with_number(TEXT, "jitter.actors_s", 0.0))


def test_switches_state_and_forget() -> None:
    on = stated.with_default("", "duration_s")
    assert stated.states(on, "duration_s") and stated.without(on, "duration_s") == ""
    assert json.loads(stated.from_time(on, 0.4, 1.0)) == {"start_s": 0.4, "duration_s": 0.6}
    assert json.loads(stated.from_time("", 0.4, 1.0)) == {"start_s": 0.4}


def test_models_are_those_of_actors_that_there_are() -> None:
    texts = {"*": '{"type": "auto"}', "a": '{"type": "idm"}', "gone": '{"type": "idm"}', "none": ""}
    known = stated.ids_of([Remove("gone"), Duplicate("a", "new", offset_m=(1.0, 0.0, 0.0))], ["a", "gone"])
    assert known == {"a", "new"}
    spec = stated.simulation_of("", texts, known)
    assert spec is not None and spec.actors == {"*": {"type": "auto"}, "a": {"type": "idm"}}
    with pytest.raises(ScenarioError, match="simulation.actors.a.gap_m: 0 is less than"):
        stated.simulation_of("", {"a": '{"type": "idm", "gap_m": 0}'}, known)


def test_every_model_and_driver_has_a_title() -> None:
    """Of the package's own, so that they are translated."""
    assert set(stated.MODEL_TITLES) == set(MODELS) == {name for name, _, _ in stated.kinds()}
    assert [name for name, _, _ in driver_items()] == [*DRIVERS, OWN]


@pytest.mark.parametrize("kind", MODELS)
def test_every_model_can_be_chosen_and_changed(kind: str) -> None:
    text = stated.with_kind('{"type": "idm", "headway_s": 2.5}', kind)
    assert stated.kind_of(text) == kind and stated.document_of(text, "here") is not None
    assert ("headway_s" in json.loads(text)) == ("headway_s" in MODELS[kind].members)
    for member, schema in stated.numbers_of(kind).items():
        for value in (-1e9, 0.0, 0.1 + 1e-9, 3.0, 1e9):
            changed = stated.with_value(text, member, value)
            assert stated.document_of(changed, "here") is not None, (member, value)
        assert stated.value_of(stated.with_value(text, member, 3.0), member) == 3.0
        assert stated.value_of(stated.with_kind("", kind), member) == getattr(MODELS[kind], member), schema


def test_scripted_keys_are_a_line() -> None:
    text = stated.with_kind("", "scripted")
    changed = stated.with_keys(text, "0 5, 1.5 - -2, 3 0")
    assert json.loads(changed)["keys"] == [
        {"time_s": 0.0, "speed_m_s": 5.0}, {"time_s": 1.5, "left_m": -2.0}, {"time_s": 3.0, "speed_m_s": 0.0},
    ]  # fmt: skip
    assert stated.keys_text(changed) == "0 5, 1.5 - -2, 3 0"
    for wrong in ("", "now", "3 1, 2 1", "1", "0 nan"):
        assert stated.with_keys(changed, wrong) == changed, wrong


@pytest.mark.parametrize(
    ("text", "is_one"),
    [
        ("a:B", True),
        ("my.drivers:make", True),
        ("a", False),
        (":b", False),
        ("a:", False),
        ("a b:c", False),
        ("", False),
    ],
)
def test_functions_are_told_from_names(text: str, is_one: bool) -> None:
    assert is_function(text) == is_one


def test_a_simulation_has_no_frames_and_all_passes() -> None:
    outputs = Outputs(passes=("rgb",), quality="fine")
    scenario = Scenario(name="a", log="log", frames=FrameRange(0, 4, 2), outputs=outputs)
    assert stated.as_simulated(scenario) == Scenario(name="a", log="log", outputs=Outputs(passes=None, quality="fine"))


def test_steps_are_counted(source: DriveSource) -> None:
    first_us, last_us = recording_us(source.drive)
    span_s = (last_us - first_us) / US_PER_SECOND
    scenario = Scenario(name="a", log="log")
    assert stated.count_steps(scenario, source.drive) == math.ceil(round(span_s / stated.STEP_S, 6))
    for spec, steps in (
        (SimulationSpec(duration_s=1.0, step_s=0.25), 4),
        (SimulationSpec(duration_s=1.1, step_s=0.25), 5),
        (SimulationSpec(start_s=last_us / US_PER_SECOND), 1),
    ):
        assert stated.count_steps(replace(scenario, simulation=spec), source.drive) == steps
