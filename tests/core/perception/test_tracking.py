"""The example stack's tracker and forecasts on boxes by hand."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[3]))

from examples.perception.forecast import STRAIGHT_S, forecast
from examples.perception.objects import Detection, Track
from examples.perception.route import Route
from examples.perception.tracker import (
    GATE,
    HITS,
    LOST_S,
    MOST_LOST_S,
    Tracker,
    assigned,
    corrected,
    distinct,
    predicted,
)
from unisim_blender.core.geometry import FloatArray

ALONG_X = Route.through(np.stack([np.arange(0.0, 120.0), np.zeros(120)], -1))
TIMES_S = np.arange(0.0, 6.01, 0.25)


def seen(x: float, y: float, deviation_m: float = 0.3, yaw: float = 0.0, score: float = 0.9) -> Detection:
    return Detection(np.array([x, y, 4.5, 1.9, yaw]), np.eye(2) * deviation_m**2, score)


def followed(places: FloatArray, deviation_m: float = 0.3, step_s: float = 0.1) -> Tracker:
    """A tracker that has seen one vehicle at places (T, 2)."""
    tracker = Tracker()
    for number, (x, y) in enumerate(places.tolist()):
        tracker.update(number * step_s, [seen(x, y, deviation_m)])
    return tracker


def moving(state: tuple[float, float, float, float]) -> Track:
    covariance = np.diag([0.1, 0.1, 0.1, 0.1])
    return Track(1, 0.0, np.array(state), covariance, np.array([4.5, 1.9, 0.0]), 1.0, 0.9, 0.0, HITS)


def test_a_filter_without_process_noise_is_least_squares(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("examples.perception.tracker.ACCELERATION_M_S2", 0.0)
    monkeypatch.setattr("examples.perception.tracker.FIRST_SPEED_M_S", 1e3)
    rng = np.random.default_rng(1)
    times = 0.1 * np.arange(20)
    x = 5 + 3 * times + rng.normal(0, 0.3, 20)
    (track,) = followed(np.stack([x, np.zeros(20)], -1)).confirmed
    slope, offset = np.polyfit(times, x, 1)
    assert track.state[2] == pytest.approx(slope, abs=1e-3)
    assert track.state[0] == pytest.approx(offset + slope * times[-1], abs=1e-3)


def test_covariance_shrinks_by_a_detection_and_grows_without() -> None:
    track = moving((0, 0, 5, 0))
    later = predicted(track, 0.5)
    assert later.state[:2].tolist() == [2.5, 0.0] and (np.diag(later.covariance) > np.diag(track.covariance)).all()
    taken = corrected(later, seen(2.5, 0.0))
    assert (np.linalg.eigvalsh(later.covariance - taken.covariance) >= -1e-12).all() and taken.hits == HITS + 1


def test_pairs_have_the_least_sum_and_keep_to_their_gates() -> None:
    tracks = [moving((0, 0, 0, 0)), moving((2, 0, 0, 0))]
    # the nearest detection of the first track is the only one that the second can have
    assert sorted(assigned(tracks, [seen(1.1, 0), seen(-1.1, 0)])) == [(0, 1), (1, 0)]
    within = float(np.sqrt(GATE * (0.1 + 0.3**2)))
    assert assigned(tracks[:1], [seen(within - 0.01, 0)]) == [(0, 0)]
    assert assigned(tracks[:1], [seen(within + 0.01, 0)]) == []


def test_two_vehicles_that_pass_keep_their_numbers() -> None:
    tracker = Tracker()
    for number in range(30):
        t = 0.1 * number
        tracker.update(t, [seen(10 * t, 0), seen(30 - 10 * t, 3.2)])
    states = {track.number: track.state for track in tracker.confirmed}
    assert sorted(states) == [1, 2] and states[1][2] == pytest.approx(10, abs=0.3)
    assert states[2][2] == pytest.approx(-10, abs=0.3)


def test_tracks_are_confirmed_and_lost() -> None:
    tracker = Tracker()
    for number in range(HITS):
        assert not tracker.confirmed
        tracker.update(0.1 * number, [seen(20, 0)])
    assert len(tracker.confirmed) == 1
    tracker.update(0.2 + HITS * LOST_S - 0.01, [])
    assert len(tracker.confirmed) == 1
    tracker.update(0.2 + HITS * LOST_S + 0.01, [])
    assert not tracker.confirmed
    longer = followed(np.tile([20.0, 0.0], (40, 1)))
    longer.update(3.9 + MOST_LOST_S - 0.01, [])
    assert len(longer.confirmed) == 1
    longer.update(3.9 + MOST_LOST_S + 0.01, [])
    assert not longer.confirmed


def test_a_second_opinion_of_a_vehicle_is_no_vehicle() -> None:
    """A camera takes a car to be 2.6 m nearer than sweeps have it: by its own deviations that is another place, but no two cars
    fit there. One that follows closely is another one."""
    tracker, weight = Tracker(), 0.1
    for number in range(12):
        x = 30 + 1.0 * number
        tracker.update(0.1 * number, [seen(x, 0), seen(x - 5.2, 0)])
        nearer = replace(seen(x + 0.4 - 2.6, 0.3, deviation_m=0.7), weight=weight)
        tracker.update(0.1 * number + 0.05, [nearer])
    assert sorted(round(track.state[0] - 41.5) for track in tracker.confirmed) == [-5, 0]


def imaged(x: float, deviation_m: float, y: float = 0.0) -> Detection:
    """What a camera at the origin has of a vehicle: its distance with a deviation, and 0.5 m across."""
    covariance = np.diag([deviation_m**2, 0.25])
    return Detection(np.array([x, y, 4.5, 1.9, 0.0]), covariance, 0.9, weight=0.1, seen_from=np.zeros(2))


def test_the_distance_from_a_camera_is_as_uncertain_as_where_the_vehicle_is() -> None:
    """A pixel is worth (40 / 30)² times as much at 40 m as at 30: of 3 m there are 16/3 m here."""
    assert np.allclose(imaged(30.0, 3.0).covariance_at(np.array([40.0, 0.0])), np.diag([(16 / 3) ** 2, 0.25]))
    assert np.allclose(imaged(30.0, 3.0).covariance_at(np.array([30.0, 0.0])), np.diag([9.0, 0.25]))
    aside = Detection(np.array([18.0, 24, 4.5, 1.9, 0]), np.eye(2), 0.9, seen_from=np.zeros(2))
    ray = np.array([0.6, 0.8])
    assert np.allclose(aside.covariance_at(np.array([36.0, 48])), np.eye(2) + 15 * np.outer(ray, ray))


def test_a_camera_has_a_vehicle_ten_metres_nearer_than_sweeps() -> None:
    """10 m are 3.3 of the 3 m that it says, and 1.9 of the 5.3 m that these are at the vehicle: it is the same vehicle, and its
    track does not move by it while sweeps have it. Without them images move it again."""
    tracker = Tracker()
    for number in range(20):
        tracker.update(0.1 * number, [seen(40, 0)])
        tracker.update(0.1 * number + 0.05, [imaged(30, 3.0)])
    (track,) = tracker.confirmed
    assert track.state[0] == pytest.approx(40.0, abs=1e-9) and track.hits == 40
    for number in range(20, 40):
        tracker.update(0.1 * number, [imaged(30, 3.0)])
    (track,) = tracker.confirmed
    assert 30 < track.state[0] < 38


def test_a_track_of_images_ends_when_sweeps_have_its_vehicle_elsewhere() -> None:
    """Ten images have a car at 30 m, from then on sweeps at 40 m. Filtered, the first have a deviation of about a metre, but each
    image errs alike. Where every image has two vehicles there are two."""
    one, two = Tracker(), Tracker()
    for number in range(20):
        one.update(0.1 * number, [imaged(30, 3.0)])
        two.update(0.1 * number, [imaged(30, 3.0), imaged(41, 5.5)])
        if number >= 10:
            one.update(0.1 * number + 0.05, [seen(40, 0)])
            two.update(0.1 * number + 0.05, [seen(40, 0)])
        if number == 9:
            assert [round(track.state[0]) for track in one.confirmed] == [30]
    assert [round(track.state[0]) for track in one.confirmed] == [40]
    assert sorted(round(track.state[0]) for track in two.confirmed) == [30, 40]


def test_a_vehicle_beside_another_one_is_seen_by_the_camera_alone() -> None:
    """In the next lane, 3.5 m aside, which are seven of the deviations across the camera's ray."""
    tracker = Tracker()
    for number in range(20):
        tracker.update(0.1 * number, [imaged(30, 3.0, y=3.5)])
        tracker.update(0.1 * number + 0.05, [seen(40, 0)])
    assert sorted(round(track.state[0]) for track in tracker.confirmed) == [30, 40]


