"""Names of inputs that are URLs, and names relative to them."""

from __future__ import annotations

import posixpath
import re

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
