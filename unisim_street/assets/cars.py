"""Cars, vans and trucks out of convex hulls and cylinders, in their box's frame: x forward, y left, z up,
centre at the origin.

Measures in `Style` are metres from the box's middle (x) and from the ground (z).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unisim_blender.core.geometry import FloatArray

from ..paint.materials import (
    Finish,
    Material,
    Plain,
    SurfaceMaterial,
    SurfacePoints,
    cover,
    linear,
    mix,
    noises,
    rectangle,
    stripes,
    surface,
)
from ..tracing.shapes import Cone, box, hull
from ..tracing.trace import Asset, AssetPart

_EDGE_M = 0.035


@dataclass(frozen=True)
class Cabin:
    """Upper part of a vehicle, on its body: glass between belt and roof. x of the windscreen's foot and head, the
    rear's head and foot."""

    front_foot: float
    front_head: float
    rear_head: float
    rear_foot: float
    foot_half: float
    roof_half: float
    pillars: tuple[float, ...]
    glass_from: float = -9.0
    """Side windows only ahead of this x, as in a panel van."""
    rear_glass: bool = True


@dataclass(frozen=True)
class Style:
    """A kind of vehicle: PandaSet's label, body measures, cabin, wheels, and a load box (x_low, x_high, z_low, z_high)
    if any."""

    label: str
    length: float
    half_width: float
    height: float
    belt: float
    nose: float
    """Height of the bonnet's front edge."""
    tail: float
    """Height of the body's rear edge."""
    cabin: Cabin
    wheel_radius: float
    axles: tuple[float, float]
    doors: tuple[float, ...]
    load: tuple[float, float, float, float] | None = None
    bed: bool = False

    @property
    def size_m(self) -> FloatArray:
        """The box's edges (3,), mirrors included."""
        return np.array([self.length, 2 * self.half_width + 0.24, self.height])


STYLES: dict[str, Style] = {
    "sedan": Style(
        "Car", 4.62, 0.88, 1.45, 0.94, 0.72, 0.92,
        Cabin(1.05, 0.22, -0.95, -1.72, 0.76, 0.56, (-0.35,)), 0.325, (1.38, -1.36), (0.95, -0.35, -1.18),
    ),
    "hatchback": Style(
        "Car", 4.05, 0.86, 1.50, 0.96, 0.74, 0.98,
        Cabin(1.05, 0.28, -1.42, -1.86, 0.76, 0.59, (-0.25, -1.15)), 0.31, (1.27, -1.26), (0.9, -0.25, -1.05),
    ),
    "suv": Style(
        "Car", 4.70, 0.93, 1.72, 1.10, 0.92, 1.10,
        Cabin(1.05, 0.38, -1.78, -2.16, 0.82, 0.66, (-0.3, -1.32)), 0.37, (1.42, -1.40), (0.98, -0.3, -1.25),
    ),
    "estate": Style(
        "Car", 4.78, 0.89, 1.48, 0.95, 0.72, 0.96,
        Cabin(1.12, 0.30, -1.75, -2.22, 0.77, 0.58, (-0.28, -1.3)), 0.325, (1.42, -1.38), (1.0, -0.28, -1.2),
    ),
    "van": Style(
        "Car", 5.30, 0.95, 2.15, 1.12, 0.98, 1.12,
        Cabin(2.02, 1.22, -2.55, -2.60, 0.90, 0.80, (0.35,), 0.3, False), 0.34, (1.68, -1.55), (1.5, 0.35, -0.85),
    ),
    "pickup": Style(
        "Pickup Truck", 5.35, 0.94, 1.80, 1.08, 0.95, 1.06,
        Cabin(1.22, 0.55, -0.62, -0.85, 0.82, 0.68, (-0.05,)), 0.39, (1.72, -1.62), (1.15, -0.05, -0.8), bed=True,
    ),
    "truck": Style(
        "Medium-sized Truck", 6.80, 1.02, 3.05, 1.30, 1.12, 0.95,
        Cabin(3.05, 2.62, 1.50, 1.42, 0.98, 0.90, (1.75,), 1.6, False), 0.42, (2.25, -1.95), (2.75, 1.62),
        load=(-3.38, 1.30, 0.95, 3.02),
    ),
}  # fmt: skip

