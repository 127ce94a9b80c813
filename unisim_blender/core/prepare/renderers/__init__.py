"""Renderers by name. Another one is a file in this folder and a line here; one of a new training method needs neither:
it is there by its preset. Each line registers what its file makes."""

from __future__ import annotations

from ...errors import SceneError
from ...scenes.scene import Scene
from .renderer_kind import RENDERERS as RENDERERS
from .untrained import SurfelRenderer

# isort: off
from .trained import TrainedRenderer as TrainedRenderer
from .street import STREET as STREET
from .surfel import SURFEL as SURFEL
from .warp import WARP as WARP

UNTRAINED_DEFAULT = SURFEL
"""What renders a log without a trained scene where nobody names another."""


def renderer_of(scene: Scene) -> str:
    """Return the name of the renderer of a trained scene. Raises `SceneError`."""
    method = scene.header.method
    if method not in RENDERERS:
        raise SceneError(f'{scene.path}: was trained by the method "{method}", for which there is no renderer here')
    return method


def surfel_renderers() -> dict[str, SurfelRenderer]:
    """Return the renderers that take a log's surfels, by their names."""
    return {name: one for name, one in RENDERERS.items() if isinstance(one, SurfelRenderer)}
