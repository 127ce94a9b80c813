"""Sweeps in the view: recorded ones where the log is at hand, simulated ones of the scene as it is edited."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
import pytest
from numpy.typing import NDArray

from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.views.points import hide_points, points_of, put_points
from unisim_blender.editing.layout.shapes import GREY, RECORDED, SIMULATED
from unisim_blender.features.points.clouds import clouds, offset


def points(scene: Any) -> NDArray[Any]:
    """The simulated points (N, 3)."""
    (one,) = [t for t in imported_objects(scene, "POINTS") if t.unisim.uid.endswith("simulated")]
    out = np.empty(3 * len(one.data.vertices), np.float32)
    one.data.vertices.foreach_get("co", out)
    return out.reshape(-1, 3)


def test_a_simulated_sweep_stands_in_the_world(street: Any) -> None:
    street.frame_set(5)
    assert bpy.ops.unisim.show_points(recorded=False, simulated=True) == {"FINISHED"}
    first = points(street)
    assert len(first) > 5000
    low = np.percentile(first[:, 2], 30)
    assert abs(low) < 1.0  # most of a sweep is road
    (one,) = imported_objects(street, "POINTS")
    assert one.hide_viewport  # drawn in colours, not as Blender's own dots
    mesh = one.data
    assert {"intensity", "depth", "instance"} <= {a.name for a in mesh.attributes}
    street.frame_set(12)
    assert np.abs(points(street).mean(0) - first.mean(0)).max() > 0.5
    assert bpy.ops.unisim.show_points(recorded=False, simulated=False) == {"FINISHED"}
    assert not list(imported_objects(street, "POINTS"))


def test_recorded_and_simulated_points_are_coloured_alike(street: Any) -> None:
    points = np.array([[1.0, 0, 0], [2.0, 0, 0], [3.0, 0, 0]])
    measured = {"intensity": np.array([0.0, 0.5, 1.0], np.float32), "depth": np.array([5.0, 40.0, 90.0], np.float32)}
    recorded = put_points(street, "lidar", RECORDED, points, {**measured, "class": np.array([7, -1, 13], np.int32)})
    simulated = put_points(street, "lidar", SIMULATED, points, {**measured, "instance": np.array([0, 3, 4], np.int32)})
    for by in ("INTENSITY", "DEPTH"):
        (places, one), (_, other) = points_of(recorded, by), points_of(simulated, by)
        assert (places == points).all() and (one == other).all()
        assert np.abs(np.diff(one, axis=0)).max(1).min() > 0.2  # low, middle and high can be told apart
    by_class, by_instance = points_of(recorded, "INSTANCE")[1], points_of(simulated, "INSTANCE")[1]
    assert by_class[1] == pytest.approx([*GREY, 1.0]) and by_instance[0] == pytest.approx([*GREY, 1.0])
    assert np.abs(by_instance[1] - by_instance[2]).max() > 0.3 and np.abs(by_class[0] - by_class[2]).max() > 0.3
    assert not np.array_equal(points_of(recorded, "ONE")[1], points_of(simulated, "ONE")[1])
    bare = put_points(street, "lidar", RECORDED, points, {})
    assert points_of(bare, "DEPTH")[1] == pytest.approx(np.tile([*GREY, 1.0], (3, 1)))


def test_clouds_are_built_again_only_when_something_changed(street: Any) -> None:
    built: list[str] = []

    def drawn() -> int:
        clouds(street, lambda obj, by: built.append(f"{obj.name} {by}"))
        return len(built)

    points = np.zeros((3, 3))
    put_points(street, "lidar", RECORDED, points, {})
    put_points(street, "lidar", SIMULATED, points, {})
    assert drawn() == 2 and drawn() == 2
    street.unisim.recorded_offset_m = 7.0
    assert drawn() == 2
    street.unisim.points_colour = "DEPTH"
    assert drawn() == 4 and drawn() == 4
    put_points(street, "lidar", SIMULATED, points + 1, {})
    assert drawn() == 5
    hide_points(street, RECORDED)
    assert drawn() == 5
    put_points(street, "lidar", RECORDED, points, {})
    assert drawn() == 6


def test_recorded_points_beside_are_to_the_vehicles_left(street: Any) -> None:
    recorded = put_points(street, "lidar", RECORDED, np.zeros((1, 3)), {})
    simulated = put_points(street, "lidar", SIMULATED, np.zeros((1, 3)), {})
    street.unisim.recorded_offset_m = 30.0
    street.frame_set(5)
    source = source_of(street)
    left = source.drive.world_from_ego.at(source.drive.time_s[5])[:3, 1]
    assert np.array(offset(street, recorded)) == pytest.approx(30.0 * left, abs=1e-3)
    assert np.array(offset(street, simulated)) == pytest.approx([0.0, 0.0, 0.0])
