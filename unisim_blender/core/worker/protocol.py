"""What goes through the pipe between Blender and the worker: JSON objects, each after its length in four bytes.

A request has an ``id`` and says what to ``do``. Its events carry the id back and say what ``event`` they are: any number of
those that the job has of its own, and then one of ``done``, ``cancelled`` and ``error`` (a sentence in ``text``).
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Iterator
from typing import Any, BinaryIO

Message = dict[str, Any]
Job = Callable[[Message], Iterator[Message]]
"""What can be asked for: a request's events."""
LENGTH = struct.Struct("<I")
MAX_BYTES = 256 << 20
ENDS = ("done", "cancelled", "error")


def write_message(stream: BinaryIO, message: Message) -> None:
    """Send one message. Raises OSError where the other end is gone."""
    data = json.dumps(message, separators=(",", ":"), allow_nan=False).encode()
    stream.write(LENGTH.pack(len(data)) + data)
    stream.flush()


def read_message(stream: BinaryIO) -> Message | None:
    """The next message; None where the other end is gone or does not keep to the protocol."""
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


def number_of(message: Message, key: str) -> int:
    """The whole number under a key of a message; -1, which no request has, where there is none."""
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
