"""Confidence of rendered pixels and beams: a calibrated probability that each is right, from what the recording shows of it.

The recorded images and sweeps that a scene was trained on are traced once, coarsely, for their distances (`RecordedDepth`). The
point that a ray ends at is projected into each of these views. A view confirms it where its own ray ends there, and contradicts
it where its own ray passes through. `ViewEvidence` holds how many do, and the angle and the distance to the closest of them.
`probability` is a logistic function of that, fitted on procedural streets, whose shifted views are known exactly
(docs/explanation/confidence.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import BoolArray, FloatArray, invert_pose
from ..sensors.rays import Rays
from ..world.drive import Actor, CameraModel
from .tracer import Array

FAR_M = 1e4
"""Distance of what is infinitely far, metres."""
BACKGROUND_M = 150.0
"""Distance, metres, beyond which points are of the background."""
TOLERANCE_M, TOLERANCE = 0.1, 0.02
"""Largest difference of distances of one surface: metres, and a part of the distance."""
MAX_ALIKE, MAX_OTHER = 8, 2
"""Number of views of a sensor's own kind and of the other kind that its points are projected into: the closest ones."""
TURN_M = 10.0
"""Distance, metres, that counts as much as looking at right angles."""
COARSER_WEIGHT = 0.05
"""Angle, radians, that a view which shows a point half as finely counts as farther away."""


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
    pixel_rad: float
    nearest: NDArray[np.float32]
    farthest: NDArray[np.float32]
    actor: NDArray[np.int16]

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


@dataclass(frozen=True)
class ViewEvidence:
    """What the recording shows of the ends of rays (N,). ``alike`` and ``other`` count views of the ray's kind of sensor and
    of the other kind that confirm a point, ``against`` all that contradict it. Of the closest view of the kind, by angle:
    ``angle_rad`` between the two rays, pi where there is none; ``coarser``, the binary logarithm of how much coarser it shows the
    point, at least 0; ``spread``, the difference of distances around its pixel as a part of the distance."""

    alike: Array
    other: Array
    against: Array
    angle_rad: Array
    coarser: Array
    spread: Array


@dataclass(frozen=True)
class RecordedDepth:
    """The views of a scene's recording, and its actors as they were recorded."""

    views: tuple[DepthView, ...]
    actors: Mapping[str, Actor]

    def near(self, world_from_sensor: FloatArray, of_beam: bool) -> RecordedDepth:
        """Return the views that are closest to a sensor's pose, of a LiDAR or a camera."""

        def distance(view: DepthView) -> float:
            away = float(np.linalg.norm(view.world_from_view[:3, 3] - world_from_sensor[:3, 3]))
            if of_beam or view.model is None:
                return away
            return away + TURN_M * (1 - float(view.world_from_view[:3, 2] @ world_from_sensor[:3, 2]))

        ordered = sorted(self.views, key=distance)
        alike = [view for view in ordered if (view.model is None) == of_beam]
        other = [view for view in ordered if (view.model is None) != of_beam]
        return replace(self, views=(*alike[:MAX_ALIKE], *other[:MAX_OTHER]))

    def evidence(
        self, rays: Rays, depth_m: Array, instance: NDArray[np.int32], active: Sequence[Actor | None], pixel_rad: float
    ) -> ViewEvidence:
        """Return what the recording shows of the ends of flat rays (N,). ``instance`` (N,) is 1 + the number
        among ``active`` of the actor that is hit, 0 for none; where that is None nothing confirms a point. ``pixel_rad`` is
        the angle between two rays."""
        count, of_beam = len(depth_m), pixel_rad == 0
        reach = np.minimum(depth_m, np.float32(FAR_M))
        directions = rays.directions.astype(np.float32)
        ends = (rays.origins + rays.directions * reach[:, None]).astype(np.float32)
        on_actors = _on_actors(rays, ends, instance, active, self.actors)
        out = ViewEvidence(*(np.zeros(count, np.float32) for _ in range(6)))
        out.angle_rad[:] = np.pi
        cost, static = np.full(count, np.inf, np.float32), instance == 0
        for view in self.views if count else ():
            points, along, present = ends, directions, static
            if on_actors:
                points, along, present = ends.copy(), directions.copy(), static.copy()
                for part in on_actors:
                    part.place(view.time_s, points, along, present)
            pose = invert_pose(view.world_from_view).astype(np.float32)
            # not by BLAS: a part of an image has the bits of the whole
            local = np.einsum("nj,ij->ni", points, pose[:3, :3]) + pose[:3, 3]
            cell, inside = view.cells(local)
            inside &= present
            distance = np.sqrt(np.einsum("ij,ij->i", local, local))
            tolerance = TOLERANCE_M + TOLERANCE * distance
            near, far = view.nearest.reshape(-1)[cell], view.farthest.reshape(-1)[cell]
            confirms = inside & (distance >= near - tolerance)
            # in the background distances mean little
            confirms &= (distance <= far + tolerance) | ((distance > BACKGROUND_M) & (far > BACKGROUND_M))
            nearer = inside & (distance < near - tolerance)
            confirms |= nearer & (distance > BACKGROUND_M)
            for part in on_actors:
                confirms[part.rays] &= view.actor.reshape(-1)[cell[part.rays]] == part.number
            out.against[nearer & (distance <= BACKGROUND_M)] += 1
            if (view.model is None) != of_beam:
                out.other[confirms] += 1
                continue
            out.alike[confirms] += 1
            cosine = np.einsum("ij,ij->i", local, np.einsum("nj,ij->ni", along, pose[:3, :3])) / np.maximum(
                distance, 1e-6
            )
            angle = np.arccos(np.clip(cosine, -1, 1))
            finer = np.maximum(reach, 1e-3) * (pixel_rad or view.pixel_rad)
            coarser = np.log2(np.maximum(distance * view.pixel_rad / finer, 1)).astype(np.float32)
            better = confirms & (angle + COARSER_WEIGHT * coarser < cost)
            for name, value in (
                ("angle_rad", angle), ("coarser", coarser), ("spread", (far - near) / np.maximum(distance, 1e-6)),
            ):  # fmt: skip
                np.copyto(getattr(out, name), value, where=better)
            np.copyto(cost, angle + COARSER_WEIGHT * coarser, where=better)
        return out


