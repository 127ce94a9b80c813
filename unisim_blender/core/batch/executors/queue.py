"""The units that wait: a worker takes those of the scene that it holds first."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from .executor import HasScene


class SceneQueue:
    """Indices of waiting units, by scene, in the order in which they were given."""

    def __init__(self, units: Sequence[HasScene]) -> None:
        self._scenes = [unit.scene for unit in units]
        self._waiting: dict[str, deque[int]] = {}
        for index, scene in enumerate(self._scenes):
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

    def put_back(self, index: int) -> None:
        """Have a unit wait again, before the others of its scene."""
        self._waiting[self._scenes[index]].appendleft(index)
