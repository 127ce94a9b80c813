"""Rays through scenes whose distances are known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from analytic_scene import Stage, analytic_scene, block, drive_of, empty, ground, sphere, still, union, wall
from whole_drive import whole_state

from unisim_blender.core.errors import SceneError
from unisim_blender.core.geometry import (
    FloatArray,
    Trajectory,
    intersect_boxes,
    invert_pose,
    make_pose,
    quaternion_from_yaw,
)
from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.ops.ray_segments import RayBatch
from unisim_blender.core.presets import preset
from unisim_blender.core.render.tracer import active_actors
from unisim_blender.core.render.tracers.torch.actor_tensors import active_actor_tensors
from unisim_blender.core.render.tracers.torch.segments import Sampling
from unisim_blender.core.render.tracers.torch.trace import trace
from unisim_blender.core.world.drive import Appearance, Box, StaticCopy

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
    trajectory = Trajectory(keys, positions, quaternion_from_yaw(np.array([0.3, 1.1])))
    actor = still("car", [0, 0, 0], size, world_from_actor=trajectory, is_moving=True)
    inner = np.array([4.0, 1.8, 1.4])
    stage = Stage(analytic_scene(empty, {"car": (block(inner), size)}), drive_of([actor]))
    rng = np.random.default_rng(3)
    time = rng.uniform(0, 0.5, 300)
    poses = trajectory.at(time)
    aim = np.einsum("nij,nj->ni", poses[:, :3, :3], rng.uniform(-0.45, 0.45, (300, 3)) * inner) + poses[:, :3, 3]
    traced = stage.trace(EYE, aim - EYE, time)
    d = (aim - EYE) / np.linalg.norm(aim - EYE, axis=1, keepdims=True)
    near, _ = intersect_boxes(np.broadcast_to(EYE, d.shape), d, invert_pose(poses)[:, None], inner[None])
    error = np.abs(traced.depth_m.numpy() - near[:, 0])
    assert np.median(error) < 0.005 and np.quantile(error, 0.95) < 0.03
    np.testing.assert_allclose(traced.feature[:, 1], traced.opacity, atol=1e-5)


def test_a_ray_sees_an_actor_where_it_is_at_its_own_time() -> None:
    size = np.array([4.0, 2.0, 1.6])
    trajectory = Trajectory(np.array([0.0, 0.5]), np.array([[0.0, 0, 1], [10, 0, 1]]), np.tile(LEVEL, (2, 1)))
    actor = still("car", [0, 0, 0], size, world_from_actor=trajectory, is_moving=True)
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
    for name in ("feature", "depth_m", "opacity", "transmittance_after"):
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
    torch.testing.assert_close(traced.opacity + traced.transmittance_after, torch.ones(600), atol=1e-5, rtol=0)


HOLLOW = np.array([6.0, 4.0, 3.0])


def hollow(static: object, z: float = 1.3) -> Stage:
    """An actor without a body, its box partly under the ground, round what stands in the static field."""
    return Stage(analytic_scene(static, {"car": (empty, HOLLOW)}), drive_of([still("car", [0, 0, z], HOLLOW)]))  # type: ignore[arg-type]


def test_the_static_field_is_cleared_in_a_box_above_the_ground_only() -> None:
    junk = union(ground, sphere([0.0, 0, 1.1], 0.9))
    down = np.array([0.3, 0.0, -0.3])  # meets the ground at (0, 0), in the box
    traced = hollow(junk).trace([-1.6, 0.0, 1.6], down)
    np.testing.assert_allclose(traced.depth_m, 1.6 * np.sqrt(2), atol=0.02)
    assert Stage(analytic_scene(junk, {}), drive_of([])).trace([-1.6, 0.0, 1.6], down).depth_m.item() < 1.5, (
        "the junk is there"
    )


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
    assert not traced.ray_segments and bool((traced.opacity == 0).all())


def test_an_actor_before_a_distant_wall_hides_it() -> None:
    """The wall's interval spans free space and the actor: it must count where the wall is."""
    size = np.array([2.0, 3.0, 3.0])
    scene = analytic_scene(
        union(wall(12.0), sphere([-14.0, 1.45, 1.6], 1.0)), {"car": (block([1.0, 2.8, 2.8]), size)}, beta=60.0
    )
    for fine in (1.0, 4.0):
        traced = Stage(scene, drive_of([still("car", [8.0, 0, 1.6], size)])).trace(
            EYE, fan(100, spread=0.01), fine=fine
        )
        assert float(traced.feature[:, 1].min()) > 0.97


