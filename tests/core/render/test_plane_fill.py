"""Ground and façades that nobody saw, filled with what was seen of the same street: in images and in sweeps."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from analytic_scene import still
from click.testing import CliRunner
from drive_frames import DriveFrames
from rendered_folder import contents

from unisim_blender.core import native
from unisim_blender.core.cli.main import unisim
from unisim_blender.core.geometry import BoolArray, FloatArray, make_pose, transform_points
from unisim_blender.core.render import recorded_depth as recorded_depth_module
from unisim_blender.core.render import traced_planes as module
from unisim_blender.core.render.confidence import RecordedDepth
from unisim_blender.core.render.frame_fill import filled_sweep, seen_through
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.plane_fill import (
    FACADE_M,
    UNSURE_TEXELS,
    PlaneFill,
    SensorKind,
    Texture,
    TexturedPlane,
    filled,
    share_of,
)
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.traced_planes import plane_fill, trace_planes
from unisim_blender.core.render.tracer import Array
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.scenario import apply_scenario, scenario_from_json
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.world.drive import Box, Camera, Drive, Lidar, StaticCopy
from unisim_blender.core.world.replay import WorldState

SAMPLE = Path(__file__).parents[3] / "sample" / "scene"
FRAME = 5


def test_markings_go_on_along_the_street() -> None:
    street = np.zeros((61, 17, 1), np.float32)
    street[:, 5], street[:, 12] = 1.0, 0.5
    known = np.zeros(street.shape[:2], bool)
    known[:40] = True
    known[10:14, 4:7] = False
    gaps = np.where(known[..., None], street, np.float32(7))
    np.testing.assert_allclose(filled(gaps, known), street, atol=1e-6)
    # halved in both directions at once, the far end is a mean of all
    assert np.abs(filled(gaps, known, along=0)[-1, :, 0] - street[-1, :, 0]).max() > 0.3


def test_what_is_known_stays_and_nothing_comes_of_nothing() -> None:
    values = np.random.default_rng(0).random((9, 14, 3)).astype(np.float32)
    known = np.random.default_rng(1).random((9, 14)) > 0.7
    out = filled(values, known)
    np.testing.assert_array_equal(out[known], values[known])
    assert out.min() >= values[known].min() - 1e-6 and out.max() <= values[known].max() + 1e-6
    assert not filled(values, np.zeros_like(known)).any()


def test_places_between_texels_and_outside_of_the_map() -> None:
    colours = np.arange(4 * 3 * 3, dtype=np.float32).reshape(4, 3, 3)
    share = np.ones((4, 3, 1), np.float32)
    grid_from_world = np.eye(4)
    grid_from_world[:3, 3] = [10, 20, 0]
    textures: dict[SensorKind, Texture] = {Camera: Texture(colours, share), Lidar: Texture(colours[..., :1], share / 2)}
    fill = PlaneFill((TexturedPlane(grid_from_world, 2.0, None, textures),))
    points = np.array([[-9.0, -19, 5], [-3, -14.9, 0], [-8, -19, 0], [-8, -19, 9], [-3, -15, 0]])
    for kind, part in ((Camera, 1.0), (Lidar, 0.5)):
        number, shown, shares = fill.of(kind, points, lambda places: places[:, 2] - [5, 0, 0, 0][: len(places)])
        np.testing.assert_array_equal(number, [0, 2, 4])
        expected = np.array([colours[0, 0], colours[:2, 0].mean(0), colours[3, 2]])
        np.testing.assert_allclose(shown, expected[:, : shown.shape[1]])
        np.testing.assert_array_equal(shares, np.full((3, 1), part))


def test_the_closest_plane_fills_what_lies_on_its_surface() -> None:
    share = np.ones((20, 20, 1), np.float32)
    wall = np.eye(4)
    wall[:3, :3] = [[1, 0, 0], [0, 0, 1], [0, -1, 0]]
    relief = share * 0
    relief[10:] = 0.4  # a pilaster before the wall

    def plane(grid: FloatArray, relief: Array | None, value: float) -> TexturedPlane:
        return TexturedPlane(grid, 0.1, relief, {Camera: Texture(np.repeat(share, 3, 2) * value, share)})

    fill = PlaneFill((plane(np.eye(4), None, 0.25), plane(wall, relief, 0.75)))
    on_wall, on_ground, before = [0.5, 0.02, 1.0], [0.5, 1.0, 0.0], [0.5, -0.4, 1.0]
    on_pilaster, behind, in_corner = [1.5, -0.4, 1.0], [1.5, 0.0, 1.0], [0.5, 0.09, 0.05]
    points = np.array([on_wall, on_ground, before, on_pilaster, behind, in_corner])
    number, shown, _ = fill.of(Camera, points, lambda places: places[:, 2])
    np.testing.assert_array_equal(number, [0, 1, 3, 5])
    np.testing.assert_allclose(shown[:, 0], [0.75, 0.25, 0.75, 0.25])


def rays_from(origin: list[float], *ends: list[float]) -> Rays:
    to = np.array(ends) - origin
    directions = to / np.linalg.norm(to, axis=1, keepdims=True)
    return Rays(np.tile(np.array(origin), (len(to), 1)), directions, np.zeros(len(to)))


def ground_and_wall(shows: float = 0.25) -> PlaneFill:
    """Ground at z = 0 from (0, -5) to (20, 15), and a wall at y = 10 up to 4 m, 0.2 m nearer from x = 10 on."""
    ground, wall = np.eye(4), np.eye(4)
    ground[:3, 3] = [0, 5, 0]
    wall[:3] = [[1, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 10]]
    share, high = np.ones((200, 200, 1), np.float32), np.ones((200, 40, 1), np.float32)
    relief = 0 * high
    relief[100:] = 0.2
    both: dict[SensorKind, Texture] = {
        Camera: Texture(shows * share.repeat(3, 2), share),
        Lidar: Texture(shows * share, share),
    }
    bricks: dict[SensorKind, Texture] = {Camera: Texture(3 * shows * high.repeat(3, 2), high)}
    return PlaneFill((TexturedPlane(ground, 0.1, None, both), TexturedPlane(wall, 0.1, relief, bricks)))


def test_rays_hit_the_first_plane_beyond_a_distance() -> None:
    fill, slope = ground_and_wall(), 0.05
    ends = [[5.0, 6, 0.05 * 5], [5.0, 10, 2], [15.0, 9.8, 2], [5.0, 6, 2.4], [5.0, 10, 4.5], [30.0, 0, 1.5]]
    rays = rays_from([0.0, 0, 1.5], *ends)

    def heights(places: FloatArray) -> FloatArray:
        return np.asarray(places[:, 2] - slope * places[:, 0])

    distance, values, normals = fill.hit(Camera, rays, np.zeros(len(ends)), heights)
    expected = [*np.linalg.norm(np.array([*ends[:3], [5.0 * 10 / 6, 10, 3]]) - [0, 0, 1.5], axis=1), np.inf, np.inf]
    np.testing.assert_allclose(distance, expected, atol=0.02)
    np.testing.assert_allclose(values[:4, 0], [0.25, 0.75, 0.75, 0.75], atol=1e-6)
    np.testing.assert_allclose(normals[:3], [[0, 0, 1], [0, -1, 0], [0, -1, 0]])
    beyond, _, _ = fill.hit(Camera, rays, np.where(np.isfinite(distance), distance, 0) + 0.1, heights)
    assert np.isinf(beyond[1:]).all() and beyond[0] > distance[0] + 2
    _, intensities, _ = fill.hit(Lidar, rays, np.zeros(len(ends)), heights)
    assert intensities[0, 0] == np.float32(0.25) and np.isnan(intensities[1:3]).all()


@dataclass
class Level:
    """A tracer of ground at z = 0 and of a wall."""

    wall_y: float = 10.0

    @staticmethod
    def heights(points: FloatArray) -> FloatArray:
        return points[:, 2]

    def trace(self, rays: Rays, *_: object) -> SimpleNamespace:
        depth = ((self.wall_y - rays.origins[:, 1]) / rays.directions[:, 1]).astype(np.float32)
        return SimpleNamespace(maps={"depth": depth})


class SeenAbove(RecordedDepth):
    """A recording that confirms what is higher than 2 m."""

    def unseen(self, rays: Rays, depth_m: Array, *_: object, **__: object) -> BoolArray:
        return np.asarray(rays.origins[:, 2] + depth_m * rays.directions[:, 2] < 2)


def test_what_nothing_confirms_behind_an_emptied_box_is_a_plane() -> None:
    fill, recorded = ground_and_wall(), SeenAbove((), {})
    box = Box(make_pose(np.array([5.0, 4, 1]), np.array([1.0, 0, 0, 0])), np.array([4.0, 2, 2]))
    #       under the box,  behind it,  on the wall, not through it, an actor, one behind, a copy, before the box
    ends = [
        [5.0, 4.5, 0],
        [5.0, 7, 0],
        [8.0, 10, 1],
        [-5.0, 10, 1],
        [5.0, 7, 0],
        [3.2, 7, 0.0],
        [6.8, 7, 0.0],
        [5.0, 7, 0],
    ]
    rays = rays_from([5.0, -4, 1.5], *ends)
    depth = np.linalg.norm(np.array(ends) - [5.0, -4, 1.5], axis=1) + [0.5, -1, -0.5, 0, -1, -2.5, -2.5, -9]
    instance = np.array([0, 0, 0, 0, 1, 0, 0, 0], np.int32)
    hidden, target = (
        still("behind", [3.0, 6.5, 0.5], [0.8, 0.8, 1.0]),
        make_pose(np.array([7.0, 6.5, 0.5]), np.array([1.0, 0, 0, 0])),
    )
    copy = StaticCopy("cone", Box(np.eye(4), np.array([0.8, 0.8, 1.0])), target)
    state = WorldState(0.0, 0.5, hidden.world_from_actor, (hidden,), (copy,), (box,))
    maps = {
        "depth": depth.astype(np.float32), "instance": instance, "unsupported": np.zeros(8, bool),
        "normal": np.zeros((8, 3), np.float32),
    }  # fmt: skip
    before = {name: values.copy() for name, values in maps.items()}
    arguments = (Level(), recorded, state, [hidden], rays)
    through, after = seen_through(fill, Camera, *arguments, maps)  # type: ignore[arg-type]
    np.testing.assert_array_equal(through.rays, [0, 1, 2])
    np.testing.assert_allclose(through.values[:, 0], [0.25, 0.25, 0.75], atol=1e-6)
    np.testing.assert_allclose(after["depth"][:3], depth[:3] - [0.5, -1, -0.5], atol=0.03)
    np.testing.assert_array_equal(after["unsupported"], np.arange(8) < 3)
    np.testing.assert_allclose(after["normal"][:3], [[0, 0, 1], [0, 0, 1], [0, -1, 0]])
    for name, values in maps.items():
        np.testing.assert_array_equal(values, before[name])
        np.testing.assert_array_equal(after[name][3:], before[name][3:])
    intensity = np.linspace(0.1, 0.8, 8, dtype=np.float32)
    distance, filled = filled_sweep(fill, *arguments, maps["depth"], intensity, instance)  # type: ignore[arg-type]
    np.testing.assert_array_equal(distance, after["depth"])
    # a wall's own intensities stay
    np.testing.assert_allclose(filled[:3], [0.25, 0.25, intensity[2]], atol=1e-6)
    # no box, one beside the rays, and what is above it is not confirmed either
    for tracer, shows, boxes in (
        (Level(), recorded, ()),
        (Level(), recorded, (replace(box, size_m=box.size_m / 9),)),
        (Level(), RecordedDepth((), {}), (box,)),
    ):
        each = replace(state, removed_boxes=boxes)
        none, same = seen_through(fill, Camera, tracer, shows, each, [hidden], rays, maps)  # type: ignore[arg-type]
        assert not len(none.rays)
        np.testing.assert_array_equal(same["depth"], maps["depth"])
    nearer, _ = seen_through(fill, Camera, Level(6.3), recorded, state, [hidden], rays, maps)  # type: ignore[arg-type]
    np.testing.assert_array_equal(nearer.rays, [0])


def test_what_was_seen_is_not_filled_and_nothing_far_from_it() -> None:
    seen = np.zeros((200, 9), bool)
    seen[:20] = True
    share = share_of(seen, seen, 0.1)[:, 4, 0]
    assert not share[: 19 + UNSURE_TEXELS].any() and (share[25:55] == 1).all() and not share[62:].any()
    assert (np.diff(share[:40]) >= 0).all()


@pytest.fixture(scope="module")
def fill(backend: CompiledBackend, tmp_path_factory: pytest.TempPathFactory) -> PlaneFill:
    """A coarse map of the sample, which comes from the cache the second time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("UNISIM_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.setattr(recorded_depth_module, "VIEWS_PER_SENSOR", 5)
        patch.setattr(module, "TEXEL_M", 0.2)
        *fractions, first = trace_planes(backend)
        shares = [each for each in fractions if isinstance(each, float)]
        assert isinstance(first, PlaneFill) and len(shares) == len(fractions)
        assert shares == sorted(shares) and shares[-1] <= 1
        patch.setattr(CompiledBackend, "bind", None)
        again = plane_fill(backend)
        assert len(first.planes) == len(again.planes) > 3
        for one, other in zip(first.planes, again.planes, strict=True):
            np.testing.assert_array_equal(one.grid_from_world, other.grid_from_world)
            for kind, texture in one.textures.items():
                np.testing.assert_array_equal(texture.values, other.textures[kind].values)
                np.testing.assert_array_equal(texture.share, other.textures[kind].share)
    return first


def aside(drive: Drive, left_m: float) -> Drive:
    edits = [{"type": "ego", "shift": [{"frame": 0, "left_m": left_m}]}]
    document = {"format": "unisim-scenario", "version": 1, "name": "s", "log": "l", "edits": edits}
    return apply_scenario(scenario_from_json(document, Path("s.json")), drive, lambda path: {})


def without_parked_cars(drive: Drive) -> Drive:
    gone = [uid for uid, actor in drive.actors.items() if actor.label == "Car" and not actor.is_moving]
    return replace(drive, actors={uid: actor for uid, actor in drive.actors.items() if uid not in gone})


def test_images_are_filled_where_no_image_saw_the_ground(backend: CompiledBackend, fill: PlaneFill) -> None:
    drive = without_parked_cars(backend.observed[0].drive)
    plain, whole = (DriveFrames(Renderer(backend, fill=each), drive) for each in (None, fill))
    passes = ("rgb", "depth", "instance", "unsupported")
    before, after = (frames.camera("front_camera", FRAME, passes, 240) for frames in (plain, whole))
    changed = (before.rgb != after.rgb).any(-1)
    assert 0.02 < changed.mean() < 0.2
    assert before.instance is not None and after.instance is not None and not before.instance[changed].any()
    np.testing.assert_array_equal(before.instance, after.instance)
    assert before.depth_m is not None and after.depth_m is not None
    moved = before.depth_m != after.depth_m
    assert 0.01 < moved.mean() < 0.1 and after.unsupported is not None and after.unsupported[moved].all()
    assert before.unsupported is not None and after.unsupported is not None
    marked = after.unsupported & ~before.unsupported
    assert marked.sum() > 0.3 * changed.sum() and not (before.unsupported & ~after.unsupported).any()
    assert (changed | ~marked).all()
    # only what was asked for is in the frame, and a part has the bits of the whole
    alone = whole.camera("front_camera", FRAME, ("rgb",), 240)
    assert alone.depth_m is None and alone.instance is None
    part = whole.camera("front_camera", FRAME, passes, 240, Region(20, 60, 200, 120))
    np.testing.assert_array_equal(part.rgb, after.rgb[60:120, 20:200])


def test_a_view_without_anything_to_fill_stays(backend: CompiledBackend, fill: PlaneFill) -> None:
    drive = without_parked_cars(backend.observed[0].drive)
    plain, whole = (DriveFrames(Renderer(backend, fill=each), drive) for each in (None, fill))
    sky, passes = Region(100, 0, 140, 16), ("rgb", "depth", "unsupported")
    before, after = (frames.camera("front_camera", FRAME, passes, 240, sky) for frames in (plain, whole))
    np.testing.assert_array_equal(before.rgb, after.rgb)
    assert before.unsupported is not None and after.unsupported is not None
    np.testing.assert_array_equal(before.unsupported, after.unsupported)
    assert before.depth_m is not None and np.isinf(before.depth_m).any()


def test_recorded_images_stay(backend: CompiledBackend, fill: PlaneFill) -> None:
    drive = backend.observed[0].drive
    plain, whole = (DriveFrames(Renderer(backend, fill=each), drive) for each in (None, fill))
    before, after = (frames.camera("front_camera", 4, ("rgb",), 240).rgb for frames in (plain, whole))
    assert (before != after).any(-1).mean() < 0.01


def test_sweeps_are_filled_where_no_sweep_saw_the_ground(backend: CompiledBackend, fill: PlaneFill) -> None:
    drive = without_parked_cars(backend.observed[0].drive)
    plain, whole = (DriveFrames(Renderer(backend, fill=each), drive) for each in (None, fill))
    before, after = (frames.lidar("pandar64", FRAME) for frames in (plain, whole))
    changed, moved = before.intensity != after.intensity, before.depth_m != after.depth_m
    assert changed.sum() > 1000 and not before.instance[changed].any()
    assert moved.sum() > 1000 and not before.instance[moved].any()
    changed &= ~moved
    points = after.origins + after.directions * after.depth_m[..., None]
    tracer = whole.renderer.tracer(whole.state(whole.lidar_named("pandar64"), 0.5))
    number, expected, share = fill.of(Lidar, points[changed], tracer.heights)
    np.testing.assert_array_equal(number, np.arange(changed.sum()))
    sure = share[:, 0] == 1
    assert sure.sum() > 200
    np.testing.assert_allclose(after.intensity[changed][sure], expected[sure, 0], atol=1e-6)


def test_facades_are_filled_in_images_and_stay_in_sweeps(backend: CompiledBackend, fill: PlaneFill) -> None:
    drive = aside(backend.observed[0].drive, 3.0)
    ground, whole = (DriveFrames(Renderer(backend, fill=each), drive) for each in (PlaneFill(fill.planes[:1]), fill))
    before, after = (frames.camera("front_camera", FRAME, ("rgb", "depth"), 240) for frames in (ground, whole))
    changed = (before.rgb != after.rgb).any(-1)
    assert 0.01 < changed.mean() < 0.1
    assert before.depth_m is not None and after.depth_m is not None
    np.testing.assert_array_equal(before.depth_m, after.depth_m)
    camera = whole.sized("front_camera", 240)
    rays = camera_rays(camera, camera.time_s[FRAME], *pixel_grid(camera.model))
    points = rays.origins[changed] + rays.directions[changed] * before.depth_m[changed][:, None]
    off = np.min([np.abs(transform_points(plane.grid_from_world, points)[:, 2]) for plane in fill.planes[1:]], 0)
    assert off.max() < FACADE_M and np.median(points[:, 2]) > 1
    less, more = (frames.lidar("pandar64", FRAME) for frames in (ground, whole))
    np.testing.assert_array_equal(less.intensity, more.intensity)


def test_sequences_are_filled_as_asked_and_say_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if native.library() is None:
        pytest.skip("the compiled kernels were not built")
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(recorded_depth_module, "VIEWS_PER_SENSOR", 3)
    monkeypatch.setattr(module, "TEXEL_M", 0.4)
    scenario = tmp_path / "scenario.json"
    document = {
        "format": "unisim-scenario", "version": 1, "name": "gone", "log": "street", "scene": str(SAMPLE), "frames": [5],
        "edits": [{"type": "remove", "actor": f"car-{number:02}"} for number in (6, 7, 11, 12)],
        "outputs": {"fill": "texture", "formats": ["png"], "passes": ["rgb", "unsupported"]},
    }  # fmt: skip
    scenario.write_text(json.dumps(document))

    def files(out: str, *more: str) -> dict[str, bytes]:
        arguments = ["render", str(scenario), "--out", str(tmp_path / out), "--width", "120", "--jobs", "1", *more]
        result = CliRunner().invoke(unisim, [*arguments, "--sensors", "front_camera"], catch_exceptions=False)
        assert result.exit_code == 0, result.output
        return contents(tmp_path / out)

    stated, asked, plain = files("stated"), files("asked", "--fill", "texture"), files("plain", "--fill", "none")
    assert stated == asked
    assert [json.loads(each["manifest.json"])["settings"]["fill"] for each in (asked, plain)] == ["texture", "none"]
    (image,) = (name for name in plain if name.endswith(".png"))
    assert asked[image] != plain[image]
    del document["outputs"]["fill"]  # type: ignore[attr-defined]
    scenario.write_text(json.dumps(document))
    assert files("none")[image] == plain[image]
    for arguments in (["--fill", "learnt"], ["--fill", "texture", "--renderer", "surfel"]):
        refused = CliRunner().invoke(unisim, ["render", str(scenario), "--out", str(tmp_path / "no"), *arguments])
        assert refused.exit_code != 0 and not (tmp_path / "no").exists()
