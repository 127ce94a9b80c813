"""Confidence of rendered pixels and beams: a calibrated probability that each is right, from what the recording shows of it.

The recorded images and sweeps that a scene was trained on are traced once, coarsely, for their distances (`RecordedDepth`). The
point that a ray ends at is projected into the closest of them. A view confirms it where its own ray ends there, and contradicts
it where its own ray passes through (`ViewEvidence`). `probability` is a logistic function of that, and of how right the scene
renders recorded frames; it is fitted on procedural streets, whose shifted views are known exactly
(docs/explanation/confidence.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import BoolArray, FloatArray
from ..sensors.rays import Rays
from ..world.drive import Actor, CameraModel
from .tracer import Array

FAR_M = 1e4
"""Distance of what is infinitely far, metres."""
BACKGROUND_M = 150.0
"""Distance, metres, beyond which points are of the background."""
TOLERANCE_M, TOLERANCE = 0.1, 0.02
"""Largest difference of distances of one surface: metres, and a part of the distance."""
MAX_VIEWS = 4
"""Number of views, of the sensor's own kind, that points are projected into: the closest ones."""
RIGHT_RGB = 0.1
"""Largest error of a channel, of 0 to 1, of a colour that is right."""
UNMEASURED = 0.6
"""Fraction of right pixels and returns that a scene without a measurement counts with."""
TURN_M = 10.0
"""Distance, metres, that counts as much as looking at right angles."""


@dataclass(frozen=True)
class DepthView:
    """Distances of what a recorded image or sweep shows, metres along its rays: ``nearest`` and ``farthest`` (h, w) of the pixels
    around each. A sweep has no ``model``: its columns are azimuths, its rows elevations from ``lowest_rad`` on. ``actor`` (h, w)
    is 1 + the number of the actor that is shown, 0 for none."""

    time_s: float
    world_from_view: FloatArray
    model: CameraModel | None
    lowest_rad: float
    row_rad: float
    nearest: NDArray[np.float32]
    farthest: NDArray[np.float32]
    actor: NDArray[np.int16]
    sensor_id: str = ""

    def cells(self, points: NDArray[Any]) -> tuple[NDArray[np.int64], BoolArray]:
        """Return the flat number of the pixel that each point (N, 3) of the view's frame projects to, and whether it does."""
        height, width = self.nearest.shape
        if self.model is not None:
            u, v, valid = self.model.project(points)
            inside = valid & (u >= 0) & (u < width) & (v >= 0) & (v < height)
        else:
            x, y, z = points.T
            u = (np.arctan2(y, x) / (2 * np.pi) + 0.5) * width
            v = (np.arctan2(z, np.hypot(x, y)) - self.lowest_rad) / self.row_rad + 0.5
            inside = (v >= 0) & (v < height)
        u, v = np.where(inside, u, 0.0).astype(np.int64), np.where(inside, v, 0.0).astype(np.int64)
        return v * width + np.minimum(u, width - 1), inside

    def shows(self, points: FloatArray) -> tuple[BoolArray, Array]:
        """Return whether the view shows static surfaces at points (N, 3), world frame, and their distances (N,) in metres."""
        to = points - self.world_from_view[:3, 3]
        cell, inside = self.cells(to @ self.world_from_view[:3, :3])
        distance = np.linalg.norm(to, axis=1).astype(np.float32)
        near, far = self.nearest.reshape(-1)[cell], self.farthest.reshape(-1)[cell]
        tolerance = TOLERANCE_M + TOLERANCE * distance
        shown = inside & (distance >= near - tolerance) & (distance <= far + tolerance)
        return shown & (self.actor.reshape(-1)[cell] == 0), distance


@dataclass(frozen=True)
class ViewEvidence:
    """What the recording shows of the ends of rays (N,): ``alike``, the number of views that confirm a point, ``against``
    that of those that contradict it. Of the closest view that confirms it: ``angle_rad`` between the two rays, pi where there is
    none; ``spread``, the difference of distances around its pixel as a part of the distance. ``accuracy``: see
    `RecordedDepth`."""

    alike: Array
    against: Array
    angle_rad: Array
    spread: Array
    accuracy: tuple[float, float] = (UNMEASURED, UNMEASURED)


