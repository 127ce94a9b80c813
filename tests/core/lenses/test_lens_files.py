"""Lenses and shutters in scenarios, rigs, scene files and logs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from turning_drive import turning_drive

from unisim_blender.core.errors import LogError, ScenarioError, SceneError
from unisim_blender.core.formats.common.sensor_file import LogSetup, read_setup, write_setup
from unisim_blender.core.json_file import Node
from unisim_blender.core.lenses.mei import Mei
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.rigs import Rig, RigCamera, read_rig, write_rig
from unisim_blender.core.scenario import apply_scenario, scenario_from_json
from unisim_blender.core.world.drive import CameraModel, RollingShutter
from unisim_blender.core.world.drive_json import drive_to_json, read_drive
from unisim_blender.editing.sensors.lenses import degrees_across, lens_of, model_of_lens, undistorted

MODEL = CameraModel(640, 400, 210.0, 211.0, 318.0, 203.0, RollingShutter(-0.02, 0.25, "columns"), Mei(1.2, 0.1, 0.02))


def edited(camera: dict[str, Any]) -> CameraModel:
    document = {
        "format": "unisim-scenario",
        "version": 1,
        "name": "s",
        "log": "log",
        "edits": [],
        "sensors": {"cameras": [camera]},
    }
    scenario = scenario_from_json(document, Path("s.json"))
    return apply_scenario(scenario, turning_drive(), lambda path: {}).cameras[camera["id"]].model


def test_a_scenario_gives_a_camera_a_lens_and_a_shutter() -> None:
    before = turning_drive().cameras["front"].model
    lens = {"type": "opencv_fisheye", "k1": -0.02}
    after = edited({"id": "front", "lens": lens, "shutter": {"duration_s": 0.02, "axis": "columns"}})
    assert after.lens == OpenCVFisheye(k1=-0.02) and after.fx == before.fx
    assert after.shutter == RollingShutter(0.02, before.shutter.reference, "columns")
    new = {
        "id": "new",
        "width": 800,
        "height": 600,
        "mount": {"position": [0, 0, 1]},
        "lens": {"type": "opencv_fisheye"},
    }
    wide = edited({**new, "horizontal_fov_deg": 200})
    u, _, valid = wide.project(np.array([np.sin(np.radians(100)), 0.0, np.cos(np.radians(100))]))
    assert valid and u == pytest.approx(800)


@pytest.mark.parametrize(
    ("camera", "sentence"),
    [
        ({"lens": {"type": "fish"}}, "sensors.cameras[0].lens"),
        ({"lens": {"k1": 1}}, "sensors.cameras[0].lens"),
        (
            {"lens": {"type": "mei", "xi": -2}},
            "s.json: sensors.cameras[0].lens: mei: xi must lie between 0 and 100, not -2",
        ),
        ({"lens": {"type": "opencv_pinhole", "k1": -1e5}}, "opencv_pinhole: the parameters fold or tear the image"),
        ({"lens": {"type": "f_theta", "radius_from_angle": [1.0] * 17}}, "must be at most 16 finite numbers"),
        ({"lens": {"type": "mei", "xi": "1"}}, "sensors.cameras[0].lens.xi: '1' is not of type 'number', 'array'"),
        ({"lens": {"type": "mei", "xi": [None]}}, "sensors.cameras[0].lens.xi[0]: None is not of type 'number'"),
        (
            {"lens": {"type": "f_theta", "radius_from_angle": [0.0, 1.0]}},
            "f_theta: the parameters fold or tear the image",
        ),
        (
            {"lens": {"type": "opencv_fisheye", "k1": [0.1, 0.2]}},
            "opencv_fisheye: k1 must be a finite number, not (0.1",
        ),
        ({"fx": 0, "lens": {"type": "mei"}}, "sensors.cameras[0].fx: 0 is less than or equal to the minimum of 0"),
        ({"fx": -3.0}, "sensors.cameras[0].fx: -3.0 is less than or equal to the minimum of 0"),
        (
            {"cx": 5000, "lens": {"type": "opencv_fisheye", "max_angle_deg": 30}},
            "sensors.cameras[0]: its image lies beside all that the lens shows, 30.0 degrees about the pixel (5000, ",
        ),
        ({"horizontal_fov_deg": 180}, "sensors.cameras[0].horizontal_fov_deg: 180 is no angle of a pinhole"),
        (
            {"horizontal_fov_deg": 220, "lens": {"type": "opencv_fisheye", "max_angle_deg": 100}},
            "horizontal_fov_deg: 220 is more than the 200.0 of the lens",
        ),
        ({"shutter": {"duration_s": 0.1, "axis": "diagonal"}}, "sensors.cameras[0].shutter.axis"),
    ],
)
def test_a_wrong_lens_is_named(camera: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ScenarioError) as fault:
        edited({"id": "front", **camera})
    assert sentence in str(fault.value) and "\n" not in str(fault.value)


def test_a_rig_keeps_lens_and_shutter(tmp_path: Path) -> None:
    write_rig(Rig((RigCamera("a", MODEL, np.eye(4)),), ()), tmp_path / "rig.json")
    assert read_rig(tmp_path / "rig.json").cameras[0].model == MODEL


def test_a_scene_file_keeps_lens_and_shutter() -> None:
    drive = turning_drive()
    drive = replace(drive, cameras={"front": replace(drive.cameras["front"], model=MODEL)})
    document = drive_to_json(drive)
    assert read_drive(Node(document, "scene.json: ", SceneError)).cameras["front"].model == MODEL
    document["cameras"]["front"]["model"]["lens"]["xi"] = "1"
    with pytest.raises(
        SceneError, match=r"scene.json: .*cameras.*front.*lens: mei: xi must be a finite number, not '1'"
    ):
        read_drive(Node(document, "scene.json: ", SceneError))


def test_a_log_keeps_lens_and_shutter(tmp_path: Path) -> None:
    (tmp_path / "meta").mkdir()
    setup = LogSetup("a", (0, 1), 0.0, np.zeros(3), {"a": MODEL.shutter, "b": RollingShutter()}, {}, {"a": MODEL.lens})
    write_setup(tmp_path, setup)
    again = read_setup(tmp_path)
    assert again is not None and again.shutters == setup.shutters
    assert again.lenses["a"] == MODEL.lens and CameraModel(1, 1, 1, 1, 0, 0, lens=again.lenses["b"]).is_pinhole
    path = tmp_path / "meta" / "unisim.json"
    assert path.read_text().count('"lens"') == path.read_text().count('"axis"') == 1
    path.write_text(path.read_text().replace('"xi": 1.2', '"xi": -1.2'))
    with pytest.raises(LogError, match="xi must lie between 0 and 100"):
        read_setup(tmp_path)


@pytest.mark.parametrize("lens", [OpenCVFisheye(), OpenCVFisheye(max_angle_deg=40), OpenCVPinhole(k1=-0.2), Mei(2.0)])
def test_blenders_frustum_reaches_as_far_as_the_image(lens: Any) -> None:
    model = CameraModel(640, 400, 300.0, 300.0, 330.0, 190.0, lens=lens)
    shown = undistorted(model)
    assert shown.is_pinhole and (shown.width, shown.height) == (640, 400)
    if degrees_across(model) < 140:
        assert degrees_across(model) == pytest.approx(degrees_across(shown), rel=0.05)
    blender = lens_of(model)
    # what is not changed in Blender stays, and a zoom there zooms the image
    same = model_of_lens(blender, None, model)
    assert same.lens == lens and same.fx == pytest.approx(model.fx) and same.cx == pytest.approx(model.cx)
    closer = model_of_lens(replace(blender, focal_mm=2 * blender.focal_mm), None, model)
    assert closer.fx == pytest.approx(2 * model.fx) and closer.lens == lens
