"""Keys of trajectories: parts of one, many as arrays, and the bounds that are made of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from analytic_scene import still

from unisim_blender.core.geometry import (
    FloatArray,
    Trajectory,
    box_corners,
    intersect_boxes,
    invert_pose,
    quaternion_from_yaw,
)
from unisim_blender.core.sensors.bounds import BIN_S, Bounds
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.world.drive import Actor
from unisim_blender.core.world.replay import PaddedKeys


def random_trajectory(keys: int, rng: np.random.Generator) -> Trajectory:
    """Keys at uneven times from about -1 s on, some of them less than a millisecond apart."""
    times = -1 + np.cumsum(rng.choice([3e-4, 0.02, 0.1, 0.37], keys) * rng.uniform(0.5, 1.5, keys))
    quaternions = rng.normal(size=(keys, 4))
    return Trajectory(
        times, rng.normal(0, 20, (keys, 3)), quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    )


def windows_of(times: FloatArray, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Windows anywhere: at keys, an ulp beside them, before the first, after the last, of no length,
    over everything."""
    first, last = float(times[0]), float(times[-1])
    ends = [
        *times,
        *np.nextafter(times, -np.inf),
        *np.nextafter(times, np.inf),
        first - 3,
        first - 2,
        last + 2,
        last + 3,
    ]
    pairs = [sorted(rng.choice(ends, 2).tolist()) for _ in range(60)]
    pairs += [sorted(rng.uniform(first - 1, last + 1, 2).tolist()) for _ in range(60)]
    pairs += [[end, end] for end in ends] + [
        [first - 3, first - 2],
        [last + 2, last + 3],
        [first - 9, last + 9],
        [-np.inf, np.inf],
    ]
    return [(start, end) for start, end in [*pairs, (-np.inf, np.inf)]]


@pytest.mark.parametrize("keys", (1, 2, 3, 5, 40))
def test_a_part_of_a_trajectory_has_the_bits_of_the_whole(keys: int) -> None:
    rng = np.random.default_rng(keys)
    for _ in range(6):
        whole = random_trajectory(keys, rng)
        shorter = 0
        for start, end in windows_of(whole.times_s, rng):
            part = whole.between(start, end)
            low, high = max(start, -20.0), min(end, 40.0)
            times = np.concatenate(
                [np.linspace(low, high, 17), whole.times_s, np.nextafter(whole.times_s, np.inf), [low, high]]
            )
            times = times[(times >= start) & (times <= end)]
            np.testing.assert_array_equal(part.at(times), whole.at(times))
            np.testing.assert_array_equal(part.positions_at(times), whole.positions_at(times))
            # its keys are keys of the whole, side by side
            first = int(np.searchsorted(whole.times_s, part.times_s[0]))
            side_by_side = slice(first, first + len(part.times_s))
            np.testing.assert_array_equal(part.times_s, whole.times_s[side_by_side])
            np.testing.assert_array_equal(part.positions, whole.positions[side_by_side])
            np.testing.assert_array_equal(part.quaternions_wxyz, whole.quaternions_wxyz[side_by_side])
            shorter += len(part.times_s) < keys
        assert (shorter > 0) == (keys > 2), "a part holds the keys alone that it needs"


def test_a_part_has_no_key_that_it_does_not_need() -> None:
    whole = random_trajectory(20, np.random.default_rng(0))
    middle = (whole.times_s[:-1] + whole.times_s[1:]) / 2
    for first, last in ((3, 3), (3, 5), (0, 0), (18, 18)):
        part = whole.between(float(middle[first]), float(middle[last]))
        np.testing.assert_array_equal(part.times_s, whole.times_s[first : last + 2])


def moving(uid: str, keys: int, rng: np.random.Generator) -> Actor:
    trajectory = random_trajectory(keys, rng)
    start, end = sorted(rng.uniform(-1, 3, 2).tolist())
    size = rng.uniform(0.5, 6, 3)
    return still(uid, (0, 0, 0), size, world_from_actor=trajectory, start_s=start, end_s=end, is_moving=keys > 1)


@pytest.mark.parametrize("counts", ((1,), (2,), (7,), (1, 1), (1, 2, 3, 9, 30, 2, 1)))
def test_padded_positions_are_the_trajectories_to_the_bit(counts: tuple[int, ...]) -> None:
    rng = np.random.default_rng(sum(counts))
    actors = [moving(str(i), keys, rng) for i, keys in enumerate(counts)]
    padded = PaddedKeys.of(actors)
    assert padded.times_s.shape == (len(counts), max(counts)) and padded.lengths.tolist() == list(counts)
    keys = np.concatenate([actor.world_from_actor.times_s for actor in actors])
    times = np.concatenate([rng.uniform(-3, 8, 200), keys, np.nextafter(keys, -np.inf), np.nextafter(keys, np.inf)])
    found = padded.positions_at(times)
    assert found.shape == (len(counts), len(times), 3)
    for actor, positions in zip(actors, found, strict=True):
        np.testing.assert_array_equal(positions, actor.world_from_actor.positions_at(times))


