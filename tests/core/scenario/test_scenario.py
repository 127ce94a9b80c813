"""Scenario documents: exact round trips, and refusals that name the place in the file."""

from __future__ import annotations

import copy
import json
import re
import time
from pathlib import Path
from typing import Any

import jsonschema
import pytest

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.scenario import load_scenario, save_scenario, scenario_from_json, scenario_to_json
from unisim_blender.core.scenario.checks import MAX_MEMBERS, MAX_VALUES
from unisim_blender.core.scenario.edit import EDITS as REGISTERED
from unisim_blender.core.scenario.schema import scenario_schema

KEYS = [
    {"time_s": 0.0, "position": [1, 2.5, 3], "yaw_deg": 10},
    {"frame": 3, "position": [2, 0.1, 3], "quaternion_wxyz": [0.6, 0, 0, 0.8]},
]
EVERYTHING: dict[str, Any] = {
    "format": "unisim-scenario",
    "version": 1,
    "name": "all there is",
    "description": "every member that a scenario can have",
    "log": {"path": "street", "street": {"frames": 20, "seed": 3, "style": "wide"}},
    "scene": "../scenes/street",
    "frames": {"start": 0, "stop": 20, "step": 2},
    "sensors": {
        "cameras": [
            {"id": "front", "width": 960, "height": 540, "fx": 900.5, "fy": 900, "cx": 480, "cy": 270.25},
            {
                "id": "side",
                "like": "front",
                "shutter": {"duration_s": -0.03, "reference": 0.5},
                "mount_offset": {"position": [0, 1, 0], "yaw_deg": 90, "pitch_deg": -5, "roll_deg": 1},
            },
            {
                "id": "new",
                "width": 64,
                "height": 32,
                "horizontal_fov_deg": 90,
                "time_offset_s": 0.01,
                "mount": {"position": [1, 0, 1.5], "quaternion_wxyz": [0.5, -0.5, 0.5, -0.5]},
            },
        ],
        "lidars": [
            {"id": "top", "preset": "pandar64", "columns": 900, "mount": {"position": [0, 0, 2]}},
            {
                "id": "low",
                "elevation_deg": [1, 0, -1.5],
                "azimuth_offset_deg": [0, 0.1, 0],
                "sweep_s": 0.05,
                "start_azimuth_deg": 0,
                "direction": 1,
                "time_offset_s": 0,
                "min_range_m": 0.1,
                "max_range_m": 80,
                "mount": {"position": [2, 0, 0.5], "yaw_deg": 45},
            },
        ],
    },
    "boxes": {"bin": {"position": [5, 3, 0.5], "yaw_deg": 30, "size_m": [0.5, 0.5, 1]}},
    "weather": {
        "visibility_m": [{"time_s": 0, "value": 1000}, {"time_s": 2, "value": 50.5}],
        "rain_mm_h": 2.5,
        "snow_mm_h": [{"time_s": 0, "value": 0}],
        "sun_elevation_deg": [{"time_s": 0, "value": 10}, {"time_s": 2, "value": -6}],
        "street_lamps": [[4.5, -3, 8], [30, 3, 6.5]],
        "seed": 4,
        "sensors": {"pulse_ns": 6, "divergence_mrad": 1.5, "exposure_s": 0.01, "threshold": 0.2, "overlap_m": 4},
    },
    "light": {
        "sun": {
            "azimuth_deg": [{"time_s": 0, "value": -140}, {"time_s": 2, "value": -120}],
            "elevation_deg": 50,
            "strength": 0.6,
        }
    },
    "edits": [
        {"type": "remove", "actor": "car-01"},
        {
            "type": "duplicate",
            "actor": "car-02",
            "id": "car-02b",
            "offset_m": [0, 3.5, 0],
            "turn_deg": 180,
            "time_offset_s": 0.5,
        },
        {"type": "duplicate", "actor": "car-02", "id": "car-02c", "world_offset_m": [1e-7, 1 / 3, 0]},
        {"type": "insert", "actor": "van", "scene": "../other", "id": "van", "trajectory": KEYS, "outside": "hold"},
        {
            "type": "insert",
            "actor": "cone",
            "id": "cone-b",
            "pose": KEYS[0] | {"time_s": None},
            "present": {"start_s": 0.5},
        },
        {"type": "move", "actor": "car-03", "trajectory": KEYS, "present": {"start_s": 0, "end_s": 1.5}},
        {"type": "retime", "actor": "car-04", "offset_s": -0.5, "speed": 0.5, "pivot_s": 1},
        {"type": "retime", "actor": "car-05", "map": [[0, 0], [1, 0.5], [1.5, 0.5]], "outside": "continue"},
        {"type": "swap", "actor": "car-06", "appearance": "van", "scene": "../other"},
        {"type": "copy_static", "box": "bin", "id": "bin-b", "target": {"position": [9, 3, 0.5]}},
        {"type": "remove_static", "box": "bin"},
        {"type": "ego", "shift_left_m": 2},
        {"type": "ego", "shift": [{"frame": 0, "left_m": 0}, {"time_s": 1.5, "left_m": 2}]},
        {"type": "ego", "trajectory": KEYS, "outside": "continue"},
        {
            "type": "insert_mesh",
            "mesh": "barrel.glb",
            "id": "barrel",
            "label": "Barrel",
            "pose": {"position": [1, 2, 0.5]},
        },
        {"type": "scale", "actor": "car-06", "factors": [1.3, 1, 0.75]},
        {
            "type": "ego_body",
            "mesh": "van.glb",
            "id": "own",
            "label": "Van",
            "mount": {"position": [1.4, 0, 1], "yaw_deg": 2},
        },
        {"type": "lane_change", "actor": "car-07", "at_s": 1, "left_m": 3.5, "duration_s": 4},
        {"type": "brake", "actor": "car-07", "at_s": 1, "deceleration_m_s2": 2.5, "speed_m_s": 0},
        {
            "type": "brake",
            "actor": "car-07",
            "at_s": 1,
            "deceleration_m_s2": 2.5,
            "stands_s": 1,
            "acceleration_m_s2": 2,
        },
        {"type": "cut_in", "actor": "car-07", "at_s": 1, "gap_s": 1.5, "side": "left", "lane_m": 3.2, "duration_s": 4},
        {"type": "cut_in", "actor": "car-07", "at_s": 1, "gap_m": 8, "speed_m_s": 9},
        {"type": "cross", "actor": "person", "at_s": 2, "side": "right", "speed_m_s": 1.4, "gap_m": 8, "from_m": 5},
        {"type": "follow", "actor": "car-02b", "leader": "car-02", "gap_s": 1.2, "gap_m": 2},
        {
            "type": "row",
            "actor": "cone",
            "id": "cones",
            "along": "ego",
            "start_m": 10,
            "end_m": 40,
            "count": 6,
            "left_m": -2,
            "end_left_m": 1,
            "variation_m": 0.2,
        },
        {
            "type": "row",
            "actor": "car-02",
            "id": "r",
            "path": [[0, 1, 0], [9, 1, 0]],
            "start_m": 0,
            "end_m": 9,
            "spacing_m": 7,
        },
        {"type": "lamp", "actor": "light", "state": "red", "lamp": "red-green", "from_s": 0.5, "to_s": 1},
    ],
    "outputs": {"passes": ["rgb", "depth"], "formats": ["png", "npz"], "width": 480, "quality": "fast"},
}
del EVERYTHING["edits"][4]["pose"]["time_s"]
EDITS: list[dict[str, Any]] = EVERYTHING["edits"]


