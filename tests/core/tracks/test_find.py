"""Tracks found in the sweeps of a street of boxes, whose actors are known, and each stage of it."""

from __future__ import annotations

import base64
import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from unisim_blender.core.data.log import Log, Sweep
from unisim_blender.core.data.moved import on_trajectory
from unisim_blender.core.errors import LogError
from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_yaw
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.tracks import evidence as evidence_module
from unisim_blender.core.tracks.associate import associate
from unisim_blender.core.tracks.box_file import Track, default_path, read_boxes
from unisim_blender.core.tracks.boxes import closest_heading, completed, viewed_from
from unisim_blender.core.tracks.certainty import moving_features, probability
from unisim_blender.core.tracks.clusters import Cluster
from unisim_blender.core.tracks.evidence import evidence_of
from unisim_blender.core.tracks.find import RISE_M, _heading, find_tracks, in_own_world
from unisim_blender.core.tracks.free_space import left_or_entered, range_image, windows
from unisim_blender.core.tracks.ground import GroundBuilder
from unisim_blender.core.tracks.register import PlanarPath, register, returns_of, rotated, smoothed
from unisim_blender.core.tracks.report import report, seen_by
from unisim_blender.core.tracks.scans import Scan, read_scan, scans_of
from unisim_blender.core.tracks.shape import class_of, shape_of
from unisim_blender.core.tracks.standing import COLUMNS, StandingBox, _pieces, around, standing_box
from unisim_blender.core.world.drive import Drive, Lidar, LidarModel

MODEL = LidarModel(np.radians(np.linspace(8, -20, 40)), np.zeros(40), columns=450, max_range_m=70.0)
FRAMES, STEP_S, SPEED = 16, 0.2, 5.0
MOUNT = make_pose(np.array([0.5, 0.0, 1.8]), np.array([1.0, 0, 0, 0]))
WALLS = np.array([[[-60, 12, 0], [90, 13, 6]], [[-60, -13, 0], [90, -12, 6]]], float)
PARKED = np.array([16.0, -7.0])
BODY, CABIN = np.array([4.4, 1.8, 0.8]), np.array([2.4, 1.4, 0.7])


def car_at(time_s: float) -> FloatArray:
    """Middle (2,) of the car that drives, along x."""
    return np.array([8.0 + 8.0 * time_s, 4.0])


def person_at(time_s: float) -> FloatArray:
    return np.array([12.0, -4.0 + 1.4 * time_s])


def car_boxes(middle: FloatArray) -> FloatArray:
    """Corners (2, 2, 3) of a car's body and of its windows and roof."""
    body, cabin = np.array([*middle, 0.6]), np.array([*middle, 1.3])
    return np.array([[body - BODY / 2, body + BODY / 2], [cabin - CABIN / 2, cabin + CABIN / 2]])


def ranges(origins: FloatArray, directions: FloatArray, solid: FloatArray) -> FloatArray:
    """Distances (N,) to the ground or a box; inf beyond the LiDAR's range."""
    with np.errstate(divide="ignore"):
        nearest = np.where(directions[:, 2] < 0, -origins[:, 2] / directions[:, 2], np.inf)
        for low, high in solid:
            ends = ((low - origins) / directions, (high - origins) / directions)
            enter, leave = np.minimum(*ends).max(1), np.maximum(*ends).min(1)
            nearest = np.where((enter > 0) & (enter < leave), np.minimum(nearest, enter), nearest)
    return np.where(nearest < MODEL.max_range_m, nearest, np.inf)


