"""Corrections of cameras: training and the finished scene see along the same rays, and frames between learn
from both sides."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from turning_drive import turning_drive

from unisim_blender.core.ops.ray_segments import RayBatch
from unisim_blender.core.sensors.camera import along_axis, camera_rays, distinct, pixel_grid
from unisim_blender.core.training.batches.sweeps import ray_batch
from unisim_blender.core.training.poses import CameraPoses
from unisim_blender.core.world.drive import RollingShutter


def test_the_finished_camera_sees_along_the_rays_that_training_saw_along() -> None:
    recorded = turning_drive().cameras["front"]
    # rows at other times than the image's would see the poses between two keys
    camera = replace(recorded, model=replace(recorded.model, shutter=RollingShutter()))
    frames = sorted(camera.time_s)[::2]
    poses = CameraPoses([np.array([camera.time_s[f] for f in frames])])
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        poses.shift_m.copy_(0.05 * torch.randn(poses.shift_m.shape, generator=generator))
        poses.turn_rad.copy_(0.002 * torch.randn(poses.turn_rad.shape, generator=generator))
    after = poses.corrected(camera, 0)
    for frame in frames:
        u, v = np.array([0.5, 3.5, 7.5]), np.array([0.5, 2.5, 1.5])
        before, wanted = (camera_rays(one, camera.time_s[frame], u, v) for one in (camera, after))
        rotation = camera.world_from_camera.at(camera.time_s[frame])[:3, :3]
        rays = ray_batch(before.origins, before.directions, before.time_s)
        got = poses(rays, torch.zeros(1, dtype=torch.long), torch.as_tensor(rotation)[None], learn=True)
        assert np.abs(got.origins.detach().numpy() - wanted.origins).max() < 1e-5
        assert np.abs(got.directions.detach().numpy() - wanted.directions).max() < 1e-5


def test_a_frame_between_two_is_corrected_as_both_are() -> None:
    poses = CameraPoses([np.array([0.0, 0.2, 0.4]), np.array([0.1])])
    with torch.no_grad():
        poses.turn_rad[0, :, 0] = torch.tensor([0.0, 1e-3, 3e-3])
        poses.shift_m[1, 0] = torch.tensor([1.0, 2.0, 3.0])
    camera, time = torch.tensor([0, 0, 1, 1, 0]), torch.tensor([0.3, 0.2, 0.1, 9.0, -50.0], dtype=torch.float64)
    shift, turn = poses.at(camera, time)
    turn[0].sum().backward()
    shift, turn = shift.detach(), turn.detach()
    assert abs(float(turn[0, 0]) - 2e-3) < 2e-4
    assert abs(float(turn[1, 0]) - 1e-3) < 4e-4
    assert torch.equal(shift[2:4], torch.tensor([[1.0, 2.0, 3.0]] * 2)), "a camera of one image is corrected as a whole"
    assert float(turn[4, 0]) == 0, "long before the first image it is as in the first"
    grad = poses.turn_rad.grad
    assert grad is not None and float(grad[0, 1, 0]) > 0.4 and float(grad[0, 2, 0]) > 0.4


def test_no_gradient_where_cameras_do_not_learn() -> None:
    poses = CameraPoses([np.array([0.0, 0.1])])
    rays = RayBatch(torch.zeros(2, 3), torch.eye(3)[:2], torch.zeros(2, dtype=torch.float64))
    pose = torch.eye(3)[None]
    assert not poses(rays, torch.zeros(1, dtype=torch.long), pose, learn=False).directions.requires_grad
    assert poses(rays, torch.zeros(1, dtype=torch.long), pose, learn=True).directions.requires_grad


@pytest.mark.parametrize("shutter", (RollingShutter(), RollingShutter(0.03, 0.4)))
def test_rays_are_pixels_directions_turned_by_their_rows_poses(shutter: RollingShutter) -> None:
    recorded = turning_drive().cameras["front"]
    camera = replace(recorded, model=replace(recorded.model, shutter=shutter))
    time_s = sorted(camera.time_s.values())[1]
    u, v = pixel_grid(camera.model)
    rays = camera_rays(camera, time_s, u, v)
    local = np.stack(
        [(u - camera.model.cx) / camera.model.fx, (v - camera.model.cy) / camera.model.fy, np.ones_like(u)], -1
    )
    local /= np.linalg.norm(local, axis=-1, keepdims=True)
    times = time_s + shutter.duration_s * (v / camera.model.height - shutter.reference)
    poses = camera.world_from_camera.at(times.reshape(-1)).reshape(*v.shape, 4, 4)
    assert np.abs(poses[0, 0] - poses[-1, 0]).max() > 1e-3 or not shutter.duration_s
    assert np.array_equal(rays.time_s, times) and np.array_equal(rays.origins, poses[..., :3, 3])
    assert np.abs(rays.directions - np.einsum("...ij,...j->...i", poses[..., :3, :3], local)).max() < 1e-15
    # rays drawn one by one are the grid's, to the bit
    some = np.random.default_rng(0).integers(0, v.size, 50)
    alone = camera_rays(camera, time_s, u.reshape(-1)[some], v.reshape(-1)[some])
    assert np.array_equal(alone.directions, rays.directions.reshape(-1, 3)[some])
    axis = camera.world_from_camera.at(time_s)[:3, 2]
    assert np.abs(along_axis(camera, time_s, u[:1], v[:, :1]) - rays.directions @ axis).max() < 1e-15


@pytest.mark.parametrize(
    "values", ([0.5, 3.5, 0.5, 2.5], [0.5, 0.75, 0.5], [7.0], [], [1e9, 1.0, 1e9], [0.1, 1.1, 2.1, 0.1], [np.nan, 1.0])
)
def test_distinct_values_are_those_that_sorting_finds(values: list[float]) -> None:
    found, which = distinct(np.array(values))
    wanted = np.unique(np.array(values), return_inverse=True)
    assert np.array_equal(found, wanted[0], equal_nan=True) and np.array_equal(which, wanted[1])
