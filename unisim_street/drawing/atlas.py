"""The street's paint laid out in images: every face of an asset gets its place in an atlas that its
material has painted; and triangles cut by boxes, as a removal takes them away and a copy takes them along.

A material is a rule that paints points; a path tracer wants images. Flat faces of one plane share a chart, drawn as
they lie; curved surfaces are drawn from the six sides, as rays along the axes hit them; each small face of what is
speckled takes one of a few colours. Charts are as fine as a camera could see them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.colour import bytes_from_srgb, srgb_from_linear
from unisim_blender.core.geometry import BoolArray, FloatArray, invert_pose, rotate_vectors, transform_points
from unisim_blender.core.world.drive import Box

from ..paint.materials import Finish, SurfacePoints
from ..tracing.shapes import TracedTriangles
from ..tracing.trace import Asset, AssetPart


def outside(model: AssetModel, boxes: tuple[Box, ...]) -> AssetModel:
    """Return the part of the model that lies in none of the boxes; nothing closes the cuts."""
    for box in boxes:
        model = _split(model, box)[1]
    return model


def inside(model: AssetModel, box: Box) -> AssetModel:
    """Return the part of the model that lies in the box."""
    return _split(model, box)[0]


def _split(model: AssetModel, box: Box) -> tuple[AssetModel, AssetModel]:
    """The model inside and outside a box."""
    box_from_model = invert_pose(box.world_from_box)
    half = np.asarray(box.size_m, np.float64) / 2
    local = model.corners @ box_from_model[:3, :3].T + box_from_model[:3, 3]
    apart = ((local > half).all(1) | (local < -half).all(1)).any(1)
    rest, clear = model.of(~apart), [model.of(apart)]
    for axis in range(3):
        for sign in (1.0, -1.0):
            normal = sign * box_from_model[axis, :3]
            offset = half[axis] - sign * box_from_model[axis, 3]
            rest, beyond = _halves(rest, normal, offset)
            clear.append(beyond)
    return rest, _joined(clear)


def _halves(model: AssetModel, normal: FloatArray, offset: float) -> tuple[AssetModel, AssetModel]:
    """The model where ``normal . x <= offset``, and the rest; triangles on both sides are cut in two."""
    distance = model.corners @ normal - offset
    below, above = (distance <= 0).all(1), (distance > 0).all(1)
    mixed = model.of(~below & ~above)
    distance = distance[~below & ~above]
    pieces = [_part_below(mixed, distance, distance <= 0), _part_below(mixed, -distance, distance > 0)]
    return _joined([model.of(below), pieces[0]]), _joined([model.of(above), pieces[1]])


def _part_below(model: AssetModel, distance: FloatArray, is_below: BoolArray) -> AssetModel:
    """Cut triangles to the side of the corners that ``is_below`` (F, 3) marks: one triangle for one corner, two for two."""
    values = np.concatenate([model.corners, model.normals, model.uv], -1).astype(np.float64)
    single = is_below.sum(1) == 1
    lone = np.where(single, is_below.argmax(1), (~is_below).argmax(1))  # the corner that stands alone on its side
    order = (lone[:, None] + np.arange(3)) % 3
    rows = np.arange(len(values))[:, None]
    values, distance = values[rows, order], distance[rows, order]
    a, b, c = values[:, 0], values[:, 1], values[:, 2]
    to_b = (distance[:, 0] / (distance[:, 0] - distance[:, 1]))[:, None]
    to_c = (distance[:, 0] / (distance[:, 0] - distance[:, 2]))[:, None]
    ab, ac = a + to_b * (b - a), a + to_c * (c - a)
    double = ~single
    cut = np.concatenate(
        [np.stack([a, ab, ac], 1)[single], np.stack([ab, b, c], 1)[double], np.stack([ab, c, ac], 1)[double]]
    ).astype(np.float32)
    source = np.concatenate([np.flatnonzero(single), np.flatnonzero(double), np.flatnonzero(double)])
    return replace(
        model,
        corners=cut[..., :3],
        normals=cut[..., 3:6],
        uv=cut[..., 6:],
        surface=model.surface[source],
        part=model.part[source],
    )


def _joined(models: list[AssetModel]) -> AssetModel:
    names = ("corners", "normals", "uv", "surface", "part")
    return replace(models[0], **{name: np.concatenate([getattr(m, name) for m in models]) for name in names})


_PAGE_TEXELS = 4096
_MAX_CHART_TEXELS = 2048
"""Texels across a page, and at most across a chart."""
_POINTS_PER_CHUNK = 400_000
_SPECKLE_COLOURS = 40
_HIDDEN_TEXELS = 4
"""Texels across a chart that no camera faces: light bounces off it all the same."""
_PROBE_SPACING_M, _MAX_PROBES = 3.0, 6
"""Charts are looked at in places this far apart, so many at most along an axis."""
_UNSEEN_DISTANCE_FACTOR = 3.0
"""Factor on the distance of surfaces outside every view, by which they are drawn less finely: they are seen in mirrors,
and between the places."""


@dataclass(frozen=True, eq=False)
class Eyes:
    """Where an asset is looked at from: places and unit axes (E, 3) of views, its frame, each ``half_angle``
    (E,) wide."""

    places: FloatArray
    axes: FloatArray
    half_angle: FloatArray


@dataclass(frozen=True, eq=False)
class Detail:
    """How fine paint is drawn: ``texel_rad`` of the nearest view that has it before it, but never finer than
    from ``near_m``.

    eyes: None, where an asset moves about, takes ``near_m`` for all of it.
    """

    texel_rad: float
    near_m: float
    eyes: Eyes | None = None


@dataclass(frozen=True, eq=False)
class AssetModel:
    """An asset to draw, in its own frame: corners, normals (F, 3, 3), uv (F, 3, 2) from a page's lower left,
    part (F,) numbers.

    surface (F,): which of ``surfaces`` a face has: page, finish, and whether some of it is glass.
    pages (H, W, 4): sRGB, and how much is glass.
    """

    corners: NDArray[np.float32]
    normals: NDArray[np.float32]
    uv: NDArray[np.float32]
    surface: NDArray[np.int32]
    part: NDArray[np.int32]
    surfaces: tuple[tuple[int, Finish, bool], ...]
    pages: tuple[NDArray[np.uint8], ...]

    def of(self, faces: BoolArray) -> AssetModel:
        """Some of its faces."""
        names = ("corners", "normals", "uv", "surface", "part")
        return replace(self, **{name: getattr(self, name)[faces] for name in names})


@dataclass
class _Chart:
    """A rectangle of a page: its size in texels, where its texels lie on a part, and which faces it shows."""

    part: int
    faces: NDArray[np.int64]
    across: FloatArray  # (F, 3, 2): the corners' places in it, 0..1
    width: int
    height: int
    origin: FloatArray
    right: FloatArray
    up: FloatArray
    normal: FloatArray
    cast: bool
    speckles: FloatArray | None = None
    page: int = 0
    x: int = 0
    y: int = 0


def painted(asset: Asset, detail: Detail) -> AssetModel:
    """The asset with its paint in images; its parts are `TracedTriangles`. A gap of a texel is between charts."""
    charts: list[_Chart] = []
    for number, part in enumerate(asset.parts):
        assert isinstance(part.shape, TracedTriangles), part.shape
        charts += (
            _speckled(number, part, part.shape) if part.shape.speckled else _charts(number, part, part.shape, detail)
        )
    pages = _pack(charts)
    for chart in charts:
        image = _speckle_texels(chart) if chart.speckles is not None else _paint(asset.parts[chart.part], chart)
        pages[chart.page][chart.y : chart.y + chart.height, chart.x : chart.x + chart.width] = image
    return _model(asset, charts, pages)


def _charts(number: int, part: AssetPart, shape: TracedTriangles, detail: Detail) -> Iterator[_Chart]:
    flat = shape.flat
    normals = shape.face_normals.astype(np.float64)
    offset = (normals * shape.corners[:, 0]).sum(1)
    planes = np.round(np.column_stack([normals * 100, offset * 1000]) + 0.0)
    axis = np.abs(normals).argmax(1)
    sign = np.sign(normals[np.arange(len(axis)), axis])
    planes[~flat] = np.column_stack([axis, sign, np.full(len(axis), np.inf), np.full(len(axis), np.inf)])[~flat]
    _, which = np.unique(planes, axis=0, return_inverse=True)
    for key in range(which.max() + 1):
        faces = np.flatnonzero(which.reshape(-1) == key)
        cast = not flat[faces[0]]
        if cast:
            normal = np.zeros(3)
            normal[axis[faces[0]]] = sign[faces[0]]
        else:
            normal = normals[faces[0]]
        yield _chart(number, part, shape, faces, normal, cast, detail)


def _chart(
    number: int,
    part: AssetPart,
    shape: TracedTriangles,
    faces: NDArray[np.int64],
    normal: FloatArray,
    cast: bool,
    detail: Detail,
) -> _Chart:
    right = np.cross([0.0, 0.0, 1.0], normal) if abs(normal[2]) < 0.9 else np.cross([0.0, 1.0, 0.0], normal)
    right /= np.linalg.norm(right)
    up = np.cross(normal, right)
    corners = shape.corners[faces].astype(np.float64)
    along, above = corners @ right, corners @ up
    low = np.array([along.min(), above.min()])
    extent = np.maximum(np.array([along.max(), above.max()]) - low, 1e-4)
    depth = (corners @ normal).max()
    texel = _texel_m(part, corners, normal, cast, detail)
    size = [
        int(np.clip(np.ceil(e / texel), 2, _MAX_CHART_TEXELS)) if np.isfinite(texel) else _HIDDEN_TEXELS for e in extent
    ]
    across = (np.stack([along, above], -1) - low) / extent
    origin = low[0] * right + low[1] * up + depth * normal
    return _Chart(number, faces, across, size[0], size[1], origin, right * extent[0], up * extent[1], normal, cast)


def _texel_m(part: AssetPart, corners: FloatArray, normal: FloatArray, cast: bool, detail: Detail) -> float:
    """How large a chart's texels are; inf where nothing looks at it."""
    if detail.eyes is None:
        return detail.texel_rad * detail.near_m
    eyes = detail.eyes
    points = corners.reshape(-1, 3)
    if part.asset_from_part is not None:
        points = transform_points(part.asset_from_part, points)
        normal = rotate_vectors(part.asset_from_part, normal[None])[0]
    facing = np.ones(len(eyes.places), bool) if cast else (eyes.places - points[0]) @ normal > 0
    if not facing.any():
        return np.inf
    low, high = points.min(0), points.max(0)
    steps = [
        np.linspace(a, b, int(np.clip((b - a) / _PROBE_SPACING_M, 0, _MAX_PROBES)) + 2)
        for a, b in zip(low, high, strict=True)
    ]
    probes = np.stack(np.meshgrid(*steps, indexing="ij"), -1).reshape(-1, 3)
    to = probes - eyes.places[facing][:, None]
    distance = np.linalg.norm(to, axis=-1)
    ahead = (to * eyes.axes[facing][:, None]).sum(-1) / np.maximum(distance, 1e-9)
    in_view = ahead > np.cos(eyes.half_angle[facing])[:, None]
    nearest = np.where(in_view, distance, _UNSEEN_DISTANCE_FACTOR * distance).min()
    return detail.texel_rad * max(float(nearest), detail.near_m)


