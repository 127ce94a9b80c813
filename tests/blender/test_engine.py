"""F12: the images of `unisim render`, passes, borders, and what a user sees when something is wrong."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import OpenEXR
import pytest
from click.testing import CliRunner
from helpers import imported, select
from numpy.typing import NDArray
from PIL import Image

from unisim_blender.bridge.objects.trajectories import trajectory_of
from unisim_blender.core.cli.main import unisim

FRAME = 9


@pytest.fixture
def small(street: Any) -> Any:
    """The street at a fifth of its size."""
    street.render.engine = "UNISIM"
    street.render.resolution_percentage = 20
    street.frame_set(FRAME)
    return street


def shot(scene: Any, path: Path, exr: bool = False) -> Path:
    """Render the frame that is shown into a file."""
    settings = scene.render.image_settings
    if exr:
        if hasattr(settings, "media_type"):
            settings.media_type = "MULTI_LAYER_IMAGE"
        settings.file_format = "OPEN_EXR_MULTILAYER"
        settings.color_depth = "32"
    else:
        settings.file_format = "PNG"
        settings.color_mode = "RGB"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return path


def pixels(path: Path) -> NDArray[Any]:
    """An image's bytes as integers."""
    return np.asarray(Image.open(path).convert("RGB")).astype(int)


def commanded(scene: Any, folder: Path) -> NDArray[Any]:
    """The same frame by `unisim render`."""
    bpy.ops.unisim.export_scenario(filepath=str(folder / "scenario.json"))
    size = scene.render.resolution_x // 5
    camera = scene.camera.unisim.uid
    arguments = [
        "render",
        str(folder / "scenario.json"),
        "--out",
        str(folder / "out"),
        "--frames",
        str(FRAME),
        "--width",
        str(size),
    ]
    result = CliRunner().invoke(unisim, [*arguments, "--sensors", camera, "--jobs", "1"])
    assert result.exit_code == 0, result.output
    (path,) = (folder / "out" / "camera" / camera).glob("*.png")
    return pixels(path)


def test_f12_is_what_the_command_renders(small: Any, tmp_path: Path) -> None:
    mine = pixels(shot(small, tmp_path / "f12.png"))
    assert small.frame_current == FRAME
    theirs = commanded(small, tmp_path)
    assert mine.shape == theirs.shape
    assert np.abs(mine - theirs).max() <= 1
    assert mine.std() > 10


def test_f12_of_edits_is_what_the_command_renders(small: Any, tmp_path: Path) -> None:
    actors = sorted(o.unisim.uid for o in small.objects if o.unisim.kind == "ACTOR")
    moving = next(uid for uid in actors if trajectory_of(imported(small, "ACTOR", uid)) is not None)
    select(imported(small, "ACTOR", moving))
    bpy.ops.unisim.duplicate_actor(where="LANE_LEFT")
    bpy.ops.unisim.retime_actor(mode="DELAY", seconds=0.3)
    bpy.ops.unisim.shift_ego(left_m=0.7)
    small.frame_set(FRAME)
    mine = pixels(shot(small, tmp_path / "f12.png"))
    theirs = commanded(small, tmp_path)
    assert np.abs(mine - theirs).max() <= 1


