"""What a scenario states that no object stands for: kept as text, and given back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.scenario import scenario_from_json
from unisim_blender.core.scenario.sensors.document import CameraSpec, Sensors
from unisim_blender.core.scenario.types import FrameRange, Outputs, Scenario
from unisim_blender.editing.reading.scenario import (
    captures_words,
    moment_keys,
    names_captures,
    span_s,
    stated_text,
    with_stated,
)
from unisim_blender.editing.sampled.source import DriveSource


def scenario(**members: Any) -> Scenario:
    head = {"format": "unisim-scenario", "version": 1, "name": "one", "log": "log", "edits": []}
    return scenario_from_json(head | members)


def name_of(source: DriveSource) -> str:
    return next(iter(source.drive.cameras))


STATED: dict[str, tuple[dict[str, Any], str]] = {
    "listed times": ({"times": [0.05, 0.3, 0.35]}, "3 times"),
    "a rate": ({"times": {"rate_hz": 20, "start_s": 0.5, "stop_s": 1.0}}, "0.5 to 1 s, 20 Hz"),
    "the whole": ({"times": {"rate_hz": 20}}, "20 Hz"),
    "outside": ({"times": {"rate_hz": 5, "start_s": -0.5}, "outside": "hold"}, "From -0.5 s, 5 Hz"),
    "listed frames": ({"frames": [0, 3, 4]}, "3 listed frames"),
    "a range": ({"frames": {"start": 2, "step": 3}}, "Frames of the scenario"),
}


@pytest.mark.parametrize("name", STATED)
def test_what_is_stated_comes_back(source: DriveSource, name: str) -> None:
    members, words = STATED[name]
    outputs = {"formats": ["png"], "quality": "fine"}
    whole = scenario(**members, description="A drive", outputs=outputs)
    text = stated_text(whole)
    assert names_captures(text) and captures_words(text) == words
    read = scenario(outputs={"quality": "fast"})
    found = with_stated(read, text, source.drive, captures=True)
    assert (found.frames, found.times, found.outside) == (whole.frames, whole.times, whole.outside)
    # formats and quality are settings of the scene
    assert found.description == "A drive" and found.outputs == Outputs(quality="fast")


def test_another_frame_range_wins_over_times(source: DriveSource) -> None:
    text = stated_text(scenario(times=[0.1, 0.2], outside="hold"))
    read = replace(scenario(), frames=FrameRange(2, 5, 1))
    found = with_stated(read, text, source.drive, captures=False)
    assert found.frames == FrameRange(2, 5, 1) and found.times is None and found.outside == "hold"


def test_sensors_keep_times_of_their_own(source: DriveSource) -> None:
    name = name_of(source)
    text = stated_text(replace(scenario(), sensors=Sensors((CameraSpec(name, times=(0.1, 0.25)),))))
    assert names_captures(text) and captures_words(text) == "1 sensor at times of its own"
    found = with_stated(scenario(), text, source.drive, captures=True)
    assert found.sensors is not None and found.sensors.lidars is None
    assert {spec.id: spec.times for spec in found.sensors.cameras or ()} == dict.fromkeys(source.drive.cameras) | {
        name: (0.1, 0.25)
    }


def test_nothing_is_kept_of_a_scenario_that_states_nothing() -> None:
    assert stated_text(scenario(edits=[{"type": "remove", "actor": "a"}])) == "" and not names_captures("")
    assert not names_captures(stated_text(scenario(description="A drive")))


def test_what_will_be_rendered(source: DriveSource) -> None:
    name = name_of(source)
    assert moment_keys(scenario(times=[0.05, 0.3]), source.drive, range(3)) == {"t0000000050000us", "t0000000300000us"}
    assert moment_keys(scenario(), source.drive, range(0, 6, 2)) == {0, 2, 4}
    own = replace(scenario(), sensors=Sensors((CameraSpec(name, times=(0.05,)),)))
    assert moment_keys(own, source.drive, range(2)) == {0, 1, "t0000000050000us"}
    assert span_s(scenario(times=[0.05, 0.3]), source.drive) == (0.05, 0.3) and span_s(scenario(), source.drive) is None


@pytest.mark.parametrize("text", ["{", "[]", '{"times": "soon"}', "[" * 5000])
def test_a_text_that_is_none_is_told_when_it_is_needed(source: DriveSource, text: str) -> None:
    """A panel that draws must not fail: files can be edited by hand."""
    assert not names_captures(text)
    with pytest.raises(ScenarioError, match="the scenario that was imported") as error:
        with_stated(scenario(), text, source.drive, captures=False)
    assert "\n" not in str(error.value)
