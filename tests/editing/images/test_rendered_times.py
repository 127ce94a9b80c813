"""Images that are named by times, in a sequence's folder."""

from __future__ import annotations

from pathlib import Path

from unisim_blender.core.world.captures import frame_name, time_name
from unisim_blender.editing.images.rendered import frames_in, player_command


def images(folder: Path, *names: str) -> Path:
    folder.mkdir()
    for name in names:
        (folder / f"{name}.png").touch()
    return folder


def test_times_at_a_rate_are_played(tmp_path: Path) -> None:
    found = frames_in(images(tmp_path / "front", *(time_name(50_000 * i) for i in range(1, 5)), "other"))
    assert found is not None and (found.first, found.last, found.step, found.count) == (50_000, 200_000, 50_000, 4)
    assert found.first_path.is_file() and found.first_path.name == "t0000000050000us.png"
    assert player_command("/blender", found, 20, 1.0)[-7:-1] == ["-s", "50000", "-e", "200000", "-j", "50000"]


def test_times_without_equal_steps_are_not(tmp_path: Path) -> None:
    assert frames_in(images(tmp_path / "uneven", time_name(0), time_name(33_333), time_name(66_667))) is None
    assert frames_in(images(tmp_path / "before", time_name(-100_000), time_name(0))) is None


def test_frames_count_before_times(tmp_path: Path) -> None:
    found = frames_in(images(tmp_path / "both", frame_name(3), frame_name(5), time_name(50_000)))
    assert found is not None and (found.first, found.step, found.count, found.timed) == (3, 2, 2, False)
