"""Files of sensors with faults: lenses of every model in a log, a rig and a scenario, beam tables, what sensors say of sweeps."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from ncore_drive import LENSES, SPINNING, UNEVEN
from turning_drive import turning_drive

from inputs.faults import Scale
from inputs.promise import Property, Reader
from inputs.strategies import Input, inputs_of
from inputs.views import In, json_text
from unisim_blender.core.formats.common.sensor_file import LidarSetup, LogSetup, read_setup, setup_path, write_setup
from unisim_blender.core.geometry import make_pose
from unisim_blender.core.lenses.lens import Lens
from unisim_blender.core.lenses.mei import Mei
from unisim_blender.core.rigs import Rig, RigCamera, RigLidar, read_rig, write_rig
from unisim_blender.core.scenario import apply_scenario, load_scenario
from unisim_blender.core.sensors.beam_tables import read_beam_table, vlp16
from unisim_blender.core.sensors.lidar import beam_directions
from unisim_blender.core.world.drive import CameraModel, LidarModel, Readouts, RollingShutter, SpinPhase

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")
ALL = {**LENSES, "mei": (Mei(1.9, 0.1, 0.2, 1e-3, -1e-3), RollingShutter(0.02, 0.5))}
MODELS = {name: CameraModel(48, 32, 30.3, 31.7, 24.25, 15.75, shutter, lens) for name, (lens, shutter) in ALL.items()}
SHOWN = np.stack(np.meshgrid(np.linspace(-3, 3, 13), np.linspace(-2, 2, 9)), -1)


def check_lens(lens: Lens) -> None:
    """Check what a lens promises: unit directions or NaN, which project to where they came from."""
    directions = lens.unproject(SHOWN)
    there = np.isfinite(directions).all(-1)
    assert np.abs(np.linalg.norm(directions[there], axis=-1) - 1).max(initial=0) < 1e-9
    plane, valid = lens.project(directions[there])
    assert valid.all() and np.abs(plane - SHOWN[there]).max(initial=0) < 1e-6
    assert np.isfinite(lens.max_angle_rad) and lens.axis_slope > 0


def check_table(model: LidarModel) -> None:
    """Check that a beam table's directions are of length 1 and its times finite."""
    assert np.abs(np.linalg.norm(beam_directions(model), axis=-1) - 1).max(initial=0) < 1e-9
    for values in (model.column_time_s, model.beam_time_s, model.sweep_s, model.time_offset_s):
        assert values is None or np.isfinite(values).all()


def log_reader(folder: Path) -> Reader:
    """What a log says of its sensors."""
    (folder / "meta").mkdir()
    shutters, lenses = {n: m.shutter for n, m in MODELS.items()}, {n: m.lens for n, m in MODELS.items()}
    phase = SpinPhase(np.array([0.0, 0.1, 0.2]), np.array([0.0, 0.01, 0.02]))
    lidars = {"roof": LidarSetup(0, np.eye(4), SPINNING, phase), "side": LidarSetup(1, np.eye(4), UNEVEN)}
    readouts = {"mei": Readouts(np.array([0.0, 0.1]), np.array([1.0, 0.7]))}
    write_setup(folder, LogSetup("a", (0, 1), 0.0, np.zeros(3), shutters, lidars, lenses, readouts))

    def read() -> object:
        setup = read_setup(folder)
        assert setup is not None
        for lens in setup.lenses.values():
            check_lens(lens)
        for lidar in setup.lidars.values():
            check_table(lidar.model)
        return setup

    path = setup_path(folder)
    name = path.relative_to(folder).as_posix()
    whole = {name: path.read_bytes()}
    return Reader(folder, whole, read, inputs_of(whole, {name: ["json"]}), (name,))


def rig_reader(folder: Path) -> Reader:
    """A rig with every lens, and LiDARs with tables of their own."""
    cameras = tuple(RigCamera(name, model, make_pose(np.zeros(3), np.eye(4)[0])) for name, model in MODELS.items())
    lidars = tuple(RigLidar(name, table, np.eye(4)) for name, table in {"roof": SPINNING, "side": UNEVEN}.items())
    write_rig(Rig(cameras, (*lidars, RigLidar("vlp", vlp16(), np.eye(4)))), folder / "rig.json")

    def read() -> object:
        rig = read_rig(folder / "rig.json")
        for camera in rig.cameras:
            check_lens(camera.model.lens)
        for lidar in rig.lidars:
            check_table(lidar.model)
        return rig

    whole = {"rig.json": (folder / "rig.json").read_bytes()}
    return Reader(folder, whole, read, inputs_of(whole, {"rig.json": ["json"]}), ("rig.json",))


