"""The renderer ``street``: a procedural street as it truly is."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from unisim_blender.core.errors import LogError
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.render.captures import CaptureStates
from unisim_blender.core.render.code_identity import NOT_RENDERING, code_digest
from unisim_blender.core.render.quality import quality_named
from unisim_blender.core.scenes.recipe import RendererRecipe, RenderMethod
from unisim_blender.core.scenes.scene import Scene
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


class StreetMethod(RenderMethod):
    """The renderer of procedural streets alone, and of those that actors were inserted from."""

    name = "street"
    about = "a procedural street as it is"

    def check_inputs(self, log: Path, scene: Scene | None) -> None:
        """Raises `LogError` where the log is not a procedural street's, or was drawn by another engine."""
        if not (log / RECIPE_FILE).is_file():
            raise LogError(
                f"{log}: is no procedural street, it has no {RECIPE_FILE}: --renderer street shows streets alone"
            )
        engine = load_street(log).recipe.engine
        if engine != "exact":
            raise LogError(f"{log}: was drawn by the engine {engine}: --renderer street draws as the engine exact does")

    def load(self, recipe: RendererRecipe) -> StreetRenderer:
        """Build the street, and those that actors were inserted from. Raises `UnisimError`."""
        return renderer_of_street(_street(recipe), recipe.world_origin, recipe.quality)

    def digests(self, recipe: RendererRecipe, drive: Drive) -> dict[str, str]:
        """Return digests of the streets' recipes, with the code that draws streets."""
        street = _street(recipe)
        return {"": _digest(street), **{name: _digest(other) for name, other in street.others.items()}}

    def states(self, recipe: RendererRecipe, drive: Drive) -> CaptureStates:
        """See `RenderMethod.states`."""
        return CaptureStates(DriveStates(drive, {}), WHOLE)


def _street(recipe: RendererRecipe) -> Street:
    return street_of(load_street(recipe.log), recipe.others)


def renderer_of_street(street: Street, world_origin: FloatArray, quality: str) -> StreetRenderer:
    """Return the renderer of drives through a street, in a world with this origin."""
    samples = SAMPLES.get(quality, RECORDED)
    return StreetRenderer(StreetBackend(street, street_origin(world_origin), quality_named(quality), samples))


def _digest(street: Street) -> str:
    code = code_digest(NOT_RENDERING) + code_digest(root=HERE)
    drawn = {"street": recipe_document(street.recipe), "code": code}
    return hashlib.sha256(json.dumps(drawn, sort_keys=True).encode()).hexdigest()


STREET = StreetMethod()
