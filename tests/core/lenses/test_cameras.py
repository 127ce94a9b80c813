"""Cameras with lenses that bend lines, and shutters that read columns: rays, what they see, and what bounds that."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from turning_drive import turning_drive

from unisim_blender.core.evaluation.recorded import actor_mask
from unisim_blender.core.geometry import (
    FloatArray,
    Trajectory,
    intersect_boxes,
    invert_pose,
    make_pose,
    quaternion_from_yaw,
)
from unisim_blender.core.lenses.lens import Lens
from unisim_blender.core.lenses.mei import Mei
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.lenses.registry import Pinhole
from unisim_blender.core.render.visibility import Reach, seen_by
from unisim_blender.core.sensors.camera import along_axis, camera_rays, pixel_directions, pixel_grid
from unisim_blender.core.sensors.rays import exposure_window
from unisim_blender.core.sensors.silhouettes import box_silhouette
from unisim_blender.core.sensors.unprojection import has_direction, image_mask, least_pixels_per_rad
from unisim_blender.core.world.drive import Actor, Appearance, Camera, CameraModel, RollingShutter
from unisim_blender.core.world.encoding import decode_sensor, encode_sensor
from unisim_blender.core.world.replay import WorldState

STRONG = OpenCVPinhole(k1=-0.28, k2=0.09, p1=0.003, p2=-0.002, k3=-0.01)
LENSES: dict[str, CameraModel] = {
    "strong": CameraModel(96, 60, 50.0, 52.0, 47.0, 31.0, lens=STRONG),
    "fisheye": CameraModel(96, 60, 30.0, 30.0, 48.0, 30.0, lens=OpenCVFisheye(k1=-0.01)),
    "over 180": CameraModel(96, 90, 22.0, 22.0, 48.0, 45.0, lens=OpenCVFisheye(max_angle_deg=115)),
    "mei": CameraModel(96, 60, 70.0, 70.0, 48.0, 30.0, lens=Mei(2.2, 0.1, 0.4, 0.0004, 0.0003)),
}
KEYS = np.linspace(0.0, 1.0, 6)


@pytest.fixture(params=LENSES)
def model(request: pytest.FixtureRequest) -> CameraModel:
    return LENSES[request.param]


def test_rays_are_those_that_the_lens_projects_to_the_pixels(model: CameraModel) -> None:
    u, v = pixel_grid(model)
    rays = pixel_directions(model, u, v)
    assert np.allclose(np.linalg.norm(rays, axis=-1), 1, atol=1e-12)
    at_u, at_v, valid = model.project(rays)
    shown = has_direction(model, u, v)
    assert valid[shown].all()
    assert np.abs(at_u - u)[shown].max() < 1e-6 and np.abs(at_v - v)[shown].max() < 1e-6
    mask = image_mask(model)
    assert np.array_equal(shown, np.ones_like(shown) if mask is None else mask)


def test_a_rays_bits_do_not_depend_on_what_else_is_asked_for(model: CameraModel) -> None:
    """Cells of the kept table, parts of an image, and single points."""
    for step in (1, 2, 3, 4):
        u, v = pixel_grid(model, step)
        whole = pixel_directions(model, u, v)
        part = pixel_directions(model, u[3:9, 4:11], v[3:9, 4:11])
        assert part.tobytes() == whole[3:9, 4:11].tobytes()
        # off the cells' centres, the same points are solved
        mixed_u, mixed_v = np.append(u[5], 3.14159), np.append(v[5], 2.71828)
        assert pixel_directions(model, mixed_u, mixed_v)[:-1].tobytes() == whole[5].tobytes()


def test_an_ideal_lens_gives_the_pinholes_rays() -> None:
    model = CameraModel(64, 40, 50.0, 52.0, 31.0, 22.0)
    grid = pixel_grid(model)
    plain = pixel_directions(model, *grid)
    for lens in (OpenCVPinhole(), Mei(0.0)):
        assert np.allclose(pixel_directions(replace(model, lens=lens), *grid), plain, atol=1e-14)
    assert np.allclose(Pinhole().unproject(np.stack([(grid[0] - 31) / 50, (grid[1] - 22) / 52], -1)), plain, atol=1e-15)
    assert replace(model, lens=OpenCVPinhole()).is_pinhole is False and model.is_pinhole


def test_a_resized_image_shows_the_same(model: CameraModel) -> None:
    small = model.resized(model.width // 2)
    u, v = pixel_grid(small)
    twice = pixel_directions(model, 2 * u, v * model.height / small.height)
    assert np.allclose(pixel_directions(small, u, v), twice, atol=1e-9)


def test_no_pixel_is_wider_than_the_coarsest(model: CameraModel) -> None:
    u, v = pixel_grid(model)
    rays, shown = pixel_directions(model, u, v), has_direction(model, u, v)
    apart = np.arccos(np.clip((rays[:, 1:] * rays[:, :-1]).sum(-1), -1, 1))[shown[:, 1:] & shown[:, :-1]]
    assert apart.max() <= 1 / least_pixels_per_rad(model) * 1.001


def random_trajectory(rng: np.random.Generator, spread_m: float, speed_m_s: float) -> Trajectory:
    steps = rng.normal(size=(6, 3)) * speed_m_s * 0.2
    positions = rng.uniform(-spread_m, spread_m, 3) + np.cumsum(steps, 0)
    return Trajectory(KEYS, positions, quaternion_from_yaw(rng.uniform(-3, 3) + np.cumsum(rng.normal(size=6) * 0.2)))


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("axis", ("rows", "columns"))
def test_no_actor_that_a_ray_meets_is_left_out(model: CameraModel, seed: int, axis: str) -> None:
    """Behind the camera's plane, too, through a lens that sees there."""
    rng = np.random.default_rng(seed)
    shutter = RollingShutter(float(rng.uniform(-0.08, 0.08)), float(rng.uniform(0, 1)), axis)
    camera = Camera("camera", replace(model, shutter=shutter), random_trajectory(rng, 3.0, 20.0), {0: 0.5})
    window = exposure_window(camera, 0.5)
    actors = [
        Actor(
            f"a{i:02d}",
            "Car",
            rng.uniform(0.3, 6.0, 3),
            random_trajectory(rng, 30.0, 15.0),
            0.0,
            1.0,
            True,
            Appearance("a"),
        )
        for i in range(60)
    ]
    ego = Trajectory(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]))
    cut = tuple(replace(a, world_from_actor=a.world_from_actor.between(*window)) for a in actors)
    seen = {actor.uid for actor in seen_by(WorldState(*window, ego, cut), camera, Reach()).actors}
    rays = camera_rays(camera, 0.5, *pixel_grid(camera.model))
    shown = has_direction(camera.model, *pixel_grid(camera.model)).reshape(-1)
    flat = rays.flat()
    assert window[0] <= flat.time_s.min() and flat.time_s.max() <= window[1]
    hit = set()
    for actor in actors:
        times, which = np.unique(flat.time_s, return_inverse=True)
        poses = invert_pose(actor.world_from_actor.at(times))[which.reshape(-1)]
        near, far = intersect_boxes(flat.origins, flat.directions, poses[:, None], actor.size_m[None])
        if (((near <= far) & (far > 0))[:, 0] & shown).any():
            hit.add(actor.uid)
            # and masks hold it, whichever way the shutter reads
            mask = actor_mask(camera, 0, [actor])
            assert np.array_equal(mask.reshape(-1), ((near <= far) & (far > 0))[:, 0] & shown)
    assert hit and hit <= seen, sorted(hit - seen)