def test_mean_depth_across_free_space() -> None:
    """Between two runs of occupied voxels no surface lies, so none of the weight does."""
    scene = analytic_scene(union(wall(12.0), sphere([-14.0, 1.7, 1.6], 1.0)), {}, beta=60.0)
    d = fan(100, spread=0.01)
    traced = Stage(scene, drive_of([])).trace(EYE, d, fine=1.0)
    np.testing.assert_allclose(traced.depth_m, 32 / d[:, 0], atol=0.25)


def test_an_actor_is_there_only_in_its_time() -> None:
    size = np.array([4.0, 4.0, 4.0])
    actor = still("car", [0, 0, 1.6], size, start_s=0.15, end_s=0.35)
    traced = Stage(analytic_scene(empty, {"car": (block(size * 0.9), size)}), drive_of([actor])).trace(
        EYE, np.tile([1.0, 0, 0], (5, 1)), np.array([0.0, 0.149, 0.15, 0.35, 0.351])
    )
    np.testing.assert_allclose(traced.opacity, [0, 0, 1, 1, 0], atol=1e-4)


def test_a_cleared_box_is_cleared_only_in_the_actors_time() -> None:
    actor = still("car", [0, 0, 1.3], HOLLOW, start_s=0.15, end_s=0.35)
    scene = analytic_scene(sphere([0.0, 0, 1.3], 1.0), {"car": (empty, HOLLOW)})
    traced = Stage(scene, drive_of([actor])).trace([-20, 0, 1.3], np.tile([1.0, 0, 0], (2, 1)), np.array([0.1, 0.2]))
    np.testing.assert_allclose(traced.opacity, [1, 0], atol=1e-3)


def pillar_with_copy(turn: float = 0.0) -> tuple[Stage, FloatArray]:
    """A block on the ground at (0, 0), turned by 0.4, copied to (2, 8) with another turn; the place of
    the copy (4, 4)."""
    to = np.cos(-0.4), np.sin(-0.4)

    def turned(x: torch.Tensor) -> torch.Tensor:
        local = torch.stack([to[0] * x[:, 0] - to[1] * x[:, 1], to[1] * x[:, 0] + to[0] * x[:, 1], x[:, 2] - 0.8], -1)
        return block([1.0, 0.5, 1.6])(local)

    source = Box(make_pose(np.array([0.0, 0, 0.8]), quaternion_from_yaw(0.4)), np.array([1.6, 1.2, 2.4]))
    target = make_pose(np.array([2.0, 8.0, 0.8]), quaternion_from_yaw(0.4 + turn))
    copy = StaticCopy("pillar-copy", source, target)
    return Stage(analytic_scene(union(ground, turned), {}), drive_of([], copies=(copy,))), target


@pytest.mark.parametrize("turn", (0.0, 1.2))
def test_a_static_copy_stands_where_it_was_put(turn: float) -> None:
    stage, target = pillar_with_copy(turn)
    local = np.random.default_rng(1).uniform(-0.9, 0.9, (300, 3)) * [0.5, 0.25, 0.7]
    rays = []
    for pose in (make_pose(np.array([0.0, 0, 0.8]), quaternion_from_yaw(0.4)), target):
        eye = pose[:3, :3] @ [-6.0, -3.0, 1.0] + pose[:3, 3]
        rays.append(stage.trace(eye, local @ pose[:3, :3].T + pose[:3, 3] - eye))
    np.testing.assert_allclose(rays[1].depth_m, rays[0].depth_m, atol=0.05)
    assert np.quantile(np.abs(rays[1].depth_m - rays[0].depth_m), 0.9) < 0.02


def test_a_static_copy_brings_no_ground_along() -> None:
    """The source's box reaches under the ground; lifted up, only the block hangs there."""
    source = Box(make_pose(np.array([0.0, 0, 0.4]), LEVEL), np.array([3.0, 3.0, 3.0]))
    copy = StaticCopy("up", source, make_pose(np.array([0.0, 10, 5.4]), LEVEL))
    scene = analytic_scene(union(ground, lambda x: block([1.0, 1.0, 1.6])(x - torch.tensor([0, 0, 0.8]))), {})
    stage = Stage(scene, drive_of([], copies=(copy,)))
    aim = np.array([[0.0, 10, 5.8], [1.3, 10, 4.2], [-1.3, 10, 4.5]])
    traced = stage.trace([0.0, 2, 5.5], aim - [0.0, 2, 5.5])
    np.testing.assert_allclose(traced.depth_m[0], np.linalg.norm([0, 7.5, 0.3]), atol=0.05)
    assert float(traced.depth_m[1:].min()) > 12 or float(traced.opacity[1:].max()) < 0.05


