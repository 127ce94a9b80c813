"""Distances along any rays through the procedural street: what tests that write it in other layouts measure."""

from __future__ import annotations

import pickle

import numpy as np
from written_once import computed_once

from unisim_blender.core.geometry import FloatArray
from unisim_street.street import Street
from unisim_street.tracing.bundles import make_bundles, tile_image, untile_image
from unisim_street.tracing.trace import trace
from unisim_street.world import make_world


def street_distances(street: Street, origins: FloatArray, directions: FloatArray, time_s: FloatArray) -> FloatArray:
    """Distances (H, W) along rays (H, W, 3), (H, W, 3), (H, W) of the drive's world; inf where nothing is met."""

    def traced() -> FloatArray:
        world = make_world(street, street.drive)
        move = world.street_from_world
        moved, turned = origins @ move[:3, :3].T + move[:3, 3], directions @ move[:3, :3].T
        bundles = make_bundles(tile_image(moved), tile_image(turned), tile_image(time_s))
        return np.asarray(untile_image(trace(world.placements, bundles).t, *time_s.shape), np.float64)

    what = pickle.dumps((street.recipe, street.drive))
    return computed_once(
        traced, what, *(np.ascontiguousarray(part).tobytes() for part in (origins, directions, time_s))
    )
