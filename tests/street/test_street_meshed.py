"""The street of triangles beside the street of solids; its paint in images; triangles cut by boxes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from unisim_blender.core.cli.main import run
from unisim_blender.core.data.images import resize_image
from unisim_blender.core.errors import LogError, OutputError, ScenarioError
from unisim_blender.core.geometry import FloatArray, make_pose, points_in_box
from unisim_blender.core.prepare.selection import spread_frames
from unisim_blender.core.scenario import apply_scenario, load_scenario, scenario_from_json
from unisim_blender.core.world.drive import Box, Drive
from unisim_street import street_truth
from unisim_street.assets.facade import Facade, Storey
from unisim_street.assets.furniture import stand
from unisim_street.assets.meshed import tessellated
from unisim_street.commands.synth import command
from unisim_street.drawing.atlas import AssetModel, Detail, inside, outside, painted
from unisim_street.drawing.image_setup import keep_image, lacks_images, true_image, true_image_path
from unisim_street.paint.materials import Banded, SurfacePoints
from unisim_street.street import Street, build_street, load_street
from unisim_street.street_truth import StreetTruth, edit_masks
from unisim_street.tracing.shapes import Cone, Ellipsoid, Solid, TracedTriangles, box, hull
from unisim_street.tracing.trace import Asset, make_bundles, trace
from unisim_street.truth import make_world, truth_camera, truth_lidar
from unisim_street.usual_edits import usual_edits, write_scenarios
from unisim_street.write import write_log

CAMERA, LIDAR = "front_camera", "pandar64"
SIZE: dict[str, Any] = {"seed": 3, "frames": 4, "width": 64, "height": 36}


@pytest.fixture(scope="module")
def solid() -> Street:
    return build_street(**SIZE)


@pytest.fixture(scope="module")
def street() -> Street:
    return build_street(**SIZE, engine="cycles", paths=4)


STOREYS = (Storey(0.0, 0.2, 1.0, 0.3, 1.0, 0.6, 2, 0.3), Storey(1.2, 1.4, 2.0, 0.2, 0.8, 0.4, 3, 0.15))
SOLIDS: dict[str, tuple[Solid, float]] = {
    "box": (box((-0.5, -0.2, 0.1), (0.6, 0.9, 0.7)), 1e-6),
    "hull": (hull(np.array([[0, 0, 0], [1, 0, 0], [0, 1.2, 0], [0.2, 0.3, 0.9], [0.8, 0.7, 0.5]])), 1e-6),
    "facade": (Facade(2.6, 1.5, 2.3, STOREYS), 1e-6),
    "cone": (Cone(0.5, 0.3, 1.0), 0.01),
    "ellipsoid": (Ellipsoid((0.5, 0.4, 0.3)), 0.02),
}  # fmt: skip


@pytest.mark.parametrize("name", SOLIDS)
def test_triangles_stand_where_the_solid_does(name: str) -> None:
    shape, sagitta = SOLIDS[name]
    surface = tessellated(shape)
    np.testing.assert_allclose([surface.low, surface.high], [shape.low, shape.high], atol=max(sagitta, 1e-6))
    rng = np.random.default_rng(5)
    aim = rng.uniform(shape.low, shape.high, (3000, 3))
    origins = (shape.low + shape.high) / 2 + 4.0 * unit(rng.standard_normal((3000, 3)))
    directions = unit(aim - origins)
    exact = shape.intersect(origins, directions, np.zeros(3000))
    t = surface.intersect(origins, directions, np.zeros(3000))
    both = np.isfinite(exact) & np.isfinite(t)
    assert both.sum() > 1500 and (np.isfinite(exact) == np.isfinite(t)).mean() > 0.97
    assert np.quantile(np.abs(t[both] - exact[both]), 0.95) <= max(3 * sagitta, 1e-5)
    points = origins[both] + t[both, None] * directions[both]
    normals, soft = surface.faced(points, directions[both])
    assert (normals * directions[both]).sum(1).max() <= 1e-6
    np.testing.assert_allclose(np.linalg.norm(soft, axis=1), 1, atol=1e-6)
    middles = surface.corners.astype(np.float64).mean(1)
    out = surface.face_normals.astype(np.float64)
    back = shape.intersect(middles + 3.0 * out, -out, np.zeros(len(middles)))
    first = np.isfinite(back) & (np.abs(back - 3.0) < max(2 * sagitta, 1e-6))
    there = middles[first] + (3.0 - back[first, None]) * out[first]
    assert first.mean() > (0.4 if name == "facade" else 0.99)  # the facade's cheeks stand behind its front
    assert ((shape.normals(there) * out[first]).sum(1) > 0.8).all()


def unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))


def test_lidar_of_both_streets_differs_by_what_is_finer(solid: Street, street: Street) -> None:
    a, b = (truth_lidar(s, s.drive, LIDAR, 1) for s in (solid, street))
    both = a.returned & b.returned
    assert both.sum() > 0.9 * a.returned.sum()
    apart = np.abs(a.depth_m - b.depth_m)[both]
    assert np.median(apart) < 1e-4 and (apart < 0.1).mean() > 0.85  # cars are rounder, crowns have leaves
    same = both & (np.abs(a.depth_m - b.depth_m) < 1e-4)
    assert np.median(np.abs(a.intensity - b.intensity)[same]) < 1e-5
    np.testing.assert_allclose(a.intensity[same].mean(), b.intensity[same].mean(), rtol=0.05)


def test_silhouettes_of_both_streets_agree(solid: Street, street: Street) -> None:
    a, b = (truth_camera(s, s.drive, CAMERA, 1, samples=1) for s in (solid, street))
    assert a.instance is not None and b.instance is not None and a.instances == b.instances
    here, there = a.instance > 0, b.instance > 0
    assert (here & there).sum() / (here | there).sum() > 0.85
    assert (a.instance == b.instance)[here & there].mean() > 0.97


def test_everything_stays_within_its_box(street: Street) -> None:
    for uid, actor in street.drive.actors.items():
        corners = np.concatenate([part.corners() for part in street.assets[uid].parts])
        assert (np.abs(corners) <= actor.size_m / 2 + 1e-3).all(), uid


def test_masks_of_an_edit_are_those_of_the_street_of_solids(solid: Street, street: Street) -> None:
    masks = []
    for s in (solid, street):
        edited = without(s.drive, "car-01")
        masks.append(edit_masks(s, s.drive, edited, CAMERA, 1, train_frames=(0, 2)))
    for kind, least in (("edited", 0.8), ("shadow", 0.3)):
        a, b = (getattr(mask, kind) for mask in masks)
        assert (a & b).sum() / (a | b).sum() > least, kind


def without(drive: Drive, uid: str) -> Drive:
    return replace(drive, actors={name: actor for name, actor in drive.actors.items() if name != uid})


def test_paint_in_images_is_the_material(street: Street) -> None:
    material = Banded("#d9480f", "#efece4", ((0.30, 0.44),))
    part = stand(Cone(0.4, 0.2, 1.0), material, np.array([1.0, 2.0, 3.0]), (0.0, 0.0, 0.0))
    part = replace(part, shape=tessellated(part.shape))
    model = painted(Asset("cone", (part,)), Detail(0.002, 1.0))
    rng = np.random.default_rng(0)
    face = rng.integers(0, len(model.corners), 500)
    weight = rng.dirichlet(np.ones(3), 500)
    points = np.einsum("nk,nkc->nc", weight, model.corners[face]) - [1.0, 2.0, 3.0]
    uv = np.einsum("nk,nkc->nc", weight, model.uv[face])
    page = np.array([model.surfaces[surface][0] for surface in model.surface[face]])
    normals = np.tile([0.0, 0.0, 1.0], (500, 1))
    true = material(SurfacePoints(points, points, normals, np.full(500, 0.002), np.ones(500))).albedo
    images = [p[..., :3] for p in model.pages]
    row = [min(int(v * images[p].shape[0]), images[p].shape[0] - 1) for p, v in zip(page, uv[:, 1], strict=True)]
    column = [int(u * images[p].shape[1]) for p, u in zip(page, uv[:, 0], strict=True)]
    drawn = np.array([images[p][r, c] for p, r, c in zip(page, row, column, strict=True)]) / 255
    linear = np.where(drawn <= 0.04045, drawn / 12.92, ((drawn + 0.055) / 1.055) ** 2.4)
    edge = np.abs(points[:, 2, None] - [0.30, 0.44]).min(1) < 0.01
    assert np.abs(linear - true)[~edge].max() < 0.01 and np.ptp(true[:, 2]) > 0.3


def test_cutting_parts_a_model_without_losing_any_of_it() -> None:
    part = stand(box((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)), Banded("#d9480f", "#efece4", ()), np.zeros(3), (0, 0, 0))
    model = painted(Asset("block", (replace(part, shape=tessellated(part.shape)),)), Detail(0.05, 1.0))
    pose = make_pose(np.array([0.6, 0.3, 0.9]), np.array([0.9, 0.1, 0.3, 0.2]) / np.linalg.norm([0.9, 0.1, 0.3, 0.2]))
    hole = Box(pose, np.array([1.0, 1.4, 0.8]))
    within, beyond = inside(model, hole), outside(model, (hole,))
    assert area(within) > 0.1 and area(within) + area(beyond) == pytest.approx(area(model), rel=1e-5)
    assert points_in_box(within.corners.mean(1).astype(np.float64), pose, np.asarray(hole.size_m) + 1e-5).all()
    assert not points_in_box(beyond.corners.mean(1).astype(np.float64), pose, np.asarray(hole.size_m) - 1e-4).any()
    # a corner that cutting made takes its place in the image from those beside it
    z_of_v = np.polyfit(*side(model), 1)
    np.testing.assert_allclose(np.polyval(z_of_v, side(beyond)[0]), side(beyond)[1], atol=1e-4)


def area(model: AssetModel) -> float:
    a, b, c = (model.corners[:, k].astype(np.float64) for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def side(model: AssetModel) -> tuple[FloatArray, FloatArray]:
    """v and z of the corners of the face that looks along x."""
    mine = (model.normals[:, :, 0] > 0.9).all(1)
    return model.uv[mine, :, 1].reshape(-1).astype(np.float64), model.corners[mine, :, 2].reshape(-1).astype(np.float64)


def test_removed_and_copied_boxes_cut_triangles_as_they_cut_rays(street: Street) -> None:
    world_box = Box(make_pose(np.array([20.0, -9.0, 3.0]), np.array([1.0, 0.0, 0.0, 0.0])), np.array([6.0, 3.0, 2.0]))
    cut = replace(street.drive, actors={}, static_removals=(world_box,))
    world = make_world(street, cut)
    static = world.placements[1]
    kept = outside(plain(static.asset), static.holes)
    rng = np.random.default_rng(2)
    aim = np.array([20.0, -9.0, 3.0]) + street.drive.world_origin + rng.uniform(-4, 4, (1000, 3)) * [1, 0.3, 0.5]
    origins = np.array([18.0, 0.0, 2.0]) + rng.uniform(-0.5, 0.5, (1000, 3))
    directions = unit(aim - origins)
    traced = trace([static], make_bundles(origins[None], directions[None], np.zeros((1, 1000)))).t[0]
    meshed = TracedTriangles(kept.corners).intersect(origins, directions, np.zeros(1000))
    whole = trace([replace(static, holes=())], make_bundles(origins[None], directions[None], np.zeros((1, 1000)))).t[0]
    assert (np.abs(whole - traced) > 0.1).sum() > 50
    assert (np.isclose(traced, meshed, atol=1e-4) | (np.isinf(traced) & np.isinf(meshed))).mean() > 0.99


def plain(asset: Asset) -> AssetModel:
    """An asset's triangles, near the place that the test looks at, without any paint."""
    return painted(asset, Detail(1.0, 1.0))


