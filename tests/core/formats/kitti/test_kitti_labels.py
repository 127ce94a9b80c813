"""Tracking labels of the procedural street beside its exact images: what they show of each actor, how much, and where."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from unisim_blender.core.convert import convert, open_source
from unisim_blender.core.errors import LogError, OutputError
from unisim_blender.core.formats.kitti.write.labels import UNKNOWN, hidden_level, seen_in
from unisim_blender.core.formats.pandaset.sensors import PANDAR64
from unisim_blender.core.formats.pandaset.write import PandasetWriter
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.formats.writers import writer_named
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.sensors.frames import CameraFrame
from unisim_blender.core.world.box_tracks import hidden_shares
from unisim_blender.core.world.drive import CameraModel, Drive, LidarModel
from unisim_street.street import build_street
from unisim_street.truth import truth_camera, truth_lidar

CAMERA = "front_camera"
FAR_M = 40.0
"""The LiDAR's reach: two cars in the images stand further away."""
TABLE = LidarModel(
    np.radians(np.linspace(4.0, -24.0, 40)),
    np.zeros(40),
    columns=600,
    start_azimuth_rad=float(np.radians(171.0)),
    max_range_m=FAR_M,
)


@dataclass(frozen=True)
class Label:
    """A line of a label file."""

    frame: int
    track: int
    label: str
    truncated: int
    occluded: int
    alpha: float
    bounds: FloatArray
    size: FloatArray
    place: FloatArray
    turned: float


@dataclass(frozen=True)
class Converted:
    """The street's drive, its exact images by the frame of the converted log, the folder, and the labels."""

    drive: Drive
    images: dict[int, CameraFrame]
    split: Path
    labels: list[Label]

    def pixels(self, label: Label, uid: str) -> tuple[FloatArray, FloatArray]:
        """Columns and rows of an actor's pixels in a label's image."""
        image = self.images[label.frame]
        rows, columns = np.nonzero(image.instance == image.instances.index(uid) + 1)
        return columns.astype(float), rows.astype(float)


def parsed(path: Path) -> Iterator[Label]:
    for line in path.read_text().splitlines():
        words = line.split()
        assert len(words) == 17
        numbers = np.array([float(word) for word in words[5:]])
        yield Label(
            int(words[0]), int(words[1]), words[2], int(words[3]), int(words[4]), float(numbers[0]), numbers[1:5],
            numbers[5:8], numbers[8:11], float(numbers[11]),
        )  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Converted:
    root = tmp_path_factory.mktemp("labels")
    street = build_street(seed=11, frames=2, width=160, height=90, cameras=(CAMERA,))
    drive = replace(street.drive, lidars={PANDAR64: replace(street.drive.lidars[PANDAR64], model=TABLE)})
    writer, images = PandasetWriter(root / "log", drive), {}
    for frame in drive.frames:
        images[frame] = truth_camera(street, drive, CAMERA, frame, samples=1)
        writer.write_image(CAMERA, frame, np.asarray(np.rint(images[frame].rgb * 255), np.uint8))
        writer.write_sweep(frame, {PANDAR64: truth_lidar(street, drive, PANDAR64, frame)})
        writer.write_cuboids(frame)
    writer.finish()
    source = open_source(root / "log")
    done = convert(source, writer_named("kitti-tracking"), root / "out")
    log, split = open_log(done.opens), root / "out/training"
    by_picture = {source.log.image(CAMERA, frame).tobytes(): images[frame] for frame in drive.frames}
    shown = {frame: by_picture[log.image("image_02", frame).tobytes()] for frame in log.image_frames("image_02")}
    return Converted(drive, shown, split, list(parsed(split / "label_02/0000.txt")))


