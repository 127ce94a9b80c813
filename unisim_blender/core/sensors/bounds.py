"""Culling of actors that a bundle of rays cannot hit, by bounding spheres of their trajectories and the cone that holds
the rays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry import BoolArray, FloatArray
from ..world.drive import BIN_S, Actor
from .rays import Rays


class Bounds:
    """Bounding spheres of actors for bins of time, by which most rays are culled without a pose.

    Bins are `BIN_S` long from ``first_s`` on; centres are (bins, actors, 3), world frame, and radii (bins, actors),
    metres, below 0 where the actor is absent.
    """

    def __init__(self, actors: Sequence[Actor]) -> None:
        self.windows: FloatArray = np.array([(actor.start_s, actor.end_s) for actor in actors]).reshape(-1, 2)
        spheres = [actor.bounding_spheres for actor in actors]
        first = min((at for at, *_ in spheres), default=0)
        bins = max((at - first + len(radii) for at, _, radii in spheres), default=1)
        self.first_s = first * BIN_S
        self.centres, self.radii = np.zeros((bins, len(actors), 3)), np.full((bins, len(actors)), -1.0)
        for number, (at, centres, radii) in enumerate(spheres):
            here = slice(at - first, at - first + len(radii))
            self.centres[here, number], self.radii[here, number] = centres, radii

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
