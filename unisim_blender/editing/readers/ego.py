"""Reads `ego`, the recording vehicle beside its recorded trajectory or on another one, and `ego_body`, meshes that are
fixed to it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...core.errors import ScenarioError
from ...core.geometry import FloatArray, invert_pose
from ...core.scenario.edit import Edit
from ...core.scenario.edits import Ego, EgoBody
from ...core.scenario.motion.keys import ShiftKey
from ..edits.lines import EditLine, displaced_words, is_retimed, joined, line_of, trajectory_words
from ..edits.reader import GroupReader, ReadContext, register
from ..edits.trajectories import keyframes, placement
from ..sampled.clock import Clock
from ..sampled.scene import SAME_M, same, same_turn
from ..texts import Text


@register
class EgoReader(GroupReader):
    """Reads the vehicle."""

    group = "RIG"
    kinds = ("EGO",)

    def edits(self, reading: ReadContext) -> Iterator[Edit]:
        """None where the vehicle drives as recorded; a shift where it drives beside that, else a new trajectory."""
        ego = next(reading.sampled.of("EGO"), None)
        if ego is None:
            return
        base = reading.drive.world_from_ego.at(reading.clock.times_s)
        if same(ego.poses, base).all():
            return
        apart = np.einsum("nji,nj->ni", base[:, :3, :3], (ego.poses - base)[:, :3, 3])
        ahead, left, up = np.abs(apart[:, 0]).max(), apart[:, 1], np.abs(apart[:, 2]).max()
        if same_turn(ego.poses, base).all() and max(ahead, up, np.ptp(left)) <= 2 * SAME_M:
            yield Ego(shift_left_m=round(float(left.mean()), 6))
        elif same_turn(ego.poses, base).all() and max(ahead, up) <= 2 * SAME_M:
            yield Ego(shift=shift_keys(reading.clock, left))
        else:
            yield Ego(trajectory=keyframes(reading.clock, ego.poses, np.ones(len(ego.poses), bool)))

    def lines(self, reading: ReadContext, uid: str) -> Iterator[EditLine]:
        clock, recorded = reading.clock, reading.drive.world_from_ego
        for edit in self.edits(reading):
            ego = next(reading.sampled.of("EGO"))
            base = recorded.at(clock.times_s)
            if ego.ridden is not None:
                ridden = trajectory_words(clock, ego.ridden, base, recorded, is_retimed(ego, recorded, clock))
                words = joined([ridden, displaced_words(invert_pose(ego.ridden) @ ego.poses)])
            else:
                words = trajectory_words(clock, ego.poses, base, None, False)
            differs = ~same(ego.poses, base)
            yield line_of("EGO", "ego", "EGO", words or Text("Moved"), (ego.title, ego.name), differs, clock, edit)

    def edited_ids(self, reading: ReadContext) -> set[str]:
        """The vehicle's, "ego", where it drives elsewhere."""
        return {"ego"} if any(True for _ in self.edits(reading)) else set()


def shift_keys(clock: Clock, left_m: FloatArray) -> tuple[ShiftKey, ...]:
    """Keys of a shift (N,) to the left: of the frames, those at which its rate changes."""
    rate = np.diff(left_m) / np.diff(clock.times_s)
    turns = np.concatenate([[True], np.abs(np.diff(rate)) * np.diff(clock.times_s)[1:] > SAME_M, [True]])
    return tuple(ShiftKey(round(float(left_m[i]), 6), frame=int(clock.frames[i])) for i in np.flatnonzero(turns))


@register
class EgoBodies(GroupReader):
    """Reads the vehicle's bodies."""

    group = "RIG"
    kinds = ("BODY",)

    def edits(self, reading: ReadContext) -> Iterator[EgoBody]:
        """An edit for each body. Raises `ScenarioError` for one that is not fixed to the vehicle."""
        ego = next(reading.sampled.of("EGO"), None)
        for obj in reading.sampled.of("BODY"):
            if not obj.there.any():
                continue
            if ego is None:
                raise ScenarioError(
                    f'object "{obj.name}": is a body of the ego vehicle, which is not there: undo that it was deleted'
                )
            mount = invert_pose(ego.poses) @ obj.poses
            if not same(mount, mount[:1]).all():
                raise ScenarioError(
                    f'object "{obj.name}": moves on the ego vehicle, which its body is fixed to: keep it parented to the '
                    "vehicle, and clear its keys and constraints"
                )
            yield EgoBody(reading.relative(obj.mesh), reading.new_id(obj), placement(mount[0]), obj.label or None)

    def lines(self, reading: ReadContext, uid: str) -> Iterator[EditLine]:
        bodies = [obj for obj in reading.sampled.of("BODY") if obj.there.any()]
        for body, obj in zip(self.edits(reading), bodies, strict=True):
            names, words = (obj.title, obj.name), Text("Body of the ego vehicle")
            yield line_of("BODY", obj.uid, "BODY", words, names, obj.there, reading.clock, body)
