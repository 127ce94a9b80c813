"""`unisim synth`, and what the reader gives back of the log it wrote."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from unisim_blender.core.errors import LogError, OutputError
from unisim_blender.core.evaluation.metrics import psnr
from unisim_blender.core.formats.pandaset.read import PandasetLog
from unisim_street.commands.synth import command
from unisim_street.street import Street, load_street
from unisim_street.truth import truth_camera, truth_lidar
from unisim_street.write import write_log

OPTIONS = [
    "--frames",
    "3",
    "--width",
    "96",
    "--height",
    "54",
    "--seed",
    "7",
    "--cameras",
    "front_camera,back_camera",
    "--quiet",
]
LIDAR = "pandar64"


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("street") / "log"
    result = CliRunner().invoke(command, [str(out), *OPTIONS, "--jobs", "2"], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return out


@pytest.fixture(scope="module")
def street(path: Path) -> Street:
    return load_street(path)


@pytest.fixture(scope="module")
def log(path: Path) -> PandasetLog:
    return PandasetLog(path)


def test_drive_reads_back(street: Street, log: PandasetLog) -> None:
    read, made = log.drive, street.drive
    assert read.frames == made.frames and read.time_s == made.time_s
    np.testing.assert_allclose(read.world_origin, made.world_origin, atol=1e-12)
    np.testing.assert_allclose(read.world_from_ego.poses, made.world_from_ego.poses, atol=1e-12)
    assert set(read.cameras) == {"front_camera", "back_camera"} == set(made.cameras)
    for name, camera in made.cameras.items():
        assert read.cameras[name].model == camera.model and read.cameras[name].time_s == camera.time_s
        np.testing.assert_allclose(
            read.cameras[name].world_from_camera.poses, camera.world_from_camera.poses, atol=1e-12
        )
    lidar = made.lidars[LIDAR]
    np.testing.assert_allclose(read.lidars[LIDAR].world_from_lidar.poses, lidar.world_from_lidar.poses, atol=1e-12)


def test_actors_read_back(street: Street, log: PandasetLog) -> None:
    assert set(log.drive.actors) == set(street.drive.actors)
    for uid, made in street.drive.actors.items():
        read = log.drive.actors[uid]
        assert (read.label, read.is_moving, read.appearance) == (made.label, made.is_moving, made.appearance), uid
        np.testing.assert_allclose(read.size_m, made.size_m, atol=1e-12)
        np.testing.assert_allclose(read.world_from_actor.at(0.13), made.world_from_actor.at(0.13), atol=1e-9)
    assert {actor.label for actor in street.drive.actors.values()} >= {
        "Car",
        "Cones",
        "Pickup Truck",
        "Medium-sized Truck",
    }


def test_images_are_the_truth(street: Street, log: PandasetLog) -> None:
    for name in log.drive.cameras:
        for frame in (0, 2):
            truth = truth_camera(street, log.drive, name, frame).rgb
            assert psnr(log.image(name, frame) / np.float32(255), truth) > 33, (name, frame)


def test_sweeps_are_the_truth_within_the_noise(street: Street, log: PandasetLog) -> None:
    truth = truth_lidar(street, log.drive, LIDAR, 1)
    grid = log.sweep_grid(LIDAR, 1)
    np.testing.assert_array_equal(grid.returned, truth.returned)
    error = (grid.depth_m.astype(np.float64) - truth.depth_m)[truth.returned]
    sigma = street.recipe.range_noise_m
    assert (
        error.std() == pytest.approx(sigma, rel=0.05)
        and abs(error.mean()) < 0.1 * sigma
        and np.abs(error).max() < 7 * sigma
    )
    np.testing.assert_allclose(grid.intensity[truth.returned], truth.intensity[truth.returned], atol=1e-6)
    np.testing.assert_allclose(grid.directions, truth.directions, atol=1e-9)


def test_writing_again_gives_the_same_bytes(path: Path, tmp_path: Path) -> None:
    again = CliRunner().invoke(command, [str(tmp_path / "again"), *OPTIONS, "--jobs", "1"], catch_exceptions=False)
    assert again.exit_code == 0, again.output
    assert contents(tmp_path / "again") == contents(path)


def test_a_kill_leaves_no_log_and_no_process_and_the_next_run_completes_it(path: Path, tmp_path: Path) -> None:
    out = tmp_path / "log"
    command_line = [sys.executable, "-m", "unisim_blender", "synth", str(out), *OPTIONS, "--jobs", "2"]
    process = subprocess.Popen(command_line, stdout=subprocess.PIPE)
    try:
        deadline = time.monotonic() + 100
        while not list(out.rglob("*.jpg")):
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.01)
    finally:
        process.kill()
    process.communicate(timeout=60)  # the pipe is closed when the last worker has ended
    (out / "lidar").mkdir(exist_ok=True)
    (out / "lidar" / ".00.pkl.gz.77.partial").write_bytes(b"half")
    with pytest.raises(LogError, match=r"lidar/timestamps\.json: is missing"):
        PandasetLog(out)
    again = CliRunner().invoke(command, [str(out), *OPTIONS, "--jobs", "2"], catch_exceptions=False)
    assert again.exit_code == 0, again.output
    assert contents(out) == contents(path)


def contents(folder: Path) -> dict[Path, bytes]:
    return {file.relative_to(folder): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


def test_a_folder_that_holds_something_else_is_left_alone(street: Street, tmp_path: Path) -> None:
    (tmp_path / "letter.txt").write_text("dear")
    with pytest.raises(OutputError, match="holds no street"):
        write_log(street, tmp_path, 1, progress=False)
    assert [file.name for file in tmp_path.iterdir()] == ["letter.txt"]
    (tmp_path / "letter.txt").unlink()
    (tmp_path / "street.json").write_text('{"format": "unisim-street", "version": 1, "seed": 8}')
    with pytest.raises(OutputError, match="another street, of seed 8"):
        write_log(street, tmp_path, 1, progress=False)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not a street's recipe"),
        ("[]", "format"),
        ('{"format": "unisim-street", "version": 9}', "version 9"),
        ('{"format": "unisim-street", "version": 1, "frames": 0}', "frames.*not 0"),
        ('{"format": "unisim-street", "version": 1, "cameras": "front_camera"}', "cameras"),
        ('{"format": "unisim-street", "version": 1, "wheels": 4}', "wheels"),
    ],
)
def test_bad_recipe_files(text: str, message: str, tmp_path: Path) -> None:
    file = tmp_path / "street.json"
    file.write_text(text)
    with pytest.raises(LogError, match=f"street.json: .*{message}"):
        load_street(tmp_path)


def test_missing_recipe(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="street.json: is missing"):
        load_street(tmp_path)


def test_recipe_names_all_it_depends_on(path: Path, street: Street) -> None:
    document = json.loads((path / "street.json").read_text())
    assert document["seed"] == 7 and document["frames"] == 3 and document["range_noise_m"] == 0.01
    assert load_street(path / "street.json").recipe == street.recipe
