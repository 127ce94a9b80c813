"""Rays coloured from recorded images: a `tracer.Tracer` over surfels as the geometry.

Where a ray hits a surfel, the place is looked up in the images about the camera, an actor's in its own box, so that it
may stand elsewhere now. An image counts where nothing hid the place from it, the more the nearer its ray came to ours.
What no image shows has the surfel's own colour; where there is no surfel, images are turned as if all
were infinitely far.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from ....data.log import Log
from ....geometry import BoolArray, FloatArray
from ....sensors.rays import Rays
from ....world.state import WorldState
from ...quality import QUALITY, Quality
from ...tracer import Array
from ..surfels.model import SurfelScene
from ..surfels.placed import NOBODY, STATIC, SurfelHits, carried
from ..surfels.tracer import SurfelBackend, SurfelTracer
from ..surfels.views import RecordedView
from .sources import SourceImage, Sources

Numbers = NDArray[np.int64]
SHARP_RAD = 0.004
"""Rays that come nearer to each other than this count alike."""
FEATHER = 0.04
"""An image counts less and less over this share of its width, towards its edges."""


class WarpBackend(SurfelBackend):
    """Surfels with the images that they were painted from, those of ``frames``; see `SurfelBackend`."""

    sees_all = True  # recorded images show actors that are elsewhere now

    def __init__(
        self, scene: SurfelScene, log: Log, frames: Sequence[int], quality: Quality = QUALITY["balanced"]
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
        """See `SurfelTracer.colours`."""
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
            bare = bare[hits.owner[bare] != NOBODY]
            for source in self.sources.farther(origin, direction, time_s) if len(bare) else ():
                self._add(total, rays, hits, bare, source, pixel_rad)
                bare = bare[total[bare, 3] == 0]
                if len(bare) == 0:
                    break
        some = total[:, 3] > 0
        painted[some] = (total[some, :3] / total[some, 3:] / 255).astype(np.float32)
        return painted, unsupported & ~some

    def _add_edited(self, total: FloatArray, rays: Rays, hits: SurfelHits, number: int, pixel_rad: float) -> None:
        """Colours of an actor on another trajectory than the recorded one, or scaled, from the images that show it
        from the same side."""
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
        """Add to sums (N, 4) of weighted colours and weights what an image shows of the chosen rays."""
        if len(chosen) == 0:
            return
        view = self.sources.view(source, self.sources.shrink(source.camera, pixel_rad), self.elsewhere)
        for owner in np.unique(hits.owner[chosen]).tolist():
            mine = chosen[hits.owner[chosen] == owner]
            if owner == NOBODY:
                self._add_beyond(total, rays, mine[total[mine, 3] == 0], view)
            elif owner == STATIC:
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
        """``ours`` are our rays' directions (N, 3) to points (N, 3), in the world as the image shows it."""
        u, v, z, distance = placed
        inside = view.inside(u, v, z)
        inside[inside] = view.sees(u[inside], v[inside], distance[inside], static)
        mine, u, v = mine[inside], u[inside], v[inside]
        centre = view.camera.world_from_camera.at(float(np.mean(view.ends())))[:3, 3]
        theirs = points[inside] - centre
        theirs /= np.maximum(np.linalg.norm(theirs, axis=1, keepdims=True), 1e-9)
        angle = np.linalg.norm(theirs - ours[inside], axis=1)
        model = view.camera.model
        edge = np.minimum(np.minimum(u, model.width - u), np.minimum(v, model.height - v)) / (FEATHER * model.width)
        weight = np.clip(edge, 1e-3, 1.0) / (SHARP_RAD + angle) ** 2
        total[mine, :3] += weight[:, None] * view.sample(u, v)
        total[mine, 3] += weight

    def _add_beyond(self, total: FloatArray, rays: Rays, mine: Numbers, view: RecordedView) -> None:
        """What lies beyond all surfels, of rays that no nearer image has shown yet."""
        first, last = (rays.directions[mine] @ view.camera.world_from_camera.at(time)[:3, :3] for time in view.ends())
        u, v, z, _ = view.place(first, last)
        inside = view.inside(u, v, np.where(z > 0, np.inf, 0.0))
        inside[inside] = view.beyond[view.cells(u[inside], v[inside])]
        total[mine[inside], :3] += view.sample(u[inside], v[inside])
        total[mine[inside], 3] += 1.0


def _rows(rays: Rays) -> Iterator[tuple[Numbers, FloatArray, FloatArray, float]]:
    """Rays in groups that share their images: numbers (M,), an origin (3,), a direction (3,), a time. All
    of one exposure."""
    if len(rays.time_s):
        middle = len(rays.time_s) // 2
        direction = rays.directions.mean(0)
        yield (
            np.arange(len(rays.time_s)),
            rays.origins[middle],
            direction / np.linalg.norm(direction),
            float(rays.time_s[middle]),
        )
