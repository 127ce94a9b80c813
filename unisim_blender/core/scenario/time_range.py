"""The times of a scenario's captures as its document states them, and what moves outside the recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Union

from .json_schema import NUMBER, Schema, members_of

MAX_RATE_HZ = 10_000.0


@dataclass(frozen=True)
class TimeRange:
    """Times ``rate_hz`` a second from ``start_s``, the recording's first time where None, up to but without ``stop_s``;
    up to the recording's last time, which is one of them where the rate meets it, where ``stop_s`` is None."""

    rate_hz: float
    start_s: float | None = None
    stop_s: float | None = None


Times = Union[tuple[float, ...], TimeRange]  # noqa: UP007 read at run time
"""Seconds from the log's first frame."""


@dataclass(frozen=True)
class Outside:
    """Motion before and after the recording: of actors, which are "absent" where None, or "hold" or "continue"; and of
    the ego, which is "hold" or "continue"."""

    actors: str | None = None
    ego: str | None = None


OUTSIDE_RULES = ["absent", "hold", "continue"]
TIMES: Schema = {
    "if": {"type": "object"},
    "then": members_of(
        {
            "start_s": NUMBER,
            "stop_s": NUMBER,
            "rate_hz": {"type": "number", "exclusiveMinimum": 0, "maximum": MAX_RATE_HZ},
        },
        ["rate_hz"],
    ),
}
DEFS: dict[str, Schema] = {
    "times": {
        **TIMES,
        "description": "Seconds from the log's first frame at which sensors capture, in place of frames.",
        "else": {"type": "array", "items": NUMBER, "minItems": 1},
    },
    "own_times": {
        **TIMES,
        "description": "Seconds from the log's first frame at which this sensor captures; an empty list for never.",
        "else": {"type": "array", "items": NUMBER},
    },
    "outside_recording": {
        "description": "What moves before and after the recording: actors, and the ego vehicle.",
        "if": {"type": "object"},
        "then": members_of({"actors": {"enum": OUTSIDE_RULES}, "ego": {"enum": OUTSIDE_RULES[1:]}}, ()),
        "else": {"enum": OUTSIDE_RULES},
    },
}
