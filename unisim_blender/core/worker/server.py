"""The worker's loop: runs one job at a time and checks between its events whether it was cancelled."""

from __future__ import annotations

import os
import queue
import sys
import threading
import traceback
from pathlib import Path
from typing import BinaryIO

from ..errors import UnisimError, in_a_line, short, what_is_missing
from .protocol import WorkerJob, WorkerMessage, number_of, read_message, write_message


class Server:
    """Runs requests in the order in which they arrive. ``jobs`` are the jobs by their names in requests."""

    def __init__(self, requests: BinaryIO, events: BinaryIO, jobs: dict[str, WorkerJob]) -> None:
        self.requests, self.events, self.jobs = requests, events, jobs
        self.waiting: queue.SimpleQueue[WorkerMessage | None] = queue.SimpleQueue()
        self.cancelled: set[int] = set()

    def run(self) -> None:
        """Run requests until the other end is closed."""
        threading.Thread(target=self._listen, daemon=True).start()
        while (request := self.waiting.get()) is not None:
            self._do(request)

    def _listen(self) -> None:
        """Read requests in a thread of its own, so that a job at work hears of its cancellation, and of
        the end of Blender."""
        while (request := read_message(self.requests)) is not None:
            if request.get("do") == "cancel":
                self.cancelled.add(number_of(request, "job"))
            else:
                self.waiting.put(request)
        # nobody is left to render for: the job at hand need not end first
        os._exit(0)

    def _do(self, request: WorkerMessage) -> None:
        number, name = number_of(request, "id"), str(request.get("do"))
        try:
            if name not in self.jobs:
                raise UnisimError(f"the worker knows no {short(name)}: it is of another version than the extension")
            if number not in self.cancelled:
                for event in self.jobs[name](request):
                    self._tell(number, event)
                    if number in self.cancelled:
                        break
            self._tell(number, {"event": "cancelled" if number in self.cancelled else "done"})
        except UnisimError as fault:
            self._tell(number, {"event": "error", "text": str(fault)})
        except MemoryError:
            self._tell(number, {"event": "error", "text": "the worker has no memory left for this"})
        except Exception as fault:
            missing = what_is_missing(fault) if isinstance(fault, ImportError) else ""
            traceback.print_exc(file=sys.stderr)
            self._tell(number, {"event": "error", "text": missing or f"{type(fault).__name__}: {in_a_line(fault)}"})
        finally:
            self.cancelled.discard(number)

    def _tell(self, number: int, event: WorkerMessage) -> None:
        write_message(self.events, {"id": number, **event})


def main(folder: Path) -> None:
    """Serve the process that started this one; arrays for it are written into ``folder``."""
    events = os.fdopen(os.dup(1), "wb")
    # whatever prints must not break the protocol
    os.dup2(2, 1)
    from .jobs import all_jobs

    Server(sys.stdin.buffer, events, all_jobs(folder)).run()
