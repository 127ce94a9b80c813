"""The states of a drive: a window's state renders what the whole drive's state renders, and holds no
more than it needs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from analytic_scene import drive_of, still
from busy_drive import FOREIGN_SCENE, backends, busy_drive
from same_frames import assert_same, named
from turning_drive import turning_drive
from whole_drive import whole_state, window_of

from unisim_blender.core import native
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracer import Backend
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.sensors.frames import CAMERA_PASSES, CameraFrame, LidarFrame
from unisim_blender.core.sensors.rays import exposure_window
from unisim_blender.core.world.drive import Camera, Drive, Lidar
from unisim_blender.core.world.replay import DriveStates, WorldState, parked_boxes, with_windows

SAMPLE = Path(__file__).parents[3] / "sample" / "scene"
needs_library = pytest.mark.skipif(native.library() is None, reason="the compiled kernels were not built")
KINDS = [pytest.param("compiled", marks=needs_library), "torch"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("busy")


@pytest.fixture(scope="module")
def drive(folder: Path) -> Drive:
    return busy_drive(folder)


@pytest.fixture(scope="module")
def loaded(folder: Path) -> Mapping[str, Backend]:
    return backends(folder)


def rendered(backend: Backend, state: WorldState, sensor: Camera | Lidar, frame: int) -> CameraFrame | LidarFrame:
    renderer = Renderer(backend, shadows=True)
    if isinstance(sensor, Lidar):
        return renderer.render(state, sensor, sensor.time_s[frame], seed=[1, frame])
    return renderer.render(state, sensor, sensor.time_s[frame], CAMERA_PASSES)


@pytest.mark.parametrize("kind", KINDS)
def test_a_windows_state_renders_what_the_whole_drives_renders(
    loaded: Mapping[str, Backend], drive: Drive, kind: str
) -> None:
    backend = loaded[kind]
    states = DriveStates(drive, backend.parked)
    whole = states.state(*window_of(drive))
    # one by the drive, and those of three actors that were parked: one is gone, one drives now, one is scaled
    assert len(whole.removed_boxes) == 4 and len(whole.static_copies) == 1 and len(whole.actors) == 7
    shown: set[str] = set()
    for sensor in (drive.cameras["front"], drive.lidars["top"]):
        for frame in (0, 2, 5):
            state = states.state(*exposure_window(sensor, sensor.time_s[frame]))
            assert len(state.actors) < 7 and len(state.world_from_ego.times_s) < len(drive.world_from_ego.times_s)
            found = rendered(backend, state, sensor, frame)
            assert_same(found, rendered(backend, whole, sensor, frame))
            shown |= set(np.unique(named(found)).tolist())
    assert {"near", "cone", "van", "guest", "cube"} <= shown, "what is not seen is not compared"


@needs_library
def test_a_trained_scene_traced_on_a_lattice_has_the_same_bits() -> None:
    """Its parked cars stand where they were recorded, but for one that is gone."""
    scene = CompiledScene(SAMPLE)
    backend, drive = CompiledBackend(scene), scene.header.drive
    gone = next(iter(parked_boxes(drive)))
    drive = replace(drive, actors={uid: actor for uid, actor in drive.actors.items() if uid != gone})
    states = DriveStates(drive, backend.parked)
    whole = states.state(*window_of(drive))
    camera, lidar = drive.cameras["front_camera"].resized(160), drive.lidars["pandar64"]
    few = replace(lidar, model=replace(lidar.model, columns=180), blocked=None)
    for sensor in (camera, few):
        state = states.state(*exposure_window(sensor, sensor.time_s[9]))
        assert len(state.removed_boxes) == len(whole.removed_boxes) == 1
        assert_same(rendered(backend, state, sensor, 9), rendered(backend, whole, sensor, 9))


def test_actors_out_of_time_are_not_in_a_state(drive: Drive) -> None:
    states = DriveStates(drive, {})

    def there(start_s: float, end_s: float) -> set[str]:
        return {actor.uid for actor in states.state(start_s, end_s).actors} & {"early", "late"}

    assert there(-0.05, 0.0) == {"early"} and there(0.2, 0.3) == set() and there(0.4, 0.45) == {"late"}
    # presence includes both ends, and the last frame's actors stay for what looks later
    assert there(0.12, 0.2) == {"early"} and there(np.nextafter(0.12, 1), 0.2) == set()
    assert there(0.2, 0.33) == {"late"} and there(0.2, np.nextafter(0.33, 0)) == set()
    assert there(0.6, 0.7) == {"late"} and there(0.0, 0.5) == {"early", "late"}


def test_a_state_is_cut_to_its_window(drive: Drive) -> None:
    state = DriveStates(drive, {}).state(0.1, 0.35)
    assert [actor.uid for actor in state.actors] == sorted(actor.uid for actor in state.actors)
    assert (state.start_s, state.end_s) == (0.1, 0.35)
    windows = {actor.uid: (actor.start_s, actor.end_s) for actor in state.actors}
    assert windows["early"] == (0.1, 0.12) and windows["late"] == (0.33, 0.35) and windows["van"] == (0.1, 0.35)
    for actor in state.actors:
        recorded = drive.actors[actor.uid]
        times = np.linspace(0.1, 0.35, 26)
        np.testing.assert_array_equal(actor.world_from_actor.at(times), recorded.world_from_actor.at(times))
        # all else is the drive's
        trajectory, window = recorded.world_from_actor, (recorded.start_s, recorded.end_s)
        assert replace(actor, world_from_actor=trajectory, start_s=window[0], end_s=window[1]) == recorded
    assert state.static_copies == drive.static_copies and state.removed_boxes == drive.static_removals
    assert {actor.appearance.scene for actor in state.actors} == {"", FOREIGN_SCENE}


def test_windows_of_presence_reach_beyond_the_first_and_the_last_frame() -> None:
    drive = turning_drive()
    actors = {actor.uid: actor for actor in with_windows(drive, reversed(drive.actors.values()))}
    assert list(actors) == ["car", "late", "van"]
    assert (actors["car"].start_s, actors["car"].end_s) == (-0.25, 1.25)
    assert (actors["late"].start_s, actors["late"].end_s) == (0.3, 0.8)


def test_boxes_of_parked_actors_are_empty_unless_these_stand_in_them() -> None:
    parked = still("car", (0.0, 0.0, 1.0), (4.0, 2.0, 2.0))
    driver = replace(still("van", (5.0, 5.0, 1.0), (4.0, 2.0, 2.0)), is_moving=True)
    recorded = drive_of([parked, driver])
    assert list(parked_boxes(recorded)) == ["car"]
    away = np.eye(4)
    away[0, 3] = 1e-9
    there = {
        "as it was": parked,
        "another appearance": replace(parked, appearance=replace(parked.appearance, actor="van")),
        "moved": replace(parked, world_from_actor=parked.world_from_actor.transformed(away)),
        "driving": replace(parked, is_moving=True),
        "smaller": replace(parked, size_m=parked.size_m / 2, scale=(0.5, 0.5, 0.5)),
        "renamed": replace(parked, uid="other"),
    }
    removed = {name: len(whole_state(drive_of([actor]), recorded).removed_boxes) for name, actor in there.items()}
    assert removed == {"as it was": 0, "another appearance": 0, "moved": 1, "driving": 1, "smaller": 1, "renamed": 1}
    (box,) = whole_state(drive_of([]), recorded).removed_boxes
    np.testing.assert_array_equal(box.world_from_box, parked.world_from_actor.poses[0])
    np.testing.assert_array_equal(box.size_m, parked.size_m)
