"""Blender's side of the worker: started when it is needed, listened to by threads of its own, restarted after a crash.

Nothing here waits for the worker, and nothing here touches Blender's data: what comes back is put into queues that the
engine, the viewport and the operators look into.
"""

from __future__ import annotations

import itertools
import queue
import shutil
import subprocess
import tempfile
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from ..core.worker.protocol import ENDS, WorkerMessage, read_message, write_message
from . import interpreters

Prepare = Callable[[WorkerMessage, dict[str, NDArray[Any]]], object]
"""Makes something of an ``arrays`` event and its arrays, in a thread."""


@dataclass
class Request:
    """A job that was asked for; ``events`` come in as the worker sends them, the last one of `ENDS`.

    Where there is ``prepare``, an ``arrays`` event has what that returned as its "prepared", and its file is gone.
    """

    number: int
    message: WorkerMessage
    prepare: Prepare | None = None
    events: queue.SimpleQueue[WorkerMessage] = field(default_factory=queue.SimpleQueue)
    ended: bool = False


class Client:
    """One worker process. Every method but `close` returns at once. ``chosen`` is the interpreter that
    the user prefers."""

    def __init__(self, chosen: str = "") -> None:
        self.chosen = chosen
        self.folder = Path(tempfile.mkdtemp(prefix="unisim-"))  # readable by its owner alone
        self.process: subprocess.Popen[bytes] | None = None
        self.python: interpreters.Probe | None = None
        self.problem = ""
        self._requests: dict[int, Request] = {}
        self._last_words: deque[str] = deque(maxlen=20)
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._outgoing: queue.SimpleQueue[WorkerMessage | None] = queue.SimpleQueue()
        self._running = False
        self._closed = False

    def ask(self, do: str, prepare: Prepare | None = None, warnings: Sequence[str] = (), **values: Any) -> Request:
        """Ask for a job; a worker that is not there is started for it. ``prepare`` gets its arrays; ``warnings`` are
        its first events: what comes out otherwise than the edits ask for."""
        with self._lock:
            number = next(self._numbers)
            request = self._requests[number] = Request(number, {**values, "do": do, "id": number}, prepare)
            for sentence in warnings:
                request.events.put({"event": "warning", "text": sentence})
            if not self._running:
                self._running, self._outgoing = True, queue.SimpleQueue()
                threading.Thread(target=self._run, args=(self._outgoing,), daemon=True).start()
            self._outgoing.put(request.message)
        return request

    def cancel(self, request: Request) -> None:
        """Say that a job is not wanted any more."""
        with self._lock:
            if not request.ended and self._running:
                self._outgoing.put({"do": "cancel", "job": request.number})

    def arrays(self, event: WorkerMessage) -> dict[str, NDArray[Any]]:
        """The arrays of an ``arrays`` event, read from the file they were left in, which then goes."""
        path = self.folder / Path(event["file"]).name
        data = path.read_bytes()
        path.unlink(missing_ok=True)
        arrays = {}
        for name, place in event["arrays"].items():
            count = int(np.prod(place["shape"]))
            arrays[name] = np.frombuffer(data, place["dtype"], count, place["offset"]).reshape(place["shape"])
        return arrays

    def close(self) -> None:
        """End the worker and throw its folder away."""
        self._closed = True
        process = self.process
        if process is not None and process.poll() is None:
            process.kill()
            process.wait()
        shutil.rmtree(self.folder, ignore_errors=True)

    # ---- the thread of one worker's life

    def _run(self, outgoing: queue.SimpleQueue[WorkerMessage | None]) -> None:
        reason, remedy = "the renderer could not be started", ""
        try:
            if self.python is None:
                self.python, failed = interpreters.find(self.chosen)
                if self.python is None:
                    reason, remedy = interpreters.how_to_mend(failed), "interpreter"
                    return
            self._last_words.clear()
            self.process = process = subprocess.Popen(
                interpreters.command(self.python.path, "serve", str(self.folder)),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                cwd=self.folder,
            )
            if self._closed:
                process.kill()
            helpers = [
                threading.Thread(target=self._write, args=(process, outgoing), daemon=True),
                threading.Thread(target=self._overhear, args=(process,), daemon=True),
            ]
            for thread in helpers:
                thread.start()
            self._read(process)
            process.wait()
            outgoing.put(None)
            for thread in helpers:
                thread.join()
            why = _reason(process.returncode, list(self._last_words))
            reason = f"the renderer stopped ({why}); it starts again when it is needed"
        except OSError as fault:
            self.python = None
            reason = f"the renderer could not be started: {fault}"
        finally:
            with self._lock:
                self._running, self.problem = False, "" if self._closed else reason
                left = list(self._requests.values())
            for request in left:
                self._end(request, {"event": "error", "text": reason, "remedy": remedy})

    def _write(self, process: subprocess.Popen[bytes], outgoing: queue.SimpleQueue[WorkerMessage | None]) -> None:
        assert process.stdin is not None
        while (message := outgoing.get()) is not None:
            try:
                write_message(cast(BinaryIO, process.stdin), message)
            except OSError:
                return

    def _read(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stdout is not None
        while (event := read_message(cast(BinaryIO, process.stdout))) is not None:
            request = self._requests.get(int(event.get("id", -1)))
            if request is None:
                continue
            if event["event"] == "arrays" and request.prepare is not None:
                try:
                    event["prepared"] = request.prepare(event, self.arrays(event))
                except Exception as fault:  # the thread goes on for other requests
                    event = {"event": "error", "text": f"what was rendered cannot be read: {fault}"}
            if event["event"] in ENDS:
                self._end(request, event)
            else:
                request.events.put(event)

    def _end(self, request: Request, event: WorkerMessage) -> None:
        request.ended = True
        self._requests.pop(request.number, None)
        request.events.put(event)

    def _overhear(self, process: subprocess.Popen[bytes]) -> None:
        """Keep what the worker prints: where it dies, that says why."""
        assert process.stderr is not None
        for line in process.stderr:
            self._last_words.append(line.decode(errors="replace").rstrip())


def _reason(code: int, last_words: list[str]) -> str:
    if code == -9:
        return "it was killed, perhaps for want of memory"
    if code < 0:
        return f"signal {-code}"
    words = next((line for line in reversed(last_words) if line and not line.startswith(" ")), "")
    return words or f"exit status {code}"


def progress_line(event: WorkerMessage) -> str:
    """A ``progress`` event in words."""
    return f"{event['text']}: {event['share']:.0%}"


_client: Client | None = None


def client(chosen: str = "") -> Client:
    """The worker that this Blender talks to; another choice of interpreter ends the one before."""
    global _client
    if _client is None or _client.chosen != chosen:
        close()
        _client = Client(chosen)
    return _client


def close() -> None:
    """End the worker, if there is one."""
    global _client
    if _client is not None:
        _client.close()
        _client = None