def document(**members: Any) -> dict[str, Any]:
    return {"format": "unisim-scenario", "version": 1, "name": "s", "log": "street", "edits": []} | members


def changed(*place: Any, value: Any) -> dict[str, Any]:
    """A copy of the whole document with the member at ``place`` set."""
    result = copy.deepcopy(EVERYTHING)
    inner: Any = result
    for step in place[:-1]:
        inner = inner[step]
    inner[place[-1]] = value
    return result


def same_json(a: Any, b: Any) -> bool:
    """Equal as JSON text up to the order of members: 1 and 1.0 differ."""
    return json.dumps(a, sort_keys=True) == json.dumps(b, sort_keys=True)


def test_the_schema_is_a_schema() -> None:
    jsonschema.Draft202012Validator.check_schema(scenario_schema())


def test_the_example_has_every_edit_and_the_schema_knows_no_other() -> None:
    assert (
        {edit["type"] for edit in EDITS}
        == set(REGISTERED)
        == set(scenario_schema()["$defs"]["edit"]["properties"]["type"]["enum"])
    )


def test_a_document_comes_back_exactly() -> None:
    scenario = scenario_from_json(EVERYTHING)
    assert same_json(scenario_to_json(scenario), EVERYTHING)
    assert scenario_from_json(scenario_to_json(scenario)) == scenario


