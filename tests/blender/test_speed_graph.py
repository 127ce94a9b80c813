"""The speed graph: what it compares, that it agrees with Check Edits, what it draws, and when it is computed again."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
import pytest
from helpers import driving_car, select

from unisim_blender.bridge.changes.handles import TransformSnapshot
from unisim_blender.bridge.changes.motion import displaced_along
from unisim_blender.bridge.objects.animation import curves_of
from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.objects.trajectories import trajectory_of
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.bridge.views import trails
from unisim_blender.editing.layout.shapes import OverlayShapes
from unisim_blender.editing.layout.speed_graph import (
    EDITED,
    NOW,
    OVER,
    RECORDED,
    axes_of,
    curves,
    grip,
    moment,
    on_curve,
    values,
)
from unisim_blender.editing.motion import kinematics as comparison
from unisim_blender.editing.motion.kinematics import Limits, MotionComparison, ObjectTrack, compared
from unisim_blender.editing.motion.plausibility import warnings_of
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.texts import kmh
from unisim_blender.features.motion.properties import graph_of, limits_of


def graph() -> MotionComparison:
    """The graph of the active object."""
    found = graph_of(bpy.context)
    assert found is not None
    return found


def swerve(one: Any, left_m: float) -> None:
    """Displace an actor to the left within half a second."""
    for frame, left in ((5, 0.0), (10, left_m)):
        bpy.context.scene.frame_set(frame)
        one.location = (0.0, left, 0.0)
        one.keyframe_insert("location", frame=frame)


def colours(shapes: OverlayShapes) -> set[tuple[float, ...]]:
    """The colours of all triangles."""
    return set(shapes.colours)


def test_recorded_speeds_are_the_logs(street: Any) -> None:
    one = driving_car(street)
    found, drive = graph(), source_of(street).drive
    assert not found.is_edited and not found.anywhere.any()
    trajectory = drive.actors[one.unisim.uid].world_from_actor
    times = np.array(sorted(drive.time_s.values()))
    before, after = trajectory.at(times[9] - 0.1), trajectory.at(times[9] + 0.1)
    assert found.now.speed_m_s[9] == pytest.approx(np.linalg.norm((after - before)[:3, 3]) / 0.2, rel=0.02)
    assert found.recorded is not None and found.recorded.speed_m_s == pytest.approx(found.now.speed_m_s, abs=0.01)
    assert RECORDED in colours(curves(found)) and EDITED not in colours(curves(found))


def test_what_drives_faster(street: Any) -> None:
    one = driving_car(street)
    before = graph().now.speed_m_s
    street.frame_set(0)
    bpy.ops.unisim.retime_actor(mode="SPEED", speed=1.2, braking="CUSTOM", deceleration_m_s2=1e3)
    found = graph()
    assert found.is_edited and found.recorded is not None
    assert found.now.speed_m_s[3:10] == pytest.approx(1.2 * before[3:10], rel=0.06)
    assert found.recorded.speed_m_s == pytest.approx(before, abs=0.01)
    assert {RECORDED, EDITED} <= colours(curves(found)) and one.name == found.name


def test_a_swerve_is_marked_and_checked_alike(street: Any) -> None:
    one = driving_car(street)
    swerve(one, 3.0)
    found, drive = graph(), source_of(street).drive
    assert found.exceeded["lateral_m_s2"].any() and OVER in colours(curves(found))
    clock = Clock.of(drive)
    warned = [w for w in warnings_of(sample_all(street, clock), drive, limits_of(street)) if w.name == one.name]
    (lateral,) = [w for w in warned if "corners" in w.text]
    at = int(np.flatnonzero(clock.frames == lateral.frame)[0])
    assert found.exceeded["lateral_m_s2"][at]
    assert f"{abs(found.now.lateral_m_s2[at]):.1f} m/s²" in lateral.text
    assert ("accelerates" in str(warned) or "brakes" in str(warned)) == found.exceeded["acceleration_m_s2"].any()


def test_limits_are_properties_that_both_heed(street: Any) -> None:
    one = driving_car(street)
    swerve(one, 3.0)
    limits = street.unisim_motion
    limits.lateral_m_s2, limits.acceleration_m_s2, limits.curvature_1_m = 50.0, 50.0, 5.0
    assert not graph().anywhere.any()
    assert bpy.ops.unisim.check() == {"FINISHED"}
    texts = [w.text for w in bpy.context.scene.unisim_check.warnings if w.name == one.name]
    assert not [text for text in texts if "m/s²" in text or "radius" in text]
    limits.lateral_m_s2 = 1.0
    assert bpy.ops.unisim.check() == {"FINISHED"}
    texts = [w.text for w in bpy.context.scene.unisim_check.warnings if w.name == one.name]
    assert [text for text in texts if "corners" in text]


def test_defaults_are_exactly_those_of_the_functions(street: Any) -> None:
    assert limits_of(street) == Limits()


def test_pedestrians_have_no_such_limits(street: Any) -> None:
    drive = source_of(street).drive
    one = driving_car(street)
    swerve(one, 3.0)
    clock = Clock.of(drive)
    track = trails.track_of(one, drive, clock)
    walking = ObjectTrack(track.name, track.kind, track.uid, "Pedestrian", track.poses, track.there)
    assert compared(track, drive, clock, Limits()).anywhere.any()
    assert not compared(walking, drive, clock, Limits()).anywhere.any()


def test_the_ego_vehicle_too(street: Any) -> None:
    ego = next(imported_objects(street, "EGO"))
    select(ego)
    assert not graph().is_edited
    swerve(ego, 3.0)
    assert graph().exceeded["lateral_m_s2"].any()
    drive = source_of(street).drive
    found = warnings_of(sample_all(street, Clock.of(drive)), drive)
    assert [w for w in found if w.name == ego.name and "corners" in w.text]


def test_it_is_computed_again_only_when_the_motion_changes(street: Any, monkeypatch: Any) -> None:
    one = driving_car(street)
    first = graph()
    computed = []
    real = comparison.compared

    def counted(*given: Any) -> MotionComparison:
        computed.append(1)
        return real(*given)

    monkeypatch.setattr(comparison, "compared", counted)
    street.frame_set(7)
    assert graph() is first and not computed
    displaced_along(one, (0.0, 1.0, 0.0))
    assert graph() is not first and computed == [1]
    street.unisim_motion.lateral_m_s2 = 2.0
    graph()
    assert computed == [1, 1]


@pytest.mark.parametrize("mode", ["DELAY", "STOP", "STRETCH"])
def test_it_is_of_the_motion_that_is_exported(street: Any, mode: str) -> None:
    one, drive = driving_car(street), source_of(street).drive
    street.frame_set(6)
    bpy.ops.unisim.retime_actor(mode=mode, seconds=0.5, speed=0.5, first_s=0.3, last_s=0.9)
    bpy.ops.unisim.drag_trajectory(time_s=1.0, offset_m=(0.0, 2.0, 0.0))
    clock = Clock.of(drive)
    (stepped,) = [t for t in sample_all(street, clock).of("ACTOR") if t.name == one.name]
    track = trails.track_of(one, drive, clock)
    assert (track.there == stepped.there).all()
    assert np.abs(track.poses - stepped.poses)[track.there].max() < 2e-3


def test_nothing_without_an_actor(street: Any) -> None:
    select(street.camera)
    assert graph_of(bpy.context) is None


def test_the_line_and_the_values_are_those_of_the_frame(street: Any) -> None:
    one = driving_car(street)
    found = graph()
    shapes, axes = moment(found, 7.0), axes_of(found)
    assert NOW in colours(shapes)
    columns = np.array(shapes.corners)[:, 0]
    assert columns.mean() == pytest.approx(float(axes.x(found.now.times_s[7])), abs=0.1)
    texts = [text for text, _ in values(found, 7.0)]
    assert texts[0] == f"{found.now.times_s[7]:.2f} s (frame 7)" and texts[1] == kmh(float(found.now.speed_m_s[7]))
    assert [text for text, _ in values(found, 22.0)] == ["2.20 s (frame 22)", "outside the drive"]
    swerve(one, 3.0)
    found = graph()
    at = float(found.frames[int(np.argmax(found.exceeded["lateral_m_s2"]))])
    assert any(over for _, over in values(found, at))


def test_an_inserted_actor_has_no_recorded_motion(street: Any) -> None:
    """Though one of the drive has its appearance, and its id."""
    uid = driving_car(street).unisim.uid
    assert bpy.ops.unisim.insert_actor(actor=uid) == {"FINISHED"}
    found = graph()
    assert found.recorded is None and found.is_edited


def test_absence_is_said(street: Any) -> None:
    one = driving_car(street)
    bpy.ops.unisim.shift_actor(left_m=0.0, ahead_m=0.0, later_s=1.0)
    drive = source_of(street).drive
    one.hide_viewport = True
    one.keyframe_insert("hide_viewport", frame=0)
    found = trails.compared_now(one, drive, Clock.of(drive), Limits())
    assert ("not present", False) in values(found, 0.0)


def test_a_dragged_speed_changes_the_motion_and_not_the_path(street: Any) -> None:
    one = driving_car(street)
    before, start = graph().now.speed_m_s, places(one)
    assert bpy.ops.unisim.drag_speed(time_s=0.9, speed_m_s=9.0, reach_s=0.8) == {"FINISHED"}
    now, times = graph().now, graph().now.times_s
    assert np.interp(0.9, times, now.speed_m_s) == pytest.approx(9.0, abs=0.2)
    assert now.speed_m_s[-2:] == pytest.approx(before[-2:], abs=0.3) and places(one)[0] == pytest.approx(start[0])
    away = np.linalg.norm(places(one)[:, None] - start[None], axis=-1).min(1)
    steps = np.linalg.norm(np.diff(start, axis=0), axis=1)
    assert away.max() < steps.max() / 2 + 0.01, "between places where it was"
    gone = np.linalg.norm(places(one)[-1] - places(one)[0]) - np.linalg.norm(start[-1] - start[0])
    assert gone == pytest.approx((9.0 - np.interp(0.9, times, before)) * 0.8, abs=0.1), "the integral of the speed"


def places(one: Any) -> Any:
    """Places (N, 3) of an object at the log's frames."""
    poses = trails.trajectory_poses(one, Clock.of(source_of(bpy.context.scene).drive))
    assert poses is not None
    return poses[:, :3, 3]


