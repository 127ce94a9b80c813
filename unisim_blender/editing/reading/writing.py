"""A scene's scenario written to a file, with the meshes that it needs beside it.

Until then models lie in this process's own folder, each in a file named after what it holds.
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
from dataclasses import fields, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from ...core.errors import OutputError
from ...core.files import partial_file
from ...core.meshes.model import SUFFIX, MeshModel, write_model
from ...core.scenario import save_scenario
from ...core.scenario.types import Scenario


def write_scenario(scenario: Scenario, path: Path) -> None:
    """Write a scenario; models that lie in this process's own folder go into one beside it. Raises `UnisimError`."""
    edits = []
    for edit in scenario.edits:
        for member in edit.meshes:
            file = scenario.resolve(getattr(edit, member))
            if file.parent == folder():
                kept = path.parent / f"{path.stem}_meshes" / file.name
                _copy(file, kept)
                edit = replace(edit, **{member: kept.relative_to(path.parent).as_posix()})
        edits.append(edit)
    save_scenario(replace(scenario, edits=tuple(edits)), path)


def _copy(source: Path, target: Path) -> None:
    if target.is_file():  # named after what it holds
        return
    try:
        with partial_file(target) as temporary:
            shutil.copyfile(source, temporary)
    except OSError as fault:
        raise OutputError(f"{target}: cannot be written: {fault.strerror}") from fault


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