def _speckled(number: int, part: AssetPart, shape: TracedTriangles) -> Iterator[_Chart]:
    """One chart of a few colours, each face taking the one nearest to its own."""
    middle = shape.corners.astype(np.float64).mean(1)
    colour = _surface_texels(part, middle, shape.face_normals.astype(np.float64), np.full(len(middle), 0.02))[:, :3]
    order = np.argsort(colour.astype(int).sum(1), kind="stable")
    bins = np.array_split(order, min(_SPECKLE_COLOURS, len(order)))
    across = np.zeros((len(middle), 3, 2))
    for i, some in enumerate(bins):
        across[some] = [(i + 0.5) / len(bins), 0.5]
    speckles = np.stack([np.append(colour[some].mean(0), 0.0) for some in bins if len(some)])
    nothing = np.zeros(3)
    faces = np.arange(len(middle))
    yield _Chart(number, faces, across, 3 * len(bins), 3, nothing, nothing, nothing, nothing, False, speckles)


def _speckle_texels(chart: _Chart) -> NDArray[np.uint8]:
    assert chart.speckles is not None
    return np.broadcast_to(np.repeat(np.rint(chart.speckles), 3, 0).astype(np.uint8), (3, chart.width, 4))


def _paint(part: AssetPart, chart: _Chart) -> NDArray[np.uint8]:
    """The texels (H, W, 4) of a chart, its row 0 at the foot."""
    shape = part.shape
    assert isinstance(shape, TracedTriangles)
    texel = np.hypot(np.linalg.norm(chart.right) / chart.width, np.linalg.norm(chart.up) / chart.height) / np.sqrt(2)
    wanted = np.zeros((chart.height, chart.width), bool)
    size = np.array([chart.width, chart.height])
    low = np.maximum(np.floor(chart.across.min(1) * size - 1), 0).astype(int)
    high = np.ceil(chart.across.max(1) * size + 1).astype(int)
    for (x0, y0), (x1, y1) in zip(low, high, strict=True):
        wanted[y0:y1, x0:x1] = True
    rows, columns = np.nonzero(wanted)
    out = np.zeros((chart.height, chart.width, 4), np.uint8)
    for start in range(0, len(rows), _POINTS_PER_CHUNK):
        r, c = rows[start : start + _POINTS_PER_CHUNK], columns[start : start + _POINTS_PER_CHUNK]
        # a chart's outermost texels lie on its edge, so that a face is never painted from beyond it
        u = (c / max(chart.width - 1, 1))[:, None]
        v = (r / max(chart.height - 1, 1))[:, None]
        points = chart.origin + u * chart.right + v * chart.up
        normals = np.broadcast_to(chart.normal, points.shape)
        if chart.cast:
            away = points + chart.normal
            down = np.broadcast_to(-chart.normal, points.shape)
            t = shape.intersect(away, down, np.zeros(len(points)))
            hit = np.isfinite(t)
            points = away + np.where(hit, t, 1.0)[:, None] * down
            normals = np.where(hit[:, None], shape.faced(points, down)[0], normals)
        out[r, c] = _surface_texels(part, points, normals, np.full(len(points), texel))
    return out


