"""A mesh as the ego vehicle's body: it rides along whatever the vehicle does, and the vehicle's own
sensors never see it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from analytic_scene import Stage, analytic_scene, drive_of, ground, renderer_of, union, wall
from drive_frames import DriveFrames
from random_scene import CARS, CONFIGS, MOVING, saved
from turning_drive import turning_drive

from unisim_blender.core import native
from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.geometry import invert_pose
from unisim_blender.core.model.scene_file import read_scene_header
from unisim_blender.core.output.frame_files import moment_labels
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.scenario import apply_scenario, scenario_from_json, scenario_to_json
from unisim_blender.core.scenes import recipe
from unisim_blender.core.scenes.recipe import load_backend
from unisim_blender.core.scenes.scene import OpenScenes, open_scene
from unisim_blender.core.sensors.frames import CAMERA_PASSES
from unisim_blender.core.world.captures import Moment
from unisim_blender.core.world.drive import Camera, Drive, Lidar
from unisim_blender.core.world.drive_json import drive_to_json

TIMES = np.linspace(-0.2, 1.2, 141)
AT = [1.0, 0.2, 0.7]
MOUNT = {"position": AT, "yaw_deg": 10}
BODY: dict[str, Any] = {"type": "ego_body", "mesh": "body.ply", "id": "body", "mount": MOUNT}
SHIFT = {"type": "ego", "shift": [{"frame": 2, "left_m": 0}, {"frame": 6, "left_m": 2}]}
ELSEWHERE = {
    "type": "ego",
    "trajectory": [
        {"frame": 0, "position": [0, 5, 0], "yaw_deg": 0},
        {"frame": 10, "position": [9, 7, 0], "yaw_deg": 40},
    ],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a body of 3 x 1.6 x 1.4 m in it, and a cube of 1 m."""
    path = tmp_path_factory.mktemp("body")
    for name, size in (("body", [3.0, 1.6, 1.4]), ("cube", [1.0, 1.0, 1.0])):
        box = trimesh.creation.box(size)
        box.visual.face_colors = [255, 64, 0, 255]
        box.export(path / f"{name}.ply")
    return path


def edited(folder: Path, *edits: dict[str, Any], drive: Drive | None = None, **members: Any) -> Drive:
    document = {"format": "unisim-scenario", "version": 1, "name": "s", "log": "l", "edits": list(edits), **members}
    scenario = scenario_from_json(document, folder / "s.json")
    assert scenario_to_json(scenario) == document
    return apply_scenario(scenario, drive or turning_drive(), lambda path: {})


@pytest.mark.parametrize("edits", [(BODY,), (BODY, SHIFT), (SHIFT, BODY), (BODY, ELSEWHERE), (ELSEWHERE, BODY)])
def test_it_rides_on_the_vehicle_whatever_that_does(folder: Path, edits: tuple[dict[str, Any], ...]) -> None:
    drive = edited(folder, *edits)
    body = drive.actors["body"]
    assert body.is_ego_body and body.inserted and body.label == "Car"
    np.testing.assert_allclose(body.size_m, [3.0, 1.6, 1.4], atol=1e-6)
    on = invert_pose(drive.world_from_ego.at(TIMES)) @ body.world_from_actor.at(TIMES)
    np.testing.assert_allclose(on[:, :3, 3], np.broadcast_to(AT, (len(on), 3)), atol=1e-4)
    np.testing.assert_allclose(on[:, 0, 0], np.cos(np.radians(10)), atol=1e-4)
    assert (body.start_s, body.end_s) == (-1.0, 2.0)


SENSORS = {
    "cameras": [
        {"id": "front"},
        {"id": "moved", "like": "front", "mount_offset": {"position": [0, 0, 1]}},
        {"id": "roadside", "like": "front", "trajectory": [{"time_s": 0, "position": [9, 6, 2], "yaw_deg": -120}]},
        {"id": "gimbal", "like": "front", "trajectory": [{"time_s": 0, "position": [0, 0, 2]}], "sees_ego_body": False},
        {"id": "chase", "like": "front", "mount": {"position": [-8, 0, 3]}, "sees_ego_body": True},
    ],
    "lidars": [
        {"id": "roof", "preset": "vlp16", "mount": {"position": [0, 0, 2]}},
        {"id": "pole", "preset": "vlp16", "trajectory": [{"time_s": 0, "position": [5, 5, 3]}]},
    ],
}


