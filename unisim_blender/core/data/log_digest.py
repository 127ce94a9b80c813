"""Digests of a log: of its files' content, to notice a change; of some captures, to know the same drive in other files."""

from __future__ import annotations

import hashlib
from pathlib import Path

from ..files import content_digests
from ..json_file import json_bytes
from ..memo import memoized
from ..world.drive_json import drive_to_json
from .log import Log, extras_of


def log_digest(log: Log) -> str:
    """Return a digest of all that a log is read from: the content of every file, by its name below the log's folder.

    It is the same wherever the log lies. The files of a log that is named by one of them are the reader's ``files``
    (`LogExtras`); without these, all captures are read. Raises `LogError`, and `OSError` where a file cannot be read.
    """
    if log.path.is_dir():
        return _digest_of_files(log.path, tuple(sorted(path for path in log.path.rglob("*") if path.is_file())))
    digest = hashlib.sha256(json_bytes(drive_to_json(log.drive)))
    if files := extras_of(log).files:
        folder = Path(*_common_parts(files))
        digest.update(_digest_of_files(folder, tuple(sorted(files))).encode())
        return digest.hexdigest()
    for name in log.drive.cameras:
        for frame in log.image_frames(name):
            digest.update(f"{name} {frame}".encode() + log.image(name, frame).tobytes())
    for name in log.drive.lidars:
        for frame in log.sweep_frames(name):
            sweep = log.sweep(name, frame)
            digest.update(f"{name} {frame}".encode() + sweep.points.tobytes() + sweep.intensity.tobytes())
    return digest.hexdigest()


@memoized
def _digest_of_files(folder: Path, files: tuple[Path, ...]) -> str:
    digest, contents = hashlib.sha256(), content_digests(files)
    for file in files:
        digest.update(f"{file.relative_to(folder).as_posix()}\0{contents[file]}\n".encode())
    return digest.hexdigest()


def _common_parts(files: tuple[Path, ...]) -> list[str]:
    """Return the parts of the path of the folder that holds all files."""
    parts = list(files[0].parent.parts)
    for file in files:
        other = file.parent.parts
        same = [a == b for a, b in zip(parts, other, strict=False)]
        parts = parts[: same.index(False) if False in same else len(same)]
    return parts
