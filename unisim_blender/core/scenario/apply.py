"""Apply a scenario's edits to a drive, in order."""

from __future__ import annotations

from dataclasses import replace

from ..geometry import TrajectoryError
from ..world.drive import Drive
from .context import EditContext, SceneActors
from .faults import fail
from .sensors.select import select_sensors
from .types import FrameRange, Scenario


def apply_scenario(scenario: Scenario, base_drive: Drive, scene_actors: SceneActors) -> Drive:
    """Return the edited drive. ``base_drive`` is not changed; the result shares the objects that no edit changes.

    ``scene_actors`` returns the actors of another trained scene, given its folder. Raises `ScenarioError` naming
    the edit's place.
    """
    context = EditContext(scenario, base_drive, scene_actors)
    for key in scenario.boxes or {}:
        if key in base_drive.actors:
            fail(f"{scenario.path}: boxes.{key}", "is an actor's id already")
    drive, place = base_drive, ""
    try:
        for index, edit in enumerate(scenario.edits):
            place = f"{scenario.path}: edits[{index}]"
            drive = edit.apply(drive, place, context)
        place = f"{scenario.path}: sensors"
        return select_sensors(select_frames(drive, scenario), context)
    except TrajectoryError as fault:
        fail(place, str(fault))


def select_frames(drive: Drive, scenario: Scenario) -> Drive:
    """Return the drive with the scenario's frames. A range skips frames that the log lacks; a list that names
    one is an error."""
    if scenario.frames is None:
        return drive
    place, span = f"{scenario.path}: frames", f"({drive.frames[0]} … {drive.frames[-1]})"
    if isinstance(scenario.frames, FrameRange):
        last = drive.frames[-1] + 1
        stop = last if scenario.frames.stop is None else scenario.frames.stop
        if stop > last:
            fail(f"{place}.stop", f"no frame {stop - 1} in the log {span}")
        wanted = range(scenario.frames.start or 0, stop, scenario.frames.step or 1)
        frames = tuple(frame for frame in drive.frames if frame in wanted)
        if not frames:
            fail(place, f"selects none of the frames there are {span}")
        return replace(drive, frames=frames)
    for index, frame in enumerate(scenario.frames):
        if frame not in drive.time_s:
            fail(f"{place}[{index}]", f"no frame {frame} in the log {span}")
    return replace(drive, frames=tuple(scenario.frames))