def test_sensors_with_a_trajectory_see_it_and_labels_say_so(folder: Path) -> None:
    drive = edited(folder, BODY, sensors=SENSORS)
    every: list[Camera | Lidar] = [*drive.cameras.values(), *drive.lidars.values()]
    assert [sensor.sensor_id for sensor in every if sensor.sees_ego_body] == ["roadside", "chase", "pole"]
    labels = moment_labels(drive, Moment.of_frame(drive, 3, (), ()))
    assert [name for name, sensor in labels["sensors"].items() if "body" in sensor["boxes"]] == [
        "roadside",
        "chase",
        "pole",
    ]
    (box,) = [box for box in labels["boxes"] if box["id"] == "body"]
    np.testing.assert_allclose(box["ego"]["position"], AT, atol=1e-4)
    # no sensor of the log sees it: it is no label
    labels = moment_labels(edited(folder, BODY), Moment.of_frame(edited(folder, BODY), 3, (), ()))
    assert "body" not in {box["id"] for box in labels["boxes"]}
    assert all("car" in sensor["boxes"] and "body" not in sensor["boxes"] for sensor in labels["sensors"].values())


def test_drives_that_differ_by_it_have_another_json(folder: Path) -> None:
    with_body, without = edited(folder, BODY, sensors=SENSORS), edited(folder, sensors=SENSORS)
    plain = replace(
        with_body, actors={**with_body.actors, "body": replace(with_body.actors["body"], is_ego_body=False)}
    )
    blind = {name: replace(camera, sees_ego_body=False) for name, camera in with_body.cameras.items()}
    texts = [drive_to_json(drive) for drive in (with_body, without, plain, replace(with_body, cameras=blind))]
    assert all(a != b for i, a in enumerate(texts) for b in texts[:i])


@pytest.mark.parametrize(
    "edits, sentence",
    [
        (({**BODY, "mesh": "none.ply"},), r"edits\[0\]\.mesh: .*none.ply: cannot be read"),
        (({**BODY, "id": "car"},), r'edits\[0\]\.id: "car" is an actor of the log already'),
        ((BODY, BODY), r'edits\[1\]\.id: "body" is taken by edits\[0\]'),
        (
            (BODY, {"type": "remove", "actor": "body"}),
            r'edits\[1\]\.actor: "body" is an ego body: it rides on the ego vehicle',
        ),
        (({k: v for k, v in BODY.items() if k != "mount"},), r"edits\[0\]: 'mount' is a required property"),
        (
            ({**BODY, "mount": {"position": [0, 0, 0], "quaternion_wxyz": [1, 1, 0, 0]}},),
            r"mount\.quaternion_wxyz: .* length",
        ),
    ],
)
def test_what_is_wrong_is_refused_by_its_place(folder: Path, edits: tuple[dict[str, Any], ...], sentence: str) -> None:
    with pytest.raises(ScenarioError, match=sentence):
        edited(folder, *edits)


def standing(folder: Path, *edits: dict[str, Any]) -> Drive:
    """The random scene's drive, whose vehicle stands at (-20, 0, 1.6), with sensors beside it that look at it."""
    beside = [{"time_s": 0, "position": [-20.0, -7.0, 1.6], "yaw_deg": 90}]
    sensors = {
        "cameras": [{"id": "front"}, {"id": "beside", "like": "front", "trajectory": beside}],
        "lidars": [{"id": "top"}, {"id": "pole", "like": "top", "trajectory": beside}],
    }
    return edited(folder, *edits, drive=drive_of([*CARS[1:], MOVING]), sensors=sensors)


CUBE = {"type": "insert_mesh", "mesh": "cube.ply", "id": "zebra", "pose": {"position": [-17.0, 0.6, 1.6]}}
ROUND = {"type": "ego_body", "mesh": "body.ply", "id": "body", "mount": {"position": [0.3, 0, -0.2]}}
"""The sensors of the vehicle are inside it, and it ends 1.2 m before them."""
TRACERS = [
    pytest.param("cpu", marks=pytest.mark.skipif(native.library() is None, reason="no compiled kernels")),
    "torch",
]


def alone(renderer: DriveFrames, camera_id: str) -> bool:
    """Whether a pixel's colour depends on its own ray and on nothing else."""
    camera = renderer.drive.cameras[camera_id]
    states = (renderer.state(camera, time_s) for time_s in camera.time_s.values())
    return all(renderer.renderer.alone(state, camera) for state in states)


