"""Figures, cards, names and portraits' files of actors, from plain data."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from unisim_blender.editing.actors.portraits import portrait_path, save_portrait, saved_portrait
from unisim_blender.editing.actors.table import (
    ActorTrack,
    at_time,
    is_plain,
    named_actors,
    names_at_import,
    present_span,
    role_words,
    size_words,
    values_at,
)
from unisim_blender.editing.sampled.clock import Clock, recorded_poses, recorded_there
from unisim_blender.editing.sampled.scene import differs
from unisim_blender.editing.sampled.source import DriveSource

CLOCK = Clock(np.arange(10.0), np.arange(10) * 0.1)


def track(name: str, speed_m_s: float, left_m: float, there: object = True) -> ActorTrack:
    """An actor that drives along x."""
    positions = np.stack([speed_m_s * CLOCK.times_s, np.full(10, left_m), np.zeros(10)], -1)
    present = np.broadcast_to(np.asarray(there), 10)
    speeds = np.where(present, speed_m_s, np.nan)
    return ActorTrack(name, name, "Car", "CAR", positions, present, speeds, np.zeros((0, 2)), False)


def test_distance_speed_and_presence_at_a_frame() -> None:
    late = np.arange(10) >= 5
    ego = np.zeros((10, 3))
    found = values_at([track("a", 0.0, 4.0), track("b", 10.0, 0.0), track("c", 1.0, 0.0, late)], ego, CLOCK, 4.5)
    assert found.distance_m == pytest.approx([4.0, 4.5, 0.45])
    assert found.speed_m_s == pytest.approx([0.0, 10.0, np.nan], nan_ok=True)
    assert found.there.tolist() == [True, True, False], "a frame counts until the next"
    assert values_at([track("c", 1.0, 0.0, late)], ego, CLOCK, 5.0).there.tolist() == [True]
    assert values_at([track("b", 10.0, 0.0)], ego, CLOCK, 0.0).speed_m_s == pytest.approx([10.0]), (
        "carried on at the ends"
    )
    assert not len(values_at([], ego, CLOCK, 0.0).distance_m)


def test_positions_at_a_time() -> None:
    assert at_time(track("b", 10.0, 0.0).positions, CLOCK, 0.25) == pytest.approx([2.5, 0.0, 0.0])
    assert at_time(track("b", 10.0, 0.0).positions, CLOCK, 1.1) == pytest.approx([11.0, 0.0, 0.0])


def test_what_differs_from_the_recording(source: DriveSource) -> None:
    drive, clock = source.drive, Clock.of(source.drive)
    for uid in ("car-01", "car-06"):
        actor = drive.actors[uid]
        poses, there = recorded_poses(actor, clock), recorded_there(actor, drive, clock)
        assert not differs(poses, there, actor, drive, clock)
        assert differs(poses, ~there, actor, drive, clock)
        moved = poses.copy()
        moved[3, 0, 3] += 0.01
        assert differs(moved, there, actor, drive, clock)


def test_words_of_a_card() -> None:
    assert role_words(True, True, True, True) == "mesh" and role_words(False, False, False, False) == "inserted"
    assert role_words(False, True, True, False) == "copy" and role_words(False, True, False, False) == "recorded"
    assert role_words(False, True, False, True) == "recorded, other appearance"
    assert size_words((4.62, 2.0, 1.45), (1.0, 1.0, 1.0)) == "4.62 x 2.00 x 1.45 m"
    assert size_words((4.62, 2.0, 1.45), (1.1, 1.1, 1.1)) == "4.6 x 2.0 x 1.4 m ×1.1"
    there = np.zeros(10, bool)
    assert present_span(there, CLOCK) is None
    there[[2, 7]] = True
    assert present_span(there, CLOCK) == pytest.approx((0.2, 0.7))


def test_names_of_an_import(source: DriveSource) -> None:
    names = names_at_import(source)
    assert set(names) == set(source.drive.actors) == set(named_actors(source)) and len(set(names.values())) == len(
        names
    )
    assert is_plain("Car 1", "Car 1") and is_plain("Car 1.001", "Car 1")
    assert not is_plain("Car 1, blue", "Car 1") and not is_plain("Car 11", "Car 1")


def test_portraits_are_kept_until_the_scene_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    scene = tmp_path / "scene"
    scene.mkdir()
    (scene / "scene.json").write_text("{}")
    assert saved_portrait(scene, "car/1") is None
    pixels = np.zeros((4, 4, 4), np.uint8)
    path = save_portrait(scene, "car/1", pixels)
    assert saved_portrait(scene, "car/1") == path == portrait_path(scene, "car/1") and path.is_file()
    assert portrait_path(scene, "car/2") != path