class DrivenLog:
    """A log without boxes: a car drives ahead, one is parked, a person crosses, between two walls."""

    def __init__(self, path: Path, frames: int = FRAMES, lidars: int = 1) -> None:
        self.path, self.missing, self.reads = path, (), 0
        path.touch()
        times = {frame: frame * STEP_S for frame in range(frames)}
        keys = np.array([-1.0, 10.0])
        ego = Trajectory(keys, np.stack([SPEED * keys, 0 * keys, 0 * keys], 1), quaternion_from_yaw(0.0 * keys))
        sensors = {}
        for number in range(lidars if frames else 0):
            beams = {name: getattr(MODEL, name)[number::lidars] for name in ("elevation_rad", "azimuth_offset_rad")}
            later = {frame: time_s + 0.005 * number for frame, time_s in times.items()}
            name = ["top", "low"][number]
            sensors[name] = Lidar(name, replace(MODEL, **beams), ego.transformed(right=MOUNT), later)
        self.drive = Drive("street", tuple(times), times, ego, {}, sensors, {})

    def sweep_frames(self, lidar: str) -> tuple[int, ...]:
        return self.drive.frames

    def sweep(self, lidar: str, frame: int) -> Sweep:
        self.reads += 1
        sensor = self.drive.lidars[lidar]
        time_s = sensor.time_s[frame] - MODEL.sweep_s / 2
        rays = lidar_rays(sensor, sensor.time_s[frame]).flat()
        person = np.array([*person_at(time_s), 0.9])
        half = np.array([0.25, 0.3, 0.85])
        solid = np.concatenate([WALLS, car_boxes(car_at(time_s)), car_boxes(PARKED), [[person - half, person + half]]])
        depth = ranges(rays.origins, rays.directions, solid)
        met = np.flatnonzero(np.isfinite(depth))
        depth = depth[met] + np.random.default_rng(frame).normal(0, 0.01, len(met))
        none = np.full(len(met), -1, np.int32)
        return Sweep(
            rays.origins[met] + rays.directions[met] * depth[:, None], rays.origins[met],
            np.full(len(met), time_s), np.ones(len(met), np.float32), none, none, none,
        )  # fmt: skip


def driven(path: Path, **options: Any) -> Any:
    return DrivenLog(path / "log", **options)


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Log, tuple[Track, ...]]:
    folder = tmp_path_factory.mktemp("searched")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("UNISIM_CACHE", str(folder / "cache"))
        log = driven(folder)
        return log, find_tracks(log)


def test_what_drives_and_what_is_parked_is_found(searched: tuple[Log, tuple[Track, ...]]) -> None:
    tracks = [track for track in searched[1] if track.certainty > 0.3]
    (car,) = (track.actor for track in tracks if track.actor.is_moving and track.actor.label == "Car")
    times = np.linspace(car.start_s, car.end_s, 7)
    assert car.end_s - car.start_s > 0.8 * (FRAMES - 1) * STEP_S
    poses = car.world_from_actor.at(times)
    assert np.abs(poses[:, :2, 3] - [car_at(time) for time in times]).max() < 0.35
    assert np.degrees(np.abs(np.arctan2(poses[:, 1, 0], poses[:, 0, 0])).max()) < 2
    assert np.abs(car.size_m - [4.4, 1.8, 1.65]).max() < 0.4
    (parked,) = (track.actor for track in tracks if not track.actor.is_moving)
    pose = parked.world_from_actor.at(1.0)
    assert parked.label == "Car" and np.abs(pose[:2, 3] - PARKED).max() < 0.3 and abs(pose[1, 0]) < 0.05
    assert len(parked.world_from_actor.times_s) == 1


def test_what_two_lidars_see_at_once_is_registered_together(tmp_path: Path) -> None:
    log = driven(tmp_path, lidars=2)
    (car,) = (
        track.actor for track in find_tracks(log)
        if track.certainty > 0.3 and track.actor.is_moving and track.actor.label == "Car"
    )  # fmt: skip
    times = np.linspace(car.start_s, car.end_s, 7)
    assert np.diff(car.world_from_actor.times_s).min() > 0.1
    assert np.abs(car.world_from_actor.at(times)[:, :2, 3] - [car_at(time) for time in times]).max() < 0.35


