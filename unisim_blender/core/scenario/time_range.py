"""The times of a scenario's captures as its document states them, and what moves outside the recording."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Union

from .json_schema import NUMBER, POSITIVE, Schema, SchemaOf, object_of

MAX_RATE_HZ = 10_000.0
OUTSIDE_RULES = ["absent", "hold", "continue"]


@dataclass(frozen=True)
class TimeRange:
    """Times ``rate_hz`` a second from ``start_s``, the recording's first time where None, up to but without ``stop_s``;
    up to the recording's last time, which is one of them where the rate meets it, where ``stop_s`` is None."""

    rate_hz: Annotated[float, SchemaOf({**POSITIVE, "maximum": MAX_RATE_HZ})]
    start_s: float | None = None
    stop_s: float | None = None


Times = Union[tuple[float, ...], TimeRange]  # noqa: UP007 read at run time
"""Seconds from the log's first frame."""


@dataclass(frozen=True)
class Outside:
    """Motion before and after the recording: of actors, which are "absent" where None, or "hold" or "continue"; and of
    the ego, which is "hold" or "continue"."""

    actors: Annotated[str, SchemaOf({"enum": OUTSIDE_RULES})] | None = None
    ego: Annotated[str, SchemaOf({"enum": OUTSIDE_RULES[1:]})] | None = None


TIMES: Schema = {
    "if": {"type": "object"},
    "then": object_of(TimeRange),
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
        "then": object_of(Outside),
        "else": {"enum": OUTSIDE_RULES},
    },
}
