"""How far a batch is: the time left, and the table of a terminal."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from unisim_blender.core.batch.records import Store
from unisim_blender.core.batch.run import Failure
from unisim_blender.core.batch.status import PACE_UNITS, batch_status, clock_text, seconds_left
from unisim_blender.core.cli.commands._batch_progress import MOST_WORKERS, BatchProgress
from unisim_blender.core.executors.executor import Doing, WorkerState


def test_the_time_left_follows_the_newest_units() -> None:
    assert seconds_left([], 3, 10.0) is None and seconds_left([5.0], 3, 10.0) is None
    assert seconds_left([], 0, 10.0) == 0.0
    assert seconds_left([0.0, 4.0, 2.0], 3, 4.0) == 6.0
    assert seconds_left([0.0, 2.0, 4.0], 3, 5.5) == 4.5
    assert seconds_left([0.0, 2.0, 4.0], 3, 60.0) == 4.0, (
        "a unit that takes long is not foreseen to end before it is begun"
    )
    slow_first = [0.0, *(1000.0 + i for i in range(PACE_UNITS))]
    assert seconds_left(slow_first, 10, slow_first[-1]) == pytest.approx(10.0)


def test_times_are_read_as_clocks() -> None:
    assert [clock_text(one) for one in (None, 0.0, 61.4, 3723.0)] == ["–", "0:00", "1:01", "1:02:03"]


def test_the_table_counts_units_and_names_failures() -> None:
    rich = pytest.importorskip("rich.console")
    progress = BatchProgress(6)
    progress.on_kept(1)
    units: Any = [SimpleNamespace(captures=3), SimpleNamespace(captures=5)]
    progress.on_unit(units[0], None)
    progress.on_unit(units[1], Failure("000004", "late-0002", "[red]the disk is full", "unisim render x"))
    assert (progress.left, progress.captures) == (3, 3)
    file = io.StringIO()
    rich.Console(file=file, width=100).print(progress.table())
    lines = file.getvalue().splitlines()
    cells = [[cell.strip() for cell in line.strip("┃│ ").replace("┃", "│").split("│")] for line in (lines[1], lines[3])]
    found = dict(zip(*cells, strict=True))
    assert [found[name] for name in ("units", "kept", "finished", "failed", "left")] == ["6", "1", "1", "1", "3"]
    assert found["time left"] != "–"
    assert "late-0002, unit 000004: [red]the disk is full" in file.getvalue(), "no markup is taken from a reason"


def test_the_table_says_what_each_worker_does() -> None:
    rich = pytest.importorskip("rich.console")
    progress = BatchProgress(6)
    progress.on_kept(2)
    unit: Any = SimpleNamespace(name="000003", variant="late[1]-0002", captures=2)
    told: list[tuple[int, Doing, bool]] = [
        (0, "starting", False), (0, "unit", True), (0, "lost", False), (0, "starting", False), (1, "unit", True),
        (2, "unit", False), (3, "idle", False), *((other, "starting", False) for other in range(4, 20)),
    ]  # fmt: skip
    for number, doing, loads in told:
        progress.on_worker(WorkerState(number, doing, 3 if doing == "unit" else None, loads), unit)
    file = io.StringIO()
    rich.Console(file=file, width=120).print(progress.table())
    assert [line[0] for line in file.getvalue().splitlines() if "┏" in line] == ["┏", "┏"], "each table has its lines"
    rows = [[cell.strip() for cell in line.strip("│ ").split("│")] for line in file.getvalue().splitlines()]
    found = {row[0]: row[1:] for row in rows if len(row) == 5 and row[0].isdigit()}
    assert found["0"] == ["starting", "0:00", "1", "1"], "what replaces a lost worker has its row"
    assert found["1"] == ["late[1]-0002, unit 000003, after its scene is loaded", "0:00", "1", "0"]
    assert found["2"][0] == "late[1]-0002, unit 000003" and found["3"][0] == "idle"
    assert len(found) == MOST_WORKERS and "and 4 more" in file.getvalue()


@pytest.mark.parametrize("place", ["{folder}", "memory://{name}"])
def test_a_status_has_the_time_left(tmp_path: Path, place: str) -> None:
    store = Store(place.format(folder=tmp_path, name=tmp_path.name))
    plan = {"units": [{}] * 10, "captures": {"asked": 1}, "variants": {}}
    store.write("batch.json", json.dumps(plan).encode())
    status = batch_status(store)
    assert (status["finished"], status["seconds_left"], status["seconds_since_last"]) == (0, None, None)
    for number in range(4):
        store.write(f"records/{number:06d}.json", b"{}")
        if store.folder is not None:
            os.utime(tmp_path / "records" / f"{number:06d}.json", (1000.0, 1000.0 + 10 * number))
    store.write("failures/000004.json", b'{"unit": "000004"}')
    status = batch_status(store)
    assert status["finished"] == 4 and status["seconds_since_last"] >= 0
    if store.folder is not None:
        assert status["seconds_left"] == 10.0 * 5 - 10.0
    else:
        assert 0.0 <= status["seconds_left"] < 60.0
