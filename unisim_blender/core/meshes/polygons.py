"""Files of polygons: Wavefront OBJ with its materials (MTL), PLY and OFF."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb
from ..errors import ScenarioError, short
from ..geometry import FloatArray
from .model import GREY, MeshPart, texture_of

Polygon = list[int]
MOST_CORNERS = 256
"""Of a concave polygon: the time that its triangles take grows with their cube."""


def file_beside(folder: Path, name: str) -> Path | None:
    """The file that another one names: quotes are no part of the name, folders may be those of another machine, and
    letters of either case; None where there is none."""
    bare = name.strip().strip('"').strip("'").strip().replace("\\", "/")
    for text in dict.fromkeys((name.strip(), bare, bare.rpartition("/")[2])):
        if text and "\0" not in text and (folder / text).is_file():
            return folder / text
    wanted = bare.rpartition("/")[2].lower()
    return next((file for file in sorted(folder.iterdir()) if file.name.lower() == wanted and file.is_file()), None)


def _texture_beside(name: str, where: str, path: Path) -> NDArray[np.uint8]:
    file = file_beside(path.parent, name)
    if file is None:
        raise ScenarioError(f"{path}: its texture {short(name)}{where} is missing")
    return texture_of(file.read_bytes(), short(file.name), path)


def _triangles(polygons: list[Polygon], vertices: FloatArray, notes: list[str]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Triangles of polygons, as places (F, 3) in the row of all their corners, and whose each is (F,): fans of convex
    ones, ears of others."""
    sizes = np.array([len(polygon) for polygon in polygons], np.int64)
    begins = np.cumsum(sizes) - sizes
    counts = np.maximum(sizes - 2, 0)
    owner = np.repeat(np.arange(len(sizes)), counts)
    ahead = np.cumsum(counts) - counts
    step = np.arange(len(owner)) - np.repeat(ahead, counts)
    first = begins[owner]
    triangles = np.stack([first, first + step + 1, first + step + 2], -1)
    flat = np.array([i for polygon in polygons for i in polygon], np.int64)
    if not (sizes > 3).any() or flat.min() < 0 or flat.max() >= len(vertices):
        return triangles, owner
    a, b, c = (vertices[flat[triangles[:, k]]] for k in range(3))
    areas = np.cross(b - a, c - a)
    total = np.stack([np.bincount(owner, areas[:, k], len(sizes)) for k in range(3)], -1)
    # a fan of a concave polygon has triangles that face the other way
    turned = (areas * total[owner]).sum(-1) < 0
    for i in np.unique(owner[turned]):
        if sizes[i] > MOST_CORNERS:
            _note(notes, f"concave polygons of more than {MOST_CORNERS} corners are read as if they were convex")
            continue
        corners = vertices[flat[begins[i] : begins[i] + sizes[i]]]
        triangles[ahead[i] : ahead[i] + counts[i]] = begins[i] + _ears(corners, total[i])
    return triangles, owner


def _ears(corners: FloatArray, normal: FloatArray) -> NDArray[Any]:
    """Triangles (N - 2, 3) of one polygon (N, 3) round its normal, by clipping ears (Meisters, 1975)."""
    keep = np.argsort(np.abs(normal))[:2]
    flat = corners[:, np.sort(keep)]

    def area(a: int, b: int, c: int) -> float:
        (ax, ay), (bx, by), (cx, cy) = flat[a], flat[b], flat[c]
        return float((bx - ax) * (cy - ay) - (by - ay) * (cx - ax))

    left, found = list(range(len(corners))), []
    side = np.sign(sum(area(0, k, k + 1) for k in range(1, len(corners) - 1)))
    while len(left) > 3:
        for k in range(len(left)):
            a, b, c = left[k - 1], left[k], left[(k + 1) % len(left)]
            if area(a, b, c) * side > 0 and not any(
                min(area(a, b, i) * side, area(b, c, i) * side, area(c, a, i) * side) >= 0
                for i in left
                if i not in (a, b, c)
            ):
                break
        else:
            k, (a, b, c) = 0, (left[-1], left[0], left[1])  # crosses itself
        found.append((a, b, c))
        del left[k]
    return np.array([*found, tuple(left)])


