"""Lamps in edited scenarios: as the truth of the edited street has them, and all else to the bit as without the edit."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from written_street import write_recipe

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.geometry import Trajectory, invert_pose
from unisim_blender.core.geometry import quaternion_from_matrix as turn
from unisim_blender.core.prepare.scenario import prepare_scenario
from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario
from unisim_blender.core.render.captures import render_capture
from unisim_blender.core.render.frame_lamps import with_lamps
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.frames import CameraFrame
from unisim_blender.core.world.drive import Actor, Appearance, Camera, CameraModel, RollingShutter
from unisim_blender.core.world.encoding import decode_state, encode_state
from unisim_blender.core.world.lamps import ActorLamp, LampPatch

FRAME = 9
PASSES = ("rgb", "depth", "instance")
OTHERWISE: list[dict[str, Any]] = [
    {"type": "lamp", "actor": "traffic-light", "state": "green"},
    {"type": "lamp", "actor": "car-01", "lamp": "red", "state": "off", "from_s": 0.5, "to_s": 1.2},
]


@pytest.fixture(scope="module")
def log_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    recipe: dict[str, Any] = {"seed": 0, "frames": 20, "width": 480, "height": 270, "lamps": True}
    return write_recipe(tmp_path_factory.mktemp("lamps") / "log", **recipe)


def scenario(log_path: Path, edits: list[dict[str, Any]]) -> Path:
    document = {"format": "unisim-scenario", "version": 1, "name": "lamps", "log": str(log_path), "edits": edits}
    path = log_path.parent / f"{len(edits)}.json"
    path.write_text(json.dumps(document))
    return path


def test_an_edited_lamp_is_shown_as_it_truly_is(log_path: Path) -> None:
    frames: dict[tuple[int, str], CameraFrame] = {}
    options = RenderOptions(frames=str(FRAME), passes=PASSES)
    cases: list[list[dict[str, Any]]] = [[], OTHERWISE]
    for edits in cases:
        for name in ("street", "surfel"):
            plan, _ = plan_scenario(scenario(log_path, edits), replace(options, renderer=name))
            renderer = plan.recipe.load()
            moment = plan.moments[0]
            frame = render_capture(renderer, plan.captures, moment.cameras[0], PASSES)
            assert isinstance(frame, CameraFrame)
            frames[len(edits), name] = frame
    time_s, camera = plan.drive.cameras["front_camera"].time_s[FRAME], plan.drive.cameras["front_camera"]
    lidar = plan.drive.lidars["pandar64"]
    true, shown, plain = frames[2, "street"].rgb, frames[2, "surfel"], frames[0, "surfel"]
    lamps = np.abs(true - frames[0, "street"].rgb).max(-1) > 0.02
    assert lamps.sum() > 60
    error, before = (float(((image.rgb - true)[lamps] ** 2).mean()) for image in (shown, plain))
    assert 10 * np.log10(before / error) > 3.0
    assert plain.instance is not None and shown.instance is not None
    assert plain.depth_m is not None and shown.depth_m is not None
    actors = [plain.instances.index(uid) + 1 for uid in ("car-01", "traffic-light")]
    changed = (shown.rgb != plain.rgb).any(-1)
    assert 0 < changed.sum() < 800 and np.isin(plain.instance[changed], actors).all()
    np.testing.assert_array_equal(shown.depth_m, plain.depth_m)
    np.testing.assert_array_equal(shown.instance, plain.instance)

    state = plan.captures.states.state(time_s - 0.2, time_s + 0.1)
    bare = replace(state, actors=tuple(replace(actor, lamps=()) for actor in state.actors))
    assert decode_state(encode_state(state)).digest == state.digest != bare.digest
    region = Region(left=200, top=100, right=420, bottom=180)
    part = renderer.render(state, camera, time_s, PASSES, region)
    np.testing.assert_array_equal(part.rgb, renderer.render(state, camera, time_s, PASSES).rgb[100:180, 200:420])
    sweeps = [renderer.render(one, lidar, lidar.time_s[FRAME], seed=(1,)) for one in (state, bare)]
    for name in ("depth_m", "intensity", "returned"):
        np.testing.assert_array_equal(*(getattr(sweep, name) for sweep in sweeps))


@pytest.mark.parametrize(
    ("edit", "said"),
    [
        ({"actor": "car-02", "state": "on"}, 'actor: the log shows "car-02" in one state alone; actors with lamps that '),
        ({"actor": "car-01", "state": "on"}, 'lamp: "car-01" has several lamps (there are amber left, red)'),
        ({"actor": "car-01", "lamp": "blue", "state": "on"}, 'lamp: "car-01" has no such lamp'),
        ({"actor": "traffic-light", "state": "amber"}, 'the log does not show "amber" of "traffic-light"'),
        ({"actor": "traffic-light", "state": "red", "from_s": 9}, "from_s: time 9 s lies outside the log"),
        ({"actor": "traffic-light", "state": "red", "from_s": 1, "to_s": 1}, "to_s: 1 must lie after from_s, 1"),
    ],
)  # fmt: skip
def test_what_the_log_does_not_show_is_said(log_path: Path, edit: dict[str, Any], said: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        prepare_scenario(scenario(log_path, [{"type": "lamp", **edit}]))
    assert said in str(caught.value)


def test_before_and_after_an_edit_a_lamp_is_as_recorded() -> None:
    lamp = ActorLamp("red", ("off", "on"), np.array([0.0, 1.0, 2.0]), np.array([0, 1, 0]), ())
    edited = lamp.switched("off", 0.5, 1.5).switched("on", 1.75, np.inf)
    states = {-1.0: 0, 0.7: 0, 1.2: 0, 1.6: 1, 1.8: 1, 2.5: 1}
    assert {time_s: int(edited.at(time_s).shown[0]) for time_s in states} == states
    assert int(lamp.switched("on", 0.0, 0.5).at(-1.0).shown[0]) == 0
    assert int(lamp.switched("on", -np.inf, 0.5).at(-1.0).shown[0]) == 1


def test_a_patch_is_on_the_face_that_a_ray_enters_by() -> None:
    size = np.array([4.0, 2.0, 1.5])
    colours = np.zeros((2, 2, 2, 3), np.float32)
    colours[1] = 1.0
    patch = LampPatch(0, -1, np.array([0.2, 0.1]), 0.1, colours, np.ones((2, 2), np.float32))
    origins = np.array([[-9.0, 0.3, 0.2], [-9.0, 0.3, 0.6], [9.0, 0.3, 0.2], [-1.0, 9.0, 0.2]])
    directions = np.array([[1.0, 0, 0], [1.0, 0, 0], [-1.0, 0, 0], [0, -1.0, 0]])
    drawn, share = patch.drawn(origins, directions, size, 1)
    np.testing.assert_allclose(share[:, 0], [1, 0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(drawn[0], 1.0, atol=1e-6)


def test_pixels_of_cells_have_rays_of_their_own() -> None:
    """Of part of the cells, too, pixels are the ones that a patch covers where the camera itself projects it."""
    up, mount = 3, np.array([[0, 0, 1.0, 0], [-1.0, 0, 0, 0], [0, -1.0, 0, 1.5], [0, 0, 0, 1.0]])
    shutter = RollingShutter(0.03)
    model = CameraModel(60, 42, 50.0, 50.0, 30.0, 21.0, shutter)
    moving = Trajectory(np.array([0.0, 1.0]), np.array([[0.0, 0, 1.5], [9.0, 0, 1.5]]), np.tile(turn(mount), (2, 1)))
    camera = Camera("front", model, moving, {0: 0.5})
    patch = LampPatch(0, -1, np.full(2, -0.5), 0.5, np.ones((2, 2, 2, 3), np.float32), np.ones((2, 2), np.float32))
    lamp = ActorLamp("red", ("off", "on"), np.zeros(1), np.ones(1, np.int64), (patch,))
    where = Trajectory(np.zeros(1), np.array([[15.0, 0.4, 1.2]]), np.array([[1.0, 0, 0, 0]]))
    actor = Actor("car", "Car", np.full(3, 2.0), where, -1.0, 2.0, False, Appearance("car"), lamps=(lamp,))
    u, v = pixel_grid(model, up)
    shown = []
    for cells in ((slice(None), slice(None)), (slice(2, 12), slice(3, 15))):
        rays = camera_rays(camera, 0.5, u[cells], v[cells])
        pending = SimpleNamespace(camera=camera, time_s=0.5, tracer=SimpleNamespace(upsample=up), lit={1: actor})
        bound = SimpleNamespace(exposed=lambda colours, *_: colours)
        maps = {"instance": np.ones(rays.time_s.size, np.int64)}
        black = np.zeros((rays.time_s.shape[0] * up, rays.time_s.shape[1] * up, 3), np.float32)
        shown.append(with_lamps(pending, bound, black, rays, maps))  # type: ignore[arg-type]
    np.testing.assert_array_equal(shown[0][6:36, 9:45], shown[1])
    y, x = np.nonzero(shown[0][..., 0] > 0.5)
    line_s = 0.5 + 0.03 * ((y.mean() + 0.5) / 42 - 0.5)
    at = invert_pose(camera.world_from_camera.at(line_s)) @ [14.0, 0.4, 1.2, 1.0]
    np.testing.assert_allclose([x.mean() + 0.5, y.mean() + 0.5], np.stack(model.project(at[:3])[:2]), atol=0.5)
    assert len(y) > 15
