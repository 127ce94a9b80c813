"""One frame's files: what is in them, and that the same frame gives the same bytes."""

from __future__ import annotations

import errno
import json
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from PIL import Image
from plyfile import PlyData
from tiny_drive import ALL_PASSES, FakeRenderer, tiny_drive

from unisim_blender.core.colour import linear_from_srgb, srgb_from_linear
from unisim_blender.core.errors import OutputError
from unisim_blender.core.files import write_file
from unisim_blender.core.geometry import make_pose, transform_points
from unisim_blender.core.output.frame_files import moment_labels, sweep_points, write_camera, write_labels, write_lidar
from unisim_blender.core.world.captures import Capture, Moment

DRIVE = tiny_drive()
RENDERER = FakeRenderer(DRIVE)


def read_exr(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    file = OpenEXR.File(str(path), separate_channels=True)
    return file.header(), {name: channel.pixels for name, channel in file.channels().items()}


def test_srgb_curve_at_known_points() -> None:
    # 0.5 -> 0.21404114 by IEC 61966-2-1; the linear toe divides by 12.92
    np.testing.assert_allclose(
        linear_from_srgb(np.array([0, 0.02, 0.5, 1])), [0, 0.02 / 12.92, 0.21404114, 1], rtol=1e-6
    )
    values = np.linspace(0, 1, 256, dtype=np.float32)
    np.testing.assert_allclose(srgb_from_linear(linear_from_srgb(values)), values, atol=1e-6)


def test_exr_holds_named_channels_and_metadata(tmp_path: Path) -> None:
    frame = RENDERER.camera("front", 3, ALL_PASSES)
    assert frame.depth_m is not None and frame.instance is not None and frame.unsupported is not None
    _, exr = write_camera(tmp_path, "000003", Capture("front", 300000, 3), 0.3, frame)
    header, channels = read_exr(exr)
    assert set(channels) == {
        *"RGBA",
        *("depth", "z_depth", "normal.X", "normal.Y", "normal.Z", "instance", "opacity", "unsupported"),
    }
    np.testing.assert_allclose(channels["G"], linear_from_srgb(frame.rgb[..., 1]), rtol=1e-3)
    np.testing.assert_array_equal(channels["depth"], frame.depth_m)
    assert np.isinf(channels["depth"][0]).all()
    np.testing.assert_array_equal(channels["instance"], frame.instance)
    assert channels["instance"].dtype == np.float32, "programs scale integers where they read all channels as float"
    np.testing.assert_array_equal(channels["unsupported"] > 0, frame.unsupported)
    assert (channels["A"] == 1).all()
    np.testing.assert_array_equal(header["K"], [[30, 0, 16], [0, 30, 9], [0, 0, 1]])
    np.testing.assert_array_equal(header["world_from_camera"], frame.world_from_camera)
    metadata = json.loads(header["unisim"])
    assert metadata["time_s"] == 0.3 and metadata["frame"] == 3 and metadata["instances"] == ["car", "cone"]
    assert metadata["shutter"] == {"duration_s": 0.0, "reference": 0.5}


def test_exr_holds_no_channel_of_a_pass_that_was_not_rendered(tmp_path: Path) -> None:
    _, exr = write_camera(tmp_path, "000000", Capture("front", 0, 0), 0.0, RENDERER.camera("front", 0))
    assert set(read_exr(exr)[1]) == set("RGBA")


def test_png_stores_srgb_as_it_is(tmp_path: Path) -> None:
    frame = RENDERER.camera("front", 0)
    frame.rgb[0, 0] = [0.0, 0.5, 1.2]
    png, _ = write_camera(tmp_path, "000000", Capture("front", 0, 0), 0.0, frame)
    image = np.asarray(Image.open(png))
    assert image[0, 0].tolist() == [0, 128, 255]
    assert np.abs(image / 255 - np.clip(frame.rgb, 0, 1)).max() <= 0.5 / 255 + 1e-6


def test_sweep_files_agree_and_lie_in_the_sensor_frame(tmp_path: Path) -> None:
    sweep = RENDERER.lidar("top", 2)
    ply, npz = write_lidar(tmp_path, "000002", Capture("top", 200000, 2), 0.2, sweep)
    vertices = PlyData.read(ply)["vertex"]
    arrays = np.load(npz, allow_pickle=False)
    assert [p.name for p in vertices.properties] == ["x", "y", "z", "intensity", "ring", "azimuth", "time", "instance"]
    for name in ("x", "y", "z", "intensity", "ring", "azimuth", "time", "instance"):
        np.testing.assert_array_equal(vertices[name], arrays[name])
    assert len(vertices["x"]) == sweep.returned.sum()
    assert arrays["world_from_lidar"].dtype == np.float64 and arrays["time_s"] == 0.2
    assert arrays["instances"].tolist() == ["car", "cone"]
    local = np.stack([arrays["x"], arrays["y"], arrays["z"]], -1)
    world = (sweep.origins + sweep.directions * sweep.depth_m[..., None])[sweep.returned]
    np.testing.assert_allclose(transform_points(arrays["world_from_lidar"], local), world, atol=1e-5)


def test_azimuth_is_the_firing_angle() -> None:
    sweep = RENDERER.lidar("top", 0)
    points = sweep_points(sweep)
    # the tiny drive does not turn, so a ray's azimuth in its own sensor frame is the direction's in the world
    direction = sweep.directions[sweep.returned]
    expected = np.arctan2(direction[:, 1], direction[:, 0])
    difference = np.angle(np.exp(1j * (points["azimuth"] - expected)))
    assert np.abs(difference).max() < 1e-6


def test_same_frame_same_bytes(tmp_path: Path) -> None:
    def write(folder: Path) -> dict[str, bytes]:
        paths = write_camera(
            folder, "000001", Capture("front", 100000, 1), 0.1, RENDERER.camera("front", 1, ALL_PASSES)
        )
        paths += write_lidar(folder, "000001", Capture("top", 100000, 1), 0.1, RENDERER.lidar("top", 1))
        paths += write_labels(folder, DRIVE, Moment.of_frame(DRIVE, 1, (), ()))
        return {str(path.relative_to(folder)): path.read_bytes() for path in paths}

    first = write(tmp_path / "a")
    assert len(first) == 5
    assert write(tmp_path / "b") == first


def test_labels_give_boxes_in_every_frame_of_reference() -> None:
    labels = moment_labels(DRIVE, Moment.of_frame(DRIVE, 2, (), ()))
    car = next(box for box in labels["boxes"] if box["id"] == "car")
    np.testing.assert_allclose(car["world"]["position"], [12.8, 0.5, 0.75])
    np.testing.assert_allclose(car["ego"]["position"], [11.8, 0.5, 0.75])
    np.testing.assert_allclose(car["velocity_m_s"], [4, 0, 0], atol=1e-9)
    # the camera stands 1 m ahead of and 1.6 m above the ego, axes right, down, forward
    np.testing.assert_allclose(labels["sensors"]["front"]["boxes"]["car"]["position"], [-0.5, 0.85, 10.8], atol=1e-9)
    np.testing.assert_allclose(labels["sensors"]["top"]["boxes"]["car"]["position"], [11.8, 0.5, -1.05], atol=1e-9)
    labels = moment_labels(DRIVE, Moment.of_frame(DRIVE, 3, (), ()))
    assert {box["id"] for box in labels["boxes"]} == {"car"}, "the cone is gone after 0.2 s"


def test_full_disk_is_one_sentence_and_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_space(self: Path, data: bytes) -> None:
        with open(self, "wb") as file:
            file.write(data[:10])
        raise OSError(errno.ENOSPC, "No space left on device")

    path = tmp_path / "labels" / "000000.json"
    write_file(path, b"the old content")
    monkeypatch.setattr(Path, "write_bytes", no_space)
    with pytest.raises(OutputError, match=r"000000\.json: cannot be written: No space left on device"):
        write_file(path, b"the new content, that does not fit")
    assert path.read_bytes() == b"the old content"
    assert [p.name for p in path.parent.iterdir()] == ["000000.json"]


def test_exr_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_space(self: OpenEXR.File, name: str) -> None:
        Path(name).write_bytes(b"half of it")
        raise RuntimeError(f'Failed to write pixel data to image file "{name}". No space left on device.')

    monkeypatch.setattr(OpenEXR.File, "write", no_space)
    with pytest.raises(OutputError, match="No space left on device"):
        write_camera(tmp_path, "000000", Capture("front", 0, 0), 0.0, RENDERER.camera("front", 0))
    assert [p.name for p in (tmp_path / "camera" / "front").iterdir()] == ["000000.png"]


def test_static_copies_are_labelled() -> None:
    from dataclasses import replace

    from unisim_blender.core.world.drive import Box, StaticCopy

    pose = make_pose(np.array([3.0, 1, 0]), np.array([1.0, 0, 0, 0]))
    drive = replace(DRIVE, static_copies=(StaticCopy("copy", Box(np.eye(4), np.ones(3)), pose),))
    assert moment_labels(drive, Moment.of_frame(drive, 0, (), ()))["static_copies"][0]["world"]["position"] == [
        3.0,
        1.0,
        0.0,
    ]
