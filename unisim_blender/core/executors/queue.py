"""The units that wait: a worker takes those of the scene that it holds first."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from .executor import MOST_LOSSES, Outcome, ProcessLost


class SceneQueue:
    """Indices of waiting units, by scene, in the order in which they were given, and how often the worker of each was lost."""

    def __init__(self, scenes: Sequence[str]) -> None:
        self._scenes = scenes
        self._losses = [0] * len(scenes)
        self._waiting: dict[str, deque[int]] = {}
        for index, scene in enumerate(scenes):
            self._waiting.setdefault(scene, deque()).append(index)

    def take(self, held: str | None, others: Sequence[str | None] = ()) -> int | None:
        """Return the next unit for a worker that holds a scene; ``others`` are held by other workers. None where no
        unit waits.

        Where none of the held scene waits, it is of the scene with the most waiting units for each worker that holds it.
        """
        waiting = {scene: units for scene, units in self._waiting.items() if units}
        if not waiting:
            return None
        if held not in waiting:
            held = max(waiting, key=lambda scene: len(waiting[scene]) / (1 + list(others).count(scene)))
        return waiting[held].popleft()

    def lost(self, index: int) -> Outcome[None] | None:
        """Have a unit whose worker was lost wait again, before the others of its scene. Where that was the last time, its outcome
        is returned."""
        self._losses[index] += 1
        if self._losses[index] < MOST_LOSSES:
            self._waiting[self._scenes[index]].appendleft(index)
            return None
        return Outcome(
            index, error=ProcessLost(f"its process was ended from outside {MOST_LOSSES} times (out of memory?)")
        )


def scenes_or_one(scenes: Sequence[str] | None, units: int) -> Sequence[str]:
    """Return the scenes of so many units: one for all, where none are given."""
    return [""] * units if scenes is None else scenes