def test_usual_edits_are_scenarios_of_any_street(tmp_path: Path) -> None:
    for seed in range(4):
        edits = usual_edits(build_street(seed=seed, frames=4))
        assert set(edits) == {"removal", "insertion", "cones", "retiming", "shift-0.5m", "shift-2m", "shift-3m"}
    street = build_street(seed=3, frames=4)
    for path in write_scenarios(street, tmp_path, tmp_path):
        assert load_scenario(path).log_path == tmp_path.resolve()
    assert spread_frames(street.drive, 8) == (1, 3) and spread_frames(street.drive, 1) == (1,)
    box_of = street.drive.actors["car-03"]
    inside_it = replace(box_of, world_from_actor=street.drive.cameras[CAMERA].world_from_camera)
    assert spread_frames(replace(street.drive, actors={"car-03": replace(inside_it, end_s=0.12)}), 8) == (3,)


@pytest.mark.parametrize("seed", range(3))
def test_the_usual_insertion_has_a_look_that_was_recorded_and_is_seen(seed: int) -> None:
    street = build_street(seed=seed, frames=20, width=160, height=90, cameras=(CAMERA,))
    (edit,) = usual_edits(street)["insertion"]
    document = {"format": "unisim-scenario", "version": 1, "name": "in", "log": ".", "edits": [edit]}
    edited = apply_scenario(scenario_from_json(document, Path("in.json")), street.drive, lambda path: {})

    def pixels(drive: Drive, uid: str) -> int:
        """The most in any of a few frames."""
        frames = [truth_camera(street, drive, CAMERA, frame, samples=1) for frame in (0, 10, 18)]
        shown = [np.asarray(f.instance) == f.instances.index(uid) + 1 for f in frames if uid in f.instances]
        return max((int(np.count_nonzero(where)) for where in shown), default=0)

    assert pixels(street.drive, edit["actor"]) > 50
    assert pixels(edited, "inserted") > 50


