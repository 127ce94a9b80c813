"""Mesh files, the first triangle on a ray, and how a surface looks there."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray
from PIL import Image
from tiny_drive import tiny_drive

from unisim_blender.core import native
from unisim_blender.core.colour import linear_from_srgb, srgb_from_linear
from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.meshes.exposure import GROUND_ALBEDO, UNSEEN, beside, level_of
from unisim_blender.core.meshes.hits import colours_at, lit, normals_at, reflectivity
from unisim_blender.core.meshes.intersect import FirstHits, Mesh, Triangles, check_boxes, first_hits_reference
from unisim_blender.core.meshes.model import GREY, MeshModel, face_normals, read_model, write_model
from unisim_blender.core.meshes.read import _part, mesh_size_m, read_mesh


def model_of(vertices: NDArray[Any], faces: NDArray[Any]) -> MeshModel:
    vertices, faces = vertices.astype(np.float32), faces.astype(np.int32)
    normals = np.repeat(face_normals(vertices, faces)[:, None], 3, 1)
    n = len(faces)
    white, nowhere = np.ones((n, 3, 3), np.float32), np.zeros((n, 3, 2), np.float32)
    return MeshModel(vertices, faces, normals, white, nowhere, np.full(n, -1, np.int32))


def unit(d: FloatArray) -> FloatArray:
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


@pytest.mark.skipif(native.library() is None, reason="the compiled kernels are not there")
@pytest.mark.parametrize("kind", ["ball", "soup", "flat", "one", "alike"])
def test_the_compiled_first_hits_are_those_of_the_plain_way(kind: str) -> None:
    rng = np.random.default_rng(3)
    if kind == "ball":
        ball = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
        model = model_of(ball.vertices * [2, 1, 0.7], ball.faces)
    elif kind == "soup":
        model = model_of(rng.normal(size=(600, 3)), np.arange(600).reshape(-1, 3))
    elif kind == "flat":
        grid = trimesh.creation.box([4, 4, 0]).subdivide().subdivide()
        model = model_of(grid.vertices, grid.faces)
    elif kind == "one":
        model = model_of(np.eye(3), np.array([[0, 1, 2]]))
    else:  # many triangles in one place, and some without area
        model = model_of(
            np.tile(np.eye(3), (50, 1)), np.concatenate([np.arange(150).reshape(-1, 3), [[0, 0, 1], [2, 2, 2]]])
        )
    n = 3000
    origins = rng.normal(size=(n, 3)) * rng.choice([0.3, 3.0, 200.0], (n, 1))
    directions = unit(rng.normal(size=(n, 3)) * 0.5 - origins)
    # straight along the axes, from where they meet edges and corners
    origins[:300], directions[:300] = np.round(origins[:300]), np.eye(3)[rng.integers(0, 3, 300)]
    for near in (0.0, 0.5):
        fast, plain = (
            Mesh(model).first_hits(origins, directions, near),
            first_hits_reference(model, origins, directions, near),
        )
        assert (fast.face >= 0).mean() > 0.02
        same = fast.face == plain.face
        # where a ray runs along an edge, rounding decides between neighbours, and at an outline between all and nothing
        assert same[300:].mean() > 0.999
        assert np.isclose(fast.t, plain.t, rtol=1e-9, atol=1e-9).mean() > 0.998
        np.testing.assert_allclose(fast.uv[same], plain.uv[same], atol=1e-5)
        assert np.isinf(fast.t[fast.face < 0]).all()


def test_a_closed_body_lets_nothing_through() -> None:
    ball = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    mesh = Mesh(model_of(ball.vertices, ball.faces))
    rng = np.random.default_rng(0)
    origins = unit(rng.normal(size=(20000, 3))) * 50
    hits = mesh.first_hits(origins, unit(rng.uniform(-0.5, 0.5, (20000, 3)) - origins), 0.5)
    assert (hits.face >= 0).all()
    np.testing.assert_allclose(hits.t, 49.2, atol=0.25)


def test_our_own_file_holds_all(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    model = model_of(rng.normal(size=(9, 3)), np.arange(9).reshape(3, 3))
    texture = np.array([0, 1, -1], np.int32)
    images = tuple(rng.integers(0, 255, (4, 5 + i, 3), np.uint8) for i in range(2))
    model = replace(model, texture=texture, textures=images, uv=rng.random((3, 3, 2)).astype(np.float32))
    write_model(model, tmp_path / "a.npz")
    again = read_model(tmp_path / "a.npz")
    for name in ("vertices", "faces", "normals", "colours", "uv", "texture"):
        np.testing.assert_array_equal(getattr(again, name), getattr(model, name))
    assert len(again.textures) == 2 and all((a == b).all() for a, b in zip(again.textures, images, strict=True))
    # it stands about the middle of its extent
    middle = read_mesh(tmp_path / "a.npz").vertices
    np.testing.assert_allclose(middle.min(0), -middle.max(0), atol=1e-6)


def test_what_trimesh_reads(tmp_path: Path) -> None:
    box = trimesh.creation.box([4.0, 2.0, 1.0])
    box.visual.face_colors = [200, 30, 30, 255]
    box.apply_translation([10, 0, 0])
    box.export(tmp_path / "box.ply")
    model = read_mesh(tmp_path / "box.ply")
    np.testing.assert_allclose(model.size_m, [4, 2, 1], atol=1e-6)
    np.testing.assert_allclose(model.colours[0, 0], linear_from_srgb(np.array([200, 30, 30]) / 255), atol=1e-6)
    # glTF has z forward, x left, y up
    box.export(tmp_path / "box.glb")
    np.testing.assert_allclose(mesh_size_m(tmp_path / "box.glb"), [1, 4, 2], atol=1e-5)
    quad = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]])
    image = Image.fromarray(np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8))
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    quad.visual = trimesh.visual.TextureVisuals(uv, image=image)  # type: ignore[no-untyped-call]
    quad.export(tmp_path / "quad.glb")
    model = read_mesh(tmp_path / "quad.glb")
    # the upper left quarter of the image is red
    at = FirstHits(np.zeros(1), np.array([1], np.int32), np.array([[0.25, 0.5]], np.float32))
    where = (model.uv[1, 0] * 0.25 + model.uv[1, 1] * 0.25 + model.uv[1, 2] * 0.5).tolist()
    np.testing.assert_allclose(where, [0.25, 0.75], atol=1e-6)
    assert colours_at(model, at)[0, 0] > 0.3 and colours_at(model, at)[0, 1:].max() == 0


def test_a_material_that_trimesh_makes_up_is_none() -> None:
    visuals: Any = trimesh.visual
    mesh, uv = trimesh.creation.box([1, 1, 1]), np.zeros((8, 2))
    grey, red = linear_from_srgb(np.array(GREY, np.float32)), linear_from_srgb(np.array([0.8, 0, 0], np.float32))
    for visual, wanted, textured in (
        (visuals.TextureVisuals(uv), grey, False),
        (visuals.TextureVisuals(uv, image=Image.new("RGB", (2, 2), (9, 9, 9))), 1.0, True),
        (visuals.TextureVisuals(uv, visuals.material.PBRMaterial(baseColorFactor=[204, 0, 0, 255])), red, False),
        (visuals.TextureVisuals(None, visuals.material.PBRMaterial(baseColorFactor=[204, 0, 0, 255])), red, False),
    ):
        mesh.visual = visual
        part = _part(mesh)
        np.testing.assert_allclose(part.colours, np.broadcast_to(wanted, part.colours.shape), atol=1e-5)
        assert (part.texture is not None) == textured


POINT = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n"
NO_MESHES = ["missing.ply", "missing.npz", "broken.ply", "broken.glb", "broken.npz", "empty.ply", "thing.xyzzy"]


@pytest.mark.parametrize("name", NO_MESHES)
def test_files_that_are_no_mesh_are_refused_by_name(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name == "empty.ply":
        path.write_bytes(POINT)
    elif "missing" not in name:
        path.write_bytes(b"ply\nnot really \xff\x00" * 3)
    with pytest.raises(ScenarioError) as caught:
        read_mesh(path)
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


class Hostile:
    def __reduce__(self) -> tuple[object, ...]:
        return exec, ("raise SystemExit('ran')",)


def test_a_pickle_in_our_own_file_is_never_run(tmp_path: Path) -> None:
    path = tmp_path / "bad.npz"
    np.savez(path, vertices=np.array([Hostile()], dtype=object))
    with pytest.raises(ScenarioError, match="is no mesh file"):
        read_model(path)
    path.write_bytes(pickle.dumps(Hostile()))
    with pytest.raises(ScenarioError, match="is no mesh file"):
        read_model(path)


@pytest.mark.parametrize(
    "change, problem",
    [
        ({"vertices": np.full((3, 3), np.nan, np.float32)}, "not finite"),
        ({"faces": np.array([[0, 1, 3]], np.int32)}, "a vertex that is not there"),
        ({"texture": np.array([0], np.int32)}, "a texture is named that is not there"),
        ({"uv": np.zeros((1, 2, 2), np.float32)}, r"uv has shape \(1, 2, 2\)"),
        ({"vertices": np.zeros((3, 3), np.float32)}, "has no extent"),
        ({"textures": (np.zeros((2, 2), np.uint8),)}, "texture 0 has shape"),
        ({"faces": np.zeros((0, 3), np.int32)}, "shape|no triangle"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(tmp_path: Path, change: dict[str, Any], problem: str) -> None:
    model = replace(model_of(np.eye(3), np.array([[0, 1, 2]])), **change)
    write_model(model, tmp_path / "a.npz")
    with pytest.raises(ScenarioError, match=problem):
        read_model(tmp_path / "a.npz")


def test_normals_face_the_ray_and_light_comes_from_above() -> None:
    model = model_of(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
    hits = FirstHits(np.ones(2), np.zeros(2, np.int32), np.full((2, 2), 0.2, np.float32))
    directions = np.array([[0, 0, -1.0], [0, 0, 1.0]])
    normals = normals_at(model, hits, directions)
    np.testing.assert_allclose(normals, [[0, 0, 1], [0, 0, -1]])
    white, level = np.ones((2, 3)), np.array([[0.5, 0.4, 0.3]])
    bright = lit(white, normals, level)
    np.testing.assert_allclose(bright[0], level[0], atol=1e-12)
    assert bright[1].max() == 0
    np.testing.assert_allclose(reflectivity(white / 2, np.array([1.0, -0.5])), [0.5, 0.25])


def test_the_level_is_the_grounds() -> None:
    grey = srgb_from_linear(np.full((20, 3), 0.1, np.float32))
    grey[:6] = 1.0  # a marking
    np.testing.assert_allclose(level_of(grey), 0.1 / GROUND_ALBEDO, rtol=1e-5)
    assert level_of(grey[:0]).tolist() == [UNSEEN] * 3
    car = tiny_drive().actors["car"]
    places = beside(car, 0.0) - car.world_from_actor.at(0.0)[:3, 3]
    assert (np.hypot(places[:, 0], places[:, 1]) > np.hypot(*car.size_m[:2]) / 2).all()
    np.testing.assert_allclose(places[:, 2], -car.size_m[2] / 2)


def ply(faces: str, vertices: str = "0 0 0\n1 0 0\n0 1 0\n0 0 1") -> bytes:
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    return f"{head}element face 1\nproperty list uchar int vertex_indices\nend_header\n{vertices}\n{faces}\n".encode()


@pytest.mark.parametrize(
    ("faces", "problem"), [("3 0 1 9", "face 0 is .0, 1, 9|index 9 is out"), ("3 0 1 -1", "face 0 is .0, 1, -1")]
)
def test_a_face_of_a_vertex_that_is_not_there_is_named(tmp_path: Path, faces: str, problem: str) -> None:
    path = tmp_path / "a.ply"
    path.write_bytes(ply(faces))
    with pytest.raises(ScenarioError, match=problem) as caught:
        read_mesh(path)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize(
    ("vertices", "faces", "problem"),
    [
        (np.eye(3), np.array([[0, 1, 7]]), r"face 0 is \[0, 1, 7\] and names a vertex that is not there: there are 3"),
        (np.eye(3), np.array([[0, 1, 2, 0]]), r"faces has shape \(1, 4\), .*: every face must be a triangle"),
        (np.zeros(9), np.array([[0, 1, 2]]), r"vertices has shape \(9,\), not \(V, 3\)"),
        (np.eye(3), np.array([0, 1, 2]), r"faces has shape \(3,\)"),
    ],
)
def test_triangles_that_are_none_reach_no_kernel(vertices: NDArray[Any], faces: NDArray[Any], problem: str) -> None:
    for use in (Triangles, face_normals):
        with pytest.raises(ScenarioError, match=problem):
            use(vertices.astype(np.float32), faces.astype(np.int32))


@pytest.mark.parametrize("name", ("vertices", "faces", "normals", "colours", "uv", "texture"))
@pytest.mark.parametrize("change", ("flat", "single", "quads"))
def test_arrays_of_other_shapes_are_refused_by_name(tmp_path: Path, name: str, change: str) -> None:
    model = model_of(np.eye(3), np.array([[0, 1, 2]]))
    arrays = {
        key: np.asarray(getattr(model, key)) for key in ("vertices", "faces", "normals", "colours", "uv", "texture")
    }
    one = arrays[name]
    arrays[name] = {"flat": one.reshape(-1), "single": one.reshape(-1)[0], "quads": np.concatenate([one, one], -1)}[
        change
    ]
    path = tmp_path / "a.npz"
    np.savez(path, **arrays)
    if change == "flat" and name == "texture":
        read_model(path)
        return
    with pytest.raises(ScenarioError, match=rf"a\.npz: {name} has shape"):
        read_model(path)


@pytest.mark.parametrize("value", (np.nan, np.inf, -np.inf, 3e38, -3e38))
@pytest.mark.parametrize("count", (1, 7, 200))
def test_corners_at_no_place_leave_a_hierarchy_that_rays_walk_through(value: float, count: int) -> None:
    """Files of kept faces are mapped, not read: what is broken in them must not lead a kernel out of its arrays."""
    rng = np.random.default_rng(0)
    vertices, faces = rng.normal(size=(300, 3)).astype(np.float32), rng.integers(0, 300, (400, 3)).astype(np.int32)
    vertices[rng.integers(0, 300, count), rng.integers(0, 3, count)] = value
    triangles = Triangles(vertices, faces)
    if triangles.boxes is not None:
        check_boxes(*triangles.boxes, len(faces))
        assert sorted(triangles.boxes[1]) == list(range(len(faces)))
    directions = rng.normal(size=(50, 3))
    hits = triangles.first_hits(np.zeros((50, 3)), directions / np.linalg.norm(directions, axis=1, keepdims=True), 0.1)
    assert ((hits.face >= -1) & (hits.face < len(faces))).all() and (hits.face >= 0).any()
