"""Pixels and beams that cannot differ between two states, and frames of standing sensors that reuse them: they have the
bits of whole frames, on trained scenes and on surfels."""

from __future__ import annotations

import json
import sys
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drive_frames import DriveFrames
from written_street import write_street

from unisim_blender.core import native
from unisim_blender.core.geometry import Trajectory
from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario
from unisim_blender.core.render import recorded_depth, traced_planes
from unisim_blender.core.render.changes import (
    ChangedActor,
    RenderedState,
    changed_actors,
    changed_beams,
    changed_regions,
    joined_where_cheaper,
    standing_pose,
)
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.reuse import FrameReuse
from unisim_blender.core.render.visibility import Reach
from unisim_blender.core.sensors.frames import CAMERA_PASSES, CameraFrame, LidarFrame
from unisim_blender.core.world.captures import Capture
from unisim_blender.core.world.drive import Box, Drive
from unisim_blender.core.world.weather import WeatherKeys

ROOT = Path(__file__).parents[3]
sys.path.insert(0, str(ROOT / "tools"))

from byte_checks.inputs import FEW_BEAMS, write_inputs  # noqa: E402

PLACE = [{"time_s": 0.0, "position": [4.0, -7.0, 2.6], "yaw_deg": 12, "pitch_deg": -8}]
STILL = {
    "id": "still",
    "width": 160,
    "height": 90,
    "horizontal_fov_deg": 80,
    "shutter": {"duration_s": -0.05, "reference": 0.5, "axis": "columns"},
    "trajectory": PLACE,
}
BEAMS = {**{name: value for name, value in FEW_BEAMS.items() if name != "mount"}, "id": "beams", "trajectory": PLACE}
FOG = WeatherKeys({"visibility_m": ((0.0, 60.0),)})
WET = WeatherKeys({"wetness": ((0.0, 0.5),)})
STEADY = WeatherKeys({**FOG.keys, "snow_mm_h": ((0.0, 2.0),)})
TIMES_US = (100_000, 150_000, 200_000, 290_000, 340_000)


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kept")
    write_inputs(folder, ROOT / "sample" / "scene", write_street(folder / "street", 4, columns=300))
    return folder


@pytest.fixture(
    scope="module",
    params=[
        pytest.param("busy", marks=pytest.mark.skipif(native.library() is None, reason="plain torch keeps nothing")),
        "log-edited",
    ],
)
def renderer(inputs: Path, request: pytest.FixtureRequest) -> DriveFrames:
    """Every type of edit, contact shadows, a mesh that moves and one that stands beside the lane, where cars pass."""
    document = json.loads((inputs / f"{request.param}.json").read_text())
    mesh = next(edit for edit in document["edits"] if edit["type"] == "insert_mesh")
    stands = {name: value for name, value in mesh.items() if name != "trajectory"}
    stands |= {"id": "block-2", "pose": {"position": [16.0, -2.2, 0.7], "yaw_deg": 10}}
    # decoders look far beside actors of other scenes: nearly all of a small image is rendered
    document["edits"] = [edit for edit in document["edits"] if edit.get("id") != "guest"] + [stands]
    document["sensors"] = {"cameras": [STILL, {"id": "front_camera"}], "lidars": [BEAMS]}
    (inputs / "still.json").write_text(json.dumps(document))
    plan, _ = plan_scenario(inputs / "still.json", RenderOptions(quality="fast"))
    return DriveFrames(plan.recipe.load(), plan.drive)


def arrays(frame: CameraFrame | LidarFrame) -> dict[str, Any]:
    """What a frame holds, but for how much was computed."""
    values = {one.name: getattr(frame, one.name) for one in fields(frame)}
    return {name: value for name, value in values.items() if name not in ("stats", "error_bound", "model")}


def assert_same(found: CameraFrame | LidarFrame, whole: CameraFrame | LidarFrame) -> None:
    for name, value in arrays(whole).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(found, name), value, err_msg=name)
        else:
            assert getattr(found, name) == value, name


