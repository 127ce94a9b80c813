"""Rigs: files of a team's sensors, read with checks, written, and the built-in ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.geometry import make_pose, quaternion_from_yaw
from unisim_blender.core.rigs import Rig, RigCamera, RigLidar, built_in_rigs, read_rig, write_rig
from unisim_blender.core.scenario.sensors.select import FRONT_FROM_OPTICAL
from unisim_blender.core.sensors.beam_tables import BEAM_TABLES, hdl32e
from unisim_blender.core.world.drive import CameraModel, LidarModel, RollingShutter

CAMERA: dict[str, Any] = {"id": "front", "width": 640, "height": 360, "fx": 500.0, "mount": {"position": [1.5, 0, 1.6]}}
LIDAR: dict[str, Any] = {"id": "roof", "preset": "vlp16", "mount": {"position": [0, 0, 2]}}
RIG: dict[str, Any] = {"format": "unisim-rig", "version": 1, "about": "ours", "cameras": [CAMERA], "lidars": [LIDAR]}


def without(member: str) -> dict[str, Any]:
    """The camera without a member."""
    return {key: value for key, value in CAMERA.items() if key != member}


def rig_of(tmp_path: Path, document: Any) -> Rig:
    path = tmp_path / "rig.json"
    path.write_text(document if isinstance(document, str) else json.dumps(document))
    return read_rig(path)


def test_a_rig_is_read_in_the_vehicles_axes(tmp_path: Path) -> None:
    camera = {**CAMERA, "mount": {"position": [1, 2, 3], "yaw_deg": 90}, "shutter": {"duration_s": 0.02}}
    rig = rig_of(tmp_path, {**RIG, "cameras": [camera], "lidars": [{**LIDAR, "columns": 900, "time_offset_s": 0.01}]})
    (front,), (roof,) = rig.cameras, rig.lidars
    assert rig.about == "ours" and front.name == "front" and roof.name == "roof"
    assert front.model == CameraModel(640, 360, 500.0, 500.0, 320.0, 180.0, RollingShutter(0.02, 0.5))
    np.testing.assert_allclose(front.ego_from_camera[:3, 2], [0, 1, 0], atol=1e-12)  # it looks to the left
    np.testing.assert_allclose(front.ego_from_camera[:3, 1], [0, 0, -1], atol=1e-12)
    np.testing.assert_allclose(front.ego_from_camera[:3, 3], [1, 2, 3])
    assert (roof.model.columns, roof.model.time_offset_s, roof.model.beams) == (900, 0.01, 16)
    np.testing.assert_allclose(roof.ego_from_lidar[:3, :3], np.eye(3))


def test_what_is_written_is_what_is_read(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    turned = make_pose(np.array([1.25, -0.5, 1.75]), quaternion_from_yaw(0.3))
    turned[:3, :3] = turned[:3, :3] @ FRONT_FROM_OPTICAL
    own = LidarModel(
        np.sort(rng.uniform(-0.4, 0.2, 20))[::-1], rng.normal(0, 0.02, 20), 777, 0.07, 0.3, 1, 0.01, 0.9, 55.0
    )
    model = CameraModel(1920, 1208, 1970.5, 1971.25, 970.1, 483.3, RollingShutter(0.03, 0.25))
    level = make_pose(np.array([0.0, 0, 2.0]), quaternion_from_yaw(-1.0))
    rig = Rig((RigCamera("a", model, turned),), (RigLidar("b", own, level), RigLidar("c", hdl32e(), level)), "Über uns")
    write_rig(rig, tmp_path / "r.json")
    again = read_rig(tmp_path / "r.json")
    assert again.about == rig.about and again.cameras[0].model == model
    np.testing.assert_allclose(again.cameras[0].ego_from_camera, turned, atol=1e-5)
    for before, after in zip(rig.lidars, again.lidars, strict=True):
        assert before.name == after.name
        np.testing.assert_allclose(before.ego_from_lidar, after.ego_from_lidar, atol=1e-5)
        for key, value in vars(before.model).items():
            if value is None:
                assert getattr(after.model, key) is None
            else:
                np.testing.assert_allclose(getattr(after.model, key), value, rtol=1e-12)
    # a maker's table is written by its name
    assert [lidar.get("preset") for lidar in json.loads((tmp_path / "r.json").read_text())["lidars"]] == [
        None,
        "hdl32e",
    ]
    write_rig(again, tmp_path / "s.json")
    assert (
        json.loads((tmp_path / "s.json").read_text())["cameras"]
        == json.loads((tmp_path / "r.json").read_text())["cameras"]
    )


@pytest.mark.parametrize(
    "document, sentence",
    [
        ("import os", r"rig\.json: is not valid JSON"),
        ({**RIG, "version": 2}, r"rig\.json: has version 2, newer than the 1"),
        ({**RIG, "format": "unisim-scenario"}, r"rig\.json: format: 'unisim-rig' was expected"),
        ({**RIG, "cameras": [{**CAMERA, "width": -5}]}, r"cameras\[0\]\.width: -5 is less than the minimum of 1"),
        ({**RIG, "cameras": [{**CAMERA, "fx": "wide"}]}, r"cameras\[0\]\.fx: 'wide' is not of type 'number'"),
        ({**RIG, "cameras": [{**CAMERA, "fx": None}]}, r"cameras\[0\]\.fx: None is not of type 'number'"),
        (json.dumps(RIG).replace("500.0", "NaN"), r"cameras\[0\]\.fx: nan is not a finite number"),
        ({**RIG, "cameras": [{**CAMERA, "id": "a/b"}]}, r"cameras\[0\]\.id: 'a/b' does not match"),
        ({**RIG, "cameras": [CAMERA, CAMERA]}, r'cameras\[1\]\.id: "front" stands twice'),
        ({**RIG, "lidars": [{**LIDAR, "id": "front"}]}, r'lidars\[0\]\.id: "front" stands twice'),
        ({**RIG, "cameras": [without("mount")]}, r"cameras\[0\]: 'mount' is a required property"),
        ({**RIG, "cameras": [without("fx")]}, r"cameras\[0\]: a new camera needs width, height, and fx"),
        ({**RIG, "cameras": [{**CAMERA, "like": "x"}]}, r"cameras\[0\]\.like: is no part of a rig"),
        ({**RIG, "cameras": [{**CAMERA, "optics": 3}]}, r"cameras\[0\]: .*'optics' was unexpected"),
        ({**RIG, "cameras": [{**CAMERA, "lens": 3}]}, r"cameras\[0\]\.lens: 3 is not of type 'object'"),
        (
            {**RIG, "cameras": [{**CAMERA, "mount": {"position": [0, 0, 0], "quaternion_wxyz": [1, 1, 0, 0]}}]},
            r"cameras\[0\]\.mount\.quaternion_wxyz: \[1, 1, 0, 0\] has length 1\.41421, not 1",
        ),
        ({**RIG, "lidars": [{**LIDAR, "preset": "vlp99"}]}, r"lidars\[0\]\.preset: 'vlp99' is not one of"),
        ({**RIG, "lidars": [{k: v for k, v in LIDAR.items() if k != "preset"}]},
        r"lidars\[0\]: a new LiDAR needs preset or"),
        ({**RIG, "cameras": [], "lidars": []}, r"rig\.json: has neither cameras nor lidars"),
        ({**RIG, "code": "x"}, r"rig\.json: .*'code' was unexpected"),
    ],
)  # fmt: skip
def test_a_bad_file_is_refused_in_a_sentence_that_names_the_place(tmp_path: Path, document: Any, sentence: str) -> None:
    with pytest.raises(ScenarioError, match=sentence) as caught:
        rig_of(tmp_path, document)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"none\.json: cannot be read: No such file"):
        read_rig(tmp_path / "none.json")


def test_the_built_in_ones_are_what_they_are_like() -> None:
    rigs = {path.stem: read_rig(path) for path in built_in_rigs()}
    assert set(rigs) == {"KITTI-like", "nuScenes-like", "Waymo-like"}
    for rig in rigs.values():
        assert "approximation" in rig.about and "et al." in rig.about
        for camera in rig.cameras:
            assert abs(camera.ego_from_camera[2, 1] + 1) < 1e-9, "level: the image's down is the vehicle's"
            assert 1.0 < camera.ego_from_camera[2, 3] < 2.5
    nuscenes, waymo, kitti = (rigs[name] for name in ("nuScenes-like", "Waymo-like", "KITTI-like"))
    assert (len(nuscenes.cameras), [lidar.model.beams for lidar in nuscenes.lidars]) == (6, [32])
    assert (len(waymo.cameras), [lidar.model.beams for lidar in waymo.lidars]) == (5, [64])
    np.testing.assert_allclose(np.degrees(waymo.lidars[0].model.elevation_rad[[0, -1]]), [2.4, -17.6])
    left, right = kitti.cameras
    np.testing.assert_allclose((left.ego_from_camera - right.ego_from_camera)[:3, 3], [0, 0.54, 0], atol=1e-9)
    np.testing.assert_array_equal(kitti.lidars[0].model.elevation_rad, BEAM_TABLES["hdl64e"]().elevation_rad)

    def around(rig: Rig) -> float:
        """How much of the circle some camera sees, degrees."""
        headings = np.radians(np.arange(0, 360, 0.5))
        seen = np.zeros(len(headings), bool)
        for camera in rig.cameras:
            axis = np.arctan2(camera.ego_from_camera[1, 2], camera.ego_from_camera[0, 2])
            apart = np.abs((headings - axis + np.pi) % (2 * np.pi) - np.pi)
            seen |= apart < np.arctan(camera.model.width / 2 / camera.model.fx)
        return float(seen.mean() * 360)

    assert around(nuscenes) == 360 and 220 < around(waymo) < 240 and 75 < around(kitti) < 85