FOREIGN = "elsewhere"


def stage_with_foreign(x_m: float, static: object = None, features: int = 15) -> Stage:
    """A wall at x = 8 and an actor of another scene at ``x_m``."""
    size = np.array([3.0, 3.0, 3.0])
    config = replace(preset("tiny").model, features=features)
    other = analytic_scene(empty, {"car": (block([2.0, 2.0, 2.0]), size), "bus": (empty, size)}, config, beta=300.0)
    foreign = still("new", [x_m, 0, 1.6], size, appearance=Appearance("car", FOREIGN))
    own = analytic_scene(static or wall(8.0), {"bike": (block([1.0, 1, 1]), size)})  # type: ignore[arg-type]
    return Stage(own, drive_of([foreign, still("bike", [-5, 5, 1.6], size)]), {FOREIGN: other})


@pytest.mark.parametrize("features", (15, 7))
def test_a_foreign_actor_hides_what_is_behind_it(features: int) -> None:
    traced = stage_with_foreign(2.0, features=features).trace(EYE, fan(50, spread=0.01))
    np.testing.assert_allclose(traced.foreign_opacity[0], 1, atol=1e-3)
    np.testing.assert_allclose(traced.foreign_features[0][:, 2], 1, atol=1e-3)
    assert traced.foreign_features[0].shape == (50, features)
    np.testing.assert_allclose(traced.feature.abs().max(), 0, atol=1e-3)
    assert traced.without_foreign is not None
    np.testing.assert_allclose(traced.without_foreign[:, 0], 1, atol=1e-3)
    np.testing.assert_allclose(traced.depth_m, 21, atol=0.1)


def test_a_foreign_actor_is_hidden_by_what_stands_before_it() -> None:
    traced = stage_with_foreign(12.0).trace(EYE, fan(50, spread=0.01))
    np.testing.assert_allclose(traced.foreign_opacity[0], 0, atol=1e-3)
    np.testing.assert_allclose(traced.feature[:, 0], 1, atol=1e-3)


def test_own_actors_hide_foreign_ones_and_foreign_ones_own_actors() -> None:
    size = np.array([2.0, 3.0, 3.0])
    body = block([1.4, 2.6, 2.6])
    other = analytic_scene(empty, {"car": (body, size)})
    for own_x, foreign_x in ((-4.0, 4.0), (4.0, -4.0)):
        actors = [
            still("own", [own_x, 0, 1.6], size),
            still("new", [foreign_x, 0, 1.6], size, appearance=Appearance("car", FOREIGN)),
        ]
        traced = Stage(analytic_scene(empty, {"own": (body, size)}), drive_of(actors), {FOREIGN: other}).trace(
            EYE, fan(50, spread=0.01)
        )
        expected = float(own_x < foreign_x)
        np.testing.assert_allclose(traced.feature[:, 1], expected, atol=1e-3)
        np.testing.assert_allclose(traced.foreign_opacity[0], 1 - expected, atol=1e-3)


def test_two_actors_on_one_ray_and_a_foreign_actor_on_another() -> None:
    """Where no static voxel is met, ray segments of the first field must still see each other."""
    size = np.array([2.0, 3.0, 3.0])
    body = (block([1.4, 2.6, 2.6]), size)
    foreign = still("new", [0, 8, 1.6], size, appearance=Appearance("car", FOREIGN))
    actors = [still("a", [3.0, 0, 1.6], size), still("b", [-3.0, 0, 1.6], size), foreign]
    stage = Stage(
        analytic_scene(empty, {"a": body, "b": body}), drive_of(actors), {FOREIGN: analytic_scene(empty, {"car": body})}
    )
    traced = stage.trace(EYE, [[20.0, 0, 0], [20, 8, 0]])
    np.testing.assert_allclose(traced.feature[:, 1:3], [[0, 1], [0, 0]], atol=1e-3)
    np.testing.assert_allclose(traced.foreign_opacity[0], [0, 1], atol=1e-3)
    np.testing.assert_allclose(traced.depth_m[0], 20 - 3 - 0.7, atol=0.05)


def test_duplicates_of_an_actor_share_its_appearance() -> None:
    size = np.array([2.0, 3.0, 3.0])
    scene = analytic_scene(empty, {"a": (empty, size), "b": (block([1.4, 2.6, 2.6]), size)})
    actors = [still("copy of b", [0, 0, 1.6], size, appearance=Appearance("b")), still("a", [-5, 0, 1.6], size)]
    traced = Stage(scene, drive_of(actors)).trace(EYE, fan(20, spread=0.01))
    np.testing.assert_allclose(traced.feature[:, 2], 1, atol=1e-3)


