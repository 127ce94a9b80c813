"""How long images, sweeps and training steps take, with kernels and without, interleaved."""

from __future__ import annotations

import statistics
import time
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import Any
from unittest.mock import patch

import numpy as np
import torch
from numpy.typing import NDArray

from unisim_blender.core import native
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.render.captures import render_image, render_sweep, states_of
from unisim_blender.core.render.quality import QUALITIES
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.torch.tracer import TorchBackend
from unisim_blender.core.scenes.recipe import load_backend
from unisim_blender.core.scenes.scene import open_scene
from unisim_blender.core.sensors.frames import CameraFrame
from unisim_blender.core.training.on_device import READ_EVERY, make_trainer
from unisim_blender.core.training.trainer import Trainer
from unisim_blender.core.world.captures import Capture

from .kernels import READY
from .scenes import beam_lidars, config_of, held_out, opened, peak_memory, scene_of
from .settings import CAMERA, Findings, Settings

BACKENDS = ("kernels", "torch")
IMAGES_APART = 1 / 255
"""Mean difference of two images of one scene, with and without kernels, that is too much."""
STEPS = 4
"""Steps of one measurement: every fourth updates poses and the hypernetwork."""


@contextmanager
def backend(name: str) -> Iterator[None]:
    """Work meanwhile with the kernels of the device or with plain torch."""
    with ExitStack() as stack:
        if name == "torch":
            stack.enter_context(patch(READY, lambda like: False))
            stack.enter_context(patch.object(native, "library", lambda: None))
        yield


def milliseconds(device: str, work: Callable[[], object]) -> float:
    """Return how long some work takes: by CUDA's events on a GPU, by the clock elsewhere."""
    if not device.startswith("cuda"):
        begun = time.perf_counter()
        work()
        return 1000 * (time.perf_counter() - begun)
    first, last = torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)
    torch.cuda.synchronize()
    first.record()
    work()
    last.record()
    torch.cuda.synchronize()
    return float(first.elapsed_time(last))


def interleaved(device: str, work: Callable[[], object], rounds: int, until: float, per: int = 1) -> dict[str, Any]:
    """Return each backend's median, least and number of rounds, in milliseconds a piece of ``per``; the first of
    each, which compiles kernels, does not count.

    There are fewer rounds than asked for where they would not end by ``until``, of `time.monotonic`. Where there is
    none, the first counts.
    """
    times: dict[str, list[float]] = {}
    first: dict[str, float] = {}
    for name in BACKENDS:
        if time.monotonic() < until:
            with backend(name):
                first[name] = milliseconds(device, work) / per
    for _ in range(rounds):
        last = {name: times[name][-1] if name in times else 0.0 for name in first}
        if until - time.monotonic() < per * sum(last.values()) / 1000:
            break
        for name in first:
            with backend(name):
                times.setdefault(name, []).append(milliseconds(device, work) / per)
    found: dict[str, Any] = {
        name: {
            "ms": round(statistics.median(times.get(name, [first_ms])), 3),
            "least_ms": round(min(times.get(name, [first_ms])), 3),
            "first_ms": round(first_ms, 3),
            "rounds": len(times.get(name, [])),
        }
        for name, first_ms in first.items()
    }
    if len(found) == len(BACKENDS):
        found["ratio"] = round(found["torch"]["ms"] / max(found["kernels"]["ms"], 1e-3), 3)
    return found


WIDTHS = (1280, 1920)
"""Of the images that the tracer without torch is timed by."""
IMAGES = 20


