"""glTF 2.0 as its specification has it: accessors, nodes, primitives, colours, textures, extensions."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gltf_files import QUAD, QUAD_FACES, QUAD_UV, GltfFile
from numpy.typing import NDArray
from PIL import Image

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.meshes.hits import colours_at
from unisim_blender.core.meshes.intersect import FirstHits
from unisim_blender.core.meshes.model import MeshModel
from unisim_blender.core.meshes.read import mesh_notes, read_mesh

pytestmark = pytest.mark.filterwarnings("ignore:.*:UserWarning")


def png(pixels: NDArray[Any]) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    return file.getvalue()


# red, green / blue, white
FOUR = png(np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8))


def corners(model: MeshModel) -> NDArray[Any]:
    """Corners (F, 3, 3) in glTF's axes, from the lowest corner of the extent."""
    found = (model.vertices - model.vertices.min(0))[model.faces]
    return found[..., [1, 2, 0]]


def seen(model: MeshModel, face: int = 0) -> list[float]:
    """The surface's colour a quarter of the way along a face's last edge."""
    at = FirstHits(np.zeros(1), np.array([face], np.int32), np.array([[0.0, 0.25]], np.float32))
    return np.round(colours_at(model, at)[0], 3).tolist()


@pytest.mark.parametrize("suffix", (".glb", ".gltf"))
def test_floats_integers_and_strides_are_the_same_quad(tmp_path: Path, suffix: str) -> None:
    halves = np.round(QUAD / 2 * 32767).astype(np.int16)
    bytes_ = np.round(QUAD / 2 * 127).astype(np.int8)
    for values, scale, more in (
        (QUAD, 1.0, {}), (QUAD, 1.0, {"pad": 8}), (halves, 2.0, {"pad": 2, "normalized": True}),
        (bytes_, 2.0, {"pad": 1, "normalized": True}), (QUAD.astype(np.uint8), 1.0, {"pad": 1}),
    ):  # fmt: skip
        file = GltfFile()
        file.document["extensionsRequired"] = file.document["extensionsUsed"] = ["KHR_mesh_quantization"]
        file.primitive({"POSITION": file.accessor(values, **more)}, node={"scale": [scale] * 3})
        model = read_mesh(file.save(tmp_path / f"a{suffix}"))
        np.testing.assert_allclose(corners(model), QUAD[QUAD_FACES.reshape(-1, 3)], atol=0.02)
        np.testing.assert_allclose(model.size_m, [0, 1, 2], atol=0.02)
        assert mesh_notes(tmp_path / f"a{suffix}") == ()
        (tmp_path / f"a{suffix}").unlink()


def test_sparse_accessors_and_those_without_a_view(tmp_path: Path) -> None:
    file = GltfFile()
    sparse = {
        "count": 3, "indices": {"bufferView": file.view(np.array([1, 2, 3], np.uint16).tobytes()), "componentType": 5123},
        "values": {"bufferView": file.view(QUAD[1:].tobytes())},
    }  # fmt: skip
    position = file.add({"componentType": 5126, "count": 4, "type": "VEC3", "sparse": sparse})
    file.primitive({"POSITION": position})
    np.testing.assert_allclose(corners(read_mesh(file.save(tmp_path / "a.glb"))), QUAD[QUAD_FACES.reshape(-1, 3)])
    # over stored values: one vertex moves
    file = GltfFile()
    sparse = {
        "count": 1, "indices": {"bufferView": file.view(b"\2"), "componentType": 5121},
        "values": {"bufferView": file.view(np.array([3, 2, 0], np.float32).tobytes())},
    }  # fmt: skip
    file.primitive({"POSITION": file.accessor(QUAD, sparse=sparse)})
    np.testing.assert_allclose(read_mesh(file.save(tmp_path / "b.glb")).size_m, [0, 3, 2])


@pytest.mark.parametrize(
    ("mode", "order", "wanted"),
    [
        (4, None, [[0, 1, 2]]),
        (5, [0, 1, 3, 2], [[0, 1, 3], [1, 2, 3]]),
        (5, [0, 1, 3, 3, 2], [[0, 1, 3]]),
        (6, [0, 1, 2, 3], [[1, 2, 0], [2, 3, 0]]),
    ],
)
def test_strips_and_fans_are_triangles_of_one_side(
    tmp_path: Path, mode: int, order: list[int] | None, wanted: list[list[int]]
) -> None:
    file = GltfFile()
    faces = None if order is None else np.array(order, np.uint8)
    file.primitive({"POSITION": file.accessor(QUAD)}, faces, mode=mode)
    model = read_mesh(file.save(tmp_path / "a.glb"))
    np.testing.assert_allclose(corners(model), QUAD[wanted])
    np.testing.assert_allclose(model.normals, np.broadcast_to([1, 0, 0], model.normals.shape), atol=1e-6)


