"""Every edit on a small drive: what it changes, what it leaves to the bit, and what it refuses."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from turning_drive import turning_drive

from unisim_blender.core.errors import ScenarioError, SceneError
from unisim_blender.core.geometry import FloatArray, Trajectory, invert_pose, make_pose, quaternion_from_yaw
from unisim_blender.core.scenario import apply_scenario, scenario_from_json
from unisim_blender.core.world.drive import Actor, Appearance, Drive
from unisim_blender.core.world.drive_json import arrays_to_json, drive_to_json

TIMES = np.linspace(-0.1413, 1.0437, 237)
"""Times between keys, and all that rolling shutters and sweeps of the drive ask for."""


def other_scene(path: Path) -> dict[str, Actor]:
    """The actors of a scene beside the scenario's."""
    if path.name != "other":
        raise SceneError(f"{path}: cannot be read")
    bus = turning_drive().actors["van"]
    return {
        "bus": replace(bus, uid="bus", label="Bus", size_m=np.array([11.0, 2.5, 3.0]), appearance=Appearance("bus"))
    }


def edited(*edits: dict[str, Any], drive: Drive | None = None, **members: Any) -> Drive:
    document = {"format": "unisim-scenario", "version": 1, "name": "s", "log": "l", "edits": list(edits), **members}
    return apply_scenario(scenario_from_json(document, Path("/folder/s.json")), drive or turning_drive(), other_scene)


def refusal(*edits: dict[str, Any], **members: Any) -> str:
    with pytest.raises(ScenarioError) as caught:
        edited(*edits, **members)
    return str(caught.value).removeprefix("/folder/")


def assert_same(a: FloatArray, b: FloatArray, tolerance: float = 1e-12) -> None:
    np.testing.assert_allclose(a, b, rtol=0, atol=tolerance)


def assert_rigid(drive: Drive, recorded: Drive, tolerance: float) -> None:
    """Every sensor sits on the vehicle as it did, at every time."""
    for now, before in [
        (drive.cameras["front"].world_from_camera, recorded.cameras["front"].world_from_camera),
        (drive.lidars["top"].world_from_lidar, recorded.lidars["top"].world_from_lidar),
    ]:
        assert_same(
            invert_pose(drive.world_from_ego.at(TIMES)) @ now.at(TIMES),
            invert_pose(recorded.world_from_ego.at(TIMES)) @ before.at(TIMES),
            tolerance,
        )


KEYS = [{"time_s": 0.2, "position": [1, 2, 3], "yaw_deg": 0}, {"frame": 6, "position": [5, 2, 3], "yaw_deg": 90}]
ALL_EDITS: list[dict[str, Any]] = [
    {"type": "duplicate", "actor": "car", "id": "a", "offset_m": [0, 3, 0], "turn_deg": 180, "time_offset_s": 0.2},
    {"type": "insert", "actor": "bus", "scene": "other", "id": "b", "trajectory": KEYS},
    {"type": "move", "actor": "late", "trajectory": KEYS, "outside": "hold"},
    {"type": "move", "actor": "late", "offset_m": [0, 1, 0], "later_s": 0.1},
    {"type": "retime", "actor": "car", "speed": 0.5},
    {"type": "swap", "actor": "car", "appearance": "van"},
    {"type": "scale", "actor": "car", "factors": [1.3, 1, 0.75]},
    {"type": "remove", "actor": "van"},
    {"type": "copy_static", "box": "x", "id": "x2", "target": {"position": [1, 1, 1]}},
    {"type": "remove_static", "box": "x"},
    {"type": "ego", "shift_left_m": 1},
    {"type": "ego", "trajectory": KEYS},
]
BOX = {"x": {"position": [5, 6, 0.5], "yaw_deg": 90, "size_m": [1, 2, 1]}}
SENSORS = {
    "cameras": [{"id": "front", "width": 32, "mount_offset": {"yaw_deg": 5}}],
    "lidars": [{"id": "top", "columns": 9}],
}


