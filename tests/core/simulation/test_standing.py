"""A vehicle that stands: its sensors stand to the bit, parts of frames are kept, and its scenario has the same bytes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from rendered_folder import captures
from written_street import write_street

from unisim_blender.core.cli.main import run
from unisim_blender.core.geometry import Trajectory
from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_blender.core.scenario.simulation import SimulationSpec
from unisim_blender.core.sensors.rays import exposure_window
from unisim_blender.core.simulation.drivers.driver import DriverKind, DriverSetup, Observation
from unisim_blender.core.simulation.edits import edits_of
from unisim_blender.core.simulation.rollout.run import FinishedRollout, complete
from unisim_blender.core.simulation.rollout.setup import Simulation, open_simulation
from unisim_blender.core.simulation.rollout.steps import SCENARIO_NAME
from unisim_blender.core.simulation.step import step
from unisim_blender.core.simulation.vehicle.actions import Control
from unisim_blender.core.world.drive import Camera, Drive, Lidar

SMALL = RenderOptions(renderer="surfel", quality="fast")
PARKED = "car-13"
PULLS_OUT = {
    "type": "scripted",
    "keys": [
        {"time_s": 0.3, "speed_m_s": 0.0},
        {"time_s": 0.5, "speed_m_s": 6.0},
        {"time_s": 0.6, "speed_m_s": 0.0},
    ],
}
"""Of an actor that stands in the recording."""
BRAKING = Control(-50.0, 0.1)


class Braking:
    """Stands after two tenths of a second."""

    def __init__(self, setup: DriverSetup) -> None:
        self.setup = setup

    def drive(self, seen: Observation) -> Control:
        """Brake."""
        return BRAKING

    def close(self) -> None:
        """Do nothing."""


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_street(tmp_path_factory.mktemp("standing") / "street", 4, columns=120)


def opened(log: Path, out: Path, duration_s: float) -> Simulation:
    """A vehicle that brakes, and a parked car that pulls out."""
    document = {
        "format": "unisim-scenario",
        "version": 1,
        "name": "standing",
        "log": str(log),
        "edits": [],
        "outside": {"actors": "continue", "ego": "continue"},
        "outputs": {"passes": ["rgb", "depth", "instance", "unsupported"], "formats": ["png", "exr", "npz", "labels"]},
        "simulation": {
            "duration_s": duration_s,
            "vehicle": {"max_deceleration_m_s2": 50.0, "acceleration_lag_s": 0.0},
            "actors": {"*": {"type": "auto"}, PARKED: PULLS_OUT},
        },
    }
    (log.parent / "standing.json").write_text(json.dumps(document))
    kind = DriverKind("braking", "brakes", Braking)
    return open_simulation(log.parent / "standing.json", out, SMALL, SimulationSpec(), kind)


@pytest.fixture(scope="module")
def rolled(log: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, FinishedRollout]:
    out = tmp_path_factory.mktemp("rolled") / "out"
    return out, complete(opened(log, out, 0.9), SMALL)


def test_its_bytes_are_those_of_whole_frames(rolled: tuple[Path, FinishedRollout], tmp_path: Path) -> None:
    """Which the scenario's rendering makes, though its parked car stands at first."""
    out, done = rolled
    assert done.anew == 0, "captures are others in the rollout's scenario"
    assert run(["render", str(out / SCENARIO_NAME), "--out", str(tmp_path), "--jobs", "1", "--renderer", "surfel"]) == 0
    told = captures(out)
    assert len(told) > 30 and told == captures(tmp_path)


def test_only_what_moved_is_rendered(rolled: tuple[Path, FinishedRollout]) -> None:
    manifest = json.loads((rolled[0] / "manifest.json").read_bytes())
    rays: dict[str, list[int]] = {}
    for moment in sorted(manifest["frames"]):
        for name, told in manifest["frames"][moment].items():
            if name != "labels":
                rays.setdefault(name, []).append(told["samples"]["rays"])
    for name in ("camera/front_camera", "lidar/pandar64"):
        assert min(rays[name]) < 0.7 * rays[name][0], name


def trajectory_of(drive: Drive, name: str) -> Trajectory:
    """A sensor's."""
    return drive.cameras[name].world_from_camera if name in drive.cameras else drive.lidars[name].world_from_lidar


def test_sensors_stand_with_the_vehicle_to_the_bit(log: Path, tmp_path: Path) -> None:
    """Long after the recording, too, and in the whole drive as in each step's."""
    simulation = opened(log, tmp_path / "out", 3.0)
    context, world, found = simulation.context, simulation.begin, {}
    keys = {key.time_s: key for key in world.ego_keys}
    moved = simulation.scenario_drive
    while world.time_us < context.stop_us:
        before, world = world, step(world, BRAKING, context)
        keys |= {key.time_s: key for key in world.ego_keys}
        drive = moved.drive_at(world)
        for one in context.ended(before.time_us, world.time_us):
            name = one.capture.sensor_id
            sensor: Camera | Lidar = drive.cameras[name] if name in drive.cameras else drive.lidars[name]
            window, near = exposure_window(sensor, one.capture.time_s(sensor)), moved.drive_at(world, one.start_us)
            part = trajectory_of(drive, name).between(*window)
            assert trajectory_of(near, name).between(*window).content() == part.content()
            for uid, actor in near.actors.items():
                wanted = drive.actors[uid].world_from_actor.between(*window)
                assert actor.world_from_actor.between(*window).content() == wanted.content(), uid
            found[name, one.start_us] = window, part
    whole = moved.with_edits(edits_of(moved, tuple(keys[time_s] for time_s in sorted(keys)), {}, frozenset(), {}))
    for (name, _), (window, part) in found.items():
        assert trajectory_of(whole, name).between(*window).content() == part.content(), (name, window)
    stopped = min(time_s for time_s, key in keys.items() if key.position_m == world.ego_keys[-1].position_m)
    assert 0.1 < stopped < 0.5
    for name in ("front_camera", "pandar64"):
        standing = [
            one.at(np.linspace(*window, 9))
            for (own, _), (window, one) in found.items()
            if own == name and window[0] > stopped
        ]
        assert len(standing) > 20 and (np.concatenate(standing) == standing[0][0]).all()
