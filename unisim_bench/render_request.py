"""One render of one sensor, and its measurement. Torch is imported where its tracer is asked for."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core import cuda_driver
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.prepare.replay import aligned_log, replayed_drive
from unisim_blender.core.render.captures import CaptureStates, render_image, render_sweep, states_of
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.quality import Quality
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracer import Backend
from unisim_blender.core.scenes.recipe import TORCH, Loaded, load_backend
from unisim_blender.core.scenes.scene import OpenScenes, Scene
from unisim_blender.core.sensors.frames import RenderStats
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.simulation.rollout.setup import OpenedScenario
from unisim_blender.core.world.captures import Capture
from unisim_blender.core.world.drive import Drive
from unisim_blender.core.world.replay import DriveStates

from .settings import GPU
from .state_cost import AddedActors, StateCost, StepCost, open_bench_scenario, state_cost, step_cost, with_copies

CORNER, WARM_COLUMNS = Region(0, 0, 8, 8), 64
"""Region of an image, and step between columns of a sweep, that are rendered first, untimed."""


@dataclass(frozen=True)
class SceneSetup:
    """A scene's drive, or a log's where one is named; ``copies`` of an actor stand before or ``behind`` the camera's
    ``view`` at ``frame``. ``tracer`` is "compiled", "gpu" or "torch"."""

    scene: Path
    view: str
    frame: int
    tracer: str = "compiled"
    threads: int = 1
    log: Path | None = None
    copies: int = 0
    behind: bool = False


@dataclass(frozen=True)
class RenderRequest:
    """A camera's image of ``width``, of which ``regions`` are kept, or a LiDAR's sweep (``width`` 0), of which every
    ``column_step``-th column is. What is not ``whole`` is rendered where it is kept, nowhere else. With a
    ``added`` nothing is rendered: what its state costs is measured. With ``steps``, so many steps of the closed loop are,
    of this camera and the LiDAR ``beside``."""

    setup: SceneSetup
    sensor: str
    quality: Quality
    width: int = 0
    regions: tuple[Region, ...] = ()
    column_step: int = 1
    whole: bool = True
    added: AddedActors | None = None
    steps: int = 0
    beside: str = ""


@dataclass
class Measurement:
    """``seconds`` are of what was rendered. ``sensor_rays`` are as many as the whole sensor has, ``rays`` as many as
    were traced. ``pieces`` are images (h, w, 3) of the regions, or one array (beams, columns) of depths in metres, 0
    where there is none. ``peak_bytes`` is the most that this process has held so far, on a GPU ``gpu_bytes``.
    Of actors added there is ``state``,
    and ``seconds`` are processor time; of the closed loop there is ``step``."""

    seconds: float
    sensor_rays: int
    rays: int
    samples: int
    actors_skipped: int
    peak_bytes: int
    pieces: list[NDArray[np.float32]]
    state: StateCost | None = None
    step: StepCost | None = None
    gpu_bytes: int = 0


class RenderSession:
    """Renders requests; keeps the scenes that it has loaded."""

    def __init__(self) -> None:
        self._backends: dict[SceneSetup, tuple[Backend, Drive]] = {}
        self._opened = OpenScenes()
        self._scenes: dict[Any, Loaded] = {}
        self._simulated: dict[Any, OpenedScenario] = {}

    def render(self, request: RenderRequest) -> Measurement:
        """Render it. Loading a scene, and what is read from disk by the first rays of all, are not timed.
        Raises `SceneError`."""
        setup = request.setup
        os.environ["OMP_NUM_THREADS"] = str(setup.threads)
        if request.steps:
            return self._steps(request)
        fresh = setup not in self._backends
        if fresh:
            self._backends[setup] = self._open(setup)
        backend, drive = self._backends[setup]
        if setup.tracer == "torch":
            import torch

            torch.set_num_threads(setup.threads)
        renderer = Renderer(backend)
        renderer.quality, states = request.quality, states_of(renderer, drive)
        if fresh:
            small = replace(request, whole=False, regions=request.regions[:1] or (CORNER,), column_step=WARM_COLUMNS)
            _rendered(renderer, states, small)
        if request.added is not None:
            return _measured(renderer, states, request, request.added)
        return _rendered(renderer, states, request)

    def _steps(self, request: RenderRequest) -> Measurement:
        setup, sensors = request.setup, (request.sensor, request.beside)
        asked = setup.scene, setup.log, sensors, request.width, "cuda" if setup.tracer == GPU else "cpu"
        if asked not in self._simulated:
            self._simulated[asked] = open_bench_scenario(*asked)
        cost = step_cost(self._simulated[asked], request.quality, request.steps)
        seconds = 0.0 if cost is None else cost.step_s
        return Measurement(seconds, 0, 0, 0, 0, peak_bytes(), [], step=cost)

    def _open(self, setup: SceneSetup) -> tuple[Backend, Drive]:
        scene = self._opened.open(setup.scene)
        header = scene.header
        drive = header.drive
        if setup.log is not None:
            drive = replayed_drive(header, aligned_log(header, open_log(setup.log)))
        make = {"torch": _torch_backend, GPU: _gpu_backend}.get(setup.tracer, _compiled_backend)
        # a decoder keeps the threads that it was made with
        loaded = self._scenes.setdefault((setup.scene, setup.tracer, setup.threads), Loaded())
        if setup.copies:
            backend, start_s = make(scene, self._opened.others(drive), loaded), drive.time_s[drive.frames[0]]
            heights = backend.bind(DriveStates(drive, backend.parked).state(start_s, start_s)).heights
            drive = with_copies(drive, heights, setup.view, setup.frame, setup.copies, setup.behind)
        return make(scene, self._opened.others(drive), loaded), drive


def _compiled_backend(scene: Scene, others: Mapping[str, Scene], loaded: Loaded) -> Backend:
    return load_backend(scene, others, loaded=loaded)


def _gpu_backend(scene: Scene, others: Mapping[str, Scene], loaded: Loaded) -> Backend:
    return load_backend(scene, others, device="cuda", loaded=loaded)


def _torch_backend(scene: Scene, others: Mapping[str, Scene], loaded: Loaded) -> Backend:
    del others
    from unisim_blender.core.model.checkpoint import load_scene
    from unisim_blender.core.render.tracers.torch.tracer import TorchBackend

    key = TORCH, "cpu", scene
    if key not in loaded:
        loaded[key] = load_scene(scene.path, header=scene.header)
    return TorchBackend(loaded[key])


def _rendered(renderer: Renderer, states: CaptureStates, request: RenderRequest) -> Measurement:
    stats = RenderStats()
    begun = time.perf_counter()
    if request.width:
        pieces, sensor_rays = _image(renderer, states, request, stats)
    else:
        pieces, sensor_rays = _sweep(renderer, states, request, stats)
    seconds = time.perf_counter() - begun
    on_gpu = cuda_driver.gpu(0).peak_bytes if request.setup.tracer == GPU else 0
    return Measurement(
        seconds,
        sensor_rays,
        stats.rays,
        stats.samples_spent,
        stats.actors_skipped,
        peak_bytes(),
        pieces,
        gpu_bytes=on_gpu,
    )


def _image(
    renderer: Renderer, states: CaptureStates, request: RenderRequest, stats: RenderStats
) -> tuple[list[NDArray[np.float32]], int]:
    camera = states.camera(request.sensor, request.width)
    model, capture = camera.model, Capture.of_frame(camera, request.setup.frame)
    up = renderer.tracer(states.state(camera, capture.time_s(camera))).upsample
    cells = -(-model.width // up) * -(-model.height // up)
    regions = (None,) if request.whole else request.regions
    frames = [render_image(renderer, states, capture, width=request.width, region=region) for region in regions]
    for frame in frames:
        stats.add(frame.stats)
    if not request.whole:
        return [frame.rgb for frame in frames], cells
    return [frames[0].rgb[r.top : r.bottom, r.left : r.right].copy() for r in request.regions], cells


def _sweep(
    renderer: Renderer, states: CaptureStates, request: RenderRequest, stats: RenderStats
) -> tuple[list[NDArray[np.float32]], int]:
    lidar = states.lidar(request.sensor)
    capture = Capture.of_frame(lidar, request.setup.frame)
    if request.whole:
        frame = render_sweep(renderer, states, capture)
        stats.add(frame.stats)
        return [frame.depth_m[:, :: request.column_step].copy()], frame.depth_m.size
    rays = lidar_rays(lidar, capture.time_s(lidar))
    some = Rays(*(x[:, :: request.column_step] for x in (rays.origins, rays.directions, rays.time_s)))
    times = some.time_s[np.isfinite(some.time_s)]
    state = states.states.state(float(times.min()), float(times.max()))
    depth = renderer.beams(state, some.flat(), stats=stats)[0]
    return [depth.reshape(some.time_s.shape)], rays.time_s.size


def _measured(renderer: Renderer, states: CaptureStates, request: RenderRequest, added: AddedActors) -> Measurement:
    sensor = states.camera(request.sensor, request.width) if request.width else states.lidar(request.sensor)
    cost = state_cost(renderer, states.drive, sensor, request.setup.frame, added)
    skipped = cost.actors - cost.in_reach
    return Measurement(sum(cost.steps_s.values()), cost.rays, cost.rays, 0, skipped, peak_bytes(), [], cost)


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