@pytest.mark.parametrize("edit", ALL_EDITS, ids=lambda edit: edit["type"])
def test_no_edit_changes_its_input(edit: dict[str, Any]) -> None:
    drive = turning_drive()
    result = edited(edit, drive=drive, boxes=BOX, sensors=SENSORS, frames=[1, 2])
    assert drive_to_json(drive) == drive_to_json(turning_drive())
    assert drive_to_json(result) != drive_to_json(drive)


def test_all_edits_together_make_a_drive() -> None:
    result = edited(*ALL_EDITS, boxes=BOX, sensors=SENSORS)
    assert list(result.actors) == ["car", "late", "a", "b"]


def test_without_edits_everything_is_the_original() -> None:
    drive = turning_drive()
    result = edited(drive=drive)
    assert result.world_from_ego is drive.world_from_ego
    assert result.actors == drive.actors
    assert drive_to_json(result) == drive_to_json(drive)


def test_what_no_edit_names_stays_the_same_object() -> None:
    drive = turning_drive()
    result = edited(
        {"type": "remove", "actor": "van"},
        {"type": "move", "actor": "late", "pose": {"position": [0, 0, 0]}},
        drive=drive,
    )
    assert result.actors["car"] is drive.actors["car"]
    assert result.cameras is drive.cameras
    assert result.world_from_ego is drive.world_from_ego


def test_remove() -> None:
    assert list(edited({"type": "remove", "actor": "car"}).actors) == ["late", "van"]


def test_a_duplicate_in_the_actors_own_frame_is_beside_it_at_all_times() -> None:
    drive = edited({"type": "duplicate", "actor": "car", "id": "b", "offset_m": [2, 3, 0.5]})
    source, copy = drive.actors["car"], drive.actors["b"]
    beside = source.world_from_actor.at(TIMES) @ make_pose(np.array([2.0, 3, 0.5]), np.array([1.0, 0, 0, 0]))
    inside = (TIMES >= 0) & (TIMES <= 1)
    assert_same(copy.world_from_actor.at(TIMES)[inside], beside[inside], 1e-6)
    assert (copy.appearance, copy.label, copy.start_s, copy.end_s) == (source.appearance, source.label, 0.0, 1.0)
    assert copy.inserted
    assert not source.inserted


def test_a_duplicate_turned_and_moved_in_the_world_is_exact() -> None:
    drive = edited({"type": "duplicate", "actor": "car", "id": "b", "world_offset_m": [2, 3, 0.5], "turn_deg": 90})
    source, copy = drive.actors["car"].world_from_actor.at(TIMES), drive.actors["b"].world_from_actor.at(TIMES)
    assert_same(copy[:, :3, 3], source[:, :3, 3] + [2, 3, 0.5])
    assert_same(copy[:, :3, 0], source[:, :3, 1])  # its front looks where the source's left side does


def test_a_duplicate_later_is_where_the_source_was() -> None:
    drive = edited({"type": "duplicate", "actor": "late", "id": "b", "time_offset_s": 0.15})
    source, copy = drive.actors["late"], drive.actors["b"]
    assert_same(copy.world_from_actor.at(TIMES), source.world_from_actor.at(TIMES - 0.15))
    assert (copy.start_s, copy.end_s) == (0.3 + 0.15, 0.8 + 0.15)


def test_a_move_displaces_and_delays_its_own_trajectory() -> None:
    shift = {"actor": "late", "offset_m": [0, 2, 0]}
    copy = edited({"type": "duplicate", "id": "b", "time_offset_s": 0.15, **shift}).actors["b"]
    now = edited({"type": "move", "later_s": 0.15, **shift}).actors["late"]
    assert_same(now.world_from_actor.at(TIMES), copy.world_from_actor.at(TIMES))
    assert (now.start_s, now.end_s, now.is_moving) == (0.3 + 0.15, 0.8 + 0.15, copy.is_moving)
    present = edited({"type": "move", "actor": "late", "later_s": 0.15, "present": {"end_s": 0.6}}).actors["late"]
    assert present.end_s == 0.6
    with pytest.raises(ScenarioError, match="has later_s beside a path of its own"):
        edited({"type": "move", "actor": "car", "later_s": 1, "trajectory": KEYS})


