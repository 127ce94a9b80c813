"""Messages between Blender and the worker: JSON objects in a pipe, each preceded by its length in four bytes.

A request has an ``id`` and the name of a job, ``do``. Each of its events has that id and a kind, ``event``: any number
of the job's own kinds, then one of ``done``, ``cancelled`` and ``error`` (with a sentence in ``text``).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO

WorkerMessage = dict[str, Any]
WorkerJob = Callable[[WorkerMessage], Iterator[WorkerMessage]]
"""A job: yields the events of a request."""
LENGTH = struct.Struct("<I")
MAX_BYTES = 256 << 20
ENDS = ("done", "cancelled", "error")


def write_message(stream: BinaryIO, message: WorkerMessage) -> None:
    """Send one message. Raises OSError if the other end is closed."""
    data = json.dumps(message, separators=(",", ":"), allow_nan=False).encode()
    stream.write(LENGTH.pack(len(data)) + data)
    stream.flush()


def read_message(stream: BinaryIO) -> WorkerMessage | None:
    """Read the next message; None if the other end is closed or breaks the protocol."""
    head = _read(stream, LENGTH.size)
    if head is None:
        return None
    (length,) = LENGTH.unpack(head)
    data = _read(stream, length) if length <= MAX_BYTES else None
    if data is None:
        return None
    try:
        message = json.loads(data)
    except (ValueError, RecursionError):
        return None
    return message if isinstance(message, dict) else None


def number_of(message: WorkerMessage, key: str) -> int:
    """Return the integer under a key of a message; -1, which no request uses, if there is none."""
    value = message.get(key)
    return value if isinstance(value, int) and not isinstance(value, bool) else -1


def _read(stream: BinaryIO, count: int) -> bytes | None:
    parts = []
    while count:
        part = stream.read(count)
        if not part:
            return None
        parts.append(part)
        count -= len(part)
    return b"".join(parts)