def scenario_reader(folder: Path) -> Reader:
    """A scenario that changes a camera's lens and a LiDAR's tables, applied to a drive."""
    drive = turning_drive()
    lidar = next(iter(drive.lidars))
    drive = replace(drive, lidars={lidar: replace(drive.lidars[lidar], model=SPINNING)})
    cameras: list[dict[str, Any]] = [{"id": "front", "lens": ALL["forward"][0].to_dict()}]
    for number, (name, (lens, shutter)) in enumerate(ALL.items()):
        mount = {"position": [1, number, 1], "yaw_deg": 10.0 * number}
        about = {"width": 64, "height": 48, "horizontal_fov_deg": 60.0, "shutter": shutter.to_dict()}
        cameras.append({"id": name, "mount": mount, "lens": lens.to_dict(), **about})
    tables = {"column_azimuth_deg": [40, 15, 0, -15, -40], "column_time_s": [-0.1, -0.08, -0.06, -0.04, -0.02]}
    lidars = [
        {"id": lidar, "columns": 45, "start_azimuth_deg": 20.0},
        {"id": "grille", "elevation_deg": [4, 0, -4], "mount": {"position": [3.6, 0, 0.6]},
         "beam_time_s": [0, 1e-5, 2e-5], **tables},
    ]  # fmt: skip
    document = {
        "format": "unisim-scenario", "version": 1, "name": "all", "log": "log", "edits": [],
        "sensors": {"cameras": cameras, "lidars": lidars},
    }  # fmt: skip

    def read() -> object:
        edited = apply_scenario(load_scenario(folder / "scenario.json"), drive, lambda path: {})
        for camera in edited.cameras.values():
            check_lens(camera.model.lens)
        for one in edited.lidars.values():
            check_table(one.model)
        return edited

    whole = {"scenario.json": json_text(document)}
    return Reader(folder, whole, read, inputs_of(whole, {"scenario.json": ["json"]}), ("scenario.json",))


def table_reader(folder: Path) -> Reader:
    """A beam table's own file."""
    azimuth = np.linspace(1.0, -1.0, 12) ** 3
    document = {
        "row_elevations_rad": [-0.1, 0.1, 0.0], "row_azimuth_offsets_rad": [0.0, 0.01, 0.02], "n_rows": 3,
        "column_azimuths_rad": azimuth.tolist(), "n_columns": 12, "spinning_frequency_hz": 10.0,
        "spinning_direction": "cw", "row_times_s": [0.0, 1e-5, 2e-5], "column_times_s": (-0.01 * np.arange(12)[::-1]).tolist(),
    }  # fmt: skip
    whole = {"table.json": json.dumps(document).encode()}

    def read() -> object:
        model = read_beam_table(folder / "table.json")
        check_table(model)
        return model

    return Reader(folder, whole, read, inputs_of(whole, {"table.json": ["json"]}), ("table.json",))


LOGS, RIGS, SCENARIOS, TABLES = map(Property, (log_reader, rig_reader, scenario_reader, table_reader))


@given(LOGS.inputs)
@example([In("meta/unisim.json", "json", (Scale(("lidars", "roof", "model", "columns"), 1e6),))])
def test_sensors_of_logs(changes: Input) -> None:
    LOGS.check(changes)


@given(RIGS.inputs)
def test_sensors_of_rigs(changes: Input) -> None:
    RIGS.check(changes)


@given(SCENARIOS.inputs)
@example([In("scenario.json", "json", (Scale(("sensors", "cameras", 3, "lens", "k1"), 2e12),))])
def test_sensors_of_scenarios(changes: Input) -> None:
    SCENARIOS.check(changes)


@given(TABLES.inputs)
def test_beam_tables(changes: Input) -> None:
    TABLES.check(changes)
