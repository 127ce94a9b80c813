"""Preparation of a log's surfels: its words, stopped and resumed, by the worker of this Blender."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy
import pytest

from unisim_blender.preferences import interpreter
from unisim_blender.process import client, preparation
from unisim_blender.process.preparation import PREPARATION


@pytest.fixture
def worker(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[client.Client]:
    """A worker with an empty cache."""
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    client.close()
    yield client.client(interpreter())
    preparation.forget()
    client.close()


def wait(holds: Callable[[], bool]) -> None:
    until = time.monotonic() + 120
    while not holds():
        assert time.monotonic() < until, PREPARATION.text
        PREPARATION.gather()
        time.sleep(0.05)


def test_a_preparation_is_stopped_and_goes_on_where_it_was(scene: Any, street_log: Path, worker: client.Client) -> None:
    log = str(street_log)
    PREPARATION.follow(log, 0.3)
    assert PREPARATION.active and PREPARATION.text == "Preparing a first image: 30 %"
    PREPARATION.follow(log, None)
    assert not PREPARATION.active and not bpy.ops.unisim.stop_preparation.poll()
    PREPARATION.begin(worker)
    wait(lambda: PREPARATION.share > 0.0)
    assert PREPARATION.active and PREPARATION.text.startswith("Preparing the finished image")
    assert bpy.ops.unisim.stop_preparation() == {"FINISHED"}
    share = PREPARATION.share
    assert PREPARATION.is_stopped(log) and not PREPARATION.is_stopped("another")
    assert PREPARATION.text == f"Preparation stopped at {int(100 * share)} %"
    PREPARATION.begin(worker)
    assert not PREPARATION.active, "nothing begins while it is stopped"
    assert bpy.ops.unisim.resume_preparation() == {"FINISHED"}
    PREPARATION.begin(worker)
    PREPARATION.share = 0.0
    wait(lambda: PREPARATION.share > 0.0)
    assert PREPARATION.share >= share, "it goes on"
    PREPARATION.follow("another", 0.1)
    assert PREPARATION.share == 0.0 and PREPARATION.text == "Preparing a first image: 10 %"


def test_a_preparation_that_fails_says_why(scene: Any, tmp_path: Path, worker: client.Client) -> None:
    PREPARATION.follow(str(tmp_path / "nowhere"), None)
    PREPARATION.begin(worker)
    wait(lambda: not PREPARATION.active)
    assert "nowhere" in PREPARATION.text and PREPARATION.text == PREPARATION.problem
    PREPARATION.begin(worker)
    assert not PREPARATION.active, "not again before the user says so"
    bpy.ops.unisim.resume_preparation()
    assert PREPARATION.problem == ""