@dataclass(frozen=True)
class RecordedDepth:
    """The views of a scene's recording, and its actors as they were recorded. ``accuracy``: the fractions of pixels whose
    colour, and of returns whose distance is right in recorded frames, as they were measured when it was trained."""

    views: tuple[DepthView, ...]
    actors: Mapping[str, Actor]
    accuracy: tuple[float, float] = (UNMEASURED, UNMEASURED)

    def near(self, world_from_sensor: FloatArray, of_beam: bool) -> RecordedDepth:
        """Return the views that are closest to a sensor's pose, of a LiDAR or a camera."""

        def distance(view: DepthView) -> float:
            away = float(np.linalg.norm(view.world_from_view[:3, 3] - world_from_sensor[:3, 3]))
            if of_beam or view.model is None:
                return away
            return away + TURN_M * (1 - float(view.world_from_view[:3, 2] @ world_from_sensor[:3, 2]))

        alike = [view for view in self.views if (view.model is None) == of_beam]
        return replace(self, views=tuple(sorted(alike, key=distance)[:MAX_VIEWS]))

    def unseen(
        self,
        rays: Rays,
        depth_m: Array,
        instance: NDArray[np.int32],
        active: Sequence[Actor | None],
        by_sweeps: bool = False,
    ) -> BoolArray:
        """Return whether no recorded image at all, nor a sweep if asked for, confirms the ends of flat rays (N,), see `evidence`;
        False for actors that were not recorded. At depth edges a sweep confirms both surfaces, not what is between."""
        recorded = [actor is not None and actor.appearance.actor in self.actors for actor in active]
        left = np.flatnonzero(np.array([True, *recorded])[instance])
        views = [view for view in self.views if view.model is not None]
        for view in (each for each in self.views if by_sweeps and each.model is None):
            views += [replace(view, farthest=view.nearest), replace(view, nearest=view.farthest)]
        for view in views:
            part = rays.part(left)
            left = left[replace(self, views=(view,)).evidence(part, depth_m[left], instance[left], active).alike == 0]
        out = np.zeros(len(depth_m), bool)
        out[left] = True
        return out

    def evidence(
        self, rays: Rays, depth_m: Array, instance: NDArray[np.int32], active: Sequence[Actor | None]
    ) -> ViewEvidence:
        """Return what the views show of the ends of flat rays (N,). ``instance`` (N,) is 1 + the number among ``active`` of the
        actor that is hit, 0 for none; where that is None nothing confirms a point."""
        reach = np.minimum(depth_m, np.float32(FAR_M))
        # rows of contiguous coordinates, and no BLAS: it is fast, and a part of an image has the bits of the whole
        directions = np.ascontiguousarray(rays.directions.T, np.float32)
        ends = np.ascontiguousarray((rays.origins + rays.directions * reach[:, None]).T, np.float32)
        on_actors = _on_actors(rays, ends.T, instance, active, self.actors)
        alike, against, spread = (np.zeros(len(reach), np.float32) for _ in range(3))
        closest, static = np.full(len(reach), np.inf, np.float32), instance == 0
        for view in self.views if len(reach) else ():
            pose = view.world_from_view.astype(np.float32)
            points = ends - pose[:3, 3:]
            along, present = _dot(points, directions), static
            for part in on_actors:
                present = part.place(view, points, along, present)
            local = np.stack([_dot(axis, points) for axis in pose[:3, :3].T])
            cell, inside = view.cells(local.T)
            inside &= present
            distance = np.sqrt(_dot(points, points))
            near, far = view.nearest.reshape(-1)[cell], view.farthest.reshape(-1)[cell]
            tolerance = TOLERANCE_M + TOLERANCE * distance
            nearer, is_background = distance < near - tolerance, distance > BACKGROUND_M
            # in the background distances mean little
            confirms = inside & (
                is_background & (nearer | (far > BACKGROUND_M)) | ~nearer & (distance <= far + tolerance)
            )
            for part in on_actors:
                confirms[part.rays] &= view.actor.reshape(-1)[cell[part.rays]] == part.number
            against[inside & nearer & ~is_background] += 1
            alike[confirms] += 1
            # the square of the chord between directions
            apart = 2 - 2 * along / np.maximum(distance, 1e-6)
            better = np.flatnonzero(confirms & (apart < closest))
            closest[better] = apart[better]
            spread[better] = (far[better] - near[better]) / np.maximum(distance[better], 1e-6)
        angle_rad = 2 * np.arcsin(np.sqrt(np.clip(closest / 4, 0, 1)))
        return ViewEvidence(alike, against, angle_rad, spread, self.accuracy)


