"""What logs that consist of files have in common."""

from __future__ import annotations

from collections.abc import Iterable


def ranges(frames: Iterable[int]) -> str:
    """Return frame numbers in words: "3, 7-9"."""
    parts: list[list[int]] = []
    for frame in sorted(frames):
        if parts and frame == parts[-1][1] + 1:
            parts[-1][1] = frame
        else:
            parts.append([frame, frame])
    return ", ".join(str(first) if first == last else f"{first}-{last}" for first, last in parts)
