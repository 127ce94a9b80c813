"""Reader of PLY files, as text and binary."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb
from ..errors import ScenarioError, short
from ..geometry import FloatArray
from .model import GREY, MeshPart
from .polygons import check_corners, note, texture_beside, triangles_of

SCALARS = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2",
    "uint16": "u2", "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
COORDINATES = (("texture_u", "texture_v"), ("u", "v"), ("s", "t"))


@dataclass
class _Element:
    count: int
    properties: list[tuple[str, str, str | None]] = field(default_factory=list)
    """Name, type, and the type of a list's length or None."""
    columns: dict[str, Any] = field(default_factory=dict)
    """Values (N,) of each property, or a list of arrays."""

    def table(self, names: Sequence[str]) -> FloatArray | None:
        """Return properties (N, K); None where one is not there."""
        if not all(name in self.columns for name in names):
            return None
        return np.stack([np.asarray(self.columns[name], float) for name in names], -1)


def read_ply(path: Path, notes: list[str]) -> list[MeshPart]:
    """Return a PLY file's triangles. Its colours are sRGB; integers are fractions of their type's largest. Raises
    `ScenarioError`."""
    elements, textures = _ply_elements(path.read_bytes(), path)
    vertex, face, strips = (elements.get(name, _Element(0)) for name in ("vertex", "face", "tristrips"))
    vertices = vertex.table("xyz")
    if vertices is None:
        raise ScenarioError(f"{path}: its vertices have no x, y and z")
    owner, corners = np.zeros(0, np.int64), None
    if strips.count:
        faces = _strips(_lists(strips, path))
        if face.count:
            note(notes, "faces beside strips are left out")
    elif face.count:
        polygons = [row.tolist() for row in _lists(face, path)]
        flat = np.array([i for polygon in polygons for i in polygon], np.int64)
        corners, owner = triangles_of(polygons, vertices, notes)
        faces = flat[corners]
    else:
        return []
    n, shown = len(faces), _ply_colours(vertex)
    check_corners(faces, len(vertices), path, lambda at: (int(owner[at]) if len(owner) else at, faces[at].tolist()))
    of_faces = _ply_colours(face) if corners is not None else None
    if shown is not None:
        colours = shown[faces]
    elif of_faces is not None:
        colours = np.repeat(of_faces[owner][:, None], 3, 1)
    else:
        colours = np.full((n, 3, 3), 1.0 if textures else GREY)
    uv, on = _ply_coordinates(vertex, face, faces, corners)
    if uv is None and textures:
        note(notes, f"its texture {short(textures[0])} is left out: it has no texture coordinates")
        textures = []
        colours = np.full((n, 3, 3), GREY) if shown is None and of_faces is None else colours
    of_vertices = vertex.table(("nx", "ny", "nz"))
    normals = None if of_vertices is None else of_vertices[faces]
    linear = linear_from_srgb(np.asarray(colours, np.float32))
    number = np.zeros(n, np.int64)
    if len(textures) > 1 and "texnumber" in face.columns and corners is not None:
        number = np.asarray(face.columns["texnumber"], np.int64)[owner]
    parts = []
    for k, name in [*enumerate(textures), (-1, "")]:
        mine = on & (number == k) if k >= 0 else ~(on & (number >= 0) & (number < len(textures)))
        if not mine.any() or (uv is None and k >= 0):
            continue
        texture = texture_beside(name, "", path) if k >= 0 else None
        own_normals = None if normals is None else normals[mine]
        own_uv = uv[mine] if texture is not None and uv is not None else None
        parts.append(MeshPart(vertices, faces[mine], linear[mine], own_normals, own_uv, texture))
    return parts


