"""Executors of a batch: every unit once, those of the scene that is held first, and one failure ends no other unit."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from unisim_blender.core.batch.executors import BATCH_EXECUTORS
from unisim_blender.core.batch.executors.processes import MOST_LOSSES
from unisim_blender.core.batch.executors.queue import SceneQueue
from unisim_blender.core.errors import UnisimError


@dataclass(frozen=True)
class Number:
    scene: str
    number: int


@dataclass(frozen=True)
class Squares:
    """Makes a function that squares numbers, fails at 3, and whose process is ended at 5, so often as ``ended`` says."""

    folder: Path
    ended: int = 0

    def __call__(self) -> Callable[[Number], int]:
        return self.square

    def square(self, unit: Number) -> int:
        with (self.folder / f"of-{os.getpid()}").open("a", encoding="utf-8") as file:
            file.write(unit.scene)
        if unit.number == 3:
            raise UnisimError("3 cannot be squared")
        if unit.number == 5 and len(list(self.folder.glob("ended-*"))) < self.ended:
            (self.folder / f"ended-{os.getpid()}").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return unit.number**2


UNITS = [Number("ab"[number % 2], number) for number in range(8)]


@pytest.mark.parametrize("name", BATCH_EXECUTORS)
def test_every_unit_has_one_outcome(name: str, tmp_path: Path) -> None:
    ended = 1 if name == "processes" else 0
    outcomes = list(BATCH_EXECUTORS[name].run(Squares(tmp_path, ended), UNITS, 2))
    assert sorted(outcome.index for outcome in outcomes) == list(range(8))
    failed = {outcome.index: outcome.failure for outcome in outcomes if outcome.failure}
    assert failed == {3: "3 cannot be squared"}
    assert all(outcome.result == outcome.index**2 for outcome in outcomes if not outcome.failure)
    assert len(list(tmp_path.glob("ended-*"))) == ended


def test_a_unit_that_ends_its_processes_fails_alone(tmp_path: Path) -> None:
    units = [Number("a", 5), Number("a", 6)]
    outcomes = {one.index: one for one in BATCH_EXECUTORS["processes"].run(Squares(tmp_path, 99), units, 1)}
    assert outcomes[1].result == 36
    assert f"ended from outside {MOST_LOSSES} times" in str(outcomes[0].failure)
    assert len(list(tmp_path.glob("ended-*"))) == MOST_LOSSES


def test_one_process_loads_each_scene_once(tmp_path: Path) -> None:
    list(BATCH_EXECUTORS["this-process"].run(Squares(tmp_path), UNITS, 1))
    assert (tmp_path / f"of-{os.getpid()}").read_text(encoding="utf-8") == "aaaabbbb"


def test_units_of_the_held_scene_go_first() -> None:
    queue = SceneQueue([Number(scene, 0) for scene in "aabbbb"])
    assert queue.take(None) == 2, "of the scene with the most units"
    assert queue.take("a", ["b"]) == 0
    assert queue.take("b", ["a"]) == 3
    assert queue.take(None, ["b", "b", "b"]) == 1, "one unit of a, and two of b for three workers"
    queue.put_back(1)
    assert queue.take("a") == 1
    assert [queue.take("a"), queue.take("b"), queue.take("b")] == [4, 5, None]
