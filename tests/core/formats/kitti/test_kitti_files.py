"""KITTI's files where they are missing, cut off or hostile: one sentence with the file's name."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import kitti_street as kitti
import numpy as np
import pytest
from kitti_street import KittiStreet
from PIL import Image

from unisim_blender.core.errors import LogError
from unisim_blender.core.formats.kitti.files import read_points
from unisim_blender.core.formats.kitti.read import LIDAR
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.render.tracers.surfels.cache import build_key
from unisim_blender.core.render.tracers.surfels.model import SurfelSettings


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> KittiStreet:
    made = kitti.record(tmp_path_factory.mktemp("kitti") / "2011_09_26/drive", 1)
    kitti.write_raw(made)
    return made


@pytest.fixture
def path(whole: KittiStreet, tmp_path: Path) -> Path:
    shutil.copytree(whole.path.parent, tmp_path / "2011_09_26")
    return tmp_path / "2011_09_26/drive"


def replaced(name: str, before: str, after: str) -> Callable[[Path], None]:
    """A change of a text file."""

    def change(path: Path) -> None:
        text = (path / name).read_text()
        assert before in text
        (path / name).write_text(text.replace(before, after, 1))

    return change


def cut(name: str, keep: int) -> Callable[[Path], None]:
    """A file that ends early."""

    def change(path: Path) -> None:
        (path / name).write_bytes((path / name).read_bytes()[:keep])

    return change


BROKEN: list[tuple[Callable[[Path], None], str]] = [
    (lambda path: (path.parent / "calib_cam_to_cam.txt").unlink(), r"calib_cam_to_cam\.txt: is missing"),
    (lambda path: (path.parent / "calib_velo_to_cam.txt").unlink(), r"calib_velo_to_cam\.txt: is missing"),
    (replaced("../calib_velo_to_cam.txt", "R: ", "Q: "), r"calib_velo_to_cam\.txt: R is missing"),
    (replaced("../calib_velo_to_cam.txt", "R: 0.0", "R: 5.0"), r"calib_velo_to_cam\.txt: R is no rotation"),
    (replaced("../calib_velo_to_cam.txt", "T: ", "T: 1 "), r"calib_velo_to_cam\.txt: T has 4 numbers, not 3"),
    (
        replaced("../calib_imu_to_velo.txt", "R: ", "R: x"),
        r"calib_imu_to_velo\.txt: R \(line 2\) holds what is no number",
    ),
    (
        replaced("../calib_cam_to_cam.txt", "P_rect_02: 5", "P_rect_02: -5"),
        r"calib_cam_to_cam\.txt: P_rect_02 is no pro",
    ),
    (replaced("../calib_cam_to_cam.txt", "P_rect_02: 5", "P_rect_02: nan 5"), r"calib_cam_to_cam\.txt: .*not finite"),
    (
        cut("velodyne_points/timestamps.txt", 60),
        r"timestamps\.txt: holds 2 timestamps, too few for frame 5|no timestamp",
    ),
    (cut("velodyne_points/timestamps.txt", 0), r"timestamps\.txt: holds no timestamp"),
    (replaced("velodyne_points/timestamps.txt", "2011", "soon"), r"timestamps\.txt: line 1 is no timestamp: 'soon-09"),
    (replaced("velodyne_points/timestamps.txt", ":26.", ":27."), r"timestamps\.txt: frame \d is .* s after frame \d"),
    (replaced("velodyne_points/timestamps_end.txt", "13:02", "12:02"), r"velodyne_points: the turn of frame \d starts"),
    (cut("oxts/data/0000000002.txt", 0), r"0000000002\.txt: is empty"),
    (cut("oxts/data/0000000002.txt", 20), r"0000000002\.txt: line 1 is no record, it has \d values"),
    (replaced("oxts/data/0000000002.txt", "49.", "490"), r"0000000002\.txt: line 1 is no place on earth"),
    (cut("tracklet_labels.xml", 500), r"tracklet_labels\.xml: is not valid XML"),
    (
        replaced("tracklet_labels.xml", "<!DOCTYPE b", '<!ENTITY a "b"><!DOCTYPE b'),
        r"tracklet_labels\.xml: refused, it dec",
    ),
    (replaced("tracklet_labels.xml", "<h>", "<h>-"), r"tracklet_labels\.xml: tracklet 0 has the size"),
    (replaced("tracklet_labels.xml", "<tx>", "<tx>inf"), r"tracklet_labels\.xml: tracklet 0, pose 0: tx holds"),
    (replaced("tracklet_labels.xml", "<rz>", "<rq>"), r"tracklet_labels\.xml: is not valid XML|has no rz"),
    (
        replaced("tracklet_labels.xml", "<tracklets", "<trackles"),
        r"tracklet_labels\.xml: is not valid XML|no tracklets",
    ),
    (cut("image_02/data/0000000000.png", 10), r"0000000000\.png: is no PNG image"),
    (cut("velodyne_points/data/0000000000.bin", 1001), r"0000000000\.bin: is cut off, its 1001 bytes"),
]


@pytest.mark.parametrize(("change", "sentence"), BROKEN, ids=[sentence[:40] for _, sentence in BROKEN])
def test_a_broken_file_is_one_sentence_with_its_name(change: Callable[[Path], None], sentence: str, path: Path) -> None:
    change(path)
    with pytest.raises(LogError, match=sentence) as raised:
        open_log(path)
    assert "\n" not in str(raised.value)


def test_frames_without_a_file_are_said(path: Path) -> None:
    (path / "velodyne_points/data/0000000003.bin").unlink()
    (path / "image_02/data/0000000001.png").unlink()
    (path / "image_02/data/0000000002.png").unlink()
    log = open_log(path)
    assert log.drive.frames == tuple(range(kitti.FRAMES)) and 3 not in log.sweep_frames(LIDAR)
    assert "velodyne_points: no sweeps of 1 of 6 frames: 3" in log.missing
    assert "image_02: no images of 2 of 6 frames: 1-2" in log.missing
    with pytest.raises(LogError, match="velodyne has no sweep of frame 3"):
        log.sweep(LIDAR, 3)
    with pytest.raises(LogError, match="image_02 has no image of frame 1"):
        log.image("image_02", 1)


def test_lines_of_lost_sweeps_are_empty(path: Path) -> None:
    """As in 2011_09_26_drive_0009_sync: what was recorded of the other frames is theirs, and images have their own times."""
    whole = open_log(path)
    (path / "velodyne_points/data/0000000002.bin").unlink()
    for name in ("timestamps", "timestamps_start", "timestamps_end"):
        file = path / f"velodyne_points/{name}.txt"
        lines = file.read_text().splitlines()
        file.write_text("\n".join([*lines[:2], "", *lines[3:]]) + "\n")
    log = open_log(path)
    assert log.sweep_frames(LIDAR) == (0, 1, 3, 4, 5) and log.image_frames("image_02") == tuple(range(6))
    times = [(log.drive.time_s[frame], whole.drive.time_s[frame]) for frame in range(6)]
    assert all(abs(one - other) < (1e-3 if frame == 2 else 1e-9) for frame, (one, other) in enumerate(times))
    np.testing.assert_allclose(log.sweep(LIDAR, 3).time_s, whole.sweep(LIDAR, 3).time_s, atol=1e-9)
    (path / "image_02/timestamps.txt").unlink()
    (path / "image_03/timestamps.txt").unlink()
    with pytest.raises(LogError, match=r"timestamps\.txt: line 3 is empty, but there is a frame 2"):
        open_log(path)


def test_records_without_a_time_are_left_out(path: Path) -> None:
    file = path / "oxts/timestamps.txt"
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:2], "", *lines[3:]]) + "\n")
    log = open_log(path)
    assert len(log.drive.world_from_ego.times_s) == len(lines) - 1


def test_frames_that_have_no_poses_are_an_error(path: Path) -> None:
    for file in sorted((path / "oxts/data").iterdir())[2:]:
        file.unlink()
    with pytest.raises(LogError, match=r"oxts has poses from -0\.030 to 0\.070 s, but there is a frame at 0\.500 s"):
        open_log(path)


def test_an_unsynced_drive_is_told_from_a_synced_one(path: Path) -> None:
    """Its sweeps are text, and its images are distorted: read as the other's they would be wrong."""
    for file in (path / "velodyne_points/data").iterdir():
        file.with_suffix(".txt").write_text("1 2 3 0.5\n")
        file.unlink()
    with pytest.raises(LogError, match=r"drive: is an unsynced drive \(_extract\).*take its _sync folder"):
        open_log(path)


