"""Images of a finished sequence, found in its folder."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import pytest

from unisim_blender.editing.images import rendered as listing
from unisim_blender.editing.images.rendered import frames_in, player_command, rendered_cameras


def images(folder: Path, frames: range) -> None:
    """Empty images of frames."""
    folder.mkdir(parents=True)
    for frame in frames:
        (folder / f"{frame:06d}.png").touch()


def test_images_are_found_by_camera(tmp_path: Path) -> None:
    images(tmp_path / "camera" / "left", range(4, 11, 2))
    images(tmp_path / "camera" / "front", range(0, 1))
    images(tmp_path / "camera" / "none", range(0))
    images(tmp_path / "camera" / "gaps", range(0, 1))
    for frame in (3, 5):
        (tmp_path / "camera" / "gaps" / f"{frame:06d}.png").touch()
    (tmp_path / "camera" / "left.mp4").touch()
    (tmp_path / "camera" / "left" / "000004.exr").touch()
    found = rendered_cameras(tmp_path)
    assert list(found) == ["front", "gaps", "left"] and found["gaps"].step == 1
    left = found["left"]
    assert (left.first, left.last, left.step, left.count) == (4, 10, 2, 4)
    assert left.first_path == tmp_path / "camera" / "left" / "000004.png" and left.first_path.is_file()
    assert (found["front"].step, found["front"].count) == (1, 1)
    assert rendered_cameras(tmp_path / "missing") == {} and frames_in(tmp_path / "camera" / "left.mp4") is None


def test_a_panel_lists_the_folder_once_a_second(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(listing, "time", SimpleNamespace(monotonic=lambda: now[0]))
    assert rendered_cameras(tmp_path) == {}
    images(tmp_path / "camera" / "left", range(2))
    assert rendered_cameras(tmp_path) == {}
    now[0] += 1.5
    assert list(rendered_cameras(tmp_path)) == ["left"]


def test_the_player_is_blender_at_the_scenes_rate(tmp_path: Path) -> None:
    images(tmp_path / "front", range(4, 11, 2))
    frames = frames_in(tmp_path / "front")
    assert frames is not None
    assert player_command("/blender", frames, 10, 1.0) == [
        "/blender", "-a", "-f", "10", "1", "-s", "4", "-e", "10", "-j", "2", str(tmp_path / "front" / "000004.png"),
    ]  # fmt: skip
