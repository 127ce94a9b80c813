"""A scenario read off the scene of a rollout: what was not edited since it was opened is as driven, to the bit.

Blender's keys are float32 and are read at the log's frames. A rollout's own edits have every key of its trajectories.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

from ...core.geometry import FloatArray, Trajectory
from ...core.scenario import apply_scenario, load_scenario, rebased
from ...core.scenario.edit import Edit
from ...core.scenario.edits import Ego, Move
from ...core.scenario.motion.keys import Keyframe, Present
from ...core.scenario.types import Scenario
from ...core.simulation.world import CLOSE_S, JUMP_US
from ...core.world.captures import US_PER_SECOND
from ...core.world.drive import Actor, Drive
from ..sampled.clock import Clock
from ..sampled.scene import differ, same
from ..sampled.source import DriveSource, scene_actors


@dataclass(frozen=True, eq=False)
class DrivenScenario:
    """The scenario that a rollout left, and the drive that it leads to."""

    scenario: Scenario
    drive: Drive


_newest: dict[tuple[Path, int, int], DrivenScenario] = {}


def open_driven(path: Path, source: DriveSource) -> DrivenScenario:
    """Return the scenario in a rollout's file and its drive, which is kept until the file changes or another is asked
    for.

    Raises `UnisimError`.
    """
    try:
        about = path.stat()
    except OSError:
        about = None
    key = (path, about.st_mtime_ns if about else 0, id(source))
    if key not in _newest:
        scenario = load_scenario(path)
        driven = DrivenScenario(scenario, apply_scenario(replace(scenario, sensors=None), source.drive, scene_actors))
        _newest.clear()
        _newest[key] = driven
    return _newest[key]


def as_driven(read: Scenario, source: DriveSource, driven: DrivenScenario, start_s: float | None = None) -> Scenario:
    """Return a scenario that was read off a rollout's scene with the rollout's own trajectories where they are not
    edited.

    With ``start_s`` those that are edited, too, are as driven before that time and as edited from then on: what is
    elsewhere then jumps there. What was added since is there from then on, and what was removed until then. Sizes,
    appearances, static items and sensors are as read throughout. Raises `ScenarioError`.
    """
    clock = Clock.of(source.drive)
    edited = apply_scenario(replace(read, sensors=None, frames=None, times=None), source.drive, scene_actors)
    own = rebased(driven.scenario, read.path).edits
    edits = _ego_edits(read.edits, edited, driven, clock, start_s)
    for uid in sorted({*driven.drive.actors, *edited.actors}):
        before, now = driven.drive.actors.get(uid), edited.actors.get(uid)
        if not any(actor is not None and actor.is_ego_body for actor in (before, now)):
            edits = _actor_edits(edits, uid, before, now, own, clock, start_s)
    return replace(read, edits=tuple(edits))


def _ego_edits(
    edits: Iterable[Edit], edited: Drive, driven: DrivenScenario, clock: Clock, start_s: float | None
) -> list[Edit]:
    """Return edits with the vehicle's as driven."""
    own = [edit for edit in driven.scenario.edits if isinstance(edit, Ego)]
    rest = [edit for edit in edits if not isinstance(edit, Ego)]
    before, now = driven.drive.world_from_ego, edited.world_from_ego
    if same(now.at(clock.times_s), before.at(clock.times_s)).all():
        return [*rest, *own]
    if start_s is None:
        return list(edits)
    shifts = [edit for edit in own if edit.trajectory is None]
    return [*rest, *shifts, Ego(trajectory=_cut(before, now, start_s, clock), outside="continue")]


def _actor_edits(
    edits: list[Edit],
    uid: str,
    before: Actor | None,
    now: Actor | None,
    own: Iterable[Edit],
    clock: Clock,
    start_s: float | None,
) -> list[Edit]:
    """Return edits with an actor's as driven. ``own`` are the rollout's, as the new file names their files."""
    moves = [edit for edit in own if isinstance(edit, Move) and edit.actor == uid and edit.trajectory is not None]
    rest = [edit for edit in edits if not (isinstance(edit, Move) and edit.actor == uid)]
    if before is not None and now is not None:
        times = clock.times_s
        was_at, is_at = before.world_from_actor.at(times), now.world_from_actor.at(times)
        if not differ(is_at, now.present(times), was_at, before.present(times)):
            return [*rest, moves[-1]] if moves else edits
        if start_s is None:
            return edits
        keys = _cut(before.world_from_actor, now.world_from_actor, start_s, clock)
        return [*rest, Move(uid, trajectory=keys, present=_present(before.start_s, now.end_s, clock))]
    if start_s is None:
        return edits
    if before is not None:  # removed since
        known = [edit for edit in edits if not edit.removes(uid)]
        known += [edit for edit in own if _is_about(edit, uid) and edit not in known and not isinstance(edit, Move)]
        keys = _standing(before.world_from_actor, clock)
        return [
            *known,
            Move(uid, trajectory=keys, present=_present(before.start_s, start_s - JUMP_US / US_PER_SECOND, clock)),
        ]
    assert now is not None  # added since
    keys = _standing(now.world_from_actor, clock)
    return [*rest, Move(uid, trajectory=keys, present=_present(max(start_s, now.start_s), now.end_s, clock))]


def _cut(before: Trajectory, after: Trajectory, start_s: float, clock: Clock) -> tuple[Keyframe, ...]:
    """Return the keys of one trajectory up to a time and of another from then on."""
    jump_s = start_s - JUMP_US / US_PER_SECOND
    keys = _keys(before, clock)
    earlier = [key for key in keys if key[0] < jump_s - CLOSE_S]
    then = [key for key in _keys(after, clock) if key[0] > start_s + CLOSE_S]
    return tuple(_keyframe(key) for key in (*earlier, _key_at(before, jump_s), _key_at(after, start_s), *then))


TrajectoryKey = tuple[float, FloatArray, FloatArray]


def _keys(trajectory: Trajectory, clock: Clock) -> list[TrajectoryKey]:
    """Return a trajectory's keys; two, at the drive's ends, where it has one."""
    if len(trajectory.times_s) > 1:
        return list(zip(trajectory.times_s.tolist(), trajectory.positions, trajectory.quaternions_wxyz, strict=True))
    return [_key_at(trajectory, time_s) for time_s in clock.times_s[[0, -1]].tolist()]


def _key_at(trajectory: Trajectory, time_s: float) -> TrajectoryKey:
    return (time_s, *trajectory.placed_at(time_s))


def _standing(trajectory: Trajectory, clock: Clock) -> tuple[Keyframe, ...]:
    """Return a trajectory's keys: the one of what stands."""
    keys = _keys(trajectory, clock)
    return tuple(_keyframe(key) for key in (keys if len(trajectory.times_s) > 1 else keys[:1]))


def _keyframe(key: TrajectoryKey) -> Keyframe:
    x, y, z = key[1].tolist()
    a, b, c, d = key[2].tolist()
    return Keyframe(position=(x, y, z), quaternion_wxyz=(a, b, c, d), time_s=key[0])


def _present(start_s: float, end_s: float, clock: Clock) -> Present | None:
    """Return when an actor is there; None for throughout."""
    first, last = clock.times_s[0], clock.times_s[-1]
    start, end = (start_s if start_s > first else None), (end_s if end_s < last else None)
    return None if start is None and end is None else Present(start, end)


def _is_about(edit: Edit, uid: str) -> bool:
    """Return whether an edit adds an actor, or changes it."""
    return getattr(edit, "id", getattr(edit, "actor", None)) == uid
