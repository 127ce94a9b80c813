"""A Blender scene read as a scenario: the difference between what was imported and what stands there.

What lies within a tenth of a millimetre of the import at every frame is unedited and keeps its float64 original.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

from ...core.errors import ScenarioError
from ...core.scenario.types import FrameRange, Outputs, Scenario
from ...core.world.drive import Drive
from .. import readers  # noqa: F401 so that all are registered
from ..edits.lines import EditLine, problem_line
from ..edits.reader import GROUPS, ReadContext
from ..readers.sensors import sensors_of
from ..sampled.scene import Sampled
from ..sampled.source import DriveSource

GROUP_OF = {kind: reader.group for reader in GROUPS for kind in reader.kinds}
"""Which objects are read together, by their kinds."""
BY_ID = {reader.group for reader in GROUPS if reader.by_id}
"""Groups of which each id is one of its own."""


def read_scenario(
    sampled: Sampled,
    source: DriveSource,
    path: Path,
    frames: FrameRange | None = None,
    outputs: Outputs | None = None,
) -> Scenario:
    """The scenario that a sampled scene stands for; its paths are relative to ``path``, where it is
    meant to be written.

    Raises `UnisimError` where another trained scene that an appearance comes from cannot be read.
    """
    drive = source.drive
    reading = _reading(sampled, drive, lambda name: relative(Path(name), path))
    edits = tuple(edit for reader in GROUPS for edit in reader.edits(reading))
    return Scenario(
        name=sampled.name,
        log=relative(source.log_path, path),
        scene=None if source.scene_path is None else relative(source.scene_path, path),
        frames=frames,
        sensors=sensors_of(sampled, drive),
        boxes=reading.boxes or None,
        edits=edits,
        outputs=outputs,
        path=path,
    )


def _reading(sampled: Sampled, drive: Drive, named: Callable[[str], str] = str) -> ReadContext:
    """Return the readers' context of a sampled scene. ``named`` gives a file or a folder as the scenario names it."""
    return ReadContext(sampled, drive, {*drive.actors, *(obj.uid for obj in sampled.of("STATIC"))}, named)


def edited_ids(sampled: Sampled, drive: Drive) -> set[str]:
    """Ids of recorded actors and sensors that do not stand as they were imported, missing ones too; "ego"
    for the vehicle."""
    reading = _reading(sampled, drive)
    return {uid for reader in GROUPS for uid in reader.edited_ids(reading)}


def group_lines(group: str, uid: str, sampled: Sampled, drive: Drive) -> Iterator[EditLine]:
    """Yield the lines of objects that are read together; where they cannot be read, one that says why."""
    try:
        for reader in GROUPS:
            if reader.group == group:
                yield from reader.lines(_reading(sampled, drive), uid)
    except ScenarioError as fault:
        yield problem_line(group, uid, fault, sampled.objects)


def relative(target: Path, file: Path) -> str:
    """``target`` as a scenario in ``file`` names it."""
    try:
        return Path(os.path.relpath(target, file.parent)).as_posix()
    except ValueError as fault:
        if os.name == "nt":  # there is no relative path to another drive
            return target.as_posix()
        raise ScenarioError(f"{file}: {target}: {fault}") from fault
