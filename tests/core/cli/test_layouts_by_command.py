"""A street in every layout that is read: trained for two steps, measured and rendered by the commands."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from unisim_blender.core.cli.main import unisim
from unisim_blender.core.data.log import Log
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import transform_points
from unisim_blender.core.world.own_rates import captures_of

NEEDS = {"ncore": "ncore", "argoverse2": "pyarrow", "waymo": "pyarrow"}
LAYOUTS = ("ncore", "argoverse2", "nuscenes", "kitti", "waymo")
"""PandaSet's is what most other tests of the commands use."""
FRAME = 1


@dataclass
class Drive:
    """A log's path and what a reader makes of it; its first camera and LiDAR; a folder for what is made of it."""

    path: Path
    log: Log
    camera: str
    lidar: str
    out: Path


@pytest.fixture(scope="module", params=LAYOUTS)
def drive(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Drive:
    for package in (NEEDS.get(request.param, "scipy"), "scipy"):
        pytest.importorskip(package, reason=f"{request.param} needs {package}")
    from street_layouts import LAYOUTS as WRITERS

    out = tmp_path_factory.mktemp(request.param)
    log = open_log(WRITERS[request.param](out / "log", 1).log)
    return Drive(log.path, log, next(iter(log.drive.cameras)), next(iter(log.drive.lidars)), out)


def told(*arguments: object) -> str:
    """What a command prints that succeeds."""
    result = CliRunner().invoke(unisim, [str(one) for one in arguments], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def numbers_in(values: Any) -> list[float]:
    """All numbers in a JSON value."""
    if isinstance(values, dict | list):
        return [n for part in (values.values() if isinstance(values, dict) else values) for n in numbers_in(part)]
    return [float(values)] if isinstance(values, int | float) and not isinstance(values, bool) else []


def check_image(drive: Drive, path: Path) -> None:
    """A rendered image is as large as a recorded one, and shows something."""
    with Image.open(path) as image:
        pixels = np.asarray(image)
    assert pixels.shape == drive.log.image(drive.camera, FRAME).shape
    assert pixels.std() > 1


def test_trained_measured_and_rendered(drive: Drive) -> None:
    scene, measured, frames = (drive.out / name for name in ("scene", "measured", "frames"))
    lean = ("--preset", "tiny", "--rays", 512, "--iterations", 2, "--quiet")
    assert "2 steps" in told("train", drive.path, "--out", scene, "--cameras", drive.camera, *lean)

    told("eval", scene, drive.path, "--out", measured, "--frames", FRAME, "--quality", "fast")
    metrics = json.loads((measured / "metrics.json").read_text())
    lidars = len(drive.log.drive.lidars)
    assert metrics["frames"] == [FRAME] and metrics["lidar"]["sweeps"] == lidars
    # a camera that is faster than the LiDAR has images between frames, which are compared, too
    camera, there = drive.log.drive.cameras[drive.camera], drive.log.image_frames(drive.camera)
    images = captures_of(camera.time_s, drive.log.drive, (FRAME,), there)
    assert metrics["camera"]["images"] == len(images) >= 1
    assert all(math.isfinite(number) for number in numbers_in(metrics))
    # two steps of random weights: neither black nor right
    assert 5 < metrics["camera"]["psnr_db"] < 30 and 0 < metrics["camera"]["ssim"] < 1
    assert set(metrics["lidar"]["by_sensor"]) == set(drive.log.drive.lidars)
    assert 0 <= metrics["lidar"]["drop_accuracy"] <= 1 and 0 <= metrics["lidar"]["hit_rate"] <= 1
    assert (measured / "index.html").is_file() and len(list((measured / "images").glob("*.png"))) >= 5

    sensors = f"{drive.camera},{drive.lidar}"
    how = ("--frames", FRAME, "--sensors", sensors, "--quality", "fast", "--jobs", 1)
    told("render", drive.path, "--scene", scene, "--out", frames, *how)
    made = {path.relative_to(frames).as_posix() for path in frames.rglob(f"*{FRAME:06d}.*")}
    stem = f"{FRAME:06d}"
    assert made >= {f"camera/{drive.camera}/{stem}.png", f"lidar/{drive.lidar}/{stem}.npz", f"labels/{stem}.json"}
    check_image(drive, frames / f"camera/{drive.camera}/{stem}.png")
    with np.load(frames / f"lidar/{drive.lidar}/{stem}.npz") as sweep:
        assert np.isfinite(sweep["world_from_lidar"]).all() and len(sweep["x"]) == len(sweep["ring"])
        lidar = drive.log.drive.lidars[drive.lidar]
        assert float(sweep["time_s"]) == pytest.approx(lidar.time_s[FRAME], abs=1e-6)
    labels = json.loads((frames / f"labels/{stem}.json").read_text())
    assert all(math.isfinite(number) for number in numbers_in(labels)) and numbers_in(labels)


@pytest.mark.slow
def test_surfels_show_what_was_recorded(drive: Drive) -> None:
    """A sweep rendered from all frames' surfels has about as many returns as the recorded one, and lies on it."""
    frames = drive.out / "surfels"
    sensors = f"{drive.camera},{drive.lidar}"
    told("render", drive.path, "--renderer", "surfel", "--out", frames, "--frames", FRAME, "--sensors", sensors)
    check_image(drive, frames / f"camera/{drive.camera}/{FRAME:06d}.png")
    recorded = drive.log.sweep(drive.lidar, FRAME)
    with np.load(frames / f"lidar/{drive.lidar}/{FRAME:06d}.npz") as sweep:
        points = np.stack([sweep[axis] for axis in "xyz"], 1)
        assert np.isfinite(points).all() and np.isfinite(sweep["intensity"]).all()
        world = transform_points(sweep["world_from_lidar"], points)
    assert 0.8 < len(world) / len(recorded.points) < 1.1
    from scipy.spatial import KDTree

    away, _ = KDTree(recorded.points).query(world)
    # nuScenes' sweeps do not keep step with each other: columns of the one rendered lie between those recorded
    assert np.median(away) < 0.1 and np.quantile(away, 0.9) < 0.5
