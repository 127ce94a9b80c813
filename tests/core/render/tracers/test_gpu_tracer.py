"""Rays traced through CUDA's driver: memory, launches and results, by a driver whose GPU is the CPU."""

from __future__ import annotations

import ctypes
import dataclasses
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analytic_scene import still
from random_scene import CONFIGS, PASSES, TINY, edited, image_rays, saved
from render.tracers.test_compiled_tracer import bits, needs_library, same_find, sweep_rays
from whole_drive import bound_to

from unisim_blender.core import cuda_driver
from unisim_blender.core.cuda_driver import GpuMemory, GpuMemoryError
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.meshes.hits import MeshHits
from unisim_blender.core.render.quality import QUALITIES
from unisim_blender.core.render.tracers.compiled import gpu
from unisim_blender.core.render.tracers.compiled.gpu import GpuBackend, GpuScene, TraceInputsStruct
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.scenes.recipe import backend_name, environment, pick_device
from unisim_blender.core.sensors.frames import RenderStats
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.world.drive import Appearance

SOURCE = Path(__file__).parents[3] / "support" / "cuda_driver_on_cpu.cpp"
pytestmark = [needs_library, pytest.mark.skipif(shutil.which("g++") is None, reason="the driver is compiled by g++")]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    library = tmp_path_factory.mktemp("driver") / "libcuda.so.1"
    flags = ["-std=c++17", "-O2", "-shared", "-fPIC", "-fvisibility=hidden"]
    subprocess.run(["g++", *flags, "-o", str(library), str(SOURCE)], check=True)
    return library


@pytest.fixture
def driver(built: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ctypes.CDLL]:
    """A driver that finds a GPU; what a test allocates is freed at its end."""
    caches = cuda_driver.driver, cuda_driver.gpu
    kernels = built.parent / "kernels.fatbin"
    kernels.write_bytes(b"of another compiler")
    monkeypatch.setattr(cuda_driver, "LIBRARY", str(built))
    monkeypatch.setattr(cuda_driver, "KERNELS", kernels)
    for cache in caches:
        cache.cache_clear()
    library = cuda_driver.driver()
    assert library is not None
    library.limit_memory.argtypes, library.memory_in_use.restype = [ctypes.c_size_t], ctypes.c_size_t
    library.limit_memory(1 << 32)
    yield library
    for cache in caches:
        cache.cache_clear()


def both(folder: Path, quality: str = "balanced", other: Path | None = None) -> tuple[GpuBackend, CompiledBackend]:
    others = {} if other is None else {"other": CompiledScene(other)}
    scene, device = CompiledScene(folder), cuda_driver.gpu()
    on_gpu = {name: GpuScene(each, device) for name, each in others.items()}
    return (
        GpuBackend(GpuScene(scene, device), QUALITIES[quality], on_gpu),
        CompiledBackend(scene, QUALITIES[quality], others),
    )


@pytest.mark.parametrize("name", CONFIGS)
@pytest.mark.parametrize("quality", ("balanced", "reference"))
def test_beside_the_compiled_tracer(driver: ctypes.CDLL, tmp_path: Path, name: str, quality: str) -> None:
    drive = edited()
    fast, slow = (bound_to(backend, drive) for backend in both(saved(tmp_path / "scene", CONFIGS[name]), quality))
    for rays, sky in ((image_rays(drive), True), (sweep_rays(drive), False)):
        stats = RenderStats(), RenderStats()
        traced = [tracer.trace(rays, PASSES, sky, None, of) for tracer, of in zip((fast, slow), stats, strict=True)]
        same_find(traced[0], traced[1], rays.time_s.shape)
        assert stats[0].rays == stats[1].rays and stats[0].actors_skipped == stats[1].actors_skipped
        assert abs(stats[0].samples_spent - stats[1].samples_spent) <= 1e-3 * stats[1].samples_spent + 2


