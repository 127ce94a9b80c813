"""The part of a view that an edit can change, from two states of a sampled scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from imported_scene import added, changed, displaced, sampled_object, without

from unisim_blender.core.geometry import FloatArray, intersect_boxes, invert_pose
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.sensors.camera import pixel_directions, pixel_grid
from unisim_blender.core.world.drive import CameraModel
from unisim_blender.editing.images.dirty_region import alike, dirty_region, is_empty, joined
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.poses import optical
from unisim_blender.editing.sampled.scene import Sampled, SampledObject

MODEL = CameraModel(400, 300, 200.0, 200.0, 200.0, 150.0)
SIZE = (1.0, 1.0, 1.0)


def at(x: float, y: float, z: float) -> FloatArray:
    """Two frames of a pose; a Blender camera at the origin looks along -z."""
    pose = np.tile(np.eye(4), (2, 1, 1))
    pose[:, :3, 3] = (x, y, z)
    return pose


@pytest.fixture
def view() -> SampledObject:
    """The camera that is looked through."""
    return sampled_object("camera", "CAMERA", at(0, 0, 0), camera=MODEL)


@pytest.fixture
def scene(view: SampledObject) -> Sampled:
    """A box ten metres ahead, one behind, the vehicle and its body."""
    objects = (
        sampled_object("ahead", "ACTOR", at(0, 0, -10), size_m=SIZE),
        sampled_object("behind", "ACTOR", at(0, 0, 10), size_m=SIZE),
        sampled_object("body", "BODY", at(-2, 0, -10), size_m=SIZE),
        view,
        sampled_object("ego", "EGO", at(0, -1, 0)),
        sampled_object("item", "STATIC", at(3, 0, -10), size_m=SIZE),
    )
    return Sampled("scene", Clock(np.array([0.0, 1.0]), np.array([0.0, 0.1])), objects)


def test_nothing_changed(scene: Sampled, view: SampledObject) -> None:
    part = dirty_region(scene, scene, view, MODEL)
    assert part is not None and is_empty(part)


def test_a_box_before_and_after(scene: Sampled, view: SampledObject) -> None:
    """It is at columns 190..210 and 240..260, and a little beside; rows 140..160."""
    after = changed(scene, "ahead", poses=at(2.5, 0, -10))
    part = dirty_region(scene, after, view, MODEL)
    assert part is not None
    left, top, right, bottom = part
    assert 180 < left < 190 and 260 < right <= 270 and 130 < top < 140 and 160 < bottom < 170
    wider = dirty_region(scene, after, view, MODEL, beside_m=1.0)
    assert wider is not None and wider[0] < left and wider[2] > right
    assert dirty_region(after, scene, view, MODEL) == part


@pytest.mark.parametrize("change", ["removed", "hidden", "added", "appearance", "index"])
def test_what_comes_goes_or_looks_otherwise(scene: Sampled, view: SampledObject, change: str) -> None:
    after = {
        "removed": without(scene, "ahead"),
        "hidden": changed(scene, "ahead", there=np.zeros(2, bool)),
        "added": added(scene, sampled_object("new", "ACTOR", at(0, 0, -10), size_m=SIZE)),
        "appearance": changed(scene, "ahead", appearance="car-02"),
        "index": changed(scene, "ahead", index=7),
    }[change]
    part = dirty_region(scene, after, view, MODEL)
    assert part is not None and is_empty(part) == (change == "index"), "the pass index is no part of the colours"


def test_what_is_behind_or_looks_is_not_seen(scene: Sampled, view: SampledObject) -> None:
    for after in (
        changed(scene, "behind", poses=at(1, 0, 12)),
        changed(scene, "ego", poses=at(5, 0, -10)),
        added(scene, sampled_object("lidar", "LIDAR", at(0, 0, -10), model="{}")),
        added(scene, sampled_object("away", "ACTOR", at(0, 0, -10), False, size_m=SIZE)),
    ):
        part = dirty_region(scene, after, view, MODEL)
        assert part is not None and is_empty(part)


def test_the_body_counts_for_who_sees_it(scene: Sampled, view: SampledObject) -> None:
    after = changed(scene, "body", poses=at(-1, 0, -10))
    seen = dirty_region(scene, after, view, MODEL)
    unseen = dirty_region(scene, after, replace(view, sees_body=False), MODEL)
    assert seen is not None and not is_empty(seen) and unseen is not None and is_empty(unseen)


def test_all_of_it_where_that_cannot_be_told(scene: Sampled, view: SampledObject) -> None:
    for after in (
        changed(scene, "camera", poses=at(0.1, 0, 0)),
        changed(scene, "item", poses=at(4, 0, -10)),
        replace(scene, items={"bin": "{}"}),
        replace(scene, clock=Clock(np.array([1.0, 2.0]), np.array([0.1, 0.2]))),
    ):
        assert dirty_region(scene, after, view, MODEL) is None


def test_a_box_about_the_camera_is_everywhere(scene: Sampled, view: SampledObject) -> None:
    assert dirty_region(scene, changed(scene, "ahead", poses=at(0, 0, 0.2)), view, MODEL) == (0, 0, 400, 300)


def test_a_box_beside_the_camera_is_where_it_is_ahead(scene: Sampled, view: SampledObject) -> None:
    """It reaches from 1.4 m behind the camera to 1.4 m ahead of it, 1 m to the right."""
    wide = changed(without(scene, "ahead"), "behind", poses=at(1.2, 0, 0), size_m=(0.2, 0.2, 2.4))
    part = dirty_region(without(scene, "ahead"), wide, view, MODEL)
    assert part is not None and 300 < part[0] < 340 and part[2] == 400


def test_a_wall_bulges_beyond_its_corners_through_a_fisheye(scene: Sampled, view: SampledObject) -> None:
    """All pixels that see it lie in the region, and some of them outside of the rectangle about its corners."""
    model = CameraModel(160, 120, 45.0, 45.0, 80.0, 60.0, lens=OpenCVFisheye(k1=-0.01))
    plain, size = without(scene, "ahead"), np.array([40.0, 1.0, 0.2])
    wall = changed(plain, "behind", poses=at(0, -3, -2), size_m=tuple(size.tolist()))
    part = dirty_region(plain, wall, replace(view, camera=model), model)
    assert part is not None
    pose = invert_pose(optical(view.poses)[:1]) @ at(0, -3, -2)[:1]
    rays = pixel_directions(model, *pixel_grid(model)).reshape(-1, 3)
    enter, leave = intersect_boxes(np.zeros_like(rays), rays, invert_pose(pose), size[None])
    rows, columns = np.nonzero(((enter <= leave) & (leave > 0))[:, 0].reshape(model.height, model.width))
    assert part[0] <= columns.min() and columns.max() < part[2] and part[1] <= rows.min() and rows.max() < part[3]
    corners = np.stack(np.meshgrid(*([-x / 2, x / 2] for x in size), indexing="ij"), -1).reshape(-1, 3)
    _, v, _ = model.project(corners @ pose[0, :3, :3].T + pose[0, :3, 3])
    assert rows.max() > v.max() + 5, "or the corners would do"


def test_alike(scene: Sampled) -> None:
    one = scene.objects[0]
    assert alike(one, replace(one, index=3)) and not alike(one, replace(one, poses=displaced(one.poses, x=1e-6)))
    assert not alike(one, replace(one, there=np.array([True, False])))


def test_joined_regions() -> None:
    assert joined((10, 10, 20, 20), (15, 5, 30, 12)) == (10, 5, 30, 20)
    assert joined((10, 10, 20, 20), (400, 300, 0, 0)) == (10, 10, 20, 20) == joined((400, 300, 0, 0), (10, 10, 20, 20))
    assert joined((10, 10, 20, 20), None) is None