def test_a_move_ahead_follows_the_path() -> None:
    source, now = (edited(*edits).actors["car"] for edits in ([], [{"type": "move", "actor": "car", "ahead_m": 0.5}]))
    path = source.world_from_actor.at(np.linspace(-1, 2, 3001))[:, :3, 3]
    times = np.linspace(0.1, 0.5, 5)
    places = now.world_from_actor.at(times)[:, :3, 3]
    assert np.linalg.norm(places[:, None] - path, axis=-1).min(1).max() < 0.05
    assert np.linalg.norm(places - source.world_from_actor.at(times)[:, :3, 3], axis=1) == pytest.approx(0.5, abs=0.02)


def test_a_trajectory_of_keyframes() -> None:
    drive = edited({"type": "move", "actor": "car", "trajectory": KEYS})
    moved = drive.actors["car"]
    assert_same(moved.world_from_actor.at(0.4), make_pose(np.array([3.0, 2, 3]), quaternion_from_yaw(np.pi / 4)))
    assert_same(moved.world_from_actor.at(0.8)[:3, 3], np.array([7.0, 2, 3]))
    assert (moved.start_s, moved.end_s, moved.size_m.tolist()) == (0.0, 1.0, [4.4, 1.9, 1.5])
    held = (
        edited({"type": "move", "actor": "car", "trajectory": KEYS, "outside": "hold"}).actors["car"].world_from_actor
    )
    assert_same(
        held.at(np.array([-5.0, 0.0, 0.7, 9.0]))[:, :3, 3], np.array([[1.0, 2, 3], [1, 2, 3], [5, 2, 3], [5, 2, 3]])
    )


def test_yaw_pitch_and_roll() -> None:
    pose = {"position": [0, 0, 0], "yaw_deg": 90, "pitch_deg": 30}
    axes = edited({"type": "move", "actor": "car", "pose": pose}).actors["car"].world_from_actor.at(0.5)[:3, :3]
    assert_same(axes[:, 0], np.array([0, np.cos(np.pi / 6), np.sin(np.pi / 6)]))  # the front points to +y and up
    rolled = edited({"type": "move", "actor": "car", "pose": {"position": [0, 0, 0], "roll_deg": 90}}).actors["car"]
    assert_same(rolled.world_from_actor.at(0.5)[:3, 1], np.array([0.0, 0, 1]))  # the left side points up


def test_insert_stands_still_all_the_time() -> None:
    pose = {"position": [7, 8, 0.75], "yaw_deg": -90}
    drive = edited({"type": "insert", "actor": "car", "id": "new", "pose": pose})
    new = drive.actors["new"]
    assert new.present(TIMES).all()
    assert_same(new.world_from_actor.at(TIMES)[:, :3, 3], np.tile([7, 8, 0.75], (len(TIMES), 1)))
    assert_same(new.world_from_actor.at(0.3)[:3, 0], np.array([0.0, -1, 0]))
    assert (new.appearance, new.is_moving, new.inserted) == (Appearance("car"), False, True)


def test_insert_from_another_scene_within_an_interval() -> None:
    present = {"start_s": 0.25, "end_s": 0.5}
    drive = edited(
        {"type": "insert", "actor": "bus", "scene": "other", "id": "bus-1", "trajectory": KEYS, "present": present}
    )
    bus = drive.actors["bus-1"]
    assert bus.appearance == Appearance("bus", "/folder/other")
    assert (bus.label, bus.size_m.tolist(), bus.is_moving) == ("Bus", [11.0, 2.5, 3.0], True)
    assert bus.present(np.array([0.2, 0.25, 0.5, 0.51])).tolist() == [False, True, True, False]


def test_insert_from_the_scenarios_own_scene_names_no_scene() -> None:
    edit = {"type": "insert", "actor": "car", "scene": "../folder/mine", "id": "b", "pose": {"position": [0, 0, 0]}}
    assert edited(edit, scene="mine").actors["b"].appearance == Appearance("car")


def test_a_removed_actors_look_can_be_inserted() -> None:
    edit = {"type": "insert", "actor": "car", "id": "b", "pose": {"position": [0, 0, 0]}}
    assert edited({"type": "remove", "actor": "car"}, edit).actors["b"].appearance == Appearance("car")


