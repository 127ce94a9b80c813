"""An object's motion beside the recorded one of its id, and its trajectory as lines, from plain data."""

from __future__ import annotations

import numpy as np
import pytest
from imported_scene import beside, driving

from unisim_blender.core.geometry import FloatArray, box_corners
from unisim_blender.core.sensors.silhouettes import BOX_EDGES as EDGES
from unisim_blender.editing.layout.speed_graph import EDITED, OVER, RECORDED, curves, moment, values
from unisim_blender.editing.layout.trails import (
    FAST,
    SLOW,
    TrailSegments,
    joined,
    own_lines,
    recorded_lines,
    speed_colours,
)
from unisim_blender.editing.layout.trails import RECORDED as GREY
from unisim_blender.editing.motion.kinematics import (
    EGO_LABEL,
    MOST,
    Limits,
    ObjectTrack,
    cached_comparison,
    compared,
    label_of,
    recorded_track,
)
from unisim_blender.editing.sampled.clock import Clock, recorded_poses, recorded_there
from unisim_blender.editing.sampled.source import DriveSource


def track_of(source: DriveSource, uid: str) -> ObjectTrack:
    """An actor's recorded motion as a track."""
    actor, clock = source.drive.actors[uid], Clock.of(source.drive)
    return ObjectTrack(
        uid, "ACTOR", uid, actor.label, recorded_poses(actor, clock), recorded_there(actor, source.drive, clock)
    )


def test_what_was_recorded_is_neither_edited_nor_beyond_limits(source: DriveSource) -> None:
    clock = Clock.of(source.drive)
    strict = Limits(acceleration_m_s2=1e-3, lateral_m_s2=1e-3, curvature_1_m=1e-6)
    for uid in source.drive.actors:
        found = compared(track_of(source, uid), source.drive, clock, strict)
        assert not found.is_edited and not any(where.any() for where in found.exceeded.values())
    ego = ObjectTrack(
        "Ego", "EGO", "ego", EGO_LABEL, source.drive.world_from_ego.at(clock.times_s), np.ones(len(clock.frames), bool)
    )
    assert not compared(ego, source.drive, clock, strict).is_edited


def test_an_edit_is_compared_with_what_was_recorded(source: DriveSource) -> None:
    clock, uid = Clock.of(source.drive), driving(source.drive).uid
    before = track_of(source, uid)
    poses = before.poses.copy()
    poses[:, :3, 3] += 2.0 * clock.times_s[:, None] * poses[:, :3, 0]
    found = compared(ObjectTrack(uid, "ACTOR", uid, "Car", poses, before.there), source.drive, clock, Limits())
    assert found.is_edited and found.recorded is not None
    assert found.now.speed_m_s - found.recorded.speed_m_s == pytest.approx(np.full(len(poses), 2.0), abs=0.1)
    swerve = before.poses.copy()
    swerve[:, :3, 3] += 1.5 * np.sin(np.linspace(0, 3 * np.pi, len(poses)))[:, None] * poses[:, :3, 1]
    wild = compared(ObjectTrack(uid, "ACTOR", uid, "Car", swerve, before.there), source.drive, clock, Limits())
    walking = compared(
        ObjectTrack(uid, "ACTOR", uid, "Pedestrian", swerve, before.there), source.drive, clock, Limits()
    )
    assert any(where.any() for where in wild.exceeded.values())
    assert walking.is_edited and not any(where.any() for where in walking.exceeded.values()), "no vehicle"
    new = compared(ObjectTrack("new", "ACTOR", "new", "Car", swerve, before.there), source.drive, clock, Limits())
    assert new.is_edited and new.recorded is None and recorded_track(ObjectTrack("new", "ACTOR", "", "", swerve,
    before.there),
        source.drive, clock) is None  # fmt: skip


def test_the_graph_shows_both_and_marks_limits(source: DriveSource) -> None:
    clock, uid = Clock.of(source.drive), driving(source.drive).uid
    before = track_of(source, uid)
    swerve = before.poses.copy()
    swerve[:, :3, 3] += 1.5 * np.sin(np.linspace(0, 3 * np.pi, len(swerve)))[:, None] * swerve[:, :3, 1]
    wild = compared(ObjectTrack(uid, "ACTOR", uid, "Car", swerve, before.there), source.drive, clock, Limits())
    assert {RECORDED, OVER} <= set(curves(wild).colours)
    faster = before.poses.copy()
    faster[:, :3, 3] += 2.0 * clock.times_s[:, None] * faster[:, :3, 0]
    plain = set(
        curves(
            compared(ObjectTrack(uid, "ACTOR", uid, "Car", faster, before.there), source.drive, clock, Limits())
        ).colours
    )
    assert {RECORDED, EDITED} <= plain and OVER not in plain
    assert len(moment(wild, 5.0).corners) % 3 == 0 and any("km/h" in text for text, _ in values(wild, 5.0))


