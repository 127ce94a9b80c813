"""Scaled actors: the edit, and what cameras and LiDARs see of them by each renderer, beside plain references."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import trimesh
from analytic_scene import Stage, analytic_scene, block, drive_of, empty, header_of, sphere, still, union
from random_scene import CONFIGS, PASSES, image_rays, rough, saved
from tiny_drive import tiny_drive
from turning_drive import turning_drive
from whole_drive import bound_to, whole_state

from unisim_blender.core import native
from unisim_blender.core.errors import ScenarioError, SceneError
from unisim_blender.core.geometry import (
    FloatArray,
    Trajectory,
    intersect_boxes,
    invert_pose,
    make_pose,
    quaternion_from_yaw,
)
from unisim_blender.core.json_file import Node
from unisim_blender.core.meshes.hits import MeshActors
from unisim_blender.core.model.checkpoint import load_scene, save_scene
from unisim_blender.core.model.config import ModelConfig
from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.model.volume import Volume
from unisim_blender.core.output.frame_files import moment_labels
from unisim_blender.core.presets import preset
from unisim_blender.core.render.quality import QUALITIES
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.render.tracers.surfels.model import SurfelSet
from unisim_blender.core.render.tracers.surfels.placed import PlacedSurfels, carried
from unisim_blender.core.render.tracers.torch.tracer import TorchBackend
from unisim_blender.core.scenario import apply_scenario, scenario_from_json
from unisim_blender.core.sensors.frames import RenderStats
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.world.captures import Moment
from unisim_blender.core.world.drive import Actor, Appearance, Drive
from unisim_blender.core.world.drive_json import drive_to_json, read_drive
from unisim_street.drawing.image_setup import true_image_path
from unisim_street.paint.materials import Plain
from unisim_street.street import Street, build_street
from unisim_street.street_truth import edit_masks
from unisim_street.tracing.shapes import Cone, Ellipsoid, box
from unisim_street.tracing.surface_hits import look_up
from unisim_street.tracing.trace import Asset, AssetPart, AssetPlacement, make_bundles, trace
from unisim_street.truth import truth_camera, truth_lidar

needs_library = pytest.mark.skipif(native.library() is None, reason="the compiled kernels were not built")
EYE = np.array([-20.0, 0.0, 1.6])
SIZE = np.array([4.0, 2.0, 1.6])
FACTORS = 1.3, 0.8, 1.5


def edited(*edits: dict[str, Any], drive: Drive | None = None) -> Drive:
    document = {"format": "unisim-scenario", "version": 1, "name": "s", "log": "l", "edits": list(edits)}
    van = turning_drive().actors["van"]
    return apply_scenario(
        scenario_from_json(document, Path("/folder/s.json")), drive or turning_drive(), lambda path: {"van": van}
    )


def scaled(actor: Actor, *factors: float) -> Actor:
    x, y, z = factors
    return replace(actor, size_m=actor.appearance_size_m * np.array(factors), scale=(x, y, z))


def by(*factors: float, actor: str = "car") -> dict[str, Any]:
    return {"type": "scale", "actor": actor, "factors": list(factors)}


# the edit


def test_the_box_is_larger_about_its_centre_and_nothing_else_changes() -> None:
    drive = turning_drive()
    now = edited(by(2, 1, 0.5), drive=drive).actors["car"]
    before = drive.actors["car"]
    np.testing.assert_allclose(now.size_m, before.size_m * [2, 1, 0.5], rtol=1e-15)
    assert now.scale == (2.0, 1.0, 0.5) and now.is_scaled and not before.is_scaled
    np.testing.assert_allclose(now.appearance_size_m, before.size_m, rtol=1e-15)
    assert now.world_from_actor is before.world_from_actor and now.appearance == before.appearance and not now.inserted


def test_edits_apply_in_order() -> None:
    size, van = turning_drive().actors["car"].size_m, turning_drive().actors["van"]
    pose = {"position": [9.0, 1.0, 2.0], "yaw_deg": 30}
    # factors multiply, and a move and a retiming leave them
    drive = edited(by(2, 1, 1), {"type": "move", "actor": "car", "pose": pose}, by(1.5, 1, 0.5))
    np.testing.assert_allclose(drive.actors["car"].size_m, size * [3, 1, 0.5], rtol=1e-12)
    drive = edited(by(2, 2, 2), {"type": "retime", "actor": "car", "offset_s": 0.1})
    assert drive.actors["car"].scale == (2.0, 2.0, 2.0)
    # a copy has the scale that its source has by then
    copy = {"type": "duplicate", "actor": "car", "id": "b"}
    assert edited(by(2, 2, 2), copy).actors["b"].scale == (2.0, 2.0, 2.0)
    late = edited(copy, by(2, 2, 2), by(0.5, 1, 1, actor="b")).actors["b"]
    assert late.scale == (0.5, 1.0, 1.0)
    # an inserted actor is as large as in its scene, until an edit scales it
    insert = {"type": "insert", "actor": "van", "id": "c", "pose": pose}
    assert edited(by(2, 2, 2, actor="van"), insert).actors["c"].scale == (1.0, 1.0, 1.0)
    assert edited(insert, by(2, 2, 2, actor="c")).actors["c"].scale == (2.0, 2.0, 2.0)
    # another appearance has its own size, its underside where the scaled one's was
    drive = edited(by(1, 1, 2), {"type": "swap", "actor": "car", "appearance": "van"})
    now = drive.actors["car"]
    np.testing.assert_array_equal(now.size_m, van.size_m)
    assert now.scale == (1.0, 1.0, 1.0)
    under = now.world_from_actor.positions[0, 2] - now.size_m[2] / 2
    assert under == pytest.approx(turning_drive().actors["car"].world_from_actor.positions[0, 2] - size[2])
    assert (
        edited({"type": "swap", "actor": "car", "appearance": "van"}, by(1, 1, 2)).actors["car"].size_m[2]
        == 2 * van.size_m[2]
    )


@pytest.mark.parametrize(
    ("edits", "told"),
    [
        ([by(0.05, 1, 1)], "edits[0].factors: [0.05, 1, 1] must lie between 0.1 and 10 along each axis"),
        ([by(1, -1, 1)], "edits[0].factors: [1, -1, 1] must lie between 0.1 and 10 along each axis"),
        ([by(1, 1, 11)], "edits[0].factors: [1, 1, 11] must lie between 0.1 and 10 along each axis"),
        (
            [by(4, 1, 1), by(4, 1, 1)],
            'edits[1].factors: with the edits before, "car" is scaled by [16.0, 1.0, 1.0], which must lie',
        ),
        ([by(1, 1, 1, actor="bus")], 'edits[0].actor: no actor "bus" in the log'),
        ([{"type": "scale", "actor": "car", "factors": [1, 2]}], "edits[0].factors: [1, 2] is too short"),
        ([{"type": "scale", "actor": "car", "factors": 2}], "edits[0].factors: 2 is not of type 'array'"),
        ([{"type": "scale", "actor": "car"}], "edits[0]: 'factors' is a required property"),
        ([by(1, 1, float("inf"))], "edits[0].factors[2]"),
    ],
)
def test_what_is_refused(edits: list[dict[str, Any]], told: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        edited(*edits)
    assert told in str(caught.value) and "\n" not in str(caught.value)


def test_labels_and_the_drives_document_have_the_size() -> None:
    drive = edited(by(2, 1, 1), drive=tiny_drive())
    boxes = {box["id"]: box["size_m"] for box in moment_labels(drive, Moment.of_frame(drive, 1, (), ()))["boxes"]}
    assert boxes["car"] == [9.0, 1.9, 1.5] and boxes["cone"] == [0.4, 0.4, 0.8]
    # what decides whether a rendered frame still holds, and says nothing of a drive in which nobody is scaled
    document = drive_to_json(drive)
    assert read_drive(Node(document, "drive", SceneError)).actors["car"].scale == (2.0, 1.0, 1.0)
    assert document["actors"]["car"]["scale"] == [2.0, 1.0, 1.0] and "scale" not in document["actors"]["cone"]


def test_what_a_smaller_box_leaves_is_empty() -> None:
    drive = turning_drive()
    (box,) = whole_state(edited(by(0.5, 0.5, 0.5, actor="van")), drive).removed_boxes
    assert box.size_m.tolist() == [6.0, 2.2, 2.5]
    assert whole_state(edited(by(0.5, 0.5, 0.5)), drive).removed_boxes == whole_state(drive).removed_boxes == ()


# fields, by torch


def aimed(actor: Actor, n: int, times: FloatArray, seed: int = 0) -> FloatArray:
    """Unit directions (n, 3) from the eye to places in an actor's box."""
    rng = np.random.default_rng(seed)
    poses = actor.world_from_actor.at(times)
    places = (
        np.einsum("nij,nj->ni", poses[:, :3, :3], rng.uniform(-0.45, 0.45, (n, 3)) * actor.size_m) + poses[:, :3, 3]
    )
    return (places - EYE) / np.linalg.norm(places - EYE, axis=1, keepdims=True)