def test_who_walks_is_a_person(searched: tuple[Log, tuple[Track, ...]]) -> None:
    (person,) = (track.actor for track in searched[1] if track.actor.label == "Pedestrian")
    assert np.linalg.norm(person.world_from_actor.at(1.5)[:2, 3] - person_at(1.5)) < 0.25


def test_walls_are_no_tracks(searched: tuple[Log, tuple[Track, ...]]) -> None:
    assert len([track for track in searched[1] if track.certainty > 0.3]) == 3


def test_a_second_search_reads_no_sweep_and_gives_the_same(tmp_path: Path) -> None:
    log, stages = driven(tmp_path, frames=8), []
    first = find_tracks(log, lambda stage, done: stages.append((stage, done)))
    reads = log.reads
    second = find_tracks(log)
    assert log.reads == reads and len(first) == len(second) > 0
    for a, b in zip(first, second, strict=True):
        assert a.actor.world_from_actor.content() == b.actor.world_from_actor.content() and a.certainty == b.certainty
    assert list(dict.fromkeys(stage for stage, _ in stages)) == ["ground", "clusters", "registration", "standing"]
    shares = [done for _, done in stages]
    assert shares == sorted(shares) and 0 < shares[0] and shares[-1] == 1.0


def test_a_broken_cache_is_made_anew(tmp_path: Path) -> None:
    log = driven(tmp_path, frames=3)
    first = evidence_of(log)
    (file,) = (tmp_path / "cache" / "tracks").iterdir()
    file.write_bytes(file.read_bytes()[:500])
    assert np.array_equal(evidence_of(log).ground.heights, first.ground.heights) and log.reads == 12


def test_a_search_is_cancelled_by_its_progress(tmp_path: Path) -> None:
    def cancel(stage: str, done: float) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        find_tracks(driven(tmp_path), cancel)
    assert not (tmp_path / "cache" / "tracks").exists()


def test_a_log_without_sweeps_is_refused_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="no two sweeps of a LiDAR.*boxes from a file"):
        find_tracks(driven(tmp_path, frames=1))


def test_sweeps_that_show_nothing_have_no_tracks(tmp_path: Path) -> None:
    log = driven(tmp_path, frames=3)
    sweep = log.sweep("top", 0)
    for count in (0, 1):
        names = ("points", "origins", "time_s", "intensity", "ring", "column", "semantic")
        few = replace(sweep, **{name: getattr(sweep, name)[:count] for name in names})
        log.sweep = lambda lidar, frame, few=few: few
        (tmp_path / "log").write_text(str(count))  # another stamp, another cache
        assert find_tracks(log) == ()


def test_tracks_of_refined_poses_lie_in_the_logs_own_world(searched: tuple[Log, tuple[Track, ...]]) -> None:
    log, tracks = searched
    ego = log.drive.world_from_ego
    turned = make_pose(np.array([3.0, 1.0, 0.0]), quaternion_from_yaw(0.1))
    used = on_trajectory(log, ego.transformed(left=turned), "refined").drive
    moved = [replace(track, actor=replace(track.actor, world_from_actor=track.actor.world_from_actor.transformed(left=turned)))
             for track in tracks]  # fmt: skip
    for track, own in zip(in_own_world(moved, used, log.drive), tracks, strict=True):
        assert np.allclose(track.actor.world_from_actor.positions, own.actor.world_from_actor.positions, atol=1e-6)


def test_the_command_writes_a_file_of_boxes_and_a_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from unisim_blender.core.cli.commands.track import command
    from unisim_blender.core.formats import readers

    log = driven(tmp_path, frames=12)
    monkeypatch.setattr(readers, "open_log", lambda path: log)
    page, film = tmp_path / "report.html", tmp_path / "film.html"
    args = [str(log.path), "--report", str(page), "--film", str(film), "--poses", "log", "--quiet"]
    result = CliRunner().invoke(command, args)
    assert result.exit_code == 0, result.output
    tracks = read_boxes(default_path(log.path)).tracks
    assert {track.source for track in tracks} == {"lidar"} and min(track.certainty for track in tracks) >= 0.3
    assert all(track.actor.uid in page.read_text() for track in tracks)
    assert "moving Car" in result.output
    assert len(list((tmp_path / "film").iterdir())) == 12 and "000011.jpg" in film.read_text()