def test_a_look_that_the_scene_does_not_hold() -> None:
    stage = Stage(
        analytic_scene(empty, {}), drive_of([still("car", [0, 0, 1], [1, 1, 1], appearance=Appearance("lorry"))])
    )
    with pytest.raises(SceneError, match="'car' has the appearance of 'lorry'"):
        stage.active()
    absent = Stage(
        analytic_scene(empty, {}), drive_of([still("car", [0, 0, 1], [1, 1, 1], appearance=Appearance("car", FOREIGN))])
    )
    with pytest.raises(SceneError, match=FOREIGN):
        absent.active()


def test_free_space_spends_no_sample() -> None:
    stage = Stage(analytic_scene(sphere([0.0, 0, 1.6], 1.0), {}), drive_of([]))
    away = stage.trace(EYE, [[-1.0, 0, 0], [0, 1, 0], [0.1, 0, 1]], background=False)
    assert away.samples == 0 and bool((away.depth_m == 0).all()) and bool((away.transmittance_after == 1).all())
    toward = stage.trace(EYE, [[1.0, 0, 0]], fine=1.0)
    assert toward.samples == stage.scene.config.samples.static
    t = toward.ray_segments[0].t
    assert 17 < float(t.min()) and float(t.max()) < 23, "all of them near the sphere"


def test_the_background_model_is_queried_only_where_it_is_seen() -> None:
    stage = Stage(analytic_scene(wall(4.0), {}), drive_of([]))
    asked: list[int] = []
    forward = stage.scene.background.forward
    stage.scene.background.forward = lambda x: (asked.append(len(x)), forward(x))[1]  # type: ignore[method-assign, func-returns-value]
    stage.trace(EYE, [[1.0, 0, 0], [1.0, 0.1, 0], [-1.0, 0, 0]], background=True)
    assert asked == [stage.scene.config.samples.background]


def test_a_ray_that_never_enters_the_volume_sees_the_background_model() -> None:
    stage = Stage(analytic_scene(wall(4.0), {}), drive_of([]))
    traced = stage.trace([0.0, 0, 100.0], [[0.0, 0, 1], [1, 0, 0], [0.6, 0.0, 0.8]], background=True)
    assert bool(torch.isfinite(traced.feature).all()) and bool((traced.feature.abs().sum(1) > 0).all())
    assert bool((traced.opacity == 0).all())


def test_what_lies_beyond_the_volume_has_a_depth_and_the_sky_has_none() -> None:
    stage = Stage(analytic_scene(wall(4.0), {}), drive_of([]))
    sky = stage.trace(EYE, [-1.0, 0, 0.05], background=True)
    assert float(sky.opacity) == 0 and float(sky.depth_m) < 1e-6 and float(sky.feature.abs().sum()) > 0
    features = stage.scene.config.features
    stage.scene.background.forward = lambda x: (torch.full_like(x[:, 0], 50.0), x.new_ones(len(x), features))  # type: ignore[method-assign]
    hill = stage.trace(EYE, [-1.0, 0, 0.05], background=True)
    assert float(hill.opacity) == pytest.approx(1) and 10 < float(hill.depth_m) < 3000
    torch.testing.assert_close(hill.feature, torch.ones_like(hill.feature))


def test_the_background_models_samples_go_where_it_is_dense() -> None:
    stage = Stage(analytic_scene(empty, {}), drive_of([]))
    scene, ahead = stage.scene, torch.tensor([1.0, 0.0, 0.0])
    at = scene.frame.points(scene.frame.recentred(EYE))

    def density(x: torch.Tensor) -> torch.Tensor:
        return 30.0 * ((x - at).norm(dim=-1) - 400.0).abs().lt(60.0)

    scene.background.density = density  # type: ignore[method-assign]
    scene.background.forward = lambda x: (density(x), x.new_ones(len(x), scene.config.features))  # type: ignore[method-assign]
    scene.config = replace(scene.config, samples=replace(scene.config.samples, background_proposals=32, background=6))
    traced = stage.trace(EYE, ahead.tolist(), background=True)
    assert traced.background is not None
    assert int(((traced.background.t - 400).abs() < 60).sum()) >= 3, "most of the samples lie in the shell"
    assert float(traced.depth_m) == pytest.approx(400, abs=60)