def test_rectangles_hold_the_pixels_of_their_actors(made: Converted) -> None:
    actors, checked = made.drive.labelled_actors, 0
    for label in made.labels:
        if label.track < 0:
            continue
        left, top, right, bottom = label.bounds
        u, v = made.pixels(label, actors[label.track].uid)
        assert 0 <= left < right <= 159 and 0 <= top < bottom <= 89
        if len(u):  # a box has room about its car
            assert left - 1.5 <= u.min() and u.max() <= right + 1.5 and top - 1.5 <= v.min() and v.max() <= bottom + 1.5
        share = len(u) / ((right - left) * (bottom - top))
        if label.label == "Car" and label.truncated == 0:
            assert {0: 0.5, 1: 0.3, 2: 0.05}[label.occluded] < share < {0: 1.0, 1: 0.8, 2: 0.4}[label.occluded]
            assert label.occluded or u.max() - u.min() > 0.65 * (right - left)
            checked += 1
    assert checked > 4
    levels = {(label.truncated, label.occluded) for label in made.labels if label.track >= 0}
    assert {(0, 0), (0, 1), (0, 2)} <= levels


def test_what_is_seen_has_a_label_and_what_no_beam_met_is_ignored(made: Converted) -> None:
    actors = made.drive.labelled_actors
    frames = sorted({label.frame for label in made.labels})
    assert frames == [0, 1], "the first turn begins before the first frame, and has labels, too"
    for frame in frames:
        image = made.images[frame]
        assert image.instance is not None and image.depth_m is not None
        listed = {actors[label.track].uid for label in made.labels if label.frame == frame and label.track >= 0}
        for number, uid in enumerate(image.instances, 1):
            mine = image.instance == number
            if mine.sum() < 20:
                continue
            if image.depth_m[mine].min() < FAR_M - 1:
                assert uid in listed
                continue
            assert uid not in listed
            v, u = np.nonzero(mine)
            ignored = [one.bounds for one in made.labels if one.frame == frame and one.label == "DontCare"]
            assert any(a <= u.mean() <= c and b <= v.mean() <= d for a, b, c, d in ignored), uid
    assert sum(label.label == "DontCare" for label in made.labels) >= 2


def test_alpha_is_the_heading_less_the_direction_of_view(made: Converted) -> None:
    values = dict(line.split(maxsplit=1) for line in (made.split / "calib/0000.txt").read_text().splitlines())
    projection = np.array(values["P2:"].split(), float).reshape(3, 4)
    for label in made.labels:
        if label.track < 0:
            continue
        x, _, z = label.place
        off = label.alpha - (label.turned - np.arctan2(x, z))
        assert abs(np.angle(np.exp(1j * off))) < 1e-5 and abs(label.alpha) <= np.pi
        height, width, length = label.size
        np.testing.assert_allclose(
            [length, width, height], made.drive.labelled_actors[label.track].size_m, rtol=0, atol=1e-6
        )
        # a point of the box's bottom projects into the rectangle, or below or beside the image
        u, v, depth = projection @ [x, label.place[1] - height / 2, z, 1]
        if label.truncated == 0:
            left, top, right, bottom = label.bounds
            assert left < u / depth < right and top < v / depth < bottom


