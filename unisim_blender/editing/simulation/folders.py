"""Where rollouts are written: a folder for each in the chosen one, beside the scenario and the command that it is of."""

from __future__ import annotations

import hashlib
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...core.errors import OutputError
from ...core.files import write_file
from ...core.scenario import scenario_to_json
from ...core.scenario.types import Scenario
from ..reading.writing import write_scenario

SCORES, STEPS, SCENARIO = "scores.json", "steps.jsonl", "scenario.json"
"""Files of a rollout's folder."""
MOST = 10_000


def rollout_name(variant: str, driver: str, number: int) -> str:
    """Return the name of a rollout's folder: "Scene idm 2"."""
    words = [re.sub(r"[^\w. -]+", "_", word) for word in (variant, driver.rpartition(":")[2])]
    return f"{' '.join(words)} {number}"


def folder_for(parent: Path, variant: str, driver: str, options: dict[str, Any]) -> Path:
    """Return the folder of a rollout: the newest one of this variant and driver where that was begun with the same options
    (`options_of`), to be resumed, else the next one that is not there. Raises `OutputError` where there is none."""
    found: Path | None = None
    for number in range(1, MOST):
        folder = parent / rollout_name(variant, driver, number)
        if not folder.exists() and not options_path(folder).exists():
            return found if found is not None and _begun_with(found) == options else folder
        found = folder
    raise OutputError(f"{parent}: holds {MOST} rollouts of {variant} by {driver}; choose another folder")


def scenario_path(folder: Path) -> Path:
    """Return the file of the scenario that a rollout begins with."""
    return folder.with_name(f"{folder.name}.json")


def options_path(folder: Path) -> Path:
    """Return the file of the options that a rollout was begun with."""
    return folder.with_name(f"{folder.name}.options.json")


def options_of(scenario: Scenario, command: list[str]) -> dict[str, Any]:
    """Return what a rollout is begun with, as JSON has it: the command's options, and a digest of the scenario."""
    edits = []
    for edit in scenario.edits:  # their meshes' files are named after what they hold, and lie in other folders later
        edits.append(replace(edit, **{name: Path(getattr(edit, name)).name for name in edit.meshes}))
    document = json.dumps(scenario_to_json(replace(scenario, edits=tuple(edits))), sort_keys=True)
    return {"options": command, "scenario": hashlib.sha256(document.encode()).hexdigest()}


def _begun_with(folder: Path) -> Any:
    try:
        return json.loads(options_path(folder).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def is_rollout(folder: Path) -> bool:
    """Return whether a folder holds a rollout that has come to its end."""
    return (folder / STEPS).is_file() and (folder / SCENARIO).is_file()


def folder_of(path: Path) -> Path | None:
    """Return the rollout's folder that a chosen folder or file is, or lies in; None where there is none."""
    folder = path if path.is_dir() else path.parent
    return folder if is_rollout(folder) and (path.is_dir() or path.name == SCENARIO) else None


def write_inputs(scenario: Scenario, command: list[str], parent: Path, variant: str, driver: str) -> Path:
    """Write a scenario and a command's options beside the folder of their rollout, and return that. Raises `UnisimError`."""
    options = options_of(scenario, command)
    folder = folder_for(parent, variant, driver, options)
    parent.mkdir(parents=True, exist_ok=True)
    write_scenario(replace(scenario, path=scenario_path(folder)), scenario_path(folder))
    write_file(options_path(folder), json.dumps(options, indent=1).encode())
    return folder