def test_a_short_document_comes_back_without_additions() -> None:
    short = document(frames=[0, 2, 5], edits=[{"type": "remove", "actor": "a"}])
    assert same_json(scenario_to_json(scenario_from_json(short)), short)
    assert "boxes" not in scenario_to_json(scenario_from_json(short))


def test_a_file_is_written_as_it_was_read(tmp_path: Path) -> None:
    file, again = tmp_path / "a.json", tmp_path / "b.json"
    file.write_text(json.dumps(EVERYTHING))
    scenario = load_scenario(file)
    save_scenario(scenario, again)
    assert load_scenario(again) == scenario
    assert same_json(json.loads(again.read_text()), EVERYTHING)
    before = again.read_bytes()
    save_scenario(load_scenario(again), again)
    assert again.read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.json", "b.json"]


def test_paths_are_relative_to_the_file(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    file = tmp_path / "here" / "s.json"
    file.write_text(json.dumps(EVERYTHING))
    scenario = load_scenario(file)
    assert scenario.log_path == tmp_path / "here" / "street"
    assert scenario.scene_path == tmp_path / "scenes" / "street"
    assert scenario_from_json(document()).scene_path is None
    assert scenario_from_json(document(scene="recorded")).scene_path is None


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        (("format",), "other", "s.json: format: 'unisim-scenario' was expected"),
        (("version",), 2, "s.json: has version 2, newer than the 1 that this program reads"),
        (("logs",), "x", "s.json: Additional properties are not allowed ('logs' was unexpected)"),
        (("log",), 3, "s.json: log: 3 is not of type 'string'"),
        (("log", "path"), "", "s.json: log.path: '' should be non-empty"),
        (("frames",), {"start": 5, "stop": 5}, "s.json: frames: stop 5 must lie beyond start 5"),
        (("frames",), [1, 1], "s.json: frames: [1, 1] has non-unique elements"),
        (("frames",), [1.5], "s.json: frames[0]: 1.5 is not of type 'integer'"),
        (("frames",), {"step": 0}, "s.json: frames.step: 0 is less than the minimum of 1"),
        (("edits", 0, "type"), "destroy", "s.json: edits[0].type: 'destroy' is not one of"),
        (("edits", 0), {"type": "remove"}, "s.json: edits[0]: 'actor' is a required property"),
        (("edits", 0, "who"), "x", "s.json: edits[0]: Additional properties are not allowed ('who' was unexpected)"),
        (("edits", 1, "offset_m", 1), float("nan"), "s.json: edits[1].offset_m[1]: nan is not a finite number"),
        (("edits", 1, "offset_m", 1), 10**400, "s.json: edits[1].offset_m[1]: is a whole number beyond 2^53"),
        (("edits", 1, "offset_m"), [1, 2], "s.json: edits[1].offset_m: [1, 2] is too short"),
        (("edits", 1, "offset_m", 0), "1", "s.json: edits[1].offset_m[0]: '1' is not of type 'number'"),
        (("edits", 1, "offset_m", 0), True, "s.json: edits[1].offset_m[0]: True is not of type 'number'"),
        (
            ("edits", 1, "pose"),
            {"position": [0, 0, 0]},
            "s.json: edits[1]: has offset_m, time_offset_s, turn_deg beside a path",
        ),
        (("edits", 2, "id"), "car-02b", 's.json: edits[2].id: "car-02b" is taken by edits[1]'),
        (("edits", 2, "id"), "bin", 's.json: edits[2].id: "bin" is taken by boxes.bin'),
        (("edits", 3, "pose"), {"position": [0, 0, 0]}, "s.json: edits[3]: needs pose or trajectory, one of them"),
        (("edits", 3, "trajectory"), [], "s.json: edits[3].trajectory: [] should be non-empty"),
        (
            ("edits", 3, "trajectory", 0, "frame"),
            0,
            "s.json: edits[3].trajectory[0]: needs time_s or frame, one of them",
        ),
        (
            ("edits", 3, "trajectory", 1, "quaternion_wxyz", 0),
            0.7,
            "s.json: edits[3].trajectory[1].quaternion_wxyz: [0.7, 0, 0, 0.8] has length 1.06301, not 1",
        ),
        (
            ("edits", 3, "trajectory", 1, "yaw_deg"),
            0,
            "s.json: edits[3].trajectory[1]: has angles beside quaternion_wxyz",
        ),
        (
            ("edits", 3, "trajectory"),
            [KEYS[0], KEYS[0]],
            "s.json: edits[3].trajectory[1].time_s: 0.0 must lie after the key before",
        ),
        (
            ("edits", 3, "trajectory"),
            [KEYS[1], KEYS[1]],
            "s.json: edits[3].trajectory[1].frame: 3 must lie after the key before, 3",
        ),
        (("edits", 4, "outside"), "hold", "s.json: edits[4].outside: needs a trajectory"),
        (("edits", 5, "present", "end_s"), -1, "s.json: edits[5].present: end_s -1 lies before start_s 0"),
        (("edits", 6, "speed"), 0, "s.json: edits[6].speed: 0 is less than or equal to the minimum of 0"),
        (("edits", 6, "map"), [[0, 0]], "s.json: edits[6]: has offset_s, speed or pivot_s beside map"),
        (("edits", 6), {"type": "retime", "actor": "a"}, "s.json: edits[6]: needs offset_s, speed or map"),
        (
            ("edits", 6),
            {"type": "retime", "actor": "a", "offset_s": 1, "pivot_s": 1},
            "s.json: edits[6].pivot_s: needs a speed",
        ),
        (("edits", 7, "map", 1), [0, 1], "s.json: edits[7].map[1]: scenario time 0 must lie after 0"),
        (("edits", 7, "map", 2), [1.5, 0.4], "s.json: edits[7].map[2]: recorded time 0.4 must not lie before 0.5"),
        (("edits", 9, "box"), "bank", 's.json: edits[9].box: no box "bank" (there is bin)'),
        (("edits", 10, "box"), "bank", 's.json: edits[10].box: no box "bank" (there is bin)'),
        (("edits", 11), {"type": "ego"}, "s.json: edits[11]: needs shift_left_m, shift or trajectory, one of them"),
        (
            ("edits", 12, "shift", 1),
            {"frame": 0, "left_m": 1},
            "s.json: edits[12].shift[1].frame: 0 must lie after the key before, 0",
        ),
        (
            ("boxes", "bin", "size_m"),
            [1, 0, 1],
            "s.json: boxes.bin.size_m[1]: 0 is less than or equal to the minimum of 0",
        ),
        (("boxes", "bin", "quaternion_wxyz"), [1, 0, 0, 0], "s.json: boxes.bin: has angles beside quaternion_wxyz"),
        (("sensors", "cameras", 1, "id"), "front", 's.json: sensors.cameras[1].id: "front" stands twice'),
        (("sensors", "cameras", 1, "id"), "../up", "s.json: sensors.cameras[1].id: '../up' does not match"),
        (
            ("sensors", "cameras", 2, "mount_offset"),
            {"yaw_deg": 1},
            "s.json: sensors.cameras[2]: has both mount and mount_offset",
        ),
        (("sensors", "lidars", 0, "preset"), "pandar65", "s.json: sensors.lidars[0].preset: 'pandar65' is not one of"),
        (("weather", "visibility_m"), 1, "s.json: weather.visibility_m: 1 is less than the minimum of 5"),
        (
            ("weather", "sun_elevation_deg"),
            -20,
            "s.json: weather.sun_elevation_deg: -20 is less than the minimum of -18",
        ),
        (("weather", "street_lamps"), 8, "s.json: weather.street_lamps: 8 is not of type 'array'"),
        (("weather", "street_lamps", 1), [3, 4], "s.json: weather.street_lamps[1]: [3, 4] is too short"),
        (
            ("weather", "street_lamps", 1, 0),
            float("nan"),
            "s.json: weather.street_lamps[1][0]: nan is not a finite number",
        ),
        (
            ("weather", "street_lamps", 0, 2),
            0,
            "s.json: weather.street_lamps[0][2]: 0 is less than or equal to the minimum of 0",
        ),
        (
            ("weather", "street_lamps"),
            [[1, 2, 8]] * 501,
            "s.json: weather.street_lamps: has 501 members, more than the 500 that are read",
        ),
        (("weather", "street_lamps", 0, 1), 1e7, "s.json: weather.street_lamps[0][1]: 1e+07 is not within 1e+06 m"),
        (("weather", "visibility_m"), "fog", "s.json: weather.visibility_m: 'fog' is not of type 'number'"),
        (("weather", "visibility_m"), [], "s.json: weather.visibility_m: [] should be non-empty"),
        (
            ("weather", "visibility_m", 1, "time_s"),
            0,
            "s.json: weather.visibility_m[1].time_s: 0 s must lie after the key before, 0 s, by a microsecond",
        ),
        (("light", "sun", "elevation_deg"), 0, "s.json: light.sun.elevation_deg: 0 is less than the minimum of 2"),
        (
            ("light", "sun", "azimuth_deg", 1, "time_s"),
            0,
            "s.json: light.sun.azimuth_deg[1].time_s: 0 s must lie after the key before, 0 s, by a microsecond",
        ),
        (("weather", "hail"), 1, "s.json: weather: Additional properties are not allowed ('hail' was unexpected)"),
        (("outputs", "passes"), ["rgb", "smell"], "s.json: outputs.passes[1]: 'smell' is not one of"),
        (("outputs", "quality"), "best", "s.json: outputs.quality: 'best' is not one of"),
    ],
)
def test_a_fault_is_refused_with_its_place(place: tuple[Any, ...], value: Any, message: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        scenario_from_json(changed(*place, value=value), Path("s.json"))
    assert str(caught.value).startswith(message)
    assert "\n" not in str(caught.value)


def test_a_long_value_does_not_flood_the_message() -> None:
    with pytest.raises(ScenarioError) as caught:
        scenario_from_json(document(edits=[{"type": "remove", "actor": list(range(10_000))}]))
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize(
    ("text", "message"), [("{", "is not valid JSON"), ("[]", "is not of type 'object'"), ("\xff", "is not UTF-8 text")]
)
def test_what_is_no_scenario_is_refused(tmp_path: Path, text: str, message: str) -> None:
    file = tmp_path / "s.json"
    file.write_bytes(text.encode("latin-1"))
    with pytest.raises(ScenarioError, match=message) as caught:
        load_scenario(file)
    assert str(caught.value).startswith(str(file))


def test_a_bad_scenario_is_not_written(tmp_path: Path) -> None:
    scenario = scenario_from_json(document(edits=[{"type": "retime", "actor": "a", "offset_s": 1}]))
    object.__setattr__(scenario.edits[0], "offset_s", float("inf"))
    with pytest.raises(ScenarioError, match=r"s\.json: edits\[0\]\.offset_s: inf is not a finite number"):
        save_scenario(scenario, tmp_path / "s.json")
    assert not list(tmp_path.iterdir())


def documented_examples() -> list[dict[str, Any]]:
    """The JSON blocks of the format's page, each completed to a document."""
    page = (Path(__file__).parents[3] / "docs" / "reference" / "scenario.md").read_text(encoding="utf-8")
    decoder, examples = json.JSONDecoder(), []
    for block in re.findall(r"```json\n(.*?)```", page, re.S):
        if block.startswith("{\n"):
            examples.append(json.loads(block))
            continue
        members: dict[str, Any] = {"edits": []}
        rest = block.strip()
        while member := re.match(r'"(\w+)": ', rest):
            value, end = decoder.raw_decode(rest, member.end())
            members[member[1]], rest = value, rest[end:].strip()
        while rest:
            value, end = decoder.raw_decode(rest)
            members["edits"].append(value)
            rest = rest[end:].strip()
        examples.append(document(**members))
    return examples


def test_the_pages_examples_are_valid_and_show_every_edit() -> None:
    examples = documented_examples()
    for example in examples:
        assert same_json(scenario_to_json(scenario_from_json(example)), example)
    assert {edit["type"] for example in examples for edit in example["edits"]} == set(REGISTERED)


@pytest.mark.parametrize("name", ("edits", "frames", "trajectory", "cameras"))
def test_more_than_is_read_is_refused_soon(name: str) -> None:
    document = copy.deepcopy(EVERYTHING)
    count = MAX_MEMBERS[name] + 1
    if name == "edits":
        document["edits"] = [{"type": "remove", "actor": "car"}] * count
    elif name == "frames":
        document["frames"] = list(range(count))
    elif name == "cameras":
        document["sensors"]["cameras"] = [document["sensors"]["cameras"][0]] * count
    else:
        keys = [{"time_s": i / count, "position": [0, 0, 0]} for i in range(count)]
        document["edits"] = [{"type": "move", "actor": "car", "trajectory": keys}]
    begun = time.process_time()
    with pytest.raises(ScenarioError, match=f"{name}: has {count} members, more than the {count - 1} that are read"):
        scenario_from_json(document)
    assert time.process_time() - begun < 5


def test_many_long_lists_are_refused_soon() -> None:
    keys = [{"time_s": i / 20000, "position": [0, 0, 0]} for i in range(MAX_MEMBERS["trajectory"])]
    document = copy.deepcopy(EVERYTHING)
    document["edits"] = [{"type": "move", "actor": "car", "trajectory": keys}] * 30
    begun = time.process_time()
    with pytest.raises(ScenarioError, match=f"holds more than {MAX_VALUES} values"):
        scenario_from_json(document)
    assert time.process_time() - begun < 10


def test_as_much_as_is_read_is_read() -> None:
    document = copy.deepcopy(EVERYTHING)
    document["edits"] = [{"type": "remove", "actor": "car"}] * MAX_MEMBERS["edits"]
    assert len(scenario_from_json(document).edits) == MAX_MEMBERS["edits"]


@pytest.mark.parametrize("text", ("\\ud800", "a\\u0000b"))
def test_a_text_that_is_no_path_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "scenario.json"
    path.write_text(json.dumps({**EVERYTHING, "log": "LOG"}).replace("LOG", text))
    with pytest.raises(ScenarioError, match=r"scenario\.json: log: holds a text that is none: '"):
        load_scenario(path)
    path.write_text(json.dumps({**EVERYTHING, "boxes": {"LOG": EVERYTHING["boxes"]["bin"]}}).replace("LOG", text))
    with pytest.raises(ScenarioError, match=r"scenario\.json: boxes: holds a text that is none: '"):
        load_scenario(path)
