"""A method's renderer: its scene trained within the budget, gone on with where it was cut off; or a
log's surfels made."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..data.log import Log
from ..model.files.scene_file import SceneHeader
from ..prepare.renderers import surfel_renderers
from ..prepare.renderers.trained import SceneSource
from ..prepare.scenes import scene_hash
from ..prepare.selection import beam_lidars
from ..render.drive_renderer import DriveRenderer
from ..render.renderer import Renderer
from ..render.tracers.surfels.build import Step, finished
from ..render.tracers.surfels.cache import build_key, surfels_of
from ..training.config import TrainConfig
from ..training.load_or_train import load_or_train
from ..world.drive import Drive
from .methods import Method
from .options import CompareOptions


@dataclass(frozen=True)
class Made:
    """``scene`` is the trained scene's folder and ``header`` what it says of itself, None for methods without one;
    ``key`` a digest of what renders; ``about`` how it was made; ``renderer`` makes a drive's renderer."""

    scene: Path | None
    header: SceneHeader | None
    key: str
    about: dict[str, Any]
    renderer: Callable[[Drive], DriveRenderer]


def make(name: str, method: Method, log: Log, folder: Path, options: CompareOptions, quiet: bool) -> Made:
    """Train the scene in ``folder``, or make the surfels, where that is not done. Raises `UnisimError`;
    KeyboardInterrupt leaves a checkpoint."""
    if method.untrained is not None:
        return _untrained(method.untrained, log, options)
    header = load_or_train(log, _config(method, log, options), folder, quiet)
    seconds, steps = header.training["seconds"], header.training["iterations"]
    about = {"training_s": seconds, "iterations": steps}

    def renderer(drive: Drive) -> DriveRenderer:
        return SceneSource(folder, drive, options.quality, options.device)()

    return Made(folder, header, scene_hash(folder), about, renderer)


def _config(method: Method, log: Log, options: CompareOptions) -> TrainConfig:
    return TrainConfig(
        cameras=options.cameras, lidars=beam_lidars(log), frames=options.training_frames(log.drive),
        width=options.width,
        preset=method.preset, without=method.without, density=method.density, adversarial=method.adversarial,
        disturb=options.disturb, minutes=None if options.iterations else options.minutes, iterations=options.iterations,
        device=options.device, seed=options.seed,
    )  # fmt: skip


def _untrained(name: str, log: Log, options: CompareOptions) -> Made:
    renderer, frames = surfel_renderers()[name], options.training_frames(log.drive)
    begun = time.perf_counter()
    steps: list[Step] = []
    scene = finished(surfels_of(log, renderer.settings, frames), steps.append)
    # surfels that were kept are there at once, which says nothing of how long they took
    about = {"training_s": round(time.perf_counter() - begun, 1)} if steps else {}

    def make_renderer(drive: Drive) -> DriveRenderer:
        return DriveRenderer(Renderer(renderer.backend(scene, log, frames, options.quality)), drive)

    return Made(None, None, build_key(log, renderer.settings, frames), about, make_renderer)
