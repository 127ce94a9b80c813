"""Confidence: which recorded views confirm a point, by hand; of a trained scene beside the truth of its street."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drive_frames import DriveFrames
from numpy.typing import NDArray

from unisim_blender.core import native
from unisim_blender.core.geometry import Trajectory, invert_pose
from unisim_blender.core.render import confidence
from unisim_blender.core.render import recorded_depth as recorded_depth_module
from unisim_blender.core.render.confidence import (
    CAMERA_WEIGHTS,
    LIDAR_WEIGHTS,
    DepthView,
    RecordedDepth,
    ViewEvidence,
    probability,
)
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.recorded_depth import recorded_depth
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.compiled.scene import CompiledScene
from unisim_blender.core.render.tracers.compiled.tracer import CompiledBackend
from unisim_blender.core.sensors.rays import Rays, exposure_window
from unisim_blender.core.world.drive import Actor, Appearance, CameraModel
from unisim_blender.core.world.replay import DriveStates
from unisim_street.exact_street import renderer_of_street
from unisim_street.street import build_street

SAMPLE = Path(__file__).parents[3] / "sample" / "scene"
WALL_M = 10.0
MODEL = CameraModel(80, 60, 60.0, 60.0, 40.0, 30.0)


def view_at(x: float, depth_m: float = WALL_M, actor: int = 0, time_s: float = 0.0) -> DepthView:
    """A view along z from (x, 0, 0) of a wall across z, or of an actor's face there."""
    v, u = np.mgrid[:60, :80] + 0.5
    rays = MODEL.unproject(u, v)
    depth = (depth_m / rays[..., 2]).astype(np.float32)
    pose = np.eye(4)
    pose[0, 3] = x
    near, far = confidence.around(depth)
    return DepthView(time_s, pose, MODEL, 0.0, 0.0, near, far, np.full(depth.shape, actor, np.int16))


def rays_to(origin: list[float], points: list[list[float]]) -> tuple[Rays, NDArray[np.float32]]:
    to = np.array(points) - origin
    depth = np.linalg.norm(to, axis=1)
    rays = Rays(np.broadcast_to(np.array(origin), to.shape).copy(), to / depth[:, None], np.zeros(len(to)))
    return rays, depth.astype(np.float32)


def test_views_confirm_what_they_end_at_and_contradict_what_they_pass_through() -> None:
    views = RecordedDepth((view_at(0.0), view_at(-2.0)), {})
    # on the wall, in the air before it, behind it, beside all that was seen
    rays, depth = rays_to([3.0, 0, 0], [[0, 0, 10], [0, 0, 5], [0, 0, 14], [60, 0, 10]])
    found = views.evidence(rays, depth, np.zeros(4, np.int32), ())
    np.testing.assert_array_equal(found.alike, [2, 0, 0, 0])
    np.testing.assert_array_equal(found.against, [0, 2, 0, 0])
    np.testing.assert_allclose(found.angle_rad, [np.arctan2(3, 10), np.pi, np.pi, np.pi], atol=1e-4)


def test_the_closest_views_of_a_sensors_kind_count() -> None:
    sweep = replace(view_at(0.5), model=None)
    views = RecordedDepth((*(view_at(float(x)) for x in range(6)), sweep), {}, (0.9, 0.8))
    near = views.near(np.eye(4), of_beam=False)
    assert [view.world_from_view[0, 3] for view in near.views] == [0, 1, 2, 3] and near.accuracy == (0.9, 0.8)
    assert views.near(np.eye(4), of_beam=True).views == (sweep,)
    rays, depth = rays_to([0.0, 0, 0], [[0, 0, 10]])
    assert near.evidence(rays, depth, np.zeros(1, np.int32), ()).accuracy == (0.9, 0.8)


def test_an_actor_is_confirmed_where_it_was_recorded() -> None:
    """A car that was recorded 10 m ahead stands elsewhere, turned by a quarter: the side that was seen is confirmed."""

    def actor(position: list[float], yaw: float) -> Actor:
        turn = np.array([[np.cos(yaw / 2), 0, np.sin(yaw / 2), 0]])
        trajectory = Trajectory(np.zeros(1), np.array([position]), turn)
        return Actor("car", "Car", np.array([2.0, 2.0, 2.0]), trajectory, 0, 1, False, Appearance("car"))

    recorded = actor([0, 0, WALL_M + 1], 0)
    views = RecordedDepth((view_at(0.0, actor=1),), {"car": recorded})
    moved = actor([30.0, 0, 20.0], np.pi / 2)
    face = moved.world_from_actor.at(0.0) @ np.array([0, 0, -1.0, 1])  # was towards the camera
    back = moved.world_from_actor.at(0.0) @ np.array([0, 0, 1.0, 1])
    instance = np.ones(2, np.int32)
    rays, depth = rays_to([30.0, 0, 0], [face[:3].tolist(), back[:3].tolist()])
    found = views.evidence(rays, depth, instance, (moved,))
    np.testing.assert_array_equal(found.alike, [1, 0])
    turned = invert_pose(moved.world_from_actor.at(0.0))[:3, :3] @ rays.directions[0]
    np.testing.assert_allclose(found.angle_rad[0], np.arccos(turned[2]), atol=1e-3)
    unknown = views.evidence(rays, depth, instance, (None,))
    assert not unknown.alike.any() and not unknown.against.any()


