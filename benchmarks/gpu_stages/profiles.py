"""What training steps and an image spend their time on, by torch's profiler."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

from torch.profiler import ProfilerActivity
from torch.profiler import profile as torch_profile

from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.render.captures import render_image, states_of
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.torch.tracer import TorchBackend
from unisim_blender.core.training.on_device import make_trainer
from unisim_blender.core.world.captures import Capture

from .scenes import config_of, held_out, opened, peak_memory, scene_of
from .settings import CAMERA, Findings, Settings

TOP = 25
TRACE_BYTES = 15_000_000
TRACE_S = 20.0
"""So long a trace may take to be written."""
STEPS = 2


def profiled(device: str, work: Callable[[], object], trace: Path, found: Findings, name: str) -> None:
    """Note the operations that took the most time, in milliseconds; where time is left, keep Chrome's trace,
    compressed, if it is small."""
    on_gpu = device.startswith("cuda")
    work()
    begun = time.perf_counter()
    with torch_profile(activities=[ProfilerActivity.CPU, *([ProfilerActivity.CUDA] if on_gpu else [])]) as measured:
        work()
    whole_ms = 1000 * (time.perf_counter() - begun)

    def own_us(row: Any) -> float:
        return float(row.self_device_time_total if on_gpu else row.self_cpu_time_total)

    rows = sorted(measured.key_averages(), key=own_us, reverse=True)
    operations = [
        {
            "name": row.key[:160], "calls": row.count, "own_ms": round(own_us(row) / 1000, 3),
            "own_cpu_ms": round(row.self_cpu_time_total / 1000, 3),
        }
        for row in rows[:TOP]
    ]  # fmt: skip
    own_ms = sum(own_us(row) for row in rows) / 1000
    told = {
        "profiled_ms": round(whole_ms, 1), "own_ms_in_all": round(own_ms, 1), "calls": sum(row.count for row in rows),
        "operations": operations, "trace": None,
    }  # fmt: skip
    found.note(**{name: told})
    if found.left_s() < TRACE_S:
        return
    measured.export_chrome_trace(str(trace))
    if trace.stat().st_size <= TRACE_BYTES:
        found.note(**{name: {**told, "trace": trace.name}})
    else:
        trace.unlink()


def profile_scene(settings: Settings, found: Findings, preset: str) -> None:
    """Note what two training steps and one image spend their time on; each fails for itself."""
    log, out = opened(settings), Path(settings.out)

    def steps() -> Callable[[], object]:
        trainer = make_trainer(
            log, config_of(log, preset, settings, iterations=10_000, poses_from=0.0, unobserved_from=0.0)
        )
        return lambda: [trainer.step() for _ in range(STEPS)]

    def image() -> Callable[[], object]:
        scene = load_scene(scene_of(settings, preset), settings.device)
        renderer = Renderer(TorchBackend(scene))
        states = states_of(renderer, scene.header.drive)
        return lambda: render_image(renderer, states, Capture.of_frame(states.camera(CAMERA), held_out(log)))

    for name, made in (("steps", steps), ("image", image)):
        try:
            if found.left_s() < 5:
                raise TimeoutError("there was no time left")
            profiled(settings.device, made(), out / f"trace_{preset}_{name}.json.gz", found, name)
        except Exception:  # noqa: BLE001 the other profile is worth having all the same
            found.failed(name, traceback.format_exc())
    found.note(peak=peak_memory(settings.device))
