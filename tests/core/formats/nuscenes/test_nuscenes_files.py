"""nuScenes' files where they are missing, cut off or hostile: one sentence with the file's name."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import nuscenes_street as nuscenes
import pytest
from PIL import Image

from unisim_blender.core.errors import LogError
from unisim_blender.core.formats.nuscenes import scene
from unisim_blender.core.formats.nuscenes.scene import LIDAR
from unisim_blender.core.formats.readers import open_log


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return nuscenes.write(tmp_path_factory.mktemp("nuscenes"), traced=False).root


@pytest.fixture
def path(whole: Path, tmp_path: Path) -> Path:
    shutil.copytree(whole, tmp_path / "data")
    return tmp_path / "data"


def row(table: str, number: int, key: str, value: Any) -> Callable[[Path], None]:
    """A value of a table's row changed; a key removed where it is Ellipsis."""

    def change(path: Path) -> None:
        file = path / "v1.0-mini" / f"{table}.json"
        rows = json.loads(file.read_text())
        if value is ...:
            del rows[number][key]
        else:
            rows[number][key] = value
        file.write_text(json.dumps(rows))

    return change


def text(table: str, content: str) -> Callable[[Path], None]:
    """Another text in place of a table."""

    def change(path: Path) -> None:
        (path / "v1.0-mini" / f"{table}.json").write_text(content)

    return change


def gone(table: str) -> Callable[[Path], None]:
    """A table that is missing."""
    return lambda path: (path / "v1.0-mini" / f"{table}.json").unlink()


def rows_gone(table: str) -> Callable[[Path], None]:
    """A table without rows."""
    return text(table, "[]")


BROKEN: list[tuple[Callable[[Path], None], str]] = [
    (gone("scene"), r"scene\.json: is missing"),
    (gone("ego_pose"), r"ego_pose\.json: is missing"),
    (gone("sample_annotation"), r"sample_annotation\.json: is missing"),
    (text("sample_data", '[{"token": "a"'), r"sample_data\.json: is not valid JSON"),
    (text("sample_data", "{}"), r"sample_data\.json: must be an array"),
    (text("sample", "[1]"), r"sample\.json: \[0\]: must be an object"),
    (rows_gone("scene"), r"holds 0 scenes"),
    (rows_gone("sample"), r"sample\.json: has no sample of scene-0001"),
    (rows_gone("sample_data"), r"sample_data\.json: has no sweep of LIDAR_TOP"),
    (rows_gone("calibrated_sensor"), r"calibrated_sensor\.json: has no row '\w+', nor 2 others"),
    (rows_gone("instance"), r"instance\.json: has no row"),
    (row("sample_data", 0, "timestamp", "now"), r"sample_data\.json: \[0\]\.timestamp: must be a whole number"),
    (row("sample_data", 1, "timestamp", nuscenes.START_US), r"sample_data\.json: .*LIDAR_TOP stands there twice"),
    (row("sample_data", 0, "filename", "../../etc/passwd"), r"filename: is no file inside the dataset's folder"),
    (row("sample_data", 0, "filename", "/etc/passwd"), r"filename: is no file inside the dataset's folder"),
    (row("sample_data", 0, "ego_pose_token", ...), r'sample_data\.json: \[0\]: "ego_pose_token" is missing'),
    (row("sample_data", 0, "calibrated_sensor_token", "x"), r"calibrated_sensor\.json: has no row 'x'"),
    (row("ego_pose", 0, "rotation", [2, 0, 0, 0]), r"ego_pose\.json: \[0\]\.rotation: has length 2, not 1"),
    (row("ego_pose", 0, "translation", [1, 2]), r"ego_pose\.json: \[0\]\.translation: must be 3 numbers"),
    (row("calibrated_sensor", 1, "camera_intrinsic", [[1, 2]]), r"camera_intrinsic: must be 3 x 3 numbers"),
    (row("calibrated_sensor", 1, "camera_intrinsic", [[-1, 0, 0]] * 3), r"has focal lengths that are not positive"),
    (row("sample_annotation", 0, "size", [1, 0, 1]), r"sample_annotation\.json: \[0\]\.size: is not positive"),
    (row("sample_annotation", 1, "rotation", [0, 0, 0, 0]), r"sample_annotation\.json: \[1\]\.rotation: has length 0"),
]


