"""Rig presets: saved, put on the vehicle of any drive, shared as files; the list of sensors; outlines of moved ones."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import edited, imported, select

from unisim_blender.bridge.importing import rig_presets
from unisim_blender.bridge.importing.drive import front_camera
from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.objects.sensors import camera_model_of
from unisim_blender.bridge.views.sensor_facts import card_of_sensor, size_of_sensor
from unisim_blender.bridge.views.trails import outline
from unisim_blender.core.geometry import invert_pose
from unisim_blender.core.rigs import built_in_rigs, read_rig
from unisim_blender.core.sensors.beam_tables import BEAM_TABLES
from unisim_blender.editing.sampled.scene import rigid
from unisim_blender.editing.sensors.names import rate_of
from unisim_blender.features.sensors.panel import active_index

RIG: dict[str, Any] = {
    "format": "unisim-rig",
    "version": 1,
    "about": "For tests",
    "cameras": [
        {"id": "ahead", "width": 640, "height": 360, "fx": 500.0, "fy": 510.0, "cx": 330.0, "cy": 170.0,
         "shutter": {"duration_s": 0.02}, "mount": {"position": [1.5, 0.1, 1.6], "pitch_deg": -3}},
        {"id": "left", "width": 320, "height": 200, "horizontal_fov_deg": 90,
         "mount": {"position": [1, 0.4, 1.5], "yaw_deg": 90}},
    ],
    "lidars": [{"id": "roof", "preset": "hdl32e", "mount": {"position": [0.9, 0, 1.9], "yaw_deg": -90}}],
}  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The user's presets folder."""
    monkeypatch.setenv("BLENDER_USER_SCRIPTS", str(tmp_path / "scripts"))
    assert rig_presets.users_folder() == tmp_path / "scripts" / "presets" / "unisim" / "rigs"
    yield rig_presets.users_folder()


@pytest.fixture
def team(folder: Path) -> Path:
    """A preset that a colleague gave."""
    (folder / "Team.json").write_text(json.dumps(RIG))
    return folder / "Team.json"


def sensors(scene: Any) -> list[str]:
    """Names of the sensors that a scenario of the scene renders."""
    drive = edited(scene)
    return [*drive.cameras, *drive.lidars]


def state(scene: Any) -> tuple[Any, ...]:
    """All of the scene that a preset could change."""
    every = [
        (o.name, o.hide_render, o.hide_viewport, o.unisim.model, tuple(o.matrix_basis.to_translation()))
        for o in scene.objects
    ]
    return sorted(every), scene.camera.name, scene.render.resolution_x, len(bpy.data.cameras)


def apply(path: Path, **options: Any) -> set[str]:
    return set(bpy.ops.unisim.apply_rig(filepath=str(path), **options))


def test_a_preset_replaces_the_rig_and_recorded_sensors_come_back(street: Any, team: Path) -> None:
    assert rig_presets.own_presets() == [team]
    before = sensors(street)
    assert before == ["front_camera", "pandar64"]
    assert apply(team) == {"FINISHED"}
    assert sensors(street) == ["ahead", "left", "roof"]
    drive, times = edited(street), np.linspace(0.05, 1.7, 5)
    rig = read_rig(team)
    for camera in rig.cameras:
        made = drive.cameras[camera.name]
        assert made.model == camera.model
        on = invert_pose(drive.world_from_ego.at(times)) @ made.world_from_camera.at(times)
        np.testing.assert_allclose(on, np.broadcast_to(camera.ego_from_camera, on.shape), atol=2e-5)
    roof = drive.lidars["roof"]
    np.testing.assert_allclose(roof.model.elevation_rad, BEAM_TABLES["hdl32e"]().elevation_rad, atol=1e-12)
    on = invert_pose(drive.world_from_ego.at(times)) @ roof.world_from_lidar.at(times)
    np.testing.assert_allclose(on, np.broadcast_to(rig.lidars[0].ego_from_lidar, on.shape), atol=2e-5)
    # what is looked through is the rig's
    assert street.camera.name == "ahead" and (street.render.resolution_x, street.render.resolution_y) == (640, 360)
    assert {o.name for o in bpy.context.selected_objects} == {"ahead", "left", "roof"}
    # applied again, it replaces itself
    count = len(bpy.data.objects)
    assert apply(team) == {"FINISHED"}
    assert sensors(street) == ["ahead", "left", "roof"] and len(bpy.data.objects) == count
    assert bpy.ops.unisim.restore_sensors() == {"FINISHED"}
    assert sensors(street) == ["ahead", "front_camera", "left", "pandar64", "roof"]
    assert not imported(street, "CAMERA", "front_camera").hide_viewport
    assert not bpy.ops.unisim.restore_sensors.poll()


