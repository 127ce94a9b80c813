"""Scenarios into Blender and out again: the same drive."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import SAMPLE, assert_alike, drive_of, there_and_back

from unisim_blender.bridge.objects.imported import copy_of, imported_objects, source_of
from unisim_blender.bridge.objects.settings import rendered_keys
from unisim_blender.bridge.objects.weather import show_recorded_sun, weather_and_sun
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.core.scenario import (
    load_scenario,
    save_scenario,
    scenario_from_json,
    scenario_to_json,
)
from unisim_blender.core.scenario.light import sun_of
from unisim_blender.core.scenario.types import FrameRange
from unisim_blender.core.scenario.weather import weather_of
from unisim_blender.core.world.encoding import decode_state
from unisim_blender.core.world.light import SunPosition, direction_to
from unisim_blender.editing.reading.requests import camera_request
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.features.drive.export_operators import scenario_of


def test_the_sample(scene: Any, tmp_path: Path) -> None:
    path = SAMPLE / "scenario.json"
    assert_alike(drive_of(path), drive_of(there_and_back(path, tmp_path)))


STATED: dict[str, dict[str, Any]] = {
    "times": {"times": [0.05, 0.3, 0.35]},
    "a rate": {"times": {"rate_hz": 20, "start_s": 0.5, "stop_s": 1.0}},
    "times outside": {"times": {"rate_hz": 5, "start_s": -0.5, "stop_s": 0.5}, "outside": {"ego": "hold"}},
    "listed frames": {"frames": [1, 4, 5]},
    "a range": {"frames": {"start": 2, "stop": 8, "step": 2}},
    "own times": {"sensors": {"cameras": [{"id": "front_camera", "times": {"rate_hz": 15}}]}},
    "weather": {
        "weather": {
            "rain_mm_h": 12.5,
            "wetness": 0.5,
            "snow_mm_h": [{"time_s": 0.0, "value": 0.0}, {"time_s": 0.4, "value": 2.0}, {"time_s": 1.0, "value": 1.0}],
            "seed": 7,
            "sensors": {"exposure_s": 0.01},
        }
    },
    "dusk": {"weather": {"sun_elevation_deg": -6.0}},
    "lamps": {"weather": {"sun_elevation_deg": -18.0, "street_lamps": [[4.0, -2.5, 8.0], [-310.123, 12.0, 6.5]]}},
    "lamps by day": {"weather": {"sun_elevation_deg": 20.0, "street_lamps": [[4.0, -2.5, 8.0]]}},
    "the sun goes down": {
        "weather": {"sun_elevation_deg": [{"time_s": 0.1, "value": 10.0}, {"time_s": 0.7, "value": -18.0}]}
    },
    "light": {"light": {"sun": {"azimuth_deg": -136, "elevation_deg": 54, "strength": 0.7}}},
    "a moving sun": {
        "light": {
            "sun": {
                "azimuth_deg": [{"time_s": 0.1, "value": -200}, {"time_s": 0.7, "value": 130}],
                "elevation_deg": 30,
                "strength": [{"time_s": 0.0, "value": 0.0}, {"time_s": 1.0, "value": 0.9}],
            }
        }
    },
    "formats": {
        "description": "A drive",
        "outputs": {"passes": ["rgb"], "formats": ["png"], "quality": "fine", "fill": "texture"},
    },
    "detail": {"outputs": {"passes": ["rgb"], "quality": "fine", "detail": True}},
    "a fixer": {"outputs": {"passes": ["rgb"], "quality": "fine", "fill": "our_fixers:fix"}},
}


def stating(members: dict[str, Any], folder: Path) -> Path:
    """A scenario of the sample's street, edited once, that states more."""
    document = json.loads((SAMPLE / "scenario.json").read_text())
    kept = {key: document[key] for key in ("format", "version", "name")}
    log, trained = ((SAMPLE / name).resolve().as_posix() for name in (document["log"]["path"], document["scene"]))
    edits = [{"type": "remove", "actor": "car-12"}]
    path = folder / "stating.json"
    path.write_text(json.dumps({**kept, "log": log, "scene": trained, **members, "edits": edits}))
    return path