def time_tracer(settings: Settings, found: Findings, preset: str) -> None:
    """Note the times, copies included, of images and sweeps by the tracer of `unisim render`, without torch, and how far
    its image is from torch's; raise where that is too far."""
    log, frame = opened(settings), held_out(opened(settings))
    opened_scene = open_scene(scene_of(settings, preset))
    renderer = Renderer(load_backend(opened_scene, device=settings.device))
    states = states_of(renderer, opened_scene.header.drive)
    image, sweep = (
        Capture.of_frame(sensor, frame) for sensor in (states.camera(CAMERA), states.lidar(beam_lidars(log)[0]))
    )
    found.note(backend=type(renderer.backend).__name__)

    def timed(work: Callable[[], object]) -> dict[str, float]:
        work()
        times: list[float] = []
        while len(times) < IMAGES and (not times or found.left_s() > 5):
            begun = time.perf_counter()
            work()
            times.append(1000 * (time.perf_counter() - begun))
        return {"ms": statistics.median(times), "least_ms": min(times), "rounds": len(times)}

    images: dict[int, Any] = {}
    for width in WIDTHS:
        images[width] = timed(partial(render_image, renderer, states, image, width=width))
        found.note(images=images)
    found.note(sweep=timed(partial(render_sweep, renderer, states, sweep)))
    by_torch = Renderer(TorchBackend(load_scene(scene_of(settings, preset), settings.device)))
    wanted = render_image(by_torch, states_of(by_torch, opened_scene.header.drive), image)
    difference = np.abs(render_image(renderer, states, image).rgb - wanted.rgb)
    found.note(beside_torch={"mean": float(difference.mean()), "max": float(difference.max()), "bound": IMAGES_APART})
    if not difference.mean() <= IMAGES_APART:
        raise ValueError("the tracer's image is not torch's")


def waits_of(trainer: Trainer) -> list[str]:
    """Return the warnings of CUDA about steps, between two readings of the loss, that wait for the GPU."""
    for _ in range(2 * READ_EVERY):
        trainer.step()
    try:
        torch.cuda.set_sync_debug_mode("warn")
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            for _ in range(1, READ_EVERY):
                trainer.step()
    finally:
        torch.cuda.set_sync_debug_mode("default")
    return [str(warning.message) for warning in caught]


def time_scene(settings: Settings, found: Findings, preset: str) -> None:
    """Note the times of images of each quality, of sweeps and of training steps; each fails for itself."""
    log = opened(settings)
    scene, frame, device = load_scene(scene_of(settings, preset), settings.device), held_out(log), settings.device
    drive = scene.header.drive

    def image(quality: str) -> Callable[[], CameraFrame]:
        renderer = Renderer(TorchBackend(scene, QUALITIES[quality]))
        states = states_of(renderer, drive)
        return lambda: render_image(renderer, states, Capture.of_frame(states.camera(CAMERA), frame))

    def sweep(quality: str) -> Callable[[], object]:
        renderer = Renderer(TorchBackend(scene, QUALITIES[quality]))
        states = states_of(renderer, drive)
        return lambda: render_sweep(renderer, states, Capture.of_frame(states.lidar(beam_lidars(log)[0]), frame))

    def steps() -> Callable[[], object]:
        on = {"perceptual_from": 0.0, "poses_from": 0.0, "unobserved_from": 0.0, "settled_from": 0.0, "prune_from": 0}
        trainer = make_trainer(log, config_of(log, preset, settings, iterations=10_000, **on))
        if device.startswith("cuda"):
            found.note(waits=waits_of(trainer))
        return lambda: [trainer.step() for _ in range(STEPS)]

    work: list[tuple[str, Callable[[], Callable[[], object]], int]] = [("step", steps, STEPS)]
    work += [(f"image, {quality}", partial(image, quality), 1) for quality in ("balanced", "fast")]
    work += [("sweep, balanced", partial(sweep, "balanced"), 1)]
    work += [(f"image, {q}", partial(image, q), 1) for q in QUALITIES if q not in ("balanced", "fast")]
    of: dict[str, Any] = {}
    for number, (name, made, per) in enumerate(work):
        share_s = found.left_s() / (len(work) - number)
        until = time.monotonic() + share_s
        try:
            if found.left_s() < 3:
                raise TimeoutError("there was no time left")
            of[name] = interleaved(device, made(), settings.rounds, until, per)
        except Exception:  # noqa: BLE001 the other times are worth having all the same
            found.failed(name, traceback.format_exc())
        found.note(times=of, peak=peak_memory(device))
    if found.left_s() < 3:
        raise TimeoutError("there was no time left to compare images with and without kernels")
    difference = _difference(image("balanced"))
    found.note(
        kernels_beside_torch={"mean": float(difference.mean()), "max": float(difference.max()), "bound": IMAGES_APART}
    )
    if not difference.mean() <= IMAGES_APART:
        raise ValueError("images with and without kernels differ")


def _difference(image: Callable[[], CameraFrame]) -> NDArray[np.float32]:
    """Return how far apart an image's colours are with and without kernels."""
    images = []
    for name in BACKENDS:
        with backend(name):
            images.append(image().rgb)
    return np.abs(images[0] - images[1])
