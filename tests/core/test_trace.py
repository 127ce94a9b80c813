"""Rays through scenes whose distances are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from analytic_scene import Stage, analytic_scene, block, drive_of, empty, ground, sphere, still, union, wall

from unisim_blender.core.drive import Box
from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_yaw

LEVEL = np.array([1.0, 0, 0, 0])
EYE = np.array([-20.0, 0.0, 1.6])


def fan(n: int, seed: int = 0, spread: float = 0.3) -> FloatArray:
    """Directions about +x."""
    d = np.random.default_rng(seed).normal([1, 0, 0], [0, spread, spread / 2], (n, 3))
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


@pytest.mark.parametrize("angle_deg", (60.0, 20.0, 6.0))
def test_depth_of_a_plane(angle_deg: float) -> None:
    stage = Stage(analytic_scene(ground, {}), drive_of([]))
    yaw = np.radians(np.arange(0, 360, 15))
    slope = np.radians(angle_deg)
    d = np.stack([np.cos(slope) * np.cos(yaw), np.cos(slope) * np.sin(yaw), np.full_like(yaw, -np.sin(slope))], -1)
    traced = stage.trace([0.0, 0, 1.6], d)
    exact = 1.6 / np.sin(slope)
    np.testing.assert_allclose(traced.depth_m, exact, rtol=2e-3)
    np.testing.assert_allclose(traced.opacity, 1, atol=1e-3)


def test_depth_of_a_sphere() -> None:
    stage = Stage(analytic_scene(sphere([4.0, 1.0, 2.0], 1.5), {}), drive_of([]))
    d = fan(400, spread=0.06)
    to = np.array([4.0, 1.0, 2.0]) - EYE
    along = d @ to
    off = np.sqrt(to @ to - along**2)
    traced = stage.trace(EYE, d, fine=8.0)
    inside, outside = off < 1.3, off > 1.6
    assert inside.sum() > 30 and outside.sum() > 100
    exact = along - np.sqrt(np.maximum(1.5**2 - off**2, 0))
    np.testing.assert_allclose(traced.depth_m[inside], exact[inside], atol=0.02)
    assert float(traced.opacity[inside].min()) > 0.99 and float(traced.opacity[outside].max()) < 0.01


def test_a_box_inside_a_moving_turned_actor() -> None:
    size = np.array([5.0, 2.4, 2.0])
    keys = np.array([0.0, 0.5])
    positions = np.array([[2.0, -1.0, 1.2], [8.0, 3.0, 1.2]])
    way = Trajectory(keys, positions, quaternion_from_yaw(np.array([0.3, 1.1])))
    actor = still("car", [0, 0, 0], size, world_from_actor=way, is_moving=True)
    inner = np.array([4.0, 1.8, 1.4])
    stage = Stage(analytic_scene(empty, {"car": (block(inner), size)}), drive_of([actor]))
    rng = np.random.default_rng(3)
    time = rng.uniform(0, 0.5, 300)
    poses = way.at(time)
    aim = np.einsum("nij,nj->ni", poses[:, :3, :3], rng.uniform(-0.45, 0.45, (300, 3)) * inner) + poses[:, :3, 3]
    traced = stage.trace(EYE, aim - EYE, time)
    from unisim_blender.core.geometry import intersect_boxes, invert_pose

    d = (aim - EYE) / np.linalg.norm(aim - EYE, axis=1, keepdims=True)
    near, _ = intersect_boxes(np.broadcast_to(EYE, d.shape), d, invert_pose(poses)[:, None], inner[None])
    error = np.abs(traced.depth_m.numpy() - near[:, 0])
    assert np.median(error) < 0.005 and np.quantile(error, 0.95) < 0.03
    np.testing.assert_allclose(traced.feature[:, 1], traced.opacity, atol=1e-5)


def test_a_ray_sees_an_actor_where_it_is_at_its_own_time() -> None:
    size = np.array([4.0, 2.0, 1.6])
    way = Trajectory(np.array([0.0, 0.5]), np.array([[0.0, 0, 1], [10, 0, 1]]), np.tile(LEVEL, (2, 1)))
    actor = still("car", [0, 0, 0], size, world_from_actor=way, is_moving=True)
    stage = Stage(analytic_scene(empty, {"car": (block([3.6, 1.6, 1.4]), size)}), drive_of([actor]))
    time = np.linspace(0, 0.5, 11)
    traced = stage.trace([-20, 0, 1], np.tile([1.0, 0, 0], (11, 1)), time)
    np.testing.assert_allclose(traced.depth_m, 20 + 20 * time - 1.8, atol=0.01)


def crossed_cars(order: tuple[str, str] = ("a", "b")) -> Stage:
    """Two bodies that stand in each other."""
    size = np.array([5.0, 2.0, 2.0])
    shapes = {uid: (block([4.6, 1.6, 1.6]), size) for uid in ("a", "b")}
    cars = {"a": still("a", [0, 0, 1], size, 0.6), "b": still("b", [0.5, 0.3, 1], size, -0.8)}
    return Stage(analytic_scene(ground, shapes), drive_of([cars[uid] for uid in order]))


def test_order_of_the_actors_changes_nothing() -> None:
    d = fan(400, spread=0.1)
    one, other = crossed_cars().trace(EYE, d), crossed_cars(("b", "a")).trace(EYE, d)
    for name in ("feature", "depth_m", "opacity", "behind"):
        assert torch.equal(getattr(one, name), getattr(other, name)), name
    both = (one.feature[:, 1] > 0.01) & (one.feature[:, 2] > 0.01)
    assert int(both.sum()) > 0, "somewhere they mix"


def test_names_of_overlapping_actors_change_nothing() -> None:
    d = fan(400, spread=0.1)
    one = crossed_cars().trace(EYE, d)
    size = np.array([5.0, 2.0, 2.0])
    shapes = {uid: (block([4.6, 1.6, 1.6]), size) for uid in ("a", "b")}
    swapped = [still("b", [0, 0, 1], size, 0.6), still("a", [0.5, 0.3, 1], size, -0.8)]
    other = Stage(analytic_scene(ground, shapes), drive_of(swapped)).trace(EYE, d)
    torch.testing.assert_close(one.depth_m, other.depth_m, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(one.feature[:, [0, 2, 1]], other.feature[:, :3], atol=1e-4, rtol=1e-4)


def test_weights_never_exceed_the_ray() -> None:
    traced = crossed_cars().trace(EYE, fan(600, spread=0.1))
    assert float(traced.feature.sum(1).max()) <= 1 + 1e-4
    torch.testing.assert_close(traced.feature.sum(1), traced.opacity, atol=1e-4, rtol=0)
    torch.testing.assert_close(traced.opacity + traced.behind, torch.ones(600), atol=1e-5, rtol=0)


HOLLOW = np.array([6.0, 4.0, 3.0])


def hollow(static: object, z: float = 1.3) -> Stage:
    """An actor without a body, its box partly under the ground, round what stands in the static field."""
    return Stage(analytic_scene(static, {"car": (empty, HOLLOW)}), drive_of([still("car", [0, 0, z], HOLLOW)]))  # type: ignore[arg-type]


def test_the_static_field_is_cleared_in_a_box_above_the_ground_only() -> None:
    junk = union(ground, sphere([0.0, 0, 1.1], 0.9))
    down = np.array([0.3, 0.0, -0.3])  # meets the ground at (0, 0), in the box
    traced = hollow(junk).trace([-1.6, 0.0, 1.6], down)
    np.testing.assert_allclose(traced.depth_m, 1.6 * np.sqrt(2), atol=0.02)
    assert Stage(analytic_scene(junk, {}), drive_of([])).trace([-1.6, 0.0, 1.6], down).depth_m.item() < 1.5, "the junk is there"


def test_a_wall_behind_a_cleared_box_stays() -> None:
    """What samples the junk inside the box drew must not be missing behind it."""
    junk = union(sphere([0.0, 0, 1.3], 1.2), wall(3.3))
    d = fan(200, spread=0.01)
    for fine in (1.0, 4.0):
        traced = hollow(junk).trace([-20, 0.0, 1.3], d, fine=fine)
        np.testing.assert_allclose(traced.opacity, 1, atol=2e-3)
        np.testing.assert_allclose(traced.depth_m, 23.3 / d[:, 0], atol=0.1 / fine)


def test_a_wall_behind_a_removed_thing_stays() -> None:
    pillar, box = union(sphere([0.0, 0, 1.3], 1.2), wall(9.0)), Box(make_pose(np.array([0.0, 0, 1.3]), LEVEL), HOLLOW)
    d = fan(200, spread=0.01)
    before = Stage(analytic_scene(pillar, {}), drive_of([])).trace([-20, 0.0, 1.3], d)
    assert float(before.depth_m.max()) < 21
    after = Stage(analytic_scene(pillar, {}), drive_of([], removals=(box,))).trace([-20, 0.0, 1.3], d, fine=1.0)
    np.testing.assert_allclose(after.opacity, 1, atol=2e-3)
    np.testing.assert_allclose(after.depth_m, 29.0 / d[:, 0], atol=0.1)


def test_the_ground_under_a_removed_thing_stays() -> None:
    scene = analytic_scene(union(ground, sphere([0.0, 0, 0.6], 0.45)), {})
    box = Box(make_pose(np.array([0.0, 0, 0.5]), quaternion_from_yaw(0.4)), np.array([2.0, 2.0, 2.0]))
    traced = Stage(scene, drive_of([], removals=(box,))).trace([-3.0, 0, 3.0], [1.0, 0, -1.0])
    np.testing.assert_allclose(traced.depth_m, np.sqrt(18), atol=0.02)


def test_rays_that_meet_nothing_but_a_removal() -> None:
    scene = analytic_scene(empty, {})
    box = Box(make_pose(np.zeros(3), LEVEL), np.ones(3))
    traced = Stage(scene, drive_of([], removals=(box,))).trace(EYE, fan(5))
    assert not traced.strands and bool((traced.opacity == 0).all())


def test_an_actor_before_a_distant_wall_hides_it() -> None:
    """The wall's interval spans free space and the actor: it must count where the wall is."""
    size = np.array([2.0, 3.0, 3.0])
    scene = analytic_scene(union(wall(12.0), sphere([-14.0, 1.45, 1.6], 1.0)), {"car": (block([1.0, 2.8, 2.8]), size)}, beta=60.0)
    for fine in (1.0, 4.0):
        traced = Stage(scene, drive_of([still("car", [8.0, 0, 1.6], size)])).trace(EYE, fan(100, spread=0.01), fine=fine)
        assert float(traced.feature[:, 1].min()) > 0.97


def test_mean_depth_across_free_space() -> None:
    """Between two runs of occupied voxels no surface lies, so none of the weight does."""
    scene = analytic_scene(union(wall(12.0), sphere([-14.0, 1.7, 1.6], 1.0)), {}, beta=60.0)
    d = fan(100, spread=0.01)
    traced = Stage(scene, drive_of([])).trace(EYE, d, fine=1.0)
    np.testing.assert_allclose(traced.depth_m, 32 / d[:, 0], atol=0.25)