def _surface_texels(
    part: AssetPart, points: FloatArray, normals: FloatArray, footprint: FloatArray
) -> NDArray[np.uint8]:
    """sRGB and glass (N, 4) of a part's points (N, 3)."""
    in_asset = points if part.asset_from_part is None else transform_points(part.asset_from_part, points)
    seen = part.material(SurfacePoints(points, in_asset, normals, footprint, np.ones(len(points))))
    colour = bytes_from_srgb(srgb_from_linear(np.asarray(seen.albedo, np.float32)))
    glass = np.rint(np.clip(seen.glass, 0, 1) * 255).astype(np.uint8)
    return np.column_stack([colour, glass])


def _pack(charts: list[_Chart]) -> list[NDArray[np.uint8]]:
    """Give every chart its place, in rows of falling height, and make the pages."""
    heights: list[int] = []
    page, x, y, row = 0, 1, 1, 0
    for chart in sorted(charts, key=lambda c: (-c.height, -c.width)):
        if x + chart.width + 1 > _PAGE_TEXELS:
            x, y, row = 1, y + row + 1, 0
        if y + chart.height + 1 > _PAGE_TEXELS:
            heights.append(y)
            page, x, y, row = page + 1, 1, 1, 0
        chart.page, chart.x, chart.y = page, x, y
        x, row = x + chart.width + 1, max(row, chart.height)
    heights.append(y + row + 1)
    return [np.zeros((height, _PAGE_TEXELS, 4), np.uint8) for height in heights]