@pytest.mark.parametrize("meshes", (False, True))
def test_foreign_actors_and_meshes(
    driver: ctypes.CDLL, tmp_path: Path, meshes: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = edited()
    foreign = still("guest", (-15, 0, 1.5), (3, 3, 3), yaw=0.3, appearance=Appearance("car", "other"))
    drive = dataclasses.replace(drive, actors={**drive.actors, "guest": foreign})
    wide = dataclasses.replace(TINY, features=7, upsample=1)
    backends = both(saved(tmp_path / "scene", TINY), other=saved(tmp_path / "other", wide, seed=1))
    fast, slow = (bound_to(backend, drive) for backend in backends)
    rays, hits = image_rays(drive), None
    if meshes:
        rng = np.random.default_rng(0)
        ray = np.sort(rng.choice(rays.time_s.size, 200, replace=False))
        up = np.tile([0.0, 0, 1], (200, 1))
        hits = MeshHits(ray, rng.uniform(3, 15, 200), rng.uniform(0.2, 1, 200), up, rng.integers(0, 2, 200))
    monkeypatch.setattr("unisim_blender.core.render.tracers.compiled.tracer.CHUNK_RAYS", 150)
    traced: list[Any] = [tracer.trace(rays, PASSES, True, hits, RenderStats()) for tracer in (fast, slow)]
    assert traced[1].foreign_opacity[0].max() > 0.3
    same_find(traced[0], traced[1], rays.time_s.shape)


def test_rays_without_room_and_memory_that_is_short(
    driver: ctypes.CDLL, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = edited()
    backend, _ = both(saved(tmp_path / "scene", TINY))
    tracer, rays = bound_to(backend, drive), image_rays(drive)
    whole = bits(tracer.trace(rays, PASSES, True, None, RenderStats()))
    in_use = driver.memory_in_use()
    launched: list[int] = []
    launch = cuda_driver.Gpu.launch

    def noted(self: cuda_driver.Gpu, name: str, threads: int, *more: Any) -> None:
        launched.append(threads)
        launch(self, name, threads, *more)

    monkeypatch.setattr(cuda_driver.Gpu, "launch", noted)
    driver.limit_memory(in_use + 2_000_000)  # less than the room of all rays at once
    for samples, segments in ((gpu.SAMPLES, gpu.SEGMENTS), (2, 1)):
        monkeypatch.setattr(gpu, "SAMPLES", samples)
        monkeypatch.setattr(gpu, "SEGMENTS", segments)
        for name, values in bits(tracer.trace(rays, PASSES, True, None, RenderStats())).items():
            assert np.array_equal(values, whole[name], equal_nan=True), name
        assert driver.memory_in_use() == in_use
    assert launched[0] < rays.time_s.size and len(launched) > 5
    driver.limit_memory(in_use + 1000)
    with pytest.raises(GpuMemoryError, match="out of memory"):
        tracer.trace(rays, PASSES, True, None, RenderStats())
    assert driver.memory_in_use() == in_use
    del tracer, backend
    assert driver.memory_in_use() == 0


def test_any_number_of_rays_and_clipped_views(driver: ctypes.CDLL, tmp_path: Path) -> None:
    drive = edited()
    backend, expected = both(saved(tmp_path / "scene", TINY))
    tracer = bound_to(backend, drive)
    none = Rays(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
    assert len(tracer.trace(none, PASSES, True, None, RenderStats()).feature) == 0
    tracers = [bound_to(each, drive) for each in (backend, expected)]
    for each in tracers:
        each.clipped = True
    rays = image_rays(drive)
    traced = [each.trace(rays, PASSES, True, None, RenderStats()) for each in tracers]
    same_find(traced[0], traced[1], rays.time_s.shape)


def test_structures_have_the_sizes_of_the_kernels(driver: ctypes.CDLL) -> None:
    driver.size_of_inputs.restype = ctypes.c_size_t
    assert driver.size_of_inputs() == ctypes.sizeof(TraceInputsStruct)


def test_memory_of_the_gpu_is_its_own(driver: ctypes.CDLL) -> None:
    values = np.arange(5.0)
    with GpuMemory(cuda_driver.gpu()) as memory:
        copy, cleared = memory.upload(values), memory.allocate(40, clear=True)
        back = np.ones(5)
        memory.download(copy, back)
        assert np.array_equal(back, values)
        memory.download(cleared, back)
        assert not back.any()
        with pytest.raises(UnisimError, match="cuMemcpyDtoH_v2: an illegal memory access"):
            memory.download(copy, np.ones(6))
    assert driver.memory_in_use() == 0


def test_a_gpu_is_taken_where_one_traces(driver: ctypes.CDLL, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert pick_device("auto") == "cuda" and backend_name("cuda") == "gpu" and backend_name("cpu") == "compiled"
    assert environment("cuda")["gpu"] == "a CPU" and "gpu" not in environment("cpu")
    monkeypatch.setattr(cuda_driver, "KERNELS", tmp_path / "none.fatbin")
    assert "make cuda" in cuda_driver.missing() and backend_name("cuda") == "torch"
    monkeypatch.setattr(cuda_driver, "LIBRARY", "libnone.so")
    cuda_driver.driver.cache_clear()
    assert "no NVIDIA GPU" in cuda_driver.missing() and pick_device("auto") != "gpu"
