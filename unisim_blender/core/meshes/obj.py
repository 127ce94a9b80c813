"""Reader of Wavefront OBJ files with their materials (MTL)."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb
from ..errors import ScenarioError, short
from ..geometry import FloatArray
from .model import GREY, MeshPart
from .polygons import Polygon, file_beside, note, text_of, texture_beside, triangles_of


@dataclass
class _Material:
    colour: FloatArray | None = None
    texture: NDArray[np.uint8] | None = None
    scale: FloatArray = field(default_factory=lambda: np.ones(2))
    offset: FloatArray = field(default_factory=lambda: np.zeros(2))


def read_obj(path: Path, notes: list[str]) -> list[MeshPart]:
    """Return an OBJ file's triangles by material. Kd and vertex colours are taken as sRGB. Raises `ScenarioError`."""
    places: list[list[str]] = []
    coordinates: list[list[str]] = []
    directions: list[list[str]] = []
    groups: dict[str | None, tuple[list[Polygon], list[Polygon], list[Polygon]]] = {}
    materials: dict[str, _Material] = {}
    material: str | None = None
    for number, line in enumerate(text_of(path).replace("\\\r\n", " ").replace("\\\n", " ").splitlines(), 1):
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
            note(notes, "points, lines and curves are left out")
    if not groups:
        return []
    lengths = {len(place) for place in places}
    table = np.array(places if len(lengths) == 1 else [place[:3] for place in places], float)
    vertices, colours = table[:, :3], None
    if lengths <= {6, 7}:
        shown = table[:, 3:6] / (255.0 if table[:, 3:6].max() > 1 else 1.0)
        colours = linear_from_srgb(np.asarray(shown, np.float32))
    elif any(length > 5 for length in lengths):
        note(notes, "colours of some of its vertices are left out, since others have none")
    uvs = np.array([(place + ["0"])[:2] for place in coordinates], float).reshape(-1, 2)
    normals = np.array([place[:3] for place in directions], float).reshape(-1, 3)
    parts = []
    for name, group in groups.items():
        if name is not None and name not in materials:
            note(notes, f"the material {short(name)} is not there: its faces are grey")
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
    """Return the triangles of one material: those with a texture, and those that have no coordinates on it."""
    triangles, _ = triangles_of(group[0], vertices, notes)
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
    places = [-1, -1, -1]
    for k, text in enumerate(word.split("/")[:3]):
        if not text:
            continue
        number = int(text)
        at = number - 1 if number > 0 else counts[k] + number
        if number == 0 or not 0 <= at < counts[k]:
            what = ("vertex", "texture coordinate", "normal")[k]
            raise ScenarioError(f"{path}: line {line} names {what} {number}, which is not there: there are {counts[k]}")
        places[k] = at
    if places[0] < 0:
        raise ScenarioError(f"{path}: line {line} names no vertex: {short(word)}")
    return tuple(places)


def _read_libraries(rest: str, names: list[str], materials: dict[str, _Material], path: Path, notes: list[str]) -> None:
    files = {name: file_beside(path.parent, name) for name in (rest, *names)}
    if files[rest] is not None or not any(files.values()):
        files = {rest: files[rest]}
    else:
        del files[rest]
    for name, file in files.items():
        if file is None:
            note(notes, f"its materials {short(name)} are missing")
        else:
            materials |= _materials(file, path, notes)


def _materials(file: Path, path: Path, notes: list[str]) -> dict[str, _Material]:
    """Return the materials of an MTL file by name."""
    materials: dict[str, _Material] = {}
    material = _Material()
    for line in text_of(file).splitlines():
        words = line.split()
        if len(words) < 2:
            continue
        key, rest = words[0].lower(), line.split(None, 1)[1].strip()
        if key == "newmtl":
            material = materials.setdefault(rest, _Material())
        elif key == "kd" and words[1] in ("spectral", "xyz"):
            note(notes, f"the colour {short(rest)} in {file.name} is left out")
        elif key == "kd":
            material.colour = _kd(np.array((words[1:4] * 3)[:3], float), file, notes)
        elif key == "map_kd":
            name = _options(rest, material, file, notes)
            material.texture = texture_beside(name, f" of {file.name}", path)
        elif (key == "d" and float(words[-1]) < 1) or (key == "tr" and float(words[-1]) > 0) or key == "map_d":
            note(notes, f"transparency in {file.name} is left out")
        elif key == "ke" and any(float(word) > 0 for word in words[1:4]):
            note(notes, f"emitted light in {file.name} is left out")
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
                note(notes, f"the option -t of a texture in {file.name} is left out")
        elif match["pair"]:
            if [float(value) for value in match["mm"].split()] != [0.0, 1.0]:
                note(notes, f"the option -mm {match['mm']} of a texture in {file.name} is left out")
        elif match["one"].lower() in ("clamp", "cc", "imfchan") and match["value"].lower() != "off":
            note(notes, f"the option -{match['one']} of a texture in {file.name} is left out")
    return text.strip()


def _kd(colour: FloatArray, file: Path, notes: list[str]) -> FloatArray:
    """Return a material's colour (3,) in 0..1. Whole numbers above 1 are of 0 to 255; values outside are clipped, and
    noted."""
    if not ((colour >= 0) & (colour <= 1)).all():
        scale = 255.0 if colour.max() > 1 and (colour == np.round(colour)).all() else 1.0
        read = "taken as 0 to 255" if scale > 1 else "cut off"
        note(notes, f"the colour Kd {' '.join(f'{x:g}' for x in colour)} in {file.name} is not in 0 to 1: it is {read}")
        colour = colour / scale
    return np.clip(colour, 0, 1)