def _model(asset: Asset, charts: list[_Chart], pages: list[NDArray[np.uint8]]) -> AssetModel:
    surfaces: dict[tuple[int, Finish, bool], int] = {}
    columns = []
    for chart in charts:
        part = asset.parts[chart.part]
        shape = part.shape
        assert isinstance(shape, TracedTriangles)
        corners, normals = (x[chart.faces].astype(np.float64) for x in (shape.corners, shape.soft))
        if part.asset_from_part is not None:
            corners = transform_points(part.asset_from_part, corners.reshape(-1, 3)).reshape(corners.shape)
            normals = rotate_vectors(part.asset_from_part, normals.reshape(-1, 3)).reshape(normals.shape)
        place = chart.across * (np.array([chart.width, chart.height]) - 1) + 0.5 + [chart.x, chart.y]
        uv = place / [_PAGE_TEXELS, pages[chart.page].shape[0]]
        texels = pages[chart.page][chart.y : chart.y + chart.height, chart.x : chart.x + chart.width]
        surface = surfaces.setdefault((chart.page, part.material.finish, bool(texels[..., 3].any())), len(surfaces))
        columns.append((corners, normals, uv, np.full(len(uv), surface), np.full(len(uv), chart.part)))
    corners, normals, uv, number, parts = (np.concatenate(column) for column in zip(*columns, strict=True))
    c, n, t = (x.astype(np.float32) for x in (corners, normals, uv))
    return AssetModel(c, n, t, number.astype(np.int32), parts.astype(np.int32), tuple(surfaces), tuple(pages))
