"""Scenarios read off a rollout's scene: as driven to the bit, and from a time on as edited."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from unisim_blender.core.scenario import apply_scenario
from unisim_blender.core.scenario.edit import Edit
from unisim_blender.core.scenario.edits import Duplicate, Ego, Move, Remove, Swap
from unisim_blender.core.scenario.motion.keys import Keyframe
from unisim_blender.core.scenario.motion.placement import Placement
from unisim_blender.core.scenario.types import Scenario
from unisim_blender.core.simulation.world import jumps
from unisim_blender.core.world.drive import Drive
from unisim_blender.editing.sampled.source import DriveSource, scene_actors
from unisim_blender.editing.simulation.continued import DrivenScenario, as_driven

START_S = 0.8
CAR, TRUCK = "car-03", "car-02"


def keys(drive: Drive, of: str, left_m: float, digits: int | None = None) -> tuple[Keyframe, ...]:
    """Keys of an actor, or the vehicle, that goes ever further to the left, every 50 ms; rounded as Blender's are."""
    trajectory = drive.world_from_ego if of == "ego" else drive.actors[of].world_from_actor
    found = []
    for time_s in np.arange(0.0, 1.901, 0.05):
        place, quaternion = (part.tolist() for part in trajectory.placed_at(time_s))
        place[1] += left_m * time_s
        if digits is not None:
            place, quaternion = ([round(value, digits) for value in part] for part in (place, quaternion))
        found.append(Keyframe(position=tuple(place), quaternion_wxyz=tuple(quaternion), time_s=float(time_s)))
    return tuple(found)


def scenario(source: DriveSource, *edits: Edit) -> Scenario:
    """A scenario of the drive."""
    return Scenario(name="a", log="log", edits=edits, path=Path("/tmp/a.json"))


def drive_of(found: Scenario, source: DriveSource) -> Drive:
    """The drive that a scenario leads to."""
    return apply_scenario(found, source.drive, scene_actors)


@pytest.fixture
def driven(source: DriveSource) -> DrivenScenario:
    """A rollout in which the vehicle and a car left their paths, and a truck looked like a car."""
    edits = (
        Swap(TRUCK, appearance="car-13"),
        Ego(trajectory=keys(source.drive, "ego", 0.5), outside="continue"),
        Move(CAR, trajectory=keys(source.drive, CAR, -0.3)),
    )
    found = scenario(source, *edits)
    return DrivenScenario(found, drive_of(found, source))


def read(source: DriveSource, *others: Edit, left_m: float = -0.3) -> Scenario:
    """What is read off that rollout's scene: rounded, and with other edits."""
    return scenario(
        source,
        Swap(TRUCK, appearance="car-13"),
        Ego(trajectory=keys(source.drive, "ego", 0.5, digits=6)),
        Move(CAR, trajectory=keys(source.drive, CAR, left_m, digits=6)),
        *others,
    )


@pytest.mark.parametrize("start_s", [None, START_S])
def test_what_is_not_edited_is_the_rollouts(source: DriveSource, driven: DrivenScenario, start_s: float | None) -> None:
    found = as_driven(read(source), source, driven, start_s)
    assert set(found.edits) == set(driven.scenario.edits)
    again = drive_of(found, source)
    for name, camera in again.cameras.items():
        assert camera.world_from_camera.content() == driven.drive.cameras[name].world_from_camera.content()


def test_an_edit_without_a_start_holds_throughout(source: DriveSource, driven: DrivenScenario) -> None:
    edited = read(source, left_m=1.0)
    found = as_driven(edited, source, driven)
    assert edited.edits[2] in found.edits and driven.scenario.edits[1] in found.edits


def test_what_is_moved_jumps_at_the_start(source: DriveSource, driven: DrivenScenario) -> None:
    found = drive_of(as_driven(read(source, left_m=1.0), source, driven, START_S), source)
    before, after = driven.drive.actors[CAR].world_from_actor, found.actors[CAR].world_from_actor
    past = before.times_s < START_S - 1e-4
    assert (after.times_s[: past.sum()] == before.times_s[past]).all()
    assert (after.positions[: past.sum()] == before.positions[past]).all()
    assert jumps(after, START_S) and not jumps(before, START_S)
    apart = [after.at(time_s)[1, 3] - before.at(time_s)[1, 3] for time_s in (START_S - 2e-6, START_S, 1.5)]
    assert apart == pytest.approx([0.0, 1.3 * START_S, 1.3 * 1.5], abs=2e-6)
    assert found.world_from_ego.content() == driven.drive.world_from_ego.content()


def test_the_vehicle_can_be_put_elsewhere(source: DriveSource, driven: DrivenScenario) -> None:
    edited = read(source)
    moved = replace(edited, edits=(Ego(trajectory=keys(source.drive, "ego", 2.0)), *edited.edits[2:]))
    found = drive_of(as_driven(moved, source, driven, START_S), source)
    before, after = driven.drive.world_from_ego, found.world_from_ego
    assert after.at(START_S)[1, 3] - before.at(START_S)[1, 3] == pytest.approx(1.5 * START_S, abs=1e-6)
    name = next(iter(found.cameras))
    early, late = (drive.cameras[name].world_from_camera for drive in (driven.drive, found))
    assert (early.at(START_S / 2) == late.at(START_S / 2)).all()
    assert late.at(1.5)[1, 3] - early.at(1.5)[1, 3] == pytest.approx(1.5 * 1.5, abs=1e-3)


def test_what_is_removed_is_there_until_the_start(source: DriveSource, driven: DrivenScenario) -> None:
    """With its appearance, which was an edit, too."""
    edited = scenario(source, *read(source).edits[1:], Remove(TRUCK))
    assert TRUCK not in drive_of(as_driven(edited, source, driven), source).actors
    actor = drive_of(as_driven(edited, source, driven, START_S), source).actors[TRUCK]
    assert actor.appearance.actor == "car-13"
    assert actor.present(START_S - 0.001) and not actor.present(START_S)


@pytest.mark.parametrize("standing", [True, False])
def test_what_is_added_is_there_from_the_start_on(source: DriveSource, driven: DrivenScenario, standing: bool) -> None:
    pose = Placement(position=(15.0, 3.0, 0.7), yaw_deg=0.0)
    offset = None if standing else (0.0, 3.0, 0.0)
    new = Duplicate(CAR, "new", **({"pose": pose} if standing else {"offset_m": offset}))
    found = drive_of(as_driven(read(source, new), source, driven, START_S), source).actors["new"]
    assert not found.present(START_S - 0.001) and found.present(START_S) and found.present(1.5)
    if standing:
        assert np.ptp(found.world_from_actor.positions, axis=0).max() == 0 and not found.is_moving