def test_images_are_kept_by_what_they_show(street: Street, tmp_path: Path) -> None:
    def path(drive: Drive, frame: int = 1, width: int | None = None) -> Path:
        return true_image_path(tmp_path, street, drive, CAMERA, frame, width)

    drive = street.drive
    unseen = replace(drive, actors={uid: actor for uid, actor in drive.actors.items()}, name="the same by another name")
    assert path(drive) == path(unseen)
    camera = drive.cameras[CAMERA]
    others = [path(drive, 2), path(drive, 1, 32), path(without(drive, "car-01"))]
    late = replace(drive.actors["car-01"], start_s=5.0, end_s=6.0)
    assert path(without(drive, "car-01")) == path(replace(drive, actors={**drive.actors, "car-01": late}))
    others.append(path(replace(drive, static_removals=(Box(np.eye(4), np.ones(3)),))))
    others.append(path(replace(drive, cameras={CAMERA: replace(camera, model=replace(camera.model, cx=30.0))})))
    assert len({path(drive), *others}) == 1 + len(others)
    assert lacks_images(tmp_path, street, (drive,), (CAMERA,), (1,), None)
    with pytest.raises(OutputError, match="not drawn yet"):
        true_image(tmp_path, street, drive, CAMERA, 1, None)
    rgb = np.random.default_rng(0).integers(0, 256, (36, 64, 3)).astype(np.uint8)
    keep_image(path(drive), rgb)
    np.testing.assert_array_equal(true_image(tmp_path, street, drive, CAMERA, 1, None), rgb)
    assert not lacks_images(tmp_path, street, (drive,), (CAMERA,), (1,), None)