@pytest.mark.parametrize(
    ("edit", "recorded"),
    [
        ({"offset_s": 0.25}, lambda t: t - 0.25),
        ({"speed": 0.5}, lambda t: t * 0.5),
        ({"speed": 2, "pivot_s": 0.5}, lambda t: 0.5 + 2 * (t - 0.5)),
        ({"speed": 2, "pivot_s": 0.5, "offset_s": 0.1}, lambda t: 0.5 + 2 * (t - 0.6)),
        ({"map": [[0.1, 0.4]]}, lambda t: t + 0.3),
        (
            {"map": [[0.15, 0.2], [0.55, 0.4], [0.75, 0.4], [1, 0.95]]},
            lambda t: np.interp(t, [-1, 0.15, 0.55, 0.75, 1, 2], [-0.95, 0.2, 0.4, 0.4, 0.95, 1.95]),
        ),
    ],
)
def test_retime_keeps_the_path(edit: dict[str, Any], recorded: Any) -> None:
    drive = turning_drive()
    for uid, actor in drive.actors.items():
        result = edited({"type": "retime", "actor": uid, **edit}).actors[uid]
        assert_same(result.world_from_actor.at(TIMES), actor.world_from_actor.at(recorded(TIMES)), 1e-9)
        np.testing.assert_array_equal(result.present(TIMES), actor.present(recorded(TIMES)))
        continued = edited({"type": "retime", "actor": uid, **edit, "outside": "continue"}).actors[uid]
        assert_same(continued.world_from_actor.at(TIMES), actor.world_from_actor.at(recorded(TIMES)), 1e-9)
        assert continued.present(TIMES).all()
        held = edited({"type": "retime", "actor": uid, **edit, "outside": "hold"}).actors[uid]
        kept = np.clip(recorded(TIMES), actor.start_s, actor.end_s)
        assert_same(held.world_from_actor.at(TIMES), actor.world_from_actor.at(kept), 1e-9)
        assert held.present(TIMES).all()


def test_a_change_of_speed_keeps_the_keys_to_the_bit() -> None:
    before, after = (
        turning_drive().actors["car"],
        edited({"type": "retime", "actor": "car", "speed": 0.7, "offset_s": 0.1}).actors["car"],
    )
    assert after.world_from_actor.positions.tobytes() == before.world_from_actor.positions.tobytes()
    assert after.world_from_actor.quaternions_wxyz.tobytes() == before.world_from_actor.quaternions_wxyz.tobytes()


def test_swap_keeps_the_ground() -> None:
    drive = turning_drive()
    result = edited({"type": "swap", "actor": "car", "appearance": "van"}, drive=drive).actors["car"]
    before = drive.actors["car"]
    assert (result.appearance, result.label, result.size_m.tolist()) == (Appearance("van"), "Van", [6.0, 2.2, 2.5])
    lowest_before = before.world_from_actor.at(TIMES)[:, 2, 3] - 1.5 / 2
    assert_same(result.world_from_actor.at(TIMES)[:, 2, 3] - 2.5 / 2, lowest_before)
    assert_same(result.world_from_actor.at(TIMES)[:, :2, 3], before.world_from_actor.at(TIMES)[:, :2, 3])
    assert (result.start_s, result.end_s, result.is_moving) == (0.0, 1.0, True)
    assert (
        edited({"type": "swap", "actor": "car", "appearance": "bus", "scene": "other"}).actors["car"].appearance.scene
        == "/folder/other"
    )


def test_static_boxes() -> None:
    drive = edited(
        {"type": "copy_static", "box": "x", "id": "x2", "target": {"position": [9, 6, 0.5]}},
        {"type": "remove_static", "box": "x"},
        boxes=BOX,
    )
    (copy,), (removal,) = drive.static_copies, drive.static_removals
    assert copy.uid == "x2"
    assert_same(copy.source.world_from_box, make_pose(np.array([5, 6, 0.5]), quaternion_from_yaw(np.pi / 2)))
    assert_same(copy.world_from_target, make_pose(np.array([9, 6, 0.5]), quaternion_from_yaw(0.0)))
    assert copy.source.size_m.tolist() == removal.size_m.tolist() == [1, 2, 1]
    np.testing.assert_array_equal(removal.world_from_box, copy.source.world_from_box)


