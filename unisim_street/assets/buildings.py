"""Houses: a front with set-back openings, a roof, and what sticks out of it. Each differs by chance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unisim_blender.core.geometry import FloatArray, make_pose, quaternion_from_yaw

from ..paint.materials import (
    Finish,
    Material,
    Plain,
    Slats,
    SurfaceMaterial,
    SurfacePoints,
    cover,
    hashed,
    linear,
    mix,
    stripes,
    surface,
)
from ..tracing.shapes import TracedShape, box, hull
from ..tracing.trace import AssetPart
from .facade import Facade, FrontPaint, Storey

_WALLS = {
    "brick": ("#8a4b39", "#9a5b42", "#75463a", "#a86f52"),
    "plaster": ("#d6c29a", "#c9b7a0", "#cfd0c6", "#b98f6b", "#a9b3b0", "#dcc7b0", "#c58f74", "#9fae9a"),
    "stone": ("#b5aa97", "#a39b8d", "#c2b79f"),
}
_TRIMS = ("#e4dccb", "#d8d4c8", "#efe9dc", "#c9bfae")
_FRAMES = ("#efede6", "#e6e2d6", "#3b332c", "#2f3b36")
_BASES = ("#8f8677", "#6d6961", "#a59a87", "#57534d")
_DOORS = ("#5b2e23", "#24404a", "#2f4a33", "#6e1f22", "#3a2f2a")
_SIGNS = ("#234b39", "#7a1f24", "#1e365c", "#c9b26a", "#2b2b2d", "#a84f1e")
_ROOFS = ("#7d4436", "#5a5450", "#6a4a3d", "#4b4f55")


@dataclass(frozen=True)
class Tiles(Material):
    """Roof tiles in rows along the part's x."""

    color: str

    @property
    def finish(self) -> Finish:
        return Finish(0.75)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        x, y, z = p.part.T
        slope = np.hypot(y, z) * np.sign(z + 1e-9)
        row = stripes(slope, 0.33, 0.06, p.spread)
        tone = 0.25 * (hashed(np.floor(slope / 0.33 + 0.5).astype(np.int64), np.floor(x / 0.3).astype(np.int64)) - 0.5)
        fade = np.clip(1.5 - p.spread / 0.25, 0, 1)
        return surface(linear(self.color) * (1 + tone * fade - 0.4 * row)[:, None])


@dataclass(frozen=True)
class ShopSign(Material):
    """A sign board with a row of pale strokes that pass for letters."""

    color: str
    width: float
    number: int

    @property
    def finish(self) -> Finish:
        return Finish(0.4)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        x, _, z = p.part.T
        u = (x - self.width / 2) / 0.26
        letter = np.floor(u).astype(np.int64)
        chance = hashed(letter, self.number)
        inside = (np.abs(u) < np.floor(1.6 * self.width)) & (chance > 0.16)
        stroke = np.minimum(
            np.abs(u - letter - 0.28) - 0.1, np.abs(z - 0.16 - 0.3 * hashed(letter, self.number, 2)) - 0.05
        )
        stroke = np.maximum(stroke * 0.26, np.abs(z - 0.29) - 0.16)
        stroke = np.maximum(stroke, (np.abs(u - letter - 0.5) - 0.36) * 0.26)
        ink = cover(stroke, p.footprint) * inside * (np.abs(p.normal[:, 1]) > 0.5)
        return surface(mix(np.tile(linear(self.color), (len(x), 1)), linear("#e9e2cf"), ink))


@dataclass(frozen=True)
class Awning(Material):
    """Striped cloth."""

    color: str

    @property
    def finish(self) -> Finish:
        return Finish(0.9, translucent=0.25)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        band = stripes(p.part[:, 0], 0.6, 0.3, p.footprint)
        return surface(mix(np.tile(linear("#e8e1d2"), (len(band), 1)), linear(self.color), band))


@dataclass(frozen=True, eq=False)
class _Front:
    """Puts shapes at x, y, z of a house's front."""

    world_from_front: FloatArray

    def __call__(
        self, shape: TracedShape, material: Material, x: float = 0.0, y: float = 0.0, z: float = 0.0
    ) -> AssetPart:
        pose = self.world_from_front.copy()
        pose[:3, 3] += pose[:3, :3] @ [x, y, z]
        return AssetPart(shape, material, pose)