def test_smaller_truths_are_made_of_drawn_ones(street: Street, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int | None] = []
    monkeypatch.setattr(street_truth, "draw_truths", lambda path, wanted, width, progress: asked.append(width))
    drive = street.drive
    rgb = np.random.default_rng(0).integers(0, 256, (SIZE["height"], SIZE["width"], 3)).astype(np.uint8)
    keep_image(true_image_path(tmp_path, street, drive, CAMERA, 1, None), rgb)

    def truth(width: int | None) -> StreetTruth:
        return StreetTruth(tmp_path, street, drive, drive, (0,), (CAMERA,), width)

    half = SIZE["width"] // 2
    truth(half).draw(tmp_path / "scenario.json", (1,), (CAMERA,))
    assert not asked
    expected = resize_image(rgb, drive.cameras[CAMERA].model.resized(half)).astype(np.float32) / 255
    assert expected.shape[1] == half
    np.testing.assert_allclose(truth(half).images(CAMERA, 1).edit, expected, atol=1e-7)
    truth(2 * SIZE["width"]).draw(tmp_path / "scenario.json", (1,), (CAMERA,))
    assert asked == [2 * SIZE["width"]]


def test_without_blender_one_sentence_says_how_to_get_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("unisim_street.drawing.path_tracer.find_spec", lambda name: None)
    assert run(["synth", str(tmp_path / "log"), "--engine", "cycles", "--frames", "2"]) == 1
    said = capsys.readouterr().err.strip()
    assert "bpy" in said and ".[blender]" in said and "\n" not in said
    assert not (tmp_path / "log").exists()


def test_truth_is_drawn_for_cycles_alone(tmp_path: Path) -> None:
    result = CliRunner().invoke(command, [str(tmp_path / "log"), "--truth", "edit.json"])
    assert result.exit_code == 2 and "--engine cycles" in result.output


@pytest.mark.parametrize(("name", "value"), [("engine", "eevee"), ("paths", 0)])
def test_bad_recipes(name: str, value: object, tmp_path: Path) -> None:
    (tmp_path / "street.json").write_text(json.dumps({"format": "unisim-street", "version": 1, name: value}))
    with pytest.raises(LogError, match=f"street.json: .*{name}.*{value}"):
        load_street(tmp_path)


def test_a_log_of_the_other_engine_is_left_alone(solid: Street, tmp_path: Path) -> None:
    (tmp_path / "street.json").write_text(
        json.dumps({"format": "unisim-street", "version": 1, **SIZE, "engine": "cycles"})
    )
    with pytest.raises(OutputError, match="another street"):
        write_log(solid, tmp_path, 1, progress=False)


def test_meshes_from_files_are_refused(street: Street, tmp_path: Path) -> None:
    actor = street.drive.actors["car-01"]
    replaced = replace(actor, appearance=replace(actor.appearance, mesh="deer.glb"))
    with pytest.raises(ScenarioError, match=r"deer\.glb"):
        true_image_path(tmp_path, street, replace(street.drive, actors={"car-01": replaced}), CAMERA, 1, None)
