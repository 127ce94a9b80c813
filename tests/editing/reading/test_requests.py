"""Requests to the worker from a sampled scene: what looks, when, and with which intrinsics; portraits of actors."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from imported_scene import added, changed, imported, one_of, sampled_object, standing

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.geometry import box_corners, invert_pose, transform_points
from unisim_blender.core.lenses.f_theta import FTheta
from unisim_blender.core.lenses.lens import Lens
from unisim_blender.core.lenses.mei import Mei
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.scenario import load_scenario, scenario_to_json
from unisim_blender.core.scenario.edits import InsertMesh, Move
from unisim_blender.core.scenario.motion.placement import Placement
from unisim_blender.core.scenario.sensors.document import Sensors
from unisim_blender.core.scenario.types import Scenario
from unisim_blender.core.sensors.rays import exposure_window
from unisim_blender.core.sensors.unprojection import directions
from unisim_blender.core.world.drive import Camera, CameraModel
from unisim_blender.core.world.encoding import decode_sensor, decode_state
from unisim_blender.core.world.replay import DriveStates
from unisim_blender.editing.actors.portraits import FILLED, SIZE_PX, portrait_request
from unisim_blender.editing.reading.requests import (
    camera_request,
    indices,
    lidar_request,
    only,
    sized,
    without_unreadable,
)
from unisim_blender.editing.reading.scenario import folder, relative, unreadable_actors, write_scenario
from unisim_blender.editing.sampled.scene import Scaling
from unisim_blender.editing.sampled.source import DriveSource

MODEL = CameraModel(480, 270, 400.0, 402.0, 238.0, 136.0)


def test_a_recorded_camera_looks_at_its_own_time(source: DriveSource) -> None:
    sampled = imported(source.drive)
    view, camera = one_of(sampled, "front_camera"), source.drive.cameras["front_camera"]
    request = camera_request(sampled, view, source, 7.0, (camera.model.width, camera.model.height))
    looks = decode_sensor(request.values["sensor"])
    assert isinstance(looks, Camera) and looks.sensor_id == "front_camera"
    assert request.values["time_s"] == camera.time_s[7]
    assert request.model == looks.model == camera.model
    assert request.scenario.edits == () and request.scenario.sensors == Sensors(None, ())
    assert json.loads(json.dumps(request.values)) == request.values
    states = DriveStates(source.drive, source.parked)
    assert decode_state(request.values["state"]) == states.state(*exposure_window(camera, camera.time_s[7]))


def test_another_camera_has_a_trajectory_of_its_own(source: DriveSource) -> None:
    sampled = imported(source.drive)
    view = sampled_object("Camera", "NONE", one_of(sampled, "front_camera").poses, uid="", camera=MODEL)
    request = camera_request(added(sampled, view), view, source, 7.0, (96, 54))
    (camera,) = scenario_to_json(request.scenario)["sensors"]["cameras"]
    assert (
        decode_sensor(request.values["sensor"]).sensor_id == camera["id"] == "Camera"
        and len(camera["trajectory"]) == 20
    )
    assert request.values["time_s"] == source.drive.time_s[7] and request.model.width == 96


def test_a_sweep_and_who_looks_alone(source: DriveSource) -> None:
    sampled = imported(source.drive)
    lidar = replace(one_of(sampled, "pandar64"), there=np.zeros(20, bool))  # hidden for renders, and asked for
    request = lidar_request(sampled, lidar, source, 3.0)
    assert (
        decode_sensor(request["sensor"]).sensor_id == "pandar64"
        and request["time_s"] == source.drive.lidars["pandar64"].time_s[3]
    )
    alone = only(changed(sampled, "pandar64", there=lidar.there), lidar)
    assert [one.name for one in alone.of("CAMERA", "LIDAR")] == ["pandar64"] and one_of(alone, "pandar64").there.all()


def test_edits_of_the_moment_are_in_it(source: DriveSource) -> None:
    uid = standing(source.drive).uid
    sampled = imported(source.drive)
    poses = one_of(sampled, uid).poses.copy()
    poses[:, 0, 3] += 2.0
    sampled = changed(sampled, uid, poses=poses, index=5)
    request = camera_request(sampled, one_of(sampled, "front_camera"), source, 7.0, (96, 54))
    (edit,) = request.scenario.edits
    assert isinstance(edit, Move) and edit.actor == uid and request.indices[uid] == 5
    copy = replace(one_of(sampled, uid), name="Copy", index=9)
    assert indices(added(sampled, copy))["Copy"] == 9 and indices(added(sampled, copy))[uid] == 5


@pytest.mark.parametrize("size", [(960, 540), (240, 135), (391, 220)])
def test_a_camera_of_the_rig_keeps_its_own_intrinsics(size: tuple[int, int]) -> None:
    found = sized(MODEL, size, 1.0, True)
    assert (found.width, found.height) == size
    assert (found.fx / size[0], found.cx / size[0]) == pytest.approx((400 / 480, 238 / 480))
    assert (found.fy / size[1], found.cy / size[1]) == pytest.approx((402 / 270, 136 / 270))


def test_another_shape_is_as_wide_as_the_lens_says() -> None:
    found = sized(MODEL, (480, 480), 1.0, True)
    assert (found.fx, found.fy, found.cx) == (400.0, 400.0, 238.0) and found.cy == 240 + 1.0
    squeezed = sized(MODEL, (480, 270), 2.0, False)
    assert squeezed.fy == 200.0 and squeezed.fx == 400.0


@pytest.mark.parametrize(
    "lens",
    [OpenCVPinhole(-0.2, 0.05, 0.001, -0.002), OpenCVFisheye(-0.03, 0.002), FTheta((1.0, 0.0, -0.05)), Mei(0.9, -0.1)],
    ids=lambda lens: lens.TYPE,
)
def test_the_view_through_a_lens_is_the_cameras(lens: Lens) -> None:
    """Each pixel of a view looks where the recorded camera's pixel in the same place of the lens does."""
    recorded = replace(MODEL, fx=200.0, fy=201.0, lens=lens)
    u, v = np.meshgrid(np.linspace(60.0, 420.0, 13), np.linspace(40.0, 230.0, 9))
    truth = directions(recorded, u, v)
    assert np.isfinite(truth).all()
    for size in ((960, 540), (240, 135), (391, 220)):
        found = sized(recorded, size, 1.0, True)
        seen = directions(found, u * size[0] / 480, v * size[1] / 270)
        np.testing.assert_allclose(seen, truth, atol=1e-6)
    # Blender frames a view of another shape by its width: what lies above and below is added
    np.testing.assert_allclose(directions(sized(recorded, (480, 480), 1.0, True), u, v + 105.0), truth, atol=1e-6)


