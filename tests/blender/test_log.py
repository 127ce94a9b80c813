"""A log without a trained scene: images behind the cameras, points in the view, training from Blender."""

from __future__ import annotations

import resource
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from click.testing import CliRunner
from helpers import REAL_LOG, read

from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.core.cli.main import unisim
from unisim_blender.editing.layout.chart import WIDTH
from unisim_blender.process.background import CURVE, PREVIEW, curve_icon


@pytest.fixture
def logged(scene: Any, street_log: Path) -> Any:
    """A scene with that log imported."""
    assert bpy.ops.unisim.import_log(filepath=str(street_log)) == {"FINISHED"}
    return scene


def test_a_log_alone_is_no_edit(logged: Any) -> None:
    assert read(logged).edits == () and read(logged).scene is None
    assert source_of(logged).scene_path is None


def test_a_log_is_dropped_by_any_of_its_files(scene: Any, street_log: Path) -> None:
    files = sorted(street_log.rglob("*.json"))
    assert len({path.parent for path in files}) > 2
    for path in files:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        assert bpy.ops.unisim.import_drive(filepath=str(path)) == {"FINISHED"}
        assert source_of(bpy.context.scene).log_path == street_log, path


def test_recorded_images_are_behind_the_cameras(logged: Any) -> None:
    for camera in imported_objects(logged, "CAMERA"):
        (shown,) = camera.data.background_images
        assert camera.data.show_background_images and shown.image.size[0] > 0
        assert shown.image_user.frame_duration == 3


def test_recorded_points(logged: Any) -> None:
    logged.frame_set(1)
    assert bpy.ops.unisim.show_points(recorded=True, simulated=False) == {"FINISHED"}
    source = source_of(logged)
    assert source.log is not None
    name = next(iter(source.drive.lidars))
    (one,) = imported_objects(logged, "POINTS")
    recorded = source.log.sweep(name, 1).points
    count = len(one.data.vertices)
    assert count > 1000
    out = np.empty(3 * count, np.float32)
    one.data.vertices.foreach_get("co", out)
    step = -(-len(recorded) // count)
    assert np.abs(out.reshape(-1, 3) - recorded[::step][:count]).max() < 1e-3
    assert {"intensity", "class", "depth"} <= {a.name for a in one.data.attributes}
    depth = np.empty(count, np.float32)
    one.data.attributes["depth"].data.foreach_get("value", depth)
    sensor = source.drive.lidars[name].world_from_lidar.at(source.drive.lidars[name].time_s[1])[:3, 3]
    assert (
        np.abs(np.linalg.norm(out.reshape(-1, 3) - sensor, axis=1) - depth).max() < 1.5
    )  # the vehicle moves during a sweep
    logged.frame_set(2)
    assert len(next(imported_objects(logged, "POINTS")).data.vertices) > 1000


@pytest.mark.slow
def test_training_from_blender(logged: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "scene"
    monkeypatch.setattr("unisim_blender.features.training.PREVIEW_S", 0.0)
    assert bpy.ops.unisim.train(directory=str(folder), minutes=0.1, width=64, preset="tiny", frames=":") == {"FINISHED"}
    assert (folder / "scene.json").is_file()
    assert bpy.data.images[PREVIEW].size[0] == 2 * 64 and bpy.data.images[CURVE].size[0] == WIDTH
    assert curve_icon() is not None
    assert bpy.ops.unisim.import_scene(filepath=str(folder / "scene.json")) == {"FINISHED"}
    assert source_of(logged).scene_path == folder
    assert read(logged).edits == ()


def test_edits_survive_another_import(logged: Any, street_log: Path) -> None:
    one = next(o for o in imported_objects(logged, "ACTOR") if o.animation_data is None)
    one.location.x += 1.5
    gone = next(o for o in imported_objects(logged, "ACTOR") if o is not one)
    bpy.data.objects.remove(gone)
    before = read(logged).edits
    assert len(before) == 2
    assert bpy.ops.unisim.import_log(filepath=str(street_log)) == {"FINISHED"}
    assert read(logged).edits == before


def test_another_log_is_refused(logged: Any, tmp_path: Path) -> None:
    result = CliRunner().invoke(
        unisim, ["synth", str(tmp_path / "other"), "--frames", "2", "--width", "48", "--height", "27"]
    )
    assert result.exit_code == 0
    with pytest.raises(RuntimeError, match="already"):
        bpy.ops.unisim.import_log(filepath=str(tmp_path / "other"))


def test_a_real_log(scene: Any) -> None:
    if not REAL_LOG.is_dir():
        pytest.skip(f"no real log at {REAL_LOG}; set UNISIM_PANDASET to a PandaSet sequence")
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begun = time.monotonic()
    assert bpy.ops.unisim.import_log(filepath=str(REAL_LOG)) == {"FINISHED"}
    print(
        f"{time.monotonic() - begun:.1f} s, {(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024:.0f} MiB more"
    )
    drive = source_of(scene).drive
    assert len(list(imported_objects(scene, "ACTOR"))) == len(drive.actors)
    assert read(scene).edits == () and read(scene).sensors is None
