"""Renderers of trained scenes, one a training method."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...errors import ScenarioError
from ...presets import methods
from ...render.captures import CaptureStates
from ...render.renderer import Renderer, reach_of
from ...scenes.backends import load_backend
from ...scenes.recipe import RendererRecipe, RenderMethod, register
from ...scenes.scene import Scene, mesh_digests
from ...world.drive import Drive
from ...world.replay import DriveStates


@dataclass(frozen=True)
class TrainedMethod(RenderMethod):
    """The renderer of scenes that were trained by a method, which has its name."""

    name: str
    trained = True

    @property
    def about(self) -> str:  # type: ignore[override]
        """See `RenderMethod`."""
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
        return Renderer(load_backend(recipe.scene, recipe.others, recipe.quality, recipe.device), recipe.shadows)

    def digests(self, recipe: RendererRecipe, drive: Drive) -> dict[str, str]:
        """See `RenderMethod.digests`."""
        assert recipe.scene is not None
        others = {name: scene.digest for name, scene in recipe.others.items()}
        return {"": recipe.scene.digest, **others, **mesh_digests(drive)}

    def states(self, recipe: RendererRecipe, drive: Drive) -> CaptureStates:
        """See `RenderMethod.states`."""
        assert recipe.scene is not None
        return CaptureStates(DriveStates(drive, recipe.scene.header.parked), reach_of(recipe.shadows))


for method in methods():
    register(TrainedMethod(method))
