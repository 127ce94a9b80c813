"""Image-based rendering (after Free View Synthesis, Riegler and Koltun, ECCV 2020): a `tracer.Tracer` that colours rays
from recorded images, with surfels as the geometry.

The point where a ray hits a surfel is projected into recorded images near the camera; a point of an actor in the
actor's own box, so that the actor may be elsewhere now. An image contributes where nothing hides the point from it,
weighted by the angle between its ray and the rendered one. Points that no image shows have the surfel's own colour;
rays that hit no surfel take the image's colour at infinite distance.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...data.log import Log
from ...geometry import BoolArray, FloatArray
from ...sensors.rays import Rays
from ...world.drive import Actor
from ...world.replay import WorldState, with_windows
from ..quality import QUALITIES, Quality
from ..tracer import Array
from .surfels.model import SurfelScene
from .surfels.placed import NO_OWNER, STATIC_OWNER, PlacedSurfels, SurfelHits, carried
from .surfels.tracer import SurfelBackend, SurfelTracer
from .surfels.views import RecordedView, open_view

NEAREST_IMAGES = 2
"""Number of nearest images for rays of a camera on its recorded trajectory."""
SHIFT_FRAMES = (0, -4, 4, -8, -12)
"""Offsets, in frames, of the images for rays of a camera beside its recorded trajectory (UniSim's supplementary,
2.1)."""
MIN_ASIDE_M = 0.5
"""A camera at least this far from its recorded trajectory counts as beside it."""
TIME_WEIGHT_M_PER_S = 0.5
"""Distance, metres, that a time difference of a second counts as: while the vehicle stands, the latest image is
nearest."""
MIN_FACING_COSINE = 0.2
"""Smallest cosine between a camera's axis and the rays' direction at which its images are used."""
DEPTH_WIDTH_PX = 640
MAX_CACHED_IMAGES = 24
"""Largest number of decoded images that are cached."""


class SourceImage(NamedTuple):
    """A recorded image."""

    camera: str
    frame: int


class Sources:
    """A log's images of ``frames``, with the depths of a scene's surfels in them."""

    def __init__(self, log: Log, scene: SurfelScene, frames: Sequence[int]) -> None:
        self.log, self.drive = log, log.drive
        allowed = set(frames)
        self.frames = {name: [f for f in log.image_frames(name) if f in allowed] for name in self.drive.cameras}
        self.poses = {}
        for name, numbers in self.frames.items():
            camera = self.drive.cameras[name]
            if numbers:
                times = np.array([camera.time_s[frame] for frame in numbers])
                self.poses[name] = times, camera.world_from_camera.at(times)
        self.recorded = {actor.uid: actor for actor in with_windows(self.drive, self.drive.actors.values())}
        self.outlines, self.exposures = scene.outlines, scene.exposures
        self.surfels = PlacedSurfels(scene.static, [(actor, scene.actors[uid]) for uid, actor in self.recorded.items()])
        self._views: OrderedDict[tuple[Any, ...], RecordedView] = OrderedDict()

    def elsewhere(self, state: WorldState) -> tuple[str, ...]:
        """Return the ids of recorded actors that are not where they were recorded: in the images they hide what is
        behind their recorded boxes."""
        now = {actor.uid for actor in state.actors if self.unedited(actor, state)}
        there = (a for a in self.recorded.values() if a.start_s <= state.end_s and a.end_s >= state.start_s)
        return tuple(actor.uid for actor in there if actor.uid not in now)

    def view(self, source: SourceImage, shrink: int, elsewhere: tuple[str, ...]) -> RecordedView:
        """Return the image at one ``shrink``-th of its width; ``elsewhere`` is the result of the method of that name.
        Raises `LogError`."""
        key = *source, shrink, elsewhere
        if key not in self._views:
            width = max(1, self.drive.cameras[source.camera].model.width // shrink)
            depth_width = min(width, DEPTH_WIDTH_PX)
            hiding = [self.recorded[uid] for uid in elsewhere]
            view = open_view(self.log, *source, width, depth_width, self.surfels, hiding, self.outlines)
            time_s = np.array([view.camera.time_s[source.frame]])
            self._views[key] = replace(view, gain=self.exposures.at(source.camera, time_s)[0])
            while len(self._views) > MAX_CACHED_IMAGES:
                self._views.popitem(last=False)
        self._views.move_to_end(key)
        return self._views[key]

    def shrink(self, camera: str, pixel_rad: float) -> int:
        """Return the factor by which an image may be reduced for pixels of at most ``pixel_rad``, radians."""
        return int(np.clip(self.drive.cameras[camera].model.pixels_per_rad * pixel_rad + 0.25, 1, 8))

    def about(self, origin: FloatArray, direction: FloatArray, time_s: float) -> list[SourceImage]:
        """Return the images for rays from ``origin`` (3,) near ``direction`` (3,), world frame, at ``time_s``, those of
        the camera that faces the direction best first."""
        by_camera: list[list[SourceImage]] = []
        for name in self._facing(direction):
            times, poses = self.poses[name]
            near = np.linalg.norm(poses[:, :3, 3] - origin, axis=1) + TIME_WEIGHT_M_PER_S * np.abs(times - time_s)
            order = np.argsort(near, kind="stable")
            aside = poses[order[0], :3, :3].T @ (origin - poses[order[0], :3, 3])
            numbers = self.frames[name]
            chosen = [numbers[i] for i in order[:NEAREST_IMAGES]]
            if np.hypot(aside[0], aside[1]) > MIN_ASIDE_M:
                middle = numbers[int(order[0])]
                chosen = [min(numbers, key=lambda frame: abs(frame - (middle + k))) for k in SHIFT_FRAMES]  # noqa: B023
            by_camera.append([SourceImage(name, frame) for frame in dict.fromkeys(chosen)])
        return [source for images in by_camera for source in images]

    def farther(self, origin: FloatArray, direction: FloatArray, time_s: float) -> list[SourceImage]:
        """Return further images for rays as in `about`, for places that are hidden in those."""
        sources = []
        for name in self._facing(direction)[:1]:
            times, poses = self.poses[name]
            near = np.linalg.norm(poses[:, :3, 3] - origin, axis=1) + TIME_WEIGHT_M_PER_S * np.abs(times - time_s)
            middle = self.frames[name][int(near.argmin())]
            wanted = [middle + k for k in (-4, 4, -8, 8, -16, 16, -32, 32)]
            sources += [SourceImage(name, min(self.frames[name], key=lambda frame: abs(frame - k))) for k in wanted]  # noqa: B023
        return list(dict.fromkeys(sources))

    def of_actor(self, uid: str, place: FloatArray, direction: FloatArray) -> list[SourceImage]:
        """Return the images that show an actor as it is seen from ``place`` (3,) in its box, in ``direction`` (3,),
        world frame."""
        actor, distances = self.recorded[uid], []
        for name in self._facing(direction):
            times, poses = self.poses[name]
            there = actor.present(times)
            inward = actor.world_from_actor.at(times)
            local = np.einsum("nji,nj->ni", inward[:, :3, :3], poses[:, :3, 3] - inward[:, :3, 3])
            ahead = np.einsum("nij,ni->nj", poses[:, :3, :3], inward[:, :3, 3] - poses[:, :3, 3])[:, 2] > 0
            near = np.where(there & ahead, np.linalg.norm(local - place, axis=1), np.inf)
            distances += [
                (near[i], SourceImage(name, self.frames[name][i]))
                for i in np.argsort(near, kind="stable")[:NEAREST_IMAGES]
            ]
        return [source for distance, source in sorted(distances) if np.isfinite(distance)][:NEAREST_IMAGES]

    def _facing(self, direction: FloatArray) -> list[str]:
        """Return the cameras that face ``direction`` (3,), world frame, the best first."""
        facing = {name: float(poses[:, :3, 2].mean(0) @ direction) for name, (_, poses) in self.poses.items()}
        return [name for name in sorted(facing, key=lambda n: (-facing[n], n)) if facing[name] > MIN_FACING_COSINE]

    def unedited(self, actor: Actor, state: WorldState) -> bool:
        """Return whether an actor of a state has its recorded trajectory and size."""
        recorded = self.recorded.get(actor.uid)
        if recorded is None or actor.appearance.actor != actor.uid or actor.is_scaled:
            return False
        a, b = actor.world_from_actor, recorded.world_from_actor.between(state.start_s, state.end_s)
        return np.array_equal(a.times_s, b.times_s) and np.array_equal(a.positions, b.positions)


Numbers = NDArray[np.int64]
MIN_ANGLE_RAD = 0.004
"""Angle between rays, radians, below which weights hardly rise."""
FEATHER_SHARE = 0.04
"""Share of an image's width, at its edges, over which its weight falls."""


