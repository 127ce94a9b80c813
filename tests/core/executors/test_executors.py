"""Executors: one outcome of every unit, those of the scene that is held first; what goes wrong reaches the caller."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.executors import EXECUTORS, RayCluster, executor_at, usual_executor
from unisim_blender.core.executors.dispatch import SceneQueue
from unisim_blender.core.executors.executor import (
    MAX_LOSSES,
    ProcessLost,
    WorkerState,
    attempt,
    register,
    results_of,
    sentence,
)

HERE = ("this-process", "processes")
"""Executors that need nothing else."""
UNITS = range(8)
SCENES = [f"scene {'ab'[number % 2]}" for number in UNITS]


@dataclass(frozen=True)
class Squares:
    """Makes a function that squares numbers, and notes in ``folder`` what each process did. It fails at ``fails_at``; its process
    is ended at ``ends_at``, so often as ``ended`` says."""

    folder: Path
    fails_at: int | None = None
    ends_at: int | None = None
    ended: int = 99

    def __call__(self) -> Callable[[int], int]:
        with (self.folder / "made").open("a", encoding="utf-8") as file:
            file.write(f"{os.getpid()}\n")
        if self.ends_at == -1:
            os.kill(os.getpid(), signal.SIGKILL)
        if self.fails_at == -1:
            raise ValueError("nothing can be squared")
        return self.square

    def square(self, number: int) -> int:
        with (self.folder / f"of-{os.getpid()}").open("a", encoding="utf-8") as file:
            file.write(SCENES[number][-1])
        if number == self.fails_at:
            raise UnisimError(f"{number} cannot be squared")
        if number == self.ends_at and len(list(self.folder.glob("ended-*"))) < self.ended:
            (self.folder / f"ended-{os.getpid()}").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return number * number

    def made(self) -> list[int]:
        return [int(line) for line in (self.folder / "made").read_text(encoding="utf-8").split()]


class Stubborn(Exception):
    """An error that cannot be made again of its message."""

    def __init__(self, number: int, reason: str) -> None:
        super().__init__(f"{number}: {reason}")


@pytest.mark.parametrize("name", HERE)
def test_every_unit_has_one_outcome(name: str, tmp_path: Path) -> None:
    ended = 1 if name == "processes" else 0
    squares, states = Squares(tmp_path, fails_at=3, ends_at=5, ended=ended), list[WorkerState]()
    outcomes = list(EXECUTORS[name].run(squares, UNITS, 2, SCENES, states.append))
    assert sorted(outcome.index for outcome in outcomes) == list(UNITS)
    assert {one.index: str(one.error) for one in outcomes if one.error} == {3: "3 cannot be squared"}
    assert all(outcome.result == outcome.index**2 for outcome in outcomes if not outcome.error)
    assert len(list(tmp_path.glob("ended-*"))) == ended
    made = squares.made()
    if name == "this-process":
        assert made == [os.getpid()]
    else:
        assert len(set(made)) == len(made) <= 3 and os.getpid() not in made, "made once in every process"
    begun = [one.index for one in states if one.doing == "unit" and one.index is not None]
    assert sorted(begun) == sorted([*UNITS, *[5] * ended]), (
        "each unit is begun once, and again where its worker was lost"
    )
    assert [one.index for one in states if one.doing == "lost"] == [5] * ended
    for number in {one.number for one in states}:
        own = [one for one in states if one.number == number]
        assert own[0].doing == "starting"
        held = None
        for one in own:
            if one.doing == "starting":
                held = None
            elif one.doing == "unit":
                assert one.index is not None and one.loads_scene == (held != SCENES[one.index])
                held = SCENES[one.index]
    assert states[-1].doing == "idle"


def test_a_unit_that_ends_its_processes_fails_alone(tmp_path: Path) -> None:
    outcomes = {one.index: one for one in EXECUTORS["processes"].run(Squares(tmp_path, ends_at=0), range(2), 1)}
    assert outcomes[1].result == 1
    assert f"ended from outside {MAX_LOSSES} times" in sentence(outcomes[0].error or ValueError())
    assert len(list(tmp_path.glob("ended-*"))) == MAX_LOSSES


@pytest.mark.parametrize("name", HERE)
def test_nothing_is_made_for_no_units(name: str, tmp_path: Path) -> None:
    assert list(EXECUTORS[name].run(Squares(tmp_path), (), 2)) == []
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize("name", HERE)
def test_what_a_unit_or_the_making_raises_reaches_the_caller(name: str, tmp_path: Path) -> None:
    with pytest.raises(UnisimError, match="3 cannot be squared"):
        list(results_of(EXECUTORS[name].run(Squares(tmp_path, fails_at=3), range(5), 2)))
    with pytest.raises(ValueError, match="nothing can be squared"):
        list(EXECUTORS[name].run(Squares(tmp_path, fails_at=-1), range(5), 2))


def test_processes_that_never_start_are_told(tmp_path: Path) -> None:
    squares = Squares(tmp_path, ends_at=-1)
    with pytest.raises(ProcessLost, match="as they started"):
        list(EXECUTORS["processes"].run(squares, range(5), 1))
    assert len(squares.made()) == MAX_LOSSES


def test_every_error_can_be_sent() -> None:
    def fail() -> None:
        raise Stubborn(3, "is odd")

    outcome = attempt(0, fail)
    assert isinstance(outcome.error, RuntimeError) and sentence(outcome.error) == "RuntimeError: Stubborn: 3: is odd"
    assert "raise Stubborn" in outcome.details


def test_one_process_loads_each_scene_once(tmp_path: Path) -> None:
    list(EXECUTORS["this-process"].run(Squares(tmp_path), UNITS, 1, SCENES))
    assert (tmp_path / f"of-{os.getpid()}").read_text(encoding="utf-8") == "aaaabbbb"


def test_units_of_the_held_scene_go_first() -> None:
    queue = SceneQueue("aabbbb")
    assert queue.take(None) == 2, "of the scene with the most units"
    assert queue.take("a", ["b"]) == 0
    assert queue.take("b", ["a"]) == 3
    assert queue.take(None, ["b", "b", "b"]) == 1, "one unit of a, and two of b for three workers"
    assert queue.lost(1) is None and queue.take("a") == 1
    assert queue.lost(1) is None and queue.take("a") == 1
    assert (last := queue.lost(1)) and isinstance(last.error, ProcessLost), "the third time"
    assert [queue.take("a"), queue.take("b"), queue.take("b")] == [4, 5, None]


def test_executors_are_named_or_addressed() -> None:
    assert executor_at("processes") is EXECUTORS["processes"]
    assert executor_at("ray", 0.5) == RayCluster(None, 0.5)
    assert executor_at("ray://head:10001") == RayCluster("ray://head:10001")
    assert executor_at("10.0.0.7:6379") == RayCluster("10.0.0.7:6379")
    for wrong in ("rays", "head", "ray://", "http://head:80", "head:port"):
        with pytest.raises(UnisimError, match="is none of this-process, processes, ray"):
            executor_at(wrong)
    before = dict(EXECUTORS)
    with pytest.raises(ValueError, match="there is an executor 'processes' already"):
        register("processes", EXECUTORS["this-process"])
    assert before == EXECUTORS


@pytest.mark.parametrize(
    ("jobs", "units", "name"), [(1, 9, "this-process"), (4, 1, "this-process"), (2, 2, "processes")]
)
def test_one_unit_or_one_job_needs_no_other_process(jobs: int, units: int, name: str) -> None:
    assert usual_executor(jobs, units) is EXECUTORS[name]
