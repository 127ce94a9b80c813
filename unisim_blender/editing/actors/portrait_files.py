"""Rendered thumbnails of a trained scene's actors: collected as they come from the worker, and kept in
the cache folder."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ...core.actor_images.best_views import png
from ...core.files import cache_folder, write_file
from ...core.model.files.scene_file import HEADER_NAME

BACKGROUND = 0.22
"""What stands behind the actor, where nothing of it is seen, as display-referred sRGB."""


class ArrayReader(Protocol):
    """What reads the arrays of an event."""

    def arrays(self, event: dict[str, Any]) -> dict[str, NDArray[Any]]:
        """The arrays by name."""
        ...


@dataclass
class Portrait:
    """An actor that the worker renders: ``request`` is the job, ``pixels`` (H, W, 3) the image once it has ``ended``
    well."""

    scene_path: Path
    uid: str
    request: Any
    ended: bool = False
    pixels: NDArray[np.uint8] | None = None
    _rgb: list[NDArray[np.float32]] = field(default_factory=list)
    _shown: list[NDArray[np.bool_]] = field(default_factory=list)

    def take(self, worker: ArrayReader) -> None:
        """Take in what has come; returns at once."""
        while not self.ended and not self.request.events.empty():
            event = self.request.events.get()
            if event["event"] == "arrays":
                arrays = worker.arrays(event)
                self._rgb.append(np.clip(arrays["rgb"], 0, 1))
                number = event["instances"].index(self.uid) + 1 if self.uid in event["instances"] else -1
                self._shown.append(arrays["instance"] == number)
            elif event["event"] not in ("warning", "progress"):
                self.ended = True
                if event["event"] == "done" and self._rgb:
                    shown = np.concatenate(self._shown)[..., None]
                    self.pixels = np.asarray(
                        255 * np.where(shown, np.concatenate(self._rgb), BACKGROUND) + 0.5, np.uint8
                    )


def portrait_path(scene_path: Path, uid: str) -> Path:
    """Return where an actor's rendered thumbnail is kept: elsewhere once the scene has changed."""
    try:
        changed = (scene_path / HEADER_NAME).stat().st_mtime_ns
    except OSError:
        changed = 0
    key = hashlib.sha256(json.dumps([str(scene_path.resolve()), changed]).encode()).hexdigest()[:32]
    return cache_folder() / "actors" / key / f"{hashlib.sha256(uid.encode()).hexdigest()[:16]}.png"


def kept_portrait(scene_path: Path, uid: str) -> Path | None:
    """Return an actor's rendered thumbnail; None where it has not been made."""
    path = portrait_path(scene_path, uid)
    return path if path.is_file() else None


def save_portrait(scene_path: Path, uid: str, pixels: NDArray[np.uint8]) -> Path:
    """Keep an actor's rendered thumbnail (H, W, 3), and return its file. Raises `OutputError`."""
    path = portrait_path(scene_path, uid)
    write_file(path, png(pixels))
    return path