def moving(size: FloatArray = SIZE, uid: str = "car") -> Actor:
    trajectory = Trajectory(
        np.array([0.0, 0.5]), np.array([[-8.0, -1.0, 1.2], [-4.0, 2.0, 1.2]]), quaternion_from_yaw(np.array([0.3, 1.1]))
    )
    return still(uid, [0, 0, 0], size, world_from_actor=trajectory, is_moving=True)


def first_inside(actor: Actor, body: Any, directions: FloatArray, times: FloatArray) -> FloatArray:
    """Where rays from the eye (N,) first are in a field's negative part: asked every millimetre, at the
    place without scale."""
    t = np.arange(8, 24, 0.001)
    out = np.full(len(directions), np.inf)
    for i, (d, time) in enumerate(zip(directions, times, strict=True)):
        pose = actor.world_from_actor.at(time)
        world = EYE + t[:, None] * d
        field = ((world - pose[:3, 3]) @ pose[:3, :3]) / np.array(actor.scale)
        inside = np.flatnonzero(body(torch.tensor(field)).numpy() < 0)
        out[i] = t[inside[0]] if len(inside) else np.inf
    return out


@pytest.mark.parametrize(
    "body", [block([3.6, 1.6, 1.2]), union(sphere([-0.8, 0, 0], 0.7), sphere([0.9, 0.1, 0.1], 0.6))]
)
@pytest.mark.parametrize("factors", [(1.3, 1.3, 1.3), FACTORS, (0.5, 2.0, 1.0)])
def test_depths_of_a_scaled_field_are_those_of_a_query_at_every_place(body: Any, factors: tuple[float, ...]) -> None:
    actor = scaled(moving(), *factors)
    stage = Stage(analytic_scene(empty, {"car": (body, SIZE)}), drive_of([actor]))
    times = np.random.default_rng(1).uniform(0, 0.5, 150)
    directions = aimed(actor, 150, times)
    exact = first_inside(actor, body, directions, times)
    traced = stage.trace(EYE, directions, times, fine=8.0)
    hit = np.isfinite(exact)
    assert hit.sum() > 60
    error = np.abs(traced.depth_m.numpy()[hit] - exact[hit])
    assert np.median(error) < 0.01 and np.quantile(error, 0.9) < 0.05
    clear = ~hit & (traced.opacity.numpy() < 0.5)
    assert clear.sum() >= 0.9 * (~hit).sum()


