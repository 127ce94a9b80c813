"""Shadows of actors that the recording does not have where they are.

Without a contact shadow such a car seems to float. Direct sunlight is in the recorded light; a contact shadow is the
sky's light that a body near the ground blocks.

A trained actor has the ground in its box, with the shadow that was recorded on it. Where an edit has moved the actor,
that piece of ground goes along, and fades towards the sides of the box.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb, srgb_from_linear
from ..geometry import BoolArray, FloatArray, invert_pose, transform_points
from ..world.drive import Actor, Box
from ..world.replay import WorldState

MAX_DARKENING = 0.6
"""Fraction of light that is blocked right under an actor."""
SHADOW_DECAY_M = 0.35
"""Distance, in metres, beside an actor's footprint or below its underside over which its shadow falls by a factor e."""
FOOTPRINT_SCALE = 0.92
"""Length and width of a footprint relative to the box: bodies are rounder than their boxes."""
SHADOW_CUTOFF_M = 5 * SHADOW_DECAY_M
FADE_M = 0.15
"""Distance from the sides of an actor's box, metres, over which its ground becomes opaque."""
LOWER_PART = -0.25
"""Height in an actor's box, relative to its size, from which on nothing is ground."""
GROUND_M, ABOVE_GROUND_M = 0.03, 0.08
"""Heights above the ground, metres, up to which an actor's surface fades as its ground, and from which on not at all."""
MIN_MOVED_M, MIN_TURNED_RAD = 1e-4, 1e-5
"""Least displacement of an actor that counts as moved."""


def shaded(
    rgb: NDArray[np.float32], points: FloatArray, ground: BoolArray, actors: Iterable[Actor], time_s: float
) -> NDArray[np.float32]:
    """Return the image (H, W, 3), display-referred sRGB, with contact shadows of ``actors`` at ``time_s``.

    ``points`` (H, W, 3) are the places that the pixels show, world frame, metres; ``ground`` (H, W) is True where they
    show no actor.
    """
    assert points.shape == rgb.shape and ground.shape == rgb.shape[:2], (rgb.shape, points.shape, ground.shape)
    boxes = [Box(actor.world_from_actor.at(time_s), actor.size_m) for actor in actors if actor.present(time_s)]
    light = np.where(ground, contact_light(points.reshape(-1, 3), boxes).reshape(ground.shape), 1.0)
    return rgb if (light == 1).all() else dimmed(rgb, light[..., None])


def contact_light(points: FloatArray, boxes: Iterable[Box]) -> FloatArray:
    """Return the part (N,) of light that boxes near points (N, 3), world frame, let through."""
    light = np.ones(len(points))
    for box in boxes:
        pose, half = box.world_from_box, np.asarray(box.size_m) / 2
        near = np.abs(points - pose[:3, 3]).max(1) < half.max() + SHADOW_CUTOFF_M
        if not near.any():
            continue
        x, y, z = transform_points(invert_pose(pose), points[near]).T
        beside = np.hypot(
            np.maximum(np.abs(x) - FOOTPRINT_SCALE * half[0], 0), np.maximum(np.abs(y) - FOOTPRINT_SCALE * half[1], 0)
        )
        height = np.abs(z + half[2])
        blocked = MAX_DARKENING * np.exp(-(beside + height) / SHADOW_DECAY_M)
        # what is further away depends on nothing here: it may not have been rendered again
        light[near] *= 1 - np.where(np.maximum(beside, height) < SHADOW_CUTOFF_M, blocked, 0)
    return light


def dimmed(rgb: NDArray[np.float32], light: FloatArray) -> NDArray[np.float32]:
    """Return an image (H, W, 3), display-referred sRGB, with ``light`` (H, W, 3) or (H, W, 1) times its linear colours;
    where that is 1, the bits are the image's."""
    changed = srgb_from_linear(np.minimum(linear_from_srgb(np.clip(rgb, 0, 1)) * light.astype(np.float32), 1))
    return np.where((light != 1.0).any(-1, keepdims=True), changed, rgb)


def displaced(state: WorldState, recorded: Mapping[str, Actor] | None) -> list[Actor]:
    """Return the actors of a state that are not where they were ``recorded``; none where that is None. Meshes have no
    recorded ground."""
    if recorded is None:
        return []
    times_s = np.array([state.start_s, state.end_s])
    trained = (actor for actor in state.actors if not actor.appearance.mesh)
    return [actor for actor in trained if not _is_recorded(actor, recorded.get(actor.uid), times_s)]


def _is_recorded(actor: Actor, recorded: Actor | None, times_s: FloatArray) -> bool:
    if recorded is None or actor.appearance != recorded.appearance or actor.is_scaled:
        return False
    # equal keys are the cheap case, and the usual one
    keys = [one.world_from_actor.between(*times_s.tolist()).content() for one in (actor, recorded)]
    if keys[0] == keys[1]:
        return True
    # at both ends: one that stands is displaced while the recorded one passes it
    here, there = (one.world_from_actor.at(times_s) for one in (actor, recorded))
    apart = np.abs(here - there)
    return bool(apart[:, :3, 3].max() < MIN_MOVED_M and apart[:, :3, :3].max() < MIN_TURNED_RAD)


def faded(
    points: FloatArray,
    time_s: FloatArray,
    instance: NDArray[np.int32],
    actors: Mapping[int, Actor],
    recorded: Mapping[str, Actor],
    heights: Callable[[FloatArray], FloatArray],
) -> NDArray[np.float32]:
    """Return the transparencies (N,) in 0..1 of the ground in the boxes of displaced ``actors``, by ``instance`` (N,).

    ``points`` (N, 3) are places that rays hit, world frame, metres, at times (N,). ``heights`` returns heights above
    the ground; an actor's ground is the one where it was ``recorded``.
    """
    transparency = np.zeros(len(points), np.float32)
    for number, actor in actors.items():
        mine = np.flatnonzero(instance == number)
        if not len(mine):
            continue
        times, which = np.unique(time_s[mine], return_inverse=True)
        pose = actor.world_from_actor.at(times)[which.reshape(-1)]
        local = np.einsum("nji,nj->ni", pose[:, :3, :3], points[mine] - pose[:, :3, 3])
        low = local[:, 2] < LOWER_PART * actor.size_m[2]
        mine, local = mine[low], local[low]
        source, places = recorded.get(actor.appearance.actor), points[mine]
        if source is not None and not actor.appearance.scene:
            # at one time: what stands must look the same at all times
            places = transform_points(source.world_from_actor.at(source.start_s), local / np.array(actor.scale))
        above = heights(places)
        inside = np.clip((actor.size_m[:2] / 2 - np.abs(local[:, :2])).min(1) / FADE_M, 0, 1)
        share = np.clip((ABOVE_GROUND_M - above) / (ABOVE_GROUND_M - GROUND_M), 0, 1)
        transparency[mine] = share * (1 - inside**2 * (3 - 2 * inside))
    return transparency
