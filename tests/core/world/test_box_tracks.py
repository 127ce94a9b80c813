"""Boxes of frames to actors: which of them move, by their class and by how far their boxes wander."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from unisim_blender.core.errors import LogError
from unisim_blender.core.world.box_tracks import TrackedBoxes, actors_of_boxes


def boxes(label: str, wander_m: float, frames: int = 20) -> TrackedBoxes:
    """Those of one actor that goes so far along x, 10 a second."""
    times = 0.1 * np.arange(frames)
    poses = np.tile(np.eye(4), (frames, 1, 1))
    poses[:, 0, 3] = np.linspace(0.0, wander_m, frames)
    sizes = np.tile([4.0, 2.0, 1.5], (frames, 1))
    return TrackedBoxes(np.full(frames, "one"), np.full(frames, label, object), times, poses, sizes, times - 0.03)


@pytest.mark.parametrize(
    ("label", "wander_m", "moves"),
    [
        ("REGULAR_VEHICLE", 1.2, False),
        ("REGULAR_VEHICLE", 3.0, True),
        ("PEDESTRIAN", 1.2, True),
        ("PEDESTRIAN", 0.6, False),
        ("CONSTRUCTION_CONE", 3.0, False),
        ("movable_object.barrier", 3.0, False),
        ("nobody's class", 3.0, True),
    ],
)
def test_what_moves(label: str, wander_m: float, moves: bool) -> None:
    """What stands by its class stands, people move by less than vehicles; the label stays the dataset's."""
    (actor,) = actors_of_boxes(Path("boxes"), boxes(label, wander_m)).values()
    assert (actor.is_moving, actor.label) == (moves, label)
    track = actor.world_from_actor
    if moves:
        np.testing.assert_allclose(track.times_s, 0.1 * np.arange(20) - 0.03)
    else:
        np.testing.assert_allclose(track.positions, [[wander_m / 2, 0, 0]], atol=1e-9)


def test_a_box_twice_in_a_frame_is_named() -> None:
    one = boxes("Car", 0.0, 2)
    one.frame_time_s[:] = 0.0
    with pytest.raises(LogError, match="boxes: box one stands twice in the frame at 0.0 s"):
        actors_of_boxes(Path("boxes"), one)