def test_nobodys_keys() -> None:
    padded = PaddedKeys.of([])
    assert padded.times_s.shape == (0, 1) and padded.positions_at(np.array([0.0, 1.0])).shape == (0, 2, 3)
    assert Bounds([]).in_reach(Rays(np.zeros((1, 3)), np.array([[1.0, 0, 0]]), np.zeros(1))) == []


def hit_by(actors: list[Actor], rays: Rays) -> set[int]:
    """The actors whose boxes flat rays meet where these are at each ray's own time."""
    hit = set()
    for i, actor in enumerate(actors):
        inward = invert_pose(actor.world_from_actor.at(rays.time_s))
        origins = np.einsum("nij,nj->ni", inward[:, :3, :3], rays.origins) + inward[:, :3, 3]
        directions = np.einsum("nij,nj->ni", inward[:, :3, :3], rays.directions)
        near, far = intersect_boxes(origins, directions, np.eye(4)[None], actor.size_m[None])
        if ((near <= far) & (far > 0))[:, 0][actor.present(rays.time_s)].any():
            hit.add(i)
    return hit


def driving(uid: str, rng: np.random.Generator) -> Actor:
    """An actor within 40 m that stands or drives at up to 30 m/s, and turns."""
    keys = int(rng.choice([1, 2, 6]))
    times = -1 + np.cumsum(rng.uniform(0.05, 0.8, keys))
    steps = rng.normal(0, [10, 10, 0.5]) * np.diff(times, prepend=times[0])[:, None]
    trajectory = Trajectory(
        times,
        rng.uniform([-30, -30, -2], [30, 30, 2]) + np.cumsum(steps, 0),
        quaternion_from_yaw(rng.uniform(-3, 3) + 0.4 * times),
    )
    start, end = sorted(rng.uniform(-1, 4, 2).tolist())
    return still(
        uid,
        (0, 0, 0),
        rng.uniform(0.5, 6, 3),
        world_from_actor=trajectory,
        start_s=start,
        end_s=end,
        is_moving=keys > 1,
    )


@pytest.mark.parametrize("seed", range(4))
def test_bounds_leave_out_nobody_that_a_ray_meets(seed: int) -> None:
    """Bundles like a camera's, a LiDAR's and one of all directions, over actors whose presence is cut to the
    bundle's window."""
    rng = np.random.default_rng(seed)
    all_hit = all_left_out = 0
    for _ in range(40):
        start = float(rng.uniform(-1, 3))
        end = start + float(rng.choice([0.0, 0.03, 0.1, 0.5]))
        actors = []
        for i in range(60):
            actor = driving(str(i), rng)
            if actor.end_s < start or actor.start_s > end:
                continue
            cut = actor.world_from_actor.between(start, end)
            window = max(start, actor.start_s), min(end, actor.end_s)
            actors.append(replace(actor, world_from_actor=cut, start_s=window[0], end_s=window[1]))
        n = 100
        directions = rng.normal(size=3) * [1, 1, 0.1] + rng.choice([0.05, 0.5, 20.0]) * rng.normal(size=(n, 3)) * [
            1,
            1,
            0.2,
        ]
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        origins = rng.normal(0, [15, 15, 1]) + rng.choice([0.0, 1.0]) * rng.normal(size=(n, 3))
        rays = Rays(origins, directions, rng.uniform(start, end, n))
        kept, hit = set(Bounds(actors).in_reach(rays)), hit_by(actors, rays)
        assert hit <= kept
        all_hit, all_left_out = all_hit + len(hit), all_left_out + len(actors) - len(kept)
    assert all_hit > 50 and all_left_out > 50


def test_bounds_hold_the_corners_of_boxes() -> None:
    """Narrow bundles that graze a corner, which the sphere round a box hardly holds."""
    rng = np.random.default_rng(1)
    grazed = 0
    for n in range(400):
        actor = driving(str(n), rng)
        time = float(rng.uniform(actor.start_s, actor.end_s))
        corners = box_corners(actor.world_from_actor.at(time), 0.999 * actor.size_m)
        eye = rng.normal(0, [15, 15, 1])
        to = corners[int(rng.integers(8))] - eye + 1e-4 * rng.normal(size=(5, 3))
        rays = Rays(np.tile(eye, (5, 1)), to / np.linalg.norm(to, axis=1, keepdims=True), np.full(5, time))
        hit = hit_by([actor], rays)
        assert hit <= set(Bounds([actor]).in_reach(rays))
        grazed += len(hit)
    assert grazed > 300


def test_bounds_hold_an_actors_first_and_last_instant() -> None:
    """Presence includes both ends, wherever rounding puts them among the bins."""
    rng = np.random.default_rng(0)
    ahead = np.array([[1.0, 0, 0]])
    for n in range(2000):
        start = 0.1 * int(rng.integers(0, 100)) if n % 3 else float(rng.uniform(-5, 20))
        end = start + BIN_S * int(rng.integers(0, 400))
        actor = still("car", (10.0, 0, 0), (4.0, 2.0, 2.0), start_s=start, end_s=round(end, 2) if n % 2 else end)
        bounds = Bounds([actor])
        for time in (actor.start_s, actor.end_s):
            rays = Rays(np.zeros((1, 3)), ahead, np.array([time]))
            assert bounds.in_reach(rays) == ([0] if actor.start_s <= actor.end_s else []), (start, end, time)