def test_the_report_stands_alone(searched: tuple[Log, tuple[Track, ...]]) -> None:
    log, tracks = searched
    pictures = []
    for shown in (tracks, ()):
        text = report(log, shown)
        assert "http" not in text
        (data,) = re.findall(r'<img src="data:image/png;base64,([^"]+)"', text)
        pictures.append(np.asarray(Image.open(io.BytesIO(base64.b64decode(data)))))
    boxed, bare = ((picture.max(2) > picture.min(2).astype(int) + 60).sum() for picture in pictures)
    assert boxed > bare + 100 * len(tracks)  # the boxes are in the picture itself


def test_what_one_sensor_alone_saw(searched: tuple[Log, tuple[Track, ...]]) -> None:
    log, tracks = searched
    moving, standing = (next(t for t in tracks if t.actor.is_moving == moves) for moves in (True, False))
    far = standing.actor.world_from_actor.transformed(
        left=make_pose(np.array([0.0, 300.0, 0.0]), quaternion_from_yaw(0.0))
    )
    away = replace(standing, actor=replace(standing.actor, uid="away", world_from_actor=far))
    lidar = next(iter(log.drive.lidars))
    seen = seen_by(log, (moving, standing, away))
    assert lidar in seen[moving.actor.uid] and lidar in seen[standing.actor.uid] and seen["away"] == set()
    page = report(log, (moving, away))
    assert re.search(r"<td>away<[^\n]* class=alone>none", page) and page.startswith("<!doctype html>")
    assert f"1 moving {moving.actor.label}, 1 standing {standing.actor.label}" in page


def test_ground_is_below_what_stands(tmp_path: Path) -> None:
    log = driven(tmp_path)
    builder = GroundBuilder(log.drive.world_from_ego)
    for ref in scans_of(log)[:4]:
        builder.add(read_scan(log, ref).points)
    assert np.abs(builder.ground().height(np.array([[5.0, 0.0], [*PARKED], [20.0, 4.0]]))).max() < 0.05


def test_ground_follows_a_slope() -> None:
    xy = np.random.default_rng(0).uniform(-30, 30, (40000, 2))
    ego = Trajectory(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]))
    builder = GroundBuilder(ego)
    for part in np.split(np.column_stack([xy, 0.1 * xy[:, 0]]), 2):
        builder.add(part)
    at = np.array([[-10.0, 3.0], [12.0, -5.0]])
    assert np.abs(builder.ground().height(at) - 0.1 * at[:, 0]).max() < 0.08


def test_a_place_that_is_seen_through_later_has_been_left(tmp_path: Path) -> None:
    log = driven(tmp_path)
    refs = scans_of(log)
    images = {number: range_image(read_scan(log, ref)) for number, ref in enumerate(refs)}
    left = np.array([[*car_at(0.1), 1.0]]) - [2.2, 0, 0]
    stands = np.array([[*PARKED, 0.8]]) + [-2.2, 0.5, 0]
    behind = np.array([[10.0, 30.0, 1.0]])
    moving, stays = left_or_entered(np.concatenate([left, stands, behind]), images, windows(refs, 0))
    assert moving.tolist() == [True, False, False] and stays.tolist() == [False, True, False]


def test_rolling_rays_are_looked_along_from_their_own_origin() -> None:
    angle = np.linspace(-np.pi, np.pi, 3600, endpoint=False)
    origins = np.stack([10 * angle / np.pi, 0 * angle, 0 * angle], 1)  # the ego moves by 20 m within the sweep
    points = origins + 20 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    image = range_image(Scan(points, origins, angle))
    free, occupied = image.looks(points)
    assert occupied.mean() > 0.9 and not free.any()
    assert image.looks(origins + (points - origins) * 0.5)[0].mean() > 0.9


