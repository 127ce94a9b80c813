"""Charts of trainings: their curve, and axes with round numbers."""

from __future__ import annotations

from typing import Any

import numpy as np

from unisim_blender.editing.layout.chart import HEIGHT, LIDAR, PSNR, WIDTH, decades, ticks, training_chart


def entry(seconds: float, psnr: float, lidar_m: float) -> dict[str, float]:
    """A line of training.jsonl."""
    return {"seconds": seconds, "psnr": psnr, "lidar_m": lidar_m}


def places(image: Any, colour: tuple[float, float, float]) -> tuple[Any, Any]:
    """Rows and columns of a colour."""
    rows, columns = np.nonzero((np.abs(image - colour) < 1e-6).all(-1))
    return rows, columns


def test_a_training_is_a_curve() -> None:
    entries = [entry(60.0 * minute, 15.0 + minute, 1.0 / minute) for minute in range(1, 6)]
    image = training_chart(entries, 10.0)
    assert image.shape == (2 * HEIGHT, WIDTH, 3)
    for colour, up in ((PSNR, True), (LIDAR, False)):
        rows, columns = places(image, colour)
        first, last = rows[columns == columns.min()].mean(), rows[columns == columns.max()].mean()
        assert (last < first - 50) == up and (last > first + 50) == (not up)
        # minutes 1 to 5 of 10: the curve takes four tenths of the axis
        assert 0.3 * WIDTH < np.ptp(columns) < 0.4 * WIDTH
    assert len(places(image, LIDAR)[0]) and places(image, LIDAR)[0].min() > HEIGHT > places(image, PSNR)[0].max()


def test_what_was_trained_twice_counts_once() -> None:
    once = [entry(60.0, 16.0, 1.0), entry(120.0, 18.0, 0.5), entry(180.0, 19.0, 0.4)]
    killed = [once[0], entry(130.0, 3.0, 9.0), entry(170.0, 2.0, 9.0), *once[1:]]
    assert np.array_equal(training_chart(once, 5.0), training_chart(killed, 5.0))


def test_a_training_that_has_only_begun() -> None:
    empty = training_chart([], 1.0)
    assert not len(places(empty, PSNR)[0])
    assert len(places(training_chart([entry(30.0, 12.0, 2.0)], 1.0), PSNR)[0])
    broken = [entry(30.0, 12.0, 2.0), entry(40.0, float("nan"), float("nan"))]
    assert len(places(training_chart(broken, 1.0), LIDAR)[0])


def test_axes_have_round_numbers() -> None:
    assert ticks(0.0, 60.0) == [0, 10, 20, 30, 40, 50, 60]
    assert ticks(11.9, 12.6) == [12.0, 12.2, 12.4, 12.6]
    assert decades(0.5, 2.0) == [5, 10, 20, 50, 100]
    assert decades(-1.0, 2.0) == [0.1, 1, 10, 100]