def test_an_image_of_another_size_and_one_cut_off(path: Path) -> None:
    log = open_log(path)
    cut("image_02/data/0000000004.png", 60)(path)
    with pytest.raises(LogError, match=r"0000000004\.png: cannot be decoded"):
        log.image("image_02", 4)
    Image.new("RGB", (8, 8)).save(path / "image_02/data/0000000003.png")
    with pytest.raises(LogError, match=r"0000000003\.png: has 8x8 pixels, the camera's first image has 96x32"):
        log.image("image_02", 3)


def test_a_sweep_that_is_cut_off_or_holds_no_numbers(path: Path) -> None:
    log = open_log(path)
    cut("velodyne_points/data/0000000004.bin", 1000)(path)
    with pytest.raises(LogError, match=r"0000000004\.bin: is cut off"):
        log.sweep(LIDAR, 4)
    points = np.full((3, 4), 1.0, "<f4")
    points[1, 2] = np.nan
    points.tofile(path / "velodyne_points/data/0000000004.bin")
    with pytest.raises(LogError, match=r"0000000004\.bin: point 1 is at"):
        read_points(path / "velodyne_points/data/0000000004.bin")
    (path / "velodyne_points/data/0000000004.bin").write_bytes(b"")
    assert not len(log.sweep(LIDAR, 4).points)