def house(
    rng: np.random.Generator, world_from_front: FloatArray, width: float, number: int, plain: bool = False
) -> list[AssetPart]:
    """A house whose front's lower left corner stands at ``world_from_front`` (4, 4); ``plain`` leaves off
    what sticks out."""
    kind = str(rng.choice(["brick", "plaster", "plaster", "stone"]))
    ground = float(rng.uniform(3.5, 4.1))
    upper = int(rng.integers(2, 5))
    rise = float(rng.uniform(2.9, 3.3))
    height = ground + upper * rise + 0.35
    shop = bool(rng.random() < 0.5) and not plain
    storeys = _storeys(rng, width, ground, upper, rise, shop)
    front = Facade(width, 11.0, height, storeys)
    trim = str(rng.choice(_TRIMS))
    paint = FrontPaint(
        front, kind, str(rng.choice(_WALLS[kind])), trim, str(rng.choice(_FRAMES)), str(rng.choice(_BASES)),
        str(rng.choice(_DOORS)), number,
    )  # fmt: skip

    put = _Front(world_from_front)
    parts = [put(front, paint)]
    reach = float(rng.uniform(0.22, 0.42))
    parts.append(
        put(box((0.0, 0.0, 0.0), (width, reach + 0.2, 0.34), 0.04), Plain(trim, 0.1), 0.0, -reach, height - 0.3)
    )
    parts.append(put(box((0.0, 0.0, 0.0), (width, 0.25, 0.16), 0.03), Plain(trim, 0.1), 0.0, -0.14, ground - 0.16))
    parts += _roof(rng, put, width, height, plain)
    if plain:
        return parts
    if shop:
        color = str(rng.choice(_SIGNS))
        sign_width = width - 0.8
        parts.append(
            put(
                box((0.0, 0.0, 0.0), (sign_width, 0.14, 0.55), 0.01),
                ShopSign(color, sign_width, number),
                0.4,
                -0.12,
                ground - 0.85,
            )
        )
        if rng.random() < 0.6:
            cloth = np.array(
                [
                    (x, y, z)
                    for x in (0.0, sign_width)
                    for y, z in ((0.0, 0.0), (0.0, 0.5), (-1.15, -0.02), (-1.15, 0.06))
                ]
            )
            parts.append(put(hull(cloth), Awning(str(rng.choice(_SIGNS))), 0.4, 0.0, ground - 1.35))
    if rng.random() < 0.55:
        parts += _balconies(rng, put, storeys)
    pipe = box((-0.05, -0.1, 0.0), (0.05, 0.0, height - 0.3), 0.02)
    parts.append(put(pipe, Plain("#6b6f70"), width - 0.12))
    return parts


def _storeys(
    rng: np.random.Generator, width: float, ground: float, upper: int, rise: float, shop: bool
) -> tuple[Storey, ...]:
    pane = float(rng.uniform(0.95, 1.35))
    pitch = float(rng.uniform(2.1, 2.8))
    count = max(2, int((width - 0.9) / pitch))
    first = (width - (count - 1) * pitch - pane) / 2
    depth = float(rng.uniform(0.14, 0.26))
    if shop:
        wide = float(rng.uniform(2.4, 3.1))
        shops = max(1, int((width - 0.8) / (wide + 0.5)))
        step = (width - 0.6) / shops
        below = Storey(0.0, 0.42, ground - 1.0, 0.3 + (step - wide) / 2, step, wide, shops, 0.3)
    else:
        below = Storey(0.0, 0.12, 2.75, first, pitch, pane, count, 0.3)
    tall = float(rng.uniform(1.55, 1.95))
    above = [
        Storey(
            ground + i * rise,
            ground + i * rise + 0.75,
            ground + i * rise + 0.75 + tall,
            first,
            pitch,
            pane,
            count,
            depth,
        )
        for i in range(upper)
    ]
    return (below, *above)


def _roof(rng: np.random.Generator, put: _Front, width: float, height: float, plain: bool) -> list[AssetPart]:
    parts: list[AssetPart] = []
    if rng.random() < 0.6:
        ridge = float(rng.uniform(2.2, 3.4))
        prism = np.array([(x, y, z) for x in (0.0, width) for y, z in ((0.0, 0.0), (11.0, 0.0), (5.5, ridge))])
        parts.append(put(hull(prism), Tiles(str(rng.choice(_ROOFS))), 0.0, 0.0, height))
        if not plain and width > 7:
            for x in np.arange(1.6, width - 2.4, 3.4):
                parts.append(
                    put(
                        box((0.0, 0.0, 0.0), (1.3, 2.2, 1.35), 0.02), Plain("#cfc8b8", 0.1), float(x), 1.0, height + 0.2
                    )
                )
    for _ in range(int(rng.integers(1, 3))):
        x = float(rng.uniform(0.5, width - 1.2))
        parts.append(put(box((0.0, 0.0, 0.0), (0.7, 0.9, 1.6)), Plain("#7d5242", 0.2), x, 4.0, height + 1.6))
    return parts


def _balconies(rng: np.random.Generator, put: _Front, storeys: tuple[Storey, ...]) -> list[AssetPart]:
    parts: list[AssetPart] = []
    rail = str(rng.choice(["#2d2f31", "#4a4f4d", "#e2ddd0"]))
    for storey in storeys[1:]:
        for column in range(1, storey.count, 2):
            x = storey.first + column * storey.pitch - 0.3
            width = storey.width + 0.6
            z = storey.low - 0.22
            parts.append(put(box((0.0, -0.95, 0.0), (width, 0.0, 0.14), 0.02), Plain("#b9b2a5", 0.1), x, 0.0, z))
            parts.append(put(box((0.0, -0.95, 0.0), (width, -0.91, 0.85)), Slats(rail, 0.14), x, 0.0, z + 0.14))
            for side in (0.0, width - 0.04):
                parts.append(
                    put(box((side, -0.91, 0.0), (side + 0.04, 0.0, 0.85)), Slats(rail, 0.14), x, 0.0, z + 0.14)
                )
    return parts


def front_pose(x: float, y: float, z: float, yaw: float) -> FloatArray:
    """Pose (4, 4) of a house's front: its lower left corner, as one looks at it, at (x, y, z); yaw 0 looks along -y."""
    return make_pose(np.array([x, y, z]), quaternion_from_yaw(yaw))