def l_shape(yaw: float, middle: FloatArray, size: tuple[float, float] = (4.4, 1.8)) -> FloatArray:
    """Points of a car's rear and left side."""
    x = np.linspace(-size[0] / 2, size[0] / 2, 60)
    y = np.linspace(-size[1] / 2, size[1] / 2, 30)
    side = np.stack([x, np.full(60, size[1] / 2)], 1)
    rear = np.stack([np.full(30, -size[0] / 2), y], 1)
    return rotated(np.full(90, yaw), np.concatenate([side, rear])) + middle


@pytest.mark.parametrize("yaw", [0.0, 0.3, 1.2])
def test_the_heading_of_an_l_is_found(yaw: float) -> None:
    xy = l_shape(yaw, np.array([3.0, 2.0])) + np.random.default_rng(0).normal(0, 0.01, (90, 2))
    away = (closest_heading(xy) - yaw + np.pi / 4) % (np.pi / 2) - np.pi / 4
    assert abs(np.degrees(away)) < 1.5


def test_a_box_goes_on_where_it_is_not_seen() -> None:
    ends, usual = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 5.0]]), np.array([4.0, 4.0, 4.0])
    middle, edges = completed(ends, usual, np.array([-1.0, 1.0, 0.3]))
    assert middle.tolist() == [2.0, -1.0, 2.5] and edges.tolist() == [4.0, 4.0, 5.0]
    assert viewed_from(ends, usual, np.array([[-9.0, 0.5, 4.5], [-9.0, 9.0, 4.5]])).tolist() == [-1.0, 0.5, 0.4]


def cluster(xy: FloatArray, time_s: float) -> Cluster:
    height = np.tile([0.4, 0.8, 1.2], len(xy))[: len(xy), None]
    return Cluster(np.concatenate([xy, height], 1), np.full(len(xy), time_s), np.array([-10.0, 5.0, 1.8]))


def test_two_that_cross_and_a_gap_stay_two_tracks() -> None:
    sweeps = []
    for number in range(30):
        time_s = number * 0.1
        one, other = l_shape(0.0, np.array([8 * time_s, 0.0])), l_shape(np.pi, np.array([24 - 8 * time_s, 3.5]))
        hidden = 10 <= number < 17
        sweeps.append([cluster(one, time_s)] if hidden else [cluster(one, time_s), cluster(other, time_s)])
    chains = associate(sweeps)
    assert sorted(len(chain) for chain in chains) == [23, 30]
    for chain in chains:
        assert np.ptp([part.middle[1] for part in chain]) < 0.5


def test_two_who_pass_each_other_closely_stay_two() -> None:
    rng, sweeps = np.random.default_rng(0), []
    for number in range(30):
        at = 0.14 * (number - 15)
        people = [rng.uniform(-0.25, 0.25, (60, 2)) + (side * at, 0.35 * side) for side in (-1, 1)]
        parts = [np.concatenate(people)] if abs(at) < 0.5 else people
        sweeps.append([cluster(part, number * 0.1) for part in parts])
    chains = associate(sweeps)
    assert len(chains) == 2 and min(len(chain) for chain in chains) > 27
    assert all(np.ptp([part.middle[1] for part in chain]) < 0.6 for chain in chains)  # they are 0.7 m apart


def test_a_track_goes_on_behind_a_long_gap() -> None:
    places = [number * 0.1 for number in range(40) if not 12 <= number < 32]  # longer than a filter coasts
    chains = associate([[cluster(l_shape(0.0, np.array([10 * time_s, 0.0])), time_s)] for time_s in places])
    assert [len(chain) for chain in chains] == [20]


