"""Scenarios moved to another file: the paths in them go on naming what they named."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..remote.requests import beside, is_url
from .types import RECORDED, Scenario, StreetLog


def rebased(scenario: Scenario, path: Path, absolute: bool = False) -> Scenario:
    """Return a scenario whose file is ``path``: what it names lies where it lay. ``absolute`` writes whole paths, for
    files that lie in no file system. URLs stay as they are."""

    def moved(name: str) -> str:
        if is_url(name):
            return name
        there = scenario.resolve(name)
        return there.as_posix() if absolute else Path(os.path.relpath(there, path.parent.resolve())).as_posix()

    return replace(_renamed(scenario, moved), path=path)


def at_url(scenario: Scenario, url: str) -> Scenario:
    """Return a scenario that was read from a URL: what its relative paths name lies beside it there."""
    return _renamed(scenario, lambda name: beside(url, name))


def _renamed(scenario: Scenario, moved: Callable[[str], str]) -> Scenario:
    """Return a scenario with other names of its log, scenes and meshes."""
    log: str | StreetLog = scenario.log
    log = moved(log) if isinstance(log, str) else replace(log, path=moved(log.path))
    scene = scenario.scene if scenario.scene in (None, RECORDED) else moved(str(scenario.scene))
    edits = []
    for edit in scenario.edits:
        named: dict[str, Any] = {
            name: moved(getattr(edit, name))
            for name in ("scene", *edit.meshes)
            if getattr(edit, name, None) is not None
        }
        edits.append(replace(edit, **named) if named else edit)
    return replace(scenario, log=log, scene=scene, edits=tuple(edits))
