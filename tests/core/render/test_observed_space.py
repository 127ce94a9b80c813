"""What a recording observed, and images clipped to it: kernels and torch agree, and nothing unobserved is shown."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drive_frames import DriveFrames
from random_scene import PASSES, TINY, edited, image_rays, saved
from render.tracers.test_compiled_tracer import both_backends, needs_library, numbers, same_find
from whole_drive import bound_to

from unisim_blender.core import native
from unisim_blender.core.geometry import Trajectory, quaternion_from_matrix, transform_points
from unisim_blender.core.render import observed_space
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.observed_space import (
    ELEVATION_CELLS,
    ObservedSpace,
    Observing,
    cache_space,
    cached_space,
    closed,
    dilated,
    direction_parts,
    observe_space,
    spread,
)
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracer import NEAR_M
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.sensors.frames import RenderStats
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.world.drive import Camera, CameraModel, Drive

SAMPLE = Path(__file__).parents[3] / "sample" / "scene"
FRAME = 9


@pytest.fixture(scope="module")
def space(backend: CompiledBackend) -> ObservedSpace:
    steps = list(observe_space(backend, *backend.observed))
    shares = [step for step in steps if isinstance(step, float)]
    assert len(shares) == len(steps) - 1 and shares == sorted(shares) and shares[0] == 0 and 0.9 < shares[-1] < 1
    assert isinstance(steps[-1], ObservedSpace)
    return steps[-1]


def seen_from(drive: Drive, ahead_m: float, left_m: float, up_m: float) -> Drive:
    """The drive with one camera, that looks at the road 15 m ahead of the vehicle from a place beside the vehicle."""
    time_s = drive.time_s[FRAME]
    ego = drive.world_from_ego.at(time_s)
    eye, at = ego[:3, :3] @ [ahead_m, left_m, up_m] + ego[:3, 3], ego[:3, :3] @ [15.0, 0, 0] + ego[:3, 3]
    forward = (at - eye) / np.linalg.norm(at - eye)
    right = np.cross(forward, [0, 0, 1.0])
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(forward, right), forward], 1)
    trajectory = Trajectory(np.array([time_s]), eye[None], quaternion_from_matrix(axes)[None])
    camera = Camera("outside", CameraModel(160, 100, 125.0, 125.0, 80.0, 50.0), trajectory, {0: time_s})
    return replace(drive, cameras={"outside": camera}, lidars={})


def random_space(backend: Observing, seed: int = 0) -> ObservedSpace:
    """A space of which some was passed, whatever its scene is."""
    header, shown, voxel_m = backend.observed
    rng = np.random.default_rng(seed)
    coarse = rng.random([-(-count // 4) for count in shown.shape]) < 0.05
    passed = coarse.repeat(4, 0).repeat(4, 1).repeat(4, 2)[: shown.shape[0], : shown.shape[1], : shown.shape[2]]
    background = rng.random((ELEVATION_CELLS, 2 * ELEVATION_CELLS)) < 0.5
    empty = observed_space._Observing(header, (1, 1, 1), voxel_m)
    return ObservedSpace(empty.volume_from_world, empty.size_m, voxel_m, np.asarray(shown) > 0, passed, background)


@needs_library
@pytest.mark.parametrize("clip", (False, True))
def test_kernels_and_torch_agree(tmp_path: Path, clip: bool) -> None:
    drive = edited()
    fast, slow = both_backends(saved(tmp_path / "scene", TINY))
    space = random_space(fast)
    rays = image_rays(drive)
    starts = space.starts(rays.flat())
    assert 0.3 < np.isfinite(starts).mean() and np.median(starts[np.isfinite(starts)]) > 2, "the bound is none"
    unclipped = bound_to(fast, drive).trace(rays, {"depth"}, True, None, RenderStats())
    found = bound_to(fast.within(space, clip), drive).trace(rays, PASSES, True, None, RenderStats())
    expected = bound_to(slow.within(space, clip), drive).trace(rays, PASSES, True, None, RenderStats())
    same_find(found, expected, rays.time_s.shape)
    assert 0.05 < found.maps["unsupported"].mean() < 0.95
    nearer = found.maps["depth"] < unclipped.maps["depth"] - 0.01
    assert nearer.mean() < 0.05, "something is met that was not there"
    assert (found.maps["depth"] > unclipped.maps["depth"] + 0.5).mean() > 0.1 if clip else not nearer.any()


@needs_library
def test_the_kernel_finds_what_numpy_finds(tmp_path: Path) -> None:
    fast, _ = both_backends(saved(tmp_path / "scene", TINY))
    space = random_space(fast)
    rng = np.random.default_rng(1)
    origins, directions = rng.uniform(-25, 25, (4000, 3)), rng.normal(size=(4000, 3)) * [1, 1, 0.2]
    directions[0] = [0, 0, 1]
    rays = Rays(origins, directions / np.linalg.norm(directions, axis=1, keepdims=True), np.zeros(4000))
    o, d = space._into(rays)
    found, expected = space._first(o, d), space.first_reference(o, d)
    # rounding may put a place on a voxel's border into the next one
    assert (np.isclose(found, expected, rtol=1e-6) | (found == expected)).mean() > 0.998
    there = np.isfinite(found)
    assert 0.1 < there.mean() < 0.9
    cells = ((o[there] + found[there, None] * d[there]) / space.voxel_m + 1e-5).astype(int)
    cells = np.clip(cells, 0, np.array(space.passed.shape) - 1)
    assert (space.passed & ~space.shown)[tuple(cells.T)].mean() > 0.99
    starts, at = space.starts(rays), np.floor(o / space.voxel_m).astype(int)
    within = ((at >= 0) & (at < space.passed.shape)).all(1)
    amid = within & space.passed[tuple(np.where(within[:, None], at, 0).T)]
    assert amid.mean() > 0.01 and (starts[amid] == np.float32(NEAR_M)).all(), (
        "a view from amid the street loses what is near"
    )
    np.testing.assert_array_equal(starts[~amid], found[~amid])


def test_without_kernels_the_clearance_is_no_larger(monkeypatch: pytest.MonkeyPatch) -> None:
    if native.library() is None:
        pytest.skip("the compiled kernels were not built")
    marked = np.random.default_rng(2).random((30, 20, 25)) < 0.001
    exact = observed_space.clearance(marked)
    with monkeypatch.context() as without:
        without.setattr(native, "library", lambda: None)
        plain = observed_space.clearance(marked)
    assert (plain == np.minimum(exact, 8)).all() and plain.max() == 8 and (plain[marked] == 0).all()


def test_a_recorded_view_is_supported_and_hardly_clipped(backend: CompiledBackend, space: ObservedSpace) -> None:
    drive = backend.scene.header.drive
    whole = DriveFrames(Renderer(backend), drive).camera("front_camera", FRAME, width=240)
    clipped = DriveFrames(Renderer(backend.within(space, True)), drive).camera(
        "front_camera", FRAME, ("rgb", "unsupported"), 240
    )
    assert clipped.unsupported is not None and clipped.unsupported.mean() < 0.02
    same = (np.abs(clipped.rgb - whole.rgb) < 0.02).all(-1) | clipped.unsupported
    assert same.mean() > 0.97


@pytest.mark.parametrize(
    "place", ((-22.0, 0.0, 18.0), (14.0, 0.0, 60.0), (15.0, 45.0, 25.0)), ids=("behind", "above", "side")
)
def test_from_outside_nothing_unobserved_is_shown(
    backend: CompiledBackend, space: ObservedSpace, place: tuple[float, float, float]
) -> None:
    drive = seen_from(backend.scene.header.drive, *place)
    told = DriveFrames(Renderer(backend.within(space, False)), drive).camera("outside", 0, ("rgb", "unsupported"))
    clipped = DriveFrames(Renderer(backend.within(space, True)), drive).camera(
        "outside", 0, ("rgb", "unsupported", "depth", "instance")
    )
    assert told.unsupported is not None and clipped.unsupported is not None and clipped.depth_m is not None
    assert 0.3 < told.unsupported.mean() < 0.9, "noise all round"
    assert 0.1 < (~clipped.unsupported).mean() < 0.8, "the street, and nothing round it"
    camera = drive.cameras["outside"]
    pose = camera.world_from_camera.at(camera.time_s[0])
    v, u = np.nonzero(~clipped.unsupported & (clipped.instance == 0) & np.isfinite(clipped.depth_m))
    rays = np.stack([(u + 0.5 - 80) / 125, (v + 0.5 - 50) / 125, np.ones(len(u))], 1)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    ends = pose[:3, 3] + (rays @ pose[:3, :3].T) * clipped.depth_m[v, u][:, None]
    cells = np.floor(transform_points(space.volume_from_world, ends) / space.voxel_m).astype(int)
    inside = ((cells >= 0) & (cells < space.shown.shape)).all(1)
    assert space.shown[tuple(cells[inside].T)].mean() > 0.96, "voxels that images do not show"


def test_what_stands_before_the_street_is_left_out(backend: CompiledBackend, space: ObservedSpace) -> None:
    """From behind a row of houses, the middle of the road is met, and not the back of their fronts."""
    drive = seen_from(backend.scene.header.drive, 15.0, 45.0, 25.0)
    away_m = float(np.hypot(45.0, 25.0))
    whole, clipped = (
        DriveFrames(Renderer(one), drive).camera("outside", 0, ("rgb", "depth"), region=Region(76, 46, 84, 54)).depth_m
        for one in (backend, backend.within(space, True))
    )
    assert whole is not None and clipped is not None
    assert np.median(whole) < away_m - 10
    assert abs(np.median(clipped) - away_m) < 3


def test_actors_are_never_clipped(backend: CompiledBackend, space: ObservedSpace) -> None:
    drive = seen_from(backend.scene.header.drive, 15.0, 45.0, 25.0)
    ego = drive.world_from_ego.at(drive.time_s[FRAME])
    car = next(actor for actor in drive.actors.values() if actor.label == "Car" and not actor.is_moving)
    yard = ego[:3, :3] @ [15.0, 30.0, 8.0] + ego[:3, 3]
    moved = replace(car, uid="moved", world_from_actor=Trajectory(np.zeros(1), yard[None], np.array([[1.0, 0, 0, 0]])))
    drive = replace(drive, actors={"moved": replace(moved, start_s=-10.0, end_s=100.0)})
    one = backend.within(space, True)
    assert not np.isfinite(space.starts(Rays(yard[None], np.array([[0.0, 0, 1]]), np.zeros(1)))).any()
    frame = DriveFrames(Renderer(one), drive).camera("outside", 0, ("rgb", "unsupported", "instance"))
    assert frame.instance is not None and frame.unsupported is not None
    assert (frame.instance > 0).sum() > 50 and not frame.unsupported[frame.instance > 0].any()


@pytest.mark.parametrize("clip", (False, True))
def test_coarse_images_and_parts_have_it_too(backend: CompiledBackend, space: ObservedSpace, clip: bool) -> None:
    drive = seen_from(backend.scene.header.drive, -22.0, 0.0, 18.0)
    renderer = DriveFrames(Renderer(backend.within(space, clip)), drive)
    camera = drive.cameras["outside"]
    time_s = camera.time_s[0]
    state = renderer.state(camera, time_s)
    parts = list(renderer.renderer.progressive(state, camera, time_s, ("rgb", "unsupported"), coarse=(8, 4), band=40))
    assert [part.stride for part in parts[:2]] == [(8, 8), (4, 4)] and len(parts) > 3
    whole = renderer.camera("outside", 0, ("rgb", "unsupported")).unsupported
    assert whole is not None
    for part in parts[:2]:
        assert part.frame.unsupported is not None and part.frame.unsupported.shape == part.frame.rgb.shape[:2]
        stride = int(part.stride[0])
        np.testing.assert_array_equal(part.frame.unsupported, whole[::stride, ::stride])
    bands = [part.frame.unsupported for part in parts[2:]]
    np.testing.assert_array_equal(np.concatenate([band for band in bands if band is not None]), whole)
    region = Region(40, 30, 90, 70)
    inner = renderer.camera("outside", 0, ("rgb", "unsupported"), region=region).unsupported
    assert inner is not None
    np.testing.assert_array_equal(inner, whole[30:70, 40:90])
    colours = renderer.camera("outside", 0)
    assert colours.unsupported is None and colours.depth_m is None, "a pass that nobody asked for"


def test_it_is_kept_for_the_next_time(
    backend: CompiledBackend, space: ObservedSpace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path))
    assert cached_space(*backend.observed) is None
    cache_space(backend.scene.header, space)
    found = cached_space(*backend.observed)
    assert found is not None
    for name in ("volume_from_world", "size_m", "shown", "passed", "background"):
        np.testing.assert_array_equal(getattr(found, name), getattr(space, name))
    (file,) = (tmp_path / "observed").iterdir()
    file.write_bytes(file.read_bytes()[:-100])
    assert cached_space(*backend.observed) is None, "a broken file counts"


def test_gaps_between_rays_are_closed_and_no_more() -> None:
    passed = np.zeros((12, 12, 12), bool)
    passed[2:10:2, 2:10, 2:10] = True
    found = closed(passed)
    assert found[3:9, 3:9, 3:9].all() and not found[:2].any() and not found[11:].any()
    assert dilated(np.eye(3, dtype=bool)).sum() == 9 and not closed(np.zeros((3, 3, 3), bool)).any()


def test_directions_go_round() -> None:
    seen = np.zeros((ELEVATION_CELLS, 2 * ELEVATION_CELLS), bool)
    behind = np.array([[-1.0, 1e-6, 0.0]])
    seen[direction_parts(behind)] = True
    seen = spread(seen)
    for direction in ([-1.0, -0.01, 0.0], [-1.0, 0.01, 0.02]):
        assert seen[direction_parts(np.array([direction]))].all()
    assert not seen[direction_parts(np.array([[1.0, 0.0, 0.0], [-1.0, 0.5, 0.0], [0.0, 0.0, 1.0]]))].any()


@needs_library
def test_opacity_and_colours_are_those_of_the_recording(tmp_path: Path) -> None:
    """A space that was passed and shown everywhere clips nothing."""
    fast, _ = both_backends(saved(tmp_path / "scene", TINY))
    space = random_space(fast)
    everywhere = replace(space, shown=np.ones_like(space.shown), passed=np.ones_like(space.passed))
    drive = edited()
    rays = image_rays(drive)
    fast.scene.observed = np.ones_like(fast.scene.observed)
    found = bound_to(fast.within(everywhere, True), drive).trace(rays, {"depth"}, True, None, RenderStats())
    expected = bound_to(fast, drive).trace(rays, {"depth"}, True, None, RenderStats())
    np.testing.assert_allclose(numbers(found.feature), numbers(expected.feature), atol=1e-5)
