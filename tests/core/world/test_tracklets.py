"""Actors' poses and boxes as tensors, against the float64 types of geometry.py."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from analytic_scene import drive_of
from torch import Tensor

from unisim_blender.core import native
from unisim_blender.core.geometry import (
    FloatArray,
    Trajectory,
    intersect_boxes,
    invert_pose,
    matrix_from_quaternion,
    quaternion_from_yaw,
)
from unisim_blender.core.model import tracklets as module
from unisim_blender.core.model.tracklets import (
    SMOOTH_S,
    Tracklets,
    quaternion_from_rotation,
    rotation_from_6d,
    rotation_from_quaternion,
    slerp,
)
from unisim_blender.core.ops.near_spheres import near_spheres, near_spheres_reference
from unisim_blender.core.sensors.bounds import BIN_S, Bounds
from unisim_blender.core.world.drive import Actor, Appearance
from unisim_blender.core.world.replay import with_windows


def unit_quaternions(n: int, seed: int) -> FloatArray:
    q = np.random.default_rng(seed).normal(size=(n, 4))
    # half turns about the axes: where the usual formula divides by zero
    q[:6] = [[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [1, 0, 0, 0], [1e-5, 1, 0, 0], [0, 0.6, 0.8, 0]]
    return np.asarray(q / np.linalg.norm(q, axis=1, keepdims=True))


def random_actors(n: int, seed: int) -> list[Actor]:
    """Moving and still ones, of one key and of many, present for a part of 0..4 s."""
    rng = np.random.default_rng(seed)
    actors = []
    for i in range(n):
        keys = 1 if i % 3 == 0 else int(rng.integers(2, 9))
        times = rng.uniform(0, 1) + np.cumsum(rng.uniform(0.2, 0.6, keys))
        positions = rng.uniform([-20, -20, 0], [20, 20, 2], 3) + np.cumsum(rng.normal(0, 0.7, (keys, 3)), 0)
        trajectory = Trajectory(
            times, positions, quaternion_from_yaw(rng.uniform(-3, 3) + np.cumsum(rng.normal(0, 0.3, keys)))
        )
        span = np.sort(rng.uniform(-0.5, 4.5, 2))
        actors.append(
            Actor(
                f"a{i:02}",
                "Car",
                rng.uniform(0.4, 6, 3),
                trajectory,
                span[0],
                span[1],
                keys > 1,
                Appearance(f"a{i:02}"),
            )
        )
    return actors


def test_6d_gives_rotations() -> None:
    generator = torch.Generator().manual_seed(0)
    r = torch.randn(500, 6, generator=generator, dtype=torch.float64)
    # nearly parallel columns, and ones of very unequal length
    r[:100, 3:] = r[:100, :3] + 1e-4 * r[:100, 3:]
    r[100:200, :3] *= 1e-6
    m = rotation_from_6d(r)
    torch.testing.assert_close(m @ m.mT, torch.eye(3, dtype=torch.float64).expand(500, 3, 3), atol=1e-9, rtol=0)
    torch.testing.assert_close(torch.linalg.det(m), torch.ones(500, dtype=torch.float64))
    torch.testing.assert_close(rotation_from_6d(torch.cat([m[..., 0], m[..., 1]], -1)), m)


def test_6d_of_degenerate_columns_is_finite_and_has_gradients() -> None:
    r = torch.tensor([[0.0, 0, 0, 0, 0, 0], [1, 0, 0, 2, 0, 0], [0, 0, 1e-20, 0, 1, 0]], requires_grad=True)
    m = rotation_from_6d(r)
    m.sum().backward()
    assert bool(torch.isfinite(m).all()) and r.grad is not None and bool(torch.isfinite(r.grad).all())


def test_quaternions_there_and_back() -> None:
    q = torch.tensor(unit_quaternions(300, 1))
    m = rotation_from_quaternion(q)
    np.testing.assert_allclose(m.numpy(), matrix_from_quaternion(q.numpy()), atol=1e-14)
    back = quaternion_from_rotation(m)
    torch.testing.assert_close((back * q).sum(-1).abs(), torch.ones(300, dtype=torch.float64))
    single = quaternion_from_rotation(m.float())
    torch.testing.assert_close(
        (single.double() * q).sum(-1).abs(), torch.ones(300, dtype=torch.float64), atol=1e-6, rtol=0
    )


def test_quaternion_from_rotation_has_true_gradients() -> None:
    q = torch.tensor(unit_quaternions(12, 2)[6:])
    turn = torch.cat([rotation_from_quaternion(q)[..., 0], rotation_from_quaternion(q)[..., 1]], -1).requires_grad_()
    assert torch.autograd.gradcheck(lambda r: quaternion_from_rotation(rotation_from_6d(r)), (turn,), atol=1e-6)


def test_slerp_of_equal_near_and_opposite_quaternions() -> None:
    a = torch.tensor(unit_quaternions(60, 3)).requires_grad_()
    tiny = torch.tensor(np.random.default_rng(4).normal(0, 1e-9, (60, 4)))
    b = torch.where(torch.arange(60)[:, None] % 3 == 0, a.detach(), -(a.detach() + tiny))
    u = torch.linspace(-0.5, 1.5, 60, dtype=torch.float64)
    q = slerp(a, b, u)
    torch.testing.assert_close(q.detach(), a.detach(), atol=1e-7, rtol=0)
    q.sum().backward()
    assert a.grad is not None and bool(torch.isfinite(a.grad).all())


@pytest.mark.parametrize("refine", (False, True))
def test_poses_are_the_trajectories(refine: bool) -> None:
    actors = random_actors(12, 5)
    tracklets = Tracklets(actors, refine=refine)
    times = np.r_[np.random.default_rng(6).uniform(-1, 5, 40), actors[1].world_from_actor.times_s]
    actor = torch.arange(12).repeat_interleave(len(times))
    with torch.no_grad():
        position, rotation = tracklets.poses_at(actor, torch.tensor(np.tile(times, 12)), tracklets.keys())
    expected = np.concatenate([a.world_from_actor.at(times) for a in actors])
    # beyond its ends a trajectory is carried on, so errors grow with the distance
    far = 1 + np.abs(expected[:, :3, 3])
    assert (np.abs(position.numpy() - expected[:, :3, 3]) / far).max() < 1e-5
    np.testing.assert_allclose(rotation.numpy(), expected[:, :3, :3], atol=2e-4 if refine else 5e-5)


def rays(n: int, seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    o, aim = rng.uniform([-25, -25, 0], [25, 25, 3], (2, n, 3))
    d = aim - o
    d[: n // 5] = np.eye(3)[rng.integers(0, 2, n // 5)]
    return o, d / np.linalg.norm(d, axis=1, keepdims=True), rng.uniform(-1, 5, n)


@pytest.mark.parametrize("chosen", (None, [0, 2, 3, 5, 6, 8, 11, 12]))
def test_hits_against_every_ray_and_box(chosen: list[int] | None) -> None:
    actors = random_actors(14, 7)
    tracklets = Tracklets(actors)
    o, d, time = rays(3000, 8)
    among = None if chosen is None else torch.tensor(chosen)
    hits = tracklets.hits(torch.tensor(o).float(), torch.tensor(d).float(), torch.tensor(time), 0.5, among)
    poses = np.stack([invert_pose(a.world_from_actor.at(time)) for a in actors], 1)
    near, far = intersect_boxes(o, d, poses, np.stack([a.size_m for a in actors]))
    near = np.maximum(near, 0.5)
    there = np.stack([a.present(time) for a in actors], 1)
    hit = (far > near) & there
    if chosen is not None:
        hit[:, [i for i in range(14) if i not in chosen]] = False
    got = np.zeros_like(hit)
    got[hits.ray.numpy(), hits.actor.numpy()] = True
    grazing = np.abs(far - near) < 1e-3
    np.testing.assert_array_equal(got | grazing, hit | grazing)
    assert hit.sum() > 50
    pairs = hits.ray.numpy(), hits.actor.numpy()
    np.testing.assert_allclose(hits.t_near.numpy(), near[pairs], atol=2e-3)
    np.testing.assert_allclose(hits.t_far.numpy(), far[pairs], atol=2e-3)
    # the ray in the box's own axes
    local = np.einsum("pij,pj->pi", poses[pairs][:, :3, :3], o[pairs[0]]) + poses[pairs][:, :3, 3]
    np.testing.assert_allclose(hits.origins.numpy(), local, atol=1e-4)
    np.testing.assert_allclose(hits.world_from_box.mT.numpy(), poses[pairs][:, :3, :3], atol=1e-5)


def moving_box(speed: float) -> Tracklets:
    trajectory = Trajectory(
        np.array([0.0, 1.0]), np.array([[10.0, 0, 0], [10, speed, 0]]), np.tile([1.0, 0, 0, 0], (2, 1))
    )
    return Tracklets([Actor("a", "Car", np.array([2.0, 2, 2]), trajectory, 0.2, 0.8, True, Appearance("a"))])


def one_ray(tracklets: Tracklets, y: float, time: float) -> int:
    origin, direction = torch.tensor([[0.0, float(y), 0.0]]), torch.tensor([[1.0, 0.0, 0.0]])
    return len(tracklets.hits(origin, direction, torch.tensor([time], dtype=torch.float64), 0.5).ray)


def test_a_box_is_met_where_it_is_at_the_rays_own_time() -> None:
    tracklets = moving_box(30.0)
    for time in np.linspace(0.21, 0.79, 20):
        assert one_ray(tracklets, 30 * time + 0.9, time) == 1 and one_ray(tracklets, 30 * time + 1.1, time) == 0


def test_presence_includes_both_its_ends() -> None:
    tracklets = moving_box(0.0)
    expected = [0, 1, 1, 1, 0]
    assert [one_ray(tracklets, 0.0, time) for time in (0.2 - 1e-9, 0.2, 0.5, 0.8, 0.8 + 1e-9)] == expected


def test_no_actors() -> None:
    tracklets = Tracklets([])
    hits = tracklets.hits(torch.zeros(4, 3), torch.ones(4, 3), torch.zeros(4, dtype=torch.float64), 0.5)
    assert len(hits.ray) == 0 and hits.directions.shape == (0, 3)


def test_refinement_moves_what_stands_as_one_and_what_moves_key_by_key() -> None:
    keys = np.array([0.0, 1.0, 2.0])
    trajectory = Trajectory(keys, np.zeros((3, 3)), np.tile([1.0, 0, 0, 0], (3, 1)))
    actors = [
        Actor(uid, "Car", np.ones(3), trajectory, 0, 2, moving, Appearance(uid))
        for uid, moving in (("a", True), ("b", False))
    ]
    tracklets = Tracklets(actors, refine=True)
    with torch.no_grad():
        tracklets.shift_m[:, 1] = torch.tensor([0.3, 0.0, 0.0])
        tracklets.turn_6d[:, 1, 1] = 0.3
        positions, quaternions = tracklets.keys()
    assert positions[0, :, 0].tolist() == pytest.approx([0, 0.3, 0], abs=1e-5), "keys a second apart do not share"
    assert positions[1, :, 0].tolist() == pytest.approx([0.1] * 3)

    def yaw(q: Tensor) -> list[float]:
        m = rotation_from_quaternion(q)
        return torch.atan2(m[:, 1, 0], m[:, 0, 0]).tolist()

    assert yaw(quaternions[0]) == pytest.approx([0, np.arctan(0.3), 0], abs=1e-5)
    assert yaw(quaternions[1]) == pytest.approx([np.arctan(0.1)] * 3, abs=1e-6)


def test_keys_that_lie_close_are_corrected_together() -> None:
    """What one key learns its neighbours take over, by a Gaussian in time; keys that only pad a
    tracklet count nothing."""
    times = np.array([0.0, 0.1, 0.2, 0.3, 0.9])
    trajectory = Trajectory(times, np.zeros((5, 3)), np.tile([1.0, 0, 0, 0], (5, 1)))
    short = Trajectory(times[:2], np.zeros((2, 3)), np.tile([1.0, 0, 0, 0], (2, 1)))
    actors = [
        Actor(uid, "Car", np.ones(3), w, 0, 1, True, Appearance(uid)) for uid, w in (("a", trajectory), ("b", short))
    ]
    tracklets = Tracklets(actors, refine=True)
    with torch.no_grad():
        tracklets.shift_m[0, :, 0] = torch.tensor([0.1, -0.1, 0.1, -0.1, 0.3])
        tracklets.shift_m[1, :, 0] = torch.tensor([0.2, 0.2, 5.0, 5.0, 5.0])
        x = tracklets.keys()[0][..., 0].tolist()
    w = np.exp(-(((times[:, None] - times) / SMOOTH_S) ** 2) / 2)
    assert x[0] == pytest.approx((w @ [0.1, -0.1, 0.1, -0.1, 0.3] / w.sum(1)).tolist(), abs=1e-6)
    assert np.abs(x[0][:4]).max() < 0.06, "what goes to and fro cancels"
    assert x[1][:2] == pytest.approx([0.2, 0.2])


def test_refinement_has_gradients_from_where_a_ray_meets_a_box() -> None:
    actors = random_actors(5, 9)
    tracklets = Tracklets(actors, refine=True)
    o, d, time = rays(600, 10)
    hits = tracklets.hits(torch.tensor(o).float(), torch.tensor(d).float(), torch.tensor(time), 0.5)
    (hits.origins.square().sum() + hits.directions[:, 0].sum()).backward()
    for parameter in tracklets.parameters():
        assert parameter.grad is not None and bool(torch.isfinite(parameter.grad).all())
        assert bool((parameter.grad != 0).any())


def test_an_actor_that_was_always_there_has_bounds() -> None:
    always = replace(random_actors(2, 3)[1], start_s=-np.inf, end_s=np.inf)
    gone = replace(always, uid="gone", start_s=-9.0, end_s=-8.0)
    drive = drive_of([always, gone])
    actors = with_windows(drive, drive.actors.values())
    bounds, index = Bounds(actors), [a.uid for a in actors].index(always.uid)
    radii = bounds.radii[int((0.0 - bounds.first_s) // BIN_S) : int((0.5 - bounds.first_s) // BIN_S) + 1]
    assert (radii[:, index] > 0).all()
    assert (radii[:, 1 - index] < 0).all()


@pytest.mark.skipif(native.library() is None, reason="the compiled kernels are not built")
@pytest.mark.parametrize("boxes", (0, 1, 37))
def test_compiled_spheres(boxes: int) -> None:
    r = torch.Generator().manual_seed(boxes)
    o, d = (
        20 * torch.randn(900, 3, generator=r),
        torch.nn.functional.normalize(torch.randn(900, 3, generator=r), dim=-1),
    )
    centres, radii = 20 * torch.randn(5, boxes, 3, generator=r), 6 * torch.rand(5, boxes, generator=r) - 1
    bins = torch.randint(-1, 5, (900,), generator=r)
    found = near_spheres(o, d, bins, centres, radii)
    assert found.dtype == torch.bool and found.shape == (900, boxes)
    assert not bool(found[bins < 0].any()) and bool(found.any()) == (boxes > 0)
    # whether a ray just touches a sphere is rounding's choice
    enlarged, shrunk = (
        near_spheres_reference(o.double(), d.double(), bins, centres.double(), radii.double() + by)
        for by in (1e-4, -1e-4)
    )
    assert not bool((found & ~enlarged).any()) and not bool((shrunk & ~found).any())


def test_keys_are_worked_out_once_where_they_are_given(monkeypatch: pytest.MonkeyPatch) -> None:
    tracklets, keys, asked = Tracklets(random_actors(6, 3), refine=True), Tracklets.keys, 0

    def counted(self: Tracklets) -> tuple[Tensor, Tensor]:
        nonlocal asked
        asked += 1
        return keys(self)

    monkeypatch.setattr(Tracklets, "keys", counted)
    r = torch.Generator().manual_seed(4)
    d = torch.nn.functional.normalize(torch.randn(2000, 3, generator=r), dim=-1)
    rays = torch.zeros(2000, 3), d, 4 * torch.rand(2000, generator=r, dtype=torch.float64), 0.5
    plain = [tracklets.hits(*rays) for _ in range(2)]
    assert len(plain[0].ray) > 0 and asked == 2
    worked_out = tracklets.keys()
    given = [tracklets.hits(*rays, keys=worked_out) for _ in range(2)]
    assert asked == 3
    assert all(torch.equal(a.origins, b.origins) for a in plain for b in given)


def test_keys_of_long_drives_are_corrected_as_those_of_short_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neighbours in time alone, and none of what only pads: the same poses and gradients."""
    actors = random_actors(12, 3)
    found = []
    for most in (module.DENSE_KEYS, 2):
        monkeypatch.setattr(module, "DENSE_KEYS", most)
        tracklets = Tracklets(actors, refine=True)
        assert tracklets.smoothing.dense == (most > 2)
        with torch.no_grad():
            for seed, parameter in enumerate((tracklets.shift_m, tracklets.turn_6d)):
                parameter.add_(0.1 * torch.randn(parameter.shape, generator=torch.Generator().manual_seed(seed)))
        real = torch.isfinite(tracklets.times)
        keys = [part[real] for part in tracklets.keys()]
        (keys[0].square().sum() + keys[1][:, 1:].square().sum()).backward()
        assert tracklets.shift_m.grad is not None and tracklets.turn_6d.grad is not None
        found.append([*keys, tracklets.shift_m.grad[real], tracklets.turn_6d.grad[real]])
    for dense, near in zip(*found, strict=True):
        torch.testing.assert_close(near, dense, rtol=1e-4, atol=1e-5)