def test_a_silhouette_holds_all_pixels_that_meet_the_box(model: CameraModel) -> None:
    rng = np.random.default_rng(7)
    u, v = pixel_grid(model)
    rays, shown = pixel_directions(model, u, v).reshape(-1, 3), has_direction(model, u, v).reshape(-1)
    loose = []
    for _ in range(120):
        yaw = np.array([rng.uniform(-3, 3)])
        pose = make_pose(rng.normal(size=(1, 3)) * rng.choice([2.0, 6.0, 20.0]), quaternion_from_yaw(yaw))[0]
        size = rng.uniform(0.3, 5.0, 3)
        near, far = intersect_boxes(np.zeros_like(rays), rays, invert_pose(pose)[None], size[None])
        hit = ((near <= far) & (far > 0))[:, 0] & shown
        silhouette = box_silhouette(model, pose, size)
        if not hit.any():
            continue
        assert silhouette is not None
        at_u, at_v = u.reshape(-1)[hit], v.reshape(-1)[hit]
        assert silhouette.left <= at_u.min() and at_u.max() <= silhouette.right
        assert silhouette.top <= at_v.min() and at_v.max() <= silhouette.bottom
        if 20 < at_u.min() and at_u.max() < model.width - 20 and shown.all():
            loose.append(at_u.min() - silhouette.left)
    assert len(loose) < 8 or np.median(loose) < 4  # a few boxes at the edge of a lens's domain say nothing


