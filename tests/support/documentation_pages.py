"""The documentation's pages as the tests read them: fenced blocks, headings, links, prose."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = (
    *(ROOT / name for name in ("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "sample/README.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
)
NAMES = tuple(page.relative_to(ROOT).as_posix() for page in PAGES)
MARK = re.compile(r"<!-- parsed only: (.+) -->")


@dataclass(frozen=True)
class Block:
    """A fenced block. ``reason`` is why it is only parsed; "" where it is run."""

    language: str
    text: str
    line: int
    reason: str = ""


def blocks(text: str) -> list[Block]:
    """Return a page's fenced blocks, in order."""
    lines, found, at = text.splitlines(), [], 0
    while at < len(lines):
        if lines[at].startswith("```"):
            end = next(i for i in range(at + 1, len(lines)) if lines[i].startswith("```"))
            mark = MARK.fullmatch(lines[at - 1].strip()) if at else None
            body = "\n".join(lines[at + 1 : end]) + "\n"
            found.append(Block(lines[at][3:].strip(), body, at + 2, mark[1] if mark else ""))
            at = end
        at += 1
    return found


def prose(text: str) -> Iterator[tuple[int, str]]:
    """Yield the numbered lines that are neither code nor table, heading, image or comment."""
    code = False
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("```"):
            code = not code
        elif not code and not line.lstrip().startswith(("|", "#", "![", "<!--")):
            yield number, line


def paragraphs(text: str) -> Iterator[tuple[int, int]]:
    """Yield the first line and the number of lines of each paragraph and list item."""
    first, count = 0, 0
    for number, line in [*prose(text), (0, "")]:
        item = re.match(r"\s*([-*]|\d+\.) ", line)
        if count and (item or not line.strip() or number != first + count):
            yield first, count
            count = 0
        if line.strip():
            first, count = (first, count + 1) if count else (number, 1)


def anchors(text: str) -> set[str]:
    """Return the anchors of a page's headings, as code hosts and the website make them."""
    plain = "\n".join(line for line in _outside_code(text) if line.startswith("#"))
    headings = re.findall(r"^#{1,6} (.*)$", plain, re.M)
    return {
        re.sub(r"\s", "-", re.sub(r"[^\w\s-]", "", heading.replace("`", "").lower()).strip()) for heading in headings
    }


def links(text: str) -> list[str]:
    """Return the targets of a page's links and images."""
    return re.findall(r"\]\(([^)\s]+)\)", re.sub(r"`[^`]*`", "", "\n".join(_outside_code(text))))


def _outside_code(text: str) -> Iterator[str]:
    code = False
    for line in text.splitlines():
        if line.startswith("```"):
            code = not code
        elif not code:
            yield line
