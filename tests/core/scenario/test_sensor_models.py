"""Lenses, shutters and beam tables that a scenario or a rig states are those that its sensors have: nothing is lost."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from turning_drive import turning_drive

from unisim_blender.core.errors import LogError, ScenarioError
from unisim_blender.core.lenses import LENSES
from unisim_blender.core.lenses.f_theta import FTheta
from unisim_blender.core.lenses.lens import Lens
from unisim_blender.core.lenses.mei import Mei
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.lenses.registry import Pinhole
from unisim_blender.core.rigs import Rig, RigCamera, RigLidar, read_rig, write_rig
from unisim_blender.core.scenario import apply_scenario, load_scenario, plain, save_scenario, scenario_from_json
from unisim_blender.core.scenario.sensors.document import CameraSpec, LidarSpec
from unisim_blender.core.scenario.sensors.select import camera_members, lidar_members
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.world.drive import CameraModel, Drive, LidarModel, RollingShutter

EVERY: dict[str, Lens] = {
    "pinhole": Pinhole(),
    "opencv_pinhole": OpenCVPinhole(
        -0.31, 0.12, 0.001, -0.002, -0.02, 0.01, 0.003, -0.0001, 0.0003, -0.0002, 0.0001, 0.00007
    ),
    "opencv_fisheye": OpenCVFisheye(-0.02, 0.003, -0.001, 0.0002, 97.5),
    "f_theta": FTheta((1.0, 0.01, -0.03, 0.002), (), 95.0, (1.01, 0.002, -0.003)),
    "f_theta backwards": FTheta((), (1.0, 0.0, 0.02), 88.0),
    "mei": Mei(1.3, -0.05, 0.01, 0.0004, -0.0003),
}
SHUTTERS = [RollingShutter(), RollingShutter(0.03, 0.25), RollingShutter(-0.02, 1.0, "columns")]
MOUNT = {"position": [1.0, 0.0, 1.5], "yaw_deg": 10}


def uneven(beams: int = 5, columns: int = 40) -> LidarModel:
    """A table in which nothing is even, as a solid-state LiDAR's."""
    rng = np.random.default_rng(3)
    azimuth = 0.7 - np.cumsum(rng.uniform(0.01, 0.06, columns))
    return LidarModel(
        np.sort(rng.uniform(-0.4, 0.2, beams))[::-1], rng.normal(0, 0.02, beams), columns, 0.07, 0.3, -1, 0.01, 0.9, 155.0,
        azimuth, np.cumsum(rng.uniform(0, 0.003, columns)) - 0.07, rng.uniform(0, 5e-5, beams),
    )  # fmt: skip


def applied(sensors: dict[str, Any], drive: Drive, folder: Path | None = None) -> Drive:
    """The drive with a scenario's sensors, which has been written to a file in ``folder``, if given, and read again."""
    document = {"format": "unisim-scenario", "version": 1, "name": "s", "log": "log", "edits": [], "sensors": sensors}
    scenario = scenario_from_json(json.loads(json.dumps(document)))
    if folder is not None:
        save_scenario(scenario, folder / "s.json")
        scenario = load_scenario(folder / "s.json")
    return apply_scenario(scenario, drive, lambda path: {})


def same_beams(a: LidarModel, b: LidarModel) -> bool:
    """Angles are degrees in a file: a rounding each way."""
    for name, value in vars(a).items():
        other = getattr(b, name)
        if (value is None) != (other is None):
            return False
        if value is not None and not np.allclose(value, other, rtol=1e-15, atol=1e-15):
            return False
    return True


def test_every_lens_is_among_these() -> None:
    assert {lens.TYPE for lens in EVERY.values()} == set(LENSES)


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("shutter", SHUTTERS)
def test_a_new_camera_keeps_lens_and_shutter(tmp_path: Path, name: str, shutter: RollingShutter) -> None:
    model = CameraModel(640, 400, 310.25, 311.5, 318.0, 203.0, shutter, EVERY[name])
    members = plain(CameraSpec("new", **camera_members(model)))
    drive = applied({"cameras": [{**members, "mount": MOUNT}]}, turning_drive(), tmp_path)
    assert drive.cameras["new"].model == model
    write_rig(Rig((RigCamera("a", model, np.eye(4)),), ()), tmp_path / "rig.json")
    assert read_rig(tmp_path / "rig.json").cameras[0].model == model


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("before", ("pinhole", "opencv_fisheye"))
def test_a_logs_camera_gets_any_other_lens_and_shutter(before: str, name: str) -> None:
    """An ideal one in place of a fisheye, a global shutter in place of one that reads columns, too."""
    drive = turning_drive()
    for old_shutter in SHUTTERS:
        old = CameraModel(320, 200, 155.0, 156.0, 160.0, 100.0, old_shutter, EVERY[before])
        recorded = replace(drive, cameras={"front": replace(drive.cameras["front"], model=old)})
        for shutter in SHUTTERS:
            model = CameraModel(640, 400, 310.25, 311.5, 318.0, 203.0, shutter, EVERY[name])
            members = plain(CameraSpec("front", **camera_members(model, old)))
            assert applied({"cameras": [members]}, recorded).cameras["front"].model == model


