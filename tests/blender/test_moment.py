"""The scene about one frame: as stepping would find it, and the regions of an image that an edit changes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import drawn, driving, imported

from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.objects.trajectories import trajectory_of
from unisim_blender.bridge.sampling.adjacent_frames import lacking, sample_now, step_beside, with_lengths
from unisim_blender.bridge.sampling.stepping import preserve_frame, sample, sample_all
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.worker.server import Jobs
from unisim_blender.core.world.drive import Camera
from unisim_blender.core.world.encoding import decode_sensor
from unisim_blender.editing.reading.requests import HERE, _walked_on, camera_request, edited_drive
from unisim_blender.editing.reading.scenario import read_scenario
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import same


def both(scene: Any, frame: float) -> tuple[Any, Any]:
    """What is sampled at a frame, without leaving it and by stepping."""
    clock = Clock.of(source_of(scene).drive).around(frame)
    scene.frame_set(int(frame), subframe=frame - int(frame))
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert step_beside(scene, clock, lacking(scene, clock))
    now = sample_now(scene, depsgraph, clock)
    with preserve_frame(scene):
        stepped = sample(scene, depsgraph, clock, scene.frame_set)
    return now, stepped


@pytest.mark.parametrize("frame", [0, 7, 19])
def test_the_moment_is_what_stepping_finds(street: Any, frame: int) -> None:
    empty = bpy.data.objects.new("parent", None)
    street.collection.objects.link(empty)
    child = next(o for o in street.objects if o.unisim.kind == "ACTOR" and trajectory_of(o) is not None)
    above_of(child).parent = empty
    empty.location = (1.0, 2.0, 0.0)
    now, stepped = both(street, frame)
    assert [t.name for t in now.objects] == [t.name for t in stepped.objects]
    for a, b in zip(now.objects, stepped.objects, strict=True):
        assert same(a.poses, b.poses).all(), a.name
        assert (a.there == b.there).all(), a.name


@pytest.mark.parametrize("edit", ["none", "turned"])
def test_limbs_have_the_phase_of_the_export(street: Any, edit: str) -> None:
    """It follows the length of the whole path, of which the moment has a few frames."""
    box = driving(street)
    if edit == "turned":
        empty = bpy.data.objects.new("parent", None)
        street.collection.objects.link(empty)
        above_of(box).parent = empty
        for frame, y in ((0, 0.0), (19, 9.0)):
            empty.location = (0.0, y, 0.0)
            empty.keyframe_insert("location", frame=frame)
    source, uid = source_of(street), box.unisim.uid
    actors = source.drive.actors
    walker = replace(actors[uid], label="Pedestrian")
    source = replace(source, drive=replace(source.drive, actors={**actors, uid: walker}))
    now, _ = both(street, 12)
    now = with_lengths(now, street, source.drive)
    edited = _walked_on(edited_drive(read_scenario(now, source, HERE), source), now).actors[uid].world_from_actor
    all_frames = sample_all(street, Clock.of(source.drive))
    whole = edited_drive(read_scenario(all_frames, source, HERE), source).actors[uid].world_from_actor
    times = np.linspace(now.clock.times_s[0], now.clock.times_s[-1], 9)
    assert whole.walked_at(times).min() > 3.0 and (len(edited.times_s) < len(whole.times_s)) == (edit == "turned")
    np.testing.assert_allclose(edited.walked_at(times), whole.walked_at(times), atol=5e-3)


def above_of(one: Any) -> Any:
    """The trajectory that a box rides on."""
    above = trajectory_of(one)
    assert above is not None
    return above


def standing(scene: Any) -> Any:
    """A box that stands still."""
    drive = source_of(scene).drive
    return imported(scene, "ACTOR", next(u for u, a in sorted(drive.actors.items()) if not a.is_moving))


def moving_empty(scene: Any) -> Any:
    """An empty that moves and turns."""
    empty = bpy.data.objects.new("empty", None)
    scene.collection.objects.link(empty)
    for frame, place, turn in ((0, (0.0, 0.0, 0.0), 0.0), (20, (30.0, 8.0, 1.0), 1.2)):
        empty.location, empty.rotation_euler.z = place, turn
        empty.keyframe_insert("location", frame=frame)
        empty.keyframe_insert("rotation_euler", frame=frame)
    return empty


def by_nla(scene: Any) -> Any:
    one = driving(scene)
    data = above_of(one).animation_data
    action, slot = data.action, getattr(data, "action_slot", None)
    strip = data.nla_tracks.new().strips.new("slow", 2, action)
    if slot is not None:
        strip.action_slot = slot
    data.action = None
    strip.scale = 1.7
    return one


def by_parent(scene: Any) -> Any:
    one = standing(scene)
    one.parent = moving_empty(scene)
    return one


def by_parent_in_nla(scene: Any) -> Any:
    one = standing(scene)
    one.parent = by_nla(scene)
    return one


def by_parent_with_scale(scene: Any) -> Any:
    one = by_parent(scene)
    one.parent.scale = (2.0, 2.0, 2.0)
    return one


def by_copied_transforms(scene: Any) -> Any:
    one = standing(scene)
    one.constraints.new("COPY_TRANSFORMS").target = moving_empty(scene)
    return one


def by_child_of(scene: Any) -> Any:
    one = standing(scene)
    one.constraints.new("CHILD_OF").target = moving_empty(scene)
    return one


def by_driver(scene: Any) -> Any:
    one = standing(scene)
    one.driver_add("location", 0).driver.expression = "0.3 * frame ** 1.5"
    return one


def by_path(scene: Any) -> Any:
    line = drawn(scene, [(0, 0, 0), (30, 0, 0), (30, 20, 0)])
    line.data.use_path, line.data.path_duration = True, 20
    one = standing(scene)
    follow = one.constraints.new("FOLLOW_PATH")
    follow.target, follow.use_curve_follow = line, True
    line.data.eval_time = 0
    line.data.keyframe_insert("eval_time", frame=0)
    line.data.eval_time = 20
    line.data.keyframe_insert("eval_time", frame=20)
    return one


def late_in_nla(scene: Any) -> Any:
    """A box that appears while it is looked at, its keys in the NLA."""
    one = driving(scene)
    one.hide_viewport = True
    one.keyframe_insert("hide_viewport", frame=0)
    one.hide_viewport = False
    one.keyframe_insert("hide_viewport", frame=4)
    return by_nla(scene)


CHANGES = (
    by_nla, by_parent, by_parent_in_nla, by_parent_with_scale, by_copied_transforms, by_child_of, by_driver, by_path,
    late_in_nla,
)  # fmt: skip


@pytest.mark.parametrize("frame", [9, 9.4])
@pytest.mark.parametrize("change", CHANGES)
def test_whatever_moves_a_thing_the_moment_is_what_stepping_finds(street: Any, change: Any, frame: float) -> None:
    one = change(street)
    now, stepped = both(street, frame)
    for a, b in zip(now.objects, stepped.objects, strict=True):
        assert (a.there == b.there).all(), a.name
        assert same(a.poses[a.there], b.poses[b.there]).all(), a.name
    (moved,) = [t for t in now.objects if t.name == one.name]
    assert np.abs(np.diff(moved.poses[moved.there][:, :3, 3], axis=0)).max() > 0.1  # it does move


def test_looking_beside_leaves_everything_as_it_is(street: Any) -> None:
    one = by_nla(street)
    street.frame_set(9)
    one.location.y += 2.0  # a change without a key
    bpy.context.view_layer.update()
    before = [(o.name, o.matrix_world.copy(), o.location.copy(), o.users) for o in street.objects]
    called: list[str] = []

    def frame_changed(scene: Any, depsgraph: Any = None) -> None:
        called.append(scene.name)

    bpy.app.handlers.frame_change_post.append(frame_changed)
    try:
        clock = Clock.of(source_of(street).drive).around(9)
        assert [o.name for o in lacking(street, clock)] == [one.name]
        step_beside(street, clock, lacking(street, clock))
    finally:
        bpy.app.handlers.frame_change_post.remove(frame_changed)
    assert street.name not in called and list(bpy.data.scenes) == [street]
    for name, matrix, location, users in before:
        now = street.objects[name]
        assert (now.matrix_world, now.location, now.users) == (matrix, location, users), name
    bpy.context.view_layer.update()
    assert street.frame_current == 9 and not lacking(street, clock)
    for name, matrix, location, _ in before:
        assert (street.objects[name].matrix_world, street.objects[name].location) == (matrix, location), name
    (moved,) = [
        t for t in sample_now(street, bpy.context.evaluated_depsgraph_get(), clock).objects if t.name == one.name
    ]
    at = list(clock.frames).index(9)
    assert moved.poses[at, :3, 3] == pytest.approx(np.array(one.matrix_world.translation), abs=1e-5)


@pytest.mark.parametrize("edit", ["scale", "start", "influence", "target"])
def test_an_edit_that_is_not_seen_now_counts_all_the_same(street: Any, edit: str) -> None:
    one, empty = by_nla(street), moving_empty(street)
    other = by_copied_transforms(street)
    both(street, 9)
    clock = Clock.of(source_of(street).drive).around(9)
    strip = above_of(one).animation_data.nla_tracks[0].strips[0]
    if edit == "scale":
        strip.scale = 0.6
    elif edit == "start":
        strip.frame_start += 3
    elif edit == "influence":
        other.constraints[0].influence = 0.5
    else:
        other.constraints[0].target = empty
    bpy.context.view_layer.update()
    assert lacking(street, clock)
    now, stepped = both(street, 9)
    for a, b in zip(now.objects, stepped.objects, strict=True):
        assert same(a.poses, b.poses).all(), a.name


@pytest.mark.parametrize("edit", ["move", "remove", "scale"])
def test_the_worker_renders_again_what_an_edit_changes(street: Any, tmp_path: Path, edit: str) -> None:
    """Laid over the image before, that is the image after, to the bit."""
    frame = 9
    street.frame_set(frame)
    before, _ = both(street, frame)
    drive = source_of(street).drive
    camera = np.array(street.camera.matrix_world.translation)
    nearby = [
        a for a in drive.actors.values() if not a.is_moving and 8 < a.world_from_actor.positions[0, 0] - camera[0] < 30
    ]
    one = imported(street, "ACTOR", nearby[0].uid)
    if edit == "move":
        one.location.y += 1.0
    elif edit == "remove":
        one.hide_render = True
    else:
        one.scale = (1.2, 1.2, 1.2)
    bpy.context.view_layer.update()
    after, _ = both(street, frame)
    view = next(t for t in after.objects if t.name == street.camera.name)
    jobs, source, size = Jobs(tmp_path), source_of(street), (480, 270)
    old, new = (camera_request(state, view, source, frame, size).values for state in (before, after))
    jobs_by_number = [
        {**values, "id": number, "update": {"job": job, "unfinished": []}}
        for number, (values, job) in enumerate(((old, None), (new, 0), (new, 1)))
    ]
    regions = [next(jobs.camera(request))["regions"] for request in jobs_by_number]
    assert regions[0] == [(0, 0, *size)] and regions[2] == []
    assert 0 < sum(region.area for region in regions[1]) < size[0] * size[1] / 2
    assert np.array_equal(shown(jobs, jobs_by_number[:2]), shown(jobs, [new]))
    assert not np.array_equal(shown(jobs, [old]), shown(jobs, [new]))
    # what had not come of the image before, an image that is not known, and another size
    rest = {**jobs_by_number[1], "update": {"job": 0, "unfinished": [(0, 0, 5, 5)]}}
    assert next(jobs.camera(rest))["regions"][-1] == (0, 0, 5, 5) or len(regions[1]) == 1
    for request in ({**rest, "update": {"job": 77, "unfinished": []}}, {**rest, "quality": "fast"}):
        assert next(jobs.camera(request))["regions"] == [(0, 0, *size)]


def shown(jobs: Jobs, requests: list[dict[str, Any]]) -> FloatArray:
    """The colours of what is asked for, one laid over the other."""
    camera = decode_sensor(requests[0]["sensor"])
    assert isinstance(camera, Camera)
    whole = np.full((camera.model.height, camera.model.width, 3), np.nan)
    for event in (event for request in requests for event in jobs.camera(request)):
        if event["event"] != "arrays":
            continue
        (top, bottom), (left, right) = event["rows"], event["columns"]
        place = event["arrays"]["rgb"]
        data = (jobs.folder / event["file"]).read_bytes()
        rgb = np.frombuffer(data, place["dtype"], (bottom - top) * (right - left) * 3, place["offset"])
        whole[top:bottom, left:right] = rgb.reshape(bottom - top, right - left, 3)
    assert np.isfinite(whole).all()
    return whole