def test_a_drive_with_neither_poses_nor_sweeps(path: Path) -> None:
    shutil.rmtree(path / "oxts")
    shutil.rmtree(path / "velodyne_points/data")
    with pytest.raises(LogError, match=r"drive: has no poses \(oxts\), and no sweeps to find them by"):
        open_log(path)
    shutil.rmtree(path / "image_02/data")
    shutil.rmtree(path / "image_03/data")
    with pytest.raises(LogError, match="drive: holds neither sweeps nor images"):
        open_log(path)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            replaced("label_02/0003.txt", "Car 0 0", "Car 0"),
            r"label_02/0003\.txt: line \d+ is no label, it has 16 values",
        ),
        (replaced("label_02/0003.txt", "\n0 ", "\n0.5 "), r"label_02/0003\.txt: line \d+ has no numbers of frame and"),
        (replaced("calib/0003.txt", "Tr_velo_cam", "Tr_velo"), r"calib/0003\.txt: Tr_velo_cam is missing"),
        (cut("oxts/0003.txt", 0), r"oxts/0003\.txt: holds no record"),
    ],
)
def test_tracking_files(whole: KittiStreet, change: Callable[[Path], None], sentence: str, tmp_path: Path) -> None:
    path = kitti.write_tracking(whole, tmp_path)
    change(tmp_path)
    with pytest.raises(LogError, match=sentence):
        open_log(path)


def test_surfels_of_one_tracking_sequence_are_not_anothers(whole: KittiStreet, tmp_path: Path) -> None:
    """Both are named by files of the same name and content: calib/0000.txt of two splits, recorded on one day."""
    for split in ("training", "testing"):
        kitti.write_tracking(whole, tmp_path / split, "0000")
    paths = [tmp_path / split / "calib/0000.txt" for split in ("training", "testing")]
    assert paths[0].read_bytes() == paths[1].read_bytes()
    one, other = (build_key(open_log(path), SurfelSettings(), None) for path in paths)
    assert one == other, "the same files anywhere"
    sweep = tmp_path / "testing/velodyne/0000/000000.bin"
    points = np.fromfile(sweep, "<f4")
    points[0] += 0.01
    sweep.unlink()  # it leads to the first one's
    points.tofile(sweep)
    assert build_key(open_log(paths[1]), SurfelSettings(), None) != one