def test_a_constant_shift_carries_ego_and_sensors_exactly() -> None:
    recorded = turning_drive()
    drive = edited({"type": "ego", "shift_left_m": 2})
    assert_rigid(drive, recorded, 1e-12)
    before = recorded.world_from_ego.at(TIMES)
    left = before @ make_pose(np.array([0.0, 2, 0]), np.array([1.0, 0, 0, 0]))
    inside = (TIMES >= 0) & (TIMES <= 1)
    assert_same(drive.world_from_ego.at(TIMES)[inside], left[inside], 1e-6)
    camera, old = drive.cameras["front"].world_from_camera, recorded.cameras["front"].world_from_camera
    own = np.isin(camera.times_s, old.times_s)
    assert camera.quaternions_wxyz[own].tobytes() == old.quaternions_wxyz.tobytes()
    assert drive.cameras["front"].time_s == recorded.cameras["front"].time_s


def test_a_ramped_shift_follows_its_keys() -> None:
    keys = [{"time_s": 0.2, "left_m": 0}, {"frame": 7, "left_m": 3}]
    recorded, drive = turning_drive(), edited({"type": "ego", "shift": keys})
    assert_rigid(drive, recorded, 1e-12)
    local = invert_pose(recorded.world_from_ego.at(TIMES)) @ drive.world_from_ego.at(TIMES)
    assert_same(local[:, 1, 3], np.interp(TIMES, [0.2, 0.7], [0, 3]), 1e-4)
    assert_same(local[:, 0, 3], np.zeros(len(TIMES)), 1e-4)


def test_ego_edits_add_up() -> None:
    once, twice = edited({"type": "ego", "shift_left_m": 2}), edited(*[{"type": "ego", "shift_left_m": 1}] * 2)
    assert_same(
        once.cameras["front"].world_from_camera.at(TIMES), twice.cameras["front"].world_from_camera.at(TIMES), 1e-5
    )


def test_a_new_ego_trajectory_carries_the_sensors() -> None:
    recorded, drive = turning_drive(), edited({"type": "ego", "trajectory": KEYS})
    assert_same(drive.world_from_ego.at(0.4), make_pose(np.array([3.0, 2, 3]), quaternion_from_yaw(np.pi / 4)))
    assert_rigid(drive, recorded, 2e-6)
    assert len(drive.cameras["front"].world_from_camera.times_s) < 5000


def test_keys_lie_outside_the_log_where_the_scenario_says_what_is_there() -> None:
    keys = [{"time_s": -2.0, **PLACE}, {"time_s": 1.5, "position": [20.0, 0.0, 0.0]}]
    moved = edited({"type": "move", "actor": "car", "trajectory": keys}, outside="hold").actors["car"]
    assert moved.world_from_actor.times_s.tolist() == [-2.0, 1.5]
    assert "outside the log" in refusal({"type": "move", "actor": "car", "trajectory": keys})


def test_what_moves_in_the_recording_moves_along_keys_that_stand() -> None:
    """A simulation knows a part of a trajectory alone."""
    keys = [{"time_s": time, **PLACE} for time in (0.1, 0.5)]
    found = edited({"type": "move", "actor": "car", "trajectory": keys}).actors["car"]
    parked = edited({"type": "move", "actor": "car", "pose": PLACE}).actors["car"]
    assert found.is_moving and not parked.is_moving


def test_frames_are_selected() -> None:
    assert edited(frames={"start": 2, "stop": 9, "step": 3}).frames == (2, 5, 8)
    assert edited(frames={"start": 8}).frames == (8, 9, 10)
    assert edited(frames=[3, 1]).frames == (3, 1)
    assert edited(frames=[3]).time_s == turning_drive().time_s


def test_listed_sensors_are_the_drives_sensors() -> None:
    drive = turning_drive()
    result = edited(
        drive=drive, sensors={"cameras": [{"id": "front"}, {"id": "b", "like": "front", "width": 32}], "lidars": []}
    )
    assert result.cameras["front"] == drive.cameras["front"]
    assert result.cameras["b"].model == drive.cameras["front"].model.resized(32)
    assert result.lidars == {}
    assert edited(drive=drive, sensors={"cameras": []}).lidars["top"] == drive.lidars["top"]


