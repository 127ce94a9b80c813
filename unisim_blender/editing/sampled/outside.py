"""Frames before and after the drive: nothing was recorded there."""

from __future__ import annotations

from ...core.world.drive import Drive
from .clock import Clock


def outside_drive(frame: float, drive: Drive) -> str:
    """Return a sentence where ``frame`` lies before or after the drive, "" where it lies in it."""
    frames = Clock.of(drive).frames
    if frames[0] <= frame <= frames[-1]:
        return ""
    return f"Frame {frame:g} is outside the drive (frames {frames[0]:g} to {frames[-1]:g}): nothing was recorded there"
