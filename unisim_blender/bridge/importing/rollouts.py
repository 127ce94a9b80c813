"""A rollout's scene: what happened in it as markers of the timeline, and where its folder is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import bpy
import numpy as np

from ...editing.sampled.clock import Clock
from ...editing.simulation.rollouts import RolloutEvent, RolloutTimes
from ..objects.imported import imported_objects

TAG = "UniSim "
"""How the names of markers begin that stand for a rollout's moments."""


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
    about.span_s = (float(rollout.times_s[0]), float(rollout.times_s[-1]))
    for marker in [one for one in scene.timeline_markers if one.name.startswith(TAG)]:
        scene.timeline_markers.remove(marker)
    for moment, words in moments:
        scene.timeline_markers.new(TAG + words, frame=round(float(clock.frame(np.array(moment.time_s)))))


def actor_names(scene: bpy.types.Scene) -> Mapping[str, str]:
    """Return the names of a scene's actors by their ids in scenarios."""
    return {obj.unisim.uid: obj.name for obj in imported_objects(scene, "ACTOR") if obj.name == obj.unisim.home}