def test_recorded_sensors_that_were_deleted_come_back_as_recorded(street: Any, team: Path) -> None:
    source = source_of(street)
    for name in ("front_camera", "pandar64"):
        bpy.data.objects.remove(bpy.data.objects[name])
    apply(team, mode="ADD")
    assert bpy.ops.unisim.restore_sensors() == {"FINISHED"}
    assert sensors(street) == ["ahead", "front_camera", "left", "pandar64", "roof"]
    drive = edited(street)
    front, roof = source.drive.cameras["front_camera"], source.drive.lidars["pandar64"]
    assert drive.cameras["front_camera"].world_from_camera is front.world_from_camera
    assert drive.cameras["front_camera"].model == front.model and drive.lidars["pandar64"].model is roof.model
    assert drive.lidars["pandar64"].world_from_lidar is roof.world_from_lidar


def test_a_file_that_is_dropped_onto_the_window_is_put_on(street: Any, team: Path) -> None:
    assert bpy.ops.unisim.import_drive(filepath=str(team)) == {"FINISHED"}
    assert sensors(street) == ["ahead", "left", "roof"]


def test_added_with_an_offset_beside_those_that_are_there(street: Any, team: Path) -> None:
    camera = street.camera
    assert apply(team, mode="ADD", offset=(0.5, -0.25, 0.125)) == {"FINISHED"}
    assert sensors(street) == ["ahead", "front_camera", "left", "pandar64", "roof"]
    assert street.camera == camera
    np.testing.assert_allclose(bpy.data.objects["ahead"].location, [2.0, -0.15, 1.725], atol=1e-6)
    # a second time: other names, that files can have
    assert apply(team, mode="ADD") == {"FINISHED"}
    assert sensors(street)[:3] == ["ahead", "ahead_2", "front_camera"] and "roof_2" in sensors(street)


def test_names_of_the_log_are_left_to_its_sensors(street: Any, folder: Path) -> None:
    document = {
        **RIG,
        "cameras": [{**RIG["cameras"][0], "id": "front_camera"}],
        "lidars": [{**RIG["lidars"][0], "id": "pandar64"}],
    }
    (folder / "same.json").write_text(json.dumps(document))
    for name in ("front_camera", "pandar64"):
        bpy.data.objects.remove(bpy.data.objects[name])
    assert apply(folder / "same.json") == {"FINISHED"}
    assert sensors(street) == ["front_camera_2", "pandar64_2"]
    assert edited(street).cameras["front_camera_2"].model.width == 640


def test_sensors_off_the_vehicle_stay(street: Any, team: Path) -> None:
    bpy.ops.unisim.add_camera()
    camera = bpy.context.active_object
    world = camera.matrix_world.copy()
    camera.name, camera.parent = "roadside", None
    camera.matrix_world = world
    assert apply(team) == {"FINISHED"}
    assert sensors(street) == ["ahead", "left", "roadside", "roof"]


def test_saved_and_put_on_again_it_is_the_same_rig(street: Any, folder: Path) -> None:
    bpy.ops.unisim.add_camera(width=800, height=450, mount=(1.0, -0.5, 1.4), yaw_deg=-60.0)
    bpy.context.active_object.name = "right side"
    front = imported(street, "CAMERA", "front_camera")
    front.location.z += 0.5
    street.frame_set(7)
    assert bpy.ops.unisim.save_rig(name="Ours 2", about="as of today") == {"FINISHED"}
    path = folder / "Ours 2.json"
    rig = read_rig(path)
    assert rig.about == "as of today"
    assert [camera.name for camera in rig.cameras] == ["front_camera", "right_side"]
    # of a recorded sensor the mount is saved, not where its object happens to be at a frame
    recorded = source_of(street).drive
    camera = recorded.cameras["front_camera"]
    mount = invert_pose(recorded.world_from_ego.at(camera.time_s[7])) @ camera.world_from_camera.at(camera.time_s[7])
    saved = rig.cameras[0].ego_from_camera
    np.testing.assert_allclose(saved[:3, 3], mount[:3, 3] + [0, 0, 0.5], atol=2e-4)
    np.testing.assert_allclose(saved[:3, :3], mount[:3, :3], atol=1e-5)
    assert rig.cameras[0].model == camera.model
    assert len(rig.lidars[0].model.elevation_rad) == 64
    street.frame_set(0)
    assert apply(path) == {"FINISHED"}
    assert sensors(street) == ["front_camera_2", "right_side", "pandar64_2"]
    assert bpy.ops.unisim.save_rig(name="Again", about="as of today") == {"FINISHED"}
    again = read_rig(folder / "Again.json")
    for camera_before, camera_after in zip(rig.cameras, again.cameras, strict=True):
        np.testing.assert_allclose(camera_before.ego_from_camera, camera_after.ego_from_camera, atol=3e-5)
    np.testing.assert_allclose(rig.lidars[0].ego_from_lidar, again.lidars[0].ego_from_lidar, atol=3e-5)


