"""Copies of images that lie inside a log's larger files: Blender and others show files."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

from ...files import cache_folder, file_stamp, write_file

PNG = b"\x89PNG"


def cached_image(layout: str, store: Path, camera: str, name: str, content: Callable[[], bytes]) -> Path:
    """Return a copy of an image among the user's cached files, written when it is first asked for.

    ``content`` gives the bytes, JPEG or PNG, of the image ``name`` of a camera in the file ``store``; the copy is made
    again where that file changes. Raises what ``content`` does.
    """
    about = f"{store.resolve()} {file_stamp(store)} {camera}"
    folder = cache_folder() / layout / hashlib.sha256(about.encode()).hexdigest()[:24]
    for suffix in (".jpg", ".png"):
        if (folder / f"{name}{suffix}").is_file():
            return folder / f"{name}{suffix}"
    data = content()
    path = folder / f"{name}{'.png' if data.startswith(PNG) else '.jpg'}"
    write_file(path, data)
    return path