def test_a_comparison_is_kept_until_the_motion_changes(source: DriveSource) -> None:
    clock, tracks = Clock.of(source.drive), [track_of(source, uid) for uid in sorted(source.drive.actors)]
    first = cached_comparison(tracks[0], source.drive, clock, Limits())
    assert cached_comparison(track_of(source, tracks[0].uid), source.drive, clock, Limits()) is first
    assert cached_comparison(tracks[0], source.drive, clock, Limits(lateral_m_s2=1.0)) is not first
    again = cached_comparison(tracks[0], source.drive, clock, Limits())
    for track in tracks[1 : MOST + 1]:
        cached_comparison(track, source.drive, clock, Limits())
    assert cached_comparison(tracks[0], source.drive, clock, Limits()) is not again, "older ones are forgotten"


def test_classes(source: DriveSource) -> None:
    assert label_of("EGO", "", "", "", source.drive) == EGO_LABEL
    assert (
        label_of("ACTOR", "cone-1", "", "", source.drive) == "Cones"
        and label_of("ACTOR", "cone-1", "", "Van", source.drive) == "Van"
    )
    assert label_of("ACTOR", "nobody", "", "", source.drive) == ""


def line(speed_m_s: float, seconds: float = 2.5) -> tuple[FloatArray, Clock]:
    """Poses along x at a constant speed, ten a second."""
    times = np.arange(0, seconds, 0.1)
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, 0, 3] = speed_m_s * times
    return poses, Clock(np.arange(len(times), dtype=float), times)


def test_colours_of_speeds() -> None:
    for speed, colour in ((0.0, SLOW), (7.5, (SLOW + FAST) / 2), (15.0, FAST), (40.0, FAST)):
        assert speed_colours(*line(speed)) == pytest.approx(np.tile(colour, (25, 1)))


def test_a_trail_joins_frames_with_ticks_at_whole_seconds() -> None:
    poses, clock = line(4.0)
    there = np.ones(25, bool)
    found = own_lines(poses, there, clock)
    assert found.points.shape == (2 * 24 + 2 * 3, 3) and found.colours.shape == (len(found.points), 4)
    assert found.points[1] == pytest.approx(poses[1, :3, 3]) and found.points[2] == pytest.approx(poses[1, :3, 3])
    ticks = found.points[48:].reshape(3, 2, 3)
    assert ticks.mean(1)[:, 0] == pytest.approx([0.0, 4.0, 8.0]) and (found.colours[48:] == 1).all()
    there[:15] = False
    late = own_lines(poses, there, clock)
    assert late.points[:, 0].min() == pytest.approx(poses[15, 0, 3]) and len(late.points) == 2 * 9 + 2
    for nothing in (own_lines(None, there, clock), own_lines(poses, np.zeros(25, bool), clock), joined([])):
        assert nothing.points.shape == (0, 3) and nothing.colours.shape == (0, 4)


def test_what_was_recorded_is_grey_with_the_box_there() -> None:
    poses, _ = line(4.0)
    size = np.array([4.0, 2.0, 1.5])
    found = recorded_lines(poses, 7, size)
    assert (found.colours == GREY).all() and len(found.points) == 2 * 24 + 2 * len(EDGES)
    box = found.points[48:]
    assert np.unique(box.round(6), axis=0) == pytest.approx(np.unique(box_corners(poses[7], size).round(6), axis=0))
    lengths = np.linalg.norm(np.diff(box.reshape(-1, 2, 3), axis=1), axis=-1)
    assert sorted(lengths.ravel().round(6)) == [1.5] * 4 + [2.0] * 4 + [4.0] * 4, "the box's twelve edges"
    assert len(recorded_lines(poses, 7, None).points) == 48
    both = joined([TrailSegments(box, found.colours[48:]), found])
    assert len(both.points) == len(box) + len(found.points)
    assert beside(poses, left=1.0)[0, 1, 3] == 1.0
