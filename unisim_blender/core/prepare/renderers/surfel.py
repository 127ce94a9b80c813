"""The renderer ``surfel``, after LiDARsim: LiDAR returns as faces."""

from __future__ import annotations

from ...data.log import Log
from ...render.quality import Quality
from ...render.tracer import Backend
from ...render.tracers.surfels.model import LIDARSIM, SurfelScene
from ...render.tracers.surfels.tracer import SurfelBackend
from .renderer_kind import register
from .untrained import SurfelRenderer


def _make(scene: SurfelScene, log: Log, frames: tuple[int, ...], quality: Quality) -> Backend:
    return SurfelBackend(scene, log.drive, quality)


SURFEL = register(SurfelRenderer("surfel", "LiDAR returns as faces", LIDARSIM, _make))
