"""Images of the sample traced from a lattice: meshes and other scenes' actors are as sharp as in one whose every pixel
is traced, parts have the whole image's bits, and an image that is looked at while it grows costs no ray more."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from analytic_scene import still
from drive_frames import DriveFrames
from numpy.typing import NDArray

from unisim_blender.core import native
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.quality import ERROR_BOUND_QUALITIES, QUALITIES
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.sensors.frames import CAMERA_PASSES, CameraFrame
from unisim_blender.core.world.drive import Appearance, Drive

pytestmark = pytest.mark.skipif(native.library() is None, reason="the kernels were not built")
SAMPLE = Path(__file__).parents[3] / "sample" / "scene"
CAMERA, FRAME, WIDTH = "front_camera", 10, 720
REGIONS = (Region(201, 105, 417, 207), Region(0, 0, 33, 21), Region(670, 100, 720, 405))


@pytest.fixture(scope="module")
def scene() -> CompiledScene:
    return CompiledScene(SAMPLE)


@pytest.fixture(scope="module")
def busy(scene: CompiledScene, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    """The sample's drive with a ball, a rod as thick as a finger, and a foreign actor in front of the camera."""
    folder = tmp_path_factory.mktemp("meshes")
    for name, mesh in (("ball", trimesh.creation.icosphere(3, 0.8)), ("rod", trimesh.creation.cylinder(0.02, 3.0))):
        mesh.visual.face_colors = [20, 180, 40, 255]
        mesh.export(folder / f"{name}.ply")
    drive = scene.header.drive
    camera = drive.cameras[CAMERA]
    pose = camera.world_from_camera.at(camera.time_s[FRAME])

    def ahead(along: float, right: float, up: float) -> list[float]:
        place: list[float] = (pose[:3, 3] + pose[:3, 2] * along + pose[:3, 0] * right + np.array([0, 0, up])).tolist()
        return place

    appearance = next(actor for actor in drive.actors.values() if actor.label == "Car")
    always = {"start_s": -10.0, "end_s": 100.0, "inserted": True}
    new = (
        still(
            "ball",
            ahead(12, -2, -0.8),
            [1.6] * 3,
            appearance=Appearance("ball", mesh=str(folder / "ball.ply")),
            **always,
        ),
        still(
            "rod",
            ahead(10, 2.5, -0.5),
            [0.04, 0.04, 3],
            appearance=Appearance("rod", mesh=str(folder / "rod.ply")),
            **always,
        ),
        still("guest", ahead(14, 1, -0.9), appearance.size_m, appearance=Appearance(appearance.uid, "other"), **always),
    )
    return replace(drive, actors={**drive.actors, **{actor.uid: actor for actor in new}})


def renderer(scene: CompiledScene, drive: Drive, lattice: int, shadows: bool = False) -> DriveFrames:
    backend = CompiledBackend(scene, replace(QUALITIES["balanced"], lattice=lattice), {"other": scene})
    return DriveFrames(Renderer(backend, shadows), drive)


def arrays(frame: CameraFrame) -> dict[str, NDArray[np.generic]]:
    names = ("rgb", "depth_m", "z_depth_m", "normal", "instance", "opacity", "unsupported")
    return {name: value for name in names if (value := getattr(frame, name)) is not None}


@pytest.mark.parametrize("passes", (("rgb",), CAMERA_PASSES))
def test_meshes_and_foreign_actors_are_as_sharp_as_with_every_pixel_traced(
    scene: CompiledScene, busy: Drive, passes: tuple[str, ...]
) -> None:
    every = renderer(scene, busy, 1).camera(CAMERA, FRAME, ("rgb", "instance"), WIDTH)
    frame = renderer(scene, busy, 4).camera(CAMERA, FRAME, passes, WIDTH)
    assert frame.stats.rays < 0.75 * every.stats.rays
    assert -10 * np.log10(np.mean((frame.rgb.astype(float) - every.rgb) ** 2)) > 40
    assert every.instance is not None
    for uid in ("ball", "rod", "guest"):
        its = every.instance == every.instances.index(uid) + 1
        assert its.sum() > 100, uid
        np.testing.assert_array_equal(frame.rgb[its], every.rgb[its], uid)
        # and what shines past its edges
        beside = np.zeros_like(its)
        beside[1:], beside[:-1] = its[:-1], its[1:]
        beside[:, 1:] |= its[:, :-1]
        beside[:, :-1] |= its[:, 1:]
        np.testing.assert_array_equal(frame.rgb[beside], every.rgb[beside], uid)