def test_a_track_goes_on_where_nothing_sees_through_its_place() -> None:
    sweeps = []
    for number in range(20):
        car = cluster(l_shape(0.0, np.array([0.8 * number, 0.0])), number * 0.1)
        beside = cluster(l_shape(0.0, np.array([0.8 * number, 6.0])), number * 0.1)
        is_weak = not 5 <= number < 15
        sweeps.append([replace(car, is_weak=is_weak), replace(beside, is_weak=True)])
    (chain,) = associate(sweeps)
    assert [part.middle_s for part in chain] == pytest.approx([0.1 * number for number in range(20)])
    assert np.ptp([part.middle[1] for part in chain]) < 0.5


def test_a_turning_car_of_which_a_sweep_shows_two_pieces_stays_one_track() -> None:
    sweeps = []
    for number in range(24):
        angle = 0.12 * max(number - 12, 0)  # straight on, then a turn to the left
        at = np.array([0.0, 0.5 * min(number, 12)]) + 0.5 / 0.12 * np.array([np.cos(angle) - 1, np.sin(angle)])
        yaw = np.pi / 2 + angle
        ahead = 0.9 * np.array([np.cos(yaw), np.sin(yaw)])
        rear, front = (l_shape(yaw, place, (1.6, 1.8)) for place in (at - ahead, at + ahead))
        shown = [rear] * (number <= 12) + [front] * (number >= 12)
        sweeps.append([cluster(part, number * 0.1) for part in shown])
    (chain,) = associate(sweeps)
    assert [part.middle_s for part in chain] == pytest.approx([0.1 * number for number in range(24)])


def test_registration_takes_back_a_turning_path() -> None:
    times = np.arange(20) * 0.1
    yaw = 0.3 * times
    velocity = 6 * np.stack([np.cos(yaw), np.sin(yaw)], 1)
    places = np.concatenate([np.zeros((1, 2)), np.cumsum((velocity[1:] + velocity[:-1]) * 0.05, 0)])
    rng = np.random.default_rng(2)
    clusters = [
        cluster(l_shape(a, at) + rng.normal(0, 0.01, (90, 2)), t) for a, at, t in zip(yaw, places, times, strict=True)
    ]
    disturbed = smoothed(times, places + rng.normal(0, 0.25, places.shape), np.zeros(20), 0.3)
    returns = returns_of(clusters, lambda points: np.zeros(len(points)))
    path = register(returns, disturbed)

    def error(path: PlanarPath) -> float:
        offset = rotated(-yaw, path.positions - places)
        return float(np.linalg.norm(offset - offset.mean(0), axis=1).max())

    assert error(path) < 0.06 < error(disturbed)
    assert np.degrees(np.ptp(path.yaw_rad - yaw)) < 2


def voxels(low: FloatArray, high: FloatArray) -> FloatArray:
    """Voxels of what stands between two corners, seen from all around by ten sweeps."""
    axes = [np.arange(a, b + 0.01, 0.1) for a, b in zip(low, high, strict=True)]
    points = np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], 1)
    values = np.zeros((len(points), len(COLUMNS)))
    values[:, 0], values[:, 1:4], values[:, 7] = 10, points, 2.0
    return values


def chance(box: StandingBox, stays: FloatArray) -> float:
    return probability((*box.features, around(box, stays)), "standing")


def test_a_wall_is_no_vehicle_and_a_cone_a_doubtful_candidate() -> None:
    low, high = np.array([5, 3, 0.3]), np.array([9.5, 3.2, 2.0])
    wall, car = standing_box(voxels(low, high)), standing_box(voxels(low, np.array([9.5, 4.8, 1.5])))
    assert wall is not None and chance(wall, voxels(low, high)) < 0.2
    assert car is not None and chance(car, voxels(low, np.array([9.5, 4.8, 1.5]))) > 0.7
    cone = standing_box(voxels(np.array([5, 3, 0.3]), np.array([5.3, 3.3, 0.8])))
    assert cone is not None and cone.label == "Cones" and not cone.features
    assert standing_box(voxels(np.array([5, 3, 0.3]), np.array([15, 6, 2.0]))) is None


