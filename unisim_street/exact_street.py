"""The renderer ``street``: a procedural street as it truly is."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from unisim_blender.core.errors import LogError
from unisim_blender.core.prepare.renderers.renderer_kind import RendererSpec, Source
from unisim_blender.core.render.captures import CaptureStates
from unisim_blender.core.render.code_identity import NOT_RENDERING, code_digest
from unisim_blender.core.render.drive_renderer import DriveRenderer
from unisim_blender.core.render.quality import quality_named
from unisim_blender.core.scenes.scene import Scene, other_scenes
from unisim_blender.core.world.drive import Drive
from unisim_blender.core.world.replay import DriveStates

from .drive_street import street_of
from .renderer import WHOLE, StreetBackend, StreetRenderer
from .street import RECIPE_FILE, Street, load_street, recipe_document, street_origin

HERE = Path(__file__).parent
SAMPLES = {"fast": 1}
"""Rays along an edge of a pixel, by the quality; `RECORDED` for the others."""
RECORDED = 2
"""As many as images of logs are recorded with."""


@dataclass(frozen=True)
class StreetSource(Source):
    """Makes the renderer of a drive through the street that the log at ``log`` was recorded in."""

    log: Path
    drive: Drive
    quality: str = "balanced"
    draw: int | None = None

    def __call__(self) -> DriveRenderer:
        """Build the street, and those that actors were inserted from. Raises `UnisimError`."""
        return DriveRenderer(renderer_of_street(self._street(), self.drive, self.quality), self.drive, self.draw)

    def hashes(self) -> dict[str, str]:
        """Digests of the streets' recipes, with the code that draws streets."""
        street = self._street()
        return {"": _digest(street), **{name: _digest(other) for name, other in street.others.items()}}

    def captures(self) -> CaptureStates:
        """See `Source.captures`."""
        return CaptureStates(DriveStates(self.drive, {}), WHOLE)

    def scenes(self) -> tuple[Scene, ...]:
        """The scenes that actors were inserted from."""
        return tuple(Scene(Path(name)) for name in other_scenes(self.drive))

    def _street(self) -> Street:
        return street_of(load_street(self.log), self.drive)


def renderer_of_street(street: Street, drive: Drive, quality: str) -> StreetRenderer:
    """Return the renderer of drives through a street, in the world of ``drive``."""
    samples = SAMPLES.get(quality, RECORDED)
    return StreetRenderer(StreetBackend(street, street_origin(drive), quality_named(quality), samples))


def _digest(street: Street) -> str:
    code = code_digest(NOT_RENDERING) + code_digest(root=HERE)
    drawn = {"street": recipe_document(street.recipe), "code": code}
    return hashlib.sha256(json.dumps(drawn, sort_keys=True).encode()).hexdigest()


class ExactStreet:
    """The renderer of procedural streets alone."""

    name: ClassVar[str] = "street"
    trained: ClassVar[bool] = False
    about: ClassVar[str] = "a procedural street as it is"

    @staticmethod
    def source(spec: RendererSpec) -> StreetSource:
        """Raises `LogError` where the log is not a procedural street's, or was drawn by another engine."""
        if not (spec.log / RECIPE_FILE).is_file():
            raise LogError(
                f"{spec.log}: is no procedural street, it has no {RECIPE_FILE}: --renderer street shows streets alone"
            )
        engine = load_street(spec.log).recipe.engine
        if engine != "exact":
            raise LogError(
                f"{spec.log}: was drawn by the engine {engine}: --renderer street draws as the engine exact does"
            )
        return StreetSource(spec.log, spec.drive, spec.quality, spec.draw)
