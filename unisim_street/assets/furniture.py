"""Objects in a street that are not annotated: lamp posts, trees, bins, hydrants, signs, benches; and
cones, which are.

Each function gives parts in the street's frame, standing at ``at`` (3,), a point of the ground.
"""

from __future__ import annotations

import numpy as np

from unisim_blender.core.geometry import FloatArray, make_pose, quaternion_from_yaw

from ..paint.materials import Banded, Foliage, Material, Plain, Sign, Slats
from ..tracing.shapes import Cone, Ellipsoid, Spheres, TracedShape, box, hull
from ..tracing.trace import Asset, AssetPart

CONE_SIZE_M = np.array([0.36, 0.36, 0.72])
"""Edges (3,) of a traffic cone's box."""

_CLUMPS_PER_CROWN = 150
"""Clumps of leaves in a tree's crown."""


def stand(
    shape: TracedShape, material: Material, at: FloatArray, offset: tuple[float, float, float], yaw: float = 0.0
) -> AssetPart:
    """A part at ``offset`` in a frame that stands at ``at``, turned by ``yaw``."""
    pose = make_pose(np.asarray(at, np.float64), quaternion_from_yaw(yaw))
    pose[:3, 3] += pose[:3, :3] @ np.asarray(offset)
    return AssetPart(shape, material, pose)


def strut(material: Material, start: FloatArray, end: FloatArray, r0: float, r1: float) -> AssetPart:
    """A round bar from start to end."""
    axis = np.asarray(end, np.float64) - start
    length = float(np.linalg.norm(axis))
    z = axis / length
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([x, np.cross(z, x), z], 1)
    pose[:3, 3] = start
    return AssetPart(Cone(r0, r1, length), material, pose)


def lamp_tip(at: FloatArray, toward_y: float) -> FloatArray:
    """Return where the lamp (3,) of the post at a place hangs."""
    return np.asarray(at + np.array([0.0, 1.7 * toward_y, 6.75]))


def lamp_post(at: FloatArray, toward_y: float) -> list[AssetPart]:
    """A lamp post whose arm reaches over the road, to the side of ``toward_y`` (+1 or -1)."""
    iron, head = Plain("#3c4240", 0.04, 0.02), Plain("#c9ccc8")
    top = at + [0.0, 0.0, 6.4]
    tip = lamp_tip(at, toward_y)
    lamp = stand(box((-0.14, -0.35, -0.07), (0.14, 0.35, 0.05), 0.03), head, tip, (0.0, 0.0, 0.0))
    return [
        stand(Cone(0.13, 0.11, 0.9), iron, at, (0, 0, 0)),
        strut(iron, at + [0.0, 0.0, 0.9], top, 0.075, 0.05),
        strut(iron, top, tip, 0.045, 0.035),
        lamp,
    ]


WIRE_RADIUS_M = 0.012


def mast(at: FloatArray) -> list[AssetPart]:
    """A wooden mast of 7.5 m."""
    return [strut(Plain("#5c4a39", 0.2), at, at + [0.0, 0.0, 7.5], 0.1, 0.075)]


def wire(start: FloatArray, end: FloatArray, sag_m: float = 0.5, pieces: int = 8) -> list[AssetPart]:
    """A dark wire that hangs between two points."""
    part = np.linspace(0.0, 1.0, pieces + 1)[:, None]
    points = start + part * (np.asarray(end) - start) - [0.0, 0.0, 4 * sag_m] * part * (1 - part)
    dark = Plain("#1d1e20", 0.02)
    return [strut(dark, a, b, WIRE_RADIUS_M, WIRE_RADIUS_M) for a, b in zip(points, points[1:], strict=False)]


def bars(
    at: FloatArray, along: float, height: float, apart: float, radius: float, rails: tuple[float, ...], color: str
) -> list[AssetPart]:
    """Upright bars, ``apart`` along x from ``at`` on, with rails at heights: a railing, a fence."""
    paint, count = Plain(color, 0.05), int(along / apart) + 1
    up, far = np.array([0.0, 0.0, height]), np.array([(count - 1) * apart, 0.0, 0.0])
    feet = [at + [apart * number, 0.0, 0.0] for number in range(count)]
    return [strut(paint, foot, foot + up, radius, radius) for foot in feet] + [
        strut(paint, at + [0.0, 0.0, z], at + far + [0.0, 0.0, z], radius, radius) for z in rails
    ]


