"""Renderers by name. Another one is a file in this folder and a line here; one of a new training method needs neither:
it is there by its preset. Each line registers what its file makes. Another distribution registers a renderer in its
pyproject.toml:

    [project.entry-points."unisim_blender.renderers"]
    name = "module:renderer"
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache

from ...errors import SceneError
from ...plugins import load_installed
from ...scenes.recipe import RENDERERS as RENDERERS
from ...scenes.recipe import RenderMethod, register
from ...scenes.scene import Scene
from .trained import TrainedMethod as TrainedMethod
from .untrained import SURFEL, WARP

for method in (SURFEL, WARP):
    register(method)

GROUP = "unisim_blender.renderers"
UNTRAINED_DEFAULT = SURFEL
"""What renders a log without a trained scene where nobody names another."""


@cache
def installed() -> tuple[RenderMethod, ...]:
    """Return the renderers of other packages. Those that cannot be loaded are left out, with a warning each."""
    return load_installed(GROUP, "renderer", RENDERERS, ("name", "trained", "about", "load", "digests", "states"))


def all_renderers() -> dict[str, RenderMethod]:
    """Return the renderers by their names, the package's own first."""
    return {**RENDERERS, **{renderer.name: renderer for renderer in installed()}}


def renderers_with(name: str) -> Mapping[str, RenderMethod]:
    """Return renderers by their names, other packages' only where the package's own have not this one."""
    return RENDERERS if name in RENDERERS else all_renderers()


def renderer_of(scene: Scene) -> str:
    """Return the name of the renderer of a trained scene. Raises `SceneError`."""
    method = scene.header.method
    if method not in renderers_with(method):
        raise SceneError(f'{scene.path}: was trained by the method "{method}", for which there is no renderer here')
    return method
