"""Rays traced through CUDA's driver: memory, launches and results, by a driver whose GPU is the CPU."""

from __future__ import annotations

import ctypes
import dataclasses
import functools
import os
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from analytic_scene import still
from drive_frames import DriveFrames
from driver_on_cpu import build_driver, loaded_driver
from random_scene import CONFIGS, PASSES, TINY, edited, image_rays, saved
from render.tracers.test_compiled_tracer import FEW, bits, close, needs_library, same_find, sweep_rays
from whole_drive import bound_to
from written_street import write_recipe

from unisim_bench.cases import all_cases, subject_of
from unisim_bench.render_request import RenderSession
from unisim_bench.report.metrics import metrics_of
from unisim_bench.report.plots import images
from unisim_bench.report.tables import GROWTH
from unisim_bench.run import machine
from unisim_bench.settings import QUICK, all_methods
from unisim_blender.core import cuda_driver
from unisim_blender.core.cli.commands.render import default_jobs
from unisim_blender.core.cuda_driver import GpuMemory, GpuMemoryError
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.executors import Processes
from unisim_blender.core.geometry import Trajectory, quaternion_from_yaw
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.meshes.hits import MeshHits
from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario
from unisim_blender.core.render.captures import render_capture, start_capture, started_ahead
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.quality import QUALITIES
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.reuse import FrameReuse
from unisim_blender.core.render.tracers.compiled import gpu
from unisim_blender.core.render.tracers.compiled.gpu import (
    GpuBackend,
    GpuScene,
    ImageInputsStruct,
    SweepInputsStruct,
    TraceInputsStruct,
)
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.scenes import recipe
from unisim_blender.core.scenes.recipe import (
    backend_name,
    environment,
    gpu_of,
    load_backend,
    pick_device,
    torch_device,
    used_device,
)
from unisim_blender.core.scenes.scene import open_scene
from unisim_blender.core.sensors.frames import CAMERA_PASSES, RenderStats
from unisim_blender.core.sensors.rays import Rays, exposure_window
from unisim_blender.core.worker.about import about
from unisim_blender.core.world.captures import Capture
from unisim_blender.core.world.drive import Appearance, CameraModel, Drive, LidarModel, RollingShutter, SpinPhase

SAMPLE = Path(__file__).parents[4] / "sample" / "scene"
pytestmark = [needs_library, pytest.mark.skipif(shutil.which("g++") is None, reason="the driver is compiled by g++")]


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_driver(tmp_path_factory.mktemp("driver"))


@pytest.fixture
def driver(built: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ctypes.CDLL]:
    """A driver that finds a GPU."""
    with loaded_driver(built, monkeypatch) as library:
        yield library


def both(folder: Path, quality: str = "balanced", other: Path | None = None) -> tuple[GpuBackend, CompiledBackend]:
    others = {} if other is None else {"other": CompiledScene(other)}
    scene, device = CompiledScene(folder), cuda_driver.gpu(0)
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
        if not sky:
            directions = rays.flat().directions
            returns = [tracer.returns(result, directions) for tracer, result in zip((fast, slow), traced, strict=True)]
            for a, b in zip(*returns, strict=True):
                close(a, b, rays.time_s.shape, 5e-3)
            # features of beams stay on the GPU
            assert traced[0].feature.size == 0 and traced[0].returned is not None
            traced[0].feature = traced[1].feature
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


SINGLE = dataclasses.replace(TINY, upsample=1, decoder_kernel=1)
"""A scene whose pixels depend on their own rays alone."""
LENSES = {
    "pinhole": CameraModel(97, 66, 80.0, 80.0, 48.0, 33.0),
    "rows": CameraModel(97, 66, 80.0, 80.0, 48.0, 33.0, RollingShutter(0.05)),
    "columns": CameraModel(64, 41, 80.0, 80.0, 32.0, 20.0, RollingShutter(-0.05, 0.2, "columns")),
    "fisheye": CameraModel(
        48, 34, 13.0, 13.0, 24.0, 16.0, RollingShutter(0.03), OpenCVFisheye(k1=-0.02, max_angle_deg=105)
    ),
}


