"""Scenarios and rigs with faults."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from turning_drive import turning_drive

from inputs.promise import Property, Reader
from inputs.scenes.mesh_files import mesh_arrays
from inputs.strategies import Input, inputs_of
from inputs.views import json_text, npz_file
from unisim_blender.core.rigs import built_in_rigs, read_rig
from unisim_blender.core.scenario import apply_scenario, load_scenario
from unisim_blender.core.world.drive import Actor

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")

KEYS = [{"time_s": 0.2, "position": [1, 2, 3], "yaw_deg": 0}, {"frame": 6, "position": [5, 2, 3], "yaw_deg": 90}]
STANDS = {"position": [1.0, 2.0, 0.5], "yaw_deg": 20.0}
SCENARIO: dict[str, Any] = {
    "format": "unisim-scenario", "version": 1, "name": "all", "log": "log", "frames": {"start": 0, "stop": 9, "step": 2},
    "boxes": {"bin": {"position": [1, 1, 1], "size_m": [1, 2, 3], "quaternion_wxyz": [1, 0, 0, 0]}},
    "sensors": {
        "cameras": [
            {"id": "front", "width": 32, "shutter": {"duration_s": 0.01}},
            {"id": "side", "like": "front", "mount": STANDS},
        ],
        "lidars": [
            {"id": "top", "mount_offset": {"position": [0, 0, 1], "pitch_deg": 3}},
            {"id": "roof", "elevation_deg": [1, 0, -1], "columns": 90, "trajectory": KEYS},
        ],
    },
    "edits": [
        {"type": "duplicate", "actor": "car", "id": "a", "offset_m": [1, 0, 0], "time_offset_s": 0.1},
        {"type": "duplicate", "actor": "late", "id": "b", "trajectory": KEYS, "outside": "hold"},
        {"type": "insert", "actor": "bus", "id": "c", "scene": "other", "pose": STANDS, "present": {"start_s": 0.1}},
        {"type": "insert_mesh", "mesh": "thing.npz", "id": "d", "label": "Cone", "trajectory": KEYS},
        {"type": "ego_body", "mesh": "thing.npz", "id": "e", "mount": STANDS},
        {"type": "move", "actor": "van", "trajectory": KEYS},
        {"type": "retime", "actor": "car", "map": [[0, 0], [0.5, 0.2], [1, 0.9]]},
        {"type": "retime", "actor": "late", "speed": 0.5, "pivot_s": 0.4, "offset_s": 0.1},
        {"type": "swap", "actor": "van", "appearance": "car"},
        {"type": "scale", "actor": "car", "factors": [1.2, 1.0, 0.9]},
        {"type": "copy_static", "box": "bin", "id": "f", "target": STANDS},
        {"type": "remove_static", "box": "bin"},
        {"type": "remove", "actor": "late"},
        {"type": "ego", "shift": [{"time_s": 0.1, "left_m": 0}, {"frame": 8, "left_m": 1.5}]},
        {"type": "ego", "trajectory": KEYS},
    ],
    "outputs": {"passes": ["rgb", "depth"], "formats": ["png", "npz"], "width": 64, "quality": "fast",
    "contact_shadows": True, "fill": "texture", "detail": True},
}  # fmt: skip


def other_scene(path: Path) -> dict[str, Actor]:
    van = turning_drive().actors["van"]
    return {"bus": replace(van, uid="bus", size_m=np.array([11.0, 2.5, 3.0]))}


def scenario_reader(folder: Path) -> Reader:
    """A scenario of every edit, and its edits applied to a drive."""
    drive = turning_drive()
    mesh = npz_file(mesh_arrays(trimesh.creation.box([2, 1, 1])))
    whole = {"scenario.json": json_text(SCENARIO)}
    (folder / "thing.npz").write_bytes(mesh)

    def read() -> object:
        return apply_scenario(load_scenario(folder / "scenario.json"), drive, other_scene)

    return Reader(folder, whole, read, inputs_of(whole, {"scenario.json": ["json"]}), ("scenario.json",))


def rig_reader(folder: Path) -> Reader:
    """A rig of every member."""
    document = json.loads(built_in_rigs()[0].read_text())
    whole = {"rig.json": json_text(document)}
    return Reader(
        folder, whole, lambda: read_rig(folder / "rig.json"), inputs_of(whole, {"rig.json": ["json"]}), ("rig.json",)
    )


SCENARIOS, RIGS = Property(scenario_reader), Property(rig_reader)


@given(SCENARIOS.inputs)
def test_scenarios(changes: Input) -> None:
    SCENARIOS.check(changes)


@given(RIGS.inputs)
def test_rigs(changes: Input) -> None:
    RIGS.check(changes)
