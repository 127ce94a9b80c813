"""Text files as JSON documents: lines of words, or tags and what lies between. Decimal fractions are numbers."""

from __future__ import annotations

import re
from typing import Any

_TAG = re.compile(r"(<[^>]*>)")
_FRACTION = re.compile(r"[-+]?\d+\.\d*(e[-+]?\d+)?")


def lines_of_words(data: bytes) -> list[list[Any]]:
    """Return the words of a text file's lines."""
    return [[_value(word) for word in line.split(" ")] for line in data.decode().split("\n")]


def text_of_lines(lines: Any) -> bytes:
    """Return the text file of lines of words; what is no list of these comes as a text of its own."""
    return "\n".join(" ".join(map(_text, line)) if isinstance(line, list) else _text(line) for line in lines).encode(
        "utf-8", "surrogatepass"
    )


def tags_of(data: bytes) -> list[Any]:
    """Return the tags of marked-up text and the texts between them, in their order."""
    return [_value(part) for part in _TAG.split(data.decode())]


def text_of_tags(parts: Any) -> bytes:
    """Return the text that parts make up."""
    return "".join(map(_text, parts)).encode("utf-8", "surrogatepass")


def _value(word: str) -> Any:
    return float(word) if _FRACTION.fullmatch(word) else word


def _text(value: Any) -> str:
    return value if isinstance(value, str) else repr(value)