def test_normals_go_through_the_inverse_of_the_scale() -> None:
    actor = scaled(still("car", [-13, 0, 1.6], [3.0, 3.0, 3.0], yaw=0.5), 1.5, 1.0, 0.6)
    scene = Stage(analytic_scene(empty, {"car": (sphere([0, 0, 0], 1.2), np.full(3, 3.0))}), drive_of([actor]))
    rays = image_rays(scene.drive, up=1).flat()
    tracer = bound_to(TorchBackend(scene.as_scene(), QUALITIES["reference"]), scene.drive)
    maps = tracer.trace(rays, PASSES, True, None, RenderStats()).maps
    mine = maps["instance"] == 1
    assert mine.sum() > 60
    pose = actor.world_from_actor.at(0.0)
    place = (rays.origins + rays.directions * maps["depth"][:, None] - pose[:3, 3])[mine] @ pose[:3, :3]
    # of an ellipsoid with half axes 1.2 times the factors
    exact = place / np.array(actor.scale) ** 2 @ pose[:3, :3].T
    wrong = place @ pose[:3, :3].T
    cosines = [(n * maps["normal"][mine]).sum(-1) / np.linalg.norm(n, axis=-1) for n in (exact, wrong)]
    assert np.quantile(cosines[0], 0.1) > 0.995 and np.median(cosines[1]) < 0.98


def rough_scene(config: ModelConfig, drive: Drive) -> SceneModel:
    torch.manual_seed(2)
    model = SceneModel(
        config, Volume(make_pose(np.array([-60.0, -40.0, -40.0]), quaternion_from_yaw(0.1)), np.full(3, 100.0)),
        tuple(sorted(drive.actors)), ("front",),
    )  # fmt: skip
    with torch.no_grad():
        rough(model)
        model.occupancy.values.zero_()
    return model.requires_grad_(False).eval()