def _strips(rows: list[NDArray[Any]]) -> NDArray[Any]:
    """Faces (F, 3) of strips that -1 separates."""
    faces = [np.zeros((0, 3), np.int64)]
    for row in rows:
        for strip in np.split(row, np.flatnonzero(row < 0)):
            strip = strip[strip >= 0].astype(np.int64)
            i = np.arange(max(len(strip) - 2, 0))
            faces.append(np.stack([strip[i], strip[i + 1 + i % 2], strip[i + 2 - i % 2]], -1))
    triangles = np.concatenate(faces)
    a, b, c = triangles.T
    return triangles[(a != b) & (b != c) & (a != c)]


def _lists(element: _Element, path: Path) -> list[NDArray[Any]]:
    for name in ("vertex_indices", "vertex_index"):
        if name in element.columns:
            rows = element.columns[name]
            if rows and not isinstance(rows[0], np.ndarray):
                break
            return list(rows)
    raise ScenarioError(f"{path}: its faces have no vertex_indices")


def _ply_colours(element: _Element) -> FloatArray | None:
    """Colours (N, 3), sRGB in 0..1, None where an element has none."""
    for names in COLOURS:
        values = element.table(names)
        if values is not None:
            kinds = {name: kind for name, kind, _ in element.properties}
            kind = np.dtype(SCALARS[kinds[names[0]]])
            most = float(values.max(initial=0.0))
            if kind.kind == "f":
                return values / (255.0 if most > 1 else 1.0)
            # integers wider than a byte often hold bytes all the same
            return values / (255.0 if kind.itemsize == 1 or most <= 255 else 65535.0)
    return None


def _ply_coordinates(
    vertex: _Element, face: _Element, faces: NDArray[Any], corners: NDArray[Any] | None
) -> tuple[FloatArray | None, NDArray[np.bool_]]:
    """uv (F, 3, 2) of faces, None where there are none, and which faces have them."""
    everywhere = np.ones(len(faces), bool)
    if "texcoord" in face.columns and corners is not None:
        rows = face.columns["texcoord"]
        sizes = [len(row) for row in _lists(face, Path())]
        fits = np.array([len(row) == 2 * size for row, size in zip(rows, sizes, strict=True)], bool)
        filled = [row if good else np.zeros(2 * size) for row, size, good in zip(rows, sizes, fits, strict=True)]
        flat = np.concatenate(filled).reshape(-1, 2).astype(float)
        first_corner = np.cumsum([0, *sizes])
        owner = np.searchsorted(first_corner, corners[:, 0], side="right") - 1
        return flat[corners], fits[owner]
    for names in COORDINATES:
        values = vertex.table(names)
        if values is not None:
            return values[faces], everywhere
    return None, everywhere


def _ply_elements(content: bytes, path: Path) -> tuple[dict[str, _Element], list[str]]:
    """Return the elements of a PLY file by name, and the textures that its comments name."""
    head = re.match(rb"ply\s.*?\bend_header[ \t]*\r?\n?", content, re.DOTALL)
    if head is None:
        raise ScenarioError(f"{path}: cannot be read as a mesh: it has no PLY header")
    elements: dict[str, _Element] = {}
    textures, kind, element = [], "", _Element(0)
    for line in head[0].decode("latin-1").splitlines():
        words = line.split()
        if line.lower().startswith("comment texturefile "):
            textures.append(line.split(None, 2)[2].strip().encode("latin-1").decode("utf-8", "replace"))
        elif words[:1] == ["format"]:
            kind = words[1]
        elif words[:1] == ["element"]:
            element = elements[words[1]] = _Element(int(words[2]))
        elif words[:2] == ["property", "list"]:
            element.properties.append((words[4], words[3], words[2]))
        elif words[:1] == ["property"]:
            element.properties.append((words[2], words[1], None))
    body = content[head.end() :]
    for name, element in elements.items():
        for _, scalar, length in element.properties:
            if scalar not in SCALARS or (length is not None and SCALARS.get(length, "f")[0] == "f"):
                raise ScenarioError(f"{path}: its element {short(name)} has the type {short(scalar)}, none of PLY's")
        if element.count < 0 or element.count > len(body):
            raise ScenarioError(f"{path}: has no place for {element.count} of {short(name)}")
    if kind == "ascii":
        _ply_text(elements, body, path)
    elif kind in ("binary_little_endian", "binary_big_endian"):
        _ply_binary(elements, body, "<" if "little" in kind else ">", path)
    else:
        raise ScenarioError(f"{path}: has the PLY format {short(kind)}, which is none")
    return elements, textures


