"""A renderer keeps the tracer of its last state: nothing of that may be seen in another state's frames."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from busy_drive import backends, busy_drive
from drive_frames import DriveFrames
from same_frames import assert_same

from unisim_blender.core import native
from unisim_blender.core.render.quality import QUALITIES
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracer import Backend, Tracer
from unisim_blender.core.sensors.frames import CAMERA_PASSES, CameraFrame, LidarFrame
from unisim_blender.core.sensors.rays import Rays, exposure_window
from unisim_blender.core.world.drive import Actor, Camera, Drive, Lidar
from unisim_blender.core.world.replay import DriveStates, WorldState

needs_library = pytest.mark.skipif(native.library() is None, reason="the compiled kernels were not built")
KINDS = [pytest.param("compiled", marks=needs_library), "torch"]
Asked = tuple[WorldState, Camera | Lidar, float]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("busy")


@pytest.fixture(scope="module")
def drive(folder: Path) -> Drive:
    return busy_drive(folder)


@pytest.fixture(scope="module")
def loaded(folder: Path) -> Mapping[str, Backend]:
    return backends(folder)


def edits(drive: Drive) -> list[Drive]:
    """The drive, and others that differ in who is there, in the static world, and in nothing but a pose."""
    away = np.eye(4)
    away[1, 3] = 0.2
    near = drive.actors["near"]
    return [
        drive,
        replace(
            drive,
            actors={**drive.actors, "near": replace(near, world_from_actor=near.world_from_actor.transformed(away))},
        ),
        replace(drive, actors={}),
        replace(drive, static_copies=(), static_removals=()),
    ]


def asked(drive: Drive, backend: Backend) -> list[Asked]:
    """States with what is rendered of them: two times and both sensors of every drive."""
    out: list[Asked] = []
    for one in edits(drive):
        states = DriveStates(one, backend.parked)
        for sensor in (one.cameras["front"], one.lidars["top"]):
            for frame in (1, 4):
                time_s = sensor.time_s[frame]
                out.append((states.state(*exposure_window(sensor, time_s)), sensor, time_s))
    return out


def rendered(renderer: Renderer, what: Asked) -> CameraFrame | LidarFrame:
    state, sensor, time_s = what
    if isinstance(sensor, Lidar):
        return renderer.render(state, sensor, time_s, seed=[3])
    return renderer.render(state, sensor, time_s, CAMERA_PASSES)


@pytest.mark.parametrize("kind", KINDS)
def test_states_in_any_order_have_the_bits_of_a_fresh_renderer(
    loaded: Mapping[str, Backend], drive: Drive, kind: str
) -> None:
    backend = loaded[kind]
    jobs = asked(drive, backend)
    fresh = [rendered(Renderer(backend, shadows=True), job) for job in jobs]
    images = [frame.rgb.tobytes() for frame in fresh if isinstance(frame, CameraFrame)]
    assert len(set(images)) == len(images), "two states that look alike tell nothing"
    kept = Renderer(backend, shadows=True)
    rng = np.random.default_rng(0)
    order = rng.permutation(len(jobs)).tolist()
    # there and back, and twice the same
    for n in [*order, order[-1], *reversed(order)]:
        assert_same(rendered(kept, jobs[n]), fresh[n])


@pytest.mark.parametrize("kind", KINDS)
def test_a_quality_holds_for_the_frames_that_follow(loaded: Mapping[str, Backend], drive: Drive, kind: str) -> None:
    """Whether a state's tracer is bound or kept, it has the renderer's quality at the time; the backend's stays."""
    backend = loaded[kind]
    # without actors: what lights meshes sets the quality, too
    first, other = asked(drive, backend)[8:10]
    kept = Renderer(backend)
    before = backend.quality
    spent = {}
    for name in ("fast", "reference", "fast", "balanced"):
        kept.quality = QUALITIES[name]
        for what in (first, first, other):
            fresh = Renderer(backend)
            fresh.quality = QUALITIES[name]
            frame = rendered(kept, what)
            assert_same(frame, rendered(fresh, what))
        spent[name] = frame.stats.samples_spent
    assert spent["fast"] < spent["reference"] and backend.quality == before


