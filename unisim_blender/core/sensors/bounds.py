"""Culling of actors that a bundle of rays cannot hit, by bounding spheres of their trajectories and the cone that holds
the rays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry import BoolArray, FloatArray
from ..world.drive import Actor
from ..world.replay import PaddedKeys
from .rays import Rays

BIN_S = 0.05
"""Length of a bin of time, seconds."""
BIN_SLACK_S = 1e-4
"""Margin of a bin, seconds: a time on the edge of two bins may be rounded into either."""


class Bounds:
    """Bounding spheres of actors for bins of time, by which most rays are culled without a pose.

    Bins are `BIN_S` long from ``first_s`` on; centres are (bins, actors, 3), world frame, and radii (bins, actors),
    metres, below 0 where the actor is absent. ``keys`` are the actors'.
    """

    def __init__(self, actors: Sequence[Actor], keys: PaddedKeys | None = None) -> None:
        self.windows: FloatArray = np.array([(actor.start_s, actor.end_s) for actor in actors]).reshape(-1, 2)
        starts, ends = self.windows.T
        self.first_s = float(starts.min()) if len(actors) else 0.0
        bins = max(1, int(np.ceil(((ends.max() if len(actors) else 0.0) - self.first_s) / BIN_S)) + 1)
        edges = self.first_s + BIN_S * np.arange(bins + 1)
        at = (keys or PaddedKeys.of(actors)).positions_at(edges).swapaxes(0, 1)
        half: FloatArray = np.linalg.norm(np.array([actor.size_m for actor in actors]).reshape(-1, 3), axis=1) / 2
        present = (edges[1:, None] >= starts - BIN_SLACK_S) & (edges[:-1, None] <= ends + BIN_SLACK_S)
        self.centres = (at[1:] + at[:-1]) / 2
        self.radii = np.where(present, half + np.linalg.norm(np.diff(at, axis=0), axis=2) / 2 + 0.5, -1.0)

    def in_reach(self, rays: Rays, slack_rad: float = 0.0) -> list[int]:
        """Return the indices of actors that flat rays (N,) can hit: present at some ray's time, and touched by the cone
        that holds the rays, and all within ``slack_rad`` of one."""
        if not len(self.windows) or len(rays.time_s) == 0:
            return []
        times = float(rays.time_s.min()), float(rays.time_s.max())
        # a product with ones is a sum that numpy does not take three numbers at a time
        axis: FloatArray = np.ones(len(rays.time_s)) @ rays.directions / len(rays.time_s)
        length = float(np.linalg.norm(axis))
        axis = axis / max(length, 1e-9)
        cosine = float((rays.directions @ axis).min()) if length > 0.2 else -1.0
        half_angle = float(np.arccos(np.clip(cosine, -1, 1))) + slack_rad
        low, high = (np.array([of(rays.origins[:, a]) for a in range(3)]) for of in (np.min, np.max))
        origin, spread = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
        first, last = (min(max(int((at - self.first_s) // BIN_S), 0), len(self.radii) - 1) for at in times)
        radii = self.radii[first : last + 1]
        to = self.centres[first : last + 1] - origin
        distance = np.linalg.norm(to, axis=2)
        angle = np.arccos(np.clip((to @ axis) / np.maximum(distance, 1e-9), -1, 1))
        reach = np.arcsin(np.clip((radii + spread) / np.maximum(distance, 1e-9), 0, 1))
        touched = (angle <= half_angle + reach) | (half_angle > 3.1) | (distance <= radii + spread)
        present = (self.windows[:, 1] >= times[0]) & (self.windows[:, 0] <= times[1])
        return [int(i) for i in np.flatnonzero(present & (touched & (radii > 0)).any(0))]


def beside_boxes(actors: Sequence[Actor], rays: Rays, widening: float) -> BoolArray:
    """Return whether flat rays (N,) pass boxes that are present at the ray's time, nearer than ``widening`` times the
    distance: (N,) bool."""
    near = np.zeros(len(rays.time_s), bool)
    times, which = np.unique(rays.time_s, return_inverse=True)
    for i in Bounds(actors).in_reach(rays):
        actor = actors[i]
        poses = actor.world_from_actor.at(times)[which]
        o = np.einsum("nij,ni->nj", poses[:, :3, :3], rays.origins - poses[:, :3, 3])
        d = np.einsum("nij,ni->nj", poses[:, :3, :3], rays.directions)
        reach = np.linalg.norm(o, axis=1) + np.linalg.norm(actor.size_m) / 2
        half = actor.size_m / 2 + widening * reach[:, None]
        safe = np.where(np.abs(d) < 1e-9, 1e-9, d)
        a, b = (-half - o) / safe, (half - o) / safe
        enter, leave = np.minimum(a, b).max(1), np.maximum(a, b).min(1)
        near |= (enter <= leave) & (leave > 0) & actor.present(rays.time_s)
    return near
