"""How a house front is painted: bricks or plaster, window frames, panes, curtains, doors, shop windows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.geometry import FloatArray

from ..paint.materials import Finish, Material, SurfaceMaterial, SurfacePoints, surface
from ..paint.textures import cover, hashed, linear, mix, noises, rectangle, stripes
from .facade import Facade


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
