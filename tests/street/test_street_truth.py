"""What the street's cameras and LiDAR see: exact ranges, edits that change what they should and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from unisim_blender.core.errors import LogError, ScenarioError
from unisim_blender.core.geometry import FloatArray, Trajectory, invert_pose, points_in_box, transform_points
from unisim_blender.core.sensors.camera import camera_rays, line_times, pixel_grid
from unisim_blender.core.sensors.frames import CameraFrame, LidarFrame
from unisim_blender.core.world.drive import Actor, Appearance, Box, Drive, StaticCopy
from unisim_street.assets.road import HALF_ROAD_WIDTH_M, KERB_HEIGHT_M
from unisim_street.street import Street, build_street
from unisim_street.street_truth import edit_masks
from unisim_street.tracing.shapes import Convex
from unisim_street.tracing.trace import Bundles, make_bundles, trace
from unisim_street.truth import make_world, truth_camera, truth_lidar

CAMERA, LIDAR = "front_camera", "pandar64"
LEAD = "car-01"
"""The car ahead of the ego."""


@pytest.fixture(scope="module")
def street() -> Street:
    return build_street(seed=3, frames=6, width=160, height=90)


@pytest.fixture(scope="module")
def sweep(street: Street) -> LidarFrame:
    return truth_lidar(street, street.drive, LIDAR, 3)


@pytest.fixture(scope="module")
def image(street: Street) -> CameraFrame:
    return truth_camera(street, street.drive, CAMERA, 3)


def street_points(
    street: Street, origins: FloatArray, directions: FloatArray, depth: NDArray[np.float32]
) -> FloatArray:
    return np.asarray(origins + directions * depth[..., None].astype(np.float64) + street.drive.world_origin)


def without(drive: Drive, uid: str) -> Drive:
    return replace(drive, actors={key: actor for key, actor in drive.actors.items() if key != uid})


def shifted(trajectory: Trajectory, x: float, y: float) -> Trajectory:
    return replace(trajectory, positions=trajectory.positions + [x, y, 0.0])


def street_box(street: Street, center: tuple[float, float, float], size: tuple[float, float, float]) -> Box:
    pose = np.eye(4)
    pose[:3, 3] = np.array(center) - street.drive.world_origin
    return Box(pose, np.array(size))


def test_lidar_ranges_are_exact_on_the_road(street: Street, sweep: LidarFrame) -> None:
    points = street_points(street, sweep.origins, sweep.directions, sweep.depth_m)
    lane = sweep.returned & (np.abs(points[..., 1]) < 3.4) & (points[..., 2] < 0.1) & (sweep.instance == 0)
    assert lane.sum() > 5000
    assert np.abs(points[lane][:, 2]).max() < 2e-6 * sweep.depth_m[lane].max()  # float32 depths
    pavement = (
        sweep.returned
        & (np.abs(points[..., 1]) > HALF_ROAD_WIDTH_M + 0.1)
        & (np.abs(points[..., 2] - KERB_HEIGHT_M) < 5e-4)
    )
    assert pavement.sum() > 1000
    np.testing.assert_array_equal(street.ground_height(points[pavement][:, :2]), KERB_HEIGHT_M)


def test_lidar_points_lie_on_moving_cars_at_their_own_time(street: Street, sweep: LidarFrame) -> None:
    actor = street.drive.actors[LEAD]
    body = street.assets[LEAD].parts[0].shape
    assert isinstance(body, Convex)
    mine = sweep.returned & (sweep.instance == 1 + sweep.instances.index(LEAD))
    assert mine.sum() > 100
    points = sweep.origins[mine] + sweep.directions[mine] * sweep.depth_m[mine, None]
    local = np.stack(
        [
            transform_points(invert_pose(actor.world_from_actor.at(time)), point[None])[0]
            for time, point in zip(sweep.time_s[mine], points, strict=True)
        ]
    )
    assert (np.abs(local) <= actor.size_m / 2 + 1e-4).all()
    on_body = np.abs(body.distances(local).max(1)) < 1e-4
    assert on_body.mean() > 0.4  # the rest are panes and wheels
    late = transform_points(invert_pose(actor.world_from_actor.at(float(sweep.time_s[mine].max()) + 0.05)), points)
    assert (np.abs(body.distances(late).max(1)) < 1e-4).mean() < 0.1


def test_lidar_drops_the_sky_and_what_is_out_of_range(street: Street, sweep: LidarFrame) -> None:
    np.testing.assert_array_equal(sweep.return_probability, sweep.returned)
    assert not sweep.returned[0].all()  # the highest beam sees the sky between the houses
    lidar = street.drive.lidars[LIDAR]
    short = replace(lidar, model=replace(lidar.model, max_range_m=20.0))
    near = truth_lidar(street, replace(street.drive, lidars={LIDAR: short}), LIDAR, 3)
    np.testing.assert_array_equal(near.returned, sweep.returned & (sweep.depth_m <= 20.0))
    assert (near.depth_m[~near.returned] == 0).all() and (near.intensity[~near.returned] == 0).all()
    assert sweep.intensity.max() <= 1 and sweep.intensity[sweep.returned].min() > 0


def test_marks_are_brighter_than_asphalt_to_the_lidar(street: Street, sweep: LidarFrame) -> None:
    points = street_points(street, sweep.origins, sweep.directions, sweep.depth_m)
    near = sweep.returned & (np.abs(points[..., 2]) < 0.01) & (sweep.depth_m < 25) & (sweep.instance == 0)
    dash = np.abs((points[..., 0] / 6.0) % 1.0 - 0.5) * 6.0
    mark = near & (np.abs(points[..., 1]) < 0.04) & (dash < 1.4)
    asphalt = near & (np.abs(np.abs(points[..., 1]) - 1.2) < 0.8)
    assert mark.sum() > 5
    assert np.median(sweep.intensity[mark]) > 3 * np.median(sweep.intensity[asphalt])


def test_depth_is_along_the_ray_and_z_depth_along_the_axis(image: CameraFrame) -> None:
    assert (
        image.depth_m is not None
        and image.z_depth_m is not None
        and image.normal is not None
        and image.opacity is not None
    )
    hit = np.isfinite(image.depth_m)
    np.testing.assert_array_equal(np.isinf(image.z_depth_m), ~hit)
    u, v = pixel_grid(image.model)
    u, v = u + 0.25, v + 0.25  # with 2 x 2 samples, those below and right of the centre
    slant = np.sqrt(((u - image.model.cx) / image.model.fx) ** 2 + ((v - image.model.cy) / image.model.fy) ** 2 + 1)
    np.testing.assert_allclose(
        image.depth_m[hit], (image.z_depth_m * slant)[hit], rtol=2e-3
    )  # the axis turns within the image
    np.testing.assert_allclose(np.linalg.norm(image.normal[hit], axis=-1), 1, atol=1e-5)
    assert (image.normal[~hit] == 0).all() and (image.opacity[hit] > 0).all()
    assert image.rgb.min() >= 0 and image.rgb.max() <= 1


def test_culling_loses_no_hit(street: Street) -> None:
    world = make_world(street, street.drive)
    u, v = np.meshgrid(np.arange(0.5, 160, 7), np.arange(0.5, 90, 7))
    rays = camera_rays(
        street.drive.cameras[CAMERA], street.drive.cameras[CAMERA].time_s[2], u.reshape(-1)[:256], v.reshape(-1)[:256]
    )
    origins = rays.origins + street.drive.world_origin
    tight = make_bundles(origins[:, None], rays.directions[:, None], rays.time_s[:, None])
    everything = np.zeros_like(tight.planes)
    everything[..., 3] = 1.0
    open_hits = trace(world.placements, Bundles(tight.origins, tight.directions, tight.time_s, everything))
    culled = trace(world.placements, tight)
    np.testing.assert_array_equal(culled.t, open_hits.t)
    np.testing.assert_array_equal(culled.placement, open_hits.placement)
    grouped = make_bundles(*(a.reshape(-1, 32, *a.shape[1:]) for a in (origins, rays.directions, rays.time_s)))
    np.testing.assert_allclose(trace(world.placements, grouped).t.reshape(-1), open_hits.t.reshape(-1), rtol=1e-12)


def test_removing_a_car_changes_its_pixels_and_its_shadow_alone(street: Street, image: CameraFrame) -> None:
    edited = without(street.drive, LEAD)
    after = truth_camera(street, edited, CAMERA, 3)
    masks = edit_masks(street, street.drive, edited, CAMERA, 3, train_frames=(0, 2, 4))
    assert image.instance is not None and after.instance is not None
    car = image.instance == 1 + image.instances.index(LEAD)
    assert car.sum() > 200 and masks.edited[car].all()
    assert masks.edited.sum() < 1.5 * car.sum()
    assert masks.shadow.sum() > 20 and not (masks.shadow & masks.edited).any()
    change = np.abs(after.rgb - image.rgb).max(-1)
    assert change[~masks.edited & ~masks.shadow].max() < 0.02
    assert (after.rgb - image.rgb)[masks.shadow].mean() > 0.05  # the road under a car is lighter without it
    hidden = masks.edited & ~masks.seen
    assert 0 < hidden.sum() < masks.edited.sum()  # some of what the car hid is never seen
    assert masks.seen[~masks.edited].mean() > 0.98


def test_no_edit_has_no_masks_and_training_frames_see_themselves(street: Street) -> None:
    masks = edit_masks(street, street.drive, street.drive, CAMERA, 3, train_frames=(3,))
    assert not masks.edited.any() and not masks.shadow.any()
    assert masks.seen.mean() > 0.999
    elsewhere = edit_masks(street, street.drive, street.drive, CAMERA, 0, train_frames=(5,), samples=1)
    assert 0.3 < elsewhere.seen.mean() < 0.97  # 4 m further on, the sides of the first image have left the view


def test_a_moved_actor_is_seen_where_it_was_recorded(street: Street) -> None:
    car = street.drive.actors[LEAD]
    moved = replace(car, world_from_actor=shifted(car.world_from_actor, 3.0, 0.0))
    edited = replace(street.drive, actors={**street.drive.actors, LEAD: moved})
    after = truth_camera(street, edited, CAMERA, 3)
    masks = edit_masks(street, street.drive, edited, CAMERA, 3, train_frames=(0, 2, 4))
    assert after.instance is not None
    mine = after.instance == 1 + after.instances.index(LEAD)
    assert mine.sum() > 150 and masks.edited[mine].all() and masks.seen[mine].mean() > 0.9


def test_ego_shift_gives_the_parallax_of_the_depths(street: Street, image: CameraFrame) -> None:
    camera = street.drive.cameras[CAMERA]
    aside = replace(camera, world_from_camera=shifted(camera.world_from_camera, 0.0, 1.0))
    after = truth_camera(street, replace(street.drive, cameras={CAMERA: aside}), CAMERA, 3)
    assert after.depth_m is not None and image.depth_m is not None and after.instance is not None
    u, v = pixel_grid(camera.model)
    rays = camera_rays(aside, aside.time_s[3], u + 0.25, v + 0.25)
    static = np.isfinite(after.depth_m) & (after.instance == 0)
    points = rays.origins[static] + rays.directions[static] * after.depth_m[static, None]
    local = transform_points(invert_pose(camera.world_from_camera.at(camera.time_s[3])), points)
    column = np.floor(camera.model.fx * local[:, 0] / local[:, 2] + camera.model.cx).astype(int)
    row = np.floor(camera.model.fy * local[:, 1] / local[:, 2] + camera.model.cy).astype(int)
    inside = (local[:, 2] > 0) & (column >= 0) & (column < 160) & (row >= 0) & (row < 90)
    found, expected = image.depth_m[row[inside], column[inside]], np.linalg.norm(local[inside], axis=1)
    assert inside.mean() > 0.7
    assert np.median(np.abs(found - expected) / expected) < 0.02  # a pixel's depths differ within it
    both = static & np.isfinite(image.depth_m)
    assert np.median(np.abs(after.depth_m[both] - image.depth_m[both])) > 0.1


def test_a_copied_static_item_is_the_item_moved(street: Street) -> None:
    skip = max(street.static.parts, key=lambda part: part.shape.high[0] == 1.8 and part.shape.high[1] == 0.92)
    assert skip.asset_from_part is not None
    x, y, _ = skip.asset_from_part[:3, 3]
    source = street_box(street, (x, y, 0.9), (4.2, 2.2, 1.8))
    target = source.world_from_box.copy()
    target[:3, 3] += [-5.0, 7.0, 0.0]
    target[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    drive = replace(street.drive, actors={}, static_copies=(StaticCopy("skip-2", source, target),))
    rng = np.random.default_rng(0)
    aim = transform_points(source.world_from_box, rng.uniform(-0.5, 0.5, (400, 3)) * source.size_m)
    origins = aim + np.array([-1.0, 1.5, 2.0]) + rng.uniform(-1, 1, (400, 3))
    directions = (aim - origins) / np.linalg.norm(aim - origins, axis=1, keepdims=True)
    move = target @ invert_pose(source.world_from_box)

    def shoot(scene: Drive, o: FloatArray, d: FloatArray) -> tuple[FloatArray, FloatArray]:
        hits = trace(
            make_world(street, scene).placements,
            make_bundles((o + scene.world_origin)[None], d[None], np.zeros((1, 400))),
        )
        return hits.t[0], hits.part[0] * (hits.placement[0] != 0)

    t, part = shoot(replace(drive, static_copies=()), origins, directions)
    inside = points_in_box(
        origins + np.where(np.isfinite(t), t, 0)[:, None] * directions, source.world_from_box, source.size_m
    )
    inside &= part > 0
    copied_t, copied_part = shoot(drive, transform_points(move, origins), directions @ move[:3, :3].T)
    assert inside.sum() > 100
    np.testing.assert_allclose(copied_t[inside], t[inside], atol=1e-9)
    np.testing.assert_array_equal(copied_part[inside], part[inside])

    removed = replace(drive, static_removals=(source,), static_copies=())
    gone_t, gone_part = shoot(removed, origins, directions)
    after = origins + np.where(np.isfinite(gone_t), gone_t, 0)[:, None] * directions
    still = points_in_box(after, source.world_from_box, np.asarray(source.size_m) - 1e-6) & (gone_part > 0)
    assert not still.any() and (gone_t[inside] > t[inside]).all()


def test_a_removal_box_cuts_through_what_it_does_not_hold(street: Street) -> None:
    post = max(street.static.parts, key=lambda part: part.shape.high[2] * (part.shape.high[0] == 0.075))
    assert post.asset_from_part is not None
    x, y, _ = post.asset_from_part[:3, 3]
    cut = replace(street.drive, actors={}, static_removals=(street_box(street, (x, y, 2.5), (1.0, 1.0, 1.0)),))
    heights = np.array([1.8, 2.2, 2.8, 3.3])
    origins = np.stack([np.full(4, x - 0.45), np.full(4, y), heights], -1)
    rays = make_bundles(origins[None], np.tile([1.0, 0.0, 0.0], (1, 4, 1)), np.zeros((1, 4)))
    near = trace(make_world(street, cut).placements, rays).t[0] < 1.0
    np.testing.assert_array_equal(near, [True, False, False, True])
    whole = trace(make_world(street, replace(cut, static_removals=())).placements, rays).t[0] < 1.0
    assert whole.all()


def test_actors_are_there_in_their_time_alone(street: Street, image: CameraFrame) -> None:
    actor = street.drive.actors[LEAD]
    camera = street.drive.cameras[CAMERA]
    time = float(line_times(camera, camera.time_s[3], np.array(57.0)))
    gone = replace(actor, end_s=time - 0.1)
    half = replace(actor, end_s=time)  # the rows down to 57 are exposed before, those below after
    frames = [
        truth_camera(street, replace(street.drive, actors={**street.drive.actors, LEAD: a}), CAMERA, 3, samples=1)
        for a in (gone, half)
    ]
    mine = [np.flatnonzero((f.instance == 1 + f.instances.index(LEAD)).any(1)) for f in (*frames, image)]  # type: ignore[union-attr]
    assert len(mine[0]) == 0 and 0 < len(mine[1]) < len(mine[2]) and mine[1].max() == 56 < mine[2].max()


def test_looks_of_other_actors_and_streets(street: Street) -> None:
    cone = street.drive.actors["cone-1"]
    stranger = Actor(
        "new",
        "Car",
        cone.size_m,
        cone.world_from_actor,
        0.0,
        1.0,
        False,
        Appearance("car-02", "elsewhere"),
        inserted=True,
    )
    drive = replace(street.drive, actors={"new": stranger})
    with pytest.raises(ScenarioError, match="'new'.*'elsewhere'"):
        make_world(street, drive)
    other = build_street(seed=4, frames=2)
    world = make_world(street.with_scene("elsewhere", other), drive)
    assert world.placements[world.first_actor].asset is other.assets["car-02"]
    unknown = replace(stranger, appearance=Appearance("car-77"))
    with pytest.raises(ScenarioError, match="'car-77'"):
        make_world(street, replace(street.drive, actors={"new": unknown}))


def test_the_same_recipe_is_the_same_street(street: Street, image: CameraFrame, sweep: LidarFrame) -> None:
    again = build_street(seed=3, frames=6, width=160, height=90)
    np.testing.assert_array_equal(truth_camera(again, again.drive, CAMERA, 3).rgb, image.rgb)
    np.testing.assert_array_equal(truth_lidar(again, again.drive, LIDAR, 3).depth_m, sweep.depth_m)
    other = build_street(seed=5, frames=6, width=160, height=90)
    assert np.abs(truth_camera(other, other.drive, CAMERA, 3, samples=1).rgb - image.rgb).mean() > 0.02


@pytest.mark.parametrize(
    "values",
    [
        {"frames": 1},
        {"width": 0},
        {"seed": -1},
        {"cameras": ("side_camera",)},
        {"cameras": ()},
        {"range_noise_m": float("nan")},
    ],
)
def test_bad_recipes_are_refused(values: dict[str, object]) -> None:
    with pytest.raises(LogError, match=str(next(iter(values)))):
        build_street(**values)  # type: ignore[arg-type]


def test_an_image_in_strips_is_the_image(street: Street, image: CameraFrame, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("unisim_street.truth._RAYS_PER_CHUNK", 160 * 4 * 20)
    striped = truth_camera(street, street.drive, CAMERA, 3)
    np.testing.assert_allclose(striped.rgb, image.rgb, atol=1e-5)
    assert striped.instance is not None and image.instance is not None
    assert striped.depth_m is not None and image.depth_m is not None
    np.testing.assert_array_equal(striped.instance, image.instance)
    np.testing.assert_allclose(striped.depth_m, image.depth_m, rtol=1e-6)
