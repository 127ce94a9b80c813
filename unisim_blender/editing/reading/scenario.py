"""A Blender scene read as a scenario: the difference between what was imported and what stands there.

What lies within a tenth of a millimetre of the import at every frame is unedited and keeps its float64 original.
"""

from __future__ import annotations

import os
from pathlib import Path

from ...core.errors import ScenarioError
from ...core.scenario.edits import Move, Remove, Scale, Swap
from ...core.scenario.sensors import CameraSpec, LidarSpec, Sensors
from ...core.scenario.types import FrameRange, Outputs, Scenario
from ...core.world.drive import Drive
from ..sampled.scene import Sampled
from ..sampled.source import Source
from .actors import actor_edits
from .ego_bodies import body_edits
from .rig import ego_edits, sensors_of
from .static_items import static_edits


def read_scenario(
    sampled: Sampled,
    source: Source,
    path: Path,
    frames: FrameRange | None = None,
    outputs: Outputs | None = None,
) -> Scenario:
    """The scenario that a sampled scene stands for; its paths are relative to ``path``, where it is meant to be written.

    Raises `UnisimError` where another trained scene that a look comes from cannot be read.
    """
    drive, taken = source.drive, {*source.drive.actors, *(thing.uid for thing in sampled.of("STATIC"))}
    boxes, edits = static_edits(sampled, taken)
    return Scenario(
        name=sampled.name,
        log=relative(source.log_path, path),
        scene=None if source.scene_path is None else relative(source.scene_path, path),
        frames=frames,
        sensors=sensors_of(sampled, drive),
        boxes=boxes or None,
        edits=(
            *actor_edits(sampled, drive, taken, lambda scene: relative(Path(scene), path)),
            *edits,
            *ego_edits(sampled, drive),
            *body_edits(sampled, taken, lambda mesh: relative(Path(mesh), path)),
        ),
        outputs=outputs,
        path=path,
    )


def edited_ids(sampled: Sampled, drive: Drive) -> set[str]:
    """Ids of recorded actors and sensors that do not stand as they were imported, missing ones too; "ego" for the vehicle."""
    edits = actor_edits(sampled, drive, set(drive.actors), str)
    found = {edit.actor for edit in edits if isinstance(edit, Move | Remove | Swap | Scale)} & set(drive.actors)
    # a vehicle that was deleted took its sensors along: nothing of them is kept
    sensors = (sensors_of(sampled, drive) if any(sampled.of("EGO")) else None) or Sensors()
    if sensors.cameras is not None:
        found |= set(drive.cameras) - {spec.id for spec in sensors.cameras if spec == CameraSpec(spec.id)}
    if sensors.lidars is not None:
        found |= set(drive.lidars) - {spec.id for spec in sensors.lidars if spec == LidarSpec(spec.id)}
    return found | ({"ego"} if any(True for _ in ego_edits(sampled, drive)) else set())


def relative(target: Path, file: Path) -> str:
    """``target`` as a scenario in ``file`` names it."""
    try:
        return Path(os.path.relpath(target, file.parent)).as_posix()
    except ValueError as fault:
        if os.name == "nt":  # there is no relative path to another drive
            return target.as_posix()
        raise ScenarioError(f"{file}: {target}: {fault}") from fault
