"""Surfels, images warped over them, and meshes, through lenses that bend lines and shutters that read columns."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from drive_frames import DriveFrames
from turning_drive import turning_drive

from unisim_blender.core import native
from unisim_blender.core.data.log import Log
from unisim_blender.core.evaluation.metrics import psnr_from_error
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import Trajectory
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.meshes.hits import MeshActors
from unisim_blender.core.prepare.renderers import SURFEL_METHODS
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.surfels.build import build_surfels, finished
from unisim_blender.core.render.tracers.surfels.views import RecordedView
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.unprojection import has_direction
from unisim_blender.core.world.drive import Actor, Appearance, Camera, CameraModel, RollingShutter
from unisim_street.street import build_street
from unisim_street.write import write_log

CAMERA, FRAME, SOURCES = "front_camera", 1, (0, 2)
FISHEYE = CameraModel(96, 60, 30.0, 30.0, 48.0, 30.0, RollingShutter(0.05, 0.3, "columns"), OpenCVFisheye(k1=-0.01))
LENSES = {
    "fisheye, columns": FISHEYE,
    "strong, rows from below": CameraModel(
        96, 60, 50.0, 52.0, 47.0, 31.0, RollingShutter(-0.04), OpenCVPinhole(k1=-0.28, k2=0.09, p1=0.003, p2=-0.002)
    ),
}
needs_kernels = pytest.mark.skipif(native.library() is None, reason="surfels are made by the compiled kernels")


def moving(model: CameraModel) -> Camera:
    """A camera that turns and drives as it exposes."""
    return replace(turning_drive().cameras["front"], model=model)


@pytest.mark.parametrize("model", LENSES.values(), ids=LENSES)
def test_places_are_where_rays_through_them_go(model: CameraModel) -> None:
    """What colours surfels and is warped: the image point of a place is that whose ray, at its line's time, meets the place."""
    camera, time_s = moving(model), 10.03
    nothing = np.zeros((15, 24), np.float32)
    camera = replace(camera, time_s={0: time_s})
    view = RecordedView(camera, 0, np.zeros((60, 96, 3), np.uint8), nothing, nothing, nothing, nothing > 0)
    rng = np.random.default_rng(5)
    pose = camera.world_from_camera.at(time_s)
    points = pose[:3, 3] + rng.normal(size=(400, 3)) * 15
    u, v, z, distance = view.of_static(points)
    inside = view.inside(u, v, z)
    assert 20 < inside.sum() < 380
    rays = camera_rays(camera, time_s, u[inside], v[inside])
    to = points[inside] - rays.origins
    aside = np.linalg.norm(np.cross(rays.directions, to / np.linalg.norm(to, axis=1, keepdims=True)), axis=1)
    # the way of a camera between its first and its last line is taken for straight
    assert np.quantile(aside, 0.9) < 0.01 and ((rays.directions * to).sum(1) > 0).all()
    still = camera_rays(camera, time_s, np.full(inside.sum(), 48.0), v[inside])
    assert np.abs(still.directions - rays.directions).max() > 0.2


@pytest.mark.parametrize("model", LENSES.values(), ids=LENSES)
def test_a_mesh_is_seen_by_the_rays_that_meet_it(model: CameraModel, tmp_path: Path) -> None:
    box = trimesh.creation.box([2.0, 2.0, 2.0])
    box.visual.face_colors = [255, 64, 0, 255]
    box.export(tmp_path / "cube.ply")
    camera, time_s = moving(model), 10.03
    pose = camera.world_from_camera.at(time_s)
    place = pose[:3, 3] + pose[:3, :3] @ (2.5, 0.8, 4.0)  # beside the axis, where lines are bent
    track = Trajectory(np.zeros(1), place[None], np.array([[1.0, 0, 0, 0]]))
    appearance = Appearance("cube", mesh=str(tmp_path / "cube.ply"))
    cube = Actor("cube", "Car", np.full(3, 2.0), track, 0.0, 99.0, False, appearance)
    u, v = pixel_grid(model)
    rays = camera_rays(camera, time_s, u, v).flat()
    meshes = MeshActors([cube])
    seen = meshes.hit_by_camera(camera, time_s, (u, v), rays, 1, 0.1, lambda actor: np.ones(3))
    truth = meshes.hit_by_rays(rays, 0.1)
    assert seen is not None and truth is not None and len(truth.ray) > 100
    whole = seen.ray[seen.share > 0.99]
    assert np.isin(whole, truth.ray).all() and np.isin(truth.ray, seen.ray[seen.share > 0.1]).all()
    shared = np.isin(seen.ray, whole)
    depth = dict(zip(truth.ray.tolist(), truth.t.tolist(), strict=True))
    beside = seen.t[shared] / [depth[ray] for ray in seen.ray[shared].tolist()] - 1
    assert (
        np.median(np.abs(beside)) < 1e-3 and np.abs(beside).max() < 0.1
    )  # a cell on an edge is the mean of both faces


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    path = tmp_path_factory.mktemp("street") / "log"
    street = build_street(seed=3, frames=3, width=96, height=54, cameras=(CAMERA,), lens="fisheye")
    write_log(street, path, jobs=1, progress=False)
    return open_log(path)


@needs_kernels
@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name != "surfel")) for name in SURFEL_METHODS]
)
def test_a_held_out_image_is_near_the_recorded_one(name: str, log: Log) -> None:
    """As near as through a pinhole, and much nearer than what a pinhole there would see."""
    one = SURFEL_METHODS[name]
    scene = finished(build_surfels(log, one.settings, SOURCES))
    renderer = DriveFrames(Renderer(one.backend(scene, log, SOURCES)), log.drive)
    recorded = log.image(CAMERA, FRAME) / 255
    model = log.drive.cameras[CAMERA].model
    shown = has_direction(model, *pixel_grid(model))

    def near(image: np.ndarray) -> float:  # type: ignore[type-arg]
        return psnr_from_error(float(((np.clip(image, 0, 1) - recorded)[shown] ** 2).mean()))

    through = near(renderer.camera(CAMERA, FRAME).rgb)
    straight = replace(log.drive.cameras[CAMERA], model=CameraModel(96, 54, model.fx, model.fy, model.cx, model.cy))
    drive = replace(log.drive, cameras={CAMERA: straight})
    as_pinhole = near(DriveFrames(renderer.renderer, drive).camera(CAMERA, FRAME).rgb)
    assert through > 19 and through > as_pinhole + 3
