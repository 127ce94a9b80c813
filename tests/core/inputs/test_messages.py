"""Messages with faults in the worker's pipe: each that can be read ends in one event, and the worker goes on."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import pytest
from hypothesis import example, given

from inputs.faults import Drop, Put
from inputs.promise import Property, Reader
from inputs.strategies import Input, inputs_of
from inputs.views import In, message_stream
from unisim_blender.core.worker.protocol import ENDS, number_of, read_message
from unisim_blender.core.worker.server import Server, all_jobs

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")
FILE = "requests"


def message_reader(folder: Path) -> Reader:
    """Requests as Blender sends them; the log that they name is not there."""
    scenario = {"format": "unisim-scenario", "version": 1, "name": "now", "log": "nowhere", "edits": []}
    model = {"width": 16, "height": 8, "fx": 10, "fy": 10, "cx": 8, "cy": 4}
    request = {
        "scenario": scenario,
        "path": str(folder / "now.json"),
        "time_s": 0.1,
        "quality": "fast",
        "device": "cpu",
    }
    messages = [
        {"id": 1, "do": "about"}, {"do": "cancel", "job": 7},
        {"id": 2, "do": "camera", "camera": "front", "model": model, "passes": ["rgb"], "rows": [0, 8], "coarse": [4],
        **request},
        {"id": 3, "do": "lidar", "lidar": "top", **request},
    ]  # fmt: skip
    whole = {FILE: message_stream(messages)}
    jobs = all_jobs(folder)

    def read() -> object:
        stream, found = io.BytesIO((folder / FILE).read_bytes()), 0
        while (message := read_message(stream)) is not None:
            found += 1
            number_of(message, "job")
            events = io.BytesIO()
            Server(io.BytesIO(), events, jobs)._do(message)
            events.seek(0)
            told = []
            while (event := read_message(events)) is not None:
                told.append(event)
            assert [event["event"] in ENDS for event in told] == [False] * (len(told) - 1) + [True]
            assert all(type(event["id"]) is int and "\n" not in event.get("text", "") for event in told)
        return found

    return Reader(folder, whole, read, inputs_of(whole, {FILE: ["messages"]}), (), refuses=False)


MESSAGES = Property(message_reader)


@given(MESSAGES.inputs)
@example([In(FILE, "messages", (Drop((1, "job")),))])
@example([In(FILE, "messages", (Put((0, "id"), None),))])
@example([In(FILE, "messages", (Put((0, "id"), [1]),))])
@example([In(FILE, "messages", (Put((0, "do"), "y" * 5000),))])
def test_messages_of_the_worker(changes: Input) -> None:
    MESSAGES.check(changes)


@pytest.mark.parametrize("data", (b"[" * 100_000, b"[1]", b"\xff", b"{", b""))
def test_a_message_that_is_none_ends_the_worker_quietly(data: bytes) -> None:
    head = len(data).to_bytes(4, "little")
    assert read_message(io.BytesIO(head + data)) is None
    assert read_message(io.BytesIO((len(data) + 1).to_bytes(4, "little") + data)) is None
