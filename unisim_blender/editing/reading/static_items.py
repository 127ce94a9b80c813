"""Boxes round things without annotation, and what is done with them."""

from __future__ import annotations

import json

import numpy as np

from ...core.geometry import quaternion_from_matrix
from ...core.scenario.edit import Edit
from ...core.scenario.edits import CopyStatic, RemoveStatic
from ...core.scenario.placement import BoxSpec
from ..sampled.poses import same
from ..sampled.scene import Sampled
from ..sampled.scene import SampledObject as Thing
from .actors import new_id, refuse_scale
from .trajectories import placement, quaternion, vector


def static_edits(sampled: Sampled, taken: set[str]) -> tuple[dict[str, BoxSpec], list[Edit]]:
    """Boxes of space by id, and copies and removals of what stands in them.

    An item's own box (the one with the name that it was given) stands for the item: where it was marked, nothing is edited;
    elsewhere, the item moved; hidden for renders or deleted, it is gone. Every other box of its id is a copy.
    """
    boxes: dict[str, BoxSpec] = {}
    edits: list[Edit] = []
    standing: dict[str, list[Thing]] = {uid: [] for uid in sampled.items}
    for thing in sampled.of("STATIC"):
        refuse_scale(thing)
        standing.setdefault(thing.uid, []).append(thing)
    for uid, things in sorted(standing.items()):
        marked = json.loads(sampled.items[uid] if uid in sampled.items else things[0].model)
        home, size = np.array(marked["world_from_box"]), np.array(marked["size_m"])
        own = next((thing for thing in things if thing.is_original), None)
        stays = own is not None and own.there.any() and bool(same(own.poses, home).all())
        new: list[Edit] = [_copy(t, taken) for t in things if t.there.any() and not (t is own and stays)]
        # a copy from another file says nothing about the item here
        if not stays and (own is not None or uid in sampled.items):
            new.insert(0, RemoveStatic(uid))
        if new:
            turn = quaternion(quaternion_from_matrix(home[:3, :3]))
            boxes[uid] = BoxSpec(position=vector(home[:3, 3]), quaternion_wxyz=turn, size_m=vector(size))
            edits += new
    return boxes, edits


def _copy(thing: Thing, taken: set[str]) -> CopyStatic:
    """Static items stand still: where they are at the first frame counts."""
    return CopyStatic(thing.uid, new_id(thing, taken), placement(thing.poses[0]))
