"""The renderer ``warp``, after FVS: recorded images, warped over surfels."""

from __future__ import annotations

from ...data.log import Log
from ...render.quality import Quality
from ...render.tracer import Backend
from ...render.tracers.surfels.model import PROXY, SurfelScene
from ...render.tracers.warping.tracer import WarpBackend
from .renderer_kind import register
from .untrained import SurfelRenderer


def _make(scene: SurfelScene, log: Log, frames: tuple[int, ...], quality: Quality) -> Backend:
    return WarpBackend(scene, log, frames, quality)


WARP = register(SurfelRenderer("warp", "recorded images warped", PROXY, _make, sees_all=True))