def test_a_camera_of_another_size_and_k() -> None:
    model = edited(sensors={"cameras": [{"id": "front", "width": 32, "height": 36, "cx": 3}]}).cameras["front"].model
    assert (model.width, model.height, model.fx, model.fy, model.cx, model.cy) == (32, 36, 30.0, 61.0, 3.0, 17.5)
    assert model.shutter.duration_s == 0.03
    wide = {"id": "front", "horizontal_fov_deg": 90, "shutter": {"duration_s": 0}}
    model = edited(sensors={"cameras": [wide]}).cameras["front"].model
    assert (round(model.fx, 9), round(model.fy, 9), model.cx) == (32.0, 32.0, 32.5)
    assert (model.shutter.duration_s, model.shutter.reference) == (0, 0.5)


def test_a_new_camera_rides_on_its_mount_of_the_edited_ego() -> None:
    spec = {
        "id": "new",
        "width": 40,
        "height": 20,
        "fx": 30,
        "mount": {"position": [1, 2, 3], "yaw_deg": 90},
        "time_offset_s": 0.01,
    }
    drive = edited({"type": "ego", "shift_left_m": 2}, sensors={"cameras": [spec]})
    camera = drive.cameras["new"]
    local = invert_pose(drive.world_from_ego.at(TIMES)) @ camera.world_from_camera.at(TIMES)
    assert_same(local[:, :3, 3], np.tile([1, 2, 3], (len(TIMES), 1)), 2e-6)
    assert_same(local[:, :3, 2], np.tile([0, 1, 0], (len(TIMES), 1)), 1e-7)  # it looks to the left
    assert_same(local[:, :3, 1], np.tile([0, 0, -1], (len(TIMES), 1)), 1e-7)
    assert camera.time_s[3] == drive.time_s[3] + 0.01
    assert (camera.model.fy, camera.model.cx, camera.model.cy, camera.model.shutter.duration_s) == (30, 20, 10, 0)


def test_a_mount_offset_moves_and_turns_a_sensor_on_the_vehicle() -> None:
    offset = {"position": [0.5, 1, -0.2], "yaw_deg": 90}
    recorded, drive = turning_drive(), edited(sensors={"cameras": [{"id": "front", "mount_offset": offset}]})
    ego = invert_pose(recorded.world_from_ego.at(TIMES))
    before, after = (
        ego @ recorded.cameras["front"].world_from_camera.at(TIMES),
        ego @ drive.cameras["front"].world_from_camera.at(TIMES),
    )
    assert_same(after[:, :3, 3], before[:, :3, 3] + [0.5, 1, -0.2], 2e-6)
    assert_same(after[:, 0, :3], -before[:, 1, :3], 2e-7)
    assert_same(after[:, 1, :3], before[:, 0, :3], 2e-7)


def test_lidars_changed_and_new() -> None:
    table = {
        "elevation_deg": [10, -10],
        "azimuth_offset_deg": [0, 2],
        "columns": 12,
        "start_azimuth_deg": 90,
        "direction": 1,
    }
    mount = {"position": [0, 0, 2.5]}
    specs = [
        {"id": "top", "max_range_m": 50},
        {"id": "new", **table, "mount": mount},
        {"id": "p", "preset": "pandar64", "mount": mount},
    ]
    recorded, drive = turning_drive(), edited(sensors={"lidars": specs})
    top, new = drive.lidars["top"], drive.lidars["new"].model
    before = replace(recorded.lidars["top"], model=replace(recorded.lidars["top"].model, max_range_m=50), blocked=None)
    assert (
        drive_to_json(drive)["lidars"]["top"]
        == drive_to_json(replace(recorded, lidars={"top": before}))["lidars"]["top"]
    )
    assert top.blocked is None
    assert edited(sensors={"lidars": [{"id": "top"}]}).lidars["top"].blocked is not None
    assert_same(new.elevation_rad, np.radians([10, -10]))
    assert_same(new.azimuth_offset_rad, np.radians([0, 2]))
    assert (new.columns, new.direction, new.max_range_m) == (12, 1, 200.0)
    assert (drive.lidars["p"].model.beams, drive.lidars["p"].model.columns) == (64, 1800)
    assert (np.diff(drive.lidars["p"].model.elevation_rad) < 0).all()


