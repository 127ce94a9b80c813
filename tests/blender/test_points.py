"""Sweeps in the view: recorded ones where the log is at hand, simulated ones of the scene as it is edited."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import bpy
import numpy as np
import pytest
from numpy.typing import NDArray

from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.views import points as points_module
from unisim_blender.bridge.views.points import hide_points, kind_of, put_sweep, sweep_of
from unisim_blender.editing.sensors.sweeps import DROPS, RECORDED, SIMULATED, ViewedSweep
from unisim_blender.features.points.clouds import offset, shown_points


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
    one, _ = sorted(imported_objects(street, "POINTS"), key=lambda obj: -len(obj.data.vertices))
    assert one.hide_viewport  # drawn in colours, not as Blender's own dots
    mesh = one.data
    assert {"intensity", "depth", "instance"} <= {a.name for a in mesh.attributes}
    street.frame_set(12)
    assert np.abs(points(street).mean(0) - first.mean(0)).max() > 0.5
    assert bpy.ops.unisim.show_points(recorded=False, simulated=False) == {"FINISHED"}
    assert not list(imported_objects(street, "POINTS"))


def sweep(kind: str, count: Any = 3, **values: Any) -> ViewedSweep:
    """Points at 1 m, 2 m, ... ahead, with some attributes."""
    points = np.arange(1.0, count + 1)[:, None] * [1.0, 0.0, 0.0]
    return ViewedSweep("lidar", kind, points, {name: np.asarray(value) for name, value in values.items()})


def test_a_sweep_is_the_same_after_it_was_put_into_a_mesh(street: Any) -> None:
    values = {"depth": np.array([5.0, 40.0, 90.0], np.float32), "cell": np.array([7, -1, 9])}
    values |= {"instance": np.array([4, 4, 0]), "class": np.array([2, 1, 0])}
    one = replace(sweep(RECORDED, **values), classes=("Bus", "Car"), frame=5.0)
    again = sweep_of(put_sweep(street, one))
    assert (again.lidar, again.kind, again.classes, again.frame) == ("lidar", RECORDED, ("Bus", "Car"), 5.0)
    assert (again.points == one.points).all() and again.attributes.keys() == one.attributes.keys()
    assert all((again.attributes[name] == values[name]).all() for name in values)
    drops = put_sweep(street, sweep(DROPS[RECORDED], cell=[1, 2, 3]))
    assert kind_of(drops) == DROPS[RECORDED] and sweep_of(drops).lidar == "lidar"


def test_a_large_sweep_is_thinned_by_beams(street: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(points_module, "MAX_CELLS", 10)
    recorded, simulated = (
        sweep_of(put_sweep(street, sweep(kind, len(cells), cell=cells)))
        for kind, cells in ((RECORDED, range(0, 26)), (SIMULATED, range(25, -1, -1)))
    )
    assert list(recorded.attributes["cell"]) == list(range(0, 26, 3))
    assert set(simulated.attributes["cell"]) == set(recorded.attributes["cell"])


def test_points_of_two_frames_are_not_compared(street: Any) -> None:
    values = {"cell": [0, 1, 2], "depth": [1.0, 2.0, 3.0], "intensity": [0.1, 0.2, 0.3]}
    for sweeps in (sweep(RECORDED, **values), sweep(DROPS[RECORDED], cell=[3, 4, 5]), sweep(SIMULATED, **values)):
        put_sweep(street, sweeps)
    shown = shown_points(street)
    assert shown is not None and "Median range error 0.000 m" in shown.legend.lines[-2]
    put_sweep(street, replace(sweep(RECORDED, **values), frame=6.0))
    shown = shown_points(street)
    assert shown is not None and shown.legend.lines[-1] == "Not compared: the points are of two frames"


def test_points_are_coloured_again_only_when_something_changed(street: Any) -> None:
    assert shown_points(street) is None
    put_sweep(street, sweep(RECORDED, depth=[1.0, 2.0, 3.0]))
    put_sweep(street, sweep(SIMULATED, depth=[1.0, 2.0, 3.0]))
    first = shown_points(street)
    assert first is not None and shown_points(street) is first
    street.unisim.recorded_offset_m = 7.0
    assert shown_points(street) is first
    street.unisim.points_colour = "DEPTH"
    second = shown_points(street)
    assert second is not None and second is not first and second.legend.bar is not None
    put_sweep(street, sweep(SIMULATED, depth=[1.0, 2.0, 4.0]))
    assert shown_points(street) is not second
    hide_points(street, (RECORDED, SIMULATED))
    assert shown_points(street) is None


def test_dropped_beams_are_shown_on_request(logged_street: Any) -> None:
    logged_street.frame_set(5)

    def kinds() -> set[str]:
        return {kind_of(one) for one in imported_objects(logged_street, "POINTS")}

    assert bpy.ops.unisim.show_points(recorded=True, simulated=False) == {"FINISHED"}
    assert kinds() == {RECORDED} and not logged_street.unisim.show_drops
    assert bpy.ops.unisim.show_points(recorded=True, simulated=True, drops=True) == {"FINISHED"}
    assert kinds() == {RECORDED, SIMULATED, *DROPS.values()} and logged_street.unisim.show_drops
    shown = shown_points(logged_street)
    assert shown is not None and "drops agree in 9" in shown.legend.lines[-2]
    by_kind = {one.kind: one for one in shown.sweeps}
    lidar = source_of(logged_street).drive.lidars[by_kind[RECORDED].lidar]
    cells = lidar.model.beams * lidar.model.columns
    assert len(by_kind[SIMULATED].points) + len(by_kind[DROPS[SIMULATED]].points) == cells
    (lidar_object,) = imported_objects(logged_street, "LIDAR")
    lidar_object.location.z += 0.5
    bpy.context.view_layer.update()
    assert bpy.ops.unisim.show_points(recorded=True, simulated=True) == {"FINISHED"}
    shown = shown_points(logged_street)
    assert shown is not None and shown.legend.lines[-1] == "Not compared: the beams are not the recorded ones"
    assert bpy.ops.unisim.show_points(recorded=False, simulated=False) == {"FINISHED"}
    assert not kinds()


def test_recorded_points_beside_are_to_the_vehicles_left(street: Any) -> None:
    street.unisim.recorded_offset_m = 30.0
    street.frame_set(5)
    source = source_of(street)
    left = source.drive.world_from_ego.at(source.drive.time_s[5])[:3, 1]
    for kind in (RECORDED, DROPS[RECORDED]):
        assert np.array(offset(street, kind)) == pytest.approx(30.0 * left, abs=1e-3)
    assert np.array(offset(street, SIMULATED)) == pytest.approx([0.0, 0.0, 0.0])
