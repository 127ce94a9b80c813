"""A scene's scenario written to a file, with the meshes that it needs beside it."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

from ...core.errors import OutputError
from ...core.files import partial_file
from ...core.scenario import save_scenario
from ...core.scenario.types import Scenario
from .mesh_files import folder


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
