"""OBJ with its materials, PLY and OFF: colours, textures, numbers of corners, names of files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from unisim_blender.core.colour import linear_from_srgb
from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.meshes.model import FLAT, GREY, MeshModel, texture_pixels
from unisim_blender.core.meshes.read import mesh_notes, read_mesh

pytestmark = pytest.mark.filterwarnings("ignore:.*:UserWarning")
SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 1\n"
UV = "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
FACES, UV_FACES = "f 1 2 3\nf 1 3 4\n", "f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
GREY_LINEAR = float(linear_from_srgb(np.array(GREY, np.float32)))


def albedo(model: MeshModel) -> NDArray[Any]:
    """The mean colour (3,) of faces, with the mean of their textures."""
    colours = model.colours.mean(1)
    for i, image in enumerate(model.textures):
        colours[model.texture == i] *= linear_from_srgb(image.reshape(-1, 3) / np.float32(255)).mean(0)
    return np.asarray(colours.mean(0))


def obj(folder: Path, text: str, mtl: str | None = None, name: str = "a") -> Path:
    """An OBJ file, with its materials beside it."""
    if mtl is not None:
        (folder / f"{name}.mtl").write_text(mtl)
        text = f"mtllib {name}.mtl\nusemtl m\n{text}"
    (folder / f"{name}.obj").write_text(text)
    return folder / f"{name}.obj"


def red(folder: Path, name: str) -> None:
    Image.new("RGB", (4, 4), (200, 0, 0)).save(folder / name)


def notes(path: Path) -> list[str]:
    return [note.removeprefix(f"{path}: ") for note in mesh_notes(path)]


PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
{vertex}element face 2
property list uchar int vertex_indices
{face}end_header
"""
PLACES = ("0 0 0", "1 0 0", "1 1 0", "0 1 1")


def ply(
    folder: Path,
    vertex: str = "",
    of_vertex: str = "",
    face: str = "",
    of_face: str = "",
    head: str = "",
    name: str = "a",
) -> Path:
    """A PLY file whose vertices and faces all have the same more properties."""
    text = PLY.format(vertex=vertex, face=face).replace("element vertex", f"{head}element vertex", 1)
    lines = [f"{place} {of_vertex}" for place in PLACES] + [f"3 {corners} {of_face}" for corners in ("0 1 2", "0 2 3")]
    (folder / f"{name}.ply").write_text(text + "\n".join(lines) + "\n")
    return folder / f"{name}.ply"


def test_texture_coordinates_alone_change_no_colour(tmp_path: Path) -> None:
    floats = "property float s\nproperty float t\n"
    for path in (
        obj(tmp_path, SQUARE + FACES), obj(tmp_path, SQUARE + UV + UV_FACES, name="uv"),
        obj(tmp_path, SQUARE + UV + UV_FACES, "newmtl m\nNs 10\n", "bare"),
        ply(tmp_path), ply(tmp_path, floats, "0.5 0.5", name="uv"),
        ply(tmp_path, face="property list uchar float texcoord\n", of_face="6 0 0 1 0 1 1", name="corners"),
    ):  # fmt: skip
        model = read_mesh(path)
        assert not model.textures
        np.testing.assert_allclose(model.colours, GREY_LINEAR, rtol=1e-5)


@pytest.mark.parametrize(
    ("mtl", "wanted"),
    [
        ("newmtl m\nKd 0.5 0.25 0\n", [0.5, 0.25, 0]),
        ("newmtl m\nKd 0.5\n", [0.5, 0.5, 0.5]),
        ("newmtl m\nKd 0 0 0\n", [0, 0, 0]),
        ("newmtl other\nKd 1 0 0\n", [GREY] * 3),
        ("newmtl m\nKa 1 0 0\nKs 1 1 1\n", [GREY] * 3),
    ],
)
def test_a_materials_colour_is_the_same_with_texture_coordinates(tmp_path: Path, mtl: str, wanted: list[float]) -> None:
    linear = linear_from_srgb(np.array(wanted, np.float32))
    for text in (SQUARE + FACES, SQUARE + UV + UV_FACES):
        path = obj(tmp_path, text, mtl, f"k{len(text)}")
        np.testing.assert_allclose(albedo(read_mesh(path)), linear, atol=1e-5)
        assert bool(notes(path)) == ("other" in mtl)