# ---- OBJ
@dataclass
class _Material:
    colour: FloatArray | None = None
    texture: NDArray[np.uint8] | None = None
    scale: FloatArray = field(default_factory=lambda: np.ones(2))
    offset: FloatArray = field(default_factory=lambda: np.zeros(2))


def read_obj(path: Path, notes: list[str]) -> list[MeshPart]:
    """An OBJ file's triangles, by material. Kd and vertex colours are taken as sRGB. Raises `ScenarioError`."""
    places: list[list[str]] = []
    coordinates: list[list[str]] = []
    directions: list[list[str]] = []
    groups: dict[str | None, tuple[list[Polygon], list[Polygon], list[Polygon]]] = {}
    materials: dict[str, _Material] = {}
    material: str | None = None
    for number, line in enumerate(_text(path).replace("\\\r\n", " ").replace("\\\n", " ").splitlines(), 1):
        words = line.split("#", 1)[0].split() if not line.lstrip().startswith(("mtllib", "usemtl")) else line.split()
        if not words:
            continue
        key = words[0]
        if key == "v":
            places.append(words[1:])
        elif key == "vt":
            coordinates.append(words[1:])
        elif key == "vn":
            directions.append(words[1:])
        elif key in ("f", "fo") and len(words) > 3:
            group = groups.setdefault(material, ([], [], []))
            counts = len(places), len(coordinates), len(directions)
            corners = [_corner(word, counts, number, path) for word in words[1:]]
            for k in range(3):
                group[k].append([corner[k] for corner in corners])
        elif key == "usemtl":
            material = line.split(None, 1)[1].strip() if len(words) > 1 else None
        elif key == "mtllib" and len(words) > 1:
            _read_libraries(line.split(None, 1)[1].strip(), words[1:], materials, path, notes)
        elif key in ("l", "p", "curv", "curv2", "surf"):
            _note(notes, "points, lines and curves are left out")
    if not groups:
        return []
    lengths = {len(place) for place in places}
    table = np.array(places if len(lengths) == 1 else [place[:3] for place in places], float)
    vertices, colours = table[:, :3], None
    if lengths <= {6, 7}:
        shown = table[:, 3:6] / (255.0 if table[:, 3:6].max() > 1 else 1.0)
        colours = linear_from_srgb(np.asarray(shown, np.float32))
    elif any(length > 5 for length in lengths):
        _note(notes, "colours of some of its vertices are left out, since others have none")
    uvs = np.array([(place + ["0"])[:2] for place in coordinates], float).reshape(-1, 2)
    normals = np.array([place[:3] for place in directions], float).reshape(-1, 3)
    parts = []
    for name, group in groups.items():
        if name is not None and name not in materials:
            _note(notes, f"the material {short(name)} is not there: its faces are grey")
        parts += _of_material(materials.get(name or "", _Material()), group, vertices, colours, uvs, normals, notes)
    return parts


def _of_material(
    material: _Material,
    group: tuple[list[Polygon], list[Polygon], list[Polygon]],
    vertices: FloatArray,
    vertex_colours: NDArray[np.float32] | None,
    uvs: FloatArray,
    normals: FloatArray,
    notes: list[str],
) -> list[MeshPart]:
    """The triangles of one material: those with a texture, and those that have no coordinates on it."""
    triangles, _ = _triangles(group[0], vertices, notes)
    v, vt, vn = (np.array([i for polygon in polygons for i in polygon])[triangles] for polygons in group)
    colour = material.colour
    if colour is not None and not colour.any() and material.texture is not None:
        colour = None  # some programs write black beside a texture, which replaces it there
    on_texture = (vt >= 0).all(1) & (material.texture is not None)
    parts = []
    for mine, texture in ((on_texture, material.texture), (~on_texture, None)):
        if not mine.any():
            continue
        plain = np.full(3, 1.0 if texture is not None or vertex_colours is not None else GREY)
        base = linear_from_srgb(np.asarray(plain if colour is None else colour, np.float32))
        colours = np.broadcast_to(base, (int(mine.sum()), 3, 3))
        if vertex_colours is not None:
            colours = colours * vertex_colours[v[mine]]
        has_normals = (vn[mine] >= 0).all() and len(normals) > 0
        uv = None if texture is None else uvs[vt[mine]] * material.scale + material.offset
        parts.append(MeshPart(vertices, v[mine], colours, normals[vn[mine]] if has_normals else None, uv, texture))
    return parts


