"""Where a sequence keeps the records of its finished frames, and how many there are."""

from __future__ import annotations

from pathlib import Path

STATE_FOLDER = ".state"


def finished_frames(out: Path) -> int:
    """How many frames of the sequence in folder ``out`` are finished."""
    return sum(1 for _ in (out / STATE_FOLDER).glob("*.json"))
