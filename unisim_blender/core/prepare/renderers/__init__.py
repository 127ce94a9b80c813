"""Renderers by name. Another one is a file in this folder and a line here; one of a new training method needs neither:
it is there by its preset. Each line registers what its file makes. Another distribution registers a renderer in its
pyproject.toml:

    [project.entry-points."unisim_blender.renderers"]
    name = "module:renderer"
"""

from __future__ import annotations

from functools import cache

from ...errors import SceneError
from ...plugins import load_installed
from ...scenes.scene import Scene
from .renderer_kind import RENDERERS as RENDERERS
from .renderer_kind import RendererKind
from .untrained import SurfelRenderer

# isort: off
from .trained import TrainedRenderer as TrainedRenderer
from .surfel import SURFEL as SURFEL
from .warp import WARP as WARP

GROUP = "unisim_blender.renderers"
UNTRAINED_DEFAULT = SURFEL
"""What renders a log without a trained scene where nobody names another."""


@cache
def installed() -> tuple[RendererKind, ...]:
    """Return the renderers of other packages. Those that cannot be loaded are left out, with a warning each."""
    return load_installed(GROUP, "renderer", RENDERERS, ("name", "trained", "about", "source"))


def all_renderers() -> dict[str, RendererKind]:
    """Return the renderers by their names, the package's own first."""
    return {**RENDERERS, **{renderer.name: renderer for renderer in installed()}}


def renderer_of(scene: Scene) -> str:
    """Return the name of the renderer of a trained scene. Raises `SceneError`."""
    method = scene.header.method
    if method not in all_renderers():
        raise SceneError(f'{scene.path}: was trained by the method "{method}", for which there is no renderer here')
    return method


def surfel_renderers() -> dict[str, SurfelRenderer]:
    """Return the renderers that take a log's surfels, by their names."""
    return {name: one for name, one in RENDERERS.items() if isinstance(one, SurfelRenderer)}
