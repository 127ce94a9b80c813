"""Where a sequence keeps the records of its finished frames, and how many there are."""

from __future__ import annotations

from collections.abc import Container
from pathlib import Path

STATE_FOLDER = ".state"


def finished_frames(out: Path, wanted: Container[int] | None = None) -> int:
    """Return how many frames of the sequence in folder ``out`` are finished, of those ``wanted`` or of all."""
    found = [path.stem for path in (out / STATE_FOLDER).glob("*.json")]
    return sum(1 for stem in found if wanted is None or (stem.lstrip("-").isdecimal() and int(stem) in wanted))