@pytest.mark.parametrize(("change", "sentence"), BROKEN, ids=[sentence[:40] for _, sentence in BROKEN])
def test_a_broken_table_is_one_sentence_with_its_name(
    change: Callable[[Path], None], sentence: str, path: Path
) -> None:
    change(path)
    with pytest.raises(LogError, match=sentence) as raised:
        open_log(path)
    assert "\n" not in str(raised.value)


def test_a_large_table_that_is_cut_off_is_told(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scene, "WHOLE_BYTES", 100)
    file = path / "v1.0-mini/sample_data.json"
    file.write_bytes(file.read_bytes()[:-100])
    with pytest.raises(LogError, match=r"sample_data\.json: is cut off"):
        open_log(path)
    file.write_text("x" * 40_000)
    monkeypatch.setattr(scene, "PIECE_BYTES", 1000)
    with pytest.raises(LogError, match=r"sample_data\.json: is no table of rows"):
        open_log(path)


def test_several_scenes_are_told_apart_by_a_file(path: Path) -> None:
    file = path / "v1.0-mini/scene.json"
    rows = json.loads(file.read_text())
    file.write_text(json.dumps([*rows, {"token": "other", "name": "scene-0002"}]))
    with pytest.raises(LogError, match=r"holds 2 scenes \(scene-0001, scene-0002\); a file of samples/LIDAR_TOP"):
        open_log(path)
    assert open_log(path / nuscenes.sweep_file(1)).drive.name == "scene-0001"
    stray = path / "samples/LIDAR_TOP/stray.pcd.bin"
    stray.write_bytes(b"")
    with pytest.raises(LogError, match=r"stray\.pcd\.bin: is in no table of"):
        open_log(stray)


def test_sweeps_and_images_that_are_not_there_are_said(path: Path) -> None:
    (path / nuscenes.sweep_file(2)).unlink()
    shutil.rmtree(path / "sweeps/CAM_FRONT")
    log = open_log(path)
    assert log.sweep_frames(LIDAR) == (0, 1, 3, 4, 5, 6)
    assert any(one.startswith("LIDAR_TOP: 1 of 7 sweeps are missing, n015") for one in log.missing)
    assert any(one.startswith("CAM_FRONT: 3 of 5 images are missing") for one in log.missing)
    assert len(log.image_frames("CAM_FRONT")) == 2
    with pytest.raises(LogError, match="LIDAR_TOP has no sweep of frame 2"):
        log.sweep(LIDAR, 2)
    shutil.rmtree(path / "sweeps")
    shutil.rmtree(path / "samples/LIDAR_TOP")
    assert not open_log(path).drive.lidars


def test_a_sweep_that_is_cut_off_or_no_columns(path: Path) -> None:
    log = open_log(path)
    file = path / nuscenes.sweep_file(3)
    content = file.read_bytes()
    file.write_bytes(content[:-20])
    with pytest.raises(LogError, match=r"pcd\.bin: is cut off, its \d+ bytes"):
        log.sweep(LIDAR, 3)
    for column, value, sentence in (
        (4, 5.0, "no columns of rings 0 to 31"),
        (1, np.nan, "not finite"),
        (3, np.inf, "not"),
    ):
        table = np.frombuffer(content, "<f4").reshape(-1, 5).copy()
        table[40, column] = value
        table.tofile(file)
        with pytest.raises(LogError, match=rf"pcd\.bin: .*{sentence}"):
            log.sweep(LIDAR, 3)
    file.write_bytes(content * 2)
    with pytest.raises(LogError, match=r"pcd\.bin: has 72\d columns, the scene's longest sweep had 362"):
        log.sweep(LIDAR, 3)


def test_an_image_that_is_cut_off_or_of_another_size(path: Path) -> None:
    log = open_log(path)
    file = log.image_path("CAM_FRONT", log.image_frames("CAM_FRONT")[0])
    assert file is not None
    file.write_bytes(file.read_bytes()[:300])
    with pytest.raises(LogError, match=r"CAM_FRONT.*\.jpg: cannot be decoded"):
        log.image("CAM_FRONT", log.image_frames("CAM_FRONT")[0])
    Image.new("RGB", (8, 8)).save(file)
    with pytest.raises(LogError, match=r"\.jpg: has 8x8 pixels, its table says 96x54"):
        log.image("CAM_FRONT", log.image_frames("CAM_FRONT")[0])
    with pytest.raises(LogError, match="CAM_BACK has no image of frame 99"):
        log.image("CAM_BACK", 99)