PAINTS = (
    "#b9bcc0", "#e6e6e2", "#1b1d21", "#5b6067", "#8c1d1f", "#1f3f77", "#3f6f8f", "#28513a", "#c7a13a", "#6e5a48",
    "#a9412a",
)  # fmt: skip


@dataclass(frozen=True)
class BodyPaint(Material):
    """The body's sheet metal with lamps, grille, plates, seams, wheel arches and sills."""

    style: Style
    color: str

    @property
    def finish(self) -> Finish:
        return Finish(0.35, metallic=0.25, coat=1.0)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        s = self.style
        x, y, _ = p.asset.T
        z = p.asset[:, 2] + s.height / 2
        foot, half = p.footprint, s.length / 2
        albedo = np.tile(linear(self.color), (len(x), 1))
        gloss = np.full(len(x), 0.035)
        glass = np.zeros(len(x))
        dirt = np.clip(0.25 - 0.35 * (z - 0.25), 0, 0.3) * (1 + 0.3 * noises()["blotch"](x * 3, z * 3, p.spread * 3))
        albedo = mix(albedo, linear("#7a7266"), np.clip(dirt, 0, 1))
        flank = np.abs(p.normal[:, 1]) > 0.45
        seam = np.zeros(len(x))
        for door in s.doors:
            line = np.where(z > 0.36, np.abs(x - door) - 0.008, 1.0)
            seam = np.maximum(seam, cover(line, foot) * np.minimum(1.0, 0.03 / np.maximum(foot, 1e-6)))
        albedo = mix(albedo, linear("#101012"), 0.7 * seam * flank)
        handle = np.full(len(x), 1.0)
        for door in s.doors[1:]:
            handle = np.minimum(handle, rectangle(x - door - 0.16, z - s.belt + 0.12, 0.09, 0.018))
        albedo = mix(albedo, linear("#2b2c2e"), cover(handle, foot) * flank)
        front, rear = x > half - 0.36, x < -half + 0.30
        dark = np.minimum(
            rectangle(y, z - 0.45 * s.nose - 0.13, 0.50, 0.10), rectangle(y, z - s.nose + 0.12, 0.36, 0.055)
        )
        albedo = mix(albedo, linear("#15161a"), cover(dark, foot) * (x > half - 0.2))
        lamp = rectangle(np.abs(y) - 0.64 * s.half_width / 0.88, z - s.nose + 0.10, 0.16, 0.065)
        bright = cover(lamp, foot) * front
        albedo = mix(albedo, linear("#dfe3e6"), bright)
        brake = rectangle(np.abs(y) - 0.70 * s.half_width / 0.88, z - s.tail + 0.16, 0.15, 0.085)
        red = cover(brake, foot) * rear
        albedo = mix(albedo, linear("#9c0f12"), red)
        plate = np.where(x > 0, rectangle(y, z - 0.40, 0.25, 0.055), rectangle(y, z - 0.62 * s.tail, 0.25, 0.06))
        number = cover(plate, foot) * (np.abs(x) > half - 0.25)
        albedo = mix(albedo, linear("#e8e6da"), number)
        sill = cover(np.maximum(z - 0.31, 0.0) - 1e-3, foot)
        arch = np.min([np.hypot(x - axle, z - s.wheel_radius) for axle in s.axles], 0) - 1.17 * s.wheel_radius
        black = np.maximum(sill, cover(arch, foot) * (np.abs(y) > 0.7 * s.half_width))
        albedo = mix(albedo, linear("#0c0c0d"), black)
        gloss = gloss * (1 - black)
        base = surface(albedo).reflectivity
        return surface(albedo, gloss, glass, np.maximum(base, 0.9 * np.maximum(number, 0.7 * np.maximum(red, bright))))


