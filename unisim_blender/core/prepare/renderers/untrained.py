"""Renderers that need no trained scene, but the log's surfels."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from ...data.log import Log
from ...formats.readers import open_log
from ...render.captures import CaptureStates
from ...render.drive_renderer import DriveRenderer
from ...render.quality import Quality, quality_named
from ...render.renderer import Renderer, reach_of
from ...render.tracer import Backend
from ...render.tracers.surfels.build import Step, finished
from ...render.tracers.surfels.cache import build_key, surfels_of
from ...render.tracers.surfels.model import SurfelScene, SurfelSettings
from ...scenes.scene import mesh_digests
from ...world.drive import Drive
from ...world.replay import DriveStates, parked_boxes
from .renderer_kind import RendererSpec, Source

MakeBackend = Callable[[SurfelScene, Log, tuple[int, ...], Quality], Backend]


@dataclass(frozen=True)
class SurfelRenderer:
    """A renderer over surfels. ``settings`` are how these are made and ``make`` what traces rays, both of frames that
    may be looked at; ``sees_all`` says that a frame depends on actors outside its view, too."""

    name: str
    about: str
    settings: SurfelSettings
    make: MakeBackend
    sees_all: bool = False
    trained: ClassVar[bool] = False

    def source(self, spec: RendererSpec) -> LogSource:
        """Return what makes the renderer from the log."""
        return LogSource(self, spec.log, spec.drive, spec.frames, spec.quality, spec.draw, spec.shadows)

    def backend(
        self, scene: SurfelScene, log: Log, frames: tuple[int, ...] | None = None, quality: str = "balanced"
    ) -> Backend:
        """Return what traces rays over a log's surfels, which were made of ``frames`` (all where None)."""
        return self.make(scene, log, log.drive.frames if frames is None else frames, quality_named(quality))


@dataclass(frozen=True)
class LogSource(Source):
    """Makes an untrained renderer of a drive, from the log that it was recorded in. ``frames`` are those whose sweeps
    and images may be looked at; all where None."""

    renderer: SurfelRenderer
    log: Path
    drive: Drive
    frames: tuple[int, ...] | None = None
    quality: str = "balanced"
    draw: int | None = None
    shadows: bool = False

    def __call__(self) -> DriveRenderer:
        """Load the log's surfels; they are made where they are not kept. Raises `UnisimError`."""
        log = open_log(self.log)
        scene = finished(surfels_of(log, self.renderer.settings, self.frames))
        backend = self.renderer.backend(scene, log, self.frames, self.quality)
        return DriveRenderer(Renderer(backend, self.shadows), self.drive, self.draw)

    def captures(self) -> CaptureStates:
        """See `Source.captures`."""
        states = DriveStates(self.drive, parked_boxes(open_log(self.log).drive))
        return CaptureStates(states, reach_of(self.shadows), sees_all=self.renderer.sees_all)

    def hashes(self) -> dict[str, str]:
        """What stands for a trained scene's digest is that of log and settings."""
        return {"": build_key(open_log(self.log), self.renderer.settings, self.frames), **mesh_digests(self.drive)}

    def steps(self) -> Iterator[Step]:
        """Make the surfels, step by step, where they are not kept. Raises `UnisimError`."""
        steps = surfels_of(open_log(self.log), self.renderer.settings, self.frames)
        return (step for step in steps if isinstance(step, Step))