def test_corners_do_not_bound_a_silhouette() -> None:
    """Why edges are sampled: a long wall beside a wide lens bulges beyond its corners."""
    model = LENSES["over 180"]
    pose = np.eye(4)
    pose[:3, 3] = (0.0, 3.0, 1.0)
    size = np.array([40.0, 0.2, 1.0])
    silhouette = box_silhouette(model, pose, size)
    corners = np.stack(np.meshgrid([-20, 20], [2.9, 3.1], [0.5, 1.5], indexing="ij"), -1).reshape(8, 3)
    _, v, valid = model.project(corners)
    assert valid.all() and silhouette is not None
    assert silhouette.bottom > v.max() + 10


@pytest.mark.parametrize("reverse", (False, True))
@pytest.mark.parametrize("axis", ("rows", "columns"))
def test_lines_are_exposed_from_start_to_end(axis: str, reverse: bool) -> None:
    shutter = RollingShutter.of_exposure(10.01, 10.05, 10.03, axis, reverse)
    assert shutter.exposure_s(10.03) == pytest.approx((10.01, 10.05))
    camera = turning_drive().cameras["front"]
    camera = replace(camera, model=replace(camera.model, width=40, height=30, shutter=shutter))
    rays = camera_rays(camera, 10.03, *pixel_grid(camera.model))
    times = rays.time_s if axis == "columns" else rays.time_s.T
    count = 40 if axis == "columns" else 30
    wanted = 10.01 + 0.04 * (np.arange(count) + 0.5) / count
    assert np.allclose(times, wanted[::-1] if reverse else wanted)
    # every ray starts where the camera is then
    assert np.allclose(rays.origins, camera.world_from_camera.at(rays.time_s.reshape(-1))[:, :3, 3].reshape(30, 40, 3))
    u, v = np.arange(40)[None] + 0.5, np.arange(30)[:, None] + 0.5
    axis_then = camera.world_from_camera.at(10.03)[:3, 2]
    assert np.allclose(along_axis(camera, 10.03, u, v), rays.directions @ axis_then, atol=1e-12)


def test_a_camera_is_sent_with_lens_and_shutter(model: CameraModel) -> None:
    camera = replace(
        turning_drive().cameras["front"], model=replace(model, shutter=RollingShutter(0.03, 0.2, "columns"))
    )
    sent = decode_sensor(encode_sensor(camera, 0.0, 1.0))
    assert isinstance(sent, Camera) and sent.model == camera.model
    assert CameraModel.from_dict(camera.model.to_dict()) == camera.model


def test_a_pinholes_json_is_as_it_was() -> None:
    model = CameraModel(4, 3, 2.0, 2.0, 2.0, 1.5, RollingShutter(0.03, 1.0))
    assert model.to_dict() == {
        "width": 4, "height": 3, "fx": 2.0, "fy": 2.0, "cx": 2.0, "cy": 1.5,
        "shutter": {"duration_s": 0.03, "reference": 1.0},
    }  # fmt: skip


@pytest.mark.parametrize("lens", [STRONG, OpenCVFisheye(), Mei(1.5)])
def test_points_that_are_none_have_no_place(lens: Lens) -> None:
    model = CameraModel(96, 60, 50.0, 50.0, 48.0, 30.0, lens=lens)
    points: FloatArray = np.array([[np.nan, 0, 1], [np.inf, 0, 1], [0, 0, 0], [1e300, 0, 1], [1.0, 1.0, -1e-300]])
    u, v, valid = model.project(points)
    assert np.isnan(u[~valid]).all() and np.isnan(v[~valid]).all() and not valid[:3].any()
    assert np.isfinite(u[valid]).all()
    assert np.isfinite(pixel_directions(model, np.array([1e12, -1e12, 48.0]), np.array([0.0, 1e12, 30.0]))).all()