def _ply_text(elements: dict[str, _Element], body: bytes, path: Path) -> None:
    words, place = body.split(), 0
    for name, element in elements.items():
        rows: dict[str, list[Any]] = {key: [] for key, _, _ in element.properties}
        width = len(element.properties)
        if all(length is None for _, _, length in element.properties):
            values = np.array(words[place : place + element.count * width]).astype(float)
            if len(values) < element.count * width:
                raise ScenarioError(f"{path}: ends before the last of {element.count} {short(name)}")
            table = values.reshape(element.count, width)
            element.columns = {key: table[:, k] for k, (key, _, _) in enumerate(element.properties)}
            place += element.count * width
            continue
        for _ in range(element.count):
            for key, scalar, length in element.properties:
                size = 1
                if length is not None:
                    size, place = _whole_number(words, place, name, path), place + 1
                if size < 0 or place + size > len(words):
                    raise ScenarioError(f"{path}: ends before the last of {element.count} {short(name)}")
                read = float if SCALARS[scalar][0] == "f" else int
                numbers = [read(word) for word in words[place : place + size]]
                place += size
                rows[key].append(numbers[0] if length is None else np.array(numbers))
        element.columns = rows


def _whole_number(words: list[bytes], place: int, name: str, path: Path) -> int:
    if place >= len(words):
        raise ScenarioError(f"{path}: ends before the last of {short(name)}")
    return int(words[place])


def _ply_binary(elements: dict[str, _Element], body: bytes, order: str, path: Path) -> None:
    place = 0
    for name, element in elements.items():
        ends = ScenarioError(f"{path}: ends before the last of {element.count} {short(name)}")
        kinds = [(key, np.dtype(order + SCALARS[kind]), length) for key, kind, length in element.properties]
        # lists of one length each, which most files have, are a table
        fields: list[Any] = []
        begin = place
        for key, kind, length in kinds:
            if length is None:
                fields.append((key, kind))
                begin += kind.itemsize
                continue
            counter = np.dtype(order + SCALARS[length])
            if begin + counter.itemsize > len(body):
                if element.count:
                    raise ends
                break
            size = int(np.frombuffer(body, counter, 1, begin)[0]) if element.count else 0
            if size < 0 or begin + size * kind.itemsize > len(body):
                raise ends
            fields += [(f"length of {key}", counter), (key, kind, (size,))]
            begin += counter.itemsize + size * kind.itemsize
        row = np.dtype(fields)
        if place + element.count * row.itemsize <= len(body):
            table = np.frombuffer(body, row, element.count, place)
            lists = [key for key, _, length in kinds if length is not None and element.count]
            if all((table[f"length of {key}"] == table[key].shape[1]).all() for key in lists):
                element.columns = {key: list(table[key]) if key in lists else table[key] for key, _, _ in kinds}
                place += element.count * row.itemsize
                continue
        elif all(length is None for _, _, length in kinds):
            raise ends
        rows: dict[str, list[Any]] = {key: [] for key, _, _ in kinds}
        for _ in range(element.count):
            for key, kind, length in kinds:
                size = 1
                if length is not None:
                    counter = np.dtype(order + SCALARS[length])
                    if place + counter.itemsize > len(body):
                        raise ends
                    size = int(np.frombuffer(body, counter, 1, place)[0])
                    place += counter.itemsize
                if size < 0 or place + size * kind.itemsize > len(body):
                    raise ends
                values = np.frombuffer(body, kind, size, place)
                place += size * kind.itemsize
                rows[key].append(values[0] if length is None else values)
        element.columns = rows
