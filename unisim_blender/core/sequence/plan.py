"""The plan of a sequence: drive, moments, settings, and what decides whether finished captures are still up to date."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..render.captures import CaptureStates
from ..scenes.recipe import RendererRecipe
from ..world.captures import Moment
from ..world.drive import Drive


@dataclass(frozen=True)
class SequenceSettings:
    """How captures are rendered. Which captures those are is not part of it, because it changes no
    capture's content."""

    cameras: tuple[str, ...]
    lidars: tuple[str, ...]
    passes: tuple[str, ...] = ("rgb",)
    formats: tuple[str, ...] = ("png", "exr", "ply", "npz", "labels")
    width: int | None = None
    quality: str = "balanced"
    device: str = "cpu"
    draw: int | None = None
    """Seed of the draw that decides which beams return; None takes those with a probability of half or more."""
    contact_shadows: bool = False
    max_error: tuple[str, ...] = ()
    """Error bounds that every frame must keep; ``quality`` then holds for sensors without a bound."""
    renderer: str = "neural"


@dataclass(frozen=True)
class RenderPlan:
    """A sequence to render: the ``moments`` of a drive.

    recipe: makes the renderer, once in every process.
    scenes: hashes of trained scenes and meshes by their names in `Appearance` ("" is the drive's own scene).
    environment: machine, instruction set, versions of the libraries that compute. With ``scenes``, ``settings`` and the
    state of the world it decides whether a capture is up to date. captures: gives the state of the world that a capture
    depends on. about: further entries of the manifest: names and hashes, no paths, so that the manifest does not depend
    on where files lie.
    """

    drive: Drive
    moments: tuple[Moment, ...]
    settings: SequenceSettings
    recipe: RendererRecipe
    scenes: dict[str, str]
    environment: dict[str, str]
    about: dict[str, Any]
    captures: CaptureStates

    @property
    def frames(self) -> tuple[int, ...]:
        """Numbers of the moments that are frames of the log."""
        return tuple(moment.frame for moment in self.moments if moment.frame is not None)

    def moment_of_frame(self, frame: int) -> Moment:
        """Return the moment of a frame of the log, whether it is part of the plan or not."""
        return Moment.of_frame(self.drive, frame, self.settings.cameras, self.settings.lidars)