@pytest.mark.parametrize("device", TRACERS)
@pytest.mark.parametrize("quality", ["reference", "fast"])
def test_own_sensors_render_the_same_bytes_and_others_see_it(
    folder: Path, tmp_path: Path, device: str, quality: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = saved(tmp_path / "scene", CONFIGS["tiny"])
    if device == "torch":
        monkeypatch.setattr(recipe, "backend_name", lambda *_: recipe.TORCH)

    def renderer(*edits: dict[str, Any]) -> DriveFrames:
        drive = standing(folder, *edits)
        backend = load_backend(open_scene(scene), OpenScenes().others(drive), quality)
        assert type(backend).__name__ == ("TorchBackend" if device == "torch" else "CompiledBackend")
        return DriveFrames(Renderer(backend, shadows=True), drive)

    bare, there = renderer(CUBE), renderer(CUBE, ROUND)
    for name, same in (("front", True), ("beside", False)):
        before, after = bare.camera(name, 2, CAMERA_PASSES), there.camera(name, 2, CAMERA_PASSES)
        alike = [
            np.array_equal(getattr(before, one), getattr(after, one), equal_nan=True)
            for one in ("rgb", "depth_m", "z_depth_m", "normal", "instance", "opacity", "unsupported")
        ]
        assert all(alike) == same, (name, alike)
        # a frame names what its sensor can see
        assert after.instances == (before.instances if same else (*before.instances, "body"))
        assert after.instance is not None
        seen = after.instance == len(before.instances) + 1
        assert seen.any() != same
        if not same:
            # 6.2 m away, 3 m and 1.4 m wide, at 40 pixels a metre and metre of distance; fields may stand before it
            assert after.z_depth_m is not None and seen.sum() > 20
            np.testing.assert_allclose(np.median(after.z_depth_m[seen]), 6.2, atol=0.01)
            assert np.median(after.rgb[seen][:, 0]) > 2 * np.median(after.rgb[seen][:, 2])
        assert alone(there, name) == alone(bare, name)
    for name, same in (("top", True), ("pole", False)):
        sweep, swept = bare.lidar(name, 2), there.lidar(name, 2)
        alike = [
            np.array_equal(getattr(sweep, one), getattr(swept, one))
            for one in ("depth_m", "intensity", "return_probability", "returned", "instance")
        ]
        assert all(alike) == same, (name, alike)
        assert np.any(swept.instance == len(sweep.instances) + 1) != same


def test_its_contact_shadow_is_for_those_that_see_it(folder: Path) -> None:
    scene = analytic_scene(union(ground, wall(10.0)), {})
    low = {
        **ROUND,
        "mount": {"position": [3.0, 0, -0.9]},
    }  # its underside is on the ground, and the front camera sees that
    drive = replace(standing(folder, low), actors={"body": standing(folder, low).actors["body"]})

    def images(drive: Drive, shadows: bool) -> list[Any]:
        renderer = renderer_of(Stage(scene, replace(drive, actors={})).as_scene(), drive, shadows=shadows)
        return [renderer.camera(name, 2).rgb for name in ("front", "beside")]

    bare, plain, shaded = images(replace(drive, actors={}), True), images(drive, False), images(drive, True)
    np.testing.assert_array_equal(bare[0], plain[0])
    np.testing.assert_array_equal(bare[0], shaded[0])
    darker = (plain[1] - shaded[1]).max(-1) > 0.02
    assert 5 < darker.sum() < darker.size / 4 and (shaded[1] <= plain[1]).all()


@pytest.mark.skipif(native.library() is None, reason="the compiled kernels were not built")
def test_images_that_are_traced_on_a_lattice_are_the_same(folder: Path) -> None:
    """Meshes make a lattice finer about them; that must not tell of one that is not seen."""
    path = Path(__file__).parents[3] / "sample" / "scene"
    recorded = read_scene_header(path).drive
    beside = [{"time_s": 0, "position": [12, 6, 1.5], "yaw_deg": -100}]
    sensors = {"cameras": [{"id": "front_camera"}, {"id": "beside", "like": "front_camera", "trajectory": beside}]}
    body = {**BODY, "mount": {"position": [1.5, 0, 0.8]}}  # the camera is above its bonnet

    def renderer(*edits: dict[str, Any]) -> DriveFrames:
        drive = edited(folder, *edits, drive=recorded, sensors=sensors)
        return DriveFrames(Renderer(load_backend(open_scene(path)), shadows=True), drive)

    bare, there = renderer(), renderer(body)
    assert alone(there, "front_camera") and not alone(there, "beside")
    passes = ("rgb", "depth", "instance")
    before, after = (made.camera("front_camera", 10, passes, width=960) for made in (bare, there))
    for name in ("rgb", "depth_m", "instance"):
        np.testing.assert_array_equal(getattr(before, name), getattr(after, name))
    outside = there.camera("beside", 10, passes, width=960)
    assert outside.instance is not None and (outside.instance == len(outside.instances)).sum() > 1000
