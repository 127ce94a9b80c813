"""A rollout's scene: markers in the timeline, and what is drawn over its objects. Rollouts are read by a thread, so that
no view waits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path

import bpy
import numpy as np

from ...core.geometry import FloatArray
from ...core.world.drive import Drive
from ...editing.layout.trails import TrailSegments, ghost_lines, joined, path_lines, plan_lines, vehicle_boxes
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import rigid
from ...editing.simulation.rollouts import RolloutEvent, RolloutTimes, read_rollout, rollout_state, vehicle_of
from ...editing.simulation.stated import vehicle_parameters
from ..objects.imported import imported_objects, originals
from ..objects.settings import rollout_folder
from ..window import redraw, run_soon

POLL_S = 0.1

_read: dict[Path, Future[RolloutTimes]] = {}
"""Rollouts by folder."""
_reader = ThreadPoolExecutor(1, "unisim-rollouts")
MARKER_PREFIX = "UniSim "
"""Prefix of the names of markers that stand for a rollout's moments."""


def keep_rollout(folder: Path, rollout: RolloutTimes) -> None:
    """Keep a rollout that was read."""
    _read[folder] = Future()
    _read[folder].set_result(rollout)


def rollout_of(scene: bpy.types.Scene) -> RolloutTimes | None:
    """Return the rollout that a scene was opened from; None for any other scene, one that was moved or deleted, and until a
    thread has read it: views are then drawn again."""
    folder = rollout_folder(scene)
    if folder is None:
        return None
    if folder not in _read:
        _read[folder] = _reader.submit(read_rollout, folder)
        run_soon(_look, POLL_S)
    read = _read[folder]
    return read.result() if read.done() and read.exception() is None else None


def forget() -> None:
    """Forget all rollouts."""
    _read.clear()


def _look() -> float | None:
    """Draw the views again once all rollouts are read; a timer of Blender's."""
    if not all(read.done() for read in _read.values()):
        return POLL_S
    redraw("VIEW_3D")
    return None


def rollout_lines(scene: bpy.types.Scene, drive: Drive, clock: Clock, frame: float) -> TrailSegments:
    """Return the plan at a frame, and the recorded drive where it differs from the rollout, as lines."""
    about, time_s = scene.unisim_simulation, float(clock.time_s(np.array(frame)))
    ego = next(imported_objects(scene, "EGO"), None)
    parts: list[TrailSegments] = []
    if ego is not None:
        now = _pose(ego)
        vehicle = vehicle_of(vehicle_parameters(about.document))
        if about.show_plans and (rollout := rollout_of(scene)) is not None:
            parts.append(plan_lines(rollout.plan_at(time_s), float((now @ vehicle.ego_from_axle)[2, 3])))
        if about.show_ghost:
            parts.append(vehicle_boxes(drive.world_from_ego.at(time_s), now, vehicle))
            parts.append(path_lines(drive.world_from_ego.transformed(right=vehicle.ego_from_axle).positions))
    if about.show_ghost:
        parts.append(ghost_lines(_apart(scene, drive, time_s)))
    return joined(parts)


def _apart(scene: bpy.types.Scene, drive: Drive, time_s: float) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Return recorded pose, pose now and size of the recorded actors that move and are there."""
    objects = originals(scene, "ACTOR")
    return [
        (actor.world_from_actor.at(time_s), _pose(objects[uid]), actor.size_m)
        for uid, actor in drive.actors.items()
        if uid in objects and actor.is_moving and bool(actor.present(time_s))
    ]


def _pose(obj: bpy.types.Object) -> FloatArray:
    return rigid(np.array(obj.matrix_world, float))


def mark_rollout(
    scene: bpy.types.Scene,
    folder: Path,
    rollout: RolloutTimes,
    moments: Sequence[tuple[RolloutEvent, str]],
    clock: Clock,
) -> None:
    """Note in an imported scene which rollout it is of, and mark its moments, each with its words, in the timeline."""
    about = scene.unisim_simulation
    about.rollout = about.scored = str(folder)
    about.state = rollout_state(folder)
    about.span_s = (float(rollout.times_s[0]), float(rollout.times_s[-1]))
    for marker in [marker for marker in scene.timeline_markers if marker.name.startswith(MARKER_PREFIX)]:
        scene.timeline_markers.remove(marker)
    for moment, words in moments:
        scene.timeline_markers.new(MARKER_PREFIX + words, frame=round(float(clock.frame(np.array(moment.time_s)))))


def scene_of_rollout(folder: Path) -> bpy.types.Scene | None:
    """Return the scene that a rollout was opened in; None where there is none."""
    return next((scene for scene in bpy.data.scenes if rollout_folder(scene) == folder), None)


def actor_names(scene: bpy.types.Scene) -> Mapping[str, str]:
    """Return the names of a scene's actors by their ids in scenarios."""
    return {obj.unisim.uid: obj.name for obj in imported_objects(scene, "ACTOR") if obj.name == obj.unisim.home}