@dataclass(frozen=True)
class CabinPaint(Material):
    """The cabin: roof and pillars in the body's colour, panes between them."""

    style: Style
    color: str

    @property
    def finish(self) -> Finish:
        return Finish(0.35, metallic=0.25, coat=1.0)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        s, c = self.style, self.style.cabin
        x, y, _ = p.asset.T
        z = p.asset[:, 2] + s.height / 2
        rise = (z - s.belt) / (s.height - s.belt)
        tall = s.height - s.belt
        ahead = c.front_foot + rise * (c.front_head - c.front_foot) - x
        behind = x - c.rear_foot - rise * (c.rear_head - c.rear_foot)
        inward = c.foot_half + rise * (c.roof_half - c.foot_half) - np.abs(y)
        nx, ny, nz = p.normal.T
        upper, lower = (0.90 - rise) * tall, (rise - 0.05) * tall
        side = np.minimum(np.minimum(ahead - 0.13, behind - 0.15), np.minimum(upper - 0.02, lower - 0.02))
        side = np.minimum(side, x - c.glass_from)
        for pillar in c.pillars:
            side = np.minimum(side, np.abs(x - pillar) - 0.045)
        screen = np.minimum(np.minimum(inward - 0.08, upper), lower - 0.02)
        pane = np.where(np.abs(ny) > 0.6, side, np.where((nx > 0.25) | ((nx < -0.25) & c.rear_glass), screen, -1.0))
        pane = np.where(nz > 0.93, -1.0, pane)
        glass = cover(-pane, p.footprint)
        seal = cover(-pane - 0.03, p.footprint)
        tint = linear("#1a2025") * (0.7 + 0.9 * np.clip(rise, 0, 1))[:, None]
        seats = (
            cover(np.abs(np.abs(y) - 0.34) - 0.16, p.footprint)
            * cover(rise - 0.55, p.footprint / tall)
            * (np.abs(nx) > 0.25)
        )
        tint = tint * (1 - 0.55 * seats)[:, None]
        albedo = mix(np.tile(linear(self.color), (len(x), 1)), linear("#0b0b0c"), seal)
        albedo = mix(albedo, tint, glass)
        return surface(albedo, 0.035 + 0.055 * glass, 0.9 * glass)


@dataclass(frozen=True)
class WheelPaint(Material):
    """Tyre, rim with spokes, hub; the part's z is the axle, outwards."""

    radius: float

    @property
    def finish(self) -> Finish:
        return Finish(0.6)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        x, y, _ = p.part.T
        r = np.hypot(x, y) / self.radius
        foot = p.footprint / self.radius
        rim = cover(r - 0.68, foot)
        spoke = np.cos(5 * np.arctan2(y, x)) * 0.5 + 0.5
        gap = cover(0.22 - r, foot) * cover(r - 0.58, foot) * np.clip((0.55 - spoke) * 4 + 0.5, 0, 1)
        albedo = mix(np.tile(linear("#17171a"), (len(x), 1)), linear("#a4a7aa"), rim)
        albedo = mix(albedo, linear("#1c1c1f"), 0.85 * gap * np.clip(1.3 - foot / 0.4, 0.3, 1))
        return surface(albedo, 0.03 * rim)


@dataclass(frozen=True)
class LoadPaint(Material):
    """A truck's box: pale panels with ribs and a coloured stripe."""

    color: str
    stripe: str
    middle: float

    @property
    def finish(self) -> Finish:
        return Finish(0.4)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        x, y, z = p.asset.T
        along = np.where(np.abs(p.normal[:, 1]) > 0.5, x, y)
        rib = stripes(along, 0.6, 0.03, p.spread)
        albedo = np.tile(linear(self.color), (len(x), 1)) * (1 - 0.18 * rib)[:, None]
        albedo = mix(albedo, linear(self.stripe), cover(np.abs(z - self.middle + 0.12 * along) - 0.22, p.footprint))
        return surface(albedo, 0.02)


