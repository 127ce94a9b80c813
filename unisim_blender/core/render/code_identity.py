"""Identity of the code that renders: part of the key of everything that is cached."""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from ..files import sha256_of_file

CORE_FOLDER = Path(__file__).parents[1]
CODE_SUFFIXES = (".py", ".npz", ".so", ".dll", ".dylib")
NOT_RENDERING = ("actor_images", "cli", "convert.py", "evaluation", "presets.py", "rigs", "training")
"""Folders and modules of core that change no rendered frame."""


@cache
def code_identity() -> dict[str, str]:
    """Return the package's version, and a digest of core's sources, weights and native libraries without `NOT_RENDERING`."""
    try:
        release = version("unisim_blender")
    except PackageNotFoundError:  # run from its sources, or as an extension of Blender
        release = "source"
    return {"version": release, "sha256": code_digest(NOT_RENDERING)}


@cache
def code_digest(left_out: tuple[str, ...] = (), root: Path = CORE_FOLDER) -> str:
    """Return a digest of the sources, weights and native libraries below ``root``, without folders and modules of these
    names."""
    digest = hashlib.sha256()
    for path in sorted(p for p in root.rglob("*") if p.suffix in CODE_SUFFIXES and p.is_file()):
        if path.relative_to(root).parts[0] not in left_out:
            digest.update(f"{path.relative_to(root).as_posix()}\0{sha256_of_file(path)}\n".encode())
    return digest.hexdigest()