@pytest.mark.parametrize("kind", KINDS)
def test_an_image_that_comes_in_bands_survives_another_state(
    loaded: Mapping[str, Backend], drive: Drive, kind: str
) -> None:
    backend = loaded[kind]
    jobs = asked(drive, backend)
    (state, camera, time_s), other = jobs[0], jobs[4]
    assert isinstance(camera, Camera)
    kept = Renderer(backend)
    bands = []
    for tile in kept.progressive(state, camera, time_s, CAMERA_PASSES, band=7):
        bands.append(tile.frame)
        rendered(kept, other)
    assert len(bands) == 5
    whole = Renderer(backend).render(state, camera, time_s, CAMERA_PASSES)
    for name in ("rgb", "depth_m", "z_depth_m", "normal", "instance", "opacity", "unsupported"):
        np.testing.assert_array_equal(np.concatenate([getattr(band, name) for band in bands]), getattr(whole, name))


class Counting:
    """A backend that counts how often it is bound."""

    sees_all = False

    def __init__(self, backend: Backend) -> None:
        self.backend, self.quality, self.parked = backend, backend.quality, backend.parked
        self.bound = 0

    def bind(self, state: WorldState) -> Tracer[Any]:
        self.bound += 1
        return self.backend.bind(state)

    def is_steady(self, sensor_id: str, start_s: float, end_s: float) -> bool:
        return self.backend.is_steady(sensor_id, start_s, end_s)

    def overhang_m(self, actor: Actor) -> float:
        return self.backend.overhang_m(actor)


def test_a_backend_is_bound_once_for_equal_states(loaded: Mapping[str, Backend], drive: Drive) -> None:
    backend = Counting(loaded["torch"])
    renderer = Renderer(backend)
    camera = drive.cameras["front"]
    window = exposure_window(camera, camera.time_s[2])
    first, again = (DriveStates(drive, backend.parked).state(*window) for _ in range(2))
    assert first is not again and renderer.tracer(first) is renderer.tracer(again) and backend.bound == 1
    other = DriveStates(drive, backend.parked).state(*exposure_window(camera, camera.time_s[3]))
    assert renderer.tracer(other) is not renderer.tracer(first) and backend.bound == 3


@pytest.mark.parametrize("kind", KINDS)
def test_a_backend_that_lights_meshes_is_bound_once_for_a_state(
    loaded: Mapping[str, Backend], drive: Drive, kind: str
) -> None:
    away = np.eye(4)
    away[2, 3] = 1.2
    cube = drive.actors["cube"]
    above = replace(cube, uid="cube-2", world_from_actor=cube.world_from_actor.transformed(away))
    two = replace(drive, actors={**drive.actors, "cube-2": above})
    backend, camera = Counting(loaded[kind]), drive.cameras["front"]
    renderer = Renderer(loaded[kind], lighting=backend)
    for bound, frame in enumerate((1, 2), start=1):
        time_s = camera.time_s[frame]
        state = DriveStates(two, backend.parked).state(*exposure_window(camera, time_s))
        found = renderer.render(state, camera, time_s, CAMERA_PASSES)
        assert found.instance is not None
        shown = {found.instances[number - 1] for number in np.unique(found.instance) if number}
        assert {"cube", "cube-2"} <= shown and backend.bound == bound
        assert_same(found, Renderer(loaded[kind]).render(state, camera, time_s, CAMERA_PASSES))


@pytest.mark.parametrize("kind", KINDS)
def test_a_drives_renderer_renders_its_exposures_states(loaded: Mapping[str, Backend], drive: Drive, kind: str) -> None:
    backend = loaded[kind]
    of_drive = DriveFrames(Renderer(backend, shadows=True), drive)
    camera, lidar = drive.cameras["front"], drive.lidars["top"]
    frame, sweep = of_drive.camera("front", 3, CAMERA_PASSES), of_drive.lidar("top", 3)
    states = DriveStates(drive, backend.parked)
    alone = Renderer(backend, shadows=True)
    assert_same(
        frame,
        alone.render(states.state(*exposure_window(camera, camera.time_s[3])), camera, camera.time_s[3], CAMERA_PASSES),
    )
    assert_same(sweep, alone.render(states.state(*exposure_window(lidar, lidar.time_s[3])), lidar, lidar.time_s[3]))
    rays = Rays(sweep.origins, sweep.directions, sweep.time_s).flat()
    depth, intensity, probability, instance = of_drive.rays_lidar(rays.origins, rays.directions, rays.time_s)
    for found, whole in ((depth, sweep.depth_m), (intensity, sweep.intensity), (probability, sweep.return_probability)):
        np.testing.assert_allclose(found, whole.reshape(-1), rtol=1e-5, atol=1e-5)
    assert (instance == sweep.instance.reshape(-1)).mean() > 0.99
