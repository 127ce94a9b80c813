"""Actors that some sensors do not see: what is rendered, what physics knows, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from written_street import write_street

from unisim_blender.core.errors import SimulationError
from unisim_blender.core.prepare.scenario_plan import RenderOptions
from unisim_blender.core.scenario.simulation import SimulationSpec
from unisim_blender.core.sensors.frames import CameraFrame
from unisim_blender.core.simulation.drivers import driver_named
from unisim_blender.core.simulation.rollout.loop import roll_out
from unisim_blender.core.simulation.rollout.run import finish
from unisim_blender.core.simulation.rollout.score import record_of
from unisim_blender.core.simulation.rollout.sensors import HiddenActors, SimulatedSensors
from unisim_blender.core.simulation.rollout.setup import Simulation, open_simulation

CAMERA, LIDAR, LEAD = "front_camera", "pandar64", "car-01"
OPTIONS = RenderOptions(renderer="surfel", quality="fast")


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_street(tmp_path_factory.mktemp("hidden") / "street", 4, columns=300)


def opened(log: Path, out: Path) -> Simulation:
    return open_simulation(log, out, OPTIONS, SimulationSpec(duration_s=0.3), driver_named("constant"))


@pytest.fixture(scope="module")
def simulation(log: Path, tmp_path_factory: pytest.TempPathFactory) -> Simulation:
    return opened(log, tmp_path_factory.mktemp("rolled") / "out")


def seen(simulation: Simulation, hidden: dict[str, set[str]]) -> tuple[bytes, bytes]:
    """The first image and the first sweep, as drivers get them."""
    sensors = HiddenActors(SimulatedSensors(simulation.plan, simulation.renderer, None), hidden)
    context = simulation.context
    first = [next(one for one in context.exposures if one.capture.sensor_id == name) for name in (CAMERA, LIDAR)]
    (image,), (sweep,) = sensors.render(context.drive, first)
    assert (CAMERA in sensors.unsupported) and len(sensors.unsupported) == 1
    return image.rgb.tobytes(), sweep.points.tobytes()


def test_an_actor_is_hidden_from_the_sensors_that_are_named(simulation: Simulation) -> None:
    image, sweep = seen(simulation, {})
    unseen_image, unseen_sweep = seen(simulation, {CAMERA: {LEAD}, LIDAR: {LEAD}})
    assert image != unseen_image and sweep != unseen_sweep
    assert seen(simulation, {CAMERA: {LEAD}}) == (unseen_image, sweep)
    assert seen(simulation, {LIDAR: {LEAD}}) == (image, unseen_sweep)


def test_drivers_get_confidence_where_it_was_asked_for(simulation: Simulation, tmp_path: Path) -> None:
    """The pass as it is rendered, of a frame that was rendered before, too; None where nobody asked."""
    settings = replace(simulation.plan.settings, passes=("rgb", "unsupported", "confidence"), formats=("png", "npz"))
    sensors = SimulatedSensors(replace(simulation.plan, settings=settings), simulation.renderer, tmp_path)
    context = simulation.context
    first = [next(one for one in context.exposures if one.capture.sensor_id == CAMERA)]
    for deliver in (sensors.render, sensors.read):
        (image,), _ = deliver(context.drive, first)
        shot = sensors.frames[CAMERA]
        assert isinstance(shot, CameraFrame) and shot.confidence is not None and image.confidence is not None
        np.testing.assert_array_equal(image.confidence, shot.confidence)
    assert image.confidence is not None
    assert sensors.confidence == {CAMERA: pytest.approx(image.confidence.mean())}
    assert 0 < sensors.confidence[CAMERA] < 1
    asked = replace(simulation, plan=replace(simulation.plan, settings=settings), out=tmp_path / "asked")
    asked.out.mkdir()
    record = record_of(asked, roll_out(asked))
    assert record.confidence is not None and 0 < np.mean([each for each in record.confidence if each is not None]) < 1
    plain = SimulatedSensors(simulation.plan, simulation.renderer, None)
    (image,), _ = plain.render(context.drive, first)
    assert image.confidence is None and not plain.confidence


def test_physics_knows_of_hidden_actors_and_the_scenario_renders_them(log: Path, simulation: Simulation) -> None:
    sensors = SimulatedSensors(simulation.plan, simulation.renderer, simulation.out)
    rollout = roll_out(simulation, sensors=HiddenActors(sensors, {LIDAR: {LEAD}}))
    for footprints in record_of(simulation, rollout).actors:
        assert LEAD in {one.uid for one in footprints}
    of_lidar = sum(one.capture.sensor_id == LIDAR for one in simulation.context.exposures)
    assert of_lidar and finish(simulation, rollout, OPTIONS).captures == of_lidar


@pytest.mark.parametrize(
    ("hidden", "sentence"),
    [
        ({"radar": {LEAD}}, 'there is no sensor "radar"'),
        ({LIDAR: {"nobody"}}, 'no actor "nobody" to hide from pandar64'),
    ],
)
def test_refused(simulation: Simulation, hidden: dict[str, set[str]], sentence: str) -> None:
    with pytest.raises(SimulationError, match=sentence):
        seen(simulation, hidden)


def test_nothing_hidden_is_what_the_sensors_deliver(simulation: Simulation) -> None:
    plain = SimulatedSensors(simulation.plan, simulation.renderer, None)
    context = simulation.context
    images, sweeps = plain.render(context.drive, context.exposures[:2])
    others = HiddenActors(plain, {}).render(context.drive, context.exposures[:2])
    assert all(np.array_equal(a.rgb, b.rgb) for a, b in zip(images, others[0], strict=True))
    assert all(np.array_equal(a.points, b.points) for a, b in zip(sweeps, others[1], strict=True))