DENSITIES = {
    "logistic": dataclasses.replace(preset("tiny").model, light="fixed"),
    "unisim": CONFIGS["paper"],
    "volume": dataclasses.replace(preset("tiny").model, light="fixed", density="volume"),
}


@pytest.mark.parametrize("density", DENSITIES)
def test_a_field_twice_as_large_from_twice_as_far_looks_the_same(density: str) -> None:
    """For every density: optical depths are of the field's own metres, and samples are placed alike."""
    config, centre = DENSITIES[density], np.array([-6.0, -3, 1])
    near = still("car", centre, SIZE, yaw=0.4)
    far = scaled(near, 2.0, 2.0, 2.0)
    stages = [Stage(rough_scene(config, drive_of([near])), drive_of([actor])) for actor in (near, far)]
    eye = centre + [-6.0, 1.5, 1.0]
    rng = np.random.default_rng(0)
    directions = centre + rng.uniform(-1, 1, (300, 3)) * [1.5, 1.0, 0.8] - eye
    one = stages[0].trace(eye, directions, fine=1.0)
    other = stages[1].trace(centre + 2 * (eye - centre), directions, fine=1.0)
    assert float(one.opacity.mean()) > 0.1 and float(one.depth_m.std()) > 0.1
    np.testing.assert_allclose(other.opacity, one.opacity, atol=2e-3)
    np.testing.assert_allclose(other.feature, one.feature, atol=5e-3)
    np.testing.assert_allclose(other.depth_m, 2 * one.depth_m, rtol=2e-3, atol=1e-4)


def test_who_is_not_scaled_keeps_its_bits() -> None:
    """By the density whose optical depths have lengths in them, in a drive in which another one is scaled."""
    a, b = still("a", [-6, 2.5, 1.2], SIZE, 0.3), still("b", [-6, -4.5, 1.2], SIZE)
    scene = rough_scene(DENSITIES["unisim"], drive_of([a, b]))
    rays = towards(a.world_from_actor.positions[0], EYE, np.array([1.5, 0.9, 0.7]), 400)
    traced = [Stage(scene, drive_of([a, other])).trace(EYE, rays.directions) for other in (b, scaled(b, 1.4, 1.2, 0.8))]
    assert len(traced[0].opacity.unique()) > 50
    for name in ("feature", "depth_m", "opacity"):
        assert torch.equal(getattr(traced[0], name), getattr(traced[1], name)), name


# fields, by the kernels


CARS = [
    scaled(still("near", (-9, 0, 0.8), (4.0, 1.8, 1.6), yaw=-0.9), 1.3, 0.7, 1.6),
    scaled(still("cone", (-12, -2, 0.4), (0.6, 0.6, 0.8)), 3.0, 3.0, 3.0),
    still("car", (-8, 3, 0.8), (4.0, 1.8, 1.6), yaw=0.4),
]


def share_alike(a: Any, b: Any, within: float) -> float:
    a, b = (np.asarray(x, float).reshape(len(x), -1) for x in (a, b))
    return float((np.isclose(a, b, rtol=within, atol=within) | (a == b)).all(1).mean())


@needs_library
@pytest.mark.parametrize("name", CONFIGS)
def test_the_kernels_say_what_torch_says(tmp_path: Path, name: str) -> None:
    drive = drive_of(CARS)
    folder = saved(tmp_path / "scene", CONFIGS[name])
    rays = image_rays(drive)
    compiled = bound_to(CompiledBackend(CompiledScene(folder), QUALITIES["reference"]), drive)
    fast = compiled.trace(rays, PASSES, True, None, RenderStats())
    slow = bound_to(TorchBackend(load_scene(folder), QUALITIES["reference"]), drive).trace(
        rays, PASSES, True, None, RenderStats()
    )
    assert {1, 2, 3} <= set(np.unique(slow.maps["instance"]))
    assert share_alike(fast.feature, slow.feature, 2e-3) > 0.98
    assert share_alike(fast.opacity, slow.opacity, 2e-3) > 0.98
    for kind in PASSES:
        assert share_alike(fast.maps[kind], slow.maps[kind], 1e-2) > 0.975, kind


