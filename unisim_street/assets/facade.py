"""A house front with openings set back into the wall, as one shape with a closed-form intersection, and its paint: bricks or
plaster, window frames, panes, curtains, doors, shop windows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.geometry import FloatArray

from ..paint.materials import (
    Finish,
    Material,
    SurfaceMaterial,
    SurfacePoints,
    cover,
    hashed,
    linear,
    mix,
    noises,
    rectangle,
    stripes,
    surface,
)
from ..tracing.shapes import Solid, first_inside, slab

_CHEEK_TOLERANCE_M = 2e-6
"""Metres by which an opening's cheeks, found with rounding, may lie beside it: those of triangles are
single precision's."""


@dataclass(frozen=True)
class Storey:
    """One storey's row of equal openings: count at ``pitch``, from ``first`` (left edge), each ``width`` wide, ``low``
    to ``high`` in height, ``depth`` deep; all in metres in the front's frame."""

    floor: float
    low: float
    high: float
    first: float
    pitch: float
    width: float
    count: int
    depth: float


class Facade(Solid):
    """A house ``width`` x ``depth`` x ``height`` whose front is the plane y = 0, looking along -y, x
    from 0 to ``width``.

    Openings are blind: a ray that enters one ends on its back or on one of its four cheeks. Storeys are given from the
    bottom up and no opening crosses its storey's floor or the house's edges.
    """

    def __init__(self, width: float, depth: float, height: float, storeys: tuple[Storey, ...]) -> None:
        self.width, self.depth, self.height = width, depth, height
        self.low, self.high = np.zeros(3), np.array([width, depth, height])
        self.storeys = storeys
        self._floors = np.array([s.floor for s in storeys])
        columns = ("low", "high", "first", "pitch", "width", "count", "depth")
        self._table = np.array([[float(getattr(s, name)) for name in columns] for s in storeys])

    def cell(self, points: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Storey and column (N,), (N,) of points' openings; column -1 where there is none at that x and z."""
        x, _, z = points.T
        storey = np.clip(np.searchsorted(self._floors, z, side="right") - 1, 0, len(self._floors) - 1)
        low, high, first, pitch, width, count, _ = self._table[storey].T
        column = np.floor((x - first + _CHEEK_TOLERANCE_M) / pitch)
        across = x - first - column * pitch
        inside = (
            (column >= 0)
            & (column < count)
            & (across <= width + _CHEEK_TOLERANCE_M)
            & (z >= low - _CHEEK_TOLERANCE_M)
            & (z <= high + _CHEEK_TOLERANCE_M)
        )
        return storey, np.where(inside, column, -1).astype(np.int64)

    def rectangle(self, storey: NDArray[np.int64], column: NDArray[np.int64]) -> tuple[FloatArray, ...]:
        """x_low, x_high, z_low, z_high, depth (N,) of openings."""
        low, high, first, pitch, width, _, depth = self._table[storey].T
        left = first + column * pitch
        return left, left + width, low, high, depth

    def intersect(self, origins: FloatArray, directions: FloatArray, t_min: FloatArray) -> FloatArray:
        x, y, z = (slab(origins[:, i], directions[:, i], self.low[i], self.high[i]) for i in range(3))
        far = np.minimum(np.minimum(x[1], y[1]), z[1])
        t = first_inside(np.maximum(np.maximum(x[0], y[0]), z[0]), far, t_min)
        rows = np.flatnonzero(np.isfinite(t))
        start = origins[rows] + t[rows, None] * directions[rows]
        storey, column = self.cell(start)
        left, right, low, high, depth = self.rectangle(storey, column)
        # only what starts within an opening's hollow goes on: on the front plane, or deeper after a part was cut away
        hollow = (column >= 0) & (start[:, 1] < depth - _CHEEK_TOLERANCE_M)
        rows = rows[hollow]
        o, d = origins[rows], directions[rows]
        walls = np.stack(
            [np.where(d[:, 0] > 0, right[hollow], left[hollow]), np.where(d[:, 2] > 0, high[hollow], low[hollow])]
        )
        sides = np.stack([o[:, 0], o[:, 2]]), np.stack([d[:, 0], d[:, 2]])
        across = np.where(np.abs(sides[1]) > 1e-12, (walls - sides[0]) / _safe(sides[1]), np.inf).min(0)
        back = np.where(d[:, 1] > 0, (depth[hollow] - o[:, 1]) / _safe(d[:, 1]), np.inf)
        t_exit = np.minimum(across, back)
        leaves = (d[:, 1] < 0) & (-o[:, 1] / _safe(d[:, 1]) <= t_exit)
        t[rows] = np.where(leaves, np.inf, np.maximum(t_exit, t[rows]))
        return t

    def normals(self, points: FloatArray) -> FloatArray:
        storey, column = self.cell(points)
        left, right, low, high, depth = self.rectangle(storey, column)
        x, y, z = points.T
        hollow = (column >= 0) & (y <= depth + _CHEEK_TOLERANCE_M) & (y > _CHEEK_TOLERANCE_M)
        outer = np.stack([y, self.depth - y, x, self.width - x, z, self.height - z], -1)
        inner = np.stack(
            [np.abs(depth - y), np.abs(x - left), np.abs(right - x), np.abs(z - low), np.abs(high - z)], -1
        )
        ways_out = np.array([[0, -1, 0], [0, 1, 0], [-1, 0, 0], [1, 0, 0], [0, 0, -1], [0, 0, 1]], np.float64)
        ways_in = np.array([[0, -1, 0], [1, 0, 0], [-1, 0, 0], [0, 0, 1], [0, 0, -1]], np.float64)
        chosen = np.where(hollow[:, None], ways_in[inner.argmin(1)], ways_out[np.abs(outer).argmin(1)])
        return np.asarray(chosen)


def _safe(x: FloatArray) -> FloatArray:
    return np.where(np.abs(x) < 1e-12, np.copysign(1e-12, x), x)


@dataclass(frozen=True)
class FrontPaint(Material):
    """Paint of a `Facade`; ``kind`` is "brick", "plaster" or "stone"; ``number`` sets its houses'
    chance features apart."""

    front: Facade
    kind: str
    wall: str
    trim: str
    frame: str
    base: str
    door: str
    number: int

    @property
    def finish(self) -> Finish:
        return Finish(0.88)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        x, y, z = p.part.T
        storey, column = self.front.cell(p.part)
        left, right, low, high, depth = self.front.rectangle(storey, column)
        back = (column >= 0) & (np.abs(y - depth) < 1e-6)
        cheek = (column >= 0) & ~back & (y > 1e-6)
        wall = surface(self._wall(p))
        gloss, glass = np.zeros(len(x)), np.zeros(len(x))
        albedo = wall.albedo.copy()
        reflectivity = wall.reflectivity.copy()
        albedo[cheek] = linear(self.trim) * 0.9
        reflectivity[cheek] = 0.45
        rows = np.flatnonzero(back)
        if len(rows):
            u, v = x[rows] - (left[rows] + right[rows]) / 2, z[rows] - low[rows]
            colour, shine = self._opening(
                u, v, (right - left)[rows], (high - low)[rows], storey[rows], column[rows], p.footprint[rows]
            )
            albedo[rows], glass[rows], gloss[rows] = colour, shine, 0.09 * shine
            reflectivity[rows] = surface(colour).reflectivity
        return surface(albedo, gloss, glass, reflectivity)

    def _wall(self, p: SurfacePoints) -> FloatArray:
        """Albedo (N, 3) of the wall itself, with trim about openings and stains."""
        front = np.abs(p.normal[:, 1]) > 0.5
        along = np.where(front, p.part[:, 0], p.part[:, 1])
        z = p.part[:, 2]
        grain, blotch = noises()["grain"], noises()["blotch"]
        shift = 5.3 * self.number
        tone = 0.10 * blotch(along + shift, 1.3 * z, p.spread) + 0.05 * grain(along + shift, z, p.spread)
        colour = linear(self.wall) * (1 + tone)[:, None]
        if self.kind == "brick":
            colour = self._bricks(colour, along, z, p.spread)
        elif self.kind == "stone":
            joint = np.maximum(
                stripes(z, 0.42, 0.025, p.spread), stripes(along + 0.4 * np.floor(z / 0.42), 0.9, 0.02, p.spread)
            )
            block = hashed(
                np.floor(z / 0.42 + 0.5).astype(np.int64), np.floor(along / 0.9).astype(np.int64), self.number
            )
            fade = np.clip(1.5 - p.spread / 0.5, 0, 1)
            colour = colour * (1 + 0.16 * (block - 0.5) * fade - 0.3 * joint)[:, None]
        storeys = self.front.storeys
        base_top = storeys[1].floor if len(storeys) > 1 else 0.0
        colour = mix(colour, linear(self.base) * (1 + tone)[:, None], cover(z - base_top + 0.25, p.footprint))
        course = np.zeros(len(z))
        for storey in storeys[1:]:
            course = np.maximum(course, cover(np.abs(z - storey.floor) - 0.11, p.footprint))
        trim = np.maximum(self._surround(p), course * front)
        colour = mix(colour, linear(self.trim) * (1 + 0.5 * tone)[:, None], trim)
        damp = np.exp(-np.maximum(z, 0) / 0.35) * 0.35
        return np.asarray(colour * (1 - damp)[:, None])

    def _bricks(self, colour: FloatArray, along: FloatArray, z: FloatArray, spread: FloatArray) -> FloatArray:
        row = np.floor(z / 0.075)
        shifted = along + 0.11 * (row % 2)
        joint = np.maximum(stripes(z, 0.075, 0.012, spread), stripes(shifted, 0.22, 0.012, spread))
        brick = hashed(row.astype(np.int64), np.floor(shifted / 0.22 + 0.5).astype(np.int64), self.number)
        fade = np.clip(1.5 - spread / 0.12, 0, 1)
        toned = colour * (1 + 0.35 * (brick - 0.5) * fade)[:, None]
        return mix(toned, linear("#b9b0a4"), 0.7 * joint)

    def _surround(self, p: SurfacePoints) -> FloatArray:
        """Coverage (N,) of the raised trim about each opening of the front, its sill a little wider."""
        x, _, z = p.part.T
        storey, _ = self.front.cell(p.part)
        table = self.front.storeys
        first = np.array([s.first for s in table])[storey]
        pitch = np.array([s.pitch for s in table])[storey]
        width = np.array([s.width for s in table])[storey]
        count = np.array([s.count for s in table])[storey]
        column = np.clip(np.round((x - first - width / 2) / pitch), 0, np.maximum(count - 1, 0)).astype(np.int64)
        left, right, low, high, _ = self.front.rectangle(storey, column)
        u, v = x - (left + right) / 2, z - (low + high) / 2
        band = rectangle(u, v, (right - left) / 2 + 0.1, (high - low) / 2 + 0.1)
        sill = rectangle(u, z - low + 0.09, (right - left) / 2 + 0.2, 0.09)
        painted = np.maximum(cover(band, p.footprint), cover(sill, p.footprint))
        return np.asarray(painted * ((np.abs(p.normal[:, 1]) > 0.5) & (count > 0) & (storey > 0)))

    def _opening(
        self,
        u: FloatArray,
        v: FloatArray,
        width: FloatArray,
        height: FloatArray,
        storey: NDArray[np.int64],
        column: NDArray[np.int64],
        footprint: FloatArray,
    ) -> tuple[FloatArray, FloatArray]:
        """Albedo (N, 3) and glassiness (N,) at u from the middle and v above the foot of an opening's back."""
        chance = hashed(column, storey, self.number)
        is_shop = (storey == 0) & (width > 1.9)
        is_door = (storey == 0) & ~is_shop & (chance < 0.45)
        frame = cover(width / 2 - np.abs(u) - 0.06, footprint)
        frame = np.maximum(frame, cover(np.minimum(v, height - v) - 0.06, footprint))
        mullion = np.where(is_shop, np.abs(np.abs(u) - width / 6), np.abs(u)) - 0.03
        frame = np.maximum(frame, cover(mullion, footprint))
        frame = np.maximum(frame, cover(np.abs(v - 0.72 * height) - 0.025, footprint))
        rise = np.clip(v / height, 0, 1)
        pane = linear("#232a31") + np.array([0.035, 0.045, 0.06]) * rise[:, None]
        drawn = 0.12 + 0.3 * hashed(column, storey, self.number, 3)
        curtain = cover((0.5 - drawn) * width - np.abs(u), footprint) * (chance > 0.35) * ~is_shop
        blind = cover(0.62 * height - v + 0.3 * chance * height, footprint) * (chance > 0.8) * ~is_shop
        drape = 0.85 + 0.15 * np.sin(u * 38.0) * np.clip(1.2 - footprint / 0.08, 0, 1)
        pane = mix(pane, linear("#c9c3b6") * (0.55 * drape)[:, None], np.maximum(curtain, blind))
        goods = noises()["blotch"](u * 4 + 3.1 * column, v * 4 + self.number, footprint * 4)
        window_shelf = np.clip(0.5 - (v - 1.1) / 0.8, 0, 1) * is_shop
        warm = np.array([0.20, 0.14, 0.07]) * (window_shelf * np.clip(0.6 + 0.5 * goods, 0, 1.6))[:, None]
        colour = mix(pane + warm, linear(self.frame), frame)
        shine = (1 - frame) * (1 - 0.6 * np.maximum(curtain, blind))
        panel = stripes(v - 0.1, 0.7, 0.06, footprint) + cover(np.abs(u) - 0.02, footprint)
        leaf = linear(self.door) * np.clip(1 - 0.35 * panel, 0.3, 1)[:, None]
        lights_over = cover(2.15 - v, footprint)
        door = mix(leaf, pane, lights_over * (1 - frame))
        colour = np.where(is_door[:, None], door, colour)
        return colour, np.where(is_door, lights_over * (1 - frame), shine)
