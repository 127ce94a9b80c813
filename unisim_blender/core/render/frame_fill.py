"""Rendered images and sweeps whose ground and façades are filled where nobody saw them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import BoolArray, FloatArray
from ..sensors.rays import Rays
from ..world.drive import Camera, Lidar
from .contact_shadow import shaded
from .pending_image import Binding, PendingImage
from .plane_fill import PlaneFill
from .tracer import Array, Maps, Tracer


def filled_image(
    pending: PendingImage,
    fill: PlaneFill,
    bound: Binding,
    image: NDArray[np.float32],
    points: FloatArray,
    ground: BoolArray,
    maps: Maps,
) -> tuple[NDArray[np.float32], Maps]:
    """Return the image, and its maps, with the ground and façades filled that nobody saw, which no recorded ray supports, with
    contact shadows of recorded actors: others' are added later. Pixels show ``points`` (H, W, 3), ``ground`` (H, W) where
    those are of no actor."""
    up, flat = pending.tracer.upsample, points.reshape(-1, 3)
    some = np.flatnonzero(ground)
    there, colours, share = fill.of(Camera, flat[some], pending.tracer.heights)
    some = some[there]
    below = np.ones(len(some), bool)
    recorded = [a for a in pending.state.actors if not a.inserted and a.visible_to(pending.camera)]
    colours = shaded(colours[None], flat[some][None], below[None], recorded, pending.time_s)[0]
    colours = bound.exposed(colours, pending.camera.sensor_id, pending.time_s)
    image = image.copy()
    shown = image.reshape(-1, 3)
    shown[some] += share * (colours - shown[some])
    if "unsupported" in maps:
        marked = np.zeros(ground.shape, bool)
        marked.reshape(-1)[some] = share[:, 0] > 0.5
        maps = {**maps, "unsupported": maps["unsupported"] | marked[up // 2 :: up, up // 2 :: up].reshape(-1)}
    return image, maps


def filled_intensity(
    fill: PlaneFill | None,
    tracer: Tracer[Any],
    rays: Rays,
    depth: Array,
    intensity: Array,
    instance: NDArray[np.int32],
) -> Array:
    """Return the intensities (N,) of flat beams (N,), those on ground that no sweep saw as it is filled."""
    if fill is None:
        return intensity
    points = rays.origins + rays.directions * depth[:, None]
    some = np.flatnonzero((instance.reshape(-1) == 0) & (depth > 0))
    there, filled, share = fill.of(Lidar, points[some], tracer.heights)
    intensity, some = intensity.copy(), some[there]
    intensity[some] += share[:, 0] * (filled[:, 0] - intensity[some])
    return intensity