def _corner(word: str, counts: tuple[int, int, int], line: int, path: Path) -> tuple[int, ...]:
    """Numbers of a corner's vertex, texture coordinate and normal, from 0; -1 for one that it does not have."""
    found = [-1, -1, -1]
    for k, text in enumerate(word.split("/")[:3]):
        if not text:
            continue
        number = int(text)
        at = number - 1 if number > 0 else counts[k] + number
        if number == 0 or not 0 <= at < counts[k]:
            what = ("vertex", "texture coordinate", "normal")[k]
            raise ScenarioError(f"{path}: line {line} names {what} {number}, which is not there: there are {counts[k]}")
        found[k] = at
    if found[0] < 0:
        raise ScenarioError(f"{path}: line {line} names no vertex: {short(word)}")
    return tuple(found)


def _read_libraries(rest: str, names: list[str], materials: dict[str, _Material], path: Path, notes: list[str]) -> None:
    files = {name: file_beside(path.parent, name) for name in (rest, *names)}
    if files[rest] is not None or not any(files.values()):
        files = {rest: files[rest]}
    else:
        del files[rest]
    for name, file in files.items():
        if file is None:
            _note(notes, f"its materials {short(name)} are missing")
        else:
            materials |= _materials(file, path, notes)


def _materials(file: Path, path: Path, notes: list[str]) -> dict[str, _Material]:
    """The materials of an MTL file by name."""
    materials: dict[str, _Material] = {}
    material = _Material()
    for line in _text(file).splitlines():
        words = line.split()
        if len(words) < 2:
            continue
        key, rest = words[0].lower(), line.split(None, 1)[1].strip()
        if key == "newmtl":
            material = materials.setdefault(rest, _Material())
        elif key == "kd" and words[1] in ("spectral", "xyz"):
            _note(notes, f"the colour {short(rest)} in {file.name} is left out")
        elif key == "kd":
            material.colour = _kd(np.array((words[1:4] * 3)[:3], float), file, notes)
        elif key == "map_kd":
            name = _options(rest, material, file, notes)
            material.texture = _texture_beside(name, f" of {file.name}", path)
        elif (key == "d" and float(words[-1]) < 1) or (key == "tr" and float(words[-1]) > 0) or key == "map_d":
            _note(notes, f"transparency in {file.name} is left out")
        elif key == "ke" and any(float(word) > 0 for word in words[1:4]):
            _note(notes, f"emitted light in {file.name} is left out")
    return materials


_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_OPTION = re.compile(
    rf"-(?:(?P<triple>[sot])(?P<values>(?:\s+{_NUMBER}){{1,3}})|(?P<pair>mm)\s+(?P<mm>{_NUMBER}\s+{_NUMBER})"
    rf"|(?P<one>bm|boost|texres|clamp|blendu|blendv|cc|imfchan|type|colorspace)\s+(?P<value>\S+))\s+",
    re.IGNORECASE,
)


def _options(text: str, material: _Material, file: Path, notes: list[str]) -> str:
    """Apply the options before a texture's name, and return the name."""
    while match := _OPTION.match(text):
        text = text[match.end() :]
        if match["triple"]:
            values = [float(value) for value in match["values"].split()]
            which = match["triple"].lower()
            if which == "s":
                material.scale = np.array((values + [1.0])[:2])
            elif which == "o":
                material.offset = np.array((values + [0.0])[:2])
            elif any(values):
                _note(notes, f"the option -t of a texture in {file.name} is left out")
        elif match["pair"]:
            if [float(value) for value in match["mm"].split()] != [0.0, 1.0]:
                _note(notes, f"the option -mm {match['mm']} of a texture in {file.name} is left out")
        elif match["one"].lower() in ("clamp", "cc", "imfchan") and match["value"].lower() != "off":
            _note(notes, f"the option -{match['one']} of a texture in {file.name} is left out")
    return text.strip()


# ---- PLY
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


