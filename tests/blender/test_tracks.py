"""Boxes of a log without boxes: drawn, followed, corrected, merged, split, and saved as the log's actors."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from shutil import copytree, rmtree
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import select

from unisim_blender.bridge.importing.tracks import put_track, track_of, tracks_in
from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.objects.trajectories import trajectory_of
from unisim_blender.bridge.views.points import put_sweep, sweep_of
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray, make_pose, quaternion_from_yaw
from unisim_blender.core.tracks.box_file import Track, default_path, read_boxes
from unisim_blender.core.world.box_tracks import passing_times
from unisim_blender.core.world.drive import Actor, Drive
from unisim_blender.editing.sampled.clock import Clock


@pytest.fixture(scope="module")
def truth(sample_with_log: Path) -> Drive:
    """The street with its boxes."""
    return open_log(sample_with_log.parents[1] / "out" / "street").drive


@pytest.fixture
def bare(scene: Any, sample_with_log: Path, tmp_path: Path) -> Any:
    """A scene with the street's log imported, whose boxes were taken away."""
    log = tmp_path / "bare"
    copytree(sample_with_log.parents[1] / "out" / "street", log)
    rmtree(log / "annotations" / "cuboids")
    assert bpy.ops.unisim.import_log(directory=str(log)) == {"FINISHED"}
    assert not source_of(scene).drive.actors
    return scene


def a_car(truth: Drive, moves: bool) -> Actor:
    """The car with most frames beside the LiDAR."""
    ego = truth.world_from_ego.positions.mean(0)
    cars = [a for a in truth.actors.values() if a.label == "Car" and a.is_moving == moves and a.start_s <= 0.0]
    return min(cars, key=lambda car: float(np.linalg.norm(car.world_from_actor.positions.mean(0) - ego)))


def draw(scene: Any, truth: Drive, car: Actor, frame: int, off: FloatArray, degrees: float) -> Any:
    """Draw a box by hand about a car as a frame's sweep shows it, a little off."""
    lidar = next(iter(truth.lidars.values()))
    at = np.array([lidar.time_s[frame]])
    for _ in range(3):
        at = passing_times(lidar, car.world_from_actor.positions_at(at[0])[None], np.array([lidar.time_s[frame]]))
    pose = car.world_from_actor.at(float(at[0])) @ make_pose(off, quaternion_from_yaw(np.radians(degrees)))
    scene.frame_set(frame)
    assert bpy.ops.unisim.draw_box(label="Car") == {"FINISHED"}
    obj = bpy.context.active_object
    obj.location = pose[:3, 3]
    obj.rotation_quaternion = quaternion_from_yaw(np.arctan2(pose[1, 0], pose[0, 0]))
    obj.scale = np.asarray(car.size_m) / np.array(obj.unisim_track.size_m)
    bpy.context.view_layer.update()
    return obj


def errors(track: Track, car: Actor) -> FloatArray:
    """Distances of a track's keys from a car's trajectory, metres."""
    path = track.actor.world_from_actor
    return np.linalg.norm((path.positions - car.world_from_actor.positions_at(path.times_s))[:, :2], axis=1)


def test_a_drawn_box_is_followed_corrected_and_saved(bare: Any, truth: Drive) -> None:
    moving, parked = a_car(truth, True), a_car(truth, False)
    clock = Clock.of(truth)
    obj = draw(bare, truth, moving, 9, np.array([0.1, -0.1, 0.0]), 3.0)
    assert bpy.ops.unisim.track_this() == {"FINISHED"}
    track = track_of(obj, clock)
    assert track.actor.is_moving and len(track.actor.world_from_actor.times_s) > 10 and trajectory_of(obj) is not None
    assert np.median(errors(track, moving)) < 0.35 and len(track.drawn_s) == 1 and tuple(obj.scale) == (1, 1, 1)
    # a correction at another frame: the box is exactly there then
    bare.frame_set(15)
    obj.location = (0.0, 0.4, 0.0)
    bpy.context.view_layer.update()
    there = np.array(obj.matrix_world.translation)
    assert bpy.ops.unisim.track_this() == {"FINISHED"}
    bpy.context.view_layer.update()
    assert len(track_of(obj, clock).drawn_s) == 2 and tuple(obj.location) == (0, 0, 0)
    assert np.abs(np.array(obj.matrix_world.translation) - there).max() < 1e-3
    standing = draw(bare, truth, parked, 9, np.array([0.1, 0.1, 0.0]), -3.0)
    assert bpy.ops.unisim.track_this() == {"FINISHED"}
    assert not track_of(standing, clock).actor.is_moving
    place = np.array(standing.matrix_world.translation)
    assert np.linalg.norm((place - parked.world_from_actor.positions[0])[:2]) < 0.3
    assert bpy.ops.unisim.save_boxes() == {"FINISHED"}
    path = default_path(Path(bare.unisim.log))
    assert bare.unisim.log == str(path) and not tracks_in(bare)
    saved = read_boxes(path).tracks
    assert sorted(track.actor.is_moving for track in saved) == [False, True] and len(saved[0].drawn_s) == 2
    actors = list(imported_objects(bare, "ACTOR"))
    assert {obj.unisim.uid for obj in actors} == set(source_of(bare).drive.actors) == {"box", "box-2"}
    # and once more: what was not touched is the same to the last bit
    before = path.read_bytes()
    assert bpy.ops.unisim.edit_boxes() == {"FINISHED"}
    assert len(tracks_in(bare)) == 2 and all(obj.hide_get() for obj in actors)
    assert bpy.ops.unisim.save_boxes() == {"FINISHED"}
    assert [t.actor.world_from_actor.content() for t in read_boxes(path).tracks] == [
        t.actor.world_from_actor.content() for t in saved
    ]
    assert path.read_bytes() == before


