"""Cars with curved bodies: the styles of `cars`, lofted. Frame and paint are those of the cars of convex hulls."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from unisim_blender.core.geometry import FloatArray

from ..tracing.trace import Asset, AssetPart
from ..tracing.triangles import TracedTriangles, grid, joined
from .cars import BodyPaint, CabinPaint, Style, WheelPaint
from .tessellate import revolved, tessellated

_STEP_M = 0.045
"""Spacing of a body's stations."""
_WHEEL_M = 0.22


def coachwork(hulls: Asset) -> Asset:
    """The car of hulls with a curved body, cabin and wheels; what it carries and its mirrors as they are."""
    body, cabin = hulls.parts[0].material, hulls.parts[1].material
    assert isinstance(body, BodyPaint) and isinstance(cabin, CabinPaint)
    parts = [AssetPart(_body(body.style), body), AssetPart(_cabin(cabin.style), cabin)]
    for part in hulls.parts[2:]:
        shape = _wheel(part.material.radius) if isinstance(part.material, WheelPaint) else tessellated(part.shape)
        parts.append(AssetPart(shape, part.material, part.asset_from_part))
    return Asset(hulls.name, tuple(parts))


@lru_cache
def _body(s: Style) -> TracedTriangles:
    """Lower body: sections across the length, rounded in plan and profile, the wheels' wells pressed in."""
    half, c = s.length / 2, s.cabin
    x = np.linspace(-half, half, round(s.length / _STEP_M))
    # stations crowd together where the ends turn round
    x = half * np.sign(x) * (1 - (1 - np.abs(x) / half) ** 1.15)
    low = 0.20 if s.height < 1.9 else 0.28
    front, rear = np.clip((x - half + 0.55) / 0.55, 0, 1), np.clip((-x - half + 0.45) / 0.45, 0, 1)
    ends = np.maximum(front, rear)
    bonnet = np.clip((x - c.front_foot + 0.25) / (half - 0.12 - c.front_foot + 0.25), 0, 1)
    boot = np.clip((-x + c.rear_foot + 0.3) / max(half + c.rear_foot + 0.3 - 0.1, 0.15), 0, 1)
    top = s.belt + (s.nose - s.belt) * bonnet**1.6 + (s.tail - s.belt) * boot**1.5
    top = top - 0.30 * (s.nose - 0.45) * front**4 - 0.16 * (s.tail - 0.45) * rear**4
    bottom = low + 0.14 * ends**2
    width = s.half_width * (1 - 0.24 * front**2.6 - 0.17 * rear**2.8)
    turn = np.linspace(0, 2 * np.pi, 72, endpoint=False) + 0.01
    power = 2 / 4.6
    across = np.sign(np.cos(turn)) * np.abs(np.cos(turn)) ** power
    up = np.sign(np.sin(turn)) * np.abs(np.sin(turn)) ** power
    z = (top + bottom)[:, None] / 2 + (top - bottom)[:, None] / 2 * up
    # flanks lean in above the widest line and tuck under below
    lean = (
        1
        - 0.09 * np.clip((z - 0.62) / (s.belt - 0.62 + 1e-6), 0, 1.2) ** 2
        - 0.06 * np.clip((0.5 - z) / 0.3, 0, 1) ** 2
    )
    y = width[:, None] * across * lean
    points = np.stack([np.broadcast_to(x[:, None], y.shape), y, z], -1)
    points = _with_wells(points, s)
    caps = np.stack([points[0].mean(0), points[-1].mean(0)])
    points = np.concatenate([np.repeat(caps[:1, None], len(turn), 1), points, np.repeat(caps[1:, None], len(turn), 1)])
    points[..., 2] -= s.height / 2
    return _outward(points)


def _with_wells(points: FloatArray, s: Style) -> FloatArray:
    """Points of the flanks within a wheel's arch pressed in behind the wheel; those next to its edge moved onto it."""
    out = points.copy()
    for axle in s.axles:
        off = out[..., [0, 2]] - [axle, s.wheel_radius]
        away = np.maximum(np.linalg.norm(off, axis=-1), 1e-9)
        reach = 1.14 * s.wheel_radius
        flank = np.abs(out[..., 1]) > 0.55 * s.half_width
        edge = flank & (away >= reach) & (away < reach + 0.6 * _STEP_M)
        moved = [axle, s.wheel_radius] + off * (reach / away)[..., None]
        out[..., 0] = np.where(edge, moved[..., 0], out[..., 0])
        out[..., 2] = np.where(edge, moved[..., 1], out[..., 2])
        inside = flank & (away < reach)
        out[..., 1] = np.where(inside, np.sign(out[..., 1]) * (s.half_width - _WHEEL_M - 0.06), out[..., 1])
    return out


@lru_cache
def _cabin(s: Style) -> TracedTriangles:
    """Rings from belt to roof, then a roof that is a little domed."""
    c = s.cabin
    turn = np.linspace(0, 2 * np.pi, 88, endpoint=False) + 0.01
    tall = s.height - s.belt
    rise = np.concatenate([np.linspace(-0.06, 0.90, 13), [0.945, 0.975, 0.990, 1.0, 1.0, 1.0]])
    shrink = np.concatenate([np.ones(13), [0.985, 0.95, 0.88, 0.72, 0.4, 0.0]])
    power = 2 / 5.5
    along = np.sign(np.cos(turn)) * np.abs(np.cos(turn)) ** power
    across = np.sign(np.sin(turn)) * np.abs(np.sin(turn)) ** power
    r = np.clip(rise, 0, 0.945)[:, None]
    front = c.front_foot + r * (c.front_head - c.front_foot)
    rear = c.rear_foot + r * (c.rear_head - c.rear_foot)
    half_y = c.foot_half + r * (c.roof_half - c.foot_half)
    middle, half_x = (front + rear) / 2, (front - rear) / 2
    bulge = 1 - 0.05 * np.abs(across) ** 3  # screens are curved in plan
    x = middle + half_x * shrink[:, None] * along * bulge
    y = half_y * shrink[:, None] * across
    z = np.broadcast_to((s.belt + tall * rise - s.height / 2)[:, None], x.shape)
    return _outward(np.stack([x, y, z], -1))


def _outward(rings: FloatArray) -> TracedTriangles:
    """Rings (R, C, 3) as a smooth surface; each is counter-clockwise as seen from where the last one is."""
    return grid(rings.swapaxes(0, 1)[np.r_[0 : rings.shape[1], 0]])


@lru_cache
def _wheel(radius: float) -> TracedTriangles:
    """Tyre and rim: their profile turned about the axle, which is the part's z."""
    w, r = _WHEEL_M, radius
    tyre = [
        (0.72 * r, w - 0.012),
        (0.90 * r, w),
        (0.97 * r, w - 0.015),
        (r, w - 0.05),
        (r, 0.04),
        (0.95 * r, 0.0),
        (0.0, 0.0),
    ]
    rim = [
        (0.0, w - 0.02),
        (0.14 * r, w - 0.02),
        (0.24 * r, w - 0.045),
        (0.60 * r, w - 0.05),
        (0.69 * r, w - 0.008),
        (0.72 * r, w - 0.012),
    ]
    return joined([revolved(np.array(p)[::-1], 36) for p in (tyre, rim)])