def alone(folder: Path) -> Path:
    """A scene in which nothing but actors stops a ray."""
    drive = drive_of([still("car", (-8, 1, 0.8), SIZE, yaw=0.4)])
    model = rough_scene(DENSITIES["logistic"], drive)
    save_scene(folder, header_of(model, drive, folder), model)
    return folder


def towards(centre: FloatArray, eye: FloatArray, spread: FloatArray, n: int = 2000) -> Rays:
    """Rays from an eye to places about a centre."""
    directions = centre + np.random.default_rng(0).uniform(-1, 1, (n, 3)) * spread - eye
    return Rays(np.tile(eye, (n, 1)), directions / np.linalg.norm(directions, axis=1, keepdims=True), np.full(n, 0.2))


@needs_library
@pytest.mark.parametrize("quality", ["fast", "balanced"])
def test_surfaces_are_followed_alike_whatever_the_scale(tmp_path: Path, quality: str) -> None:
    """Marching bounds steps by the field's distances: twice as large, seen from twice as far, it takes
    as many samples."""
    scene = CompiledScene(alone(tmp_path / "scene"))
    centre = np.array([-8.0, 1, 0.8])
    near = still("car", centre, SIZE, yaw=0.4)
    found, spent = [], []
    for actor, k in ((near, 1.0), (scaled(near, 2.0, 2.0, 2.0), 2.0)):
        rays, stats = (
            towards(centre, centre + k * np.array([-5.0, 1.5, 1.0]), k * np.array([1.8, 0.9, 0.7])),
            RenderStats(),
        )
        tracer = bound_to(CompiledBackend(scene, QUALITIES[quality]), drive_of([actor]))
        found.append(tracer.trace(rays, {"depth", "instance", "normal"}, False, None, stats))
        spent.append(stats.samples_spent)
    mine = (found[0].maps["instance"] == 1) & (found[1].maps["instance"] == 1)
    assert mine.mean() > 0.3
    assert share_alike(found[1].maps["depth"][mine], 2 * found[0].maps["depth"][mine], 2e-4) > 0.97
    assert share_alike(found[1].maps["normal"][mine], found[0].maps["normal"][mine], 1e-2) > 0.97
    assert abs(spent[1] / spent[0] - 1) < 0.02


@needs_library
@pytest.mark.parametrize("factors", [FACTORS, (0.3, 0.3, 0.3), (4.0, 1.0, 1.0)])
def test_marching_meets_the_surface_that_dense_samples_meet(tmp_path: Path, factors: tuple[float, ...]) -> None:
    folder, centre = alone(tmp_path / "scene"), np.array([-8.0, 1, 0.8])
    actor = scaled(still("car", centre, SIZE, yaw=0.4), *factors)
    drive, rays = drive_of([actor]), towards(centre, centre + [-9.0, 2.0, 1.0], 0.4 * actor.size_m)
    slow = bound_to(TorchBackend(load_scene(folder), QUALITIES["reference"]), drive)
    slow.quality = replace(slow.quality, samples=8.0)
    fast = bound_to(CompiledBackend(CompiledScene(folder)), drive)
    ours, theirs = (tracer.trace(rays, {"depth", "instance"}, False, None, RenderStats()) for tracer in (fast, slow))
    both = (ours.maps["instance"] == 1) & (theirs.maps["instance"] == 1)
    assert both.mean() > 0.3
    assert ((ours.maps["instance"] == 1) != (theirs.maps["instance"] == 1)).mean() < 0.02
    error = np.abs(ours.maps["depth"][both] - theirs.maps["depth"][both])
    assert np.median(error) < 0.01 and np.quantile(error, 0.9) < 0.05


@needs_library
def test_the_kernels_leave_who_is_not_scaled(tmp_path: Path) -> None:
    folder = saved(tmp_path / "scene", CONFIGS["tiny"])
    plain = [*CARS[:2], CARS[2]]
    drives = (
        drive_of([scaled(actor, 1.0, 1.0, 1.0) for actor in plain]),
        drive_of([scaled(plain[0], 1.0, 1.0, 1.0), *plain[1:]]),
    )
    found = [
        bound_to(CompiledBackend(CompiledScene(folder), QUALITIES[quality]), drive).trace(
            image_rays(drive), PASSES, True, None, RenderStats()
        )
        for quality in ("balanced", "reference")
        for drive in drives
    ]
    for a, b in (found[:2], found[2:]):
        same = (np.asarray(a.feature) == np.asarray(b.feature)).all(1)
        # the cone alone is scaled, and covers a small part
        assert 0.6 < same.mean() < 1.0
        assert (a.maps["instance"][same] == 3).sum() + (a.maps["instance"][same] == 1).sum() > 20


