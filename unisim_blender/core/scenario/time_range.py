"""Times at which sensors capture, as a scenario's document states them: a list, or a range with a rate."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Union

from .fragments import NUMBER, Schema, members_of


@dataclass(frozen=True)
class TimeRange:
    """Times ``rate_hz`` a second from ``start_s``, the recording's first time where None, up to but without ``stop_s``; up to the
    recording's last time, which is one of them where the rate meets it, where ``stop_s`` is None."""

    rate_hz: float
    start_s: float | None = None
    stop_s: float | None = None


Times = Union[tuple[float, ...], TimeRange]  # noqa: UP007 read at run time
"""Seconds from the log's first frame."""
DEFS: dict[str, Schema] = {
    "times": {
        "description": "Seconds from the log's first frame at which sensors capture, in place of frames.",
        "if": {"type": "object"},
        "then": members_of(
            {
                "start_s": NUMBER,
                "stop_s": NUMBER,
                "rate_hz": {"type": "number", "exclusiveMinimum": 0, "maximum": 10000},
            },
            ["rate_hz"],
        ),
        "else": {"type": "array", "items": NUMBER, "minItems": 1},
    },
}
