"""A vehicle that stands: its sensors stand to the bit, parts of their frames are kept, and the bytes are those of whole frames."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rendered_folder import captures
from written_street import write_street

from unisim_blender.core import native
from unisim_blender.core.cli.main import run
from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_blender.core.scenario.simulation.document import SimulationSpec
from unisim_blender.core.simulation.drivers.driver import DriverKind
from unisim_blender.core.simulation.observations import Observation, Setup
from unisim_blender.core.simulation.rollout.base import SCENARIO_NAME
from unisim_blender.core.simulation.rollout.opening import open_simulation
from unisim_blender.core.simulation.rollout.run import Done, complete
from unisim_blender.core.simulation.rollout.setup import Simulation
from unisim_blender.core.simulation.step import step
from unisim_blender.core.simulation.vehicle.actions import Control

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT / "tools"))

from byte_checks.inputs import write_inputs  # noqa: E402

SMALL = {"quality": "fast", "width": 200}
STILL = {
    "id": "still",
    "width": 96,
    "height": 54,
    "horizontal_fov_deg": 80,
    "shutter": {"duration_s": -0.05, "reference": 0.5, "axis": "columns"},
    "trajectory": [{"time_s": 0.0, "position": [4.0, -8.0, 2.6], "yaw_deg": 5, "pitch_deg": -8}],
}
"""A camera at the roadside that stands all the time."""
PULLS_OUT = {
    "type": "scripted",
    "keys": [
        {"time_s": 0.3, "speed_m_s": 0.0},
        {"time_s": 0.5, "speed_m_s": 6.0},
        {"time_s": 0.6, "speed_m_s": 0.0},
    ],
}
"""Of an actor that stands in the recording."""


class Braking:
    """Stands after a few tenths of a second."""

    def __init__(self, setup: Setup) -> None:
        self.setup = setup

    def drive(self, seen: Observation) -> Control:
        return Control(-50.0, 0.0)

    def close(self) -> None: ...


def opened(folder: Path, name: str, out: Path, parked: str, **more: Any) -> Simulation:
    """A scenario of `byte_checks` in which the vehicle brakes and a parked actor pulls out."""
    document = json.loads((folder / f"{name}.json").read_text())
    document["outside"] = {"actors": "continue", "ego": "continue"}
    document["outputs"]["formats"] = ["png", "exr", "npz", "labels"]
    # decoders look far beside actors of other scenes: nearly all of a small image is rendered
    document["edits"] = [edit for edit in document["edits"] if edit.get("id") != "guest"]
    document["sensors"]["cameras"] = [document["sensors"]["cameras"][0], STILL]
    document["simulation"] = {
        "duration_s": 0.7,
        "vehicle": {"max_deceleration_m_s2": 50.0, "acceleration_lag_s": 0.0},
        "actors": {"*": {"type": "replay"}, parked: PULLS_OUT},
        **more,
    }
    (folder / f"{name}-simulated.json").write_text(json.dumps(document))
    kind = DriverKind("braking", "brakes", Braking)
    return open_simulation(folder / f"{name}-simulated.json", out, RenderOptions(**SMALL), SimulationSpec(), kind)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("standing")
    log = write_street(folder / "street", 4, columns=300)
    write_inputs(folder, ROOT / "sample" / "scene", log)
    return folder


@pytest.fixture(
    scope="module",
    params=[
        pytest.param(("busy", "car-13"), marks=pytest.mark.skipif(native.library() is None, reason="torch is exact")),
        ("log-edited", "car-13"),
    ],
)
def rolled(inputs: Path, tmp_path_factory: pytest.TempPathFactory, request: pytest.FixtureRequest) -> tuple[Path, Done]:
    out = tmp_path_factory.mktemp("rolled") / "out"
    simulation = opened(inputs, request.param[0], out, request.param[1])
    return out, complete(simulation, RenderOptions(**SMALL))


def test_its_bytes_are_those_of_whole_frames(rolled: tuple[Path, Done], tmp_path: Path) -> None:
    """Which the scenario's rendering makes: one frame alone knows of no other."""
    out, done = rolled
    assert done.anew == 0, "captures are others in the rollout's scenario"
    asked = ["--out", str(tmp_path / "again"), "--jobs", "1", "--quality", "fast", "--width", "200"]
    assert run(["render", str(out / SCENARIO_NAME), *asked]) == 0
    told = captures(out)
    assert len(told) > 40 and told == captures(tmp_path / "again")


def test_only_what_moved_is_rendered(rolled: tuple[Path, Done]) -> None:
    manifest = json.loads((rolled[0] / "manifest.json").read_bytes())
    rays: dict[str, list[int]] = {}
    for moment in sorted(manifest["frames"]):
        for name, told in manifest["frames"][moment].items():
            if name != "labels":
                rays.setdefault(name, []).append(told["samples"]["rays"])
    print(rays)
    for name in ("camera/front_camera", "camera/still", "lidar/few"):
        assert min(rays[name]) < 0.5 * max(rays[name]), name
