"""The renderer of a method: its scene is trained within the budget, resumed where a run was cut off; or the log's
surfels are built."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...data.log import Log
from ...model.scene_file import SceneHeader
from ...prepare.renderers import SURFEL_METHODS
from ...prepare.selection import beam_lidars
from ...render.renderer import Renderer
from ...render.tracers.surfels.build import Step, finished
from ...render.tracers.surfels.cache import build_key, surfels_of
from ...scenes.recipe import load_backend
from ...scenes.scene import OpenScenes, Scene
from ...training.config import TrainConfig
from ...training.load_or_train import load_or_train
from ...world.drive import Drive
from ..recorded import TimedRenderer
from .methods import CompareOptions, Method


@dataclass(frozen=True)
class MethodRenderer:
    """``scene`` is the trained scene's folder and ``header`` what it says of itself, None for methods without one;
    ``key`` a digest of what renders; ``about`` how it was made; ``renderer`` makes a drive's renderer."""

    scene: Path | None
    header: SceneHeader | None
    key: str
    about: dict[str, Any]
    renderer: Callable[[Drive], TimedRenderer]


def make_renderer(
    name: str, method: Method, log: Log, folder: Path, options: CompareOptions, quiet: bool
) -> MethodRenderer:
    """Train the scene in ``folder``, or build the surfels, where that is not done. Raises `UnisimError`;
    KeyboardInterrupt leaves a checkpoint."""
    if method.untrained is not None:
        return untrained_renderer(method.untrained, log, options.training_frames(log.drive), options.quality)
    header = load_or_train(log, _config(method, log, options), folder, quiet)
    seconds, steps = header.training["seconds"], header.training["iterations"]
    about, scene = {"training_s": seconds, "iterations": steps}, Scene(folder)

    def renderer(drive: Drive) -> TimedRenderer:
        backend = load_backend(scene, OpenScenes().others(drive), options.quality, options.device)
        return TimedRenderer(Renderer(backend), drive)

    return MethodRenderer(folder, header, scene.digest, about, renderer)


def _config(method: Method, log: Log, options: CompareOptions) -> TrainConfig:
    return TrainConfig(
        cameras=options.cameras, lidars=beam_lidars(log), frames=options.training_frames(log.drive),
        width=options.width,
        preset=method.preset, without=method.without, density=method.density, adversarial=method.adversarial,
        disturb=options.disturb, minutes=None if options.iterations else options.minutes, iterations=options.iterations,
        device=options.device, seed=options.seed,
    )  # fmt: skip


def untrained_renderer(name: str, log: Log, frames: tuple[int, ...], quality: str) -> MethodRenderer:
    """Return the renderer of a name in `SURFEL_METHODS`, of frames of a log. Raises `UnisimError`."""
    renderer = SURFEL_METHODS[name]
    begun = time.perf_counter()
    steps: list[Step] = []
    scene = finished(surfels_of(log, renderer.settings, frames), steps.append)
    # surfels that were kept are there at once, which says nothing of how long they took
    about = {"training_s": round(time.perf_counter() - begun, 1)} if steps else {}

    def renderer_of(drive: Drive) -> TimedRenderer:
        return TimedRenderer(Renderer(renderer.backend(scene, log, frames, quality)), drive)

    return MethodRenderer(None, None, build_key(log, renderer.settings, frames), about, renderer_of)