def test_a_piece_of_a_hedge_is_less_certain_than_the_same_alone() -> None:
    low, high = np.array([5, 3, 0.3]), np.array([9.5, 4.8, 1.5])
    box, hedge = standing_box(voxels(low, high)), voxels(low - np.array([2.0, 0, 0]), high + np.array([2.0, 0, 0]))
    assert box is not None and chance(box, hedge) < chance(box, voxels(low, high)) - 0.05


def test_what_moves_where_something_stands_is_less_certain() -> None:
    times = np.arange(12) * 0.1
    path = PlanarPath(times, np.stack([3 * times, 0 * times], 1), 0 * times)
    clusters = [cluster(l_shape(0.0, at), time_s) for at, time_s in zip(path.positions, times, strict=True)]
    returns = returns_of(clusters, lambda points: np.zeros(len(points)))
    stands = voxels(np.array([-4, -3, 0.0]), np.array([9, 3, 2.0]))

    def certain(stays: FloatArray) -> float:
        return probability(moving_features(returns, 1.0, 1.0, stays), "moving")

    assert certain(stands[:0]) > 0.9 > certain(stands) + 0.1


def test_a_car_looks_where_its_lower_end_is() -> None:
    hood, cabin = np.array([[5, 3, 0.3], [6.5, 4.7, 0.9]]), np.array([[6.5, 3, 0.3], [9.4, 4.7, 1.6]])
    box = standing_box(np.concatenate([voxels(*hood), voxels(*cabin)]))
    assert box is not None and abs(box.rise_m) > RISE_M
    yaw = _heading(box, np.array([[7.0, 8.0, 1.0, 0.0]]))  # traffic beside it goes the other way
    assert np.cos(yaw) < -0.99


def test_what_is_parked_bumper_to_bumper_is_parted() -> None:
    cars = [voxels(np.array([x, 3, 0.5]), np.array([x + 4.4, 4.7, 1.5])) for x in (5.0, 9.8)]
    bridge = voxels(np.array([9.4, 3.5, 0.5]), np.array([9.8, 3.6, 0.6]))
    bridge[:, 0] = 2
    assert [len(piece) > 500 for piece in _pieces(np.concatenate([*cars, bridge]))] == [True, True]


@pytest.mark.parametrize(
    ("size", "speed", "label"),
    [
        ((4.3, 1.8, 1.5), 8.0, "Car"), ((0.5, 1.7, 1.4), 8.0, "Car"), ((0.6, 0.5, 1.7), 1.4, "Pedestrian"),
        ((1.7, 0.6, 1.7), 5.0, "Cyclist"), ((6.0, 2.3, 2.8), 10.0, "Truck"), ((11.0, 2.5, 3.0), 8.0, "Bus"),
    ],
)  # fmt: skip
def test_classes_by_size_and_speed(size: tuple[float, float, float], speed: float, label: str) -> None:
    assert class_of(*size, speed) == label


def test_a_branch_is_no_part_of_who_walks_below_it() -> None:
    body = np.random.default_rng(0).uniform([-0.25, -0.3, 0.3], [0.25, 0.3, 1.75], (200, 3))
    branch = np.random.default_rng(1).uniform([-0.2, -0.2, 3.2], [0.2, 0.2, 3.5], (20, 3))
    shape = shape_of(np.concatenate([body, branch]), np.tile([-10.0, 0.0], (220, 1)), 1.4)
    assert shape.label == "Pedestrian" and 1.5 < shape.size_m[2] < 2.0


def test_a_search_without_scipy_says_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "scipy.spatial", None)
    with pytest.raises(LogError, match="scipy"):
        evidence_module.evidence_of(driven(tmp_path, frames=2))
