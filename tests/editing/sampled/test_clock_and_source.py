"""Frames and seconds, frames outside the drive, and the recorded drive opened again."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from imported_scene import imported, one_of, sampled_object

from unisim_blender.editing.images.views import outside_drive
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.source import DriveSource, NotImported, open_source, summary
from unisim_blender.editing.texts import counted

UNEVEN = Clock(np.array([3.0, 4.0, 6.0, 7.0]), np.array([0.3, 0.5, 0.6, 1.1]))


def test_frames_and_seconds_are_each_others_inverse() -> None:
    frames = np.array([0.0, 3.0, 3.5, 5.0, 6.9, 7.0, 12.0])
    assert UNEVEN.frame(UNEVEN.time_s(frames)) == pytest.approx(frames)
    assert UNEVEN.time_s(np.array(5.0)) == pytest.approx(0.55) and UNEVEN.rate == pytest.approx(5.0)
    assert UNEVEN.time_s(np.array([2.0, 8.0])) == pytest.approx([0.1, 1.3]), "at the mean rate beyond the ends"


@pytest.mark.parametrize(
    ("frame", "frames"), [(0.0, [3, 4]), (3.0, [3, 4]), (4.0, [3, 4, 6]), (4.5, [4, 6]), (7.0, [6, 7]), (99.0, [6, 7])]
)
def test_frames_around_one(frame: float, frames: list[int]) -> None:
    assert UNEVEN.around(frame).frames.tolist() == frames


def test_outside_the_drive(source: DriveSource) -> None:
    assert outside_drive(0.0, source.drive) == "" and outside_drive(19.0, source.drive) == ""
    assert outside_drive(-3.0, source.drive).startswith("Frame -3 is outside the drive (frames 0 to 19)")


def test_a_source_is_kept_until_the_trained_scene_changes(source: DriveSource, tmp_path: Path) -> None:
    assert source.scene_path is not None
    scene = tmp_path / "scene"
    shutil.copytree(source.scene_path, scene)
    first = open_source(str(tmp_path / "log"), str(scene))
    assert first.log is None and open_source(str(tmp_path / "log"), str(scene)) is first
    os.utime(scene / "scene.json", (1.0, 1.0))
    second = open_source(str(tmp_path / "log"), str(scene))
    assert second is not first and second.drive.frames == first.drive.frames
    with pytest.raises(NotImported, match="there is no log"):
        open_source(str(tmp_path / "log"), "")


def test_a_sampled_scene(source: DriveSource) -> None:
    sampled = imported(source.drive)
    assert [one.name for one in sampled.of("CAMERA", "LIDAR")] == ["front_camera", "pandar64"]
    one = one_of(sampled, "car-01")
    assert one.is_original and one.title == "car-01"
    copy = sampled_object("Copy", "ACTOR", one.poses, uid="car-01", original_name="car-01", called="Van")
    assert not copy.is_original and copy.title == "Van"


def test_what_a_drive_holds(source: DriveSource) -> None:
    text = summary(source)
    assert "20 frames (1.9 s), 1 camera, 1 LiDAR, 20 actors (13 Car, 5 Cones, 1 Medium-sized Truck, 1 others)" in text
    assert text.endswith("; trained scene scene; the log itself is not at hand")
    assert [counted(number, "1 actor", "{count} actors") for number in (0, 1)] == ["0 actors", "1 actor"]