def test_even_places_of_the_background_model_share_its_way() -> None:
    stage = Stage(analytic_scene(empty, {}), drive_of([]))
    scene = stage.scene
    scene.background.density = lambda x: torch.full_like(x[:, 0], 0.7)  # type: ignore[method-assign]
    scene.background.forward = lambda x: (torch.full_like(x[:, 0], 0.7), x.new_ones(len(x), scene.config.features))  # type: ignore[method-assign]
    for samples in (2, 9):
        scene.config = replace(scene.config, samples=replace(scene.config.samples, background=samples))
        traced = stage.trace(EYE, [1.0, 0, 0], background=True)
        assert float(traced.opacity) == pytest.approx(1 - np.exp(-0.7), rel=1e-5), "however many there are"


def test_the_papers_density() -> None:
    """Opacity of steps of its own length: a plane head-on is met within a step before or behind it."""
    config = replace(preset("tiny").model, density="unisim", unisim_step_m=0.2)
    scene = analytic_scene(wall(4.0), {}, config, beta=40.0)
    traced = Stage(scene, drive_of([])).trace(EYE, fan(20, spread=0.01), fine=8.0)
    np.testing.assert_allclose(traced.depth_m, 24, atol=0.3)
    torch.testing.assert_close(traced.feature[:, 0], traced.opacity, atol=1e-5, rtol=0)


def test_a_look_is_mirrored_on_all_rays_or_on_none() -> None:
    """A block in the left half of its box alone: mirrored, it stands in the right half."""
    size = np.array([2.0, 4.0, 2.0])

    def left(x: torch.Tensor) -> torch.Tensor:
        return block([1.8, 1.6, 1.8])(x - torch.tensor([0.0, 1.1, 0.0]))

    stage = Stage(analytic_scene(empty, {"car": (left, size)}), drive_of([still("car", [0, 0, 1.6], size)]))
    across = torch.stack([torch.full((40,), -20.0), torch.linspace(-1.7, 1.7, 40), torch.full((40,), 1.6)], -1)
    rays = RayBatch(
        stage.scene.frame.recentred(across.numpy()),
        torch.tensor([[1.0, 0, 0]]).expand(40, 3),
        torch.zeros(40, dtype=torch.float64),
    )
    sides = []
    for seed in range(12):
        sampling = Sampling(
            fine=4.0, background=False, mirror=torch.tensor([0.5]), generator=torch.Generator().manual_seed(seed)
        )
        hit = trace(stage.scene, stage.active(), rays, sampling).opacity > 0.5
        sides.append((bool(hit[across[:, 1] > 0.4].all()), bool(hit[across[:, 1] < -0.4].all())))
    assert set(sides) == {(True, False), (False, True)}, "one side or the other, never some rays of each"


def test_gradients_reach_every_field() -> None:
    torch.manual_seed(1)
    size = np.array([4.0, 3.0, 3.0])
    drive = drive_of([still("car", [0, 0, 1.0], size)])
    volume = analytic_scene(empty, {}).volume
    scene = SceneModel(preset("tiny").model, volume, ("car",), ("front",))
    scene.occupancy.values.fill_(255)
    drawn = fan(64, spread=0.1)
    batch = RayBatch(
        scene.frame.recentred(np.tile(EYE, (64, 1))), torch.tensor(drawn).float(), torch.zeros(64).double()
    )
    active = active_actor_tensors(
        active_actors(whole_state(drive), {"": ("car",)}), {"": (scene, scene.actors.tables())}
    )
    traced = trace(scene, active, batch, Sampling(jitter=True, generator=torch.Generator().manual_seed(2)))
    (traced.feature.sum() + traced.depth_m.sum() + traced.transmittance_after.sum()).backward()
    for name in (
        "static.grid.table",
        "background.grid.table",
        "actors.latents",
        "log_beta",
        "static.network.0.weight",
    ):
        gradient = scene.get_parameter(name).grad
        assert gradient is not None and bool(torch.isfinite(gradient).all()) and bool((gradient != 0).any()), name


def test_what_stood_still_leaves_an_empty_box() -> None:
    parked = still("car", (0.0, 0.0, 1.0), (4.0, 2.0, 2.0))
    assert not parked.is_moving
    recorded, gone = drive_of([parked]), drive_of([])
    (box,) = whole_state(gone, recorded).removed_boxes
    np.testing.assert_array_equal(box.size_m, parked.size_m)
    assert whole_state(recorded).removed_boxes == ()
    away = np.eye(4)
    away[0, 3] = 3.0
    moved = replace(parked, world_from_actor=parked.world_from_actor.transformed(away))
    assert len(whole_state(drive_of([moved]), recorded).removed_boxes) == 1
    driven = drive_of([replace(parked, is_moving=True)])
    assert whole_state(gone, driven).removed_boxes == (), "the road under a moving car was seen"
