"""The renderer ``street``: at recorded states what was recorded, elsewhere what is there."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drive_frames import DriveFrames
from written_street import write_street

from unisim_blender.core.errors import LogError
from unisim_blender.core.evaluation.metrics import psnr
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import invert_pose, points_in_box
from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.scenario.simulation import SimulationSpec
from unisim_blender.core.simulation.drivers import driver_named
from unisim_blender.core.simulation.rollout.loop import roll_out
from unisim_blender.core.simulation.rollout.run import finish
from unisim_blender.core.simulation.rollout.score import occupancy_of
from unisim_blender.core.simulation.rollout.sensors import SimulatedSensors
from unisim_blender.core.simulation.rollout.setup import open_scenario, open_simulation
from unisim_street.exact_street import StreetRenderer
from unisim_street.street import build_street, recipe_document
from unisim_street.truth import truth_camera, truth_lidar

CAMERA, LIDAR, LEAD, FRAMES = "front_camera", "pandar64", "car-01", 3
OPTIONS = RenderOptions(renderer="street")
STREET = build_street(3, FRAMES, 64, 36, (CAMERA,), 0.0)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = write_street(tmp_path_factory.mktemp("street") / "log", FRAMES, columns=300)
    (out / "street.json").write_text(json.dumps(recipe_document(STREET.recipe)))
    return out


@pytest.fixture(scope="module")
def renderer(log: Path) -> DriveFrames:
    plan, _ = plan_scenario(log, OPTIONS)
    return DriveFrames(plan.recipe.load(), plan.drive)


def test_a_recorded_frame_is_what_was_recorded(log: Path, renderer: DriveFrames) -> None:
    recorded = open_log(log)
    image = renderer.camera(CAMERA, 1, ("rgb", "depth", "instance", "unsupported"))
    truth = truth_camera(STREET, recorded.drive, CAMERA, 1)
    assert psnr(recorded.image(CAMERA, 1) / np.float32(255), image.rgb) > 33  # it is a JPEG
    for name in ("rgb", "depth_m", "z_depth_m"):
        np.testing.assert_array_equal(getattr(image, name), getattr(truth, name))
    uids = np.array(["", *image.instances]), np.array(["", *truth.instances])
    assert truth.instance is not None and image.instance is not None
    assert (uids[0][image.instance] == uids[1][truth.instance]).all() and (image.instance > 0).any()
    assert image.normal is None and image.unsupported is not None and not image.unsupported.any()
    part = renderer.camera(CAMERA, 1, ("rgb", "depth"), region=Region(10, 5, 40, 30))
    np.testing.assert_array_equal(part.rgb, image.rgb[5:30, 10:40])
    assert part.depth_m is not None and image.depth_m is not None
    np.testing.assert_array_equal(part.depth_m, image.depth_m[5:30, 10:40])
    sweep, grid = renderer.lidar(LIDAR, 1), recorded.sweep_grid(LIDAR, 1)
    np.testing.assert_array_equal(sweep.returned, grid.returned)
    on = grid.returned
    np.testing.assert_allclose(sweep.depth_m[on], grid.depth_m[on], atol=1e-4)
    np.testing.assert_allclose(sweep.intensity[on], grid.intensity[on], atol=1e-6)


def test_its_tracer_renders_images_as_any_other(log: Path, renderer: DriveFrames) -> None:
    """A ray a pixel through the pixel's middle: the street's own image of one sample."""
    street = renderer.renderer
    assert isinstance(street, StreetRenderer)
    passes = ("rgb", "depth", "normal", "instance", "opacity", "unsupported")
    image = DriveFrames(Renderer(street.backend), renderer.drive).camera(CAMERA, 1, passes)
    truth = truth_camera(STREET, open_log(log).drive, CAMERA, 1, samples=1)
    assert psnr(truth.rgb, image.rgb) > 40
    for name in ("depth_m", "opacity"):
        np.testing.assert_allclose(getattr(image, name), getattr(truth, name), rtol=1e-6)
    assert image.instance is not None and truth.instance is not None
    uids = np.array(["", *image.instances]), np.array(["", *truth.instances])
    assert (uids[0][image.instance] == uids[1][truth.instance]).all() and (image.instance > 0).any()
    assert image.normal is not None and truth.normal is not None
    np.testing.assert_allclose(image.normal, truth.normal, atol=1e-5)
    assert image.unsupported is not None and not image.unsupported.any()


def test_a_moved_car_is_where_it_was_moved(log: Path, tmp_path: Path) -> None:
    """In the image and in the sweep; and it is where it was no longer."""
    before = open_log(log).drive.actors[LEAD]
    size, place = before.size_m, [9.0, 2.5, float(before.size_m[2]) / 2]
    edit = {"type": "move", "actor": LEAD, "pose": {"position": place, "yaw_deg": 20.0}}
    document = {"format": "unisim-scenario", "version": 1, "name": "moved", "log": str(log), "edits": [edit]}
    (tmp_path / "moved.json").write_text(json.dumps(document))
    plan, prepared = plan_scenario(tmp_path / "moved.json", OPTIONS)
    made, drive = DriveFrames(plan.recipe.load(), plan.drive), prepared.edited
    image, sweep = made.camera(CAMERA, 1, ("rgb", "instance")), made.lidar(LIDAR, 1)
    camera = drive.cameras[CAMERA]
    x, y, z = (invert_pose(camera.world_from_camera.at(camera.time_s[1])) @ [*place, 1.0])[:3]
    u, v = camera.model.fx * x / z + camera.model.cx, camera.model.fy * y / z + camera.model.cy
    assert image.instance is not None
    assert image.instances[image.instance[int(v), int(u)] - 1] == LEAD
    points = (sweep.origins + sweep.directions * sweep.depth_m[..., None].astype(np.float64))[sweep.returned]
    hits = points_in_box(points, drive.actors[LEAD].world_from_actor.at(0.1), size + 0.02)
    assert hits.sum() > 20
    assert (sweep.instance[sweep.returned][hits] == sweep.instances.index(LEAD) + 1).all()
    assert not points_in_box(points, before.world_from_actor.at(0.1), size - [0, 0, 0.3]).any()
    np.testing.assert_array_equal(image.rgb, truth_camera(STREET, drive, CAMERA, 1).rgb)
    np.testing.assert_array_equal(sweep.depth_m, truth_lidar(STREET, drive, LIDAR, 1).depth_m)


def test_a_rollout_delivers_the_street(log: Path, tmp_path: Path) -> None:
    """The log driven again delivers what was recorded; actors that a state lacks are not there."""
    simulation = open_scenario(log, OPTIONS).simulation(SimulationSpec(duration_s=0.2), driver_named("log"), tmp_path)
    context = simulation.context
    sensors = SimulatedSensors(simulation.plan, simulation.renderer, None)
    shots = [one for one in context.exposures if one.capture.frame == 1]
    (image,), (sweep,) = sensors.render(context.drive, shots)
    recorded = open_log(log)
    assert psnr(recorded.image(CAMERA, 1) / np.float32(255), image.rgb / np.float32(255)) > 33
    assert len(sweep.points) == recorded.sweep_grid(LIDAR, 1).returned.sum()
    assert sensors.unsupported == {CAMERA: 0.0}
    gone = replace(context.drive, actors={})
    (empty,), _ = sensors.render(gone, [one for one in shots if one.capture.sensor_id == CAMERA])
    assert np.mean(np.any(empty.rgb != image.rgb, -1)) > 0.05
    ego = context.drive.world_from_ego.at(0.1)[:3, 3]
    assert context.heights(ego[None] + [[0.0, 0.0, 1.0]])[0] == pytest.approx(1.0, abs=0.15)
    # fronts on the left, which rays along y meet, and the air under the vehicle
    fronts = recorded.sweep(LIDAR, 1).points
    fronts = fronts[(fronts[:, 1] > 6) & (fronts[:, 2] > 2)][::20]
    occupied = occupancy_of(simulation)
    assert occupied(fronts).mean() > 0.5 and not occupied(ego[None] + [[0.0, 0.0, 1.0]]).any()


def test_a_rollouts_scenario_renders_what_its_driver_saw(log: Path, tmp_path: Path) -> None:
    spec = SimulationSpec(duration_s=0.2, actors={"*": {"type": "idm"}})
    simulation = open_simulation(log, tmp_path / "out", OPTIONS, spec, driver_named("constant"))
    rollout = roll_out(simulation)
    report = finish(simulation, rollout, OPTIONS)
    assert report.captures == 0 and report.captures_kept == len(simulation.context.exposures) > 1


def test_refused(log: Path, tmp_path: Path) -> None:
    other = write_street(tmp_path / "other", 2, columns=60)
    with pytest.raises(LogError, match=r"other: is no procedural street, it has no street\.json"):
        plan_scenario(other, OPTIONS)
    recipe = {**recipe_document(STREET.recipe), "engine": "cycles"}
    (other / "street.json").write_text(json.dumps(recipe))
    with pytest.raises(LogError, match="was drawn by the engine cycles"):
        plan_scenario(other, OPTIONS)