def test_a_wall_hides_what_stands_behind_it() -> None:
    azimuth, elevation = np.meshgrid(np.radians(np.arange(-20, 20, 0.2)), np.radians(np.arange(-8, 3, 0.5)))
    rays = np.stack([np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1)
    pose, size = np.eye(4), np.array([[4.0, 2.0, 2.0]])
    pose[:3, 3] = 20.0, 0.0, -0.5
    aside = azimuth.ravel()
    met = rays.reshape(-1, 3) * 18.2
    for limit, level in ((-1.0, 0), (-0.02, 1), (0.02, 2), (1.0, 2)):
        points = np.where((aside < limit)[:, None], rays.reshape(-1, 3) * 9.0, met)
        (share,), inside = hidden_shares(np.zeros_like(points), points, pose[None], size)
        assert hidden_level(share) == level and bool(inside[0]) == (limit < 1)
        assert abs(share - np.clip((limit + 0.04) / 0.08, 0, 1)) < 0.1
    pose[:3, 3] = -20.0, 0.0, -0.5  # where no beam looks
    (share,), inside = hidden_shares(np.zeros_like(met), met, pose[None], size)
    assert (hidden_level(share), inside.tolist()) == (UNKNOWN, [0])
    shares, inside = hidden_shares(met, met, np.eye(4)[None], size)  # rays that begin where they end
    assert not inside.any()


def test_a_box_is_cut_off_by_the_images_edge() -> None:
    model, size = CameraModel(100, 60, 80.0, 80.0, 50.0, 30.0), np.array([4.0, 2.0, 2.0])
    pose = np.eye(4)
    pose[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]
    found = []
    for x in (0.0, 5.6, 6.3, 7.2, 30.0):
        pose[:3, 3] = x, 0.2, 10.0
        seen = seen_in(model, pose, size)
        found.append(None if seen is None else seen.truncated)
    assert found == [0, 1, 2, 2, None]
    pose[:3, 3] = 0.0, 0.2, -10.0
    assert seen_in(model, pose, size) is None
    pose[:3, 3] = -1.5, 0.2, 1.0  # beside the camera, half of it behind
    seen = seen_in(model, pose, size)
    assert seen is not None and seen.truncated == 2 and seen.bounds[0] == 0.0


def test_times_and_beams_lie_beside_the_layout(made: Converted, tmp_path: Path) -> None:
    split = tmp_path / "training"
    shutil.copytree(made.split, split)
    beside = split / "unisim/0000"
    assert (split / "evaluate_tracking.seqmap.training").read_text() == "0000 empty 000000 000002\n"
    log = open_log(split / "calib/0000.txt")
    assert not any("assumed" in sentence or "which way" in sentence for sentence in log.missing)
    assert log.drive.lidars["velodyne"].model.direction == TABLE.direction == -1
    stamps = beside / "velodyne_points/timestamps_start.txt"
    stamps.write_text(stamps.read_text().replace("2000-01-01", "2000-01-02"))
    with pytest.raises(LogError, match=r"unisim/0000/velodyne_points: the turn of frame 0 starts"):
        open_log(split / "calib/0000.txt")
    shutil.rmtree(beside)  # as the dataset has it
    log = open_log(split / "label_02/0000.txt")
    assert any("0.1 s from one frame to the next are assumed" in sentence for sentence in log.missing)
    assert log.drive.lidars["velodyne"].model.beams == len(TABLE.elevation_rad)


def test_a_drive_without_a_camera_has_no_labels(made: Converted, tmp_path: Path) -> None:
    source = open_source(made.split.parent.parent / "log")
    blind = replace(source.log.drive, cameras={})
    source.log.drive = blind
    with pytest.raises(OutputError, match="has no images of a camera that rides on the vehicle"):
        convert(source, writer_named("kitti-tracking"), tmp_path / "out")
    assert not list(tmp_path.iterdir())


def test_object_samples_are_what_detectors_load(made: Converted, tmp_path: Path) -> None:
    """Read as OpenPCDet and MMDetection3D do: calibration by lines, boxes to the LiDAR's frame by the documented formulas."""
    root = tmp_path / "out"
    source = open_source(made.split.parent.parent / "log")
    convert(source, writer_named("kitti-object"), root)
    lists = {path.stem: path.read_text().split() for path in (root / "ImageSets").iterdir()}
    assert lists == {"train": ["000000"], "val": ["000001"], "trainval": ["000000", "000001"], "test": []}
    lidar = made.drive.lidars[PANDAR64]
    tracked = {frame: [one for one in made.labels if one.frame == frame] for frame in (0, 1)}
    cars = 0
    for sample in lists["trainval"]:
        for name, end in (("image_2", "png"), ("velodyne", "bin"), ("label_2", "txt"), ("calib", "txt")):
            assert [path.name for path in sorted((root / "training" / name).iterdir())] == [
                f"00000{n}.{end}" for n in (0, 1)
            ]
        lines = (root / f"training/calib/{sample}.txt").read_text().splitlines()
        names, rows = [line.split(": ")[0] for line in lines], [np.array(line.split()[1:], float) for line in lines]
        assert names == ["P0", "P1", "P2", "P3", "R0_rect", "Tr_velo_to_cam", "Tr_imu_to_velo"]
        rectified = np.eye(4)
        rectified[:3, :3] = rows[4].reshape(3, 3)
        projection, camera_from_lidar = (
            rows[2].reshape(3, 4),
            rectified @ np.vstack([rows[5].reshape(3, 4), [0, 0, 0, 1]]),
        )
        points = np.fromfile(root / f"training/velodyne/{sample}.bin", "<f4").reshape(-1, 4)
        assert 0 <= points[:, 3].min() and points[:, 3].max() <= 1 and len(points) > 1000
        labels = [line.split() for line in (root / f"training/label_2/{sample}.txt").read_text().splitlines()]
        assert [words[0] for words in labels] == [one.label for one in tracked[int(sample)]]
        for words, same in zip(labels, tracked[int(sample)], strict=True):
            assert len(words) == 15
            truncated, occluded, alpha, left, top, right, bottom, h, w, long, x, y, z, turned = map(float, words[1:])
            np.testing.assert_array_equal([left, top, right, bottom], same.bounds)
            if words[0] == "DontCare":
                assert words[1:4] == ["-1", "-1", "-10"] and words[8:] == ["-1"] * 3 + ["-1000"] * 3 + ["-10"]
                continue
            assert 0 <= truncated <= 1 and (truncated > 0.5, occluded) == (same.truncated == 2, same.occluded)
            actor = made.drive.labelled_actors[same.track]
            np.testing.assert_allclose([long, w, h], actor.size_m, rtol=0, atol=1e-6)
            centre = np.linalg.inv(camera_from_lidar) @ [x, y - h / 2, z, 1]
            heading = -(np.pi / 2 + turned)
            # a moment of the turn at which it was there in the LiDAR's frame, and so turned
            times = np.arange(-0.15, 0.15, 1e-4) + 0.1 * int(sample)
            truth = np.linalg.inv(lidar.world_from_lidar.at(times)) @ actor.world_from_actor.at(times)
            off = np.linalg.norm(truth[:, :3, 3] - centre[:3], axis=1)
            assert off.min() < 1.5e-3
            yaw = np.arctan2(truth[off.argmin(), 1, 0], truth[off.argmin(), 0, 0])
            assert abs(np.angle(np.exp(1j * (heading - yaw)))) < 1e-3
            assert abs(np.angle(np.exp(1j * (alpha - turned + np.arctan2(x, z))))) < 1e-5
            own = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
            local = points[:, :2] - centre[:2]
            inside = (np.abs(local @ own.T) < np.array([long, w]) / 2).all(1) & (
                np.abs(points[:, 2] - centre[2]) < h / 2
            )
            assert inside.any()
            u, v, depth = projection @ [x, y - h / 2, z, 1]
            if truncated == 0:
                assert left < u / depth < right and top < v / depth < bottom
                cars += words[0] == "Car"
    assert cars > 4


def test_a_camera_that_looks_down_is_told_of(made: Converted, tmp_path: Path) -> None:
    source = open_source(made.split.parent.parent / "log")
    camera = source.log.drive.cameras[CAMERA]
    nod = np.eye(4)
    nod[1:3, 1:3] = [[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]]
    tilted = replace(camera, world_from_camera=camera.world_from_camera.transformed(right=nod))
    source.log.drive = replace(source.log.drive, cameras={CAMERA: tilted})
    done = convert(source, writer_named("kitti-object"), tmp_path / "out")
    assert any("tilted by 5.7 degrees against the vehicle" in loss for loss in done.losses)
