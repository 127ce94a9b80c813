"""The worker behind its pipe: started when asked, killed, restarted, closed."""

from __future__ import annotations

import os
import queue
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from unisim_blender import interpreters
from unisim_blender.client import Client, Request

LIMIT_S = 120


@pytest.fixture
def worker() -> Iterator[Client]:
    client = Client(sys.executable)
    yield client
    client.close()
    assert not client.folder.exists()


def last(request: Request) -> dict[str, object]:
    """The event that ends a request."""
    until = time.monotonic() + LIMIT_S
    while time.monotonic() < until:
        try:
            event = request.events.get(timeout=1)
        except queue.Empty:
            continue
        if event["event"] in ("done", "error", "cancelled"):
            return event
    raise AssertionError("no end")


def test_it_says_what_it_is(worker: Client) -> None:
    request = worker.ask("about")
    event = request.events.get(timeout=LIMIT_S)
    assert event["event"] == "about" and "cpu" in event["devices"]
    assert last(request)["event"] == "done"


def test_asking_returns_at_once(worker: Client) -> None:
    started = time.monotonic()
    request = worker.ask("about")
    assert time.monotonic() - started < 0.1
    last(request)


def test_a_killed_worker_is_a_sentence_and_comes_back(worker: Client) -> None:
    last(worker.ask("about"))
    assert worker.process is not None
    before = worker.process.pid
    os.kill(before, signal.SIGSTOP)
    request = worker.ask("about")
    os.kill(before, signal.SIGKILL)
    event = last(request)
    assert event["event"] == "error" and "killed" in str(event["text"])
    assert last(worker.ask("about"))["event"] == "done"
    assert worker.process.pid != before


def test_an_unknown_job_is_a_sentence(worker: Client) -> None:
    assert "another version" in str(last(worker.ask("sing"))["text"])


def test_a_broken_scenario_is_a_sentence(worker: Client) -> None:
    event = last(worker.ask("camera", scenario={"format": "x"}, path="/tmp/x.json", camera="c", time_s=0.0, model={}))
    assert event["event"] == "error" and "/tmp/x.json" in str(event["text"])


NOISY = """#!/bin/sh
shift
exec {python} -c '
import os, runpy, sys
class Noise:
    def find_spec(name, path=None, target=None):
        if name == "torch":
            os.write(1, b"1 ")
sys.meta_path.insert(0, Noise)
sys.argv.pop(0)
runpy.run_path(sys.argv[0], run_name="__main__")
' "$@"
"""
"""An interpreter whose torch prints while it is imported."""


def test_what_an_import_prints_is_no_part_of_the_answer(tmp_path: Path) -> None:
    path = tmp_path / "python"
    path.write_text(NOISY.format(python=sys.executable))
    path.chmod(0o755)
    found = interpreters.probe(str(path))
    assert not found.problem and "torch" in found.about


def test_an_interpreter_that_cannot_render_says_why(tmp_path: object) -> None:
    found = interpreters.probe("/bin/false")
    assert found.problem
    assert "/bin/false" in interpreters.how_to_mend([found])