def test_saving_asks_before_it_replaces_and_removing_deletes(street: Any, folder: Path, team: Path) -> None:
    before = team.read_text()
    with pytest.raises(RuntimeError, match=r"Team\.json: is there already"):
        bpy.ops.unisim.save_rig(name="Team")
    assert team.read_text() == before
    assert bpy.ops.unisim.save_rig(name="Team", overwrite=True) == {"FINISHED"}
    assert team.read_text() != before
    for name in ("", "a/b", "../x", ".hidden", "x" * 61):
        with pytest.raises(RuntimeError, match="a preset's name has 1 to 60 letters"):
            bpy.ops.unisim.save_rig(name=name)
    other = folder.parent / "other.json"
    other.write_text("{}")
    for path in (other, built_in_rigs()[0]):
        with pytest.raises(RuntimeError, match="is no rig preset in Blender's presets folders"):
            bpy.ops.unisim.remove_rig(filepath=str(path))
    assert bpy.ops.unisim.remove_rig(filepath=str(team)) == {"FINISHED"}
    assert not team.exists() and other.exists() and rig_presets.own_presets() == []
    for one in list(imported_objects(street, "CAMERA", "LIDAR")):
        one.hide_render = True
    with pytest.raises(RuntimeError, match="has no sensor on the vehicle that a rig preset could hold"):
        bpy.ops.unisim.save_rig(name="None")


@pytest.mark.parametrize(
    "change, sentence",
    [
        (lambda d: d["cameras"][1].update(width=0), r"Bad\.json: cameras\[1\]\.width: 0 is less than the minimum of 1"),
        (lambda d: d["lidars"][0].update(preset="vlp99"), r"Bad\.json: lidars\[0\]\.preset: 'vlp99' is not one of"),
        (
            lambda d: d["cameras"][1]["mount"].update(position=[1, 2]),
            r"Bad\.json: cameras\[1\]\.mount\.position: \[1, 2\] is too short",
        ),
        (lambda d: d.pop("format"), r"Bad\.json: 'format' is a required property"),
    ],
)
def test_of_a_bad_file_nothing_is_applied(street: Any, folder: Path, change: Any, sentence: str) -> None:
    document = json.loads(json.dumps(RIG))
    change(document)
    (folder / "Bad.json").write_text(json.dumps(document))
    before = state(street)
    with pytest.raises(RuntimeError, match=sentence):
        apply(folder / "Bad.json")
    assert state(street) == before
    with pytest.raises(RuntimeError, match=r"gone\.json: cannot be read"):
        apply(folder / "gone.json")
    (folder / "text.json").write_text("__import__('os').system('true')")
    with pytest.raises(RuntimeError, match=r"text\.json: is not valid JSON"):
        apply(folder / "text.json")
    assert state(street) == before


def test_the_built_in_ones_go_on_the_vehicle(street: Any) -> None:
    for path in built_in_rigs():
        assert apply(path) == {"FINISHED"}
        rig = read_rig(path)
        assert sorted(sensors(street)) == sorted(
            [*(one.name for one in rig.cameras), *(one.name for one in rig.lidars)]
        )
        front = front_camera(street)
        assert front == street.camera and abs(rigid(np.array(front.matrix_local, float))[1, 2]) < 0.01
    properties = SimpleNamespace(filepath=str(built_in_rigs()[0]))
    operator = bpy.types.UNISIM_OT_apply_rig
    assert "2 cameras, 1 LiDAR. The rectified stereo pair" in operator.description(bpy.context, properties)
    properties.filepath = "/nowhere.json"
    assert "nowhere.json: cannot be read" in operator.description(bpy.context, properties)


def test_one_undo_step_takes_it_back(street: Any, team: Path) -> None:
    bpy.ops.ed.undo_push(message="before")
    before = state(street)
    apply(team)
    bpy.ops.ed.undo_push(message="Apply Rig Preset")
    assert state(bpy.context.scene) != before
    bpy.ops.ed.undo()
    assert state(bpy.context.scene) == before


