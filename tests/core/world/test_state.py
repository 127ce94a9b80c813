"""A state's digest tells whether anything differs that a sensor could see."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from busy_drive import busy_drive

from unisim_blender.core.geometry import FloatArray, Trajectory
from unisim_blender.core.world.drive import Actor, Drive
from unisim_blender.core.world.replay import DriveStates, WorldState

WINDOW = (0.18, 0.24)


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return busy_drive(tmp_path_factory.mktemp("busy"))


def state_of(drive: Drive, window: tuple[float, float] = WINDOW) -> WorldState:
    return DriveStates(drive, {}).state(*window)


def with_actor(drive: Drive, uid: str, change: Callable[[Actor], Actor]) -> Drive:
    return replace(drive, actors={**drive.actors, uid: change(drive.actors[uid])})


def nudged(trajectory: Trajectory, near_s: float, of: str = "positions", by: float = 1e-9) -> Trajectory:
    """The trajectory with one number of the last key before a time changed."""
    values: FloatArray = getattr(trajectory, of).copy()
    key = max(int(np.searchsorted(trajectory.times_s, near_s, side="right")) - 1, 0)
    values[key, ...] += by if values.ndim == 1 else np.eye(values.shape[1])[0] * by
    changes: dict[str, Any] = {of: values}
    return replace(trajectory, **changes)


def turned(actor: Actor) -> Actor:
    return replace(actor, world_from_actor=nudged(actor.world_from_actor, 0.2, "quaternions_wxyz"))


def appearance(**changes: str) -> Callable[[Actor], Actor]:
    return lambda actor: replace(actor, appearance=replace(actor.appearance, **changes))


CHANGED_ACTORS: dict[str, tuple[str, Callable[[Actor], Actor]]] = {
    "moved": ("near", lambda a: replace(a, world_from_actor=nudged(a.world_from_actor, 0.2))),
    "moved, with one key": ("cone", lambda a: replace(a, world_from_actor=nudged(a.world_from_actor, 0.2))),
    "turned": ("near", turned),
    "later": ("near", lambda a: replace(a, world_from_actor=nudged(a.world_from_actor, 0.2, "times_s"))),
    "renamed": ("near", lambda a: replace(a, uid="nearer")),
    "of another label": ("near", lambda a: replace(a, label="Van")),
    "scaled": ("cone", lambda a: replace(a, scale=(1.5, 0.8, 2.0 + 1e-9))),
    "larger": ("cone", lambda a: replace(a, size_m=a.size_m + [0, 1e-9, 0])),
    "of another appearance": ("near", appearance(actor="cone")),
    "of another scene": ("guest", appearance(scene="elsewhere")),
    "of another mesh": ("cube", appearance(mesh="/elsewhere.ply")),
    "inserted": ("near", lambda a: replace(a, inserted=True)),
    "a body": ("cube", lambda a: replace(a, is_ego_body=True)),
    "still": ("near", lambda a: replace(a, is_moving=False)),
    "late": ("near", lambda a: replace(a, start_s=0.19)),
    "gone early": ("near", lambda a: replace(a, end_s=0.23)),
}


@pytest.mark.parametrize("what", CHANGED_ACTORS)
def test_another_actor_is_another_state(drive: Drive, what: str) -> None:
    uid, change = CHANGED_ACTORS[what]
    before, after = state_of(drive), state_of(with_actor(drive, uid, change))
    assert len(after.actors) == len(before.actors)
    assert after.digest != before.digest and after != before and hash(after) != hash(before)


def moved(pose: FloatArray) -> FloatArray:
    out = pose.copy()
    out[1, 3] += 1e-9
    return out


def changed_drives(drive: Drive) -> dict[str, Drive]:
    (copy,), (box,) = drive.static_copies, drive.static_removals
    far = replace(box, world_from_box=moved(box.world_from_box))
    source = copy.source
    copies = {
        "renamed": replace(copy, uid="other"),
        "moved": replace(copy, world_from_target=moved(copy.world_from_target)),
        "of elsewhere": replace(copy, source=replace(source, world_from_box=moved(source.world_from_box))),
        "larger": replace(copy, source=replace(source, size_m=source.size_m + 1e-9)),
    }
    return {
        "nobody": replace(drive, actors={}),
        "one is gone": replace(drive, actors={uid: a for uid, a in drive.actors.items() if uid != "near"}),
        "the ego": replace(drive, world_from_ego=nudged(drive.world_from_ego, 0.2)),
        "no copy": replace(drive, static_copies=()),
        "two copies": replace(drive, static_copies=(copy, copy)),
        "no box": replace(drive, static_removals=()),
        "two boxes": replace(drive, static_removals=(box, box)),
        "the box moved": replace(drive, static_removals=(far,)),
        "a larger box": replace(drive, static_removals=(replace(box, size_m=box.size_m + 1e-9),)),
        "the boxes' order": replace(drive, static_removals=(far, box)),
        "the boxes' other order": replace(drive, static_removals=(box, far)),
        **{f"a copy that is {name}": replace(drive, static_copies=(one,)) for name, one in copies.items()},
    }


def test_whatever_differs_the_digest_does(drive: Drive) -> None:
    states = {name: state_of(one) for name, one in changed_drives(drive).items()}
    states["as it is"] = state_of(drive)
    states["starts earlier"] = state_of(drive, (np.nextafter(WINDOW[0], 0), WINDOW[1]))
    states["ends later"] = state_of(drive, (WINDOW[0], np.nextafter(WINDOW[1], 1)))
    digests = {name: state.digest for name, state in states.items()}
    assert len(set(digests.values())) == len(digests)
    assert all(len(digest) == 32 and int(digest, 16) >= 0 for digest in digests.values())


def test_names_do_not_run_into_each_other(drive: Drive) -> None:
    """What ends one name and begins the next counts."""
    cube = drive.actors["cube"]
    names = [("ab", "c", "d"), ("a", "bc", "d"), ("a", "b", "cd"), ("abc", "", "d"), ("", "abc", "d"), ("abcd", "", "")]
    states = []
    for label, actor, mesh in names:
        one = replace(cube, label=label, appearance=replace(cube.appearance, actor=actor, mesh=mesh))
        states.append(state_of(replace(drive, actors={"cube": one})))
    assert len({state.digest for state in states}) == len(names)


def outside(drive: Drive) -> dict[str, Drive]:
    """Drives that differ beyond the window alone."""

    def trajectory(uid: str, at: float, of: str = "positions", by: float = 1.0) -> Drive:
        return with_actor(drive, uid, lambda a: replace(a, world_from_actor=nudged(a.world_from_actor, at, of, by)))

    far = drive.actors["late"]
    return {
        "a key long before": trajectory("near", -0.05),
        "a key long after": trajectory("near", 0.55),
        "a time long after": trajectory("near", 0.55, "times_s", 1e-3),
        "the ego's keys": replace(drive, world_from_ego=nudged(drive.world_from_ego, 0.5)),
        "who comes later": trajectory("late", 0.4),
        "who has left": replace(drive, actors={uid: a for uid, a in drive.actors.items() if uid != "early"}),
        "one more who comes later": replace(drive, actors={**drive.actors, "later": replace(far, uid="later")}),
        "how long one stays": with_actor(drive, "near", lambda a: replace(a, end_s=0.3)),
        "since when one is there": with_actor(drive, "near", lambda a: replace(a, start_s=0.15)),
        "sensors": replace(drive, cameras={}, lidars={}, name="other"),
        "the order of actors": replace(drive, actors=dict(reversed(drive.actors.items()))),
    }


def test_what_is_out_of_the_window_does_not_count(drive: Drive) -> None:
    before = state_of(drive)
    for name, one in outside(drive).items():
        after = state_of(one)
        assert after.digest == before.digest and after == before and hash(after) == hash(before), name
    assert before != "a state"


def test_the_same_drive_read_again_has_the_same_digest(tmp_path: Path) -> None:
    one, two = busy_drive(tmp_path), busy_drive(tmp_path)
    assert one is not two and state_of(one) == state_of(two)


def test_a_state_of_some_actors_alone(drive: Drive) -> None:
    state = state_of(drive)
    few = state.restricted({"van", "cone", "nobody"})
    assert [actor.uid for actor in few.actors] == ["cone", "van"] and few.removed_boxes == state.removed_boxes
    assert few != state and state.restricted([actor.uid for actor in state.actors]) == state