def boxes_of(scene: Any, truth: Drive, *tracks: Track) -> list[Any]:
    """Boxes of tracks."""
    return [put_track(scene, track, truth) for track in tracks]


def test_boxes_are_merged_split_classed_and_shown_by_certainty(bare: Any, truth: Drive) -> None:
    car = a_car(truth, True)
    clock = Clock.of(truth)
    (obj,) = boxes_of(bare, truth, Track(replace(car, uid="whole"), 0.6, "lidar"))
    select(obj)
    bare.frame_set(8)
    assert bpy.ops.unisim.split_boxes() == {"FINISHED"}
    first, second = tracks_in(bare)
    spans = sorted((track_of(one, clock).actor.start_s, track_of(one, clock).actor.end_s) for one in (first, second))
    assert abs(spans[0][1] - spans[1][0]) < 0.01 and abs(spans[1][0] - truth.time_s[8]) < 1e-3
    select(second)
    assert bpy.ops.unisim.merge_boxes(other=first.unisim.uid) == {"FINISHED"}
    (whole,) = tracks_in(bare)
    track = track_of(whole, clock)
    assert errors(track, car).max() < 1e-3 and track.actor.is_moving and track.certainty == pytest.approx(0.6)
    select(whole)
    assert bpy.ops.unisim.class_boxes(label="Truck") == {"FINISHED"}
    (whole,) = tracks_in(bare)
    assert track_of(whole, clock).actor.label == "Truck" and bpy.context.active_object == whole
    bare.unisim_tracks.certainty = 0.7
    assert whole.hide_get()
    bare.unisim_tracks.certainty = 0.5
    assert not whole.hide_get()
    select(whole)
    assert bpy.ops.unisim.accept_boxes() == {"FINISHED"}
    bare.unisim_tracks.certainty = 1.0
    assert not whole.hide_get()
    assert bpy.ops.unisim.discard_boxes() == {"FINISHED"} and not tracks_in(bare)


def test_doubtful_places_are_stepped_through(bare: Any, truth: Drive) -> None:
    car = a_car(truth, True)
    path = car.world_from_actor
    positions = path.positions.copy()
    late = path.times_s > path.times_s.mean()
    positions[late, 1] += 2.0
    jumps = replace(car, uid="jumps", world_from_actor=replace(path, positions=positions))
    boxes_of(bare, truth, Track(jumps), Track(replace(car, uid="twin")))
    frames, kinds = [], []
    for _ in range(3):
        assert bpy.ops.unisim.next_doubtful() == {"FINISHED"}
        place = json.loads(bare.unisim_tracks.place)
        frames.append(bare.frame_current)
        kinds.append(place["key"][2])
    assert "jump" in kinds and "overlap" in kinds and bpy.context.active_object.unisim.kind == "TRACK"
    assert place["count"] >= 2 and "box" in "".join(place["text"]) + "box"
    at = kinds.index("jump")
    assert abs(truth.time_s[frames[at]] - path.times_s[late][0]) < 0.12


def test_a_doubtful_place_that_was_looked_at_is_gone_also_after_saving(bare: Any, truth: Drive) -> None:
    car = a_car(truth, True)
    boxes_of(bare, truth, Track(replace(car, uid="one")), Track(replace(car, uid="twin")))
    assert bpy.ops.unisim.next_doubtful() == {"FINISHED"}
    shown = json.loads(bare.unisim_tracks.place)
    assert bpy.ops.unisim.dismiss_doubtful() == {"FINISHED"}
    now = json.loads(bare.unisim_tracks.place or "null")
    assert now is None or (now["key"] != shown["key"] and now["count"] == shown["count"] - 1)
    while bare.unisim_tracks.place:
        assert bpy.ops.unisim.dismiss_doubtful() == {"FINISHED"}
    assert bpy.ops.unisim.save_boxes() == {"FINISHED"} and bpy.ops.unisim.edit_boxes() == {"FINISHED"}
    assert bpy.ops.unisim.next_doubtful() == {"FINISHED"} and not bare.unisim_tracks.place
    assert bpy.ops.unisim.discard_boxes() == {"FINISHED"}


def test_points_are_of_the_frame_that_is_shown_after_undo_and_saving(bare: Any, truth: Drive) -> None:
    def shown() -> set[float]:
        return {sweep_of(obj).frame for obj in imported_objects(bpy.context.scene, "POINTS")}

    boxes_of(bare, truth, Track(replace(a_car(truth, False), uid="one")))
    assert bpy.ops.unisim.show_points(recorded=True) == {"FINISHED"}
    obj = next(imported_objects(bare, "POINTS"))
    put_sweep(bare, replace(sweep_of(obj), frame=3))  # as undo brings it
    for handler in [h for h in bpy.app.handlers.undo_post if h.__module__.endswith("features.points.operators")]:
        handler(bare)
    assert shown() == {bare.frame_current}
    put_sweep(bare, replace(sweep_of(next(imported_objects(bare, "POINTS"))), frame=3))
    assert bpy.ops.unisim.save_boxes() == {"FINISHED"}
    assert shown() == {bare.frame_current}


def test_a_copy_made_by_blender_is_another_track(bare: Any, truth: Drive) -> None:
    (obj,) = boxes_of(bare, truth, Track(replace(a_car(truth, False), uid="one")))
    select(obj)
    bpy.ops.object.duplicate()
    bpy.context.active_object.location.x += 8.0
    bpy.context.view_layer.update()
    assert bpy.ops.unisim.save_boxes() == {"FINISHED"}
    actors = source_of(bare).drive.actors
    assert len(actors) == 2 and "one" in actors