def test_passes_in_an_exr(small: Any, tmp_path: Path) -> None:
    layer = small.view_layers[0]
    layer.use_pass_z = layer.use_pass_normal = layer.use_pass_object_index = True
    small.unisim.opacity_pass = True
    path = shot(small, tmp_path / "f12.exr", exr=True)
    channels: dict[str, NDArray[Any]] = {}
    with OpenEXR.File(str(path), separate_channels=True) as file:
        for part in file.parts:
            channels |= {name: channel.pixels for name, channel in part.channels.items()}
    short = {name.split(".", 1)[-1]: values for name, values in channels.items()}
    depth = next(v for k, v in short.items() if k.startswith("Depth"))
    index = next(v for k, v in short.items() if k.startswith("IndexOB") or k.startswith("Object Index"))
    normal = np.stack([next(v for k, v in short.items() if k == f"Normal.{axis}") for axis in "XYZ"], -1)
    opacity = next(v for k, v in short.items() if k.startswith("Opacity"))
    assert 1 < np.median(depth) < 200
    assert set(np.unique(index)) - {0} <= {float(o.pass_index) for o in small.objects if o.unisim.kind == "ACTOR"}
    assert (index > 0).any()
    length = np.linalg.norm(normal, axis=-1)
    assert np.minimum(np.abs(length - 1), length).max() < 0.02  # nothing was hit where there is none
    assert (length[opacity > 0.9] > 0.5).mean() > 0.95
    lower = normal[-normal.shape[0] // 8 :]
    assert np.median(lower[..., 2]) > 0.8  # the road looks up


def test_a_border_is_a_part_of_the_whole(small: Any, tmp_path: Path) -> None:
    whole = pixels(shot(small, tmp_path / "whole.png"))
    render = small.render
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.75, 0.5, 1.0
    part = pixels(shot(small, tmp_path / "part.png"))
    height, width = whole.shape[:2]
    left, lower = int(0.25 * width), int(0.5 * height)
    assert np.abs(part - whole[: part.shape[0], left : left + part.shape[1]]).max() <= 1
    assert part.shape[0] in (height - lower, height - lower - 1)
    render.use_crop_to_border = False
    black = pixels(shot(small, tmp_path / "black.png"))
    assert black.shape == whole.shape and black[-1].max() == 0
    assert np.abs(black[: part.shape[0] - 1, left : left + part.shape[1]] - part[:-1]).max() <= 1


def test_f12_of_a_frame_outside_the_drive_is_marked(small: Any, tmp_path: Path) -> None:
    small.render.resolution_percentage = 10
    small.frame_set(small.frame_end)
    last = pixels(shot(small, tmp_path / "last.png"))
    small.frame_set(small.frame_end + 1)
    outside = pixels(shot(small, tmp_path / "outside.png"))
    assert last.max() > 200 and outside.max() < 180  # nothing is left of a bright sky
    assert np.abs(outside[:, 10:] - outside[:, :-10]).mean() > 20  # from stripe to stripe


def test_any_camera_sees(small: Any, tmp_path: Path) -> None:
    data = bpy.data.cameras.new("above")
    above = bpy.data.objects.new("above", data)
    small.collection.objects.link(above)
    above.location = np.array(small.camera.matrix_world.translation) + [0.0, 0.0, 6.0]
    above.rotation_euler = (np.radians(70), 0.0, np.radians(-90))
    small.camera = above
    image = pixels(shot(small, tmp_path / "above.png"))
    assert image.std() > 5


def test_a_log_without_a_trained_scene_is_rendered_by_its_surfels(
    scene: Any, street_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    assert bpy.ops.unisim.import_log(filepath=str(street_log)) == {"FINISHED"}
    scene.render.engine = "UNISIM"
    scene.frame_set(1)
    image = pixels(shot(scene, tmp_path / "surfels.png"))
    (recorded,) = (street_log / "camera" / scene.camera.unisim.uid).glob("01.*")
    error = np.abs(image - pixels(recorded)).mean()
    assert image.std() > 5 and error < 30, f"{error} of 255 beside the recorded image"


@pytest.mark.slow
def test_f12_through_a_fisheye_is_what_the_command_renders(
    scene: Any, street_log: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The lens and the shutter of its columns are the log's: the frame is the camera's own, not that of Blender's pinhole."""
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    log = tmp_path / "log"
    shutil.copytree(street_log, log)
    setup = json.loads((log / "meta" / "unisim.json").read_text())
    for camera in setup["cameras"].values():
        camera["lens"] = {"type": "opencv_fisheye", "k1": -0.02}
        camera["shutter"] = {"duration_s": -0.03, "reference": 0.5, "axis": "columns"}
    (log / "meta" / "unisim.json").write_text(json.dumps(setup))
    assert bpy.ops.unisim.import_log(filepath=str(log)) == {"FINISHED"}
    scene.render.engine = "UNISIM"
    scene.frame_set(1)
    mine = pixels(shot(scene, tmp_path / "f12.png"))
    assert bpy.ops.unisim.export_scenario(filepath=str(tmp_path / "scenario.json")) == {"FINISHED"}
    name = scene.camera.unisim.uid
    arguments = ["--out", str(tmp_path / "out"), "--frames", "1", "--sensors", name, "--jobs", "1"]
    result = CliRunner().invoke(unisim, ["render", str(tmp_path / "scenario.json"), *arguments])
    assert result.exit_code == 0, result.output
    (path,) = (tmp_path / "out" / "camera" / name).glob("*.png")
    theirs = pixels(path)
    assert mine.shape == theirs.shape and mine.std() > 5
    assert np.abs(mine - theirs).max() <= 1
