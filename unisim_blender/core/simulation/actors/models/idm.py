"""The model `idm`."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache

from ....world.actor_path import ActorPath, joined
from ....world.captures import US_PER_SECOND
from ....world.drive import Actor
from ...states import ActorState, Traffic, actor_footprint
from ..follow import IdmParameters, PathProgress, advanced, search_of
from ..lead import Lead, touching
from ..model import ActorMotion, Answer, Model, Pending, after, register
from ..recording import Recording
from .replay import Replay

SAME_M, SAME_TURN = 1e-6, 1 - 1e-12
"""An actor so near to a place is there: the second is the cosine of half an angle."""
RETURN_M = 5.0
"""Within this distance what labels wander comes back to the path."""


@dataclass(frozen=True)
class RecordedMemory:
    """Memory of an actor that is where the recording has it. ``waits``: its time to appear has come and its place is taken."""

    world: Recording
    waits: bool = False
    people: ActorMotion | None = None
    """State of `Replay` for a pedestrian, which no model here moves otherwise."""


@dataclass(frozen=True)
class FollowingMemory:
    """Memory of an actor that follows a path. ``stage`` is the model's own."""

    world: Recording
    progress: PathProgress
    stage: int = 0


@register
@dataclass(frozen=True)
class Idm(IdmParameters, Model):
    """Along its recorded path at the speed recorded there, behind whatever is in its way.

    It stands where and until when the recording stood. The defaults are nuPlan's. Beyond the path's end it goes straight on, or
    leaves the world where the recording lost it. Pedestrians replay.
    """

    type = "idm"

    def start(self, actor: Actor, world: Recording, time_us: int) -> ActorMotion:
        if actor.uid in world.people:
            replayed = _replay().start(actor, world, time_us)
            return ActorMotion(replayed.state, RecordedMemory(world, people=replayed))
        return ActorMotion(world.state(actor.uid, time_us), RecordedMemory(world))

    def answer(self, actor: Actor, motion: ActorMotion, traffic: Traffic, time_us: int, step_us: int) -> Answer:
        memory = motion.memory
        if isinstance(memory, FollowingMemory):
            return self.follow(actor, memory, time_us, step_us)
        assert isinstance(memory, RecordedMemory)
        if memory.people is not None:
            replayed = _replay().answer(actor, memory.people, traffic, time_us, step_us)
            return after(replayed, lambda walked: ActorMotion(walked.state, replace(memory, people=walked)))
        return self.released(actor, motion, memory, traffic, time_us, step_us)

    def path_of(self, actor: Actor, world: Recording) -> ActorPath | None:
        """Return the path that the actor follows; None where it stands."""
        return world.paths[actor.uid]

    def released(
        self, actor: Actor, motion: ActorMotion, memory: RecordedMemory, traffic: Traffic, time_us: int, step_us: int
    ) -> Answer:
        """Return the state after the first step by the driver model, or where the recording has the actor if it stands or is
        not there yet. An actor whose first place is taken appears when that is free."""
        world, later_us = memory.world, time_us + step_us
        path = self.path_of(actor, world)
        if path is None:
            return ActorMotion(world.state(actor.uid, later_us), memory)
        if motion.state.present:
            following = begun(actor, path, motion.state, world, path.s_at_time(time_us / US_PER_SECOND))
            return self.follow(actor, following, time_us, step_us)
        state, (start, end) = world.state(actor.uid, later_us), world.windows_s[actor.uid]
        if not start <= later_us / US_PER_SECOND <= end:
            return ActorMotion(replace(state, present=False), memory)
        if memory.waits:
            position, quaternion = path.place(0.0)
            state = ActorState(position, quaternion, path.speed_at(0.0))
        if touching(actor_footprint(actor, state), traffic):
            return ActorMotion(replace(state, present=False), replace(memory, waits=True))
        s = 0.0 if memory.waits else path.s_at_time(later_us / US_PER_SECOND)
        return ActorMotion(state, begun(actor, path, state, world, s))

    def follow(self, actor: Actor, memory: FollowingMemory, time_us: int, step_us: int) -> Answer:
        """Return the state after a step along the path, which depends on what is in the way there."""
        length, width, _ = actor.size_m.tolist()
        progress = memory.progress
        if progress.is_over:
            return ActorMotion(progress.state(), memory)

        def then(lead: Lead | None) -> ActorMotion:
            after_step = advanced(progress, self, lead, time_us, step_us)
            return ActorMotion(after_step.state(), FollowingMemory(memory.world, after_step, memory.stage))

        return Pending(search_of(progress, self, (length, width), actor.uid), then)


def begun(actor: Actor, path: ActorPath, state: ActorState, world: Recording, s_m: float) -> FollowingMemory:
    """Return the start of following a path from where an actor is, at its speed, near an arc length."""
    speed = state.speed_m_s if path.gear_at(s_m) > 0 else path.speed_at(s_m)
    ignored = world.passed(actor, path)
    if _is_on(path, s_m, state):
        return FollowingMemory(world, PathProgress(path, s_m, speed, ignored=ignored))
    onto = joined(path, s_m, state.position_m, state.quaternion_wxyz, RETURN_M)
    return FollowingMemory(world, PathProgress(onto, 0.0, speed, ignored=ignored))


def _is_on(path: ActorPath, s_m: float, state: ActorState) -> bool:
    """Return whether an actor is at a place of a path: then nothing has to come back to it."""
    position, quaternion = path.place(s_m)
    turned = abs(sum(a * b for a, b in zip(quaternion, state.quaternion_wxyz, strict=True)))
    return math.dist(position, state.position_m) <= SAME_M and turned >= SAME_TURN


@cache
def _replay() -> Replay:
    """Return the model of pedestrians. Not made with the module: the check of parameters takes a package."""
    return Replay()
