"""Culling of actors that a bundle of rays cannot hit, by bounding spheres of their trajectories and the cone that holds
the rays."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry import BoolArray, FloatArray
from ..world.drive import Actor
from .rays import Rays

BIN_S = 0.05
"""Length of a bin of time, seconds."""
BIN_SLACK_S = 1e-4
"""Margin of a bin, seconds: a time on the edge of two bins may be rounded into either."""


class Bounds:
    """Bounding spheres of actors for bins of time, by which most rays are culled without a pose.

    Bins are `BIN_S` long from ``first_s`` on; centres are (bins, actors, 3), world frame, and radii (bins, actors),
    metres, below 0 where the actor is absent.
    """

    def __init__(self, actors: Sequence[Actor]) -> None:
        self.windows = [(actor.start_s, actor.end_s) for actor in actors]
        self.first_s = min((start for start, _ in self.windows), default=0.0)
        last = max((end for _, end in self.windows), default=0.0)
        bins = max(1, int(np.ceil((last - self.first_s) / BIN_S)) + 1)
        edges = self.first_s + BIN_S * np.arange(bins + 1)
        starts, ends = np.array(self.windows).reshape(-1, 2).T
        present = (edges[1:, None] >= starts - BIN_SLACK_S) & (edges[:-1, None] <= ends + BIN_SLACK_S)
        half = np.linalg.norm(np.array([actor.size_m for actor in actors]).reshape(-1, 3), axis=1) / 2
        self.centres, self.radii = np.zeros((bins, len(actors), 3)), np.full((bins, len(actors)), -1.0)
        for number, actor in enumerate(actors):
            here = np.flatnonzero(present[:, number])
            if not len(here):
                continue
            at = actor.world_from_actor.positions_at(edges[here[0] : here[-1] + 2])
            step = np.linalg.norm(np.diff(at, axis=0), axis=-1)
            self.centres[here, number] = (at[1:] + at[:-1]) / 2
            self.radii[here, number] = half[number] + step / 2 + 0.5

    def between(self, actor: int, first_s: float, last_s: float) -> tuple[FloatArray, FloatArray] | None:
        """Return the spheres (K, 3), (K,) around one actor over a span of time, world frame; None where it is absent
        throughout."""
        last_bin = len(self.radii) - 1
        low = min(max(int((first_s - self.first_s) // BIN_S), 0), last_bin)
        high = min(max(int((last_s - self.first_s) // BIN_S), 0), last_bin)
        radii = self.radii[low : high + 1, actor]
        here = radii > 0
        return (self.centres[low : high + 1, actor][here], radii[here]) if here.any() else None

    def in_reach(self, rays: Rays, slack_rad: float = 0.0) -> list[int]:
        """Return the indices of actors that flat rays (N,) can hit: present at some ray's time, and touched by the cone
        that holds the rays, and all within ``slack_rad`` of one."""
        if not self.windows or len(rays.time_s) == 0:
            return []
        first, last = float(rays.time_s.min()), float(rays.time_s.max())
        # a product with ones is a sum that numpy does not take three numbers at a time
        axis: FloatArray = np.ones(len(rays.time_s)) @ rays.directions / len(rays.time_s)
        length = float(np.linalg.norm(axis))
        axis = axis / max(length, 1e-9)
        cosine = float((rays.directions @ axis).min()) if length > 0.2 else -1.0
        half_angle = float(np.arccos(np.clip(cosine, -1, 1))) + slack_rad
        low, high = (np.array([of(rays.origins[:, a]) for a in range(3)]) for of in (np.min, np.max))
        origin, spread = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
        keep = []
        for i, (start, end) in enumerate(self.windows):
            near = None if end < first or start > last else self.between(i, first, last)
            if near is None:
                continue
            centres, radii = near
            to = centres - origin
            distance = np.linalg.norm(to, axis=1)
            angle = np.arccos(np.clip((to @ axis) / np.maximum(distance, 1e-9), -1, 1))
            reach = np.arcsin(np.clip((radii + spread) / np.maximum(distance, 1e-9), 0, 1))
            if (
                bool((angle <= half_angle + reach).any())
                or half_angle > 3.1
                or bool((distance <= radii + spread).any())
            ):
                keep.append(i)
        return keep


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
