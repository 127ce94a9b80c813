"""What an exposure can see: nothing that one of its rays meets is left out, and what is far out of view is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unisim_blender.core.geometry import (
    FloatArray,
    Trajectory,
    intersect_boxes,
    invert_pose,
    make_pose,
    quaternion_from_yaw,
)
from unisim_blender.core.render.visibility import Reach, seen_by
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.rays import Rays, exposure_window
from unisim_blender.core.world.drive import Actor, Appearance, Camera, CameraModel, Lidar, LidarModel, RollingShutter
from unisim_blender.core.world.replay import WorldState

KEYS = np.linspace(0.0, 1.0, 6)


def random_trajectory(rng: np.random.Generator, spread_m: float, speed_m_s: float) -> Trajectory:
    """A trajectory that bends and turns at every key."""
    steps = rng.normal(size=(6, 3)) * speed_m_s * 0.2
    positions = rng.uniform(-spread_m, spread_m, 3) + np.cumsum(steps, 0)
    return Trajectory(KEYS, positions, quaternion_from_yaw(rng.uniform(-3, 3) + np.cumsum(rng.normal(size=6) * 0.2)))


def random_actor(rng: np.random.Generator, uid: str) -> Actor:
    return Actor(
        uid, "Car", rng.uniform(0.3, 6.0, 3), random_trajectory(rng, 30.0, 15.0), 0.0, 1.0, True, Appearance(uid)
    )


def is_hit(actor: Actor, rays: Rays) -> bool:
    """Whether a ray meets the actor's box at the ray's own time."""
    times, which = np.unique(rays.time_s, return_inverse=True)
    poses = invert_pose(actor.world_from_actor.at(times))[which.reshape(-1)]
    near, far = intersect_boxes(rays.origins, rays.directions, poses[:, None], actor.size_m[None])
    return bool(((near <= far) & (far > 0)).any())


def state_of(actors: list[Actor], window: tuple[float, float]) -> WorldState:
    ego = Trajectory(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]))
    cut = tuple(replace(a, world_from_actor=a.world_from_actor.between(*window)) for a in actors)
    return WorldState(*window, ego, cut)


@pytest.mark.parametrize("seed", range(6))
def test_no_actor_that_a_cameras_ray_meets_is_left_out(seed: int) -> None:
    """Cameras that drive, turn and expose their rows one after the other, downwards or upwards."""
    rng = np.random.default_rng(seed)
    shutter = RollingShutter(float(rng.uniform(-0.08, 0.08)), float(rng.uniform(0, 1)))
    (fx, fy), (cx, cy) = rng.uniform(15, 80, 2), rng.uniform(10, 35, 2)
    model = CameraModel(48, 32, fx, fy, cx, cy, shutter)
    camera = Camera("camera", model, random_trajectory(rng, 3.0, 20.0), {0: 0.5})
    window = exposure_window(camera, 0.5)
    actors = [random_actor(rng, f"a{i:02d}") for i in range(60)]
    seen = {actor.uid for actor in seen_by(state_of(actors, window), camera, Reach()).actors}
    rays = camera_rays(camera, 0.5, *pixel_grid(model)).flat()
    hit = {actor.uid for actor in actors if is_hit(actor, rays)}
    assert hit and hit <= seen, sorted(hit - seen)
    assert len(seen) < 50, "hardly anything is left out"


@pytest.mark.parametrize("seed", range(3))
def test_no_actor_that_a_beam_meets_within_its_range_is_left_out(seed: int) -> None:
    rng = np.random.default_rng(seed)
    model = LidarModel(np.radians(rng.uniform(-25, 15, 8)), np.zeros(8), columns=180, max_range_m=25.0)
    lidar = Lidar("lidar", model, random_trajectory(rng, 3.0, 20.0), {0: 0.5})
    window = exposure_window(lidar, 0.5)
    actors = [random_actor(rng, f"a{i:02d}") for i in range(60)]
    seen = {actor.uid for actor in seen_by(state_of(actors, window), lidar, Reach()).actors}
    rays = lidar_rays(lidar, 0.5).flat()
    for actor in actors:
        times, which = np.unique(rays.time_s, return_inverse=True)
        poses = invert_pose(actor.world_from_actor.at(times))[which.reshape(-1)]
        near, far = intersect_boxes(rays.origins, rays.directions, poses[:, None], actor.size_m[None])
        if bool(((near <= far) & (far > 0) & (near < 25.0)).any()):
            assert actor.uid in seen
    assert len(seen) < 60


def frustum_meets(model: CameraModel, pose: FloatArray, actor: Actor) -> bool:
    """Whether a ray within the image meets a box that stands still; by many rays."""
    u, v = np.meshgrid(np.linspace(0, model.width, 200), np.linspace(0, model.height, 140))
    camera = Camera("camera", model, Trajectory.from_poses(np.zeros(1), pose[None]), {0: 0.5})
    return is_hit(actor, camera_rays(camera, 0.5, u, v).flat())


def test_little_is_kept_that_no_ray_meets() -> None:
    """Of boxes that stand still before a camera that does, at most a twentieth is kept beside those that rays meet."""
    rng = np.random.default_rng(0)
    model, kept_in_vain, hit_boxes = CameraModel(48, 32, 40.0, 40.0, 24.0, 16.0), 0, 0
    pose = make_pose(np.zeros(3), np.array([1.0, 0, 0, 0]))
    camera = Camera("camera", model, Trajectory.from_poses(np.zeros(1), pose[None]), {0: 0.5})
    actors = []
    for i in range(300):
        place = Trajectory(np.zeros(1), rng.uniform(-30, 30, (1, 3)), quaternion_from_yaw(rng.uniform(-3, 3, 1)))
        actors.append(Actor(f"a{i:03d}", "Car", rng.uniform(0.5, 4.0, 3), place, 0.0, 1.0, False, Appearance("a")))
    seen = {actor.uid for actor in seen_by(state_of(actors, (0.5, 0.5)), camera, Reach()).actors}
    for actor in actors:
        in_view = frustum_meets(model, pose, actor)
        hit_boxes += in_view
        kept_in_vain += actor.uid in seen and not in_view
        assert actor.uid in seen or not in_view
    assert hit_boxes > 15 and kept_in_vain <= 300 / 20, (hit_boxes, kept_in_vain)
