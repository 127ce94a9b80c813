"""What of a log's files is read when it is opened, and when one sweep or one image of it is asked for: no more than that needs.

Readers that open files in Python are watched. Those that leave it to Arrow have all else broken, and work nevertheless.
"""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any

import kitti_street as kitti
import numpy as np
import nuscenes_street as nuscenes
import pytest
from kitti_street import KittiStreet
from opened_files import opened_below
from small_log import write_small_log

from unisim_blender.core.errors import LogError
from unisim_blender.core.formats.kitti import registration
from unisim_blender.core.formats.kitti.read import KittiLog
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.world.drive_json import drive_to_json

DATA = (".bin", ".png", ".jpg")


def data_of(opened: Collection[str]) -> set[str]:
    """Of opened files those of images and sweeps."""
    return {name for name in opened if name.endswith(DATA) or re.search(r"lidar/\d+\.pkl\.gz$", name)}


def opened_by(folder: Path, work: Callable[[], object]) -> set[str]:
    """The images and sweeps below a folder that are opened by something."""
    with opened_below(folder) as opened:
        work()
    return data_of(opened)


def test_pandasets_layout(tmp_path: Path) -> None:
    write_small_log(tmp_path)
    head = {"camera/front_camera/00.jpg"}  # its header tells the images' size
    assert opened_by(tmp_path, lambda: open_log(tmp_path)) == head
    log = open_log(tmp_path)
    assert opened_by(tmp_path, lambda: log.sweep("pandar64", 1)) == {"lidar/01.pkl.gz"}
    assert opened_by(tmp_path, lambda: log.image("front_camera", 1)) == {"camera/front_camera/01.jpg"}


def test_nuscenes(tmp_path: Path) -> None:
    """Four sweeps tell the beams; of all others the sizes alone are looked at."""
    made = nuscenes.write(tmp_path, traced=False)
    told = {nuscenes.sweep_file(sweep) for sweep in (0, 2, 4, 6)}
    assert opened_by(tmp_path, lambda: open_log(tmp_path)) == told
    log = open_log(tmp_path)
    assert len(log.sweep_frames("LIDAR_TOP")) == len(made.stamps_us) == 7
    assert opened_by(tmp_path, lambda: log.sweep("LIDAR_TOP", 3)) == {nuscenes.sweep_file(3)}
    assert opened_by(tmp_path, lambda: log.sweep_grid("LIDAR_TOP", 5)) == {nuscenes.sweep_file(5)}
    path = log.image_path("CAM_BACK", 1)
    assert path is not None
    assert opened_by(tmp_path, lambda: log.image("CAM_BACK", 1)) == {path.relative_to(tmp_path).as_posix()}


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> KittiStreet:
    made = kitti.record(tmp_path_factory.mktemp("kitti") / "2011_09_26/drive", 1)
    kitti.write_raw(made)
    return made


def test_kitti_raw(street: KittiStreet, monkeypatch: pytest.MonkeyPatch) -> None:
    """Some sweeps tell beams and spin when a drive is opened for the first time, and none later."""
    monkeypatch.setattr(registration, "BEAM_SWEEPS", 2)  # the first and the last
    monkeypatch.setattr(registration, "TRIED_SWEEPS", 4)  # those in the middle, of which one pair is far enough apart
    path = street.path
    for camera in ("image_02", "image_03"):  # the first image's header tells the size
        first = path / camera / "data/0000000000.png"
        first.write_bytes(first.read_bytes()[:24])
    heads = {f"{camera}/data/0000000000.png" for camera in ("image_02", "image_03")}
    told = {f"velodyne_points/data/{frame:010d}.bin" for frame in (0, 1, 4, 5)}
    assert opened_by(path, lambda: open_log(path)) == heads | told
    assert opened_by(path, lambda: open_log(path)) == heads
    log = open_log(path)
    check_one_by_one(log, path, "velodyne_points/data/{:010d}.bin", "image_02/data/{:010d}.png")


def test_kitti_tracking(street: KittiStreet, tmp_path: Path) -> None:
    path = kitti.write_tracking(street, tmp_path)
    shutil.rmtree(tmp_path / "velodyne")
    shutil.copytree(street.path / "velodyne_points/data", tmp_path / "velodyne/0003")
    heads = {"image_02/0003/0000000000.png"}
    open_log(path)
    assert opened_by(tmp_path, lambda: open_log(path)) == heads
    log = open_log(path)
    check_one_by_one(log, tmp_path, "velodyne/0003/{:010d}.bin", "image_02/0003/{:010d}.png")


def check_one_by_one(log: Any, folder: Path, sweep: str, image: str) -> None:
    """One sweep, image and grid at a time; the first grid looks for the cells that the vehicle blocks."""
    assert isinstance(log, KittiLog)
    assert opened_by(folder, lambda: log.sweep("velodyne", 3)) == {sweep.format(3)}
    assert opened_by(folder, lambda: log.image("image_02", 2)) == {image.format(2)}
    assert opened_by(folder, lambda: log.sweep_grid("velodyne", 1)) == {sweep.format(n) for n in range(6)}
    assert opened_by(folder, lambda: log.sweep_grid("velodyne", 4)) == {sweep.format(4)}


