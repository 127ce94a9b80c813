"""Cache of surfels on disk, built once for each log: a folder that may be deleted at any time."""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

from ....data.log import Log, log_digest
from ....errors import OutputError, SceneError
from ....files import CACHE_VARIABLE, cache_folder
from ...code_identity import code_digest
from .build import Step, build_surfels
from .model import FORMAT_VERSION, SurfelScene, SurfelSettings, load_surfels, save_surfels

NOT_SURFELS = ("cli", "convert.py", "evaluation", "rigs", "sequence", "training", "worker")
"""Packages that take no part in building surfels of a log."""
MAX_CACHED_LOGS = 32
"""Largest number of logs whose surfels stay in the cache folder."""


def surfels_of(log: Log, settings: SurfelSettings, frames: Sequence[int] | None = None) -> Iterator[Step | SurfelScene]:
    """Yield the steps of the build, none where the surfels are cached, and last the scene, mapped from disk.

    Raises `LogError`, and `OutputError` where the folder cannot be written.
    """
    folder = cache_folder() / "surfels" / build_key(log, settings, frames)
    if (cached := _cached(folder)) is not None:
        yield cached
        return
    for step in build_surfels(log, settings, frames):
        if not isinstance(step, SurfelScene):
            yield step
            continue
        yield Step("Writing surfels", 0.99)
        try:
            folder.parent.mkdir(parents=True, exist_ok=True)
            temporary = Path(tempfile.mkdtemp(prefix=".making-", dir=folder.parent))
            try:
                save_surfels(step, temporary)
                # of two that made the same, the first stays
                if _cached(folder) is None:
                    shutil.rmtree(folder, ignore_errors=True)
                    temporary.rename(folder)
                _forget_oldest(folder)
            finally:
                shutil.rmtree(temporary, ignore_errors=True)
        except OSError as fault:
            raise OutputError(
                f"{folder}: surfels cannot be kept there: {fault.strerror or fault}; {CACHE_VARIABLE} names another folder"
            ) from fault
        cached = _cached(folder)
        yield step if cached is None else cached


def _forget_oldest(new: Path) -> None:
    """Remove the oldest surfels beyond `MAX_CACHED_LOGS`."""
    others = [path for path in new.parent.iterdir() if path.is_dir() and path != new and not path.name.startswith(".")]
    for old in sorted(others, key=lambda path: path.stat().st_mtime)[: max(0, len(others) + 1 - MAX_CACHED_LOGS)]:
        shutil.rmtree(old, ignore_errors=True)


def _cached(folder: Path) -> SurfelScene | None:
    try:
        return load_surfels(folder)
    except SceneError:
        return None


def build_key(log: Log, settings: SurfelSettings, frames: Sequence[int] | None) -> str:
    """Return a digest of all inputs of surfels."""
    document = {
        "version": FORMAT_VERSION,
        "code": code_digest(NOT_SURFELS),
        "log": log_digest(log),
        "settings": asdict(settings),
        "frames": None if frames is None else sorted(frames),
    }
    return hashlib.sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()[:32]