def read_ply(path: Path, notes: list[str]) -> list[MeshPart]:
    """A PLY file's triangles. Its colours are sRGB; integers are parts of their type's largest. Raises `ScenarioError`."""
    elements, textures = _ply_elements(path.read_bytes(), path)
    vertex, face, strips = (elements.get(name, _Element(0)) for name in ("vertex", "face", "tristrips"))
    if not all(axis in vertex.columns for axis in "xyz"):
        raise ScenarioError(f"{path}: its vertices have no x, y and z")
    vertices = np.stack([np.asarray(vertex.columns[axis], float) for axis in "xyz"], -1)
    owner, corners = np.zeros(0, np.int64), None
    if strips.count:
        faces = _strips(_lists(strips, path))
        if face.count:
            _note(notes, "faces beside strips are left out")
    elif face.count:
        polygons = [row.tolist() for row in _lists(face, path)]
        flat = np.array([i for polygon in polygons for i in polygon], np.int64)
        corners, owner = _triangles(polygons, vertices, notes)
        faces = flat[corners]
    else:
        return []
    n, shown = len(faces), _ply_colours(vertex)
    bad = (faces < 0) | (faces >= len(vertices))
    if bad.any():
        at = int(bad.any(1).argmax())
        raise ScenarioError(
            f"{path}: face {int(owner[at]) if len(owner) else at} is {faces[at].tolist()} and names a vertex that is not "
            f"there: there are {len(vertices)}"
        )
    of_faces = _ply_colours(face) if corners is not None else None
    if shown is not None:
        colours = shown[faces]
    elif of_faces is not None:
        colours = np.repeat(of_faces[owner][:, None], 3, 1)
    else:
        colours = np.full((n, 3, 3), 1.0 if textures else GREY)
    uv, on = _ply_coordinates(vertex, face, faces, corners)
    if uv is None and textures:
        _note(notes, f"its texture {short(textures[0])} is left out: it has no texture coordinates")
        textures = []
        colours = np.full((n, 3, 3), GREY) if shown is None and of_faces is None else colours
    normals = None
    if all(axis in vertex.columns for axis in ("nx", "ny", "nz")):
        normals = np.stack([np.asarray(vertex.columns[axis], float) for axis in ("nx", "ny", "nz")], -1)[faces]
    linear = linear_from_srgb(np.asarray(colours, np.float32))
    number = np.zeros(n, np.int64)
    if len(textures) > 1 and "texnumber" in face.columns and corners is not None:
        number = np.asarray(face.columns["texnumber"], np.int64)[owner]
    parts = []
    for k, name in [*enumerate(textures), (-1, "")]:
        mine = on & (number == k) if k >= 0 else ~(on & (number >= 0) & (number < len(textures)))
        if uv is None or not mine.any():
            if k >= 0 or not mine.any():
                continue
        texture = _texture_beside(name, "", path) if k >= 0 else None
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
    found = np.concatenate(faces)
    a, b, c = found.T
    return found[(a != b) & (b != c) & (a != c)]


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
        if all(name in element.columns for name in names):
            kinds = {name: kind for name, kind, _ in element.properties}
            values = np.stack([np.asarray(element.columns[name], float) for name in names], -1)
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
        if all(name in vertex.columns for name in names):
            values = np.stack([np.asarray(vertex.columns[name], float) for name in names], -1)
            return values[faces], everywhere
    return None, everywhere


def _ply_elements(content: bytes, path: Path) -> tuple[dict[str, _Element], list[str]]:
    """The elements of a PLY file by name, and the textures that its comments name."""
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


