"""Polygons as triangles, textures and texts beside a mesh file, and the reader of OFF files."""

from __future__ import annotations

import re
from collections.abc import Callable
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
"""Largest number of corners of a concave polygon: the time of its triangulation grows with their cube."""


def file_beside(folder: Path, name: str) -> Path | None:
    """Return the file that another one names; None where there is none. Quotes are removed from the name, its folders
    may be those of another machine, and the case of letters may differ."""
    bare = name.strip().strip('"').strip("'").strip().replace("\\", "/")
    for text in dict.fromkeys((name.strip(), bare, bare.rpartition("/")[2])):
        if text and "\0" not in text and (folder / text).is_file():
            return folder / text
    wanted = bare.rpartition("/")[2].lower()
    return next((file for file in sorted(folder.iterdir()) if file.name.lower() == wanted and file.is_file()), None)


def texture_beside(name: str, where: str, path: Path) -> NDArray[np.uint8]:
    """Return the texture that the mesh file ``path`` names; ``where`` says where, in a sentence. Raises
    `ScenarioError`."""
    file = file_beside(path.parent, name)
    if file is None:
        raise ScenarioError(f"{path}: its texture {short(name)}{where} is missing")
    return texture_of(file.read_bytes(), short(file.name), path)


def triangles_of(polygons: list[Polygon], vertices: FloatArray, notes: list[str]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the triangles of polygons as indices (F, 3) of all their corners in a row, and the number (F,) of each
    one's polygon: fans of convex polygons, ears of others."""
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
            note(notes, f"concave polygons of more than {MOST_CORNERS} corners are read as if they were convex")
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

    left, ears = list(range(len(corners))), []
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
        ears.append((a, b, c))
        del left[k]
    return np.array([*ears, tuple(left)])


def check_corners(faces: NDArray[Any], count: int, path: Path, face: Callable[[int], tuple[int, list[int]]]) -> None:
    """Raise `ScenarioError` where triangles (F, 3) name none of ``count`` vertices; ``face`` gives the number of a
    triangle's face in the file, and its vertices."""
    bad = (faces < 0) | (faces >= count)
    if bad.any():
        number, corners = face(int(bad.any(1).argmax()))
        raise ScenarioError(
            f"{path}: face {number} is {corners} and names a vertex that is not there: there are {count}"
        )


def read_off(path: Path, notes: list[str]) -> list[MeshPart]:
    """Return an OFF file's triangles (Geomview), of vertices or faces with colours, sRGB. Raises `ScenarioError`."""
    lines = [line for line in (line.split("#", 1)[0].strip() for line in text_of(path).splitlines()) if line]
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
        note(notes, "texture coordinates are left out: an OFF file names no texture")
    polygons: list[Polygon] = []
    own: list[list[str]] = []
    for row in rows[counts[0] :]:
        size = int(row[0])
        if size > len(row) - 1:
            raise ScenarioError(f"{path}: face {len(polygons)} has {len(row) - 1} vertices, not {size}")
        polygons.append([int(word) for word in row[1 : 1 + max(size, 0)]])
        own.append(row[1 + max(size, 0) :][:3])
    corners, owner = triangles_of(polygons, vertices, notes)
    faces = np.array([i for polygon in polygons for i in polygon], np.int64)[corners]
    check_corners(faces, len(vertices), path, lambda at: (int(owner[at]), polygons[int(owner[at])]))
    colours = np.full((len(faces), 3, 3), GREY)
    has_colour = [len(colour) == 3 for colour in own]
    if shown is not None:
        colours = shown[faces]
    elif any(has_colour):
        of_faces = np.full((len(own), 3), GREY)
        of_faces[has_colour] = _off_colours([colour for colour in own if len(colour) == 3])
        colours = np.repeat(of_faces[owner][:, None], 3, 1)
    elif any(own):
        note(notes, "colours are left out: they are numbers in a table that the file does not hold")
    normals = None
    if has_normals:
        normals = np.array([row[3:6] for row in rows[: counts[0]]], float)[faces]
    return [MeshPart(vertices, faces, linear_from_srgb(np.asarray(colours, np.float32)), normals)]


def _off_colours(words: list[list[str]]) -> FloatArray:
    """Colours (N, 3) in 0..1: whole numbers reach 255."""
    values = np.array(words, float).reshape(-1, 3)
    whole = not any("." in word or "e" in word.lower() for row in words for word in row)
    return values / 255.0 if (whole and values.max(initial=0.0) > 0) or values.max(initial=0.0) > 1 else values


def text_of(path: Path) -> str:
    """Return a file's text, UTF-8 or Latin-1."""
    content = path.read_bytes()
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("latin-1")


def note(notes: list[str], sentence: str) -> None:
    """Add a sentence to notes, once."""
    if sentence not in notes:
        notes.append(sentence)
