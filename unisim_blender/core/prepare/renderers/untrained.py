"""Renderers that need no trained scene, but the log's surfels: ``surfel``, after LiDARsim, and ``warp``, after FVS."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from ...data.log import Log
from ...formats.readers import open_log
from ...render.captures import CaptureStates
from ...render.quality import Quality, quality_named
from ...render.renderer import Renderer, reach_of
from ...render.tracer import Backend
from ...render.tracers.surfels.build import Step, finished
from ...render.tracers.surfels.cache import build_key, surfels_of
from ...render.tracers.surfels.model import LIDARSIM, PROXY, SurfelScene, SurfelSettings
from ...render.tracers.surfels.tracer import SurfelBackend
from ...render.tracers.warping import WarpBackend
from ...scenes.recipe import RendererRecipe, RenderMethod
from ...scenes.scene import mesh_digests
from ...world.drive import Drive
from ...world.replay import DriveStates, parked_boxes

MakeBackend = Callable[[SurfelScene, Log, tuple[int, ...], Quality], Backend]


@dataclass(frozen=True)
class SurfelMethod(RenderMethod):
    """A renderer over surfels. ``settings`` are how these are made and ``make`` what traces rays, both of frames that
    may be looked at; ``sees_all`` says that a frame depends on actors outside its view, too."""

    name: str
    about: str
    settings: SurfelSettings
    make: MakeBackend
    sees_all: bool = False

    def backend(
        self, scene: SurfelScene, log: Log, frames: tuple[int, ...] | None = None, quality: str = "balanced"
    ) -> Backend:
        """Return what traces rays over a log's surfels, which were made of ``frames`` (all where None)."""
        return self.make(scene, log, log.drive.frames if frames is None else frames, quality_named(quality))

    def load(self, recipe: RendererRecipe) -> Renderer:
        """Load the log's surfels; they are made where they are not kept. Raises `UnisimError`."""
        log = open_log(recipe.log)
        scene = finished(surfels_of(log, self.settings, recipe.frames))
        return Renderer(self.backend(scene, log, recipe.frames, recipe.quality), recipe.shadows)

    def states(self, recipe: RendererRecipe, drive: Drive) -> CaptureStates:
        """See `RenderMethod.states`."""
        states = DriveStates(drive, parked_boxes(open_log(recipe.log).drive))
        return CaptureStates(states, reach_of(recipe.shadows), sees_all=self.sees_all)

    def digests(self, recipe: RendererRecipe, drive: Drive) -> dict[str, str]:
        """Return in place of a trained scene's digest that of log and settings."""
        return {"": build_key(open_log(recipe.log), self.settings, recipe.frames), **mesh_digests(drive)}

    def steps(self, recipe: RendererRecipe) -> Iterator[Step]:
        """Make the surfels, step by step, where they are not kept. Raises `UnisimError`."""
        steps = surfels_of(open_log(recipe.log), self.settings, recipe.frames)
        return (step for step in steps if isinstance(step, Step))


def _surfels(scene: SurfelScene, log: Log, frames: tuple[int, ...], quality: Quality) -> Backend:
    return SurfelBackend(scene, log.drive, quality)


def _warped(scene: SurfelScene, log: Log, frames: tuple[int, ...], quality: Quality) -> Backend:
    return WarpBackend(scene, log, frames, quality)


SURFEL = SurfelMethod("surfel", "LiDAR returns as faces", LIDARSIM, _surfels)
WARP = SurfelMethod("warp", "recorded images warped", PROXY, _warped, sees_all=True)
SURFEL_METHODS = {method.name: method for method in (SURFEL, WARP)}
"""The renderers that take a log's surfels, by their names."""