def test_of_two_tracks_in_one_place_the_one_of_more_weight_stays() -> None:
    light = replace(moving((1.5, 0.2, 0, 0)), weight=0.3, number=1, hits=9)
    heavy, behind = replace(moving((0, 0, 8, 0)), number=2), replace(moving((-4.4, 0, 8, 0)), number=3)
    assert [track.number for track in distinct([light, heavy, behind])] == [2, 3]
    assert distinct([]) == []


def test_a_weak_detection_begins_no_track_but_continues_one() -> None:
    tracker = Tracker()
    for number in range(5):
        tracker.update(0.1 * number, [seen(20, 0, score=0.5)])
    assert not tracker.confirmed
    for number in range(5, 10):
        tracker.update(0.1 * number, [seen(20, 0, score=0.9 if number == 5 else 0.5)])
    assert len(tracker.confirmed) == 1


def test_half_a_turn_is_the_same_box() -> None:
    track = corrected(moving((0, 0, 0, 0)), seen(0, 0, yaw=np.pi - 0.1))
    assert track.shape[2] == pytest.approx(-0.05, abs=1e-9)


def test_a_standing_vehicle_is_forecast_to_stand() -> None:
    rng = np.random.default_rng(2)
    (track,) = followed(np.array([30.0, 0.0]) + rng.normal(0, 0.3, (10, 2))).confirmed
    (mode,) = forecast(track, ALONG_X, TIMES_S)
    assert mode.trusted == len(TIMES_S) and np.ptp(mode.boxes[:, :2], axis=0).max() == 0