def test_what_was_dragged_is_put_back_whole(street: Any) -> None:
    one = driving_car(street)
    one.hide_viewport = True
    one.keyframe_insert("hide_viewport", frame=15)
    start, subjects = places(one), [one, trajectory_of(one)]
    snapshots = [TransformSnapshot.of(obj) for obj in subjects]
    bpy.ops.unisim.drag_speed(time_s=0.9, speed_m_s=2.0)
    assert np.abs(places(one) - start).max() > 0.5 and presence(one) != [15.0]
    for obj, snapshot in zip(subjects, snapshots, strict=True):
        snapshot.restore(obj)
    assert places(one) == pytest.approx(start, abs=1e-6) and presence(one) == [15.0]


def presence(one: Any) -> list[float]:
    """Frames of the keys that say when an object is there."""
    return [
        key.co[0] for curve in curves_of(one) if curve.data_path == "hide_viewport" for key in curve.keyframe_points
    ]


def test_the_curve_is_under_the_mouse_where_it_is_drawn(street: Any) -> None:
    driving_car(street)
    found, axes = graph(), axes_of(graph())
    x, y = float(axes.x(np.array(1.0))), float(axes.y(np.array(np.interp(1.0, found.now.times_s, found.now.speed_m_s))))
    assert on_curve(found, x, y + 3, 4.0) == pytest.approx(1.0) and on_curve(found, x, y + 9, 4.0) is None
    assert on_curve(found, float(axes.x(np.array(-0.5))), y, 1e3) is None, "beside the axes"
    assert axes.speed_m_s(float(axes.y(np.array(3.0)) - axes.y(np.array(1.0)))) == pytest.approx(2.0)
    held = grip(found, 1.0, 0.5, 6.0, 30.0)
    assert OVER in colours(held) and any("km/h" in text for text, *_ in held.texts)
    top = max(corner[1] for corner in held.corners)
    assert top <= 214, "within the graph"