@dataclass(frozen=True)
class _OnActor:
    """The rays (M,), by their numbers, that end at an actor: their ends and directions in the recorded actor's frame."""

    recorded: Actor
    number: int
    rays: NDArray[np.int64]
    ends: FloatArray
    directions: FloatArray

    def place(self, time_s: float, points: Array, along: Array, present: BoolArray) -> None:
        """Set points, directions and presence of the rays to where the actor was recorded at ``time_s``."""
        if self.recorded.present(time_s):
            pose = self.recorded.world_from_actor.at(time_s)
            points[self.rays] = np.einsum("nj,ij->ni", self.ends, pose[:3, :3]) + pose[:3, 3]
            along[self.rays] = np.einsum("nj,ij->ni", self.directions, pose[:3, :3])
            present[self.rays] = True


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


CAMERA_WEIGHTS = (2.417, 1.706, 0.653, 0.626, 0.531, 0.297, 0.0, 0.389, 0.667, 0.157, 0.692, 3.005)
LIDAR_WEIGHTS = (3.617, 0.636, 0.342, 0.172, 0.632, 1.033, 0.0, 0.0, 0.443, 0.483, 0.485, 0.863)
"""Weights of `features`, fitted by maximum likelihood on procedural streets; none is below 0, so
that worse evidence never raises a probability."""
NEAREST_M, FARTHEST_M = 2.0, 200.0
"""Limits, metres, between which the distance of a point counts."""


def features(evidence: ViewEvidence, depth_m: Array, opacity: Array, instance: NDArray[np.int32]) -> Array:
    """Return the features (N, F) of `probability`: 1, of the closest view that confirms
    a point, of all views, and of the ray."""
    seen, reach = (evidence.alike > 0).astype(np.float32), np.clip(depth_m, NEAREST_M, FARTHEST_M)
    views = evidence.alike + evidence.other + evidence.against
    return np.stack(
        [
            np.ones_like(seen), seen,
            -seen * np.sqrt(np.minimum(evidence.angle_rad, 1)),
            -seen * np.minimum(evidence.coarser, 3),
            -seen * np.log1p(20 * np.minimum(evidence.spread, 1)),
            seen * np.minimum(evidence.alike, MAX_ALIKE) / MAX_ALIKE,
            (evidence.other > 0).astype(np.float32),
            -evidence.against / np.maximum(views, 1),
            -(instance > 0).astype(np.float32),
            -(np.isfinite(depth_m) & (opacity < 0.98)).astype(np.float32),
            -np.log2(reach / NEAREST_M),
            (depth_m > BACKGROUND_M).astype(np.float32),
        ], 1,
    )  # fmt: skip


def probability(
    evidence: ViewEvidence, depth_m: Array, opacity: Array, instance: NDArray[np.int32], of_beam: bool
) -> Array:
    """Return the probability (N,) that what is rendered is right."""
    weights = np.array(LIDAR_WEIGHTS if of_beam else CAMERA_WEIGHTS, np.float32)
    score = np.einsum("nf,f->n", features(evidence, depth_m, opacity, instance), weights)
    return np.asarray(1 / (1 + np.exp(-score)), np.float32)
