"""A car that stands in the lane, seen by both sensors, by one, or by none: the example stack stops where it can.

The detectors are those below the folder ``PERCEPTION_WEIGHTS`` (`make test-perception` trains them); without it nothing runs.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[3]))

from stopped_car import CAMERA, LIDAR, write_scenario, write_sparse_street

from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_blender.core.scenario.simulation import SimulationSpec
from unisim_blender.core.simulation.drivers.driver import DriverKind
from unisim_blender.core.simulation.rollout.loop import roll_out
from unisim_blender.core.simulation.rollout.score import scores_of
from unisim_blender.core.simulation.rollout.sensors import HiddenActors, SimulatedSensors
from unisim_blender.core.simulation.rollout.setup import OpenedScenario, open_scenario
from unisim_street.street import build_street

WEIGHTS = os.environ.get("PERCEPTION_WEIGHTS")
pytestmark = [
    pytest.mark.perception,
    pytest.mark.skipif(not WEIGHTS, reason="PERCEPTION_WEIGHTS names no detectors: make test-perception"),
]
SEED = 3


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> tuple[OpenedScenario, str]:
    folder = tmp_path_factory.mktemp("stopped")
    log = write_sparse_street(folder / "street", SEED)
    car = write_scenario(log, build_street(SEED, 66, 320, 180), folder / "stopped.json")
    return open_scenario(folder / "stopped.json", RenderOptions(renderer="surfel", quality="fast")), car


def driven(
    opened: tuple[OpenedScenario, str], out: Path, hidden: tuple[str, ...], duration_s: float | None
) -> dict[str, Any]:
    """The scores of a rollout in which some sensors do not see the car, with its last speed."""
    from examples.perception.driver import perception

    scenario, car = opened
    simulation = scenario.simulation(
        SimulationSpec(duration_s=duration_s), DriverKind("perception", "", perception), out
    )
    out.mkdir()
    sensors = SimulatedSensors(simulation.plan, simulation.renderer, None)
    rollout = roll_out(simulation, sensors=HiddenActors(sensors, {name: {car} for name in hidden}))
    scores = scores_of(simulation, rollout)
    met = [one["actor"] for one in scores["collision"]["contacts"]]
    return {"met": met, "hits": car in met, "speed_m_s": rollout.end.ego.speed_m_s}


@pytest.mark.parametrize("hidden", [(), (CAMERA,), (LIDAR,)], ids=["both", "LiDAR alone", "camera alone"])
def test_it_stops_where_a_sensor_sees_the_car(
    opened: tuple[OpenedScenario, str], tmp_path: Path, hidden: tuple[str, ...]
) -> None:
    found = driven(opened, tmp_path / "out", hidden, None)
    assert not found["hits"] and found["speed_m_s"] < 1.0, found


def test_it_hits_a_car_that_no_sensor_sees(opened: tuple[OpenedScenario, str], tmp_path: Path) -> None:
    """Physics have it all the same."""
    found = driven(opened, tmp_path / "out", (CAMERA, LIDAR), 4.0)
    assert found["hits"] and found["speed_m_s"] > 5.0, found
