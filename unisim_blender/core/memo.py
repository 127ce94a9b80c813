"""Memoized results of reading inputs, within a scope: opening many scenarios of one log reads the log once."""

from __future__ import annotations

import functools
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, ParamSpec, TypeVar

_results: ContextVar[dict[Hashable, Any] | None] = ContextVar("results", default=None)
Params = ParamSpec("Params")
ResultT = TypeVar("ResultT")


@contextmanager
def memo_scope() -> Iterator[None]:
    """Within it, functions that are `memoized` return for equal arguments the object that they returned first, and files that
    change meanwhile are not read again. One within another shares the results of the outer one."""
    token = _results.set({}) if _results.get() is None else None
    try:
        yield
    finally:
        if token is not None:
            _results.reset(token)


def memoized(function: Callable[Params, ResultT]) -> Callable[Params, ResultT]:
    """Decorate a function whose results are reused within a `memo_scope`: nothing changes them. Its arguments are hashable."""

    @functools.wraps(function)
    def wrapper(*args: Params.args, **options: Params.kwargs) -> ResultT:
        results = _results.get()
        if results is None:
            return function(*args, **options)
        key = (function, args, tuple(sorted(options.items())))
        if key not in results:
            results[key] = function(*args, **options)
        result: ResultT = results[key]
        return result

    return wrapper
