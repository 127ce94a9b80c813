"""Tracks of a detector's boxes: of another package's detector, linked, and fused with what was found."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from written_street import write_recipe

from unisim_blender.core.data.log import Log, Sweep
from unisim_blender.core.errors import LogError, UnisimError
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_yaw
from unisim_blender.core.tracks.box_file import Track
from unisim_blender.core.tracks.detections import DETECTORS, detected_boxes, detector_named, fused, linked
from unisim_blender.core.world.box_tracks import TrackedBoxes
from unisim_blender.core.world.drive import Actor, Appearance

DETECTOR = '''
import types

import numpy as np
from scipy import ndimage


class Upright:
    """Cars where as many returns stand above the ground as a car has, along the axis of the street."""

    name, about = "upright", "returns above the ground, in clusters"

    def detect(self, points):
        above = points[(points[:, 2] > -1.4) & (points[:, 2] < 0.2) & (np.abs(points[:, :2]) < 30).all(1)]
        cell = np.floor(above[:, :2] / 0.5).astype(int) + 61
        grid = np.zeros((122, 122), bool)
        grid[tuple(cell.T)] = True
        number = ndimage.label(grid, np.ones((3, 3)))[0][tuple(cell.T)]
        boxes = []
        for each in range(1, number.max(initial=0) + 1):
            part = above[number == each, :2]
            low, high = part.min(0), part.max(0)
            if len(part) >= 12 and (high - low < (6, 3)).all() and (high - low).max() > 1.2:
                boxes.append([*(low + high) / 2, -1.0, 4.5, 1.9, 1.5, 0.0])
        return types.SimpleNamespace(boxes=np.reshape(boxes, (-1, 7)), label=["Car"] * len(boxes), score=np.full(len(boxes), 0.6))


UPRIGHT = Upright()
'''


@pytest.fixture(scope="module")
def street(tmp_path_factory: pytest.TempPathFactory) -> Log:
    return open_log(write_recipe(tmp_path_factory.mktemp("street") / "log", frames=10, width=48, height=32))


def test_another_packages_detector_gives_tracks(street: Log, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "upright_detector.py").write_text(DETECTOR)
    about = tmp_path / "upright_detector-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: upright-detector\nVersion: 1\n")
    (about / "entry_points.txt").write_text("[unisim_blender.detectors]\nupright = upright_detector:UPRIGHT\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    DETECTORS.forget_plugins()
    detector = DETECTORS.with_plugins()["upright"]
    assert detector_named("upright") is detector
    done: list[float] = []
    boxes = detected_boxes(street, detector, done.append)
    assert done[-1] == 1 and (boxes.uid == "").all() and len(boxes.uid) > 50
    tracks = linked(boxes, "upright")
    near: int = 0
    for actor in street.drive.actors.values():
        away = [
            np.linalg.norm(track.actor.world_from_actor.at(0.5)[:2, 3] - actor.world_from_actor.at(0.5)[:2, 3])
            for track in tracks
            if track.actor.present(0.5)
        ]
        near += bool(min(away) < 1.5)
    assert near >= 6, near
    assert all(track.certainty == pytest.approx(0.6) and track.source == "upright" for track in tracks)
    DETECTORS.forget_plugins()


@pytest.mark.parametrize(
    ("seen", "sentence"),
    [
        (lambda: SimpleNamespace(boxes=np.zeros((1, 7)), label=["Car"], score=[0.5]), "has no size"),
        (lambda: SimpleNamespace(boxes=np.full((1, 7), np.nan), label=["Car"], score=[0.5]), "is not finite"),
        (lambda: SimpleNamespace(boxes=np.ones((2, 7)), label=["Car"], score=[0.5]), r"\(2, 7\) boxes, 1 labels"),
        (lambda: SimpleNamespace(boxes=np.ones((1, 7)), label=["Car"], score=[7.0]), "not from 0 to 1"),
        (lambda: 1 / 0, "ZeroDivisionError: division by zero"),
    ],
)
def test_what_a_detector_must_not_return(street: Log, seen: Callable[[], Any], sentence: str) -> None:
    detector = SimpleNamespace(name="odd", about="", detect=lambda points: seen())
    with pytest.raises(LogError, match=rf"pandar64, frame 0: the detector odd: .*{sentence}"):
        detected_boxes(street, detector)


def test_a_detector_gets_each_sweep_in_the_lidars_frame_one_of_a_single_return_too(street: Log) -> None:
    class OneReturn:
        path, drive, sweep_frames = street.path, street.drive, street.sweep_frames

        def sweep(self, lidar: str, frame: int) -> Sweep:
            whole = street.sweep(lidar, frame)
            some: dict[str, Any] = {field.name: getattr(whole, field.name) for field in fields(Sweep)}
            some = {name: values if values is None else values[:1] for name, values in some.items() if name != "drops"}
            return Sweep(**some)

    seen: list[FloatArray] = []

    def detect(points: FloatArray) -> Any:
        seen.append(points)
        return SimpleNamespace(boxes=[[*points[0, :3], 4, 2, 1.5, 0.1]], label=["Car"], score=[0.5])

    log: Any = OneReturn()
    boxes = detected_boxes(log, SimpleNamespace(name="one", about="", detect=detect))
    assert [points.shape for points in seen] == [(1, 4)] * len(street.sweep_frames("pandar64"))
    first = [street.sweep("pandar64", frame).points[0] for frame in street.sweep_frames("pandar64")]
    np.testing.assert_allclose(boxes.poses[:, :3, 3], first, atol=1e-4)
    assert (np.abs(boxes.key_s - boxes.frame_time_s) < 0.11).all()


def test_a_detector_that_sees_nothing_and_one_that_is_not_there(street: Log) -> None:
    nothing = SimpleNamespace(
        name="none", about="", detect=lambda points: SimpleNamespace(boxes=[], label=[], score=[])
    )
    assert linked(detected_boxes(street, nothing), "none") == ()
    with pytest.raises(UnisimError, match="--detector centre: is not installed; there is none"):
        detector_named("centre")


def noisy(seed: int = 0) -> tuple[TrackedBoxes, FloatArray]:
    """Detections over 3 s of a car on a bend with misses, one that stands, doubles, and what is there once; the bend."""
    random, times = np.random.default_rng(seed), np.arange(30) / 10
    bend = np.stack([8 * times, 0.6 * times**2, np.full(30, 0.8)], -1)
    yaw = np.arctan2(1.2 * times, 8.0)
    rows = []
    for at, time in enumerate(times):
        off = random.normal(0, 0.15, (4, 3)) * (1, 1, 0.1)
        if at not in (7, 8, 15):
            turned = yaw[at] + random.normal(0, 0.05) + np.pi * (at == 20)
            rows.append((time, bend[at] + off[0], turned, 0.9, "car" if at % 5 else "truck"))
            rows.append((time, bend[at] + off[1], turned, 0.5, "car"))  # the same once more
        rows.append((time, np.array([5, -6, 0.8]) + off[2], 0.3, 0.7, "car"))
        rows.append((time, random.uniform(20, 60, 3), 0.0, 0.3, "car"))
        rows.append((time, np.array([9, 9, 0.8]), 0.0, 0.05, "car"))
    when, places, turned, score, label = (np.array(column) for column in zip(*rows, strict=True))
    poses = make_pose(places, quaternion_from_yaw(turned))
    sizes = np.tile([4.5, 1.9, 1.5], (len(rows), 1))
    return TrackedBoxes(np.full(len(rows), ""), label, when, poses, sizes, when, score), bend


def test_detections_are_linked_and_smoothed() -> None:
    boxes, bend = noisy()
    moving, standing = sorted(linked(boxes, "net"), key=lambda track: not track.actor.is_moving)
    assert moving.actor.is_moving and not standing.actor.is_moving
    assert moving.sweeps == 27 and moving.actor.label == "car" and moving.certainty == pytest.approx(0.9)
    times = np.arange(30) / 10
    path = moving.actor.world_from_actor
    away = np.linalg.norm(path.positions_at(times)[:, :2] - bend[:, :2], axis=1)
    assert np.median(away) < 0.12 and away.max() < 0.4  # less than the detections' own 0.19 m and 0.4 m
    yaw = np.arctan2(path.at(times)[:, 1, 0], path.at(times)[:, 0, 0])
    assert np.degrees(np.median(np.abs(yaw - np.arctan2(1.2 * times, 8.0)))) < 3
    assert standing.actor.world_from_actor.positions[0] == pytest.approx([5, -6, 0.8], abs=0.1)
    assert moving.actor.uid != standing.actor.uid


def test_found_and_detected_tracks_are_fused() -> None:
    def track(uid: str, label: str, start: float, end: float, y: float, certainty: float, source: str) -> Track:
        times = np.linspace(start, end, 11)
        path = Trajectory(
            times, np.stack([8 * times, np.full(11, y), np.ones(11)], -1), quaternion_from_yaw(np.zeros(11))
        )
        actor = Actor(uid, label, np.array([4.5, 1.9, 1.5]), path, start, end, True, Appearance(uid))
        return Track(actor, certainty, source)

    found = [track("car-000", "Car", 1, 2, 0, 0.6, "lidar"), track("car-001", "Car", 0, 3, 20, 0.4, "lidar")]
    detected = [track("van-000", "Van", 0, 3, 0.4, 0.5, "net"), track("car-001", "Car", 0, 3, -20, 0.7, "net")]
    both, only_found, only_detected = fused(found, detected)
    assert (both.actor.uid, both.actor.label, both.source) == ("car-000", "Van", "lidar and net")
    assert both.certainty == pytest.approx(0.8) and (both.actor.start_s, both.actor.end_s) == (0, 3)
    path = both.actor.world_from_actor
    assert path.positions_at(np.array([0.0, 1.5, 3.0]))[:, 1] == pytest.approx(0, abs=1e-9)  # displaced as at its ends
    assert len(path.times_s) == 19 and only_found == found[1]
    assert only_detected == replace(
        detected[1], actor=replace(detected[1].actor, uid="car-001-2", appearance=Appearance("car-001-2"))
    )