def test_a_portrait_shows_all_of_the_actor_and_no_other(source: DriveSource) -> None:
    shown = 0
    for actor in source.drive.actors.values():
        request = portrait_request(source, actor, "portrait")
        if request is None:
            continue
        shown += 1
        document = scenario_to_json(request.scenario)
        (camera,) = document["sensors"]["cameras"]
        key = camera["trajectory"][0]
        model = request.model
        assert (model.width, model.height) == (SIZE_PX, SIZE_PX) and model.fx == pytest.approx(model.fy)
        removed = {edit["actor"] for edit in document["edits"] if edit["type"] == "remove"}
        assert actor.uid not in removed and len(removed) >= len(source.drive.actors) - 1 - 5
        w, x, y, z = key["quaternion_wxyz"]
        axes = np.array([
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ])  # fmt: skip
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = axes, key["position"]
        if actor.is_moving:
            continue
        corners = transform_points(invert_pose(pose), box_corners(actor.world_from_actor.at(0.0), actor.size_m))
        across = np.abs(corners[:, :2] / corners[:, 2:]).max() * model.fx
        assert (corners[:, 2] > 0).all() and across == pytest.approx(FILLED * SIZE_PX / 2, rel=1e-3)
    assert shown > 5


def test_paths_are_relative_to_the_scenario() -> None:
    assert relative(Path("/a/b/log"), Path("/a/c/scenario.json")) == "../b/log"


