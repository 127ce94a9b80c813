"""Renderers by name. Another one is a file in this folder and a line here; one of a new training method needs neither:
it is there by its preset. Each line registers what its file makes. Another distribution registers a renderer in its
pyproject.toml:

    [project.entry-points."unisim_blender.renderers"]
    name = "module:renderer"
"""

from __future__ import annotations

from collections.abc import Mapping

from ...errors import SceneError
from ...scenes.recipe import RENDERERS as RENDERERS
from ...scenes.recipe import RenderMethod, register
from ...scenes.scene import Scene
from .trained import TrainedMethod as TrainedMethod
from .untrained import SURFEL, WARP

for method in (SURFEL, WARP):
    register(method)

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
