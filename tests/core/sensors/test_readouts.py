"""Images of one camera that take unequally long to be read out: their rays' times, and files and messages that keep them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from small_log import small_drive

from unisim_blender.core.errors import LogError, UnisimError
from unisim_blender.core.formats.common.sensor_file import LogSetup, read_setup, setup_path, write_setup
from unisim_blender.core.json_file import Node
from unisim_blender.core.scenario import apply_scenario, scenario_from_json
from unisim_blender.core.sensors.camera import camera_rays, rays_at_times
from unisim_blender.core.sensors.rays import exposure_window
from unisim_blender.core.sequence.plan import _sensor_parts
from unisim_blender.core.world.captures import Capture
from unisim_blender.core.world.drive import Camera, Readouts, RollingShutter
from unisim_blender.core.world.drive_json import _camera_to_json, _read_camera
from unisim_blender.core.world.encoding import decode_sensor, encode_sensor

STAMPS, STRETCH = np.array([0.0, 0.1, 0.2]), np.array([1.0, 0.5, 2.0])


@pytest.fixture
def camera() -> Camera:
    plain = small_drive().cameras["front_camera"]
    model = replace(plain.model, shutter=RollingShutter(0.02, 0.5))
    return replace(plain, model=model, readouts=Readouts(STAMPS, STRETCH))


@pytest.mark.parametrize(
    ("time_s", "factor"), [(0.0, 1.0), (0.1, 0.5), (0.15, 1.25), (0.2, 2.0), (-9.0, 1.0), (9.0, 2.0)]
)
def test_each_image_has_its_own_duration(camera: Camera, time_s: float, factor: float) -> None:
    height = camera.model.height
    rows = np.array([0.0, height / 2, height])
    times = camera_rays(camera, time_s, np.full(3, 3.5), rows).time_s
    np.testing.assert_allclose(times - time_s, 0.02 * factor * np.array([-0.5, 0, 0.5]), atol=1e-12)
    first, last = exposure_window(camera, time_s)
    assert first <= times[0] and last >= times[-1] and last - first < 0.02 * factor * 1.7
    assert camera.model_at(time_s).shutter.duration_s == pytest.approx(0.02 * factor)


def test_rays_of_several_images_at_once(camera: Camera) -> None:
    """As a training batch has them: as of each image alone, to the bit."""
    u, v, stamps = np.full(6, 2.5), np.array([0.5, 9.5, 20.5] * 2), np.repeat(STAMPS[:2], 3)
    together = rays_at_times(camera, stamps, u, v)
    for i, stamp in enumerate(stamps):
        alone = camera_rays(camera, float(stamp), u[i : i + 1], v[i : i + 1])
        np.testing.assert_array_equal(together.time_s[i], alone.time_s[0])
        np.testing.assert_array_equal(together.origins[i], alone.origins[0])


def test_messages_and_files_keep_them(camera: Camera, tmp_path: Path) -> None:
    sent = decode_sensor(encode_sensor(camera, 0.0, 0.2))
    stored = _read_camera("c", Node(json.loads(json.dumps(_camera_to_json(camera))), "x", UnisimError))
    (tmp_path / "meta").mkdir()
    assert camera.readouts is not None
    shutters = {"c": camera.model.shutter, "even": camera.model.shutter}
    setup = LogSetup("x", (0,), 0.0, np.zeros(3), shutters, {}, readouts={"c": camera.readouts})
    write_setup(tmp_path, setup)
    read = read_setup(tmp_path)
    assert isinstance(sent, Camera) and read is not None and set(read.readouts) == {"c"}
    for found in (sent.readouts, stored.readouts, read.readouts["c"]):
        assert found is not None
        np.testing.assert_array_equal(found.times_s, STAMPS)
        np.testing.assert_array_equal(found.stretch, STRETCH)


def test_files_without_them_are_as_before(camera: Camera) -> None:
    plain = replace(camera, readouts=None)
    assert "readouts" not in _camera_to_json(plain) and "readouts" not in encode_sensor(plain, 0.0, 0.2)


@pytest.mark.parametrize(
    ("member", "value", "sentence"),
    [
        ("times_s", [0.0, 0.0, 0.2], "times_s: must be times that increase"),
        ("stretch", [1.0, 0.0, 2.0], "stretch: must be above 0"),
        ("stretch", [1.0], "stretch"),
    ],
)
def test_wrong_ones_are_one_sentence(
    member: str, value: list[float], sentence: str, camera: Camera, tmp_path: Path
) -> None:
    (tmp_path / "meta").mkdir()
    assert camera.readouts is not None
    setup = LogSetup("x", (0,), 0.0, np.zeros(3), {"c": camera.model.shutter}, {}, readouts={"c": camera.readouts})
    write_setup(tmp_path, setup)
    document = json.loads(setup_path(tmp_path).read_text())
    document["cameras"]["c"]["readouts"][member] = value
    setup_path(tmp_path).write_text(json.dumps(document))
    with pytest.raises(LogError) as found:
        read_setup(tmp_path)
    assert "unisim.json" in str(found.value) and sentence in str(found.value) and "\n" not in str(found.value)


def test_a_frame_depends_on_its_own_alone(camera: Camera) -> None:
    """So that a frame is kept when another image's duration changes."""
    others = replace(camera, readouts=Readouts(STAMPS, np.array([1.0, 0.5, 1.0])))
    captures = [Capture(camera.sensor_id, round(1e6 * camera.time_s[frame]), frame) for frame in (0, 2)]
    same, differs = ([b"".join(_sensor_parts(one, capture)) for one in (camera, others)] for capture in captures)
    assert same[0] == same[1] and differs[0] != differs[1]


def test_a_scenario_moves_them_along_and_replaces_them(camera: Camera) -> None:
    drive = small_drive()
    drive = replace(drive, cameras={camera.sensor_id: camera})
    cameras = [
        {"id": "late", "like": camera.sensor_id, "time_offset_s": 0.05},
        {"id": "still", "like": camera.sensor_id, "shutter": {"duration_s": 0.01}},
    ]
    document = {"format": "unisim-scenario", "version": 1, "name": "s", "log": "log", "sensors": {"cameras": cameras}}
    found = apply_scenario(scenario_from_json({**document, "edits": []}), drive, lambda path: {}).cameras
    readouts = found["late"].readouts
    assert readouts is not None and found["still"].readouts is None
    np.testing.assert_allclose(readouts.times_s, STAMPS + 0.05)