def test_a_written_scenario_has_its_meshes_beside_it(tmp_path: Path) -> None:
    assert folder() == folder() and folder().is_dir()
    mesh, own = folder() / "abc.npz", tmp_path / "own.npz"
    mesh.write_bytes(b"shape")
    own.write_bytes(b"other")
    path = tmp_path / "out" / "cut in.json"
    path.parent.mkdir()
    place = Placement(position=(1.0, 2.0, 3.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0))
    edits = (InsertMesh(str(mesh), "box", pose=place), InsertMesh("../own.npz", "own", pose=place))
    write_scenario(Scenario(name="x", log=str(tmp_path), edits=edits, path=path), path)
    kept = path.parent / "cut in_meshes" / "abc.npz"
    assert kept.read_bytes() == b"shape"
    meshes = [edit.mesh for edit in load_scenario(path).edits if isinstance(edit, InsertMesh)]
    assert meshes == ["cut in_meshes/abc.npz", "../own.npz"]


def test_without_a_trained_scene_actors_of_other_scenes_are_left_out_with_a_warning(source: DriveSource) -> None:
    sampled, untrained = imported(source.drive), replace(source, scene_path=None)
    view, car = one_of(sampled, "front_camera"), standing(source.drive)
    look = {"uid": "", "appearance": car.uid, "appearance_scene": str(source.scene_path), "size_m": tuple(car.size_m)}
    sampled = added(sampled, sampled_object("Other", "ACTOR", one_of(sampled, car.uid).poses, **look))
    values = camera_request(sampled, view, untrained, 7.0, (96, 54)).values
    assert values["warnings"] == ["Other: not shown, since actors of another scene need a trained scene of this drive"]
    assert values["others"] == [] and "Other" not in {actor.uid for actor in decode_state(values["state"]).actors}
    assert camera_request(sampled, view, source, 7.0, (96, 54)).values["warnings"] == []


@pytest.mark.parametrize("case", ["scale", "scene", "appearance"])
def test_an_unreadable_actor_is_left_out_of_a_view_and_refused_elsewhere(source: DriveSource, case: str) -> None:
    """Its scale is forbidden, its scene was moved, or that scene lacks its appearance; all else is in the image."""
    car, view_name = standing(source.drive).uid, "front_camera"
    here = imported(source.drive)
    copy = replace(one_of(here, car), name="Copy of it", original_name="", appearance=car)
    before = camera_request(here, one_of(here, view_name), source, 7.0, (96, 54))
    faulty = {
        "scale": replace(copy, scaling=Scaling((20.0, 20.0, 20.0))),
        "scene": replace(copy, appearance_scene="/gone/scene"),
        "appearance": replace(copy, appearance="car-99"),
    }[case]
    sampled = added(here, faulty)
    view = one_of(sampled, view_name)
    with pytest.raises(UnisimError):
        camera_request(sampled, view, source, 7.0, (96, 54))
    request, left_out = without_unreadable(
        lambda readable: camera_request(readable, view, source, 7.0, (96, 54)), sampled, source.drive
    )
    assert request.scenario == before.scenario and request.values["state"] == before.values["state"]
    (sentence,) = left_out
    assert str(sentence).startswith('Left out: "Copy of it" ')
    assert list(unreadable_actors(sampled, source.drive)) == ["Copy of it"]


def test_a_faulty_scene_without_faulty_actors_is_refused_in_a_view_too(source: DriveSource) -> None:
    sampled = imported(source.drive)
    broken = replace(sampled, objects=tuple(obj for obj in sampled.objects if obj.kind != "EGO"))
    with pytest.raises(UnisimError, match="has no ego vehicle"):
        without_unreadable(
            lambda readable: camera_request(readable, one_of(sampled, "front_camera"), source, 7.0, (96, 54)),
            broken,
            source.drive,
        )