def tree(at: FloatArray, rng: np.random.Generator) -> list[AssetPart]:
    """A street tree in its square of soil."""
    height = rng.uniform(2.3, 2.9)
    bark = Plain("#4d4136", 0.25)
    green = Foliage(str(rng.choice(["#4e6336", "#465c34", "#5d6a38", "#4c6140"])))
    crown = at + [0.0, 0.0, height + 1.5]
    reach = np.array([1.55, 1.55, 1.7]) * rng.uniform(0.85, 1.15)
    direction = rng.standard_normal((_CLUMPS_PER_CROWN, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    centers = direction * (rng.uniform(0.2, 1.0, (_CLUMPS_PER_CROWN, 1)) ** 0.5) * reach
    radii = rng.uniform(0.13, 0.36, _CLUMPS_PER_CROWN)
    parts = [
        stand(box((-0.6, -0.6, 0.0), (0.6, 0.6, 0.015)), Plain("#4a3b2c", 0.3), at, (0, 0, 0)),
        strut(bark, at, at + [0.0, 0.0, height], 0.15, 0.10),
        stand(Spheres(centers, radii), green, crown, (0, 0, 0)),
    ]
    for turn in rng.uniform(0, 2 * np.pi, 3):
        end = at + np.array([0.8 * np.cos(turn), 0.8 * np.sin(turn), height + 1.1])
        parts.append(strut(bark, at + [0.0, 0.0, height - 0.25], end, 0.07, 0.04))
    return parts


def litter_bin(at: FloatArray) -> list[AssetPart]:
    """A round litter bin with a lid."""
    return [
        stand(Cone(0.24, 0.28, 0.85), Banded("#2f4a3c", "#8f9a92", ((0.66, 0.74),), retro=0.5), at, (0, 0, 0)),
        stand(Cone(0.31, 0.16, 0.16), Plain("#25352d"), at, (0, 0, 0.85)),
    ]


def hydrant(at: FloatArray) -> list[AssetPart]:
    """A red fire hydrant."""
    red, grey = Plain("#b5251b", 0.08, 0.03), Plain("#c8c5bd")
    return [
        stand(Cone(0.17, 0.17, 0.06), red, at, (0, 0, 0)),
        stand(Cone(0.115, 0.105, 0.52), red, at, (0, 0, 0.06)),
        stand(Ellipsoid((0.13, 0.13, 0.12)), grey, at, (0, 0, 0.58)),
        strut(grey, at + [-0.19, 0.0, 0.42], at + [0.19, 0.0, 0.42], 0.05, 0.05),
        strut(grey, at + [0.0, -0.17, 0.42], at + [0.0, 0.17, 0.42], 0.065, 0.065),
    ]


def bollard(at: FloatArray) -> list[AssetPart]:
    """A dark post with a pale ring."""
    paint = Banded("#2b2d30", "#d8d6cd", ((0.72, 0.80),))
    return [
        stand(Cone(0.075, 0.06, 0.9), paint, at, (0, 0, 0)),
        stand(Ellipsoid((0.07, 0.07, 0.05)), paint, at, (0, 0, 0.9)),
    ]


def bench(at: FloatArray, yaw: float) -> list[AssetPart]:
    """A wooden bench that looks along its -y."""
    wood, iron = Slats("#8a5f38", 0.13), Plain("#2c2e30")
    return [
        stand(box((-0.9, -0.25, 0.42), (0.9, 0.2, 0.48)), wood, at, (0, 0, 0), yaw),
        stand(box((-0.9, 0.17, 0.55), (0.9, 0.22, 0.95)), wood, at, (0, 0, 0), yaw),
        stand(box((-0.72, -0.22, 0.0), (-0.64, 0.22, 0.56)), iron, at, (0, 0, 0), yaw),
        stand(box((0.64, -0.22, 0.0), (0.72, 0.22, 0.56)), iron, at, (0, 0, 0), yaw),
    ]


def sign(at: FloatArray, facing: float, kind: int) -> list[AssetPart]:
    """A traffic sign on a pole; it faces along ``facing`` (yaw)."""
    faces = (
        Sign("#f2f0ea", "#b3161b", None, 0.32),
        Sign("#b3161b", "#b3161b", "#f2f0ea", 0.32),
        Sign("#20509c", "#f2f0ea", None, 0.3),
    )
    face = faces[kind % len(faces)]
    pose = np.eye(4)  # the plate's z looks along ``facing``, its y up
    pose[:3, :3] = np.stack([[-np.sin(facing), np.cos(facing), 0], [0, 0, 1], [np.cos(facing), np.sin(facing), 0]], 1)
    pose[:3, 3] = at + pose[:3, 2] * 0.035 + [0.0, 0.0, 2.4]
    pole = strut(Plain("#84898b"), at, at + [0.0, 0.0, 2.75], 0.032, 0.032)
    return [pole, AssetPart(Cone(face.radius, face.radius, 0.03), face, pose)]


def planter(at: FloatArray) -> list[AssetPart]:
    """A stone trough with a bush."""
    rng = np.random.default_rng(round(abs(float(at[0])) * 100))
    spread = rng.uniform(-1, 1, (16, 3)) * [0.5, 0.22, 0.12]
    return [
        stand(box((-0.65, -0.32, 0.0), (0.65, 0.32, 0.5), 0.03), Plain("#a39c8f", 0.1), at, (0, 0, 0)),
        stand(Spheres(spread + [0, 0, 0.62], rng.uniform(0.16, 0.26, 16)), Foliage("#54683a"), at, (0, 0, 0)),
    ]


def skip_container(at: FloatArray, color: str) -> list[AssetPart]:
    """A builder's skip with rubble."""
    metal = Plain(color, 0.15, 0.02)
    foot = [(x * 1.25, y * 0.78, 0.0) for x in (-1, 1) for y in (-1, 1)]
    rim = [(x * 1.75, y * 0.88, 1.15) for x in (-1, 1) for y in (-1, 1)]
    heap = [(x * 1.5, y * 0.7, 1.1) for x in (-1, 1) for y in (-1, 1)] + [(0.4, 0.1, 1.5), (-0.6, -0.2, 1.42)]
    parts = [
        stand(hull(np.array(foot + rim), 0.02), metal, at, (0, 0, 0)),
        stand(hull(np.array(heap)), Plain("#8b7d6b", 0.3), at, (0, 0, 0)),
    ]
    parts.append(stand(box((-1.8, -0.92, 1.08), (1.8, 0.92, 1.17)), metal, at, (0, 0, 0)))
    return parts


def cone_asset(name: str) -> Asset:
    """A traffic cone in its box's frame."""
    foot = np.array([0.0, 0.0, -CONE_SIZE_M[2] / 2])
    orange = Banded("#d9480f", "#efece4", ((0.30, 0.44), (0.54, 0.62)), 0.02)
    base = stand(box((-0.18, -0.18, 0.0), (0.18, 0.18, 0.045), 0.01), Plain("#2a2523"), foot, (0, 0, 0))
    return Asset(name, (base, stand(Cone(0.145, 0.028, 0.72), orange, foot, (0, 0, 0))))
