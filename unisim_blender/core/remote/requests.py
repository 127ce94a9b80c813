"""Requests to a file system of fsspec, repeated where they fail."""

from __future__ import annotations

import errno
import posixpath
import random
import re
import time
from collections.abc import Callable
from typing import Any, TypeVar

from ..errors import UnisimError, in_a_line, remedy_of, what_is_missing

_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")
"""At least two letters: "C:/street" is a path."""


def is_url(name: object) -> bool:
    """Return whether a name is a URL, as ``s3://bucket/street``; a path is none."""
    return isinstance(name, str) and _SCHEME.match(name) is not None


def beside(url: str, name: str) -> str:
    """Return what a document at a URL means by a name: a URL and a whole path mean themselves, other names are relative to the
    document, with slashes."""
    if is_url(name) or posixpath.isabs(name):
        return name
    scheme, rest = url.split("://", 1)
    host, _, path = rest.partition("/")
    joined = posixpath.normpath(posixpath.join("/", posixpath.dirname(path), name)).lstrip("/")
    return f"{scheme}://{host}/{joined}" if host else f"{scheme}:///{joined}"


def last_part(url: str) -> str:
    """Return the name of the file or folder at a URL."""
    return url.rstrip("/").rsplit("/", 1)[-1]


ATTEMPTS = 6
FIRST_WAIT_S, LONGEST_WAIT_S = 0.1, 5.0
FINAL = (PermissionError, FileNotFoundError, NotADirectoryError, IsADirectoryError)
"""Exceptions that another attempt does not resolve."""
FULL = (errno.ENOSPC, errno.EDQUOT)
ResultT = TypeVar("ResultT")


def file_system(url: str, error: type[UnisimError]) -> tuple[Any, str]:
    """Return the file system of a URL, and the path that it has there. Raises ``error``."""
    try:
        from fsspec.core import url_to_fs

        return url_to_fs(url, use_listings_cache=False)
    except ImportError as fault:
        sentence = f"{url}: cannot be opened: {what_is_missing(fault) or in_a_line(fault)}"
        raise error(sentence, remedy=remedy_of(fault)) from fault
    except (ValueError, OSError) as fault:
        raise error(f"{url}: cannot be opened: {in_a_line(fault)}") from fault


def tried(request: Callable[[], ResultT], sentence: str, error: type[UnisimError]) -> ResultT:
    """Return what a request returns. It is repeated up to `ATTEMPTS` times, after waits that double; what then still fails, or
    cannot be mended by repeating, is an ``error``: the sentence, and why."""
    wait_s = FIRST_WAIT_S
    for attempt in range(1, ATTEMPTS + 1):
        try:
            return request()
        except UnisimError:
            raise
        except Exception as fault:  # every file system has errors of its own
            final = isinstance(fault, FINAL) or getattr(fault, "errno", None) in FULL
            if final or attempt == ATTEMPTS:
                tries = "" if attempt == 1 else f" in {attempt} attempts"
                raise error(f"{sentence}{tries}: {in_a_line(fault)}") from fault
        time.sleep(wait_s * random.uniform(0.5, 1.0))
        wait_s = min(2 * wait_s, LONGEST_WAIT_S)
    raise AssertionError("unreachable")
