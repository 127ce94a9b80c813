"""Plausibility of edits in a sampled scene, from plain data: nothing recorded is odd, each odd thing is one finding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from imported_scene import added, beside, changed, displaced, driving, imported, one_of, sampled_object, standing

from unisim_blender.editing.motion.kinematics import Limits
from unisim_blender.editing.motion.plausibility import (
    Finding,
    boxes_overlap,
    ground_height,
    heights,
    on_actors,
    place_of,
    undersides,
    unseen_share,
    warnings_of,
)
from unisim_blender.editing.sampled.scene import SHEARED, WHY, Sampled, Scaling
from unisim_blender.editing.sampled.source import DriveSource


def found(sampled: Sampled, source: DriveSource, limits: Limits | None = None) -> dict[str, list[str]]:
    """Texts of the findings by object."""
    texts: dict[str, list[str]] = {}
    for finding in warnings_of(sampled, source.drive, limits):
        texts.setdefault(finding.name, []).append(finding.text)
    return texts


def test_nothing_recorded_is_odd(source: DriveSource) -> None:
    assert found(imported(source.drive), source) == {}


def test_a_copy_in_place_overlaps(source: DriveSource) -> None:
    uid = standing(source.drive).uid
    sampled = imported(source.drive)
    one = one_of(sampled, uid)
    copy = replace(one, name="Copy")
    texts = found(added(sampled, copy), source)
    assert texts == {"Copy": [f"overlaps {uid}"]}
    away = found(added(sampled, replace(copy, there=np.zeros_like(copy.there))), source)
    assert away == {}, "a copy that is not there"


def test_above_and_below_the_ground(source: DriveSource) -> None:
    uid = standing(source.drive).uid
    sampled = imported(source.drive)
    for z, text in ((2.0, "is 2.0 m above the ground"), (-1.0, "is 1.0 m below the ground")):
        texts = found(changed(sampled, uid, poses=displaced(one_of(sampled, uid).poses, z=z)), source)
        assert text in texts[uid]


def test_sideways_and_too_fast(source: DriveSource) -> None:
    actor = max((a for a in source.drive.actors.values() if a.is_moving and a.label == "Car"), key=lambda a: float(
        np.linalg.norm(a.world_from_actor.positions[-1] - a.world_from_actor.positions[0])))  # fmt: skip
    sampled = imported(source.drive)
    poses = one_of(sampled, actor.uid).poses
    assert "drives sideways" in found(changed(sampled, actor.uid, poses=beside(poses, yaw_deg=90.0)), source)[actor.uid]
    fast = poses.copy()
    fast[:, :3, 3] += np.arange(len(poses))[:, None] * 8.0 * poses[:, :3, 0]  # 80 m/s more
    (text,) = [
        text for text in found(changed(sampled, actor.uid, poses=fast), source)[actor.uid] if text.startswith("goes")
    ]
    assert float(text.split()[1]) > 252


def test_a_pose_that_nobody_recorded_is_extrapolated(source: DriveSource) -> None:
    def of_class(label: str, uid: str, forward_m: float, **more: object) -> list[str]:
        actor = source.drive.actors[uid]
        drive = replace(source.drive, actors={uid: replace(actor, label=label)})
        sampled = imported(drive)
        poses = one_of(sampled, uid).poses.copy()
        poses[:, :3, 3] += np.arange(len(poses))[:, None] * forward_m * poses[:, :3, 0]
        texts = found(changed(sampled, uid, poses=poses), replace(source, drive=drive))
        return [text for text in texts.get(uid, []) if "extrapolated" in text]

    stands, goes = standing(source.drive).uid, driving(source.drive).uid
    assert of_class("Pedestrian", stands, 0.12) == [
        "goes 4 km/h and was recorded at 0 km/h to 0 km/h: its pose is extrapolated"
    ]
    assert of_class("Car", stands, 0.12) == [] == of_class("Pedestrian", stands, 0.0)
    assert of_class("Pedestrian", goes, 0.05) == []
    assert len(of_class("Pedestrian", goes, -0.6)) == 1


def test_limits_of_motion_count_for_edited_vehicles_alone(source: DriveSource) -> None:
    actor = driving(source.drive)
    sampled = imported(source.drive)
    poses = one_of(sampled, actor.uid).poses.copy()
    swerve = 1.5 * np.sin(np.linspace(0, 3 * np.pi, len(poses)))
    poses[:, :3, 3] += swerve[:, None] * poses[:, :3, 1]
    swerving = changed(sampled, actor.uid, poses=poses)
    beyond = [text for text in found(swerving, source)[actor.uid] if "m/s²" in text or "radius" in text]
    assert beyond
    generous = Limits(acceleration_m_s2=100.0, lateral_m_s2=100.0, curvature_1_m=10.0)
    assert not set(found(swerving, source, generous).get(actor.uid, [])) & set(beyond)
    strict = Limits(acceleration_m_s2=1e-3, lateral_m_s2=1e-3, curvature_1_m=1e-6)
    assert found(sampled, source, strict) == {}


def test_the_scale_beside_what_was_recorded(source: DriveSource) -> None:
    uid = standing(source.drive).uid
    sampled = imported(source.drive)
    assert any(
        "is scaled by 3" in text for text in found(changed(sampled, uid, scaling=Scaling((3.0, 3.0, 3.0))), source)[uid]
    )
    assert WHY[SHEARED] in found(changed(sampled, uid, scaling=Scaling(fault=SHEARED)), source)[uid]
    assert uid not in found(changed(sampled, uid, scaling=Scaling((1.1, 1.1, 1.1))), source)


def test_the_extent_of_a_mesh_in_another_unit(source: DriveSource) -> None:
    uid = standing(source.drive).uid
    sampled = imported(source.drive)
    for size, odd in ((4500.0, True), (4.5, False), (0.0045, True)):
        mesh = replace(one_of(sampled, uid), name="Mesh", mesh="car.npz", size_m=(size, size / 2, size / 3))
        texts = found(added(sampled, mesh), source)["Mesh"]
        assert (f"has an extent of {size:.3g} m" in texts) == odd


def test_views_from_afar_and_aside(source: DriveSource) -> None:
    sampled = imported(source.drive)
    camera = one_of(sampled, "front_camera")
    assert (
        "looks from 8."
        in found(changed(sampled, camera.name, poses=displaced(camera.poses, z=8.0)), source)[camera.name][0]
    )
    back = camera.poses.copy()
    back[:, :3, [0, 2]] *= -1.0  # turned about its own up
    (text,) = found(changed(sampled, camera.name, poses=back), source)[camera.name]
    assert text == "looks 100% beside all that was recorded"
    assert unseen_share(camera, source.drive, 0) <= 1 / 16, "but for a ray at the edge"
    assert unseen_share(replace(camera, poses=back), source.drive, 0) == 1.0


def test_boxes_overlap() -> None:
    size = np.array([4.0, 2.0, 1.5])
    a, b = np.eye(4), np.eye(4)
    assert boxes_overlap(a, size, b, size)
    b[:3, 3] = [0, 2.05, 0]
    assert not boxes_overlap(a, size, b, size)
    turn = np.eye(4)
    turn[:2, :2] = [[0, -1], [1, 0]]
    turn[:3, 3] = [0, 2.5, 0]
    assert boxes_overlap(a, size, turn, size)  # its nose is in the other's side


def test_the_ground_lies_under_recorded_actors(source: DriveSource) -> None:
    ground = undersides(source.drive)
    actor = standing(source.drive)
    pose = actor.world_from_actor.at(0.0)
    under = pose[:3, 3] - pose[:3, 2] * actor.size_m[2] / 2
    assert np.abs(ground - under).max(1).min() < 1e-9
    assert ground_height(source, under + [0.0, 0.0, 5.0], 0) == pytest.approx(under[2], abs=0.3)
    assert ground_height(source, under + [1e4, 0.0, 0.0], 0) is None
    slope = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 1.0]])
    found = heights(slope, np.array([[0.0, 0.0, 9.0], [5.0, 0.0, 9.0], [500.0, 0.0, 9.0]]))
    assert found[0] < 0.05 and found[1] == pytest.approx(0.5) and np.isnan(found[2])


def test_returns_of_an_actor_are_no_ground(source: DriveSource) -> None:
    drive, actor = source.drive, standing(source.drive)
    pose = actor.world_from_actor.at(drive.time_s[0])
    points = pose[:3, 3] + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, actor.size_m[2] / 2], [0.0, 0.0, 10.0]])
    assert on_actors(drive, points, 0).tolist() == [True, True, False]


def test_a_mesh_has_the_limits_of_its_own_class(source: DriveSource) -> None:
    sampled = imported(source.drive)
    place = np.tile(np.eye(4), (len(sampled.clock.frames), 1, 1))
    place[:, :3, 3] = one_of(sampled, "Ego vehicle").poses[0, :3, 3] + [-60.0, 30.0, 0.0]
    place[:, 0, 3] += 1.0 * np.arange(len(place))  # 10 m/s
    walker = sampled_object(
        "Walker", "ACTOR", place, uid="", mesh="walker.npz", label="Pedestrian", size_m=(0.6, 0.6, 1.8)
    )
    van = replace(walker, name="Van", label="Car")
    assert "goes 36 km/h" in found(added(sampled, walker), source)["Walker"]
    assert not any(text.startswith("goes") for text in found(added(sampled, van), source).get("Van", []))


def test_a_finding_has_a_place(source: DriveSource) -> None:
    sampled = imported(source.drive)
    actor = one_of(sampled, standing(source.drive).uid)
    frame = int(sampled.clock.frames[1])
    assert place_of(Finding(actor.name, frame, ""), sampled) == tuple(actor.poses[1, :3, 3])


def test_an_actor_of_another_scene_is_checked_by_its_class(source: DriveSource) -> None:
    """Its class is that of the other scene: the drive has no actor of its id."""
    car = driving(source.drive)
    poses = beside(one_of(imported(source.drive), car.uid).poses, yaw_deg=90.0)
    here = replace(source.drive, actors={})
    assert source.scene_path is not None
    look = {"uid": "", "appearance": car.uid, "appearance_scene": str(source.scene_path)}
    sampled = added(imported(here), sampled_object("Other", "ACTOR", poses, **look, size_m=tuple(car.size_m)))
    assert [finding.text for finding in warnings_of(sampled, here)] == ["drives sideways"]
    (unshown, _) = warnings_of(sampled, here, is_trained=False)
    assert "is not shown without a trained scene" in unshown.text
    (first, *_) = warnings_of(changed(sampled, "Other", appearance="nobody"), here)
    assert first.text == "has no known class, so its motion is not checked"