# ---- OFF
def read_off(path: Path, notes: list[str]) -> list[MeshPart]:
    """An OFF file's triangles (Geomview): of vertices or faces with colours, sRGB. Raises `ScenarioError`."""
    lines = [line for line in (line.split("#", 1)[0].strip() for line in _text(path).splitlines()) if line]
    head = re.match(r"(ST)?(C)?(N)?(4)?(n)?OFF\b(?!\s*BINARY)|(ST)?(C)?(N)?OFF(?=\d)", lines[0]) if lines else None
    if head is None or head[4] or head[5]:
        raise ScenarioError(f"{path}: cannot be read as a mesh: it is no OFF file of text in three dimensions")
    has_uv, has_colours, has_normals = (bool(head[k] or head[k + 5]) for k in (1, 2, 3))
    lines[0] = lines[0][head.end() :].strip()
    lines = lines[0 if lines[0] else 1 :]
    counts = [int(word) for word in lines[0].split()[:2]] if lines else []
    if len(counts) < 2 or min(counts) < 0 or sum(counts) > len(lines) - 1:
        raise ScenarioError(f"{path}: has {len(lines) - 1} lines, which are not its {counts} vertices and faces")
    rows = [line.split() for line in lines[1 : 1 + sum(counts)]]
    begin = 6 if has_normals else 3
    vertices = np.array([row[:3] for row in rows[: counts[0]]], float).reshape(-1, 3)
    widths = {len(row) for row in rows[: counts[0]]}
    # many programs write a vertex's colour in a file that says nothing of it
    has_colours = has_colours or (not has_uv and widths <= {begin + 3, begin + 4} and not has_normals)
    end = -2 if has_uv else None
    if has_colours and any(len(row[begin:end]) < 3 for row in rows[: counts[0]]):
        raise ScenarioError(f"{path}: says that vertices have colours, and has some without")
    shown = _off_colours([row[begin:end][:3] for row in rows[: counts[0]]]) if has_colours else None
    if has_uv:
        _note(notes, "texture coordinates are left out: an OFF file names no texture")
    polygons: list[Polygon] = []
    own: list[list[str]] = []
    for row in rows[counts[0] :]:
        size = int(row[0])
        if size > len(row) - 1:
            raise ScenarioError(f"{path}: face {len(polygons)} has {len(row) - 1} vertices, not {size}")
        polygons.append([int(word) for word in row[1 : 1 + max(size, 0)]])
        own.append(row[1 + max(size, 0) :][:3])
    corners, owner = _triangles(polygons, vertices, notes)
    faces = np.array([i for polygon in polygons for i in polygon], np.int64)[corners]
    bad = (faces < 0) | (faces >= len(vertices))
    if bad.any():
        at = int(bad.any(1).argmax())
        raise ScenarioError(
            f"{path}: face {int(owner[at])} is {polygons[int(owner[at])]} and names a vertex that is not there: there are "
            f"{len(vertices)}"
        )
    colours = np.full((len(faces), 3, 3), GREY)
    told = [len(colour) == 3 for colour in own]
    if shown is not None:
        colours = shown[faces]
    elif any(told):
        of_faces = np.full((len(own), 3), GREY)
        of_faces[told] = _off_colours([colour for colour in own if len(colour) == 3])
        colours = np.repeat(of_faces[owner][:, None], 3, 1)
    elif any(own):
        _note(notes, "colours are left out: they are numbers in a table that the file does not hold")
    normals = None
    if has_normals:
        normals = np.array([row[3:6] for row in rows[: counts[0]]], float)[faces]
    return [MeshPart(vertices, faces, linear_from_srgb(np.asarray(colours, np.float32)), normals)]


def _kd(colour: FloatArray, file: Path, notes: list[str]) -> FloatArray:
    """A material's colour (3,) in 0..1. Whole numbers above 1 are of 0 to 255; what is outside is cut off, and said."""
    if not ((colour >= 0) & (colour <= 1)).all():
        scale = 255.0 if colour.max() > 1 and (colour == np.round(colour)).all() else 1.0
        read = "taken as 0 to 255" if scale > 1 else "cut off"
        _note(
            notes, f"the colour Kd {' '.join(f'{x:g}' for x in colour)} in {file.name} is not in 0 to 1: it is {read}"
        )
        colour = colour / scale
    return np.clip(colour, 0, 1)


def _off_colours(words: list[list[str]]) -> FloatArray:
    """Colours (N, 3) in 0..1: whole numbers reach 255."""
    values = np.array(words, float).reshape(-1, 3)
    whole = not any("." in word or "e" in word.lower() for row in words for word in row)
    return values / 255.0 if (whole and values.max(initial=0.0) > 0) or values.max(initial=0.0) > 1 else values


def _text(path: Path) -> str:
    content = path.read_bytes()
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def _note(notes: list[str], sentence: str) -> None:
    if sentence not in notes:
        notes.append(sentence)
