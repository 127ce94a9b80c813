"""Lamps that change during a drive: a traffic light, and brake lamps and an indicator of a car."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from unisim_blender.core.world.lamps import ActorLamp

from ..paint.materials import Bulb, Plain
from ..tracing.shapes import Cone, box
from ..tracing.trace import Asset, AssetPart
from .cars import Style

TRAFFIC_LIGHT_SIZE_M = np.array([0.3, 0.38, 1.05])
RED, AMBER, GREEN = (1.0, 0.05, 0.03), (1.0, 0.42, 0.03), (0.04, 0.8, 0.3)
BLINK_S = 0.66
"""Period of an indicator."""


def traffic_light(name: str, green_from_s: float) -> Asset:
    """A traffic light in its box's frame, its lamps on the front: red, and green from a time on; amber stays unlit."""
    length, width, height = TRAFFIC_LIGHT_SIZE_M / 2
    bulbs = (
        Bulb("red", "#4a1210", RED, (0.0, green_from_s), (True, False)),
        Bulb("amber", "#4a3410", AMBER),
        Bulb("green", "#103a22", GREEN, (0.0, green_from_s), (False, True)),
    )
    pose = np.eye(4)
    pose[:3, :3] = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]  # a lamp's z is the box's x
    parts = [AssetPart(box((-length, -width, -height), (length - 0.012, width, height), 0.02), Plain("#1d2321", 0.03))]
    for bulb, up in zip(bulbs, (0.32, 0.0, -0.32), strict=True):
        pose = pose.copy()
        pose[:3, 3] = length - 0.012, 0.0, up
        parts.append(AssetPart(Cone(0.11, 0.105, 0.012), bulb, pose))
    return Asset(name, tuple(parts))


def with_rear_lamps(asset: Asset, style: Style, braking_s: tuple[float, float], end_s: float) -> Asset:
    """Return a car with brake lamps that are lit between two times, and an indicator that blinks until ``end_s``."""
    brake = Bulb("red", "#7a1416", RED, (0.0, *braking_s), (False, True, False))
    blinks = np.arange(-1.0, end_s + 1.0, BLINK_S / 2)
    amber = Bulb("amber left", "#8a5a20", AMBER, tuple(blinks.tolist()), tuple(i % 2 == 0 for i in range(len(blinks))))
    aside, rear, up = 0.70 * style.half_width, -style.length / 2, style.tail - style.height / 2
    parts = []
    for bulb, y, z, half_y, half_z in (
        (brake, aside, up - 0.14, 0.14, 0.06),
        (brake, -aside, up - 0.14, 0.14, 0.06),
        (amber, aside, up - 0.28, 0.12, 0.045),
    ):
        corners = (rear, y - half_y, z - half_z), (rear + 0.12, y + half_y, z + half_z)
        parts.append(AssetPart(box(*corners, 0.01), bulb))
    return Asset(asset.name, (*asset.parts, *parts), asset.limbs, asset.cycle_m)


def with_lamps(asset: Asset, lamps: Sequence[ActorLamp]) -> Asset:
    """Return an asset whose lamps are lit as an actor has them."""
    if not lamps:
        return asset
    return replace(asset, parts=tuple(_switched(part, lamps) for part in asset.parts))


def _switched(part: AssetPart, lamps: Sequence[ActorLamp]) -> AssetPart:
    bulb = part.material
    if isinstance(bulb, Bulb):
        for lamp in lamps:
            lit_in = bulb.name if bulb.name in lamp.states else "on" if bulb.name == lamp.name else None
            if lit_in is not None:
                lit = tuple(lamp.states[number] == lit_in for number in lamp.shown)
                bulb = replace(bulb, times_s=tuple(lamp.times_s.tolist()), lit=lit)
    return part if bulb is part.material else AssetPart(part.shape, bulb, part.asset_from_part)
