"""Reads `copy_static` and `remove_static`: boxes around static items that are not annotated."""

from __future__ import annotations

import json
from collections.abc import Iterator

import numpy as np

from ...core.errors import ScenarioError
from ...core.geometry import quaternion_from_matrix
from ...core.scenario.edits import CopyStatic, RemoveStatic
from ...core.scenario.motion.placement import BoxSpec
from ..edits.lines import EditLine, line_of, moved
from ..edits.reader import GroupReader, ReadContext, register
from ..edits.trajectories import placement, quaternion, vector
from ..sampled.scene import UNIT, SampledObject, same, scale_text
from ..texts import Text


@register
class StaticItems(GroupReader):
    """Reads static items.

    An item's own box (the one with the name that it was given) stands for the item: where it was marked, nothing is
    edited; elsewhere, the item moved; hidden for renders or deleted, it is gone. Every other box of its id is a copy.
    """

    group = "STATIC"
    kinds = ("STATIC",)

    def edits(self, reading: ReadContext) -> Iterator[CopyStatic | RemoveStatic]:
        sampled = reading.sampled
        standing: dict[str, list[SampledObject]] = {uid: [] for uid in sampled.items}
        for obj in sampled.of("STATIC"):
            refuse_scale(obj)
            standing.setdefault(obj.uid, []).append(obj)
        for uid, objects in sorted(standing.items()):
            marked = json.loads(sampled.items[uid] if uid in sampled.items else objects[0].model)
            pose, size = np.array(marked["world_from_box"]), np.array(marked["size_m"])
            own = next((obj for obj in objects if obj.is_original), None)
            stays = own is not None and own.there.any() and bool(same(own.poses, pose).all())
            new: list[CopyStatic | RemoveStatic] = []
            # a copy from another file says nothing about the item here
            if not stays and (own is not None or uid in sampled.items):
                new.append(RemoveStatic(uid))
            for obj in objects:
                if obj.there.any() and not (obj is own and stays):
                    # static items stand still: where they are at the first frame counts
                    new.append(CopyStatic(uid, reading.new_id(obj), placement(obj.poses[0])))
            if new:
                turn = quaternion(quaternion_from_matrix(pose[:3, :3]))
                reading.boxes[uid] = BoxSpec(position=vector(pose[:3, 3]), quaternion_wxyz=turn, size_m=vector(size))
                yield from new

    def lines(self, reading: ReadContext, uid: str) -> Iterator[EditLine]:
        """A line for each item and copy. An item that is moved is removed and copied in a scenario; it is one line."""
        clock, sampled, always = reading.clock, reading.sampled, np.ones(len(reading.clock.frames), bool)
        edits = list(self.edits(reading))
        for uid in reading.boxes:
            standing = [obj for obj in sampled.of("STATIC") if obj.uid == uid and obj.there.any()]
            own = next((obj for obj in standing if obj.is_original), None)
            copies = [edit for edit in edits if isinstance(edit, CopyStatic) and edit.box == uid]
            gone = RemoveStatic(uid) in edits
            copied = [obj for obj in standing if not (obj is own and not gone)]
            for edit, obj in zip(copies, copied, strict=True):
                apart = float(np.linalg.norm(obj.poses[0, :3, 3] - np.array(reading.boxes[uid].position)))
                far = Text("{length} away", length=f"{apart:.1f} m")
                part, words = ("MOVE", moved(far)) if obj is own else ("COPY", Text("Copied: {how}", how=far))
                yield line_of("STATIC", uid, part, words, (obj.title, obj.name), always, clock, edit)
            if gone and own is None:
                hidden = next((obj.name for obj in sampled.of("STATIC") if obj.uid == uid and obj.is_original), "")
                yield line_of("STATIC", uid, "REMOVE", Text("Removed"), (uid, hidden), always, clock, RemoveStatic(uid))


def refuse_scale(obj: SampledObject) -> None:
    """Raise `ScenarioError` where a static item's box is drawn in another size than it was marked in."""
    if obj.scaling.fault or obj.scaling.factors != UNIT:
        raise ScenarioError(
            f'object "{obj.name}": is scaled by {scale_text(obj.scaling.factors)}, which a static item cannot be: clear its '
            "scale (Alt-S), or that of its parent"
        )