def _dot(a: Array, b: Array) -> Array:
    """Return the products of vectors (3, N) or (3,)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


@dataclass(frozen=True)
class _OnActor:
    """The rays (M,), by their numbers, that end at an actor: their ends and directions in the recorded actor's frame."""

    recorded: Actor
    number: int
    rays: NDArray[np.int64]
    ends: FloatArray
    directions: FloatArray

    def place(self, view: DepthView, points: Array, along: Array, present: BoolArray) -> BoolArray:
        """Set the points (3, N) from the view, and their products with directions, to where the actor was
        recorded at the view's time, and return which rays are present in it."""
        if not self.recorded.present(view.time_s):
            return present
        pose = self.recorded.world_from_actor.at(view.time_s)
        moved = np.einsum("nj,ij->in", self.ends, pose[:3, :3]) + (pose[:3, 3:] - view.world_from_view[:3, 3:])
        points[:, self.rays] = moved
        along[self.rays] = _dot(moved, np.einsum("nj,ij->in", self.directions, pose[:3, :3]))
        present = present.copy()
        present[self.rays] = True
        return present


def _on_actors(
    rays: Rays, ends: Array, instance: NDArray[np.int32], active: Sequence[Actor | None], recorded: Mapping[str, Actor]
) -> list[_OnActor]:
    numbers = {uid: number for number, uid in enumerate(sorted(recorded), 1)}
    parts = []
    for each in np.unique(instance[instance > 0]).tolist():
        actor = active[each - 1]
        if actor is None or actor.appearance.actor not in recorded:
            continue
        source, some = recorded[actor.appearance.actor], np.flatnonzero(instance == each)
        times, which = np.unique(rays.time_s[some], return_inverse=True)
        pose = actor.world_from_actor.at(times)[which]
        local = np.einsum("nji,nj->ni", pose[:, :3, :3], ends[some] - pose[:, :3, 3]) / np.array(actor.scale)
        turned = np.einsum("nji,nj->ni", pose[:, :3, :3], rays.directions[some])
        parts.append(_OnActor(source, numbers[source.uid], some, local, turned))
    return parts


def around(depth: Array) -> tuple[Array, Array]:
    """Return the least and the greatest distance (h, w) of each pixel and the eight around it; 0 and 0 where all are
    0, which means unknown."""
    padded = np.pad(depth, 1, mode="edge")
    parts = np.stack([padded[y : y + depth.shape[0], x : x + depth.shape[1]] for y in range(3) for x in range(3)])
    near = np.where(parts > 0, parts, np.float32(np.inf)).min(0)
    return np.where(np.isfinite(near), near, np.float32(0)), parts.max(0)


CAMERA_WEIGHTS = (-2.081, 0.857, 0.442, 0.535, 0.344, 0.326, 0.145, 0.265, 1.968, 0.341, 0.843)
LIDAR_WEIGHTS = (-0.262, 1.17, 0.906, 0.618, 1.042, 0.363, 0.0, 0.372, 0.0, 0.083, 0.939)
"""Weights of `features`, fitted by maximum likelihood on procedural streets (`benchmarks/confidence.py`); none but the first is
below 0, so that worse evidence never raises a probability."""
NEAREST_M, FARTHEST_M = 2.0, 200.0
"""Limits, metres, between which the distance of a point counts."""


def features(evidence: ViewEvidence, depth_m: Array, instance: NDArray[np.int32]) -> Array:
    """Return the features (F, N) of `probability`: 1, of the closest view that confirms a point, of all views, of the ray,
    and of the scene."""
    seen, reach = (evidence.alike > 0).astype(np.float32), np.clip(depth_m, NEAREST_M, FARTHEST_M)
    odds = [np.full_like(seen, np.log(share / (1 - share))) for share in np.clip(evidence.accuracy, 0.01, 0.99)]
    return np.stack(
        [
            np.ones_like(seen), seen,
            -seen * np.sqrt(np.minimum(evidence.angle_rad, 1)),
            -seen * np.log1p(20 * np.minimum(evidence.spread, 1)),
            evidence.alike / MAX_VIEWS,
            -evidence.against / np.maximum(evidence.alike + evidence.against, 1),
            -(instance > 0).astype(np.float32),
            -np.log2(reach / NEAREST_M),
            (depth_m > BACKGROUND_M).astype(np.float32),
            *odds,
        ]
    )  # fmt: skip


def probability(evidence: ViewEvidence, depth_m: Array, instance: NDArray[np.int32], of_beam: bool) -> Array:
    """Return the probability (N,) that what is rendered is right."""
    score = np.zeros(len(depth_m), np.float32)
    for weight, feature in zip(
        LIDAR_WEIGHTS if of_beam else CAMERA_WEIGHTS, features(evidence, depth_m, instance), strict=True
    ):
        score += np.float32(weight) * feature
    return np.asarray(1 / (1 + np.exp(-score)), np.float32)