# meshes


@pytest.fixture(scope="module")
def cube(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cube of 2 m."""
    path = tmp_path_factory.mktemp("mesh") / "cube.ply"
    trimesh.creation.box([2.0, 2.0, 2.0]).export(path)
    return path


def test_a_scaled_mesh_is_the_mesh_of_that_size(cube: Path) -> None:
    actor = scaled(moving(np.full(3, 2.0), "cube"), *FACTORS)
    actor = replace(actor, appearance=Appearance("cube", mesh=str(cube)))
    times = np.random.default_rng(1).uniform(0, 0.5, 200)
    directions = aimed(actor, 200, times)
    mesh_hits = MeshActors([actor]).hit_by_rays(Rays(np.tile(EYE, (200, 1)), directions, times), 0.5)
    assert mesh_hits is not None and len(mesh_hits.ray) == 200
    poses = actor.world_from_actor.at(times)
    near, _ = intersect_boxes(np.tile(EYE, (200, 1)), directions, invert_pose(poses)[:, None], actor.size_m[None])
    np.testing.assert_allclose(mesh_hits.t, near[:, 0], atol=1e-6)
    local = np.einsum("nji,nj->ni", poses[:, :3, :3], mesh_hits.normals)
    np.testing.assert_allclose(np.sort(np.abs(local), axis=1), np.tile([0.0, 0, 1], (200, 1)), atol=1e-6)
    # what lies nearer than near_m along the ray in the world is passed over
    behind = MeshActors([actor]).hit_by_rays(Rays(np.tile(EYE, (200, 1)), directions, times), float(near.max()) + 0.01)
    assert behind is not None and (behind.t > near.max()).all()


# surfels


def surfels(n: int = 300) -> SurfelSet:
    rng = np.random.default_rng(4)
    middle = rng.uniform(-0.45, 0.45, (n, 1, 3)) * SIZE
    vertices = middle + rng.normal(0, 0.2, (n, 3, 3))
    normals = np.cross(vertices[:, 1] - vertices[:, 0], vertices[:, 2] - vertices[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    ones = np.ones(n, bool)
    return SurfelSet(
        vertices.reshape(-1, 3).astype(np.float32), normals.astype(np.float32), np.ones(n, np.float32),
        np.zeros((n, 3, 3), np.uint8), ones, ones,
    )  # fmt: skip


def test_scaled_surfels_are_faces_with_scaled_corners() -> None:
    nothing, faces = surfels().of(np.zeros(300, bool)), surfels()
    actor = moving()
    factors = np.array(FACTORS)
    larger = (faces.vertices * factors.astype(np.float32)).astype(np.float32)
    corners = larger.reshape(-1, 3, 3).astype(float)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    by_hand = replace(faces, vertices=larger, normals=normals.astype(np.float32))
    size = actor.size_m * factors
    times = np.random.default_rng(1).uniform(0, 0.5, 400)
    ours = PlacedSurfels(nothing, [(scaled(actor, *FACTORS), faces)])
    theirs = PlacedSurfels(nothing, [(replace(actor, size_m=size), by_hand)])
    rays = Rays(np.tile(EYE, (400, 1)), aimed(scaled(actor, *FACTORS), 400, times), times)
    a, b = ours.first(rays, 0.5), theirs.first(rays, 0.5)
    assert (a.owner == 0).sum() > 200
    np.testing.assert_array_equal(a.face, b.face)
    np.testing.assert_allclose(a.t, b.t, rtol=1e-5)
    np.testing.assert_allclose(ours.normals(a, rays), theirs.normals(b, rays), atol=1e-4)


def test_points_of_a_scaled_actor_go_there_and_back() -> None:
    actor = scaled(moving(), *FACTORS)
    rng = np.random.default_rng(0)
    points, times = rng.normal(size=(50, 3)), rng.uniform(0, 0.5, 50)
    there = carried(actor, times, points)
    np.testing.assert_allclose(carried(actor, times, there, back=True), points, atol=1e-12)
    poses = actor.world_from_actor.at(times)
    np.testing.assert_allclose(
        np.einsum("nji,nj->ni", poses[:, :3, :3], there - poses[:, :3, 3]), points * FACTORS, atol=1e-12
    )


# the street's ground truth


def paint() -> Plain:
    return Plain("#808080")


def asset(factors: tuple[float, float, float]) -> Asset:
    """A box, a ball beside it and a cylinder on it, whose shapes are scaled by hand; a cylinder keeps round,
    so x and y agree."""
    x, y, z = factors
    lifted = np.eye(4)
    lifted[:3, 3] = [0.0, 0.0, 0.5 * z]
    aside = np.eye(4)
    aside[:3, 3] = [1.2 * x, 0.2 * y, 0.0]
    return Asset(
        "thing",
        (
            AssetPart(box([-x, -0.6 * y, -0.5 * z], [x, 0.6 * y, 0.5 * z]), paint()),
            AssetPart(Ellipsoid([0.8 * x, 0.5 * y, 0.4 * z]), paint(), aside),
            AssetPart(Cone(0.5 * x, 0.3 * x, 0.6 * z), paint(), lifted),
        ),
    )


def test_a_scaled_asset_is_one_whose_shapes_are_scaled() -> None:
    factors = (1.5, 1.5, 0.7)
    trajectory = moving().world_from_actor
    times = np.repeat(np.random.default_rng(1).uniform(0, 0.5, 4), 64)
    shape = replace(moving(), size_m=np.array([4.0, 2.0, 1.6]) * factors)
    directions = aimed(shape, 256, times)
    bundles = make_bundles(*(x.reshape(4, 64, *x.shape[1:]) for x in (np.tile(EYE, (256, 1)), directions, times)))
    answers = []
    for placement in (
        AssetPlacement("a", asset((1.0, 1.0, 1.0)), trajectory, scale=np.array(factors)),
        AssetPlacement("a", asset(factors), trajectory),
    ):
        hits = trace([placement], bundles)
        flat = [x.reshape(-1, *x.shape[2:]) for x in (bundles.origins, bundles.directions, bundles.time_s)]
        o, d, t = flat
        answers.append((hits, look_up([placement], hits, o, d, t, 1e-3)))
    (a, seen_a), (b, seen_b) = answers
    assert 60 < np.isfinite(a.t).sum() and len(np.unique(a.part)) == 4
    np.testing.assert_allclose(a.t, b.t, rtol=1e-9)
    np.testing.assert_array_equal(a.part, b.part)
    for name in ("points", "normals", "soft_normals", "cosine"):
        np.testing.assert_allclose(getattr(seen_a, name), getattr(seen_b, name), atol=1e-6, err_msg=name)
    np.testing.assert_allclose(seen_a.local * factors, seen_b.local, atol=1e-9)


@pytest.fixture(scope="module")
def street() -> Street:
    return build_street(seed=3, frames=6, width=160, height=90)


def test_the_street_shows_a_larger_car(street: Street) -> None:
    lead, size = "car-01", street.drive.actors["car-01"].size_m
    drive = edited(by(1.4, 1.4, 1.4, actor=lead), drive=street.drive)
    plain, frame = (truth_camera(street, d, "front_camera", 3) for d in (street.drive, drive))
    assert plain.instance is not None and frame.instance is not None
    number = frame.instances.index(lead) + 1
    heights = [np.ptp(np.nonzero(f.instance == number)[0]) for f in (plain, frame)]
    assert heights[1] > 1.25 * heights[0]
    sweeps = [truth_lidar(street, d, "pandar64", 3) for d in (street.drive, drive)]
    ranges = [sweep.depth_m[(sweep.instance == number) & sweep.returned] for sweep in sweeps]
    # the rear comes nearer by 0.2 of the length
    assert np.percentile(ranges[0], 5) - np.percentile(ranges[1], 5) == pytest.approx(0.2 * size[0], abs=0.1)
    masks = edit_masks(street, street.drive, drive, "front_camera", 3, (2, 4))
    assert masks.edited[frame.instance == number].mean() > 0.95
    assert masks.shadow.any()


def test_an_image_that_cycles_drew_is_kept_under_another_name(street: Street, tmp_path: Path) -> None:
    scaled_drive = edited(by(1.4, 1.0, 1.0, actor="car-01"), drive=street.drive)
    names = {
        true_image_path(tmp_path, street, drive, "front_camera", 3, None).name
        for drive in (street.drive, scaled_drive, edited(by(1.0, 1.0, 1.0, actor="car-01"), drive=street.drive))
    }
    assert len(names) == 2
