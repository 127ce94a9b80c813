"""Walking people and a cyclist in their box's frame: x forward, y left, z up, centre at the origin.

A cycle of a gait is two steps, or a turn of the crank; its phase follows the path's length, so feet on the ground do not
slide, whatever the speed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from unisim_blender.core.geometry import FloatArray

from ..paint.materials import Material, Plain
from ..tracing.shapes import Cone, Ellipsoid, box
from ..tracing.trace import Asset, AssetPart, Limb
from .furniture import stand, strut

Joint = Callable[[FloatArray], FloatArray]
"""Function from phases (N,), in cycles, to places (N, 3), metres, z from the ground."""

PERSON_SIZE_M = np.array([1.0, 0.66, 1.78])
CYCLIST_SIZE_M = np.array([1.84, 0.66, 1.88])
WALK_CYCLE_M, CRANK_TURN_M = 1.32, 4.6
"""Metres that a walker covers by two steps, and a cyclist in a turn of the crank."""
_SHIRTS = ("#a8322a", "#2f5d8a", "#d9d4c6", "#3f6b45", "#c98f2b", "#5a4a78")
_TROUSERS = ("#23283a", "#4a4038", "#6f7276", "#2b2b2d")
_SKIN = ("#c69076", "#8d5a3f", "#e0b394")
_HIP_M, _SEGMENT_M = 0.86, 0.435
"""Height of a walker's hips, and length of a thigh and of a shin."""
_SHOE_M = 0.08


def person(name: str, rng: np.random.Generator) -> Asset:
    """A walker of about 1.75 m."""
    shirt, trousers, skin = (Plain(str(rng.choice(colors))) for colors in (_SHIRTS, _TROUSERS, _SKIN))
    start = float(rng.uniform())
    parts, limbs = _trunk(shirt, trousers, skin, np.array([0.0, 0.0, _HIP_M]), 0.03), []
    for side in (1.0, -1.0):
        shift = start + (0.0 if side > 0 else 0.5)

        def hip(phase: FloatArray, y: float = 0.1 * side) -> FloatArray:
            return np.broadcast_to([0.0, y, _HIP_M], (len(phase), 3))

        def ankle(phase: FloatArray, y: float = 0.1 * side, shift: float = shift) -> FloatArray:
            return _stepping_foot(phase + shift) + [0.0, y, 0.0]

        limbs += _leg(f"{name}-{_side(side)}", hip, ankle, _SEGMENT_M, trousers)
        shoulder = np.array([0.0, 0.235 * side, 1.40])

        def hand(phase: FloatArray, shoulder: FloatArray = shoulder, shift: float = shift) -> FloatArray:
            swing = 0.5 * np.cos(2 * np.pi * (phase + shift + 0.5))
            return shoulder + 0.6 * np.stack([np.sin(swing), np.zeros_like(swing), -np.cos(swing)], -1)

        def elbow(phase: FloatArray, shoulder: FloatArray = shoulder, hand: Joint = hand) -> FloatArray:
            return (shoulder + hand(phase)) / 2 - [0.05, 0.0, 0.0]

        limbs += [
            _bone(f"{name}-arm-{_side(side)}", _fixed(shoulder), elbow, 0.055, 0.045, shirt),
            _bone(f"{name}-forearm-{_side(side)}", elbow, hand, 0.043, 0.036, skin),
        ]
    return _asset(name, parts, limbs, PERSON_SIZE_M, WALK_CYCLE_M)