@pytest.mark.parametrize("of_beam", (False, True))
def test_confidence_falls_with_worse_evidence(of_beam: bool) -> None:
    steps = np.linspace(0, 1, 20, dtype=np.float32)
    four, none_at_all = np.full(20, 4, np.float32), np.zeros(20, np.float32)
    whole = ViewEvidence(four, none_at_all, none_at_all, none_at_all, (0.9, 0.9))
    depth, background = np.full(20, 10, np.float32), np.zeros(20, np.int32)

    def said(evidence: ViewEvidence) -> NDArray[np.float32]:
        return probability(evidence, depth, background, of_beam)

    unseen = said(replace(whole, alike=none_at_all, angle_rad=none_at_all + np.float32(np.pi)))
    worse = (
        replace(whole, against=8 * steps), replace(whole, spread=steps), replace(whole, angle_rad=steps),
    )  # fmt: skip
    for evidence in worse:
        assert (np.diff(said(evidence)) <= 1e-6).all()
    assert (said(worse[2]) > unseen).all() and unseen.max() < said(whole).min() - 0.03
    # how right recorded frames are
    trained = [said(replace(whole, accuracy=(share, share)))[0] for share in (0.3, 0.6, 0.8, 0.95)]
    assert (np.diff(trained) > 0.03).all(), trained
    assert len(CAMERA_WEIGHTS) == len(LIDAR_WEIGHTS)


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    if native.library() is None:
        pytest.skip("the compiled kernels were not built")
    return Renderer(CompiledBackend(CompiledScene(SAMPLE)))


def test_distances_come_from_the_cache(renderer: Renderer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path))
    monkeypatch.setattr(recorded_depth_module, "VIEWS_PER_SENSOR", 2)
    backend = renderer.backend
    assert isinstance(backend, CompiledBackend)
    first = recorded_depth(backend, backend.observed[0])
    assert len(first.views) == 4 and len(list(tmp_path.rglob("*.npz"))) == 1
    monkeypatch.setattr(CompiledBackend, "bind", None)
    for a, b in zip(first.views, recorded_depth(backend, backend.observed[0]).views, strict=True):
        for name in ("nearest", "farthest", "actor", "world_from_view"):
            np.testing.assert_array_equal(getattr(a, name), getattr(b, name))


def test_a_part_has_the_bits_of_the_whole_and_colours_stay(renderer: Renderer) -> None:
    frames = DriveFrames(renderer, renderer.backend.observed[0].drive)  # type: ignore[attr-defined]
    plain, whole = (frames.camera("front_camera", 9, passes, 240) for passes in (("rgb",), ("rgb", "confidence")))
    np.testing.assert_array_equal(plain.rgb, whole.rgb)
    assert whole.confidence is not None and whole.depth_m is None and plain.confidence is None
    assert whole.confidence.dtype == np.float32 and 0.8 < (whole.confidence > 0.5).mean() <= 1
    region = Region(37, 21, 171, 90)
    part = frames.camera("front_camera", 9, ("rgb", "confidence"), 240, region)
    assert part.confidence is not None
    np.testing.assert_array_equal(part.confidence, whole.confidence[21:90, 37:171])


def test_confidence_beside_the_truth_of_a_street(renderer: Renderer) -> None:
    """Beside the path fewer pixels are right, and confidence says so: in sum, and which ones."""
    header = renderer.backend.observed[0]  # type: ignore[attr-defined]
    truth = renderer_of_street(build_street(), header.world_origin, "balanced")
    right, claimed = [], []
    for shift in (0.0, 3.5):
        aside = np.eye(4)
        aside[0, 3] = shift
        recorded = header.drive.cameras["front_camera"].resized(160)
        camera = recorded.along(recorded.trajectory.transformed(right=aside))
        time_s = camera.time_s[9]
        states = DriveStates(header.drive, renderer.backend.parked)
        window = exposure_window(camera, time_s)
        image = renderer.render(states.state(*window), camera, time_s, ("rgb", "depth", "confidence"))
        true = truth.render(DriveStates(header.drive, {}).state(*window), camera, time_s, ("rgb", "depth"))
        assert image.depth_m is not None and true.depth_m is not None and image.confidence is not None
        with np.errstate(invalid="ignore"):
            near = np.abs(image.depth_m - true.depth_m) <= np.maximum(0.1, 0.02 * true.depth_m)
        near |= (true.depth_m > 150) & (image.depth_m > 100)
        right.append(near & (np.abs(image.rgb - true.rgb).max(-1) < 0.1))
        claimed.append(image.confidence)
    shares, means = [x.mean() for x in right], [x.mean() for x in claimed]
    assert shares[1] < shares[0] - 0.03 and means[1] < means[0] - 0.03, (shares, means)
    np.testing.assert_allclose(means, shares, atol=0.08)
    lidar = header.drive.lidars["pandar64"]
    states, time_s = DriveStates(header.drive, renderer.backend.parked), lidar.time_s[9]
    state = states.state(*exposure_window(lidar, time_s))
    sweep = renderer.render(state, lidar, time_s)
    said = renderer.sweep_confidence(state, sweep)
    assert said is not None and said.shape == sweep.depth_m.shape
    true_sweep = truth.render(DriveStates(header.drive, {}).state(*exposure_window(lidar, time_s)), lidar, time_s)
    both = sweep.returned & true_sweep.returned
    close = np.abs(sweep.depth_m - true_sweep.depth_m) <= np.maximum(0.1, 0.02 * true_sweep.depth_m)
    assert said[both].mean() == pytest.approx(close[both].mean(), abs=0.05)
    assert said[both & close].mean() > said[both & ~close].mean() + 0.03
    least = claimed[1] < np.quantile(claimed[1], 0.2)
    assert right[1][~least].mean() > right[1][least].mean() + 0.15