@pytest.fixture
def launches(driver: ctypes.CDLL, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the kernels that were launched."""
    names: list[str] = []
    launch = cuda_driver.Gpu.launch

    def noted(self: cuda_driver.Gpu, name: str, *more: Any) -> None:
        names.append(name)
        launch(self, name, *more)

    monkeypatch.setattr(cuda_driver.Gpu, "launch", noted)
    return names


def passes_of(frame: Any) -> dict[str, Any]:
    names = ("rgb", "depth_m", "z_depth_m", "normal", "instance", "opacity", "unsupported")
    return {name: value for name in names if (value := getattr(frame, name)) is not None}


def of_small_images(backends: tuple[GpuBackend, CompiledBackend]) -> tuple[GpuBackend, CompiledBackend]:
    """The backends, as if their scene had learnt from small images: theirs are traced from a lattice."""
    header: Any = backends[0].scene.header
    header.training["width"] = 16
    return backends


def moving(drive: Drive, model: CameraModel) -> Drive:
    """The drive with one camera of a model, which moves and turns."""
    front = drive.cameras["front"]
    turned = np.stack([quaternion_from_yaw(np.array([yaw]))[0] for yaw in (0.0, 0.2)])
    stands = front.world_from_camera
    along = Trajectory(
        np.array([-1.0, 1.0]),
        stands.positions[0] + np.array([[0.0, 0, 0], [1.5, 0.3, 0]]),
        np.stack([multiplied(q, stands.quaternions_wxyz[0]) for q in turned]),
    )
    return dataclasses.replace(
        drive, cameras={"front": dataclasses.replace(front, model=model, world_from_camera=along)}
    )


def multiplied(a: Any, b: Any) -> Any:
    """The product of two quaternions, wxyz."""
    (w, *v), (s, *u) = a, b
    return np.array([w * s - np.dot(v, u), *(w * np.array(u) + s * np.array(v) + np.cross(v, u))])


@pytest.mark.parametrize("lens", LENSES)
@pytest.mark.parametrize("quality", ("balanced", "fine", "reference"))
def test_images_beside_the_compiled_tracer(launches: list[str], tmp_path: Path, lens: str, quality: str) -> None:
    drive = moving(edited(), LENSES[lens])
    # confidence traces recorded views, once for a scene
    passes = [name for name in CAMERA_PASSES if name != "confidence"]
    frames = [
        DriveFrames(Renderer(backend), drive).camera("front", 2, passes)
        for backend in of_small_images(both(saved(tmp_path / "scene", SINGLE), quality))
    ]
    assert launches.count("unisim_begin_image") == 1 and "unisim_fill_pixels" in launches
    assert launches.count("unisim_trace_rays") == {"balanced": 5, "fine": 3, "reference": 1}[quality]
    fast, slow = map(passes_of, frames)
    assert fast.keys() == slow.keys() and frames[0].instances == frames[1].instances
    for name, values in slow.items():
        assert fast[name].dtype == values.dtype, name
        a, b = (x.astype(float).reshape(-1, values[0, 0].size) for x in (fast[name], values))
        differ = ~(np.isclose(a, b, rtol=5e-3, atol=5e-3) | (a == b)).all(1)
        assert differ.sum() <= 3 * FEW, name
    stats = [frame.stats for frame in frames]
    assert abs(stats[0].rays - stats[1].rays) <= 0.003 * stats[1].rays
    assert abs(stats[0].samples_spent - stats[1].samples_spent) <= 0.005 * stats[1].samples_spent
    assert stats[0].samples_saved > 0


@pytest.mark.parametrize("lens", ("rows", "fisheye"))
def test_images_whose_cells_are_several_pixels(launches: list[str], tmp_path: Path, lens: str) -> None:
    drive = moving(edited(), LENSES[lens])
    several = dataclasses.replace(SINGLE, upsample=3)
    frames = [
        DriveFrames(Renderer(backend), drive).camera("front", 2, CAMERA_PASSES, None, region)
        for backend in both(saved(tmp_path / "scene", several))
        for region in (None, Region(7, 5, 30, 21))
    ]
    assert launches.count("unisim_begin_image") == 2
    for fast, slow in zip(map(passes_of, frames[:2]), map(passes_of, frames[2:]), strict=True):
        for name, values in slow.items():
            assert fast[name].shape == values.shape and fast[name].dtype == values.dtype, name
            a, b = (x.astype(float).reshape(-1, values[0, 0].size) for x in (fast[name], values))
            assert (~(np.isclose(a, b, rtol=5e-3, atol=5e-3) | (a == b)).all(1)).sum() <= 9 * FEW, name


def test_an_image_of_the_sample(launches: list[str]) -> None:
    fast, slow = (
        DriveFrames(Renderer(backend), backend.scene.header.drive).camera("front_camera", 10, ("rgb", "depth"), 160)
        for backend in of_small_images(both(SAMPLE))
    )
    assert "unisim_begin_image" in launches
    error = np.mean((fast.rgb.astype(float) - slow.rgb) ** 2)
    assert -10 * np.log10(error) > 60 and np.abs(fast.rgb - slow.rgb).max(-1).mean() < 1e-4
    assert fast.stats.rays < 0.85 * fast.rgb[..., 0].size
    assert fast.depth_m is not None and slow.depth_m is not None
    hit = np.isfinite(slow.depth_m) & np.isfinite(fast.depth_m)
    assert np.median(np.abs(fast.depth_m[hit] - slow.depth_m[hit])) < 1e-4


def test_parts_of_an_image_and_images_that_stay(launches: list[str], tmp_path: Path) -> None:
    drive = moving(edited(), LENSES["rows"])
    backend, _ = of_small_images(both(saved(tmp_path / "scene", SINGLE)))
    frames = DriveFrames(Renderer(backend), drive)
    whole = passes_of(first := frames.camera("front", 2, CAMERA_PASSES))
    expected = {name: values.copy() for name, values in whole.items()}
    in_use = len(launches)
    for region in (Region(21, 10, 70, 51), Region(0, 0, 3, 2), Region(90, 60, 97, 66)):
        part = passes_of(frames.camera("front", 2, CAMERA_PASSES, None, region))
        for name, values in part.items():
            cut = expected[name][region.top : region.bottom, region.left : region.right]
            assert np.array_equal(values, cut), name
    assert len(launches) > in_use
    camera = frames.captures.camera("front")
    state = frames.states.state(*exposure_window(camera, 0.2))
    tiles = list(frames.renderer.progressive(state, camera, 0.2, CAMERA_PASSES, coarse=(8,), band=20))
    assert [tile.region.top for tile in tiles] == [0, 20, 40, 60] and {tile.stride for tile in tiles} == {(1, 1)}
    assert np.array_equal(np.concatenate([tile.frame.rgb for tile in tiles]), expected["rgb"])
    # arrays of earlier images are nobody else's
    frames.camera("front", 4, CAMERA_PASSES)
    for name, values in passes_of(first).items():
        assert np.array_equal(values, expected[name]), name


def test_an_image_is_launched_before_the_one_before_it_is_copied(
    driver: ctypes.CDLL, launches: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = moving(edited(), LENSES["rows"])
    backend, on_cpu = of_small_images(both(saved(tmp_path / "scene", SINGLE)))
    frames = DriveFrames(Renderer(backend), drive)
    captures = [Capture.of_frame(drive.cameras["front"], frame) for frame in (1, 2, 3, 2)]
    alone = [passes_of(render_capture(frames.renderer, frames.captures, each, CAMERA_PASSES)) for each in captures]
    alone = [{name: values.copy() for name, values in passes.items()} for passes in alone]
    wait = cuda_driver.Gpu.wait

    def noted(self: cuda_driver.Gpu, event: ctypes.c_void_p) -> None:
        launches.append("wait")
        wait(self, event)

    monkeypatch.setattr(cuda_driver.Gpu, "wait", noted)
    del launches[:]
    start = functools.partial(start_capture, frames.renderer, frames.captures, passes=CAMERA_PASSES)
    in_use, waited = 0, 0
    for expected, waits in zip(alone, started_ahead(start, captures), strict=True):
        begun = launches.count("unisim_begin_image")
        assert begun == min(waited + 2, len(captures)) and launches.count("wait") == waited
        frame = waits()
        waited += 1
        assert launches.count("wait") == waited
        for name, values in passes_of(frame).items():
            assert np.array_equal(values, expected[name]), name
        # two images lie on the GPU: nothing is allocated for further ones
        assert waited < 2 or driver.memory_in_use() == in_use
        in_use = driver.memory_in_use()
    # one that nobody waits for leaves its memory to others
    start(captures[0])
    for name, values in passes_of(start(captures[1])()).items():
        assert np.array_equal(values, alone[1][name]), name
    assert driver.memory_in_use() == in_use
    # a CPU renders when it is waited for
    frames = DriveFrames(Renderer(on_cpu), drive)
    later: Any = start_capture(frames.renderer, frames.captures, captures[1], CAMERA_PASSES)
    for name, values in passes_of(render_capture(frames.renderer, frames.captures, captures[1], CAMERA_PASSES)).items():
        assert np.array_equal(passes_of(later())[name], values), name


def test_images_allocate_nothing_anew_and_take_the_room_and_the_memory_that_there_is(
    driver: ctypes.CDLL, launches: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = moving(edited(), LENSES["pinhole"])
    folder = saved(tmp_path / "scene", SINGLE)
    backend, _ = of_small_images(both(folder))
    frames = DriveFrames(Renderer(backend), drive)
    expected = passes_of(frames.camera("front", 2, CAMERA_PASSES))
    frames.camera("front", 3, CAMERA_PASSES)
    allocated = driver.memory_in_use()
    pinned = []  # a queued copy may be done after its memory is given back

    def in_numpy(self: cuda_driver.Gpu, shape: tuple[int, ...], kind: type[Any]) -> np.ndarray[Any, Any]:
        pinned.append(np.empty(shape, kind))
        return pinned[-1]

    monkeypatch.setattr(cuda_driver.Gpu, "pinned", in_numpy)
    driver.limit_memory(allocated)
    frames.camera("front", 3, CAMERA_PASSES)
    assert driver.memory_in_use() == allocated
    driver.limit_memory(1 << 32)
    monkeypatch.setattr(gpu, "SAMPLES", 16)
    monkeypatch.setattr(gpu, "SEGMENTS", 2)
    del launches[:]
    for name, values in passes_of(frames.camera("front", 2, CAMERA_PASSES)).items():
        assert np.array_equal(values, expected[name]), name
    assert launches.count("unisim_begin_image") > 1
    # less than an image needs: its rays are traced a few at a time
    backend.gpu_scenes[""].gpu.trim()
    driver.limit_memory(driver.memory_in_use() + 1_000_000)
    del launches[:]
    monkeypatch.setattr("unisim_blender.core.render.tracers.compiled.tracer.CHUNK_RAYS", 500)
    region = Region(40, 20, 64, 36)
    part = frames.camera("front", 2, CAMERA_PASSES, None, region)
    assert np.abs(part.rgb - expected["rgb"][20:36, 40:64]).mean() < 1e-4
    assert "unisim_fill_pixels" not in launches


TABLES: dict[str, dict[str, Any]] = {
    "even": {},
    "delays": {"beam_time_s": np.linspace(0.02, -0.01, 24)},
    "narrow": {"column_azimuth_rad": np.linspace(0.4, -0.5, 70) ** 3, "column_time_s": np.linspace(-0.1, 0.05, 70)},
}


def with_lidar(drive: Drive, turns: bool = True, **table: Any) -> Drive:
    """The drive with one LiDAR of a beam table, which moves and turns."""
    top = drive.lidars["top"]
    model = LidarModel(np.linspace(0.3, -0.7, 24), 0.01 * np.sin(np.arange(24)), columns=70, sweep_s=0.15, **table)
    # a little higher, see `sweep_rays`
    position, stands = top.world_from_lidar.positions[0] + [0, 0, 0.013], top.world_from_lidar.quaternions_wxyz[0]
    ends = np.stack([multiplied(quaternion_from_yaw(np.array([yaw]))[0], stands) for yaw in (0.0, 0.3)])
    along = Trajectory(np.array([-1.0, 1.0]), position + np.array([[0.0, 0, 0], [1.5, 0.3, 0]]), ends)
    if not turns:
        along = Trajectory(np.zeros(1), position[None], stands[None])
    phase = SpinPhase(np.array([0.0, 1.0]), np.array([0.0, 0.5])) if turns else None
    lidar = dataclasses.replace(top, model=model, world_from_lidar=along, blocked=None, phase=phase)
    return dataclasses.replace(drive, lidars={"top": lidar})


SWEEP = ("depth_m", "intensity", "return_probability", "instance")


@pytest.mark.parametrize("name", ("tiny", "dark", "sample"))
@pytest.mark.parametrize("table", TABLES)
def test_sweeps_beside_the_compiled_tracer(launches: list[str], tmp_path: Path, name: str, table: str) -> None:
    drive = with_lidar(edited(), **TABLES[table])
    fast, slow = (
        DriveFrames(Renderer(backend), drive, draw=3).lidar("top", 2)
        for backend in both(saved(tmp_path / "scene", CONFIGS[name]))
    )
    assert launches == ["unisim_begin_sweep", "unisim_trace_rays", "unisim_decode_beams"]
    for of in ("origins", "directions", "time_s"):
        assert np.abs(getattr(fast, of) - getattr(slow, of)).max() < 1e-12, of
    shape = slow.depth_m.shape
    for of, within in zip(SWEEP, (1e-2, 5e-3, 5e-3, 1e-2), strict=True):
        assert getattr(fast, of).dtype == getattr(slow, of).dtype and getattr(fast, of).shape == shape
        close(getattr(fast, of).reshape(-1), getattr(slow, of).reshape(-1), shape, within)
    assert slow.depth_m.max() > 1 and 0.01 < slow.returned.mean() and (fast.returned != slow.returned).mean() < 0.01
    assert fast.instances == slow.instances and fast.stats.rays == slow.stats.rays == slow.depth_m.size
    # no actor is culled that a beam may hit
    assert fast.stats.actors_skipped <= slow.stats.actors_skipped
    assert abs(fast.stats.samples_spent - slow.stats.samples_spent) <= 1e-3 * slow.stats.samples_spent + 2


def test_sweeps_are_started_ahead_and_take_the_room_and_the_memory_that_there_is(
    driver: ctypes.CDLL, launches: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = with_lidar(edited(), **TABLES["delays"])
    backend, _ = both(saved(tmp_path / "scene", TINY))
    frames = DriveFrames(Renderer(backend), drive, draw=3)
    captures = [Capture.of_frame(drive.lidars["top"], frame) for frame in (1, 2, 3)]
    alone = [frames.sweep(each) for each in captures]
    expected = [{of: getattr(frame, of).copy() for of in (*SWEEP, "returned", "origins")} for frame in alone]
    del launches[:]
    start = functools.partial(start_capture, frames.renderer, frames.captures, draw=3)
    for number, waits in enumerate(started_ahead(start, captures)):
        assert launches.count("unisim_begin_sweep") == min(number + 2, len(captures))
        same_sweep(waits(), expected[number])
    monkeypatch.setattr(gpu, "SAMPLES", 16)
    monkeypatch.setattr(gpu, "SEGMENTS", 2)
    del launches[:]
    same_sweep(frames.sweep(captures[0]), expected[0])
    assert launches.count("unisim_begin_sweep") > 1
    # less than a sweep needs: its rays are traced a few at a time
    backend.gpu_scenes[""].gpu.trim()
    driver.limit_memory(driver.memory_in_use() + 500_000)
    del launches[:]
    monkeypatch.setattr("unisim_blender.core.render.tracers.compiled.tracer.CHUNK_RAYS", 500)
    part = frames.sweep(captures[0])
    assert "unisim_begin_sweep" not in launches and "unisim_trace_rays" in launches
    assert np.abs(part.depth_m - expected[0]["depth_m"]).mean() < 1e-2


def same_sweep(frame: Any, expected: dict[str, Any]) -> None:
    for of, values in expected.items():
        assert np.array_equal(getattr(frame, of), values), of


def test_beams_of_a_lidar_that_stands_are_reused(launches: list[str], tmp_path: Path) -> None:
    drive = with_lidar(edited(), turns=False, **TABLES["narrow"])
    backend, _ = both(saved(tmp_path / "scene", TINY))
    frames, reused = (DriveFrames(Renderer(backend), drive, 3, reuse) for reuse in (None, FrameReuse()))
    reused.lidar("top", 1)
    expected, frame = frames.lidar("top", 2), reused.lidar("top", 2)
    assert frame.stats.rays < expected.stats.rays and launches.count("unisim_begin_sweep") == 2
    same_sweep(frame, {of: getattr(expected, of) for of in (*SWEEP, "returned", "origins", "directions", "time_s")})


def test_rays_without_room_and_memory_that_is_short(
    driver: ctypes.CDLL, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive = edited()
    backend, _ = both(saved(tmp_path / "scene", TINY))
    tracer, rays = bound_to(backend, drive), image_rays(drive)
    whole = bits(tracer.trace(rays, PASSES, True, None, RenderStats()))
    device = backend.gpu_scenes[""].gpu
    assert device.trim()
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
        assert device.trim()
        assert driver.memory_in_use() == in_use
    assert launched[0] < rays.time_s.size and len(launched) > 5
    driver.limit_memory(in_use + 1000)
    with pytest.raises(GpuMemoryError, match="out of memory"):
        tracer.trace(rays, PASSES, True, None, RenderStats())
    device.trim()
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
    driver.size_of_image.restype = ctypes.c_size_t
    assert driver.size_of_image() == ctypes.sizeof(ImageInputsStruct)
    driver.size_of_sweep.restype = ctypes.c_size_t
    assert driver.size_of_sweep() == ctypes.sizeof(SweepInputsStruct)


def test_memory_of_the_gpu_is_its_own(driver: ctypes.CDLL) -> None:
    values = np.arange(5.0)
    with GpuMemory(cuda_driver.gpu(0)) as memory:
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
    monkeypatch.setattr(cuda_driver, "nvrtc", lambda: object())
    assert not cuda_driver.missing()
    monkeypatch.setattr(cuda_driver, "nvrtc", lambda: None)
    assert "make cuda" in cuda_driver.missing() and backend_name("cuda") == "torch"
    monkeypatch.setattr(cuda_driver, "LIBRARY", "libnone.so")
    cuda_driver.driver.cache_clear()
    assert "no NVIDIA GPU" in cuda_driver.missing() and pick_device("auto") == torch_device()


NVRTC = """
#include <cstring>
#define EXPORT extern "C" __attribute__((visibility("default")))
EXPORT int nvrtcCreateProgram(void **, const char *, const char *, int, const char **, const char **) { return 0; }
EXPORT int nvrtcCompileProgram(void *, int, const char **) { return FAULT; }
EXPORT int nvrtcGetProgramLogSize(void *, size_t *size) { return *size = 8, 0; }
EXPORT int nvrtcGetProgramLog(void *, char *text) { return std::memcpy(text, "line 1: ", 8), 0; }
EXPORT int nvrtcGetCUBINSize(void *, size_t *size) { return *size = 9, 0; }
EXPORT int nvrtcGetCUBIN(void *, char *code) { return std::memcpy(code, "compiled", 9), 0; }
"""
"""A compiler that compiles everything, or nothing."""


def compiler(folder: Path, fault: int) -> ctypes.CDLL:
    source, library = folder / f"nvrtc-{fault}.cpp", folder / f"nvrtc-{fault}.so"
    source.write_text(NVRTC)
    subprocess.run(["g++", "-shared", "-fPIC", f"-DFAULT={fault}", "-o", str(library), str(source)], check=True)
    return ctypes.CDLL(str(library))


def test_a_gpu_that_fails_says_why(driver: ctypes.CDLL, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path))
    monkeypatch.setattr(recipe, "torch_device", lambda: "cpu")

    def no_gpu(sentence: str) -> None:
        cuda_driver.opened_gpu.cache_clear()
        with pytest.warns(UserWarning, match=f"the CPU renders: .*{sentence}"):
            assert pick_device("auto") == "cpu"
        with pytest.raises(UnisimError, match=sentence):
            used_device("cuda")
        with pytest.raises(UnisimError, match=sentence):
            load_backend(open_scene(SAMPLE), device="cuda")

    # a file without code for this GPU: NVRTC compiles the source, if it is there and can
    cuda_driver.KERNELS.write_bytes(b"of another GPU")
    monkeypatch.setattr(cuda_driver, "nvrtc", lambda: None)
    no_gpu("kernels.fatbin does not run on this GPU: .*cuModuleLoadData: no kernel image is available")
    monkeypatch.setattr(cuda_driver, "nvrtc", lambda: compiler(tmp_path, 6))
    no_gpu("NVRTC does not compile the kernels for capability 90: line 1")
    monkeypatch.setattr(cuda_driver, "nvrtc", lambda: compiler(tmp_path, 0))
    cuda_driver.opened_gpu.cache_clear()
    assert pick_device("auto") == "cuda" == used_device("cuda")
    # nothing that could be loaded
    monkeypatch.setattr(cuda_driver, "KERNELS", tmp_path / "none.fatbin")
    monkeypatch.setattr(cuda_driver, "nvrtc", lambda: None)
    no_gpu("make cuda compiles it")
    # what NVRTC compiled may itself be refused
    monkeypatch.setattr(cuda_driver, "nvrtc", object)
    monkeypatch.setattr(cuda_driver, "compiled", lambda capability: b"of another GPU")
    no_gpu("cuModuleLoadData: no kernel image is available")
    assert about()["devices"] == ["cpu"] and "no kernel image" in about()["warnings"][0]


def test_what_a_gpu_does_not_take_is_rendered_by_the_cpu(
    driver: ctypes.CDLL, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(recipe, "torch_device", lambda: "cpu")
    on_gpu, _ = plan_scenario(SAMPLE.parent / "scenario.json", RenderOptions(frames="5", device="cuda"))
    assert on_gpu.settings.device == "cuda" and on_gpu.environment["gpu"] == "a CPU" and "warnings" not in on_gpu.about
    street = write_recipe(tmp_path / "log", 60, seed=3, frames=7, width=64, height=36)
    surfels, _ = plan_scenario(street, RenderOptions(frames="5", device="cuda", renderer="surfel"))
    assert surfels.settings.device == "cpu" and "gpu" not in surfels.environment
    assert surfels.about["warnings"] == ["the renderer 'surfel' has no kernels for --device cuda: the CPU renders"]
    # a scene that the kernels do not take, where torch has no GPU
    monkeypatch.setattr(recipe, "not_taken", lambda config: "colour 'surface'")
    by_torch, _ = plan_scenario(SAMPLE.parent / "scenario.json", RenderOptions(frames="5", device="cuda"))
    assert by_torch.settings.device == "cpu" and "torch" in by_torch.environment
    assert by_torch.about["warnings"][-1].endswith("has no kernels for --device cuda: the CPU renders")


def test_the_benchmarks_rows_of_a_gpu(driver: ctypes.CDLL) -> None:
    settings = dataclasses.replace(QUICK, widths=(64,), windows=(1, 1), memory_width=64, loop_width=64, loop_steps=1)
    settings = dataclasses.replace(settings, growth_width=64, growth_widths=(64,), state_width=64)
    methods = {gpu: all_methods({"native": "portable"}, 1, False, gpu) for gpu in (False, True)}
    names = [method.name for method in methods[True] if method not in methods[False]]
    assert names == [f"GPU {quality}" for quality in QUALITIES] and {m.tracer for m in methods[False]} == {"compiled"}
    cases = {case.kind: case for case in all_cases([subject_of(SAMPLE)], methods[True], settings)}
    rows = [entry for case in cases.values() for entry in case.entries if entry.process == "gpu"]
    assert all(entry.request.setup.tracer == "gpu" for entry in rows)
    assert {kind: sum(e in rows for e in case.entries) for kind, case in cases.items() if kind != "scenes"} == {
        "camera": 4, "lidar": 4, "pixels": 0, "copies": 0, "state": 0, "region": 0, "loop": 4, "memory": 2
    }  # fmt: skip
    session = RenderSession()
    typical = next(entry for entry in cases["camera"].entries if entry.about.get("method") == "GPU balanced").request
    beside = dataclasses.replace(typical, setup=dataclasses.replace(typical.setup, tracer="compiled"))
    fast, slow = (session.render(request) for request in (typical, beside))
    assert np.abs(fast.pieces[0] - slow.pieces[0]).mean() < 1e-4
    # the scene's tables lie there, and what its rays need
    assert fast.gpu_bytes > (SAMPLE / "weights.safetensors").stat().st_size / 2 and slow.gpu_bytes == 0
    assert cuda_driver.gpu(0).peak_bytes == fast.gpu_bytes >= driver.memory_in_use()
    step = session.render(next(e for e in cases["loop"].entries if e.about["method"] == "GPU fast").request).step
    assert step is not None and step.step_s > 0
    (opened,) = session._simulated.values()
    assert isinstance(opened.renderer.backend, GpuBackend)
    for entry, measured in zip(cases["memory"].entries, (slow, slow, fast, fast), strict=True):
        entry.measurements.append(measured)
    for entry in cases["camera"].entries:
        entry.measurements.append(fast)
    report = metrics_of([cases["memory"], cases["camera"]])
    assert [row["gpu_mb"] > 0 for row in report["memory"][0]["entries"]] == [False, False, True, True]
    assert "camera.png" in images(report)
    lines = GROWTH["memory"](report["memory"][0])
    assert "most of the GPU's, MB" in lines[2] and lines[4].endswith("| – |") and "image, 64 wide, GPU" in lines[6]
    assert machine("portable")["gpu"] == "a CPU"


def test_one_gpu_for_each_worker(driver: ctypes.CDLL, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    assert default_jobs("cuda") == 1
    driver.have_devices(3)
    try:
        assert default_jobs("cuda") == 3 and default_jobs("cuda:2") == 1
        numbers = [
            result.get()
            for result in Processes().run(functools.partial(gpu_numbers, cuda_driver.LIBRARY, tmp_path), [0, 1], 2)
        ]
        assert {number for number, _ in numbers} == {"0", "1"}
        assert all(number == str(gpu) for number, gpu in numbers)
        monkeypatch.setenv("UNISIM_WORKER", "5")
        assert gpu_of("cuda") is cuda_driver.gpu(2) and gpu_of("cuda:1") is cuda_driver.gpu(1)
        with pytest.raises(UnisimError, match="--device cuda:3: there is no such GPU; this machine has 3"):
            gpu_of("cuda:3")
        with pytest.raises(UnisimError, match="--device cuda:x: is none of"):
            used_device("cuda:x")
    finally:
        driver.have_devices(1)


def gpu_numbers(library: str, folder: Path) -> Callable[[int], tuple[str, int]]:
    """A function that returns a worker's number, and that of the GPU that it takes of three, when two workers are there."""
    cuda_driver.LIBRARY, cuda_driver.KERNELS = library, Path(library)
    found = cuda_driver.driver()
    assert found is not None
    found.have_devices(3)
    chosen: list[int] = []
    setattr(cuda_driver, "gpu", chosen.append)  # noqa: B010
    number = os.environ["UNISIM_WORKER"]

    def of_unit(unit: int) -> tuple[str, int]:
        (folder / number).touch()
        for _ in range(600):
            if len(list(folder.iterdir())) == 2:
                break
            time.sleep(0.1)
        gpu_of("cuda")
        return number, chosen[-1]

    return of_unit