class WarpBackend(SurfelBackend):
    """Surfels and the images of ``frames`` that they were painted from; see `SurfelBackend`."""

    sees_all = True  # recorded images show actors that are elsewhere now

    def __init__(
        self, scene: SurfelScene, log: Log, frames: Sequence[int], quality: Quality = QUALITIES["balanced"]
    ) -> None:
        super().__init__(scene, log.drive, quality)
        self.log, self.frames = log, frames
        self.sources = Sources(log, scene, frames)

    def bind(self, state: WorldState) -> WarpTracer:
        """See `tracer.Backend`. Raises `SceneError` for actors that the log does not hold."""
        return WarpTracer(self, state)


class WarpTracer(SurfelTracer):
    """A `tracer.Tracer`: a backend's images, warped over its surfels in a state of the world."""

    def __init__(self, backend: WarpBackend, state: WorldState) -> None:
        super().__init__(backend, state)
        self.sources = backend.sources
        self.elsewhere = self.sources.elsewhere(state)
        self.edited = [not self.sources.unedited(actor, state) for actor in self.active.own.actors]

    def colours(self, rays: Rays, hits: SurfelHits, pixel_rad: float) -> tuple[Array, BoolArray]:
        painted, unsupported = super().colours(rays, hits, pixel_rad)
        total = np.zeros((len(painted), 4))
        own, copies = len(self.active.own.actors), hits.owner >= len(self.active.own.actors)
        moved = np.zeros(len(hits.t), bool)
        for number in np.unique(hits.owner[(hits.owner >= 0) & (hits.owner < own)]).tolist():
            if self.edited[number]:
                moved |= hits.owner == number
                self._add_edited(total, rays, hits, number, pixel_rad)
        for part, origin, direction, time_s in _rows(rays):
            here = part[~moved[part] & ~copies[part]]
            for source in self.sources.about(origin, direction, time_s):
                self._add(total, rays, hits, here, source, pixel_rad)
            bare = here[total[here, 3] == 0]
            bare = bare[hits.owner[bare] != NO_OWNER]
            for source in self.sources.farther(origin, direction, time_s) if len(bare) else ():
                self._add(total, rays, hits, bare, source, pixel_rad)
                bare = bare[total[bare, 3] == 0]
                if len(bare) == 0:
                    break
        some = total[:, 3] > 0
        painted[some] = (total[some, :3] / total[some, 3:] / 255).astype(np.float32)
        return painted, unsupported & ~some

    def _add_edited(self, total: FloatArray, rays: Rays, hits: SurfelHits, number: int, pixel_rad: float) -> None:
        """Add the colours of an actor on another trajectory than the recorded one, or scaled, from the images that show
        it from the same side."""
        actor = self.active.own.actors[number]
        mine = np.flatnonzero(hits.owner == number)
        middle = mine[len(mine) // 2]
        time = rays.time_s[middle : middle + 1]
        place = carried(actor, time, rays.origins[middle : middle + 1], back=True)[0]
        recorded = self.sources.recorded.get(actor.appearance.actor)
        if recorded is not None:
            for source in self.sources.of_actor(recorded.uid, place, rays.directions[middle]):
                self._add(total, rays, hits, mine, source, pixel_rad)

    def _add(
        self, total: FloatArray, rays: Rays, hits: SurfelHits, chosen: Numbers, source: SourceImage, pixel_rad: float
    ) -> None:
        """Add an image's colours of the chosen rays to sums (N, 4) of weighted colours and weights."""
        if len(chosen) == 0:
            return
        view = self.sources.view(source, self.sources.shrink(source.camera, pixel_rad), self.elsewhere)
        for owner in np.unique(hits.owner[chosen]).tolist():
            mine = chosen[hits.owner[chosen] == owner]
            if owner == NO_OWNER:
                self._add_beyond(total, rays, mine[total[mine, 3] == 0], view)
            elif owner == STATIC_OWNER:
                points = rays.origins[mine] + rays.directions[mine] * hits.t[mine, None]
                self._add_seen(total, rays.directions[mine], points, mine, view, view.of_static(points), True)
            elif owner < len(self.active.own.actors):
                actor = self.active.own.actors[owner]
                recorded = self.sources.recorded.get(actor.appearance.actor)
                first, last = view.ends()
                if (
                    recorded is None
                    or not recorded.start_s <= min(first, last)
                    or not max(first, last) <= recorded.end_s
                ):
                    continue
                points = rays.origins[mine] + rays.directions[mine] * hits.t[mine, None]
                local = carried(actor, rays.time_s[mine], points, back=True)
                inward = carried(actor, rays.time_s[mine], rays.origins[mine], back=True)
                then = carried(recorded, np.full(len(mine), (first + last) / 2), local)
                ours = then - carried(recorded, np.full(len(mine), (first + last) / 2), inward)
                ours /= np.linalg.norm(ours, axis=1, keepdims=True)
                self._add_seen(total, ours, then, mine, view, view.of_actor(recorded.world_from_actor, local), False)

    def _add_seen(
        self,
        total: FloatArray,
        ours: FloatArray,
        points: FloatArray,
        mine: Numbers,
        view: RecordedView,
        placed: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
        static: bool,
    ) -> None:
        """Add the colours of points (N, 3) that the image sees. ``ours`` (N, 3) are the rendered rays' directions to
        them, in the world as the image shows it."""
        u, v, z, distance = placed
        inside = view.inside(u, v, z)
        inside[inside] = view.sees(u[inside], v[inside], distance[inside], static)
        mine, u, v = mine[inside], u[inside], v[inside]
        centre = view.camera.world_from_camera.at(float(np.mean(view.ends())))[:3, 3]
        theirs = points[inside] - centre
        theirs /= np.maximum(np.linalg.norm(theirs, axis=1, keepdims=True), 1e-9)
        angle = np.linalg.norm(theirs - ours[inside], axis=1)
        model = view.camera.model
        edge = np.minimum(np.minimum(u, model.width - u), np.minimum(v, model.height - v)) / (
            FEATHER_SHARE * model.width
        )
        weight = np.clip(edge, 1e-3, 1.0) / (MIN_ANGLE_RAD + angle) ** 2
        total[mine, :3] += weight[:, None] * view.sample(u, v)
        total[mine, 3] += weight

    def _add_beyond(self, total: FloatArray, rays: Rays, mine: Numbers, view: RecordedView) -> None:
        """Add the colours beyond all surfels to rays that no nearer image has shown yet."""
        first, last = (rays.directions[mine] @ view.camera.world_from_camera.at(time)[:3, :3] for time in view.ends())
        u, v, z, _ = view.place(first, last)
        inside = view.inside(u, v, np.where(z > 0, np.inf, 0.0))
        inside[inside] = view.beyond[view.cells(u[inside], v[inside])]
        total[mine[inside], :3] += view.sample(u[inside], v[inside])
        total[mine[inside], 3] += 1.0


def _rows(rays: Rays) -> Iterator[tuple[Numbers, FloatArray, FloatArray, float]]:
    """Yield groups of an exposure's rays that share their images: numbers (M,), an origin (3,), a direction (3,), a
    time."""
    if len(rays.time_s):
        middle = len(rays.time_s) // 2
        direction = rays.directions.mean(0)
        yield (
            np.arange(len(rays.time_s)),
            rays.origins[middle],
            direction / np.linalg.norm(direction),
            float(rays.time_s[middle]),
        )
