"""Executors: each runs every unit once, whatever the number of jobs, and what goes wrong reaches the caller."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from unisim_blender.core.sequence.executors import EXECUTORS, usual_executor
from unisim_blender.core.sequence.executors.executor import ProcessLost, register


@dataclass(frozen=True)
class Squares:
    """Makes a function that squares numbers, counts how often it was made, and fails at some."""

    made: Path
    fails_at: int | None = None
    ends_at: int | None = None

    def __call__(self) -> Callable[[int], tuple[int, int]]:
        with self.made.open("a", encoding="utf-8") as file:
            file.write(f"{os.getpid()}\n")
        return self.square

    def square(self, number: int) -> tuple[int, int]:
        if number == self.fails_at:
            raise ValueError(f"{number} cannot be squared")
        if number == self.ends_at:
            os.kill(os.getpid(), signal.SIGKILL)
        return number, number * number


@pytest.mark.parametrize("name", EXECUTORS)
def test_every_unit_is_run_once(name: str, tmp_path: Path) -> None:
    made = tmp_path / "made"
    results = sorted(EXECUTORS[name].run(Squares(made), range(7), jobs=2))
    assert results == [(number, number * number) for number in range(7)]
    assert 1 <= len(made.read_text(encoding="utf-8").split()) <= 2, "made once by every worker"


def test_this_process_alone_works_or_others_alone(tmp_path: Path) -> None:
    here, elsewhere = tmp_path / "here", tmp_path / "elsewhere"
    assert len(list(EXECUTORS["this-process"].run(Squares(here), range(7), jobs=2))) == 7
    assert here.read_text(encoding="utf-8").split() == [str(os.getpid())]
    assert len(list(EXECUTORS["processes"].run(Squares(elsewhere), range(7), jobs=2))) == 7
    processes = elsewhere.read_text(encoding="utf-8").split()
    assert str(os.getpid()) not in processes and len(set(processes)) == len(processes), "made once in every process"


def test_a_name_that_is_taken_is_refused() -> None:
    before = dict(EXECUTORS)
    with pytest.raises(ValueError, match="there is an executor 'processes' already"):
        register("processes", EXECUTORS["this-process"])
    assert before == EXECUTORS


@pytest.mark.parametrize("name", EXECUTORS)
def test_nothing_is_made_for_no_units(name: str, tmp_path: Path) -> None:
    assert list(EXECUTORS[name].run(Squares(tmp_path / "made"), (), jobs=2)) == []
    assert not (tmp_path / "made").exists()


@pytest.mark.parametrize("name", EXECUTORS)
def test_what_the_function_raises_reaches_the_caller(name: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="3 cannot be squared"):
        list(EXECUTORS[name].run(Squares(tmp_path / "made", fails_at=3), range(5), jobs=2))


def test_a_process_that_is_lost_is_told(tmp_path: Path) -> None:
    with pytest.raises(ProcessLost, match="ended from outside"):
        list(EXECUTORS["processes"].run(Squares(tmp_path / "made", ends_at=2), range(5), jobs=2))


@pytest.mark.parametrize(
    ("jobs", "units", "name"), [(1, 9, "this-process"), (4, 1, "this-process"), (2, 2, "processes")]
)
def test_one_unit_or_one_job_needs_no_other_process(jobs: int, units: int, name: str) -> None:
    assert usual_executor(jobs, units) is EXECUTORS[name]