def cyclist(name: str, rng: np.random.Generator) -> Asset:
    """A bicycle with its rider, in one box."""
    shirt, trousers, skin = (Plain(str(rng.choice(colors))) for colors in (_SHIRTS, _TROUSERS, _SKIN))
    steel, rubber = Plain("#2f6f73", 0.02, 0.03), Plain("#1b1b1d")
    saddle, head, crank = np.array([-0.22, 0.0, 0.94]), np.array([0.42, 0.0, 0.92]), np.array([-0.05, 0.0, 0.32])
    rear, front = np.array([-0.52, 0.0, 0.34]), np.array([0.55, 0.0, 0.34])
    tubes = ((saddle, crank), (crank, rear), (saddle, rear), (saddle, head), (crank, head), (head, front))
    parts = [strut(steel, a, b, 0.02, 0.02) for a, b in tubes]
    for hub in (rear, front):  # spokes let light through: rims of short bars
        turn = np.linspace(0, 2 * np.pi, 17)
        rim = hub + 0.33 * np.stack([np.cos(turn), np.zeros(17), np.sin(turn)], -1)
        parts += [strut(rubber, a, b, 0.02, 0.02) for a, b in zip(rim[:-1], rim[1:], strict=True)]
    grip = head + [0.02, 0.0, 0.13]
    parts += [
        strut(steel, head, grip, 0.016, 0.016),
        strut(steel, grip - [0, 0.26, 0], grip + [0, 0.26, 0], 0.015, 0.015),
    ]
    parts.append(stand(box((-0.13, -0.07, -0.03), (0.13, 0.07, 0.03), 0.02), rubber, saddle, (0, 0, 0.03)))
    hips = saddle + [0.0, 0.0, 0.12]
    parts += _trunk(shirt, trousers, skin, hips, 0.55)
    shoulders = hips + 0.52 * np.array([np.sin(0.55), 0.0, np.cos(0.55)])
    for side in (1.0, -1.0):
        joint, hold = shoulders + [0.0, 0.2 * side, 0.0], grip + [0.0, 0.24 * side, 0.0]
        parts.append(strut(shirt, joint, (joint + hold) / 2 - [0.03, 0, 0.05], 0.052, 0.043))
        parts.append(strut(skin, (joint + hold) / 2 - [0.03, 0, 0.05], hold, 0.042, 0.034))
    limbs: list[Limb] = []
    for side in (1.0, -1.0):
        shift = 0.0 if side > 0 else 0.5
        seat = hips + [0.02, 0.09 * side, -0.02]

        def pedal(phase: FloatArray, side: float = side, shift: float = shift) -> FloatArray:
            turn = -2 * np.pi * (phase + shift)
            return crank + np.stack([0.17 * np.cos(turn), np.full_like(turn, 0.1 * side), 0.17 * np.sin(turn)], -1)

        def ankle(phase: FloatArray, pedal: Joint = pedal) -> FloatArray:
            return pedal(phase) + [-0.06, 0.0, 0.09]

        limbs += _leg(f"{name}-{_side(side)}", _fixed(seat), ankle, 0.44, trousers)
        inner = crank + [0.0, 0.1 * side, 0.0]
        limbs.append(_bone(f"{name}-crank-{_side(side)}", _fixed(inner), pedal, 0.014, 0.014, steel))
    return _asset(name, parts, limbs, CYCLIST_SIZE_M, CRANK_TURN_M)


def _side(side: float) -> str:
    return "left" if side > 0 else "right"


def _asset(name: str, parts: Sequence[AssetPart], limbs: Sequence[Limb], size_m: FloatArray, cycle_m: float) -> Asset:
    """The asset with the ground at its box's lower face."""
    lift = np.array([0.0, 0.0, -size_m[2] / 2])

    def lowered(part: AssetPart) -> AssetPart:
        pose = np.eye(4) if part.asset_from_part is None else part.asset_from_part.copy()
        pose[:3, 3] += lift
        return AssetPart(part.shape, part.material, pose)

    def lowered_joint(joint: Joint) -> Joint:
        return lambda phase: joint(phase) + lift

    moved = tuple(Limb(limb.asset, lowered_joint(limb.root), lowered_joint(limb.tip)) for limb in limbs)
    return Asset(name, tuple(lowered(part) for part in parts), moved, cycle_m)


