"""The samples of exact streets as trained scenes simulate them: every street is recorded, learnt,
edited and rendered."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from unisim_blender.core.formats.pandaset.sensors import PANDAR64
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.prepare.replay import replayed_drive
from unisim_blender.core.render.captures import CaptureStates, render_image, render_sweep, states_of
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.scenes.recipe import load_backend
from unisim_blender.core.scenes.scene import open_scene
from unisim_blender.core.training.config import TrainConfig
from unisim_blender.core.training.load_or_train import load_or_train
from unisim_blender.core.world.captures import Capture
from unisim_street.write import write_log

from .samples import Key, Sample, sample_of
from .streets import CAMERA, StreetSet, seed_of


@dataclass(frozen=True)
class SimulatedSet:
    """``streets`` by scenes of so many training ``steps`` each, kept in the folder ``work`` with the streets' logs.
    They learn from the frames that no sample is of."""

    streets: StreetSet
    work: Path
    steps: int
    preset: str

    def sample(self, key: Key) -> Sample:
        """Render one, with what it needs where that is not there yet. Raises `UnisimError`."""
        renderer, states = _renderer(self, seed_of(key))
        image, sweep = (Capture.of_frame(s, key.frame) for s in (states.camera(CAMERA), states.lidar(PANDAR64)))
        rgb = render_image(renderer, states, image).rgb
        return sample_of(states.drive, key.frame, CAMERA, rgb, render_sweep(renderer, states, sweep))


@lru_cache(maxsize=1)  # frames come street by street
def _renderer(simulated: SimulatedSet, seed: int) -> tuple[Renderer, CaptureStates]:
    folder, street = simulated.work / f"street-{seed}", simulated.streets.street(seed)
    write_log(street, folder / "log", os.cpu_count() or 1, progress=False)
    log = open_log(folder / "log")
    scene = folder / f"scene-{simulated.preset}-{simulated.steps}"
    frames = tuple(frame for frame in log.drive.frames if frame % simulated.streets.step)
    config = TrainConfig((CAMERA,), (PANDAR64,), frames, preset=simulated.preset, iterations=simulated.steps)
    header = load_or_train(log, config, scene, quiet=True)
    renderer = Renderer(load_backend(open_scene(scene)))
    return renderer, states_of(renderer, simulated.streets.edited(street, replayed_drive(header, log)))