def test_points_and_lines_are_left_out_by_name(tmp_path: Path) -> None:
    file = GltfFile()
    file.primitive({"POSITION": file.accessor(QUAD)})
    first = file.document["meshes"][0]["primitives"]
    first += [{**first[0], "mode": 0}, {**first[0], "mode": 3}]
    path = file.save(tmp_path / "a.glb")
    assert len(read_mesh(path).faces) == 2
    assert [note.partition(": ")[2] for note in mesh_notes(path)] == [
        "meshes[0].primitives[1] is of points, which are left out",
        "meshes[0].primitives[2] is of lines, which are left out",
    ]


def test_nodes_carry_their_children_and_mirrors_keep_the_outside(tmp_path: Path) -> None:
    file = GltfFile()
    normals = np.tile(np.array([0, 0, 1], np.float32), (4, 1))
    file.primitive({"POSITION": file.accessor(QUAD), "NORMAL": file.accessor(normals)})
    half = float(np.sqrt(0.5))
    matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 10, 0, 0, 1]
    file.document["nodes"] = [
        {"children": [1], "rotation": [0, 0, half, half]},  # a quarter turn about z: x to y
        {"mesh": 0, "scale": [-3, 1, 1], "children": [2]},
        {"mesh": 0, "matrix": matrix},
        {"mesh": 0, "translation": [500, 0, 0]},  # in no scene
    ]
    file.document["scenes"] = [{"nodes": [3]}, {"nodes": [0]}]
    file.document["scene"] = 1
    model = read_mesh(file.save(tmp_path / "a.glb"))
    # x runs from -33 to 0 before the turn
    np.testing.assert_allclose(model.size_m, [0, 2, 33], atol=1e-5)
    np.testing.assert_allclose(model.normals, np.broadcast_to([1, 0, 0], model.normals.shape), atol=1e-6)
    a, b, c = (model.vertices[model.faces[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 0] > 0).all()


def test_skins_and_morphs_stand_as_at_rest(tmp_path: Path) -> None:
    file = GltfFile()
    joints = np.array([[0, 0, 0, 0]] * 2 + [[1, 0, 0, 0]] * 2, np.uint8)
    weights = np.tile(np.array([255, 0, 0, 0], np.uint8), (4, 1))
    inverse = np.tile(np.eye(4, dtype=np.float32), (2, 1, 1))
    attributes = {
        "POSITION": file.accessor(QUAD), "JOINTS_0": file.accessor(joints),
        "WEIGHTS_0": file.accessor(weights, normalized=True),
    }  # fmt: skip
    file.primitive(attributes, node={"skin": 0, "translation": [99, 0, 0]})
    file.document["skins"] = [{"joints": [1, 2], "inverseBindMatrices": file.accessor(inverse.reshape(2, 16))}]
    file.document["nodes"] += [{}, {"translation": [0, 5, 0]}]
    file.document["animations"] = [{"channels": [], "samplers": []}]
    path = file.save(tmp_path / "a.glb")
    np.testing.assert_allclose(read_mesh(path).size_m, [0, 1, 7])
    assert mesh_notes(path) == (f"{path}: animations are left out: the mesh stands as at rest",)
    file = GltfFile()
    moved = (QUAD * np.array([0, 1, 0], np.float32)).astype(np.float32)
    target = {"POSITION": file.accessor(moved)}
    file.primitive({"POSITION": file.accessor(QUAD)}, targets=[target])
    file.document["meshes"][0]["weights"] = [0.5]
    np.testing.assert_allclose(read_mesh(file.save(tmp_path / "b.glb")).size_m, [0, 1, 3])


COLOURS = np.tile(np.array([0.5, 0.25, 0.125, 1.0]), (4, 1))


@pytest.mark.parametrize("kind", ("float32", "uint16", "uint8"))
@pytest.mark.parametrize("width", (3, 4))
def test_vertex_colours_multiply_the_material(tmp_path: Path, kind: str, width: int) -> None:
    for factor, wanted in ((None, [0.5, 0.25, 0.125]), ([0.5, 1, 0, 1], [0.25, 0.25, 0])):
        file = GltfFile()
        most = 1 if kind == "float32" else np.iinfo(kind).max
        colours = np.ascontiguousarray((COLOURS * most)[:, :width], kind)
        pad = -colours.itemsize * width % 4
        at = {
            "POSITION": file.accessor(QUAD),
            "COLOR_0": file.accessor(colours, pad=pad, normalized=kind != "float32"),
        }
        file.primitive(at, material=0)
        file.document["materials"] = [
            {"pbrMetallicRoughness": {} if factor is None else {"baseColorFactor": factor}, "name": "paint"}
        ]
        model = read_mesh(file.save(tmp_path / f"{factor is None}.glb"))
        np.testing.assert_allclose(model.colours, np.broadcast_to(wanted, model.colours.shape), atol=0.005)


def test_what_states_no_colour_is_white_with_texture_coordinates_and_without(tmp_path: Path) -> None:
    for name in ("plain", "uv", "material"):
        file = GltfFile()
        uv = {"TEXCOORD_0": file.accessor(QUAD_UV)} if name != "plain" else {}
        more: dict[str, Any] = {"material": 0} if name == "material" else {}
        file.primitive({"POSITION": file.accessor(QUAD), **uv}, **more)
        file.document["materials"] = [{"pbrMetallicRoughness": {"metallicFactor": 1.0}}]
        model = read_mesh(file.save(tmp_path / f"{name}.glb"))
        assert (model.colours == 1).all() and not model.textures


@pytest.mark.parametrize("kind", ("float32", "uint16", "uint8"))
def test_a_texture_stands_upright_by_any_coordinates(tmp_path: Path, kind: str) -> None:
    file = GltfFile()
    most = 1 if kind == "float32" else np.iinfo(kind).max
    # the second set lies on the image's upper left texel
    second = np.tile(np.array([[0.25, 0.25]]), (4, 1))
    sets = [np.ascontiguousarray(uv * most, kind) for uv in (QUAD_UV, second)]
    at = {
        f"TEXCOORD_{k}": file.accessor(uv, pad=-uv.itemsize * 2 % 4, normalized=kind != "float32")
        for k, uv in enumerate(sets)
    }
    file.primitive({"POSITION": file.accessor(QUAD), **at}, material=0)
    file.textured(FOUR, {})
    model = read_mesh(file.save(tmp_path / "a.glb"))
    assert model.uv.min() == 0 and model.uv.max() == 1
    np.testing.assert_allclose(seen(model), [0, 0, 1], atol=0.02)
    file.textured(FOUR, {"texCoord": 1}, baseColorFactor=[0.5, 0.5, 0.5, 1])
    np.testing.assert_allclose(seen(read_mesh(file.save(tmp_path / "b.glb"))), [0.5, 0, 0], atol=0.02)
    file.textured(FOUR, {"extensions": {"KHR_texture_transform": {"texCoord": 1}}})
    np.testing.assert_allclose(seen(read_mesh(file.save(tmp_path / "c.glb"))), [1, 0, 0], atol=0.02)
    file.textured(FOUR, {"texCoord": 2})
    model = read_mesh(file.save(tmp_path / "d.glb"))
    assert not model.textures and "has a texture and no TEXCOORD_2" in mesh_notes(tmp_path / "d.glb")[0]


def test_a_texture_is_scaled_turned_and_moved(tmp_path: Path) -> None:
    """By the extension's words: counter-clockwise, v down, so that u grows towards where v shrank."""
    file = GltfFile()
    file.primitive({"POSITION": file.accessor(QUAD), "TEXCOORD_0": file.accessor(QUAD_UV)}, material=0)
    turned = {"offset": [0.1, 0.2], "rotation": np.pi / 2, "scale": [0.5, 2.0]}
    file.textured(FOUR, {"extensions": {"KHR_texture_transform": turned}})
    model = read_mesh(file.save(tmp_path / "a.glb"))
    u, v = (QUAD_UV * [0.5, 2.0]).T
    wanted = np.stack([v + 0.1, 1 - (-u + 0.2)], -1)
    np.testing.assert_allclose(model.uv, wanted[QUAD_FACES.reshape(-1, 3)], atol=1e-6)


def test_images_by_data_uri_escaped_name_and_view(tmp_path: Path) -> None:
    (tmp_path / "my image.png").write_bytes(FOUR)
    data = "data:image/png;base64," + base64.b64encode(FOUR).decode()
    for uri in (data, "my%20image.png", "my image.png"):
        file = GltfFile()
        file.primitive({"POSITION": file.accessor(QUAD), "TEXCOORD_0": file.accessor(QUAD_UV)}, material=0)
        file.textured(FOUR, {})
        file.document["images"] = [{"uri": uri}]
        model = read_mesh(file.save(tmp_path / f"{len(uri)}.gltf"))
        assert model.textures[0].shape == (2, 2, 3)
    file.document["images"] = [{"uri": "of%20another.png"}]
    with pytest.raises(ScenarioError, match=r"b\.glb: its texture 'of another.png' is missing"):
        read_mesh(file.save(tmp_path / "b.glb"))


@pytest.mark.parametrize("mode", ("I;16", "L", "LA", "P", "RGBA", "1"))
def test_textures_of_every_depth_keep_their_brightness(tmp_path: Path, mode: str) -> None:
    grey = np.full((2, 2), 180, np.uint8)
    if mode == "I;16":
        image = Image.fromarray(grey.astype(np.uint16) * 257)
    else:
        image = Image.fromarray(grey).convert(mode)
    content = io.BytesIO()
    image.save(content, "PNG")
    file = GltfFile()
    file.primitive({"POSITION": file.accessor(QUAD), "TEXCOORD_0": file.accessor(QUAD_UV)}, material=0)
    file.textured(content.getvalue(), {})
    texture = read_mesh(file.save(tmp_path / "a.glb")).textures[0]
    assert (np.abs(texture.astype(int) - 180) <= 3).all() or (mode == "1" and set(np.unique(texture)) <= {0, 255})


@pytest.mark.parametrize(
    "name",
    (
        "KHR_draco_mesh_compression", "EXT_meshopt_compression", "KHR_meshopt_compression", "KHR_texture_basisu",
        "EXT_mesh_gpu_instancing", "MSFT_texture_dds", "ACME_unheard_of",
    ),
)  # fmt: skip
def test_what_is_required_and_not_read_is_refused_and_what_is_used_is_named(tmp_path: Path, name: str) -> None:
    file = GltfFile()
    file.document |= {"extensionsUsed": [name, "KHR_materials_unlit"], "extensionsRequired": [name]}
    file.primitive({"POSITION": file.accessor(QUAD)})
    with pytest.raises(ScenarioError, match=rf"a\.glb: requires the glTF extension {name}, which is not read"):
        read_mesh(file.save(tmp_path / "a.glb"))
    del file.document["extensionsRequired"]
    path = file.save(tmp_path / "b.glb")
    assert len(read_mesh(path).faces) == 2
    assert mesh_notes(path) == (f"{path}: the glTF extension {name} is not read",)


def test_compressed_data_without_a_plain_copy_is_refused(tmp_path: Path) -> None:
    name = "KHR_draco_mesh_compression"
    file = GltfFile()
    position = file.add({"componentType": 5126, "count": 4, "type": "VEC3"})
    file.primitive({"POSITION": position}, extensions={name: {"bufferView": 0, "attributes": {}}})
    with pytest.raises(ScenarioError, match=rf"primitives\[0\] needs the glTF extension {name}"):
        read_mesh(file.save(tmp_path / "a.glb"))


def test_materials_that_are_not_matt_and_opaque_are_named(tmp_path: Path) -> None:
    file = GltfFile()
    file.primitive({"POSITION": file.accessor(QUAD)}, material=0)
    file.document["materials"] = [{"name": "glass", "alphaMode": "BLEND", "emissiveFactor": [1, 0, 0]}]
    path = file.save(tmp_path / "a.glb")
    assert [note.partition(": ")[2] for note in mesh_notes(path)] == [
        "the material 'glass' is opaque, not BLEND",
        "the material 'glass' does not emit light",
    ]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        ({"asset": {"version": "1.0"}}, "is glTF '1.0', not 2.0"),
        ({"nodes": [{"mesh": 4}]}, r"meshes\[4\] is named and not there: there are 1"),
        ({"nodes": [{"mesh": 0, "children": [0]}]}, "children of each other"),
        ({"bufferViews": []}, r"bufferViews\[0\] is named and not there"),
        ({"scene": 3}, r"scenes\[3\] is named"),
        ({"accessors": [{"componentType": 5126, "count": 9**9, "type": "VEC3", "bufferView": 0}]}, "9 elements, which"),
        ({"accessors": [{"componentType": 5126, "count": 9**9, "type": "VEC3"}]}, "elements and no buffer view"),
        ({"accessors": [{"componentType": 5124, "count": 4, "type": "VEC3"}]}, "has the type 5124 VEC3"),
        ({"materials": [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]}, r"textures\[0\] is named"),
    ],
)
def test_documents_with_faults_are_refused_in_one_sentence(tmp_path: Path, change: Any, problem: str) -> None:
    file = GltfFile()
    file.primitive({"POSITION": file.accessor(QUAD), "TEXCOORD_0": file.accessor(QUAD_UV)}, material=0)
    file.document["materials"] = [{}]
    file.document |= change
    with pytest.raises(ScenarioError, match=problem) as caught:
        read_mesh(file.save(tmp_path / "a.glb"))
    assert str(caught.value).startswith(f"{tmp_path / 'a.glb'}: ")


def test_an_extent_that_cannot_be_metres_is_doubted(tmp_path: Path) -> None:
    for scale, doubted in ((1000, True), (30, False), (1, False), (0.01, True)):
        file = GltfFile()
        file.primitive({"POSITION": file.accessor(QUAD)}, node={"scale": [scale] * 3})
        path = file.save(tmp_path / f"{scale}.glb")
        if doubted:
            with pytest.warns(UserWarning, match=rf"{path}: its extent is \S+ m: is its unit the metre\?"):
                read_mesh(path)
        assert bool(mesh_notes(path)) == doubted, json.dumps(scale)
