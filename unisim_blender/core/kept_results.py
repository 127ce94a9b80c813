"""Results of reading inputs that are kept for a while: what opens many scenarios of one log reads the log once."""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, ParamSpec, TypeVar

_kept: ContextVar[dict[Hashable, Any] | None] = ContextVar("kept", default=None)
Params = ParamSpec("Params")
ResultT = TypeVar("ResultT")


@contextmanager
def results_kept() -> Iterator[None]:
    """Within it, functions that are `read_once` give for equal arguments the very object that they gave first, and files that
    change meanwhile are not read again. One within another keeps what the outer one keeps."""
    token = _kept.set({}) if _kept.get() is None else None
    try:
        yield
    finally:
        if token is not None:
            _kept.reset(token)


def read_once(function: Callable[Params, ResultT]) -> Callable[Params, ResultT]:
    """Decorate a function whose results may be kept by `results_kept`: nothing changes them. Its arguments are hashable."""

    @functools.wraps(function)
    def wrapper(*args: Params.args, **options: Params.kwargs) -> ResultT:
        results = _kept.get()
        if results is None:
            return function(*args, **options)
        key = (function, args, tuple(sorted(options.items())))
        if key not in results:
            results[key] = function(*args, **options)
        found: ResultT = results[key]
        return found

    return wrapper