def car(name: str, style: Style, color: str) -> Asset:
    """An asset of that style and paint."""
    s, c = style, style.cabin
    lift = np.array([0.0, 0.0, -s.height / 2])
    w, half = s.half_width, s.length / 2
    front_z, low = s.nose, 0.20 if s.height < 1.9 else 0.28
    body = [
        (-half + 0.22, 0.76 * w, low + 0.05), (half - 0.25, 0.74 * w, low),
        (-half + 0.42, 0.97 * w, low + 0.12), (half - 0.52, 0.97 * w, low + 0.12),
        (-half + 0.36, 1.00 * w, 0.64), (half - 0.55, 1.00 * w, 0.62),
        (-half + 0.32, 0.91 * w, s.belt), (min(c.front_foot, half - 0.5), 0.91 * w, s.belt + 0.01),
        (half - 0.34, 0.80 * w, front_z), (half - 0.09, 0.62 * w, front_z - 0.10),
        (half, 0.50 * w, 0.38), (half, 0.50 * w, 0.58), (half - 0.10, 0.82 * w, 0.36), (half - 0.09, 0.82 * w, 0.60),
        (-half, 0.62 * w, 0.45), (-half, 0.62 * w, s.tail - 0.14), (-half + 0.10, 0.84 * w, 0.38),
        (-half + 0.09, 0.84 * w, s.tail - 0.06), (-half + 0.14, 0.74 * w, s.tail),
    ]  # fmt: skip
    both = np.array([(x, side * y, z) for x, y, z in body for side in (-1, 1)])
    middle = (c.front_head + c.rear_head) / 2
    cabin = [
        (c.front_foot, 0.94 * c.foot_half, s.belt - 0.02), (c.front_foot - 0.30, c.foot_half, s.belt - 0.02),
        (c.rear_foot + 0.12, c.foot_half, s.belt - 0.02), (c.rear_foot, 0.92 * c.foot_half, s.belt - 0.02),
        (c.front_head, 0.95 * c.roof_half, s.height - 0.05), (c.rear_head, 0.95 * c.roof_half, s.height - 0.05),
        (c.front_head - 0.12, c.roof_half, s.height - 0.06), (c.rear_head + 0.10, c.roof_half, s.height - 0.06),
        (middle + 0.3, 0.72 * c.roof_half, s.height), (middle - 0.3, 0.72 * c.roof_half, s.height),
    ]  # fmt: skip
    cabin_points = np.array([(x, side * y, z) for x, y, z in cabin for side in (-1, 1)])
    paint = BodyPaint(s, color)
    parts = [
        AssetPart(hull(both + lift, _EDGE_M), paint),
        AssetPart(hull(cabin_points + lift, _EDGE_M), CabinPaint(s, color)),
    ]
    parts += [_wheel(s, axle, side) for axle in s.axles for side in (-1.0, 1.0)]
    for side in (-1.0, 1.0):
        y = side * (w + 0.03)
        corner = np.array([c.front_foot - 0.42, y, s.belt + 0.08]) + lift
        parts.append(
            AssetPart(
                box((corner - [0.07, 0.085, 0.065]).tolist(), (corner + [0.07, 0.085, 0.065]).tolist(), 0.03), paint
            )
        )
    if s.load is not None:
        x0, x1, z0, z1 = s.load
        load = box((x0, -w, z0 - s.height / 2), (x1, w, z1 - s.height / 2), 0.02)
        parts.append(AssetPart(load, LoadPaint("#d8d8d2", color, (z0 + z1) / 2 - s.height / 2)))
    if s.bed:
        parts += _bed(s, paint)
    return Asset(name, tuple(parts))


def _wheel(s: Style, axle: float, side: float) -> AssetPart:
    pose = np.eye(4)
    # the part's z points outwards along the axle
    pose[:3, :3] = np.stack([[1.0, 0, 0], [0, 0, -side], [0, side, 0]], 1)
    width = 0.22
    pose[:3, 3] = axle, side * (s.half_width + 0.006 - width), s.wheel_radius - s.height / 2
    return AssetPart(Cone(s.wheel_radius, s.wheel_radius, width), WheelPaint(s.wheel_radius), pose)


def _bed(s: Style, paint: Material) -> list[AssetPart]:
    """Walls round a pickup's bed, on the body behind the cabin."""
    back, front, w = -s.length / 2 + 0.1, s.cabin.rear_foot - 0.05, 0.90 * s.half_width
    low, high = s.belt - 0.03 - s.height / 2, s.belt + 0.22 - s.height / 2
    walls = [box((back, side * w - 0.05, low), (front, side * w + 0.05, high), 0.02) for side in (-1.0, 1.0)] + [
        box((back, -w, low), (back + 0.08, w, high), 0.02)
    ]
    inner = box((back, -w, low), (front, w, low + 0.05))
    return [AssetPart(wall, paint) for wall in walls] + [AssetPart(inner, Plain("#1d1e20"))]
