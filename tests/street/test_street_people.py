"""People of a street: limbs in step with the path, and the same in a drive, in a state of it, and after edits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unisim_blender.core.errors import LogError
from unisim_blender.core.geometry import FloatArray, Trajectory, transform_points
from unisim_blender.core.render.changes import changed_actors
from unisim_blender.core.world.drive import Actor
from unisim_blender.core.world.encoding import decode_state, encode_state
from unisim_blender.core.world.replay import DriveStates
from unisim_street.assets.meshed import meshed
from unisim_street.assets.people import CYCLIST_SIZE_M, PERSON_SIZE_M, WALK_CYCLE_M, cyclist, person
from unisim_street.street import Street, build_street, street_origin
from unisim_street.tracing.trace import Asset, AssetPlacement
from unisim_street.truth import make_world, truth_lidar, world_of_state


@pytest.fixture(scope="module")
def street() -> Street:
    return build_street(seed=1, frames=6, width=96, height=54, people=3)


def corners(asset: Asset, phase: float) -> FloatArray:
    limbs = [
        transform_points(limb.poses(np.array([phase]))[0], limb.asset.corners.reshape(-1, 3)) for limb in asset.limbs
    ]
    return np.concatenate([asset.corners.reshape(-1, 3), *limbs])


@pytest.mark.parametrize(("make", "size_m"), [(person, PERSON_SIZE_M), (cyclist, CYCLIST_SIZE_M)])
def test_people_fill_their_boxes_at_every_phase(make: object, size_m: FloatArray) -> None:
    asset: Asset = make("someone", np.random.default_rng(0))  # type: ignore[operator]
    points = np.concatenate([corners(asset, phase) for phase in np.linspace(0, 1, 40, endpoint=False)])
    assert (np.abs(points) <= size_m / 2 + 0.03).all(), (
        np.abs(points).max(0) - size_m / 2
    )  # corners of boxes about round bars
    assert (np.ptp(points, axis=0) > 0.78 * size_m).all()
    moved = corners(asset, 0.0) - corners(asset, 0.5)
    assert np.abs(moved).max() > 0.2
    assert [limb.asset.name for limb in meshed(asset).limbs] == [limb.asset.name for limb in asset.limbs]


@pytest.mark.parametrize("speed", [0.7, 1.5])
def test_a_foot_on_the_ground_does_not_slide(speed: float) -> None:
    asset = person("someone", np.random.default_rng(4))
    times = np.arange(0, 2, 0.05)
    path = np.stack([speed * times, 0 * times, 0 * times], -1)
    walk = Trajectory(times, path, np.tile([1.0, 0, 0, 0], (len(times), 1)))
    shoes = [p for p in AssetPlacement("a", asset, walk).limbs() if p.asset.name.endswith("shoe")]
    assert len(shoes) == 2
    for shoe in shoes:
        assert shoe.motion is not None
        heel = shoe.motion.positions[shoe.motion.times_s < 1.95]
        down = heel[:, 2] < heel[:, 2].min() + 1e-9
        both = down[1:] & down[:-1]
        assert both.mean() > 0.3 and np.abs(np.diff(heel[:, 0])[both]).max() < 1e-9
        assert np.ptp(heel[:, 0] - speed * shoe.motion.times_s[shoe.motion.times_s < 1.95]) > 0.4 * WALK_CYCLE_M


def test_states_and_messages_have_the_limbs_of_the_drive(street: Street) -> None:
    drive = street.drive
    state = DriveStates(drive, {}).state(0.31, 0.44)
    assert len(state.actors[-1].world_from_actor.times_s) < 6
    state = decode_state(encode_state(state))
    whole = make_world(street, drive)
    part = world_of_state(street, street_origin(drive.world_origin), state)
    assert len(whole.placements) == len(part.placements) > len(drive.actors) + 27
    for a, b in zip(whole.placements, part.placements, strict=True):
        if a.motion is not None and b.motion is not None:
            assert a.name == b.name and np.allclose(a.motion.at(0.4), b.motion.at(0.4), atol=1e-9)


def test_a_person_retimed_has_the_same_limbs_at_the_same_place(street: Street) -> None:
    actor = street.drive.actors["person-01"]
    slow = replace(actor.world_from_actor, times_s=2 * actor.world_from_actor.times_s)
    drive = replace(street.drive, actors={"person-01": replace(actor, world_from_actor=slow, end_s=2.0)})
    late, early = make_world(street, drive).placements, make_world(street, street.drive).placements
    limbs = [[p for p in placements if p.asset.name.startswith("person-01-")] for placements in (late, early)]
    assert len(limbs[0]) == len(limbs[1]) == 10
    for a, b in zip(*limbs, strict=True):
        assert a.motion is not None and b.motion is not None
        assert np.allclose(a.motion.at(0.4), b.motion.at(0.2), atol=2e-3)  # limbs move evenly for 10 ms
    assert make_world(street, drive).instances == ("person-01",)


def test_sweeps_hit_limbs_and_name_their_person(street: Street) -> None:
    sweep = truth_lidar(street, street.drive, "pandar64", 3)
    number = sweep.instances.index("cyclist-1") + 1
    points = (sweep.origins + sweep.directions * sweep.depth_m[..., None])[sweep.instance == number]
    assert len(points) > 100
    pose = street.drive.actors["cyclist-1"].world_from_actor.at(0.3)
    local = (points - pose[:3, 3]) @ pose[:3, :3]
    legs = local[(np.abs(local[:, 2] + 0.3) < 0.25) & (np.abs(local[:, 1]) > 0.05)]
    assert len(legs) > 10 and (np.abs(local[:, 1:]) <= CYCLIST_SIZE_M[1:] / 2 + 0.02).all()


def test_people_are_part_of_the_recipe_and_change_nothing_else() -> None:
    street, empty = (build_street(seed=2, frames=3, width=32, height=18, people=n) for n in (1, 0))
    assert street.recipe != empty.recipe
    assert set(street.drive.actors) - set(empty.drive.actors) == {"person-01"}
    for uid, actor in empty.drive.actors.items():
        assert np.array_equal(actor.world_from_actor.positions, street.drive.actors[uid].world_from_actor.positions)
    with pytest.raises(LogError, match="people is a whole number from 0 to 100, not -1"):
        build_street(people=-1)


def test_a_state_differs_where_a_person_has_come_a_longer_way(street: Street) -> None:
    state = DriveStates(street.drive, {}).state(0.31, 0.44)

    def further(uid: str) -> tuple[Actor, ...]:
        at = next(i for i, actor in enumerate(state.actors) if actor.uid == uid)
        actor = state.actors[at]
        longer = replace(actor.world_from_actor, start_walked_m=actor.world_from_actor.start_walked_m + 0.2)
        return (*state.actors[:at], replace(actor, world_from_actor=longer), *state.actors[at + 1 :])

    assert replace(state, actors=further("car-01")) == state
    assert replace(state, actors=further("person-01")) != state
    camera = street.drive.cameras["front_camera"]
    for uid, changed in (("car-01", 0), ("person-01", 2)):
        assert len(changed_actors(state, replace(state, actors=further(uid)), camera)) == changed
