"""Streets with bends and drives at other speeds: their coordinates, solids, what is recorded of them, and their recipes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from unisim_blender.core.cli.main import unisim
from unisim_blender.core.errors import LogError
from unisim_blender.core.formats.pandaset.sensors import PANDAR64
from unisim_blender.core.geometry import FloatArray
from unisim_street.assets.road import (
    BEND_RADIUS_M,
    HALF_ROAD_WIDTH_M,
    HALF_STREET_WIDTH_M,
    KERB_HEIGHT_M,
    LANE_WIDTH_M,
    MIN_SELF_DISTANCE_M,
    Course,
)
from unisim_street.layout import EGO_Y_M, FRAME_S
from unisim_street.street import (
    RECIPE_FILE,
    Recipe,
    Street,
    build_street,
    load_street,
    recipe_document,
    street_origin,
)
from unisim_street.tracing.shapes import Sector
from unisim_street.tracing.trace import AssetPlacement, make_bundles, trace
from unisim_street.truth import truth_lidar

TURNS, SPEED_M_S, FRAMES = (90.0, -45.0), 20.0, 171
"""340 m: the first bend lies between 81 and 144 m."""


@pytest.fixture(scope="module")
def street() -> Street:
    return build_street(3, FRAMES, 96, 54, speed_m_s=SPEED_M_S, turns_deg=TURNS)


def test_places_and_coordinates_are_inverse() -> None:
    course = Course((90.0, -60.0, 30.0), 600.0)
    rng = np.random.default_rng(0)
    s, d = rng.uniform(-80, 700, 4000), rng.uniform(-30, 30, 4000)
    x, y, heading = course.place(s, d, np.zeros(4000))
    along, beside = course.coordinates(np.stack([x, y], -1))
    np.testing.assert_allclose(along, s, atol=1e-9)
    np.testing.assert_allclose(beside, d, atol=1e-9)
    ahead = np.stack(course.place(s + 1e-5, d, heading * 0)[:2], -1) - np.stack([x, y], -1)
    np.testing.assert_allclose(np.arctan2(ahead[:, 1], ahead[:, 0]), (heading + np.pi) % (2 * np.pi) - np.pi, atol=1e-4)
    assert course.place(np.array([700.0]), np.zeros(1), np.zeros(1))[2][0] == pytest.approx(np.radians(60.0))


def test_the_middle_line_is_as_long_as_it_says_and_bends_by_its_radius() -> None:
    course = Course((120.0,), 300.0)
    s = np.arange(0, 300, 0.01)
    x, y, heading = course.place(s, np.zeros(len(s)), np.zeros(len(s)))
    steps = np.hypot(np.diff(x), np.diff(y))
    np.testing.assert_allclose(steps, 0.01, rtol=1e-6)
    turning = np.diff(heading) / 0.01
    assert turning.max() == pytest.approx(1 / BEND_RADIUS_M) and turning.min() == 0.0


@pytest.mark.parametrize("turns", [(), (90.0,)])
def test_a_pose_is_that_of_its_place(turns: tuple[float, ...]) -> None:
    course = Course(turns, 300.0)
    for s in (-20.0, 10.0, 150.0, 290.0):
        pose = course.pose(s)
        x, y, heading = course.place(np.array([s]), np.array([3.0]), np.zeros(1))
        np.testing.assert_allclose(pose @ [s, 3.0, 1.0, 1.0], [x[0], y[0], 1.0, 1.0], atol=1e-9)
        np.testing.assert_allclose(pose[:2, 0], [np.cos(heading[0]), np.sin(heading[0])], atol=1e-12)


@pytest.mark.parametrize("inner", [0.0, 4.0])
def test_sectors_are_met_where_they_are(inner: float) -> None:
    """Against steps of a millimetre through what is inside."""
    shape = Sector(inner, 9.0, 0.6, -0.5, 1.0)
    rng = np.random.default_rng(1)
    origins = rng.uniform((-4, -8, -2), (12, 8, 3), (300, 3))
    directions = rng.standard_normal((300, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)

    def inside(points: FloatArray) -> FloatArray:
        radius, angle = np.hypot(points[..., 0], points[..., 1]), np.arctan2(points[..., 1], points[..., 0])
        level = (points[..., 2] >= -0.5) & (points[..., 2] <= 1.0)
        return np.asarray(level & (radius >= inner) & (radius <= 9.0) & (np.abs(angle) <= 0.6))

    t_min = np.where(np.arange(300) % 3 == 0, 2.0, 0.0)
    found = shape.intersect(origins, directions, t_min)
    steps = np.arange(0, 25, 1e-3)
    met = 0
    for origin, direction, start, t in zip(origins, directions, t_min, found, strict=True):
        within = inside(origin + (start + steps)[:, None] * direction)
        first = start + steps[within.argmax()] if within.any() else np.inf
        if np.isfinite(t) and not np.isfinite(first):  # a corner that no step hits
            assert not inside(origin + (t + 2e-3) * direction)
            continue
        assert t == pytest.approx(first, abs=2e-3)
        met += np.isfinite(t)
    assert met > 30
    entered = np.isfinite(found) & (found > t_min + 1e-6) & (inner == 0.0)
    points = origins[entered] + found[entered, None] * directions[entered]
    normals = shape.normals(points)
    assert ((normals * directions[entered]).sum(1) <= 1e-9).all()
    assert not inside(points + 1e-6 * normals).any() and inside(points - 1e-6 * normals).all()


def test_the_ground_is_as_high_as_it_says(street: Street) -> None:
    rng = np.random.default_rng(2)
    s, d = rng.uniform(-50, 370, 3000), rng.uniform(-20, 20, 3000)
    d = np.where(np.abs(np.abs(d) - HALF_ROAD_WIDTH_M) < 1e-3, 0.0, d)
    x, y, _ = street.plan.course.place(s, d, np.zeros(3000))
    origins = np.stack([x, y, np.full(3000, 5.0)], -1)
    down = np.broadcast_to([0.0, 0.0, -1.0], origins.shape)
    hits = trace(
        [AssetPlacement("ground", street.ground)], make_bundles(origins[:, None], down[:, None], np.zeros((3000, 1)))
    )
    height = 5.0 - hits.t[:, 0]
    np.testing.assert_allclose(height, street.ground_height(origins[:, :2]), atol=1e-9)
    in_crossing = (s > street.plan.crossing[0]) & (s < street.plan.crossing[1])
    np.testing.assert_array_equal(height > KERB_HEIGHT_M / 2, (np.abs(d) > HALF_ROAD_WIDTH_M) & ~in_crossing)


def test_a_sweep_in_a_bend_lies_on_what_is_there(street: Street) -> None:
    frame = 55
    sweep = truth_lidar(street, street.drive, PANDAR64, frame)
    back = sweep.returned
    points = (sweep.origins + sweep.directions * sweep.depth_m[..., None])[back] + street.drive.world_origin
    s, d = street.plan.course.coordinates(points[:, :2])
    assert 90 < np.median(s) < 135
    ground = (sweep.instance[back] == 0) & (np.abs(points[:, 2] - street.ground_height(points[:, :2])) < 2e-3)
    assert (ground & (np.abs(d) < HALF_ROAD_WIDTH_M)).sum() > 5000 and (
        ground & (np.abs(d) > HALF_ROAD_WIDTH_M)
    ).sum() > 500
    assert points[:, 2].min() > -2e-3
    # fronts bound the street on both sides, all round the bend; nearer stand trees and lamps
    high = (points[:, 2] > 7.5) & (np.abs(s - 112) < 30)
    assert (np.abs(d[high]) > HALF_STREET_WIDTH_M - 1.0).all()
    fronts = (points[:, 2] > 2.5) & (np.abs(s - 112) < 30)
    assert ((d > 8) & fronts).sum() > 300 and ((d < -8) & fronts).sum() > 300


def test_the_drive_and_the_traffic_follow_the_street(street: Street) -> None:
    drive = street.drive
    times = np.array([drive.time_s[frame] for frame in drive.frames])
    poses = street_origin(drive.world_origin) @ drive.world_from_ego.at(times)
    s, d = street.plan.course.coordinates(poses[:, :2, 3])
    np.testing.assert_allclose(s, SPEED_M_S * FRAME_S * np.arange(FRAMES), atol=1e-6)
    assert (np.abs(d - EGO_Y_M) < 0.17).all()
    heading = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    assert np.degrees(heading[-1] - heading[0]) == pytest.approx(sum(TURNS), abs=2.0)
    assert np.degrees(heading).max() == pytest.approx(90.0, abs=2.0)
    moving = 0
    for actor in drive.actors.values():
        there = times[(times >= actor.start_s) & (times <= actor.end_s)]
        at = street_origin(drive.world_origin) @ actor.world_from_actor.at(there)
        s, d = street.plan.course.coordinates(at[:, :2, 3])
        assert (
            (np.abs(d) < HALF_STREET_WIDTH_M).all()
            and (s > street.plan.start_x).all()
            and (s < street.plan.end_x).all()
        )
        if actor.is_moving:
            moving += 1
            assert (np.abs(np.abs(d) - LANE_WIDTH_M / 2) < 0.3).all()
            ahead = street.plan.course.place(s, d, np.zeros(len(s)))[2]
            along = np.cos(np.arctan2(at[:, 1, 0], at[:, 0, 0]) - ahead)
            assert (np.abs(along) > 0.99).all() and (np.sign(along) == -np.sign(d)).all()
    assert moving > 8


def test_a_straight_street_at_another_speed_is_longer() -> None:
    street = build_street(0, 11, 96, 54, speed_m_s=30.0)
    assert np.ptp(street.drive.world_from_ego.positions[:, 0]) == pytest.approx(30.0)
    assert street.plan.course.is_straight and street.plan.end_x == 200.0


def test_a_recipe_is_read_as_it_was_written(street: Street, tmp_path: Path) -> None:
    document = recipe_document(street.recipe)
    (tmp_path / RECIPE_FILE).write_text(json.dumps(document))
    again = load_street(tmp_path)
    assert again.recipe == street.recipe and document["turns_deg"] == [90.0, -45.0]
    np.testing.assert_array_equal(again.drive.world_from_ego.positions, street.drive.world_from_ego.positions)
    assert set(recipe_document(Recipe())) & {"turns_deg", "speed_m_s"} == set()


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ({"turns_deg": (90.0,)}, "is for a drive of at least 183 m, not 15 m"),
        ({"turns_deg": (121.0,), "frames": 400}, "turns_deg are up to 20 numbers from 1 to 120 degrees"),
        ({"turns_deg": (0.0,), "frames": 400}, "turns_deg are up to 20 numbers"),
        ({"turns_deg": (float("nan"),), "frames": 400}, "turns_deg are up to 20 numbers"),
        ({"turns_deg": ("left",), "frames": 400}, "turns_deg are up to 20 numbers"),
        ({"turns_deg": (90.0,) * 4, "frames": 1000}, f"comes within {MIN_SELF_DISTANCE_M:.0f} m of itself"),
        ({"speed_m_s": 0.5}, "speed_m_s is from 1 to 40 m/s, not 0.5"),
        ({"speed_m_s": True}, "speed_m_s is from 1 to 40 m/s"),
        ({"speed_m_s": 20.0, "engine": "cycles"}, "drawn by the exact engine alone"),
    ],
)
def test_what_no_street_can_be_is_refused(values: dict[str, object], sentence: str) -> None:
    with pytest.raises(LogError) as error:
        build_street(**values)  # type: ignore[arg-type]
    assert sentence in str(error.value)


def test_the_command_refuses_turns_that_are_no_numbers_or_too_many(tmp_path: Path) -> None:
    for turns, sentence in (("left", "are degrees"), ("90", "at least 183 m")):
        result = CliRunner().invoke(unisim, ["synth", str(tmp_path / "street"), "--turns", turns])
        assert result.exit_code and sentence in result.output + str(result.exception)
    assert not (tmp_path / "street").exists()
