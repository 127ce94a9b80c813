"""A street's log, of the size that is measured at."""

from __future__ import annotations

import os
import time
from pathlib import Path

from .settings import CAMERA, Findings, Settings


def street_of(settings: Settings) -> Path:
    """Return the folder of the street's log."""
    return Path(settings.work) / "street"


def make_street(settings: Settings, found: Findings) -> None:
    """Write the log of street 0, its frames in parallel."""
    from unisim_street.street import build_street
    from unisim_street.write import write_log

    begun = time.monotonic()
    street = build_street(0, settings.frames, *settings.size, (CAMERA,))
    write_log(street, street_of(settings), min(os.cpu_count() or 1, settings.frames), progress=False)
    found.note(
        frames=settings.frames,
        size=settings.size,
        actors=len(street.drive.actors),
        seconds=round(time.monotonic() - begun, 1),
    )
