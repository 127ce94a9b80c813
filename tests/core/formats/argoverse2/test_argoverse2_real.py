"""The reader of Argoverse 2 on two real sweeps; skipped where they are absent (UNISIM_ARGOVERSE2 names a log's folder)."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pyarrow", reason="the extra parquet is not installed")

from unisim_blender.core.data.log import Sweep  # noqa: E402
from unisim_blender.core.formats.argoverse2.beams import Firings, elevation_spread  # noqa: E402
from unisim_blender.core.formats.argoverse2.read import Argoverse2Log  # noqa: E402
from unisim_blender.core.geometry import FloatArray  # noqa: E402
from unisim_blender.core.sensors.beam_tables import vlp32c  # noqa: E402
from unisim_blender.core.world.drive import Actor  # noqa: E402

DATA = Path(__file__).parents[5] / "shared/data/argoverse2/val/7fab2350-7eaf-3b7e-a39d-6937a4c1bede"
ROOT = Path(os.environ.get("UNISIM_ARGOVERSE2", DATA))
pytestmark = pytest.mark.skipif(not ROOT.is_dir(), reason=f"no real log at {ROOT}; set UNISIM_ARGOVERSE2 to one")
LIDARS = ("up_lidar", "down_lidar")


@pytest.fixture(scope="module")
def log() -> Argoverse2Log:
    return Argoverse2Log(ROOT)


def spread_deg(log: Argoverse2Log, name: str, sweep: Sweep, poses: FloatArray) -> FloatArray:
    """By how much each beam's elevation spreads, points seen from poses (N, 4, 4) or (4, 4)."""
    poses = np.broadcast_to(poses, (len(sweep.points), 4, 4))
    local = np.einsum("nji,nj->ni", poses[:, :3, :3], sweep.points - poses[:, :3, 3])
    return np.degrees(elevation_spread(Firings(sweep.ring.astype(np.int64), sweep.time_s, local)))


@pytest.mark.parametrize("name", LIDARS)
def test_undone_motion_puts_points_on_the_beams(log: Argoverse2Log, name: str) -> None:
    """With the pose of the sweep's timestamp for all, the same beams spread ten times as far."""
    lidar = log.drive.lidars[name]
    for frame in log.sweep_frames(name):
        sweep = log.sweep(name, frame)
        own = spread_deg(log, name, sweep, lidar.world_from_lidar.at(sweep.time_s))
        rigid = spread_deg(log, name, sweep, lidar.world_from_lidar.at(log.drive.time_s[frame]))
        assert np.median(own) <= 0.005 and own.max() <= 0.01
        assert np.median(rigid) > 8 * np.median(own)
        early = spread_deg(log, name, sweep, lidar.world_from_lidar.at(sweep.time_s - 0.02))
        assert np.median(early) > 2 * np.median(own)


@pytest.mark.parametrize("name", LIDARS)
def test_the_beams_are_a_vlp32cs(log: Argoverse2Log, name: str) -> None:
    model, maker = log.drive.lidars[name].model, vlp32c()
    np.testing.assert_allclose(np.degrees(model.elevation_rad), np.degrees(maker.elevation_rad), atol=0.01)
    assert abs(model.columns - 1808) <= 2 and model.sweep_s == pytest.approx(0.1, rel=1e-3)
    offsets, published = np.degrees(model.azimuth_offset_rad), np.degrees(maker.azimuth_offset_rad)
    assert np.abs(offsets - published).max() < 0.2 or np.abs(offsets + published).max() < 0.2


@pytest.mark.parametrize("name", LIDARS)
def test_cells_hold_one_return_each(log: Argoverse2Log, name: str) -> None:
    for frame in log.sweep_frames(name):
        sweep, grid = log.sweep(name, frame), log.sweep_grid(name, frame)
        assert (sweep.ring >= 0).all()
        cells = sweep.ring.astype(np.int64) * 4096 + sweep.column
        assert len(np.unique(cells)) / len(cells) > 0.995
        assert 0.8 < grid.returned.mean() < 0.95 and grid.blocked.mean() < 0.1


def test_moving_cars_hold_their_points(log: Argoverse2Log) -> None:
    """Boxes are where the beams met the cars; keyed earlier or later, they are not."""

    def share(shift_s: float) -> float:
        inside = []
        for frame in log.sweep_frames("up_lidar"):
            sweeps = [log.sweep(name, frame) for name in LIDARS]
            points, times = (np.concatenate([getattr(s, what) for s in sweeps]) for what in ("points", "time_s"))
            for actor in log.drive.actors.values():
                held, near = _held(actor, points, times + shift_s, times)
                if near > 40:
                    inside.append(held / near)
        assert len(inside) >= 4
        return float(np.mean(inside))

    assert share(0) > 0.97
    assert share(0) > share(0.05) + 0.1 and share(0) > share(-0.05) + 0.03


def _held(actor: Actor, points: FloatArray, box_times: FloatArray, times: FloatArray) -> tuple[int, int]:
    """How many of the returns about a fast actor lie in its box as it is at ``box_times``, and how many there are."""
    middle = float(times.mean())
    if not actor.is_moving or not actor.present(middle):
        return 0, 0
    a, b = actor.world_from_actor.positions_at(np.array([middle - 0.1, middle + 0.1]))
    if np.linalg.norm(b - a) < 1.0:
        return 0, 0
    # which returns are the actor's is asked of a larger box, the same for all shifts
    half = actor.size_m / 2
    local = _local(actor, points, times)
    own = (np.abs(local) <= half + np.array([1.2, 0.6, 0.3])).all(1) & (local[:, 2] > 0.3 - half[2])
    held = (np.abs(_local(actor, points[own], box_times[own])) <= half).all(1)
    return int(held.sum()), int(own.sum())


def _local(actor: Actor, points: FloatArray, times: FloatArray) -> FloatArray:
    poses = actor.world_from_actor.at(times)
    return np.asarray(np.einsum("nji,nj->ni", poses[:, :3, :3], points - poses[:, :3, 3]))


def test_poses_are_exact_at_the_sweeps_in_city_coordinates(log: Argoverse2Log) -> None:
    from pyarrow import feather

    table = feather.read_table(str(ROOT / "city_SE3_egovehicle.feather")).to_pydict()
    for frame in log.sweep_frames("up_lidar"):
        stamp = int(log._sweeps[frame].stem)
        row = table["timestamp_ns"].index(stamp)
        place = log.drive.world_from_ego.at(log.drive.time_s[frame])[:3, 3] + log.drive.world_origin
        np.testing.assert_allclose(place, [table[name][row] for name in ("tx_m", "ty_m", "tz_m")], atol=1e-8)


def test_what_is_not_there_is_told(log: Argoverse2Log) -> None:
    cameras = ROOT / "sensors/cameras"
    assert ("sensors/cameras is missing: no images" in log.missing) is not cameras.is_dir()
    for name in ("ring_front_center", "stereo_front_right") if cameras.is_dir() else ():
        assert (f"camera {name} has no images" in log.missing) is not (cameras / name).is_dir()
