"""Renderers by name: trained scenes by their training method, surfels and warped images.

A new training method needs no entry: its renderer is registered by its preset. Another distribution registers a
renderer in its pyproject.toml:

    [project.entry-points."unisim_blender.renderers"]
    name = "module:renderer"
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from ..data.log import Log
from ..errors import ScenarioError, SceneError
from ..formats.readers import open_log
from ..presets import methods
from ..render.captures import CaptureStates
from ..render.fixers import FIXERS, RecordedFixer, fixer_named
from ..render.learned_fixer import LearnedFixer
from ..render.observed_space import Observing
from ..render.quality import Quality, quality_named
from ..render.recorded_detail import RecordedDetail
from ..render.renderer import Renderer, reach_of
from ..render.traced_planes import plane_fill, trace_planes
from ..render.tracer import Backend
from ..render.tracers.surfels.build import Step, finished
from ..render.tracers.surfels.cache import build_key, surfels_of
from ..render.tracers.surfels.model import LIDARSIM, PROXY, SurfelScene, SurfelSettings
from ..render.tracers.surfels.tracer import SurfelBackend
from ..render.tracers.warping import WarpBackend
from ..scenes.recipe import RENDERERS as RENDERERS
from ..scenes.recipe import RendererRecipe, RenderMethod, load_backend, register
from ..scenes.scene import Scene, mesh_digests
from ..world.drive import Drive
from ..world.replay import DriveStates, parked_boxes

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


@dataclass(frozen=True)
class TrainedMethod(RenderMethod):
    """The renderer of scenes that were trained by a method, which has its name."""

    name: str
    trained = True

    @property
    def about(self) -> str:  # type: ignore[override]
        return f"a scene trained as {self.name}"

    def check_inputs(self, log: Path, scene: Scene | None) -> None:
        """Raises `ScenarioError` where there is no trained scene, or one of another method."""
        if scene is None:
            raise ScenarioError(f'{log}: has no trained scene to render with; train one with "unisim train"')
        if (method := scene.header.method) != self.name:
            raise ScenarioError(f'{scene.path}: was trained by the method "{method}", not by "{self.name}"')

    def load(self, recipe: RendererRecipe) -> Renderer:
        """Load the scene and those that actors were inserted from. Raises `SceneError`."""
        assert recipe.scene is not None
        backend = load_backend(recipe.scene, recipe.others, recipe.quality, recipe.device)
        if not isinstance(backend, Observing):
            return Renderer(backend, recipe.shadows)
        fill = fixer = detail = None
        if recipe.is_filled:
            fill = plane_fill(backend)
        if fixer_named(recipe.fill) is not None:
            fixer = RecordedFixer(recipe.fill, open_log(recipe.log), recipe.scene.header.drive.cameras)
        if recipe.detail:
            detail = detail_of(backend, recipe.scene, open_log(recipe.log))
        return Renderer(backend, recipe.shadows, fill=fill, fixer=fixer, detail=detail)

    def steps(self, recipe: RendererRecipe) -> Iterator[Step]:
        """Trace and fill ground and façades, step by step, where these are not kept and asked for. Raises `SceneError`."""
        if recipe.is_filled and recipe.scene is not None:
            backend = load_backend(recipe.scene, {}, recipe.quality, recipe.device)
            assert isinstance(backend, Observing)
            for step in trace_planes(backend):
                if isinstance(step, float):
                    yield Step("Filling the ground", step)

    def digests(self, recipe: RendererRecipe, drive: Drive) -> dict[str, str]:
        assert recipe.scene is not None
        others = {name: scene.digest for name, scene in recipe.others.items()}
        return {"": recipe.scene.digest, **others, **mesh_digests(drive)}

    def states(self, recipe: RendererRecipe, drive: Drive) -> CaptureStates:
        assert recipe.scene is not None
        reach = reach_of(recipe.shadows or recipe.is_filled)
        return CaptureStates(DriveStates(drive, recipe.scene.header.parked), reach)


def detail_of(backend: Backend, scene: Scene, log: Log) -> RecordedDetail:
    """Return the detail of a log's images that a trained scene, which the backend renders, lacks."""
    return RecordedDetail(Renderer(backend), scene.header.drive, scene.header.training, log)


for method in (SURFEL, WARP, *(TrainedMethod(name) for name in methods())):
    register(method)
FIXERS.register(LearnedFixer())

UNTRAINED_DEFAULT = SURFEL
"""Default method for rendering a log without a trained scene."""


def renderers_with(name: str) -> Mapping[str, RenderMethod]:
    """Return renderers by their names, other packages' only where the package's own have not this one."""
    return RENDERERS if name in RENDERERS else RENDERERS.with_plugins()


def renderer_of(scene: Scene) -> str:
    """Return the name of the renderer of a trained scene. Raises `SceneError`."""
    method = scene.header.method
    if method not in renderers_with(method):
        raise SceneError(f'{scene.path}: was trained by the method "{method}", for which there is no renderer here')
    return method
