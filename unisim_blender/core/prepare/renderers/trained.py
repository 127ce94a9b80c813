"""Renderers of trained scenes, one a method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

from ...errors import ScenarioError
from ...presets import methods
from ...render.bounded import BoundedRenderer
from ...render.captures import CaptureStates
from ...render.drive_renderer import DriveRenderer
from ...render.renderer import Renderer, reach_of
from ...scenes.backends import load_backend
from ...scenes.scene import Scene, mesh_digests
from ...sensors.error_bound import ErrorBound
from ...world.drive import Drive
from ...world.replay import DriveStates
from ..capabilities import capability_warnings
from .renderer_kind import Maker, RendererSpec, Source, register


@dataclass(frozen=True)
class SceneSource(Source):
    """Makes the renderer of a drive by a trained scene."""

    scene: Scene
    others: Mapping[str, Scene]
    drive: Drive
    quality: str = "balanced"
    device: str = "cpu"
    draw: int | None = None
    shadows: bool = False

    def __call__(self) -> DriveRenderer:
        """Load the scene and those that actors were inserted from. Raises `SceneError`."""
        backend = load_backend(self.scene, self.others, self.quality, self.device)
        return DriveRenderer(Renderer(backend, self.shadows), self.drive, self.draw)

    def hashes(self) -> dict[str, str]:
        """See `Source.hashes`."""
        others = {name: scene.digest for name, scene in self.others.items()}
        return {"": self.scene.digest, **others, **mesh_digests(self.drive)}

    def captures(self) -> CaptureStates:
        """See `Source.captures`."""
        return CaptureStates(DriveStates(self.drive, self.scene.header.parked), reach_of(self.shadows))

    def scenes(self) -> tuple[Scene, ...]:
        """Its own scene, and those that actors were inserted from."""
        return self.scene, *self.others.values()

    def warnings(self, recorded: Drive, sweeps: bool) -> list[str]:
        """See `capability_warnings`."""
        return capability_warnings(self.scene, recorded, self.drive, sweeps)

    def bounded(self, bounds: tuple[ErrorBound, ...]) -> BoundedSource:
        """See `Source.bounded`."""
        return BoundedSource(self, bounds)


@dataclass(frozen=True)
class BoundedSource(Maker):
    """The same of a renderer whose error is bounded."""

    source: SceneSource
    bounds: tuple[ErrorBound, ...]

    def __call__(self) -> BoundedRenderer:
        """Load what the source loads. Raises `SceneError`."""
        return BoundedRenderer(self.source(), self.bounds)


@dataclass(frozen=True)
class TrainedRenderer:
    """The renderer of scenes that were trained by a method, which has its name."""

    name: str
    trained: ClassVar[bool] = True

    @property
    def about(self) -> str:
        """See `RendererKind.about`."""
        return f"a scene trained as {self.name}"

    def source(self, spec: RendererSpec) -> SceneSource:
        """Raises `ScenarioError` where there is no trained scene, or one of another method."""
        if spec.scene is None:
            raise ScenarioError(f'{spec.log}: has no trained scene to render with; train one with "unisim train"')
        if (method := spec.scene.header.method) != self.name:
            raise ScenarioError(f'{spec.scene.path}: was trained by the method "{method}", not by "{self.name}"')
        return SceneSource(spec.scene, spec.others, spec.drive, spec.quality, spec.device, spec.draw, spec.shadows)


for method in methods():
    register(TrainedRenderer(method))
