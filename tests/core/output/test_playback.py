"""At which rate images are played, and how long each is shown."""

from __future__ import annotations

import pytest

from unisim_blender.core.output.video import MAX_RATE_HZ, playback


def test_evenly_spaced_times_are_played_at_their_rate() -> None:
    rate, counts = playback([0.5 + 0.1 * i for i in range(4)])
    assert rate == pytest.approx(10) and counts == [1, 1, 1, 1]
    # a log's stamps are a millisecond apart from even ones
    rate, counts = playback([0.0, 0.1001, 0.2, 0.3001])
    assert rate == pytest.approx(10, rel=1e-3) and counts == [1, 1, 1, 1]


def test_an_image_is_shown_until_the_next_ones_time() -> None:
    rate, counts = playback([-0.1, 0.0, 0.05, 0.3])
    assert rate == pytest.approx(20) and counts == [2, 1, 5, 1]
    assert [sum(counts[:i]) / rate for i in range(4)] == pytest.approx([0.0, 0.1, 0.15, 0.4])


def test_a_player_that_is_faster_shows_each_for_longer() -> None:
    assert playback([0.0, 0.05, 0.1], least_hz=40) == (40, [2, 2, 1])


def test_few_times() -> None:
    assert playback([], 5) == (5, []) and playback([3.0]) == (10, [1])


def test_times_a_microsecond_apart_make_no_long_film() -> None:
    assert playback([0.0, 1e-6, 0.1]) == (MAX_RATE_HZ, [0, 24, 1])
