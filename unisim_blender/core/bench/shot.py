"""One render of one sensor, and what came of it. Torch is imported where its tracer is asked for."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..data import open_log
from ..model.scene_file import read_scene_header
from ..prepare.renderers import make_backend, other_scenes
from ..prepare.replay import replayed_drive
from ..render.drive_renderer import DriveRenderer
from ..render.quality import Quality
from ..render.regions import Region
from ..render.renderer import Renderer
from ..render.tracer import Backend
from ..sensors.frames import RenderStats
from ..world.drive import Drive
from ..world.replay import DriveStates
from .copies import with_copies

CORNER, WARM_COLUMNS = Region(0, 0, 8, 8), 64
"""What is rendered first, untimed."""


@dataclass(frozen=True)
class Stage:
    """A scene's drive, or a log's where one is named; ``copies`` of an actor stand before or ``behind`` the camera's ``view``
    at ``frame``. ``tracer`` is "compiled" or "torch"."""

    scene: Path
    view: str
    frame: int
    tracer: str = "compiled"
    threads: int = 1
    log: Path | None = None
    copies: int = 0
    behind: bool = False


@dataclass(frozen=True)
class Shot:
    """A camera's image of ``width``, of which ``regions`` are kept, or a LiDAR's sweep (``width`` 0), of which every
    ``column_step``-th column is. What is not ``whole`` is rendered where it is kept, nowhere else."""

    stage: Stage
    sensor: str
    quality: Quality
    width: int = 0
    regions: tuple[Region, ...] = ()
    column_step: int = 1
    whole: bool = True


@dataclass
class Take:
    """``seconds`` are of what was rendered. ``sensor_rays`` are as many as the whole sensor has, ``rays`` as many as were traced.
    ``pieces`` are images (h, w, 3) of the regions, or one array (beams, columns)
    of depths in metres, 0 where there is none. ``peak_bytes`` is the most that this process has held so far."""

    seconds: float
    sensor_rays: int
    rays: int
    samples: int
    actors_skipped: int
    peak_bytes: int
    pieces: list[NDArray[np.float32]]


class Studio:
    """Renders shots; keeps what it has loaded."""

    def __init__(self) -> None:
        self._backends: dict[Stage, tuple[Backend, Drive]] = {}
        self._scenes: dict[Any, dict[object, Any]] = {}

    def take(self, shot: Shot) -> Take:
        """Render it. Loading a scene, and what is read from disk by the first rays of all, are not timed. Raises `SceneError`."""
        stage = shot.stage
        os.environ["OMP_NUM_THREADS"] = str(stage.threads)
        fresh = stage not in self._backends
        if fresh:
            self._backends[stage] = self._open(stage)
        backend, drive = self._backends[stage]
        if stage.tracer == "torch":
            import torch

            torch.set_num_threads(stage.threads)
        renderer = DriveRenderer(Renderer(backend), drive)
        renderer.renderer.quality = shot.quality
        if fresh:
            _rendered(renderer, replace(shot, whole=False, regions=shot.regions[:1] or (CORNER,), column_step=WARM_COLUMNS))
        return _rendered(renderer, shot)

    def _open(self, stage: Stage) -> tuple[Backend, Drive]:
        header = read_scene_header(stage.scene)
        drive = header.drive
        if stage.log is not None:
            drive = replayed_drive(header, open_log(stage.log).drive, stage.log)
        make = _torch_backend if stage.tracer == "torch" else _compiled_backend
        # a decoder keeps the threads that it was made with
        kept = self._scenes.setdefault((stage.scene, stage.tracer, stage.threads), {})
        if stage.copies:
            backend, start_s = make(stage.scene, drive, kept), drive.time_s[drive.frames[0]]
            heights = backend.bind(DriveStates(drive, backend.parked).state(start_s, start_s)).heights
            drive = with_copies(drive, heights, stage.view, stage.frame, stage.copies, stage.behind)
        return make(stage.scene, drive, kept), drive


def _compiled_backend(scene: Path, drive: Drive, kept: dict[object, Any]) -> Backend:
    return make_backend(scene, other_scenes(drive), kept=kept)


def _torch_backend(scene: Path, drive: Drive, kept: dict[object, Any]) -> Backend:
    from ..model.checkpoint import load_scene
    from ..render.tracers.torch.tracer import TorchBackend

    if scene not in kept:
        kept[scene] = load_scene(scene)
    return TorchBackend(kept[scene])


def _rendered(renderer: DriveRenderer, shot: Shot) -> Take:
    stats = RenderStats()
    begun = time.perf_counter()
    if shot.width:
        pieces, sensor_rays = _image(renderer, shot, stats)
    else:
        pieces, sensor_rays = _sweep(renderer, shot, stats)
    seconds = time.perf_counter() - begun
    return Take(seconds, sensor_rays, stats.rays, stats.samples_spent, stats.actors_skipped, peak_bytes(), pieces)


def _image(renderer: DriveRenderer, shot: Shot, stats: RenderStats) -> tuple[list[NDArray[np.float32]], int]:
    camera = renderer.sized(shot.sensor, shot.width)
    model, state = camera.model, renderer.state(camera, camera.time_s[shot.stage.frame])
    up = renderer.renderer.tracer(state).upsample
    cells = -(-model.width // up) * -(-model.height // up)
    regions = (None,) if shot.whole else shot.regions
    frames = [renderer.camera(shot.sensor, shot.stage.frame, width=shot.width, region=region) for region in regions]
    for frame in frames:
        stats.add(frame.stats)
    if not shot.whole:
        return [frame.rgb for frame in frames], cells
    return [frames[0].rgb[r.top : r.bottom, r.left : r.right].copy() for r in shot.regions], cells


def _sweep(renderer: DriveRenderer, shot: Shot, stats: RenderStats) -> tuple[list[NDArray[np.float32]], int]:
    if shot.whole:
        frame = renderer.lidar(shot.sensor, shot.stage.frame)
        stats.add(frame.stats)
        return [frame.depth_m[:, :: shot.column_step].copy()], frame.depth_m.size
    _, rays = renderer.sweep_rays(shot.sensor, shot.stage.frame)
    some = [x[:, :: shot.column_step] for x in (rays.origins, rays.directions, rays.time_s)]
    shape = some[2].shape
    depth = renderer.rays_lidar(some[0].reshape(-1, 3), some[1].reshape(-1, 3), some[2].reshape(-1), stats)[0]
    return [depth.reshape(shape)], rays.time_s.size


def peak_bytes() -> int:
    """The most memory that this process has held resident; mapped files count where they were read."""
    try:
        # getrusage would remember the process that this one was forked from
        lines = Path("/proc/self/status").read_text().splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024
    except (OSError, StopIteration):
        import resource
        import sys

        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak if sys.platform == "darwin" else peak * 1024