def test_argoverse2(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    from argoverse2_street import Argoverse2Street

    from unisim_blender.core.formats.argoverse2 import read as reader

    monkeypatch.setattr(reader, "SAMPLED", 2)  # the first and the last tell the beams
    made, camera = Argoverse2Street(sweeps=3), "ring_front_center"
    made.write(tmp_path)
    known = open_log(tmp_path)
    rgb = known.image(camera, 1)
    images = sorted((tmp_path / "sensors/cameras" / camera).iterdir())
    kept, middle = known.image_path(camera, 1), tmp_path / f"sensors/lidar/{made.stamps_ns[1]}.feather"
    for path in {*images, middle} - {kept}:
        path.write_bytes(b"broken")
    log = open_log(tmp_path)
    assert len(log.sweep_frames("up_lidar")) == 3
    np.testing.assert_array_equal(log.image(camera, 1), rgb)
    np.testing.assert_array_equal(log.sweep("up_lidar", 2).points, known.sweep("up_lidar", 2).points)
    assert log.sweep_grid("down_lidar", 2).returned.any()
    with pytest.raises(LogError, match=f"{middle.name}: is no Feather file"):
        log.sweep("up_lidar", 1)
    other = log.image_path(camera, 0)
    assert other is not None and other != kept
    with pytest.raises(LogError, match=f"{other.name}: is no JPEG"):
        log.image(camera, 0)


JPEGS = "[CameraImageComponent].image"
VALUES = {
    "lidar": ("[LiDARComponent].range_image_return1.values", "[LiDARComponent].range_image_return2.values"),
    "lidar_pose": ("[LiDARPoseComponent].range_image_return1.values",),
}


def break_columns(path: Path, names: Collection[str], kept: int | None = None) -> list[int]:
    """Overwrite columns of a Parquet file in all groups of rows but that which holds the row ``kept``; the broken rows."""
    from pyarrow import parquet

    about = parquet.read_metadata(str(path))
    data, first = bytearray(path.read_bytes()), 0
    broken: list[int] = []
    for number in range(about.num_row_groups):
        group = about.row_group(number)
        rows = range(first, first + group.num_rows)
        first = rows.stop
        if kept in rows:
            continue
        broken += rows
        for column in map(group.column, range(group.num_columns)):
            if column.path_in_schema.removesuffix(".list.element") in names:
                start = min(filter(None, (column.dictionary_page_offset, column.data_page_offset)))
                data[start : start + column.total_compressed_size] = b"\xff" * column.total_compressed_size
    assert bytes(data) != path.read_bytes()
    path.write_bytes(data)
    return broken


def test_waymo(tmp_path: Path) -> None:
    """Of the columns with images and returns, nothing is read to open a segment; one sweep reads none with images, and both
    nothing outside of their own group of rows."""
    pytest.importorskip("pyarrow", reason="the extra parquet is not installed")
    from waymo_street import SEGMENT, WaymoStreet

    file = f"{SEGMENT}.parquet"
    WaymoStreet().write(tmp_path / "whole")
    known = open_log(tmp_path / "whole")
    shutil.copytree(tmp_path / "whole", tmp_path / "opened")
    break_columns(tmp_path / "opened/camera_image" / file, [JPEGS])
    for part, names in VALUES.items():
        break_columns(tmp_path / "opened" / part / file, names)
    opened = open_log(tmp_path / "opened")
    assert drive_to_json(opened.drive) == drive_to_json(known.drive) and opened.missing == known.missing
    with pytest.raises(LogError, match=re.escape(file)):
        opened.image("front", 1)
    with pytest.raises(LogError, match=re.escape(file)):
        opened.sweep("top", 1)

    shutil.copytree(tmp_path / "whole", tmp_path / "swept")
    break_columns(tmp_path / "swept/camera_image" / file, [JPEGS])
    for part, names in VALUES.items():
        row = known._sweeps[1][part == "lidar_pose"]  # type: ignore[attr-defined]
        assert break_columns(tmp_path / "swept" / part / file, names, kept=row)
    swept = open_log(tmp_path / "swept")
    np.testing.assert_array_equal(swept.sweep("top", 1).points, known.sweep("top", 1).points)

    shutil.copytree(tmp_path / "whole", tmp_path / "seen")
    rows = known._images["front"]  # type: ignore[attr-defined]
    broken = break_columns(tmp_path / "seen/camera_image" / file, [JPEGS], kept=rows[1])
    seen = open_log(tmp_path / "seen")
    np.testing.assert_array_equal(seen.image("front", 1), known.image("front", 1))
    other = next(frame for frame, row in rows.items() if row in broken)
    with pytest.raises(LogError, match=re.escape(file)):
        seen.image("front", other)