@pytest.mark.parametrize("kind,taken,like", [("cameras", "top", "front"), ("lidars", "front", "top")])
def test_a_camera_and_a_lidar_of_one_name_are_refused(kind: str, taken: str, like: str) -> None:
    with pytest.raises(ScenarioError, match=f'sensors: "{taken}" is a camera and a LiDAR'):
        applied({kind: [{"id": taken, "like": like}]}, turning_drive())


def test_a_drive_whose_sensors_share_a_name_is_refused() -> None:
    drive = turning_drive()
    with pytest.raises(LogError, match="'top' is a camera and a LiDAR"):
        replace(drive, cameras={"top": drive.cameras["front"]})


def test_a_new_lidar_keeps_its_tables(tmp_path: Path) -> None:
    model = uneven()
    members = plain(LidarSpec("new", **lidar_members(model)))
    drive = applied({"lidars": [{**members, "mount": MOUNT}]}, turning_drive(), tmp_path)
    lidar = drive.lidars["new"]
    assert same_beams(lidar.model, model)
    # and its rays are those of the table
    rays, wanted = (lidar_rays(replace(lidar, model=m), 0.5) for m in (lidar.model, model))
    assert np.abs(rays.directions - wanted.directions).max() < 1e-12
    assert np.abs(rays.time_s - wanted.time_s).max() < 1e-12
    write_rig(Rig((), (RigLidar("a", model, np.eye(4)),)), tmp_path / "rig.json")
    assert same_beams(read_rig(tmp_path / "rig.json").lidars[0].model, model)


def test_a_logs_lidar_gets_tables_and_loses_them() -> None:
    drive = turning_drive()
    name = next(iter(drive.lidars))
    even = LidarModel(np.radians([2.0, -3.0]), np.zeros(2), 90)
    for before in (drive.lidars[name].model, even, uneven(2)):
        recorded = replace(drive, lidars={name: replace(drive.lidars[name], model=before)})
        for after in (even, uneven(), uneven(3, 17), replace(uneven(), column_time_s=None)):
            members = plain(LidarSpec(name, **lidar_members(after)))
            assert same_beams(applied({"lidars": [members]}, recorded).lidars[name].model, after)
    # a table alone says how many columns there are
    edit = {"id": name, "column_azimuth_deg": [30, 20, -5]}
    found = applied({"lidars": [edit]}, replace(drive, lidars={name: replace(drive.lidars[name], model=even)}))
    assert found.lidars[name].model.columns == 3
    azimuth = found.lidars[name].model.column_azimuth_rad
    assert azimuth is not None
    np.testing.assert_allclose(azimuth, np.radians([30, 20, -5]))


@pytest.mark.parametrize(
    ("members", "sentence"),
    [
        ({"beam_time_s": [0.0, 1e-5, 2e-5]}, r"lidars\[0\]\.beam_time_s: has 3 values for 2 beams"),
        ({"azimuth_offset_deg": [1.0]}, r"lidars\[0\]\.azimuth_offset_deg: has 1 values for 2 beams"),
        ({"columns": 9, "column_time_s": [0.0, 0.1]}, r"lidars\[0\]\.column_time_s: has 2 values for 9 columns"),
        ({"column_azimuth_deg": [3, 2, 1], "column_time_s": [0]}, r"column_time_s: has 1 values for 3 columns"),
        ({"column_azimuth_deg": [1, 2, 3]}, r"lidars\[0\]: column_azimuth_deg must turn in the direction -1"),
        (
            {"column_azimuth_deg": [100, -20, -140, 99]},
            r"column_azimuth_deg must turn in the direction -1, by less than",
        ),
        ({"column_azimuth_deg": []}, r"lidars\[0\]\.column_azimuth_deg: \[\] should be non-empty"),
        ({"beam_time_s": [0, "soon"]}, r"lidars\[0\]\.beam_time_s\[1\]: 'soon' is not of type 'number'"),
        ({"column_time_s": [0, 1e9]}, r"lidars\[0\]\.column_time_s\[1\]: 1e\+09 is not within 1e\+06 s"),
    ],
)
def test_a_wrong_table_is_named(tmp_path: Path, members: dict[str, Any], sentence: str) -> None:
    lidar = {"id": "roof", "mount": MOUNT, "elevation_deg": [1, -1], **members}
    with pytest.raises(ScenarioError, match=sentence) as fault:
        applied({"lidars": [lidar]}, turning_drive())
    assert "\n" not in str(fault.value) and len(str(fault.value)) < 300
    path = tmp_path / "rig.json"
    path.write_text(json.dumps({"format": "unisim-rig", "version": 1, "lidars": [lidar]}))
    with pytest.raises(ScenarioError, match=sentence):
        read_rig(path)