@pytest.mark.parametrize(
    ("kd", "factor"), [("", 1.0), ("Kd 1 1 1\n", 1.0), ("Kd 0 0 0\n", 1.0), ("Kd 0.5 0.5 0.5\n", GREY_LINEAR)]
)
def test_a_colour_multiplies_its_texture_but_for_black(tmp_path: Path, kd: str, factor: float) -> None:
    red(tmp_path, "t.png")
    path = obj(tmp_path, SQUARE + UV + UV_FACES, f"newmtl m\n{kd}map_Kd t.png\n")
    wanted = linear_from_srgb(np.array([200, 0, 0], np.float32) / 255) * factor
    np.testing.assert_allclose(albedo(read_mesh(path)), wanted, atol=1e-5)
    # faces without coordinates on it have the plain colour
    path = obj(tmp_path, SQUARE + UV + "f 1/1 2/2 3/3\nf 1 3 4\n", f"newmtl m\n{kd}map_Kd t.png\n", "mixed")
    assert sorted(read_mesh(path).texture.tolist()) == [FLAT, 0]


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("t.png", "t.png"), ("t.png", "-s 2 3 1 -o 0.5 -0.25 0 t.png"), ("t.png", "-o 0.5 -0.25 -s 2 3 t.png"),
        ("t.png", "-clamp off -bm 1.0 -mm 0 1 -blendu on -texres 512 -s 2 3 1 -o 0.5 -.25 0 t.png"),
        ("my tex.png", "my tex.png"), ("my tex.png", '"my tex.png"'), ("my tex.png", "-s 2 3 1 -o 0.5 -0.25 0 my tex.png"),
        ("T.PNG", "t.png"), ("t.png", "C:\\some where\\maps\\t.png"), ("t.png", ".\\t.png"), ("t.png", "/home/x/t.png"),
        ("-s.png", "-s.png"),
    ],
)  # fmt: skip
def test_textures_are_found_as_programs_name_them(tmp_path: Path, name: str, line: str) -> None:
    red(tmp_path, name)
    path = obj(tmp_path, SQUARE + UV + UV_FACES, f"newmtl m\nMap_Kd {line}\n")
    model = read_mesh(path)
    assert model.textures[0].shape == (4, 4, 3) and notes(path) == []
    moved = "-o 0.5" in line
    wanted = np.array([[0.5, -0.25], [2.5, 2.75]]) if moved else np.array([[0, 0], [1, 1]])
    np.testing.assert_allclose([model.uv.min((0, 1)), model.uv.max((0, 1))], wanted)


def test_options_that_are_not_applied_are_named(tmp_path: Path) -> None:
    red(tmp_path, "t.png")
    line = "map_Kd -mm 0.2 0.5 -clamp on -imfchan r -t 1 1 1 t.png"
    path = obj(tmp_path, SQUARE + UV + UV_FACES, f"newmtl m\n{line}\nd 0.5\nKe 1 0 0\n")
    assert len(read_mesh(path).textures) == 1
    said = " ".join(notes(path))
    assert all(word in said for word in ("-mm 0.2 0.5", "-clamp", "-imfchan", "-t of", "transparency", "emitted light"))


@pytest.mark.parametrize("line", ("gone.png", "C:\\maps\\gone.png", "-s 2 2 2 gone.png", '"gone.png"'))
def test_a_texture_that_is_missing_is_named(tmp_path: Path, line: str) -> None:
    path = obj(tmp_path, SQUARE + UV + UV_FACES, f"newmtl m\nKd 1 1 1\nmap_Kd {line}\n")
    with pytest.raises(ScenarioError, match=r"a\.obj: its texture .*gone\.png.* of a\.mtl is missing"):
        read_mesh(path)
    path = ply(tmp_path, "property float u\nproperty float v\n", "0 0", head="comment TextureFile gone.png\n")
    with pytest.raises(ScenarioError, match=r"a\.ply: its texture 'gone\.png' is missing"):
        read_mesh(path)
    (tmp_path / "gone.png").write_bytes(b"no image")
    with pytest.raises(ScenarioError, match=r"a\.ply: its texture 'gone\.png' cannot be read: "):
        read_mesh(path)


