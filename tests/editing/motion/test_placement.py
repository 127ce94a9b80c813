"""The default place of an inserted actor, among an ego and other actors on straight paths."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.core.geometry import FloatArray
from unisim_blender.editing.motion.placement import InsertPlace, Neighbour, place_ahead

TIMES_S = np.arange(0.0, 8.0, 0.1)
CAR_M = np.array([4.5, 1.9, 1.6])


def moving(x: float, y: float, speed_m_s: float, z: float = 0.0) -> FloatArray:
    """Poses (N, 4, 4) along x, facing where they go."""
    poses = np.tile(np.diag([np.sign(speed_m_s) or 1.0] * 2 + [1.0, 1.0]), (len(TIMES_S), 1, 1))
    poses[:, :3, 3] = np.stack([x + speed_m_s * TIMES_S, y + 0 * TIMES_S, z + 0 * TIMES_S], -1)
    return poses


def neighbour(poses: FloatArray, label: str = "Car", size_m: FloatArray = CAR_M) -> Neighbour:
    return Neighbour(poses, np.ones(len(poses), bool), label, size_m)


def placed(label: str, ego: FloatArray, *others: Neighbour, at: int = 0, size_m: FloatArray = CAR_M) -> InsertPlace:
    return place_ahead(label, size_m, ego, others, at, TIMES_S)


@pytest.mark.parametrize("at", [0, 40, 79])
def test_a_car_is_ahead_of_the_ego_at_its_speed(at: int) -> None:
    ego = moving(0.0, 0.0, 10.0, z=1.0)
    place = placed("Car", ego, at=at)
    apart = (place.poses - ego)[:, :3, 3]
    assert not place.stands and apart == pytest.approx(np.tile([3.9 + 15.0 + 2.25, 0.0, 0.0], (80, 1)))
    assert place.on_ground(0.2, 1.6)[:, 2, 3] == pytest.approx(1.0), "its underside is on the ground, at 0.2 m"


def test_a_car_is_clear_of_the_one_ahead_at_all_frames() -> None:
    """The lead is caught up with, so the place is in front of it."""
    ego, lead = moving(0.0, 0.0, 10.0), moving(45.0, 0.0, 7.0)
    place = placed("Car", ego, neighbour(lead))
    apart = (place.poses - lead)[:, 0, 3]
    assert (apart > 4.5).all() and place.poses[0, 0, 3] < 80.0


def test_before_an_ego_that_stands_a_car_follows_the_nearest_path_that_leads_the_same_way() -> None:
    ego, left = moving(0.0, 0.0, 0.0), neighbour(moving(-20.0, 3.5, 8.0, z=0.8))
    oncoming = neighbour(moving(80.0, 3.0, -8.0, z=0.8))
    place = placed("Car", ego, left, oncoming)
    assert place.poses[0, :2, 3] == pytest.approx([12.15, 3.5], abs=0.9)
    assert np.diff(place.poses[:, 0, 3]) == pytest.approx(np.full(79, 0.8))
    assert place.on_ground(None, 2.0)[0, 2, 3] == pytest.approx(1.0), "as high as the path's actor stands"
    alone = placed("Car", ego)
    assert alone.stands and alone.poses[:, :2, 3] == pytest.approx(np.tile([12.15, 0.0], (80, 1)))


def test_what_stands_is_beside_the_ego_and_a_pedestrian_goes_where_others_go() -> None:
    ego, small = moving(0.0, 0.0, 10.0), np.array([0.5, 0.5, 1.0])
    cone = placed("Cones", ego, size_m=small)
    assert cone.stands and cone.poses[0, :2, 3] == pytest.approx([19.15, -2.0])
    walking = neighbour(moving(15.0, 6.0, -1.4), "Pedestrian", np.array([0.7, 0.7, 1.8]))
    pedestrian = placed("Pedestrian", ego, walking, size_m=small)
    assert not pedestrian.stands and pedestrian.poses[:, 1, 3] == pytest.approx(6.0)
    assert np.diff(pedestrian.poses[:, 0, 3]) == pytest.approx(np.full(79, -0.14))
    assert placed("Pedestrian", ego, size_m=small).stands