@pytest.mark.parametrize("name", STATED)
def test_what_no_object_stands_for_comes_back(scene: Any, tmp_path: Path, name: str) -> None:
    path = stating(STATED[name], tmp_path)
    before, after = load_scenario(path), load_scenario(there_and_back(path, tmp_path))
    assert (after.frames, after.times, after.outside) == (before.frames, before.times, before.outside)
    assert (after.sensors, after.edits, after.description) == (before.sensors, before.edits, before.description)
    if before.outputs is not None:
        assert after.outputs == before.outputs
    suns = [None if x.light is None else sun_of(x.light).at(0.43) for x in (before, after)]
    assert (suns[0] is None) == (suns[1] is None)
    if suns[0] is not None and suns[1] is not None:
        np.testing.assert_allclose(suns[1].direction, suns[0].direction, atol=1e-6)
        np.testing.assert_allclose(suns[1].strength, suns[0].strength, atol=1e-6)
    weathers = [None if x.weather is None else weather_of(x.weather) for x in (before, after)]
    for time_s in (-1.0, 0.0, 0.13, 0.4, 0.77, 3.0):
        was, now = (None if x is None else x.at(time_s) for x in weathers)
        assert (was is None) == (before.weather is None) and (now is None) == (was is None)
        if was is not None and now is not None:
            assert now.snow_mm_h == pytest.approx(was.snow_mm_h, abs=1e-4)
            assert now.sun_elevation_deg == pytest.approx(was.sun_elevation_deg, abs=1e-3)
            now = replace(now, snow_mm_h=0, sun_elevation_deg=0)
            assert now == replace(was, snow_mm_h=0, sun_elevation_deg=0)
    lamps = [None if x.weather is None else x.weather.street_lamps for x in (before, after)]
    assert lamps[1] == lamps[0]


def test_street_lamps_are_objects_that_are_moved_copied_and_deleted(scene: Any, tmp_path: Path) -> None:
    members = {"weather": {"sun_elevation_deg": -12.0, "street_lamps": [[12.5, 3.0, 7.0]]}}
    there_and_back(stating(members, tmp_path), tmp_path)
    (lamp,) = imported_objects(scene, "STREET_LAMP")
    before = weather_and_sun(scene)
    scene.cursor.location = (20.0, -3.0, 0.0)
    assert bpy.ops.unisim.add_street_lamp(height_m=8.0) == {"FINISHED"}
    added = bpy.context.active_object
    assert weather_and_sun(scene) != before
    copy = copy_of(bpy.context, added)
    copy.location.x, copy.scale = 40.0, (1.5, 1.5, 1.5)
    lamp.location = (13.0, 4.0, 2.0)

    def lamps() -> Any:
        weather = scenario_of(scene, tmp_path / "lit.json").weather
        return weather is not None and sorted(weather.street_lamps or ())

    assert lamps() == [(13.0, 4.0, 7.0), (20.0, -3.0, 8.0), (40.0, -3.0, 12.0)]
    sampled = sample_all(scene, Clock.of(source_of(scene).drive))
    view = next(obj for obj in sampled.objects if obj.kind == "CAMERA")
    asked = camera_request(sampled, view, source_of(scene), 6.0, (64, 36))
    state = decode_state(asked.values["state"])
    assert state.weather is not None and sorted(state.weather.street_lamps) == lamps()
    bpy.data.objects.remove(lamp)
    copy.hide_render = True
    assert lamps() == [(20.0, -3.0, 8.0)]


