"""The figures of benchmarks/tracks.py on boxes whose right ones are known."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.tracks import FrameBoxes, counted, presence, scores

CAR = (4.5, 1.9)


def boxes(*rows: tuple[int, float, float, float, int, bool]) -> FrameBoxes:
    """Boxes of the size of a car: uid, x, y, yaw, returns, moving."""
    table = np.array(rows, float).reshape(-1, 6)
    xylwa = np.column_stack([table[:, 1:3], np.tile(CAR, (len(table), 1)), table[:, 3]])
    away = np.linalg.norm(table[:, 1:3], axis=1)
    return FrameBoxes(table[:, 0].astype(int), xylwa, away, table[:, 4].astype(int), table[:, 5].astype(bool))


def test_only_what_the_lidar_sees_in_range_counts() -> None:
    labels = boxes((0, 10, 0, 0, 50, True), (1, 20, 0, 0, 4, True), (2, 40, 0, 0, 50, True), (3, 15, 9, 0, 50, False))
    found = boxes(
        (0, 10.5, 0, 0, 50, True),  # right
        (1, 20, 1, 0, 4, True),  # on a label that the LiDAR does not see
        (2, 39, 0, 0, 50, True),  # on one at another range
        (3, 15, 9, 0, 50, True),  # on one that stands
        (4, 10, -9, 0, 50, True),  # wrong
        (5, 10, -14, 0, 3, True),  # wrong, of no return
        (6, 10, -20, 0, 50, False),  # wrong, and stands
    )
    targets, counts = counted(labels, found, (0, 30), True)
    assert targets.uid.tolist() == [0] and counts.uid.tolist() == [0, 4]
    targets, counts = counted(labels, found, (0, 30), False)
    assert targets.uid.tolist() == [3] and counts.uid.tolist() == [3, 6]
    targets, counts = counted(labels, found, (0, 50), None)
    assert targets.uid.tolist() == [0, 2, 3] and counts.uid.tolist() == [0, 2, 3, 4, 6]


def test_figures_of_a_switch_a_miss_and_a_box_turned_round() -> None:
    pytest.importorskip("trackeval", reason="pip install -e '.[tracking]'")
    frames = []
    for t in range(4):
        label = boxes((0, 10 + t, 0, 0.1, 50, True), (1, 10 + t, 8, 0, 50, True))
        first = (7 if t < 2 else 8, 10.3 + t, 0, 0.1 + np.pi * (t == 3), 50, True)
        frames.append([label, boxes(first, *([(9, 10 + t, 8, 0.05, 50, True)] if t else []), (5, -20, 0, 0, 9, True))])
    figures = scores(frames)
    assert (figures["labels"], figures["actors"], figures["switches"]) == (8, 2, 1)
    assert figures["recall"] == 87.5 and figures["precision"] == pytest.approx(700 / 11)
    assert figures["centre m"] == pytest.approx(0.3) and figures["reversed"] == pytest.approx(100 / 7)
    assert figures["heading deg"] == pytest.approx(np.degrees(0.05)) and figures["axis deg"] < 1e-6
    assert 40 < figures["HOTA"] < figures["HOTA 2 m"] < 75
    perfect = scores([[label, label] for label, _ in frames])
    assert perfect["HOTA"] == pytest.approx(100) and perfect["recall"] == perfect["precision"] == 100
    there = presence(frames, "ab", "0123456789")
    assert there["a"] == {"frames": 4, "right": 4, "tracks": ["7", "8"]} and there["b"]["right"] == 3
    nothing = scores([[label, label.some(np.zeros(2, bool))] for label, _ in frames])
    assert nothing["recall"] == nothing["HOTA"] == 0 and np.isnan(nothing["centre m"])
