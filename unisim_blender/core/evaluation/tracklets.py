"""Errors of refined tracklets against true ones, and how much of a disturbance training has corrected.

An actor's appearance is learned in its box. A constant rigid offset of all boxes, with the inverse offset of the
appearance, gives the same images. Errors are therefore measured after removing each actor's best constant offset, in
the box's own axes.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.spatial.transform import Rotation

from ..geometry import FloatArray, invert_pose
from ..model.scene_file import SceneHeader
from ..training.poses import disturbed
from ..world.drive import Actor, Drive


def offset_errors(true: FloatArray, poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Errors of poses (K, 4, 4) against true ones (K, 4, 4), world from box: metres (K,) and radians (K,).

    The constant offset C that is taken off is the least-squares one: of ``inverse(true_k) pose_k`` the mean of the
    shifts and the mean of the rotations (Moakher, "Means and averaging in the group of rotations", 2002, eq. 3.2).
    """
    assert true.shape == poses.shape, f"poses of shapes {true.shape} and {poses.shape}"
    offset = invert_pose(true) @ poses
    shifts, turns = offset[:, :3, 3], Rotation.from_matrix(offset[:, :3, :3])
    shift_m = np.linalg.norm(shifts - shifts.mean(0), axis=1)
    return shift_m, np.asarray((turns.mean().inv() * turns).magnitude(), np.float64)


def taken_back(
    true: Mapping[str, Actor], disturbed: Mapping[str, Actor], refined: Mapping[str, Actor]
) -> dict[str, float | int] | None:
    """Root mean square errors of moving actors' boxes, all keys alike, as they were disturbed and as training refined
    them, and the share of the error that is gone: 1 for all of it, below 0 where it grew. None where no actor moves.

    Actors with a single key are left out: their offset is all there is.
    """
    moving = [uid for uid, actor in true.items() if actor.is_moving and len(actor.world_from_actor.times_s) > 1]
    if not moving:
        return None
    before, after = (
        _rms([true[uid] for uid in moving], [other[uid] for uid in moving]) for other in (disturbed, refined)
    )
    return {
        "actors": len(moving),
        "disturbed_m": before[0],
        "refined_m": after[0],
        "shift_taken_back": 1 - after[0] / before[0] if before[0] else 0.0,
        "disturbed_deg": float(np.degrees(before[1])),
        "refined_deg": float(np.degrees(after[1])),
        "turn_taken_back": 1 - after[1] / before[1] if before[1] else 0.0,
    }


def _rms(true: list[Actor], other: list[Actor]) -> tuple[float, float]:
    """Return the root mean square errors of all actors' keys: metres and radians."""
    errors = [
        offset_errors(a.world_from_actor.poses, b.world_from_actor.at(a.world_from_actor.times_s))
        for a, b in zip(true, other, strict=True)
    ]
    shifts, turns = (np.concatenate(parts) for parts in zip(*errors, strict=True))
    return float(np.sqrt((shifts**2).mean())), float(np.sqrt((turns**2).mean()))


def disturbance_taken_back(header: SceneHeader, recorded: Drive) -> dict[str, float | int] | None:
    """`taken_back` of a scene that was trained on disturbed boxes of a recorded drive; None for any other."""
    noise = header.training.get("disturbed")
    if noise is None:
        return None
    before = disturbed(recorded, noise["metres"], noise["degrees"], header.training["seed"])
    return taken_back(recorded.actors, before.actors, header.drive.actors)


def in_words(header: SceneHeader, recorded: Drive) -> str:
    """`disturbance_taken_back` in a sentence."""
    errors = disturbance_taken_back(header, recorded)
    if errors is None:
        return "no actor moves: no box was disturbed"
    text = (
        "boxes of {actors} moving actors were off by {disturbed_m:.3f} m and {disturbed_deg:.2f} degrees (root mean "
        "square, each actor's constant offset taken off), and are by {refined_m:.3f} m and {refined_deg:.2f} degrees: "
        "{shift_taken_back:.0%} and {turn_taken_back:.0%} taken back"
    )
    return text.format(**errors).replace("%", " %")