MOUNT = {"position": [0, 0, 2]}
PLACE = {"position": [0, 0, 0]}


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (
            {"type": "remove", "actor": "car-9"},
            'edits[1].actor: no actor "car-9" in the log (there are car, late, van)',
        ),
        ({"type": "move", "actor": "gone", "pose": PLACE}, 'edits[1].actor: no actor "gone" in the log'),
        (
            {"type": "swap", "actor": "car", "appearance": "bus"},
            'edits[1].appearance: no actor "bus" in the log (there are car, late, van)',
        ),
        ({"type": "duplicate", "actor": "car", "id": "van"}, 'edits[1].id: "van" is an actor of the log already'),
        ({"type": "insert", "actor": "bus", "id": "b", "pose": PLACE}, 'edits[1].actor: no actor "bus" in the log'),
        (
            {"type": "insert", "actor": "tram", "scene": "other", "id": "b", "pose": PLACE},
            'edits[1].actor: no actor "tram" in the scene other (there is bus)',
        ),
        (
            {"type": "insert", "actor": "bus", "scene": "none", "id": "b", "pose": PLACE},
            "edits[1].scene: /folder/none: cannot be read",
        ),
        (
            {"type": "move", "actor": "car", "trajectory": [{"time_s": 1.5, **PLACE}]},
            "edits[1].trajectory[0].time_s: time 1.5 s lies outside the log (0 … 1 s)",
        ),
        (
            {"type": "move", "actor": "car", "trajectory": [{"frame": 11, **PLACE}]},
            "edits[1].trajectory[0].frame: no frame 11 in the log (0 … 10)",
        ),
        (
            {"type": "move", "actor": "car", "trajectory": [{"frame": 5, **PLACE}, {"time_s": 0.4, **PLACE}]},
            "edits[1].trajectory[1]: 0.4 s must lie after the key before, 0.5 s",
        ),
        (
            {"type": "move", "actor": "car", "pose": PLACE, "present": {"end_s": 3}},
            "edits[1].present.end_s: time 3 s lies outside the log (0 … 1 s)",
        ),
        (
            {"type": "retime", "actor": "car", "map": [[0, 0], [0.5, 2]]},
            "edits[1].map[1]: time 2 s lies outside the log (0 … 1 s)",
        ),
        (
            {"type": "retime", "actor": "car", "speed": 2, "pivot_s": -1},
            "edits[1].pivot_s: time -1 s lies outside the log",
        ),
        (
            {"type": "ego", "shift": [{"frame": 99, "left_m": 1}]},
            "edits[1].shift[0].frame: no frame 99 in the log (0 … 10)",
        ),
        ({"type": "copy_static", "box": "x", "id": "car", "target": PLACE}, 'edits[1].id: "car" is an actor already'),
    ],
)
def test_what_does_not_fit_the_log_is_refused_with_its_place(edit: dict[str, Any], message: str) -> None:
    assert refusal({"type": "ego", "shift_left_m": 0}, edit, boxes=BOX).startswith(f"s.json: {message}")


def test_a_removed_actor_cannot_be_edited_again() -> None:
    retime = {"type": "retime", "actor": "car", "speed": 2}
    assert (
        refusal({"type": "remove", "actor": "car"}, retime) == 's.json: edits[1].actor: "car" was removed by edits[0]'
    )


def test_a_box_cannot_have_an_actors_id() -> None:
    assert refusal(boxes={"car": BOX["x"]}) == "s.json: boxes.car: is an actor's id already"


