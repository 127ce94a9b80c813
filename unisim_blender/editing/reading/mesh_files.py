"""Files of mesh models that a scenario names: in this process's own folder, each named after what it holds."""

from __future__ import annotations

import hashlib
import tempfile
from dataclasses import fields
from functools import lru_cache
from pathlib import Path

import numpy as np

from ...core.meshes.model import SUFFIX, MeshModel, write_model


def file_of(model: MeshModel) -> Path:
    """The model in a file named after what it holds, in this process's own folder."""
    digest = hashlib.sha256()
    for field in fields(MeshModel):
        value = getattr(model, field.name)
        for array in value if isinstance(value, tuple) else (value,):
            digest.update(f"{field.name} {array.dtype.str} {array.shape}".encode())
            digest.update(np.ascontiguousarray(array).data)
    path = folder() / f"{digest.hexdigest()[:32]}{SUFFIX}"
    if not path.is_file():
        write_model(model, path)
    return path


def folder() -> Path:
    """Where models of this process lie until it ends."""
    return Path(_folder().name).resolve()


@lru_cache(maxsize=1)
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="unisim-meshes-")
