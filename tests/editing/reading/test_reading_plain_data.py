"""A sampled scene read as a scenario, from plain data: each kind of edit, and that the scenario is where
the objects are."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from imported_scene import (
    added,
    beside,
    changed,
    displaced,
    driving,
    imported,
    one_of,
    sampled_object,
    standing,
    without,
)

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.geometry import FloatArray, invert_pose
from unisim_blender.core.scenario import apply_scenario
from unisim_blender.core.scenario.edits import (
    CopyStatic,
    Duplicate,
    EgoBody,
    Insert,
    InsertMesh,
    Move,
    Remove,
    RemoveStatic,
    Scale,
    Swap,
)
from unisim_blender.core.scenario.types import Scenario
from unisim_blender.editing.edits.reader import ReadContext
from unisim_blender.editing.readers.actors import original
from unisim_blender.editing.readers.ego import shift_keys
from unisim_blender.editing.reading.scenario import edited_ids, read_scenario
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import CHANGING, MIRRORED, SHEARED, Sampled, Scaling, same
from unisim_blender.editing.sampled.source import DriveSource, scene_actors
from unisim_blender.editing.sensors.names import safe_name, sensor_name

PATH = Path("/tmp/drive/scenario.json")


def read(sampled: Sampled, source: DriveSource) -> Scenario:
    """The scenario that a sampled scene stands for."""
    return read_scenario(sampled, source, PATH)


def agrees(sampled: Sampled, source: DriveSource, *names: str) -> None:
    """The edited drive has actors where the sampled scene has the objects of these names."""
    drive, clock = apply_scenario(read(sampled, source), source.drive, scene_actors), sampled.clock
    for name in names:
        one, actor = one_of(sampled, name), drive.actors[name]
        times = clock.times_s if actor.is_moving else np.zeros(len(clock.times_s))
        assert same(actor.world_from_actor.at(times)[one.there], one.poses[one.there]).all(), name
        assert (actor.present(clock.times_s) == one.there).all(), name


def test_an_import_is_no_edit(source: DriveSource) -> None:
    sampled = imported(source.drive)
    scenario = read(sampled, source)
    assert scenario.edits == () and scenario.sensors is None and scenario.boxes is None
    assert scenario.scene is not None and not Path(scenario.scene).is_absolute()
    assert edited_ids(sampled, source.drive) == set()


def test_less_than_a_tenth_of_a_millimetre_is_no_edit(source: DriveSource) -> None:
    uid = driving(source.drive).uid
    sampled = imported(source.drive)
    near = changed(sampled, uid, poses=displaced(one_of(sampled, uid).poses, x=5e-5))
    far = changed(sampled, uid, poses=displaced(one_of(sampled, uid).poses, x=5e-3))
    assert not read(near, source).edits and edited_ids(far, source.drive) == {uid}


def test_what_stands_is_moved_to_a_pose(source: DriveSource) -> None:
    uid = standing(source.drive).uid
    sampled = imported(source.drive)
    sampled = changed(sampled, uid, poses=displaced(one_of(sampled, uid).poses, x=2.5))
    (edit,) = read(sampled, source).edits
    assert isinstance(edit, Move) and edit.actor == uid and edit.pose is not None and edit.trajectory is None
    agrees(sampled, source, uid)


def test_what_drives_is_moved_along_a_trajectory(source: DriveSource) -> None:
    uid = driving(source.drive).uid
    sampled = imported(source.drive)
    poses = one_of(sampled, uid).poses.copy()
    poses[12:, 1, 3] += 1.5
    sampled = changed(sampled, uid, poses=poses)
    (edit,) = read(sampled, source).edits
    assert isinstance(edit, Move) and edit.trajectory is not None
    agrees(sampled, source, uid)
    recorded, now = (
        source.drive.actors[uid],
        apply_scenario(read(sampled, source), source.drive, scene_actors).actors[uid],
    )
    early = float(sampled.clock.times_s[0]) + 0.05  # between two frames before the change the recorded motion stays
    assert np.abs(now.world_from_actor.at(early) - recorded.world_from_actor.at(early)).max() < 1e-6


def test_a_span_of_presence(source: DriveSource) -> None:
    uid = driving(source.drive).uid
    sampled = imported(source.drive)
    there = np.zeros(len(sampled.clock.frames), bool)
    there[4:11] = True
    sampled = changed(sampled, uid, there=there)
    (edit,) = read(sampled, source).edits
    assert isinstance(edit, Move) and edit.present is not None
    assert (edit.present.start_s, edit.present.end_s) == pytest.approx(tuple(sampled.clock.times_s[[4, 10]]))
    agrees(sampled, source, uid)


@pytest.mark.parametrize("deleted", (True, False))
def test_deleted_or_hidden_is_removed(source: DriveSource, deleted: bool) -> None:
    uid = standing(source.drive).uid
    sampled = imported(source.drive)
    hidden = changed(sampled, uid, there=np.zeros(len(sampled.clock.frames), bool))
    assert read(without(sampled, uid) if deleted else hidden, source).edits == (Remove(uid),)


def test_copies_keep_their_source(source: DriveSource) -> None:
    actor = driving(source.drive)
    sampled = imported(source.drive)
    poses = one_of(sampled, actor.uid).poses
    world = sampled_object("Copy", "ACTOR", displaced(poses, y=3.5), uid=actor.uid, original_name=actor.uid)
    own = sampled_object("Copy.001", "ACTOR", beside(poses, left=3.5), uid=actor.uid, original_name=actor.uid)
    other = sampled_object("Copy.002", "ACTOR", beside(poses, yaw_deg=5.0), uid=actor.uid, original_name=actor.uid)
    sampled = added(sampled, world, own, other)
    first, second, third = read(sampled, source).edits
    assert isinstance(first, Duplicate) and first.world_offset_m == pytest.approx((0.0, 3.5, 0.0), abs=1e-6)
    assert isinstance(second, Duplicate) and second.offset_m == pytest.approx((0.0, 3.5, 0.0), abs=1e-6)
    assert isinstance(third, Duplicate) and third.trajectory is not None
    agrees(sampled, source, "Copy", "Copy.001", "Copy.002")


def test_a_copy_stands_for_a_deleted_original(source: DriveSource) -> None:
    actor = driving(source.drive)
    sampled = imported(source.drive)
    copy = sampled_object("Copy", "ACTOR", one_of(sampled, actor.uid).poses, uid=actor.uid, original_name=actor.uid)
    assert not read(added(without(sampled, actor.uid), copy), source).edits
    moved = replace(copy, name="Moved", poses=displaced(copy.poses, x=9.0))
    assert original([moved, copy], actor, sampled.clock) is copy and original([], actor, sampled.clock) is None


def test_another_appearance(source: DriveSource) -> None:
    """The box that comes with the appearance is lower: its underside stays on the ground, and it is no move."""
    truck, car = driving(source.drive, "Truck"), driving(source.drive)
    sampled = imported(source.drive)
    lowered = one_of(sampled, truck.uid).poses.copy()
    lowered[:, :3, 3] += (car.size_m[2] - truck.size_m[2]) / 2 * lowered[:, :3, 2]
    sampled = changed(sampled, truck.uid, appearance=car.uid, poses=lowered)
    assert read(sampled, source).edits == (Swap(truck.uid, car.uid, None),)
    with pytest.raises(ScenarioError, match='has the appearance of "nobody", which the log lacks'):
        read(changed(sampled, truck.uid, appearance="nobody"), source)


def test_scales(source: DriveSource) -> None:
    uid = standing(source.drive).uid
    sampled = imported(source.drive)
    assert read(changed(sampled, uid, scaling=Scaling((1.5, 1.0, 1.2))), source).edits == (Scale(uid, (1.5, 1.0, 1.2)),)
    for fault in (MIRRORED, SHEARED, CHANGING):
        with pytest.raises(ScenarioError, match=f'object "{uid}": .*cannot be rendered'):
            read(changed(sampled, uid, scaling=Scaling(fault=fault)), source)
    with pytest.raises(ScenarioError, match="can be scaled by"):
        read(changed(sampled, uid, scaling=Scaling((100.0, 1.0, 1.0))), source)


def test_inserted_actors_and_meshes(source: DriveSource) -> None:
    sampled = imported(source.drive)
    place = np.tile(np.eye(4), (len(sampled.clock.frames), 1, 1))
    box = sampled_object("Box", "ACTOR", place, uid="", mesh="/tmp/drive/meshes/box.npz", label="Other")
    twin = sampled_object(
        "car-01.001",
        "ACTOR",
        displaced(place, x=5.0),
        uid="car-1",
        appearance="car-03",
        appearance_scene="/tmp/drive/other",
    )
    scenario = read_scenario(added(sampled, box, replace(twin, called="Box")), source, PATH)
    mesh, insert = scenario.edits
    assert isinstance(mesh, InsertMesh) and (mesh.mesh, mesh.id, mesh.label) == ("meshes/box.npz", "Box", "Other")
    assert isinstance(insert, Insert) and (insert.actor, insert.scene, insert.id) == ("car-03", "other", "Box 2")


def test_ids_are_taken_once(source: DriveSource) -> None:
    one = sampled_object("Car", "ACTOR", np.eye(4)[None])
    reading = ReadContext(imported(source.drive), source.drive, {"Car"})
    assert [reading.new_id(one), reading.new_id(one)] == ["Car 2", "Car 3"] and reading.taken == {
        "Car",
        "Car 2",
        "Car 3",
    }
    assert reading.new_id(replace(one, called="Van")) == "Van"


def test_the_vehicle_beside_its_lane(source: DriveSource) -> None:
    sampled = imported(source.drive)
    ego = one_of(sampled, "Ego vehicle").poses

    def edit(poses: FloatArray) -> object:
        moved = {one.name: one.poses for one in sampled.objects if one.kind in ("CAMERA", "LIDAR")}
        found = changed(sampled, "Ego vehicle", poses=poses)
        for name, before in moved.items():  # they ride on it
            found = changed(found, name, poses=poses @ invert_pose(ego) @ before)
        scenario = read(found, source)
        assert scenario.sensors is None
        (one,) = scenario.edits
        return one

    constant = edit(beside(ego, left=1.25))
    assert getattr(constant, "shift_left_m", None) == pytest.approx(1.25)
    lane_change = np.interp(np.arange(len(ego)), [5, 12], [0.0, 3.0])
    shifted = ego.copy()
    shifted[:, :3, 3] += lane_change[:, None] * ego[:, :3, 1]
    keys = getattr(edit(shifted), "shift", None)
    assert [(key.frame, key.left_m) for key in keys or ()] == [(0, 0.0), (5, 0.0), (12, 3.0), (19, 3.0)]
    assert getattr(edit(beside(ego, yaw_deg=3.0)), "trajectory", None)


def test_keys_of_a_shift_are_where_its_rate_changes() -> None:
    clock = Clock(np.arange(7.0), np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6]))
    keys = shift_keys(clock, np.array([0.0, 0.0, 0.0, 1.0, 2.0, 2.0, 2.0]))
    assert [(key.frame, key.left_m) for key in keys] == [(0, 0.0), (2, 0.0), (4, 2.0), (6, 2.0)]


def test_sensors_that_moved_went_or_came(source: DriveSource) -> None:
    sampled = imported(source.drive)
    camera = one_of(sampled, "front_camera")
    raised = read(changed(sampled, "front_camera", poses=displaced(camera.poses, z=0.3)), source).sensors
    assert raised is not None and raised.lidars is None and raised.cameras is not None
    (spec,) = raised.cameras
    assert (
        spec.mount_offset is not None
        and spec.mount_offset.position is not None
        and spec.mount_offset.quaternion_wxyz is None
    )
    assert np.linalg.norm(spec.mount_offset.position) == pytest.approx(0.3, abs=1e-3)
    assert camera.camera is not None
    wider = read(changed(sampled, "front_camera", camera=replace(camera.camera, fx=300.0)), source).sensors
    assert wider is not None and wider.cameras is not None and wider.cameras[0].fx == 300.0
    gone = read(without(sampled, "pandar64"), source).sensors
    assert gone is not None and gone.lidars == () and gone.cameras is None
    new = replace(camera, name="side camera", poses=beside(camera.poses, yaw_deg=0.0))
    both = read(added(sampled, new), source).sensors
    assert both is not None and both.cameras is not None
    assert [(spec.id, spec.like) for spec in both.cameras] == [("front_camera", None), ("side_camera", "front_camera")]
    with pytest.raises(ScenarioError, match="has no ego vehicle"):
        read(without(sampled, "Ego vehicle"), source)


def test_names_of_sensors(source: DriveSource) -> None:
    assert sensor_name("My camera", "front_camera", False, source.drive) == "My_camera"
    assert sensor_name("My camera", "front_camera", True, source.drive) == "front_camera"
    assert safe_name(".a/b c") == "_a_b_c"


def test_a_body_is_fixed_to_the_vehicle(source: DriveSource) -> None:
    sampled = imported(source.drive)
    ego = one_of(sampled, "Ego vehicle").poses
    body = sampled_object("Hood", "BODY", beside(ego, ahead=1.5), uid="", mesh="/tmp/drive/hood.npz", label="Car")
    (edit,) = read(added(sampled, body), source).edits
    assert (
        isinstance(edit, EgoBody)
        and edit.mesh == "hood.npz"
        and edit.mount.position == pytest.approx((1.5, 0.0, 0.0), abs=1e-6)
    )
    with pytest.raises(ScenarioError, match='object "Hood": moves on the ego vehicle'):
        read(added(sampled, replace(body, poses=ego[:1].repeat(len(ego), 0))), source)


def test_static_items(source: DriveSource) -> None:
    sampled = imported(source.drive)
    home = np.eye(4)
    home[:3, 3] = (9.0, 4.0, 0.6)
    still = np.tile(home, (len(sampled.clock.frames), 1, 1))
    model = json.dumps({"world_from_box": home.tolist(), "size_m": [0.8, 0.8, 1.2]})
    bin_ = sampled_object("bin", "STATIC", still, model=model)
    marked = replace(sampled, items={"bin": model})
    assert not read(added(marked, bin_), source).edits
    gone = read(marked, source)
    assert (
        gone.edits == (RemoveStatic("bin"),)
        and gone.boxes is not None
        and gone.boxes["bin"].position == (9.0, 4.0, 0.6)
    )
    copied = read(added(marked, bin_, replace(bin_, name="bin.001", poses=displaced(still, x=4.0))), source)
    (copy,) = copied.edits
    assert isinstance(copy, CopyStatic) and copy.id == "bin.001" and copy.target.position == (13.0, 4.0, 0.6)
    moved = read(added(marked, replace(bin_, poses=displaced(still, x=4.0))), source).edits
    assert [type(edit) for edit in moved] == [RemoveStatic, CopyStatic]
    with pytest.raises(ScenarioError, match="which a static item cannot be"):
        read(added(marked, replace(bin_, scaling=Scaling((2.0, 1.0, 1.0)))), source)