@pytest.mark.parametrize(
    ("members", "message"),
    [
        ({"frames": [1, 90]}, "frames[1]: no frame 90 in the log (0 … 10)"),
        ({"frames": {"stop": 12}}, "frames.stop: no frame 11 in the log (0 … 10)"),
        ({"frames": {"start": 11}}, "frames: selects none of the frames there are (0 … 10)"),
        (
            {"sensors": {"cameras": [{"id": "side"}]}},
            'sensors.cameras[0].id: no camera "side" in the log (there is front)',
        ),
        (
            {"sensors": {"cameras": [{"id": "a", "like": "b"}]}},
            'sensors.cameras[0].like: no camera "b" in the log (there is front)',
        ),
        (
            {"sensors": {"cameras": [{"id": "a", "mount": MOUNT, "width": 9}]}},
            "sensors.cameras[0]: a new camera needs width, height",
        ),
        (
            {"sensors": {"cameras": [{"id": "front", "fx": 1, "horizontal_fov_deg": 9}]}},
            "sensors.cameras[0]: has fx beside",
        ),
        (
            {"sensors": {"lidars": [{"id": "a", "mount": MOUNT}]}},
            "sensors.lidars[0]: a new LiDAR needs preset or elevation_deg",
        ),
        (
            {"sensors": {"lidars": [{"id": "top", "azimuth_offset_deg": [1]}]}},
            "sensors.lidars[0].azimuth_offset_deg: has 1 values for 3",
        ),
        (
            {"sensors": {"lidars": [{"id": "top", "max_range_m": 0.1}]}},
            "sensors.lidars[0]: min_range_m 0.5 must lie below max_range_m",
        ),
        (
            {"sensors": {"lidars": [{"id": "top", "preset": "vlp16", "elevation_deg": [1]}]}},
            "sensors.lidars[0]: has preset beside",
        ),
    ],
)
def test_frames_and_sensors_that_do_not_fit_are_refused(members: dict[str, Any], message: str) -> None:
    assert refusal(**members).startswith(f"s.json: {message}")


def test_an_actor_with_one_key_stays_one_key() -> None:
    copy = edited({"type": "duplicate", "actor": "van", "id": "b", "offset_m": [0, 1, 0], "time_offset_s": 0.1}).actors[
        "b"
    ]
    assert len(copy.world_from_actor.times_s) == 1
    assert arrays_to_json(copy.world_from_actor)["positions"] == [[30.0, -3.0, 1.25]]
    assert isinstance(copy.world_from_actor, Trajectory)


def test_keys_that_coincide_after_an_edit_are_refused() -> None:
    """float64 tells these times apart, but not once they are a day later."""
    close = [{"time_s": 0.5, "position": [0, 0, 0]}, {"time_s": 0.5 + 1e-12, "position": [1, 0, 0]}]
    edits = (
        {"type": "move", "actor": "car", "trajectory": close},
        {"type": "retime", "actor": "car", "offset_s": 86400.0},
    )
    assert refusal(*edits).startswith("s.json: edits[1]: key ")
    assert "is not later than the one before" in refusal(*edits)


def test_a_path_that_turns_too_fast_for_where_it_is_is_refused_soon() -> None:
    far = [{"time_s": 0.01 * i, "position": [9e5 * (-1) ** i, 9e5, 0], "yaw_deg": 179.0 * i} for i in range(100)]
    edits = [{"type": "ego", "trajectory": far}] * 3
    begun = time.process_time()
    assert "takes more than 100000 keys to follow" in refusal(*edits)
    assert time.process_time() - begun < 10


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        ({"type": "ego", "shift_left_m": 2e6}, "edits[1].shift_left_m: 2e+06 is not within 1e+06 m"),
        ({"type": "retime", "actor": "car", "speed": 1e-9}, "edits[1].speed: 1e-09 is not from 0.001 to 1000"),
        ({"type": "retime", "actor": "car", "offset_s": -1e308}, "edits[1].offset_s: -1e+308 is not within 1e+06 s"),
        (
            {"type": "duplicate", "actor": "car", "id": "b", "turn_deg": 1e300},
            "edits[1].turn_deg: 1e+300 is not within 1e+06 degrees",
        ),
    ],
)
def test_numbers_beyond_limits_are_refused(edit: dict[str, Any], message: str) -> None:
    assert refusal({"type": "remove", "actor": "van"}, edit) == f"s.json: {message}"
