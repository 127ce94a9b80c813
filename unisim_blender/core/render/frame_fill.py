"""Rendered images and sweeps whose ground and façades are filled where nobody saw them.

What stood in a box that an edit empties hid what is behind. A trained scene has something there that no recorded image or sweep
confirms: such a ray goes on to the first plane, if that is before what is seen above the box (`seen_through`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import BoolArray, FloatArray, intersect_boxes, invert_pose
from ..sensors.frames import RenderStats
from ..sensors.rays import Rays
from ..world.drive import Actor, Box, Camera, Lidar
from ..world.replay import WorldState
from .confidence import RecordedDepth
from .contact_shadow import shaded
from .pending_image import Binding, PendingImage, per_pixel
from .plane_fill import THROUGH_PART, PlaneFill, SensorKind
from .tracer import Array, Maps, Tracer

ABOVE_M, NEAREST_M, BEHIND_M = 0.3, 0.5, 0.5
"""How far above emptied boxes a ray looks at what is behind them, the least distance of a box that it clears, and how far behind
what it shows a plane may be, metres."""


class SeenThrough(NamedTuple):
    """Rays (M,), by their numbers, that end on a plane in place of what nothing recorded confirms, and its values (M, C)."""

    rays: NDArray[np.int64]
    values: Array


def seen_through(
    fill: PlaneFill,
    kind: SensorKind,
    standing: Tracer[Any],
    recorded: RecordedDepth | None,
    state: WorldState,
    own: Sequence[Actor | None],
    rays: Rays,
    maps: Maps,
) -> tuple[SeenThrough, Maps]:
    """Return which flat rays (N,) through emptied boxes go on to a plane, and the maps with their distances. ``standing`` traces
    the state without actors: what moves changes no ray that passes beside it. ``own`` as of `RecordedDepth.evidence`."""
    boxes, some = state.removed_boxes, np.flatnonzero(maps["instance"] == 0)
    if recorded is None or not boxes or not len(some):
        return SeenThrough(some[:0], np.zeros((0, 3), np.float32)), maps
    emptied = _entries(rays.part(some), boxes)
    copies = _entries(
        rays.part(some), [Box(copy.world_from_target, copy.source.size_m) for copy in state.static_copies]
    )
    crossing = (emptied < maps["depth"][some]) & ~np.isfinite(copies)
    some, start = some[crossing], emptied[crossing]
    unseen = recorded.unseen(rays.part(some), maps["depth"][some], maps["instance"][some], own, by_sweeps=True)
    over = _above(rays.part(some), boxes)
    some, start, over = (x[unseen & np.isfinite(over)] for x in (some, start, over))
    if not len(some):
        return SeenThrough(some, np.zeros((0, 3), np.float32)), maps
    few, before = rays.part(some), maps["depth"][some]
    level = np.maximum(np.hypot(few.directions[:, 0], few.directions[:, 1]), 1e-6)
    rise = np.sqrt(1 + over**2)
    above = np.c_[few.directions[:, :2] / level[:, None], over] / rise[:, None]
    look = Rays(few.origins, above, few.time_s)
    away = standing.trace(look, {"depth"}, False, None, RenderStats()).maps["depth"]
    distance, values, normals = fill.hit(kind, few, start, standing.heights)
    hidden = distance > away / (rise * level) + BEHIND_M
    hidden |= recorded.unseen(look, away, np.zeros(len(some), np.int32), own, by_sweeps=True)
    distance[hidden] = np.inf
    for actor in state.actors:
        box_from_world = invert_pose(actor.world_from_actor.at(few.time_s))[:, None]
        near, far = intersect_boxes(few.origins, few.directions, box_from_world, np.asarray(actor.size_m)[None])
        # an actor may hide the plane
        distance[((near < far) & (far > before[:, None]) & (near < distance[:, None]))[:, 0]] = np.inf
    ends = np.isfinite(distance)
    some = some[ends]
    changed = {"depth": distance[ends], "normal": normals[ends], "unsupported": True}
    out = {name: x.copy() if name in changed else x for name, x in maps.items()}
    for name in changed.keys() & out.keys():
        out[name][some] = changed[name]
    return SeenThrough(some, values[ends]), out


def _entries(rays: Rays, boxes: Sequence[Box]) -> FloatArray:
    """Return where flat rays (N,) enter the first of some boxes, metres, inf where they pass none."""
    entries = np.full(len(rays.time_s), np.inf)
    for box in boxes:
        to, reach = box.world_from_box[:3, 3] - rays.origins, float(np.linalg.norm(box.size_m)) / 2
        along = np.einsum("nj,nj->n", to, rays.directions)
        some = np.flatnonzero((along > -reach) & (np.einsum("nj,nj->n", to, to) - along**2 < reach**2))
        near, far = intersect_boxes(
            rays.origins[some],
            rays.directions[some],
            invert_pose(box.world_from_box)[None],
            np.asarray(box.size_m)[None],
        )
        first = np.where((near < far) & (far > 0), np.maximum(near, 0), np.inf)[:, 0]
        entries[some] = np.minimum(entries[some], first)
    return entries


def _above(rays: Rays, boxes: Sequence[Box]) -> FloatArray:
    """Return the slopes (N,) at which flat rays (N,), turned upwards, pass above all boxes of their azimuth; inf beside a box."""
    slopes = np.full(len(rays.time_s), -np.inf)
    level = rays.directions * [1, 1, 0]
    level /= np.maximum(np.linalg.norm(level, axis=1, keepdims=True), 1e-6)
    for box in boxes:
        tall = np.array([*box.size_m[:2], 1e6])[None]
        near, far = (x[:, 0] for x in intersect_boxes(rays.origins, level, invert_pose(box.world_from_box)[None], tall))
        height = box.world_from_box[2, 3] + box.size_m[2] / 2 + ABOVE_M - rays.origins[:, 2]
        slope = np.where(near > NEAREST_M, height / np.where(height > 0, np.maximum(near, NEAREST_M), far), np.inf)
        slopes = np.where((near < far) & (far > 0), np.maximum(slopes, slope), slopes)
    return slopes


def filled_image(
    pending: PendingImage,
    fill: PlaneFill,
    bound: Binding,
    image: NDArray[np.float32],
    points: FloatArray,
    ground: BoolArray,
    maps: Maps,
    through: SeenThrough,
) -> tuple[NDArray[np.float32], Maps, Array]:
    """Return the image, and its maps, with the ground and façades filled that nobody saw, which no recorded ray supports, with
    contact shadows of recorded actors: others' are added later; and how much of each pixel (H, W) is filled. Pixels show
    ``points`` (H, W, 3), ``ground`` (H, W) where those are of no actor. ``through`` has cells and their colours."""
    up, flat = pending.tracer.upsample, points.reshape(-1, 3)
    some = np.flatnonzero(ground)
    there, colours, share = fill.of(Camera, flat[some], pending.tracer.heights)
    some = some[there]
    if len(through.rays):
        cells = np.full(len(maps["depth"]), -1)
        cells[through.rays] = np.arange(len(through.rays))
        which = per_pixel(cells.reshape(-(-ground.shape[0] // up), -1), up, ground.shape).reshape(-1)
        beside, whole = which[some] < 0, np.flatnonzero(which >= 0)
        some, share = (
            np.r_[some[beside], whole],
            np.r_[share[beside], np.full((len(whole), 1), np.float32(THROUGH_PART))],
        )
        colours = np.r_[colours[beside], through.values[which[whole]]]
    below = np.ones(len(some), bool)
    recorded = [a for a in pending.state.actors if not a.inserted and a.visible_to(pending.camera)]
    colours = shaded(colours[None], flat[some][None], below[None], recorded, pending.time_s)[0]
    colours = bound.exposed(colours, pending.camera.sensor_id, pending.time_s)
    image = image.copy()
    shown = image.reshape(-1, 3)
    shown[some] += share * (colours - shown[some])
    filled = np.zeros(ground.shape, np.float32)
    filled.reshape(-1)[some] = share[:, 0]
    if "unsupported" in maps:
        marked = filled[up // 2 :: up, up // 2 :: up].reshape(-1) > 0.5
        maps = {**maps, "unsupported": maps["unsupported"] | marked}
    return image, maps, filled


def filled_sweep(
    fill: PlaneFill,
    standing: Tracer[Any],
    recorded: RecordedDepth | None,
    state: WorldState,
    own: Sequence[Actor | None],
    rays: Rays,
    depth: Array,
    intensity: Array,
    instance: NDArray[np.int32],
) -> tuple[Array, Array]:
    """Return the distances and intensities (N,) of flat beams (N,), those on ground that no sweep saw as it is filled. See
    `seen_through`."""
    maps = {"depth": np.where(depth > 0, depth, np.float32(np.inf)), "instance": instance}
    through, maps = seen_through(fill, Lidar, standing, recorded, state, own, rays, maps)
    depth, intensity = np.where(np.isfinite(maps["depth"]), maps["depth"], 0).astype(np.float32), intensity.copy()
    points = rays.origins + rays.directions * depth[:, None]
    some = np.flatnonzero((instance == 0) & (depth > 0))
    there, filled, share = fill.of(Lidar, points[some], standing.heights)
    some = some[there]
    intensity[some] += share[:, 0] * (filled[:, 0] - intensity[some])
    known = np.isfinite(through.values[:, 0])
    intensity[through.rays[known]] = through.values[known, 0]
    return depth, intensity