def test_forecasts_along_a_bend_and_straight_on() -> None:
    angle = np.linspace(0, np.pi / 2, 100)
    radius = 40.0
    bend = Route.through(radius * np.stack([np.sin(angle), 1 - np.cos(angle)], -1))
    along, straight = forecast(moving((0, -3.0, 8, 0)), bend, TIMES_S)
    # outside, three metres from the bend: an arc of 43 m
    turned = 8 * TIMES_S / (radius + 3)
    arc = np.stack([(radius + 3) * np.sin(turned), radius - (radius + 3) * np.cos(turned)], -1)
    assert np.abs(along.boxes[:, :2] - arc).max() < 0.5
    assert np.abs(along.boxes[:, 4] - turned).max() < 0.03
    assert straight.boxes[-1, :2].tolist() == [48.0, -3.0]
    assert along.probability + straight.probability == 1 and straight.trusted == STRAIGHT_S / 0.25 + 1
    (only,) = forecast(moving((20, 9, 0, -5)), ALONG_X, TIMES_S)
    assert only.boxes[-1, :2].tolist() == [20.0, 9 - 30.0]


def test_places_on_a_route_and_back() -> None:
    angle = np.linspace(0, 1.0, 60)
    route = Route.through(50 * np.stack([np.sin(angle), 1 - np.cos(angle)], -1))
    assert np.abs(route.curvature[4:-4] - 1 / 50).max() < 2e-3
    for s, d in ((12.3, 2.0), (33.3, -4.0), (60.0, 1.0), (-5.0, -1.0)):
        x, y = route.place(np.array(s), np.array(d))
        assert route.project(float(x), float(y)) == pytest.approx((s, d), abs=0.02)
