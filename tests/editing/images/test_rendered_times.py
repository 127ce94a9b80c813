"""Images that are named by times, in a sequence's folder."""

from __future__ import annotations

from pathlib import Path

from unisim_blender.core.world.captures import frame_name, time_name
from unisim_blender.editing.images.rendered import frames_in, player_command


def images(folder: Path, *names: str) -> Path:
    folder.mkdir()
    for name in names:
        (folder / f"{name}.png").write_text(name)
    return folder


def played(folder: Path, fps: float) -> tuple[float, list[str]]:
    """The rate at which Blender's player shows a folder's images, and which it shows, one after the other."""
    found = frames_in(folder)
    assert found is not None
    command = player_command("/blender", found, fps, 1.0)
    first, last, step = (int(command[command.index(flag) + 1]) for flag in ("-s", "-e", "-j"))
    links = Path(command[-1]).parent
    assert Path(command[-1]).name == f"{first:06d}.png"
    return float(command[3]), [(links / f"{number:06d}.png").read_text() for number in range(first, last + 1, step)]


def test_times_at_a_rate_are_played_one_after_the_other(tmp_path: Path) -> None:
    names = [time_name(50_000 * i) for i in range(1, 5)]
    folder = images(tmp_path / "front", *names, "other")
    found = frames_in(folder)
    assert found is not None and found.count == 4
    assert found.first_path.is_file() and found.first_path.name == "t0000000050000us.png"
    assert played(folder, 10) == (20, names)
    assert played(folder, 40) == (40, [name for name in names[:-1] for _ in range(2)] + names[-1:])


def test_an_image_is_held_until_the_time_of_the_next(tmp_path: Path) -> None:
    names = [time_name(-100_000), time_name(0), time_name(50_000), time_name(300_000)]
    rate, shown = played(images(tmp_path / "uneven", *names), 10)
    assert rate == 20 and shown == [names[0]] * 2 + [names[1]] + [names[2]] * 5 + [names[3]]


def test_one_image_is_played_once(tmp_path: Path) -> None:
    assert played(images(tmp_path / "one", time_name(7)), 10) == (10, [time_name(7)])


def test_a_microsecond_between_two_times_is_no_million_images(tmp_path: Path) -> None:
    rate, shown = played(images(tmp_path / "near", time_name(0), time_name(1), time_name(100_000)), 10)
    assert rate == 240 and shown == [time_name(1)] * 24 + [time_name(100_000)]


def test_frames_count_before_times(tmp_path: Path) -> None:
    found = frames_in(images(tmp_path / "both", frame_name(3), frame_name(5), time_name(50_000)))
    assert found is not None and (found.first, found.step, found.count, found.times_us) == (3, 2, 2, ())