def random_edits(drive: Drive, seed: int) -> Drive:
    """Another drive: one to three actors are moved, turned, scaled, copied, removed or come later."""
    rng = np.random.default_rng(seed)
    actors = dict(drive.actors)
    for uid in rng.choice(sorted(actors), rng.integers(1, 4), replace=False).tolist():
        actor, kind = actors[uid], rng.choice(["move", "scale", "copy", "remove", "later"])
        pose = np.eye(4)
        pose[:2, :2] = [[np.cos(turn := rng.uniform(-1, 1)), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
        pose[:3, 3] = rng.uniform((-3, -3, -0.2), (3, 3, 0.5))
        moved = replace(actor, world_from_actor=actor.world_from_actor.transformed(right=pose))
        if kind == "move":
            actors[uid] = moved
        elif kind == "scale" and not actor.appearance.mesh:
            factor = float(rng.uniform(0.7, 1.4))
            actors[uid] = replace(actor, size_m=actor.size_m * factor, scale=(factor, factor, factor))
        elif kind == "copy":
            actors[f"{uid}-copy"] = replace(moved, uid=f"{uid}-copy", inserted=True)
        elif kind == "later":
            actors[uid] = replace(actor, start_s=0.15)
        else:
            del actors[uid]
    return replace(drive, actors=dict(sorted(actors.items())))


@pytest.mark.parametrize("weather", [None, STEADY], ids=["clear", "fog and snow"])
@pytest.mark.parametrize("camera_id", ["still", "front_camera"])
def test_pixels_outside_the_regions_of_an_edit_have_the_same_bits(
    renderer: DriveFrames, camera_id: str, weather: WeatherKeys | None
) -> None:
    """Whatever the edit is, through a camera that stands and through one that moves while it is exposed."""
    camera, passes = renderer.captures.camera(camera_id, 96), ("rgb", "depth", "unsupported")
    capture = Capture("still", 200_000) if camera_id == "still" else Capture.of_frame(camera, 2)
    time_s = capture.time_s(camera)

    def rendered(drive: Drive) -> tuple[RenderedState, CameraFrame]:
        state = DriveFrames(renderer.renderer, drive).state(camera, time_s)
        frame = renderer.renderer.render(state, camera, time_s, passes)
        return RenderedState(state, (), renderer.renderer.margin(state)), frame

    first, before = rendered(replace(renderer.drive, weather=weather))
    assert changed_regions(renderer.renderer, first, first, camera) == []
    shares, differ = [], 0
    for seed in range(12 if weather is None else 4):
        second, after = rendered(replace(random_edits(renderer.drive, seed), weather=weather))
        regions = changed_regions(renderer.renderer, first, second, camera)
        assert regions is not None and regions == changed_regions(renderer.renderer, second, first, camera)
        inside = np.zeros(after.rgb.shape[:2], bool)
        for region in regions:
            inside[region.top : region.bottom, region.left : region.right] = True
        for name in ("rgb", "depth_m", "unsupported"):
            a, b = getattr(before, name), getattr(after, name)
            np.testing.assert_array_equal(a[~inside], b[~inside], err_msg=f"{name}, {seed}")
        differ += bool((before.rgb != after.rgb).any())
        shares.append(inside.mean())
    assert differ > (2 if weather is None else 0) and np.median(shares) < 0.9, (differ, shares)


def test_beams_beside_an_edit_have_the_same_bits(renderer: DriveFrames) -> None:
    lidar, rays = renderer.sweep_rays(Capture("beams", 200_000))

    def rendered(drive: Drive) -> tuple[RenderedState, LidarFrame]:
        state = DriveFrames(renderer.renderer, drive).state(lidar, 0.2)
        return RenderedState(state, ()), renderer.renderer.render(state, lidar, 0.2)

    (first, before), shares, differ = rendered(renderer.drive), [], 0
    for seed in range(12):
        second, after = rendered(random_edits(renderer.drive, seed))
        changed = changed_beams(renderer.renderer, first, second, lidar, rays)
        assert changed is not None
        np.testing.assert_array_equal(before.depth_m[~changed], after.depth_m[~changed])
        np.testing.assert_array_equal(before.intensity[~changed], after.intensity[~changed])
        differ += bool((before.depth_m != after.depth_m).any())
        shares.append(changed.mean())
    assert differ > 2 and np.median(shares) < 0.5, (differ, shares)


def test_what_may_differ_everywhere_has_no_regions(renderer: DriveFrames) -> None:
    """Other settings, another margin, static boxes in another order, or a camera that moves and another time."""
    camera = renderer.drive.cameras["front_camera"]
    state, later = (renderer.states.state(time_s, time_s + 0.02) for time_s in (0.1, 0.2))
    boxes = state.removed_boxes or (Box(np.eye(4), np.ones(3)),)
    two = replace(state, removed_boxes=(*boxes, Box(np.eye(4), 2 * np.ones(3))))
    one = RenderedState(two, (), 3)
    for other in (
        RenderedState(two, ("fast",), 3),
        RenderedState(two, (), 4),
        RenderedState(replace(two, removed_boxes=two.removed_boxes[::-1]), (), 3),
        RenderedState(replace(later, removed_boxes=two.removed_boxes), (), 3),
    ):
        assert changed_regions(renderer.renderer, one, other, camera) is None


@pytest.mark.parametrize("weather", [None, FOG], ids=["clear", "fog"])
def test_images_have_the_bits_of_whole_ones(renderer: DriveFrames, weather: WeatherKeys | None) -> None:
    drive = replace(renderer.drive, weather=weather)
    kept = DriveFrames(renderer.renderer, drive, renderer.draw, FrameReuse())
    renderer = DriveFrames(renderer.renderer, drive, renderer.draw)
    rays = []
    for time_us in TIMES_US:
        capture = Capture("still", time_us)
        found, whole = (one.image(capture, CAMERA_PASSES) for one in (kept, renderer))
        assert_same(found, whole)
        rays.append(found.stats.rays / whole.stats.rays)
    assert rays[0] == 1 and max(rays[1:]) < 0.8, rays


@pytest.mark.parametrize("weather", [None, STEADY], ids=["clear", "fog and snow"])
def test_sweeps_have_the_bits_of_whole_ones(renderer: DriveFrames, weather: WeatherKeys | None) -> None:
    drive = replace(renderer.drive, weather=weather)
    kept = DriveFrames(renderer.renderer, drive, 7, FrameReuse())
    whole_ones = DriveFrames(renderer.renderer, drive, 7)
    rays = []
    for time_us in TIMES_US:
        capture = Capture("beams", time_us)
        found, whole = (one.sweep(capture) for one in (kept, whole_ones))
        assert_same(found, whole)
        rays.append(found.stats.rays / whole.stats.rays)
    assert rays[0] == 1 and max(rays[1:]) < 0.5, rays
    assert whole.returned.any()


def test_filled_frames_have_the_bits_of_whole_ones(renderer: DriveFrames, monkeypatch: pytest.MonkeyPatch) -> None:
    """While actors pass behind boxes that edits have emptied, and before them."""
    backend = renderer.renderer.backend
    if not hasattr(backend, "observed"):
        pytest.skip("surfels are not filled")
    monkeypatch.setattr(recorded_depth, "VIEWS_PER_SENSOR", 2)
    monkeypatch.setattr(traced_planes, "TEXEL_M", 0.5)
    stays = {uid: actor for uid, actor in renderer.drive.actors.items() if uid not in backend.parked}
    drive = replace(renderer.drive, actors=stays)
    filled = Renderer(backend, renderer.renderer.shadows, fill=traced_planes.plane_fill(backend))  # type: ignore[arg-type]
    kept, whole_ones = (DriveFrames(filled, drive, 7, reuse) for reuse in (FrameReuse(), None))
    for time_us in TIMES_US:
        found, whole = (one.image(Capture("still", time_us), CAMERA_PASSES) for one in (kept, whole_ones))
        assert_same(found, whole)
        assert_same(*(one.sweep(Capture("beams", time_us)) for one in (kept, whole_ones)))
    assert found.stats.rays < 0.8 * whole.stats.rays
    plain = DriveFrames(renderer.renderer, drive).image(Capture("still", time_us), CAMERA_PASSES)
    assert whole.depth_m is not None and (whole.depth_m != plain.depth_m).sum() > 50


def test_nothing_is_rendered_where_nothing_moves(renderer: DriveFrames) -> None:
    """Though one actor is there no more that is numbered before others, and none of its pixels are."""
    drive, camera = renderer.drive, renderer.drive.cameras["still"]
    first, then = (renderer.states.state(time_s - 0.05, time_s + 0.05) for time_s in (0.1, 0.3))
    moves = {one.actor.uid for one in changed_actors(first, then, camera)}
    stand = {uid: actor for uid, actor in drive.actors.items() if uid not in moves}
    pose = camera.world_from_camera.poses
    pose[:, :3, 3] -= 20 * pose[:, :3, 2]
    behind = replace(stand["block-2"], uid="a-block", world_from_actor=Trajectory.from_poses(np.zeros(1), pose))
    kept = FrameReuse()
    for time_us, actors in ((100_000, {**stand, "a-block": behind}), (300_000, stand)):
        standing = DriveFrames(renderer.renderer, replace(drive, actors=actors), 7, kept)
        image, sweep = (
            standing.image(Capture("still", time_us), CAMERA_PASSES),
            standing.sweep(Capture("beams", time_us)),
        )
    whole = DriveFrames(renderer.renderer, replace(drive, actors=stand), 7)
    assert_same(image, whole.image(Capture("still", time_us), CAMERA_PASSES))
    assert_same(sweep, whole.sweep(Capture("beams", time_us)))
    assert image.stats.rays == 0


def test_weather_that_differs_or_falls_changes_all_of_an_image(renderer: DriveFrames) -> None:
    camera = renderer.drive.cameras["still"]

    def rendered(weather: WeatherKeys | None, time_s: float) -> RenderedState:
        drive = DriveFrames(renderer.renderer, replace(renderer.drive, weather=weather))
        return RenderedState(drive.state(camera, time_s), ())

    for before, after, later_s, alike in (
        (FOG, FOG, 0.1, True), (STEADY, STEADY, 0.0, True), (STEADY, STEADY, 0.1, False), (None, FOG, 0.0, False),
        (WET, WET, 0.0, False),
    ):  # fmt: skip
        regions = changed_regions(renderer.renderer, rendered(before, 0.2), rendered(after, 0.2 + later_s), camera)
        assert (regions is not None) == alike, (before, after, later_s)


def test_the_light_of_the_air_is_estimated_once_for_an_exposure(renderer: DriveFrames) -> None:
    """Whatever regions and edits follow, and again for another time."""
    counts, drive = [], replace(renderer.drive, weather=STEADY)
    fresh = Renderer(renderer.renderer.backend, renderer.renderer.shadows)
    for edited, time_us in ((drive, 100_000), (random_edits(drive, 3), 100_000), (drive, 150_000)):
        frames = DriveFrames(fresh, edited)
        camera = drive.cameras["still"]
        state, time_s = frames.state(camera, time_us / 1e6), time_us / 1e6
        lights = [fresh._frame_weather.air(state, camera, time_s, fresh.quality, fresh._clear_frame) for _ in range(2)]
        assert lights[0] is lights[1]
        counts.append(len(fresh._frame_weather._air))
    assert counts == [1, 1, 2]


def test_what_an_image_depends_on_is_rendered_again(renderer: DriveFrames) -> None:
    """Other passes, a removed box, another size."""
    kept = FrameReuse()
    capture = Capture("still", 100_000)
    edited = replace(renderer.drive, static_removals=renderer.drive.static_removals[:0], static_copies=())
    for drive, passes, width in (
        (renderer.drive, ("rgb",), None),
        (renderer.drive, ("rgb", "depth"), None),
        (renderer.drive, ("rgb", "depth"), 80),
        (edited, ("rgb", "depth"), 80),
    ):
        one = DriveFrames(renderer.renderer, drive, None, kept)
        found = one.image(capture, passes, width)
        assert found.stats.rays > 0
        assert_same(found, DriveFrames(renderer.renderer, drive).image(capture, passes, width))


def test_a_camera_that_moves_reuses_nothing(renderer: DriveFrames) -> None:
    kept = DriveFrames(renderer.renderer, renderer.drive, None, FrameReuse())
    for time_us in (100_000, 101_000):
        found, whole = (one.image(Capture("front_camera", time_us), ("rgb",), 64) for one in (kept, renderer))
        assert found.stats.rays == whole.stats.rays > 0
        assert_same(found, whole)


def test_what_moves_covers_a_box_all_along(renderer: DriveFrames) -> None:
    """Corners of a box at any time of an exposure lie within its bounds, and within one of the boxes swept."""
    state = renderer.states.state(0.1, 0.25)
    for actor in state.actors:
        changed = ChangedActor(actor, state.start_s, state.end_s)
        pose, size = changed.swept(Reach(), 0.0).bounds()
        half = actor.size_m / 2
        corners = np.stack(np.meshgrid(*((-x, x) for x in half), indexing="ij"), -1).reshape(-1, 3)
        for at in actor.world_from_actor.at(np.linspace(state.start_s, state.end_s, 37)):
            world = corners @ at[:3, :3].T + at[:3, 3]
            local = (world - pose[:3, 3]) @ pose[:3, :3]
            assert (np.abs(local) <= size / 2).all(), actor.uid


def test_actors_that_stand_have_not_changed(renderer: DriveFrames) -> None:
    first, second = renderer.states.state(0.1, 0.15), renderer.states.state(0.2, 0.25)
    camera = renderer.drive.cameras["still"]
    assert standing_pose(camera.world_from_camera, 0.1, 0.25) is not None
    found = {one.actor.uid for one in changed_actors(first, second, camera)}
    moving = {one.uid for one in first.actors if np.ptp(one.world_from_actor.at(np.array([0.1, 0.25])), 0).any()}
    assert "block-2" not in found and "block" in found and moving <= found
    assert len(found) < len(first.actors) / 2
    one = next(actor for actor in second.actors if actor.uid == "block-2")
    for other in (replace(one, size_m=one.size_m * 1.5), replace(one, label="Van"), replace(one, end_s=0.22)):
        actors = tuple(other if actor is one else actor for actor in second.actors)
        assert "block-2" in {x.actor.uid for x in changed_actors(first, replace(second, actors=actors), camera)}


def test_regions_are_joined_where_that_costs_less() -> None:
    a, b, far = Region(0, 0, 100, 50), Region(50, 10, 140, 60), Region(900, 500, 1000, 600)
    assert joined_where_cheaper([a, far, b]) == [far, Region(0, 0, 140, 60)]
    assert joined_where_cheaper([]) == []