def test_materials_that_are_missing_are_named_and_grey(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text("mtllib of another.mtl\nusemtl paint\n" + SQUARE + UV + UV_FACES)
    np.testing.assert_allclose(read_mesh(path).colours, GREY_LINEAR, rtol=1e-5)
    assert notes(path) == [
        "its materials 'of another.mtl' are missing",
        "the material 'paint' is not there: its faces are grey",
    ]


def test_several_libraries_groups_and_materials(tmp_path: Path) -> None:
    (tmp_path / "one.mtl").write_text("newmtl my red\nKd 1 0 0\n")
    (tmp_path / "two two.mtl").write_text("newmtl blue\r\n  Kd 0 0 1\r\n")
    text = "mtllib one.mtl\nmtllib two two.mtl\no a\nusemtl my red\n{}g b\ns 1\nusemtl blue\n{}l 1 2\n"
    path = tmp_path / "a.obj"
    path.write_text(SQUARE + text.format("f 1 2 3\n", "f 1 3 \\\n4\n"))
    model = read_mesh(path)
    assert model.colours[:, 0].tolist() == [[1, 0, 0], [0, 0, 1]]
    assert notes(path) == ["points, lines and curves are left out"]


def test_corners_counted_from_the_end_and_polygons(tmp_path: Path) -> None:
    # each group counts from its own end, as programs that stream their output write it
    path = obj(tmp_path, "v 0 0 0\nv 1 0 0\nv 1 1 0\nf -3 -2 -1\nv 0 0 5\nv 1 0 5\nv 1 1 5\nv 0 1 5\nf -4 -3 -2 -1\n")
    model = read_mesh(path)
    assert len(model.faces) == 3 and np.isclose(model.size_m[2], 5)
    heights = model.vertices[model.faces][..., 2]
    assert (np.ptp(heights, axis=1) == 0).all() and (heights[:, 0] > 0).sum() == 2
    for bad, what in (("f 1 2 9", "vertex 9"), ("f 1 2 -4", "vertex -4"), ("f 0 1 2", "vertex 0"), ("f 1/5 2 3", "5")):
        path = obj(tmp_path, f"v 0 0 0\nv 1 0 0\nv 1 1 0\n{bad}\n", name="bad")
        with pytest.raises(ScenarioError, match=rf"bad\.obj: line 4 names .*{what}, which is not there"):
            read_mesh(path)
        path.unlink()


@pytest.mark.parametrize("turn", range(6))
@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("mirrored", (False, True))
def test_concave_polygons_cover_their_own_area(tmp_path: Path, turn: int, axis: int, mirrored: bool) -> None:
    corners = np.roll([[0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]], turn, axis=0)
    places = np.roll(np.insert(corners[:: -1 if mirrored else 1], 2, 0, axis=1), axis, axis=1)
    text = "".join("v {} {} {}\n".format(*place) for place in places)
    model = read_mesh(obj(tmp_path, f"{text}f 1 2 3 4 5 6\n"))
    a, b, c = (model.vertices[model.faces[:, k]] for k in range(3))
    areas = np.cross(b - a, c - a) / 2
    assert len(areas) == 4
    np.testing.assert_allclose(np.linalg.norm(areas, axis=1).sum(), 6)
    np.testing.assert_allclose(np.linalg.norm(areas.sum(0)), 6)  # all to one side


def test_vertices_that_no_face_names_have_no_extent(tmp_path: Path) -> None:
    path = obj(tmp_path, "v 500 0 0\n" + SQUARE + "f 2 3 4\nf 2 4 5\n")
    np.testing.assert_allclose(read_mesh(path).size_m, 1)
    assert notes(path) == []


@pytest.mark.parametrize("most", (1, 255))
def test_colours_of_an_objs_vertices(tmp_path: Path, most: int) -> None:
    wanted = np.array([200, 100, 50])
    shown = " ".join(str(value if most == 255 else value / 255) for value in wanted)
    square = "".join(f"{line} {shown}\n" for line in SQUARE.splitlines())
    for text in (square + FACES, square + UV + UV_FACES):
        model = read_mesh(obj(tmp_path, text, name=f"k{len(text)}"))
        np.testing.assert_allclose(albedo(model), linear_from_srgb(wanted / np.float32(255)), atol=1e-5)


@pytest.mark.parametrize(
    ("kind", "most"), [("uchar", 255), ("uint8", 255), ("ushort", 65535), ("uint", 255), ("float", 1), ("double", 1)]
)
@pytest.mark.parametrize("owner", ("vertex", "face"))
@pytest.mark.parametrize("alpha", (False, True))
def test_colours_of_a_ply_of_every_type(tmp_path: Path, kind: str, most: int, owner: str, alpha: bool) -> None:
    wanted = np.array([0.8, 0.4, 0.2])
    numbers = [f"{value:.6f}" if most == 1 else str(round(value)) for value in (*wanted * most, *[most / 2] * alpha)]
    names = ("red", "green", "blue", "alpha")[: 3 + alpha]
    properties = "".join(f"property {kind} {name}\n" for name in names)
    shown = {owner: properties, f"of_{owner}": " ".join(numbers)}
    for more in ({}, {"vertex": shown.get("vertex", "") + "property float s\nproperty float t\n"}):
        values = dict(shown) | more
        if more:
            values["of_vertex"] = values.get("of_vertex", "") + " 0.5 0.5"
        model = read_mesh(ply(tmp_path, **values, name=f"a{len(more)}"))
        np.testing.assert_allclose(albedo(model), linear_from_srgb(wanted.astype(np.float32)), atol=0.005)


@pytest.mark.parametrize("order", ("<", ">"))
def test_binary_ply_with_polygons_of_any_size(tmp_path: Path, order: str) -> None:
    name = "little" if order == "<" else "big"
    head = PLY.format(vertex="", face="").replace("ascii", f"binary_{name}_endian")
    places = np.array([place.split() for place in PLACES], float).astype(f"{order}f4").tobytes()
    for polygons, faces in (([[0, 1, 2], [0, 2, 3]], 2), ([[0, 1, 2, 3], [0, 1, 2]], 3), ([[0, 1], [0, 1, 2]], 1)):
        rows = b"".join(bytes([len(row)]) + np.array(row, f"{order}i4").tobytes() for row in polygons)
        path = tmp_path / f"{faces}.ply"
        path.write_bytes(head.encode() + places + rows)
        assert len(read_mesh(path).faces) == faces
        path = tmp_path / f"{faces}.cut.ply"
        path.write_bytes(head.encode() + places + rows[:-1])
        with pytest.raises(ScenarioError, match="ends before the last of 2 'face'"):
            read_mesh(path)


def test_a_textured_ply_is_as_bright_as_its_texture(tmp_path: Path) -> None:
    red(tmp_path, "my t.png")
    head = "comment TextureFile my t.png\n"
    wanted = linear_from_srgb(np.array([200, 0, 0], np.float32) / 255)
    for path in (
        ply(tmp_path, "property float s\nproperty float t\n", "0.5 0.5", head=head),
        ply(tmp_path, face="property list uchar float texcoord\n", of_face="6 0 0 1 0 1 1", head=head, name="b"),
    ):
        np.testing.assert_allclose(albedo(read_mesh(path)), wanted, atol=1e-5)
    path = ply(tmp_path, head=head, name="c")
    np.testing.assert_allclose(albedo(read_mesh(path)), GREY_LINEAR, atol=1e-5)
    assert notes(path) == ["its texture 'my t.png' is left out: it has no texture coordinates"]


def test_strips_of_a_ply(tmp_path: Path) -> None:
    path = ply(tmp_path)
    text = path.read_text().replace("element face 2", "element tristrips 1").replace("list uchar int", "list int int")
    path.write_text(text.replace("3 0 1 2 \n3 0 2 3 \n", "8 0 1 3 2 -1 1 2 3\n"))
    assert len(read_mesh(path).faces) == 3


@pytest.mark.parametrize(
    ("head", "vertex", "face", "wanted"),
    [
        ("OFF", "", "", [GREY] * 3), ("COFF", " 204 102 51 255", "", [0.8, 0.4, 0.2]),
        ("COFF", " 0.8 0.4 0.2 1.0", "", [0.8, 0.4, 0.2]), ("OFF", " 204 102 51", "", [0.8, 0.4, 0.2]),
        ("OFF", "", " 204 102 51", [0.8, 0.4, 0.2]), ("OFF", "", " 0.8 0.4 0.2 1.0", [0.8, 0.4, 0.2]),
        ("NOFF", " 0 0 1", "", [GREY] * 3), ("STOFF", " 0.5 0.5", "", [GREY] * 3),
        ("STCNOFF", " 0 0 1 0.8 0.4 0.2 1 0.5 0.5", "", [0.8, 0.4, 0.2]), ("OFF", "", " 3", [GREY] * 3),
    ],
)  # fmt: skip
def test_colours_of_an_off(tmp_path: Path, head: str, vertex: str, face: str, wanted: list[float]) -> None:
    rows = [f"{place}{vertex}" for place in PLACES] + [f"3 {corners}{face}" for corners in ("0 1 2", "0 2 3")]
    for first in (f"{head}\n# made by hand\n4 2 0\n", f"{head} 4 2 0\n", f"{head}4 2 0\n"):
        path = tmp_path / f"{len(first)}.off"
        path.write_text(first + "\n".join(rows))
        model = read_mesh(path)
        np.testing.assert_allclose(model.colours[0, 0], linear_from_srgb(np.array(wanted, np.float32)), atol=0.005)
        assert len(model.faces) == 2


@pytest.mark.parametrize("mode", ("I;16", "I;16B", "I", "L", "LA", "P", "RGB", "RGBA", "CMYK", "YCbCr", "PA"))
def test_pixels_of_every_mode_keep_their_brightness(mode: str) -> None:
    grey = np.full((3, 2), 200, np.uint8)
    if mode.startswith("I"):
        image = Image.new(mode, (2, 3))
        image.putdata([200 * 257] * 6)
    else:
        image = Image.fromarray(grey).convert("RGB" if mode in ("CMYK", "YCbCr") else "L").convert(mode)
    np.testing.assert_allclose(texture_pixels(image), 200, atol=1)


@pytest.mark.parametrize(("mode", "value"), [("I", 70000), ("I", -1), ("F", 0.5)])
def test_pixels_of_no_known_range_are_refused(mode: str, value: float) -> None:
    with pytest.raises(ValueError, match=rf"mode {mode}"):
        texture_pixels(Image.new(mode, (2, 2), value))


@pytest.mark.parametrize(
    ("kd", "wanted", "said"),
    [
        ("200 100 50", (200 / 255, 100 / 255, 50 / 255), "taken as 0 to 255"),
        ("1.5 0.5 0", (1.0, 0.5, 0.0), "cut off"),
        ("-1 0 0", (0.0, 0.0, 0.0), "cut off"),
    ],
)
def test_a_materials_colour_outside_of_its_range_is_said(
    tmp_path: Path, kd: str, wanted: tuple[float, ...], said: str
) -> None:
    path = obj(tmp_path, "v 0 0 0\nv 1 0 0\nv 1 1 0\nusemtl m\nf 1 2 3\n", f"newmtl m\nKd {kd}\n")
    np.testing.assert_allclose(read_mesh(path).colours[0, 0], linear_from_srgb(np.array(wanted)), atol=1e-6)
    (note,) = notes(path)
    assert f"the colour Kd {kd} in " in note and said in note


def test_an_off_that_lacks_its_colours_is_refused_in_words(tmp_path: Path) -> None:
    path = tmp_path / "a.off"
    path.write_text("COFF\n3 1 0\n0 0 0\n1 0 0\n1 1 0\n3 0 1 2\n")
    with pytest.raises(ScenarioError, match="says that vertices have colours, and has some without"):
        read_mesh(path)