def test_rows_cards_and_buttons_of_sensors(street: Any, team: Path) -> None:
    drive = source_of(street).drive
    front, lidar = imported(street, "CAMERA", "front_camera"), imported(street, "LIDAR", "pandar64")
    model = camera_model_of(front)
    assert size_of_sensor(front) == f"{model.width}×{model.height}" and size_of_sensor(lidar) == "64 beams"
    assert rate_of(drive) == "10 Hz" and rate_of(None) == ""
    cards = [card_of_sensor(street, one, drive) for one in (front, lidar)]
    assert [card.state for card in cards] == ["recorded", "recorded"] and "degrees across" in cards[0].view
    x, y, z = (float(value) for value in cards[1].mount.removesuffix(" m").split(", "))
    np.testing.assert_allclose([x, y, z], [0.78, 0.0, 1.86], atol=0.006)
    front.location.z += 0.5
    bpy.context.view_layer.update()
    assert card_of_sensor(street, front, drive).state == "recorded, moved"
    assert bpy.ops.unisim.show_sensor(name="pandar64") == {"FINISHED"}
    assert card_of_sensor(street, lidar, drive).state == "recorded, hidden" and sensors(street) == ["front_camera"]
    assert bpy.ops.unisim.show_sensor(name="pandar64") == {"FINISHED"}
    apply(team, mode="ADD")
    left = bpy.data.objects["left"]
    assert card_of_sensor(street, left, drive).state == "added"
    assert bpy.ops.unisim.look_through(name="left") == {"FINISHED"}
    assert street.camera == left and street.render.resolution_x == 320 and bpy.context.active_object == left
    # the list's active row is the active sensor
    assert street.objects[street.unisim_sensor_index] == left
    street.unisim_sensor_index = list(street.objects).index(lidar)
    assert bpy.context.active_object == lidar and bpy.context.selected_objects == [lidar]
    select(imported(street, "ACTOR", "car-12"))
    assert active_index(street) == -1
    # hiding what is looked through leaves the view a camera that is there
    assert bpy.ops.unisim.show_sensor(name="left") == {"FINISHED"}
    assert street.camera.name in ("ahead", "front_camera")
    with pytest.raises(RuntimeError, match='no sensor "x" in scene'):
        bpy.ops.unisim.look_through(name="x")


def test_new_sensors_have_names_that_can_be_read(street: Any) -> None:
    for _ in range(2):
        bpy.ops.unisim.add_camera()
        bpy.ops.unisim.add_lidar(preset="vlp16")
    assert sensors(street) == ["camera", "camera_2", "front_camera", "pandar64", "vlp16", "vlp16_2"]


def test_where_a_moved_sensor_was_recorded_is_drawn(street: Any) -> None:
    drive = source_of(street).drive
    front, lidar = imported(street, "CAMERA", "front_camera"), imported(street, "LIDAR", "pandar64")
    for frame in (0, 7):
        street.frame_set(frame)
        assert not len(outline(street, front, drive, frame).points) and not len(
            outline(street, lidar, drive, frame).points
        )
    was = np.array(front.matrix_world.translation)
    front.location.x -= 0.75
    lidar.rotation_quaternion = (0.9, 0.0, 0.0, 0.435)
    bpy.context.view_layer.update()
    lines = outline(street, front, drive, 7)
    np.testing.assert_allclose(lines.points[-2], was, atol=1e-4)
    np.testing.assert_allclose(lines.points[-1], np.array(front.matrix_world.translation), atol=1e-4)
    # the pyramid looks where the camera looked
    camera = drive.cameras["front_camera"]
    ahead = camera.world_from_camera.at(camera.time_s[7])[:3, 2]
    assert ((lines.points[:-2] - was) @ ahead).max() > 0.2 and ((lines.points[:-2] - was) @ ahead).min() > -1e-4
    assert len(outline(street, lidar, drive, 7).points) > 40 and len(lines.colours) == len(lines.points)
    bpy.ops.unisim.add_camera()
    assert not len(outline(street, bpy.context.active_object, drive, 7).points)


def test_a_hidden_camera_can_still_be_looked_through(street: Any, folder: Path) -> None:
    """A rig without cameras hides the recorded one, which the view goes on to look through."""
    (folder / "beams.json").write_text(json.dumps({**RIG, "cameras": []}))
    assert apply(folder / "beams.json") == {"FINISHED"}
    assert sensors(street) == ["roof"] and street.camera.name == "front_camera" and not street.camera.hide_viewport
    street.render.engine, street.render.resolution_percentage = "UNISIM", 10
    street.render.filepath = str(folder / "picture")
    bpy.ops.render.render(write_still=True)
    assert (folder / "picture.png").is_file()
    assert not edited(street).cameras