def test_passes_that_need_depths_come_without_them_too(scene: CompiledScene) -> None:
    frame = renderer(scene, scene.header.drive, 4).camera(
        CAMERA, FRAME, ("rgb", "normal", "unsupported"), WIDTH, REGIONS[0]
    )
    assert frame.normal is not None and frame.unsupported is not None
    length = np.linalg.norm(frame.normal, axis=-1)
    # no normal where nothing is
    assert (length > 0.5).mean() > 0.3 and np.abs(length[length > 0] - 1).max() < 1e-5
    assert frame.unsupported.shape == frame.rgb.shape[:2]


def test_a_part_has_the_bits_of_the_whole(scene: CompiledScene, busy: Drive) -> None:
    one = renderer(scene, busy, 4, shadows=True)
    whole = arrays(one.camera(CAMERA, FRAME, CAMERA_PASSES, WIDTH))
    for region in REGIONS:
        part = arrays(one.camera(CAMERA, FRAME, CAMERA_PASSES, WIDTH, region))
        assert part.keys() == whole.keys()
        for name, values in part.items():
            assert np.array_equal(values, whole[name][region.top : region.bottom, region.left : region.right]), name


@pytest.mark.parametrize(
    "region, lattice", [pytest.param(None, 1, marks=pytest.mark.slow), (None, 4), (REGIONS[0], 1), (REGIONS[0], 4)]
)
def test_an_image_that_grows_is_the_image(
    scene: CompiledScene, busy: Drive, lattice: int, region: Region | None
) -> None:
    one = renderer(scene, busy, lattice)
    at_once = one.camera(CAMERA, FRAME, ("rgb", "depth"), WIDTH, region)
    whole = one.camera(CAMERA, FRAME, ("rgb",), WIDTH)
    camera = one.sized(CAMERA, WIDTH)
    time_s = camera.time_s[FRAME]
    state = one.state(camera, time_s)
    parts = list(one.renderer.progressive(state, camera, time_s, ("rgb", "depth"), region, coarse=(8, 4), band=37))
    assert [part.stride for part in parts[:3]] == [(8, 8), (4, 4), (1, 1)]
    for part in parts[:2]:
        row, column, stride = int(part.origin[0]), int(part.origin[1]), int(part.stride[0])
        h, w = part.frame.rgb.shape[:2]
        assert np.array_equal(part.frame.rgb, whole.rgb[row::stride, column::stride][:h, :w])
        # they reach over all that was asked for
        assert row <= part.region.top and row + h * stride >= part.region.bottom
        assert column <= part.region.left and column + w * stride >= part.region.right
    finished = parts[2:]
    assert len(finished) > 2 and all(part.stride == (1, 1) for part in finished)
    for name in ("rgb", "depth_m", "z_depth_m"):
        joined = np.concatenate([getattr(part.frame, name) for part in finished])
        assert np.array_equal(joined, getattr(at_once, name)), name
    assert finished[-1].frame.stats.rays == at_once.stats.rays


@pytest.mark.parametrize("quality, least_db", [("fast", 45), ("balanced", 48), ("fine", 48)])
def test_an_image_of_the_trainings_size_skips_pixels_between_alike_ones(
    scene: CompiledScene, quality: str, least_db: float
) -> None:
    backend, width = CompiledBackend(scene), scene.header.drive.cameras[CAMERA].model.width
    backend.quality = QUALITIES[quality]
    frames = DriveFrames(Renderer(backend), scene.header.drive)
    found = frames.camera(CAMERA, FRAME, ("rgb", "depth"), width)
    region = Region(101, 53, 301, 155)
    part = frames.camera(CAMERA, FRAME, ("rgb", "depth"), width, region)
    for name, values in arrays(part).items():
        assert np.array_equal(values, arrays(found)[name][region.top : region.bottom, region.left : region.right]), name
    smaller = frames.camera(CAMERA, FRAME, ("rgb",), width * 2 // 3)
    assert smaller.stats.rays == smaller.rgb.shape[0] * smaller.rgb.shape[1]
    frames.renderer.quality = replace(QUALITIES[quality], native_spread=0.0)
    every = frames.camera(CAMERA, FRAME, ("rgb",), width)
    assert every.stats.rays == width * every.rgb.shape[0] and found.stats.rays < 0.97 * every.stats.rays
    assert -10 * np.log10(np.mean((found.rgb.astype(float) - every.rgb) ** 2)) > least_db


def test_bounds_on_errors_are_of_images_whose_every_pixel_is_traced() -> None:
    assert not any(quality.native_spread for quality in ERROR_BOUND_QUALITIES.values())