def _trunk(shirt: Material, trousers: Material, skin: Material, hips: FloatArray, lean_rad: float) -> list[AssetPart]:
    """Hips, chest, neck and head above the hips, leaning forward."""
    up = np.array([np.sin(lean_rad), 0.0, np.cos(lean_rad)])
    neck = hips + 0.58 * up
    head = neck + 0.16 * np.array([np.sin(lean_rad / 2), 0.0, np.cos(lean_rad / 2)])
    parts = [stand(Ellipsoid((0.13, 0.17, 0.15)), trousers, hips + 0.03 * up, (0, 0, 0))]
    chest = [
        strut(shirt, hips + [0, y, 0] + 0.04 * up, hips + [0, 1.25 * y, 0] + 0.52 * up, 0.105, 0.12)
        for y in (-0.07, 0.07)
    ]
    parts += [*chest, stand(Ellipsoid((0.12, 0.225, 0.11)), shirt, hips + 0.5 * up, (0, 0, 0))]
    parts += [
        strut(skin, neck - 0.02 * up, head, 0.055, 0.055),
        stand(Ellipsoid((0.105, 0.085, 0.13)), skin, head, (0, 0, 0)),
    ]
    return [*parts, stand(Ellipsoid((0.105, 0.09, 0.09)), Plain("#33261d", 0.2), head, (-0.015, 0, 0.06))]


def _stepping_foot(phase: FloatArray) -> FloatArray:
    """The ankle (N, 3): it stands on the ground for one half of a cycle, which moves it backwards by half of the cycle's metres,
    and swings ahead in the other."""
    u = phase % 1.0
    reach = WALK_CYCLE_M / 4
    swing = np.clip(2 * u - 1, 0, 1)
    x = np.where(u < 0.5, reach * (1 - 4 * u), -reach * np.cos(np.pi * swing))
    lift = np.where(u < 0.5, 0.0, 0.16 * np.sin(np.pi * swing) ** 2)
    return np.stack([x, np.zeros_like(x), _SHOE_M + lift], -1)


def _fixed(place: FloatArray) -> Joint:
    return lambda phase: np.broadcast_to(place, (len(phase), 3))


def _leg(name: str, hip: Joint, ankle: Joint, segment_m: float, trousers: Material) -> list[Limb]:
    """A thigh and a shin of equal length, bent at the knee, and a shoe."""

    def knee(phase: FloatArray) -> FloatArray:
        top, foot = hip(phase), ankle(phase)
        along = foot - top
        length = np.linalg.norm(along[:, ::2], axis=1)
        bend = np.sqrt(np.maximum(segment_m**2 - (length / 2) ** 2, 0.0))
        ahead = np.stack([-along[:, 2], np.zeros_like(length), along[:, 0]], -1) / length[:, None]
        return np.asarray((top + foot) / 2 + bend[:, None] * ahead)

    def toe(phase: FloatArray) -> FloatArray:
        return ankle(phase) + [0.15, 0.0, -0.035]

    def heel(phase: FloatArray) -> FloatArray:
        return ankle(phase) + [-0.06, 0.0, -0.035]

    return [
        _bone(f"{name}-thigh", hip, knee, 0.085, 0.062, trousers, segment_m),
        _bone(f"{name}-shin", knee, ankle, 0.058, 0.043, trousers, segment_m),
        _bone(f"{name}-shoe", heel, toe, 0.042, 0.036, Plain("#26211e")),
    ]


def _bone(
    name: str, root: Joint, tip: Joint, r0: float, r1: float, material: Material, length_m: float | None = None
) -> Limb:
    """A round bar between two joints, as long as they are apart at phase 0."""
    start = np.zeros(1)
    length = float(np.linalg.norm(tip(start) - root(start))) if length_m is None else length_m
    return Limb(Asset(name, (AssetPart(Cone(r0, r1, length), material),)), root, tip)