def test_weather_is_animated_as_anything_and_reaches_what_is_rendered(scene: Any, tmp_path: Path) -> None:
    there_and_back(stating({}, tmp_path), tmp_path)
    about = scene.unisim_weather
    about.visibility_m = 400.0
    scene.keyframe_insert("unisim_weather.visibility_m", frame=2)
    about.visibility_m = 50.0
    scene.keyframe_insert("unisim_weather.visibility_m", frame=4)
    drive = source_of(scene).drive
    weather = scenario_of(scene, tmp_path / "foggy.json").weather
    assert weather is not None and weather.rain_mm_h is None
    keys = weather_of(weather)
    at = {frame: keys.at(drive.time_s[frame]) for frame in (0, 2, 3, 4, 9)}
    assert [round(x.visibility_m, 2) for x in at.values() if x is not None][::4] == [400.0, 50.0]
    assert at[3] is not None and 50 < at[3].visibility_m < 400
    sampled = sample_all(scene, Clock.of(drive))
    view = next(obj for obj in sampled.objects if obj.kind == "CAMERA")
    asked = camera_request(sampled, view, source_of(scene), 6.0, (64, 36))
    state = decode_state(asked.values["state"])
    assert state.weather is not None and state.weather.visibility_m == pytest.approx(50.0, rel=1e-3)
    scene.animation_data_clear()
    about.visibility_m = 1e5
    assert scenario_of(scene, tmp_path / "clear.json").weather is None


def test_a_sun_is_turned_by_its_ball_animated_and_reaches_what_is_rendered(scene: Any, tmp_path: Path) -> None:
    there_and_back(stating({}, tmp_path), tmp_path)
    assert scenario_of(scene, tmp_path / "off.json").light is None
    sun, drive = scene.unisim_sun, source_of(scene).drive
    show_recorded_sun(scene, SunPosition(30.0, 20.0, 0.3))
    assert not sun.enabled
    np.testing.assert_allclose(sun.direction, direction_to(np.radians(30), np.radians(20)), atol=1e-6)
    sun.enabled, sun.direction = True, (0.0, -0.6, 0.8)
    np.testing.assert_allclose((sun.azimuth, sun.elevation), (-np.pi / 2, np.arcsin(0.8)), atol=1e-6)
    sun.direction = (1.0, 0.0, -0.2)  # the ball turns below the horizon, the sun does not
    assert sun.azimuth == 0 and sun.elevation == pytest.approx(np.radians(2))
    before = weather_and_sun(scene)
    for frame, azimuth in ((2, 0.0), (6, np.pi / 2)):
        sun.azimuth = azimuth
        scene.keyframe_insert("unisim_sun.azimuth", frame=frame)
    assert weather_and_sun(scene) != before
    spec = scenario_of(scene, tmp_path / "sun.json").light
    assert spec is not None and spec.sun.strength == pytest.approx(0.7)
    degrees = [sun_of(spec).at(drive.time_s[frame]).azimuth_deg for frame in (0, 4, 9)]
    assert degrees == pytest.approx([0, 45, 90], abs=0.01)
    sampled = sample_all(scene, Clock.of(drive))
    view = next(obj for obj in sampled.objects if obj.kind == "CAMERA")
    asked = camera_request(sampled, view, source_of(scene), 8.0, (64, 36))
    state = decode_state(asked.values["state"])
    assert state.light is not None and state.light.sun.azimuth_deg == pytest.approx(90)


def test_another_frame_range_takes_the_place_of_times(scene: Any, tmp_path: Path) -> None:
    path = stating(STATED["a rate"], tmp_path)
    again = there_and_back(path, tmp_path)
    assert (scene.frame_start, scene.frame_end) == (5, 10) and load_scenario(again).times is not None
    scene.frame_end = 8
    assert bpy.ops.unisim.export_scenario(filepath=str(again)) == {"FINISHED"}
    assert load_scenario(again).times is None and load_scenario(again).frames == FrameRange(5, 9, 1)
    scene.frame_end = 10
    assert bpy.ops.unisim.use_frame_range() == {"FINISHED"} and not bpy.ops.unisim.use_frame_range.poll()
    assert bpy.ops.unisim.export_scenario(filepath=str(again)) == {"FINISHED"}
    assert load_scenario(again).times is None and load_scenario(again).frames == FrameRange(5, 11, 1)


