"""The edited drive of a request: kept between views of the same edits, and the one that a scenario's
file would give."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import SAMPLE

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.model.scene_file import read_scene_header
from unisim_blender.core.prepare.capture_request import capture_request
from unisim_blender.core.scenario import apply_scenario, scenario_from_json
from unisim_blender.core.scenario.types import Scenario
from unisim_blender.core.world.drive import Camera, Lidar
from unisim_blender.editing.reading import requests as asked
from unisim_blender.editing.sampled.source import DriveSource, scene_actors

EDITS: list[dict[str, Any]] = [
    {"type": "ego", "shift_left_m": 1.0},
    {"type": "duplicate", "actor": "car-01", "id": "copy", "offset_m": [0, 3, 0]},
    {"type": "remove_static", "box": "bin"},
]
CAMERAS: list[dict[str, Any]] = [
    {"id": "front_camera", "width": 240, "mount_offset": {"position": [0, 0.5, 0], "yaw_deg": 10}},
    {"id": "pole", "width": 64, "height": 48, "fx": 50, "trajectory": [{"time_s": 0, "position": [0, 4, 5]}]},
]


@pytest.fixture
def source() -> DriveSource:
    header = read_scene_header(SAMPLE / "scene")
    return DriveSource(SAMPLE / "none", SAMPLE / "scene", header.drive, None, header.parked)


def scenario(**members: Any) -> Scenario:
    boxes = {"bin": {"position": [5, 3, 0.5], "size_m": [1, 1, 1]}}
    document = {"format": "unisim-scenario", "version": 1, "name": "s", "log": "log", "edits": EDITS, "boxes": boxes}
    return scenario_from_json(document | members, Path("s.json"))


def test_it_is_what_all_edits_at_once_give(source: DriveSource) -> None:
    for cameras in (CAMERAS, CAMERAS[:1], CAMERAS[1:]):
        told = scenario(sensors={"cameras": cameras, "lidars": [{"id": "pandar64", "columns": 90}]})
        found, wanted = asked.edited_drive(told, source), apply_scenario(told, source.drive, scene_actors)
        assert found.cameras.keys() == wanted.cameras.keys() and found.lidars.keys() == wanted.lidars.keys()
        pairs: list[tuple[Camera | Lidar, Camera | Lidar]] = [
            (found.cameras[name], one) for name, one in wanted.cameras.items()
        ]
        pairs += [(found.lidars[name], one) for name, one in wanted.lidars.items()]
        for a, b in pairs:
            requests = [
                capture_request(drive, source.parked, sensor, 0.93, source.log_path, source.scene_path)
                for drive, sensor in ((found, a), (wanted, b))
            ]
            assert requests[0] == requests[1]


def test_edits_are_applied_once_for_many_views(source: DriveSource, monkeypatch: pytest.MonkeyPatch) -> None:
    applied = []

    def counted(told: Scenario, *rest: Any) -> Any:
        applied.append(len(told.edits))
        return apply_scenario(told, *rest)

    monkeypatch.setattr(asked, "apply_scenario", counted)
    asked._newest.clear()
    for x in range(3):
        asked.edited_drive(scenario(sensors={"cameras": [{**CAMERAS[0], "fx": 100.0 + x}]}), source)
    assert applied == [3, 0, 0, 0]
    one = asked.edited_drive(scenario(edits=EDITS[:1]), source)
    assert applied[4:] == [1, 0] and "copy" not in one.actors
    # another recorded drive is another one, though it is told the same
    again = replace(source, drive=replace(source.drive, actors={}))
    assert asked.edited_drive(scenario(edits=EDITS[:1]), again).actors == {}


def test_edits_that_cannot_be_are_a_sentence_and_nothing_is_kept_of_them(source: DriveSource) -> None:
    with pytest.raises(ScenarioError, match=r'edits\[0\]\.actor: no actor "nobody"'):
        asked.edited_drive(scenario(edits=[{"type": "remove", "actor": "nobody"}]), source)
    ego = asked.edited_drive(scenario(edits=EDITS[:1]), source).world_from_ego
    assert np.abs(ego.at(0.5)[:3, 3] - source.drive.world_from_ego.at(0.5)[:3, 3]).max() > 0.5