def test_a_sequence_of_times_counts_what_it_renders(scene: Any, tmp_path: Path) -> None:
    path = stating(STATED["a rate"], tmp_path)
    there_and_back(path, tmp_path)
    scenario = scenario_of(scene, tmp_path / "scenario.json")
    keys = rendered_keys(scene, scenario, source_of(scene).drive)
    assert len(keys) == 10 and "t0000000550000us" in keys
    scene.frame_end = 8
    assert rendered_keys(scene, scenario_of(scene, tmp_path / "scenario.json"), source_of(scene).drive) == {5, 6, 7, 8}


EDITS: dict[str, list[dict[str, Any]]] = {
    "remove": [{"type": "remove", "actor": "car-12"}],
    "duplicate": [{"type": "duplicate", "actor": "car-03", "id": "second", "offset_m": [0, 3.5, 0], "time_offset_s": 0.3}],
    "insert": [
        {
            "type": "insert", "actor": "car-13", "id": "new", "present": {"start_s": 0.3},
            "trajectory": [{"frame": 3, "position": [20, 3, 0.7]}, {"frame": 9, "position": [30, 4, 0.7], "yaw_deg": 20}],
        }
    ],
    "move": [{"type": "move", "actor": "car-12", "pose": {"position": [12, 5, 0.7], "yaw_deg": 30}}],
    "retime": [{"type": "retime", "actor": "car-03", "speed": 0.5, "outside": "continue"}],
    "swap": [{"type": "swap", "actor": "car-12", "appearance": "car-13"}],
    "static": [{"type": "copy_static", "box": "bin", "id": "bin-b",
    "target": {"position": [22, 5, 0.5], "yaw_deg": 40}}],
    "static gone": [{"type": "remove_static", "box": "bin"}],
    "ego": [
        {"type": "ego", "trajectory": [{"frame": 0, "position": [0, 0, 0]},
        {"frame": 19, "position": [20, 1, 0], "yaw_deg": 5}]}
    ],
}  # fmt: skip


@pytest.mark.parametrize("name", EDITS)
def test_every_kind_of_edit(scene: Any, tmp_path: Path, name: str) -> None:
    document = scenario_to_json(load_scenario(SAMPLE / "scenario.json"))
    document["log"], document["scene"] = (
        str((SAMPLE.parent / "out" / "street").resolve()),
        str((SAMPLE / "scene").resolve()),
    )
    document["boxes"] = {"bin": {"position": [18, 5, 0.5], "size_m": [0.8, 0.8, 1.0]}}
    document["edits"] = EDITS[name]
    path = tmp_path / "scenario.json"
    save_scenario(scenario_from_json(document, path), path)
    again = there_and_back(path, tmp_path)
    assert_alike(drive_of(path), drive_of(again))


def test_sensors(scene: Any, tmp_path: Path) -> None:
    document = scenario_to_json(load_scenario(SAMPLE / "scenario.json"))
    document["log"], document["scene"] = (
        str((SAMPLE.parent / "out" / "street").resolve()),
        str((SAMPLE / "scene").resolve()),
    )
    document["edits"] = []
    name = next(iter(drive_of(SAMPLE / "scenario.json").cameras))
    document["sensors"] = {
        "cameras": [
            {"id": name, "mount_offset": {"position": [0, 0, 0.4], "pitch_deg": -4}},
            {
                "id": "wide",
                "width": 320,
                "height": 200,
                "horizontal_fov_deg": 100,
                "mount": {"position": [1, 0, 1.5], "yaw_deg": 30},
            },
            {
                "id": "mast",
                "like": name,
                "trajectory": [{"frame": 0, "position": [4, 4, 5], "yaw_deg": -20, "pitch_deg": -10}],
            },
        ],
        "lidars": [{"id": "roof", "preset": "vlp16", "mount": {"position": [0.8, 0, 1.9]}}],
    }
    path = tmp_path / "scenario.json"
    save_scenario(scenario_from_json(document, path), path)
    assert_alike(drive_of(path), drive_of(there_and_back(path, tmp_path)))
