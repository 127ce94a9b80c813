"""Boxes that are scaled in Blender: read as the edit that sensors see, imported again, checked,
brought to the ground."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
import trimesh
from helpers import SAMPLE, edited, imported, read, select
from mathutils import Euler

from unisim_blender.bridge.changes import following
from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.objects.trajectories import trajectory_of
from unisim_blender.bridge.sampling.adjacent_frames import lacking, sample_now, step_beside
from unisim_blender.bridge.sampling.edit_list import read_now
from unisim_blender.bridge.sampling.stepping import sample, sample_all
from unisim_blender.bridge.views.actors import card_of
from unisim_blender.bridge.views.trails import trail
from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.scenario import load_scenario, save_scenario, scenario_from_json, scenario_to_json
from unisim_blender.core.scenario.edits import Duplicate, InsertMesh, Move, Remove, Scale, Swap
from unisim_blender.editing.motion.plausibility import ground_height, warnings_of
from unisim_blender.editing.reading.scenario import edited_ids
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import CHANGING


def standing(scene: Any) -> Any:
    """A box that stands still."""
    return imported(scene, "ACTOR", "car-12")


def driving(scene: Any) -> Any:
    """A box that rides on a trajectory."""
    one = imported(scene, "ACTOR", "car-03")
    assert trajectory_of(one) is not None
    return one


# what a scale is, without Blender


# reading


@pytest.mark.parametrize("of", [standing, driving])
@pytest.mark.parametrize("factors", [(1.5, 1.5, 1.5), (1.0, 1.0, 1.4), (0.8, 1.2, 0.97531)])
def test_a_scaled_box_is_one_edit(street: Any, of: Any, factors: tuple[float, float, float]) -> None:
    one = of(street)
    one.scale = factors
    assert read(street).edits == (Scale(one.unisim.uid, factors),)
    drive = source_of(street).drive
    now, before = edited(street).actors[one.unisim.uid], drive.actors[one.unisim.uid]
    np.testing.assert_allclose(now.size_m, before.size_m * factors)
    assert now.world_from_actor is before.world_from_actor
    assert edited_ids(sample_all(street, Clock.of(drive)), drive) == {one.unisim.uid}
    one.scale = (1.0, 1.0, 1.0)
    assert not read(street).edits


def test_a_parents_scale_counts(street: Any) -> None:
    one = standing(street)
    above = bpy.data.objects.new("above", None)
    street.collection.objects.link(above)
    one.parent, above.scale, one.scale = above, (2.0, 2.0, 2.0), (1.0, 1.0, 0.5)
    move, scale = read(street).edits
    assert isinstance(move, Move) and scale == Scale("car-12", (2.0, 2.0, 1.0))


def test_a_scaled_and_moved_one_says_both(street: Any) -> None:
    one = driving(street)
    one.scale, one.location = (1.2, 1.2, 1.2), (0.0, 1.0, 0.0)
    move, scale = read(street).edits
    assert isinstance(move, Move) and scale == Scale("car-03", (1.2, 1.2, 1.2))


@pytest.mark.parametrize("of", [standing, driving])
def test_copies_of_a_scaled_box_are_scaled(street: Any, of: Any) -> None:
    one = of(street)
    one.scale = (1.5, 1.0, 1.0)
    select(one)
    bpy.ops.object.duplicate()
    copy = bpy.context.active_object
    copy.location.y += 4.0
    bpy.context.view_layer.update()
    uid = one.unisim.uid
    new, larger, own = read(street).edits
    assert (
        isinstance(new, Duplicate) and larger == Scale(new.id, (1.5, 1.0, 1.0)) and own == Scale(uid, (1.5, 1.0, 1.0))
    )
    drive = edited(street)
    np.testing.assert_allclose(drive.actors[new.id].size_m, drive.actors[uid].size_m)
    copy.scale, one.scale = (1.0, 1.0, 1.0), (2.0, 2.0, 2.0)
    assert edited(street).actors[new.id].scale == (1.0, 1.0, 1.0)


def test_a_copy_is_told_beside_the_recorded_actor_whatever_became_of_that(street: Any) -> None:
    one = standing(street)
    select(one)
    bpy.ops.object.duplicate()
    copy = bpy.context.active_object
    copy.location.y += 4.0
    one.location.x += 10.0
    bpy.context.view_layer.update()
    drive = source_of(street).drive
    new, move = read(street).edits
    assert isinstance(new, Duplicate) and isinstance(move, Move)
    place = edited(street).actors[new.id].world_from_actor.positions[0]
    np.testing.assert_allclose(place, drive.actors["car-12"].world_from_actor.positions[0] + [0, 4, 0], atol=1e-4)
    # and where that is hidden
    one.hide_render = True
    new, gone = read(street).edits
    assert isinstance(new, Duplicate) and gone == Remove("car-12")
    assert new.id in edited(street).actors


def test_another_look_and_a_scale(street: Any) -> None:
    one = standing(street)
    low = source_of(street).drive.actors["car-12"]
    under = low.world_from_actor.positions[0, 2] - low.size_m[2] / 2
    select(one)
    assert bpy.ops.unisim.replace_appearance(appearance="car-09") == {"FINISHED"}
    one.scale = (1.2, 1.2, 1.2)
    swap, scale = read(street).edits
    assert isinstance(swap, Swap) and scale == Scale("car-12", (1.2, 1.2, 1.2))
    # a scaled one that gets another look keeps its scale and its underside
    one.scale = (1.0, 1.0, 2.0)
    bpy.context.view_layer.update()
    before = float(one.location.z) - float(source_of(street).drive.actors["car-09"].size_m[2])
    assert bpy.ops.unisim.replace_appearance(appearance="car-13") == {"FINISHED"}
    now = edited(street).actors["car-12"]
    assert now.scale == (1.0, 1.0, 2.0)
    assert now.world_from_actor.positions[0, 2] - now.size_m[2] / 2 == pytest.approx(before, abs=1e-4)
    assert under == pytest.approx(before + source_of(street).drive.actors["car-09"].size_m[2] / 2, abs=1e-4)


# what is refused


@pytest.mark.parametrize(
    ("scale", "told"),
    [
        ((1.0, -1.0, 1.0), "is mirrored by a negative scale"),
        ((12.0, 1.0, 1.0), "is scaled by 12 x 1 x 1; along each axis an actor can be scaled by 0.1 to 10"),
        ((0.0, 1.0, 1.0), "is scaled by 0 x 1 x 1; along each axis"),
    ],
)
def test_what_sensors_cannot_be_shown_is_refused_by_name(
    street: Any, scale: tuple[float, float, float], told: str
) -> None:
    one = standing(street)
    one.scale = scale
    with pytest.raises(ScenarioError) as caught:
        read(street)
    assert str(caught.value).startswith(f'object "{one.name}": {told}')
    assert str(caught.value).count(". ") == 0


def test_shear_is_refused(street: Any) -> None:
    one = standing(street)
    above = bpy.data.objects.new("above", None)
    street.collection.objects.link(above)
    one.parent, above.scale = above, (2.0, 1.0, 1.0)
    one.rotation_quaternion = Euler((0.0, 0.0, 0.6)).to_quaternion()
    with pytest.raises(ScenarioError, match=f'"{one.name}": is sheared by the scale of its parent'):
        read(street)
    assert any(
        "is sheared" in found.text for found in warnings_of(sample_all(street, clock(street)), source_of(street).drive)
    )


def clock(scene: Any) -> Clock:
    return Clock.of(source_of(scene).drive)


@pytest.mark.parametrize("of", [standing, driving])
def test_a_scale_that_changes_over_time_is_refused_whichever_frames_are_looked_at(street: Any, of: Any) -> None:
    one = of(street)
    for frame, factor in ((0, 1.0), (10, 1.4)):
        one.scale = (factor,) * 3
        one.keyframe_insert("scale", frame=frame)
    with pytest.raises(ScenarioError, match=f'"{one.name}": has a scale that changes over time'):
        read(street)
    # also about a frame at which it has come to rest
    street.frame_set(15)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    now = sample_now(street, depsgraph, clock(street).around(15))
    assert next(t for t in now.objects if t.name == one.name).scaling.fault == CHANGING


def test_a_scale_that_is_keyed_and_stays_is_none_that_changes(street: Any) -> None:
    one = driving(street)
    one.scale = (1.3, 1.3, 1.3)
    one.keyframe_insert("scale", frame=4)
    assert read(street).edits == (Scale("car-03", (1.3, 1.3, 1.3)),)


def test_a_scale_that_a_constraint_changes_is_told_about_the_moment_too(street: Any) -> None:
    one, target = standing(street), bpy.data.objects.new("target", None)
    street.collection.objects.link(target)
    for frame, factor in ((0, 1.0), (19, 3.0)):
        target.scale = (factor,) * 3
        target.keyframe_insert("scale", frame=frame)
    follow = one.constraints.new("COPY_SCALE")
    follow.target = target
    street.frame_set(10)
    here = clock(street).around(10)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert step_beside(street, here, lacking(street, here))
    for state in (sample_now(street, depsgraph, here), sample_all(street, clock(street))):
        assert next(t for t in state.objects if t.name == one.name).scaling.fault == CHANGING


def test_static_items_cannot_be_scaled(street: Any) -> None:
    street.cursor.location = (18.0, 5.0, 0.5)
    bpy.ops.unisim.mark_static()
    item = next(imported_objects(street, "STATIC"))
    item.scale, item.location.x = (2.0, 1.0, 1.0), item.location.x + 3.0
    with pytest.raises(ScenarioError, match=f'"{item.name}": is scaled by 2 x 1 x 1, which a static item cannot be'):
        read(street)


# there and back


EDITS: list[dict[str, Any]] = [
    {"type": "duplicate", "actor": "car-03", "id": "second", "offset_m": [0, 3.5, 0]},
    {"type": "scale", "actor": "car-03", "factors": [1.3, 1.3, 1.3]},
    {"type": "scale", "actor": "second", "factors": [1.0, 0.9, 1.4]},
    {"type": "swap", "actor": "car-12", "appearance": "car-09"},
    {"type": "scale", "actor": "car-12", "factors": [0.8, 0.8, 0.8]},
    {"type": "insert", "actor": "car-13", "id": "new", "pose": {"position": [32.0, 6.2, 0.9], "yaw_deg": 180.0}},
    {"type": "scale", "actor": "new", "factors": [1.25, 1.25, 1.25]},
]


def test_a_scenario_with_scales_comes_through(scene: Any, tmp_path: Path) -> None:
    document = scenario_to_json(load_scenario(SAMPLE / "scenario.json"))
    document["log"], document["scene"] = (
        str((SAMPLE.parent / "out" / "street").resolve()),
        str((SAMPLE / "scene").resolve()),
    )
    document["edits"] = EDITS
    path = tmp_path / "scenario.json"
    save_scenario(scenario_from_json(document, path), path)
    assert bpy.ops.unisim.import_scenario(filepath=str(path)) == {"FINISHED"}
    assert tuple(imported(scene, "ACTOR", "car-03").scale) == pytest.approx((1.3, 1.3, 1.3))
    drive = edited(bpy.context.scene)
    sizes = source_of(bpy.context.scene).drive.actors
    for uid, look, factors in (
        ("car-03", "car-03", (1.3, 1.3, 1.3)), ("second", "car-03", (1.0, 0.9, 1.4)),
        ("car-12", "car-09", (0.8, 0.8, 0.8)),
        ("new", "car-13", (1.25, 1.25, 1.25)),
    ):  # fmt: skip
        assert drive.actors[uid].scale == factors, uid
        np.testing.assert_allclose(drive.actors[uid].size_m, sizes[look].size_m * factors)
        box = next(
            t for t in sample_all(scene, clock(scene)).objects if t.name == uid or (t.uid == uid and t.is_original)
        )
        np.testing.assert_allclose(box.size_m, drive.actors[uid].size_m, rtol=1e-5, err_msg=uid)
    edits = read(bpy.context.scene).edits
    assert [type(edit) for edit in edits] == [Duplicate, Scale, Scale, Swap, Scale, Duplicate, Scale]
    # importing the drive again leaves what was edited
    assert bpy.ops.unisim.import_scene(filepath=str(SAMPLE / "scene" / "scene.json")) == {"FINISHED"}
    assert imported(bpy.context.scene, "ACTOR", "car-03").scale.x == pytest.approx(1.3)
    assert read(bpy.context.scene).edits == edits


def test_a_scaled_mesh_comes_through_as_a_mesh_of_that_size(scene: Any, tmp_path: Path) -> None:
    trimesh.creation.box([2.0, 1.0, 1.0]).export(tmp_path / "block.ply")
    document = scenario_to_json(load_scenario(SAMPLE / "scenario.json"))
    document["log"], document["scene"] = (
        str((SAMPLE.parent / "out" / "street").resolve()),
        str((SAMPLE / "scene").resolve()),
    )
    document["edits"] = [
        {
            "type": "insert_mesh",
            "mesh": "block.ply",
            "id": "block",
            "pose": {"position": [20.0, 3.0, 1.0], "yaw_deg": 20},
        },
        {"type": "scale", "actor": "block", "factors": [1.0, 2.0, 1.5]},
    ]
    path = tmp_path / "scenario.json"
    save_scenario(scenario_from_json(document, path), path)
    assert bpy.ops.unisim.import_scenario(filepath=str(path)) == {"FINISHED"}
    bpy.context.view_layer.update()
    (edit,) = read(bpy.context.scene).edits
    assert isinstance(edit, InsertMesh)
    now = edited(bpy.context.scene).actors["block"]
    np.testing.assert_allclose(now.size_m, [2.0, 2.0, 1.5], rtol=1e-5)
    assert not now.is_scaled, "the scale is in its model"
    block = bpy.context.scene.objects["block"]
    for frame, factor in ((0, 1.0), (10, 1.4)):
        block.scale = (factor,) * 3
        block.keyframe_insert("scale", frame=frame)
    with pytest.raises(ScenarioError, match='"block": has a scale that changes over time'):
        read(bpy.context.scene)


# what is shown, checked and touched


def test_the_card_says_the_size(street: Any) -> None:
    one, drive = standing(street), source_of(street).drive
    assert card_of(street, one, drive).size == "4.70 x 2.10 x 1.72 m"
    one.scale = (1.5, 1.0, 1.0)
    bpy.context.view_layer.update()
    assert card_of(street, one, drive).size == "7.0 x 2.1 x 1.7 m ×1.5 x 1 x 1"
    assert len(trail(one, drive, clock(street), 0.0).points), "the box as it was recorded is drawn beside it"


@pytest.mark.parametrize(("factor", "odd"), [(1.9, False), (2.5, True), (0.4, True)])
def test_an_implausible_size_is_told(street: Any, factor: float, odd: bool) -> None:
    one = standing(street)
    one.scale = (factor, 1.0, 1.0)
    drive = source_of(street).drive
    texts = [found.text for found in warnings_of(sample_all(street, clock(street)), drive) if found.name == one.name]
    assert any(f"is scaled by {factor:g} x 1 x 1, beyond 0.5 to 2" in text for text in texts) == odd


def test_a_box_that_grew_into_its_neighbour_overlaps(street: Any) -> None:
    drive, one = source_of(street).drive, standing(street)
    one.scale = (6.0, 1.0, 1.0)
    texts = [found.text for found in warnings_of(sample_all(street, clock(street)), drive)]
    assert any("overlaps" in text for text in texts)


def test_a_scaled_box_is_drawn_as_large_as_it_is(street: Any) -> None:
    one = standing(street)
    one.scale = (1.5, 2.25, 1.5)
    sampled = sample(street, bpy.context.evaluated_depsgraph_get(), clock(street).around(7), street.frame_set)
    larger = next(t for t in sampled.objects if t.name == one.name)
    np.testing.assert_allclose(larger.size_m, np.array([4.7, 2.1, 1.72]) * [1.5, 2.25, 1.5], rtol=1e-4)


@pytest.mark.parametrize("of", [standing, driving])
@pytest.mark.parametrize("factors", [(1.3, 1.3, 1.3), (1.0, 1.0, 0.6)])
def test_a_scaled_box_comes_to_the_ground(street: Any, of: Any, factors: tuple[float, float, float]) -> None:
    street.frame_set(7)
    one, source = of(street), source_of(street)
    one.scale = factors
    bpy.context.view_layer.update()
    select(one)
    assert bpy.ops.unisim.snap_to_ground() == {"FINISHED"}
    now = edited(street).actors[one.unisim.uid]
    pose = now.world_from_actor.at(source.drive.time_s[7])
    low = pose[:3, 3] - pose[:3, 2] * now.size_m[2] / 2
    ground = ground_height(source, low, 7)
    assert ground is not None and low[2] == pytest.approx(ground, abs=0.02)
    assert now.scale == factors


def test_a_beside_copy_of_a_scaled_box_stands_clear_of_it(street: Any) -> None:
    one = standing(street)
    one.scale = (1.0, 2.0, 1.0)
    bpy.context.view_layer.update()
    select(one)
    assert bpy.ops.unisim.duplicate_actor(where="LEFT") == {"FINISHED"}
    apart = (bpy.context.active_object.matrix_world.translation - one.matrix_world.translation).length
    assert apart > 2 * 2.1


# a person's scale leaves the underside where it is


def let_go(one: Any, factors: tuple[float, float, float]) -> list[str]:
    """What happens when a person lets go of what is scaled; returns what the status bar says."""
    one.scale = factors
    bpy.context.view_layer.update()
    following.note_changes(bpy.context.scene, bpy.context.evaluated_depsgraph_get())
    following._unsettled.add((bpy.context.scene.name, one.name))
    said = following.settle_now()
    bpy.context.view_layer.update()
    return said


def underside(scene: Any, uid: str, time_s: float = 0.7) -> Any:
    """The middle of an edited actor's underside (3,) at a time of the log."""
    now = edited(scene).actors[uid]
    pose = now.world_from_actor.at(time_s)
    return pose[:3, 3] - pose[:3, 2] * now.size_m[2] / 2


@pytest.mark.parametrize("of", [standing, driving])
def test_a_scaled_actor_stays_on_its_wheels(street: Any, of: Any) -> None:
    one = of(street)
    uid, stood = one.unisim.uid, underside(street, one.unisim.uid)
    following.look_again()
    for factors in ((1.5, 1.5, 1.5), (1.5, 1.0, 0.6), (1.0, 1.0, 2.0)):
        (said,) = let_go(one, factors)
        assert "underside stays" in said
        np.testing.assert_allclose(underside(street, uid), stood, atol=1e-4)
        move, scale = read(street).edits
        assert isinstance(move, Move) and scale == Scale(uid, factors)
        (line,) = read_now(street)
        assert line.part == "SCALE", "what follows from the scale is no line of its own"
    assert let_go(one, (1.0, 1.0, 1.0))
    assert not read(street).edits and one.unisim.scale_lift_m == 0.0


def test_a_scaled_actor_that_is_moved_too_says_how_far_it_was_moved(street: Any) -> None:
    one = driving(street)
    following.look_again()
    let_go(one, (1.3, 1.3, 1.3))
    one.location.y += 3.0
    bpy.context.view_layer.update()
    assert {line.part: line.what for line in read_now(street)} == {"MOVE": "Moved 3.0 m left", "SCALE": "Scaled by 1.3"}
    select(one)
    bpy.ops.object.duplicate()
    copy = bpy.context.active_object
    copy.location.y += 1.0
    bpy.context.view_layer.update()
    assert [line.what for line in read_now(street) if line.part == "COPY"] == ["Copied: 4.0 m left"]


@pytest.mark.parametrize("of", [standing, driving])
def test_undo_and_redo_of_a_scale(street: Any, of: Any) -> None:
    one = of(street)
    following.look_again()
    height = float(one.location.z)
    one.scale = (1.5, 1.5, 1.5)  # as Blender keeps it for redo: not yet displaced
    following.look_again()
    once = float(one.location.z)
    assert once > height + 0.2
    following.look_again()
    assert float(one.location.z) == once


def test_a_scale_is_muted_and_reverted_with_what_it_was_lifted(street: Any) -> None:
    one = standing(street)
    following.look_again()
    let_go(one, (1.5, 1.5, 1.5))
    whole = read(street).edits

    def press(operator: Any) -> None:
        (line,) = read_now(street)
        kind, name, part = line.key
        assert operator(kind=kind, name=name, part=part, muted=line.muted) == {"FINISHED"}
        assert not let_go(one, tuple(one.scale)), "it has settled"

    press(bpy.ops.unisim.mute_edit)
    assert not read(street).edits
    press(bpy.ops.unisim.mute_edit)
    assert len(read(street).edits) == len(whole) == 2
    np.testing.assert_allclose(underside(street, "car-12")[2], sunk_to(street, 0.0), atol=1e-4)
    press(bpy.ops.unisim.revert_edit)
    assert not read(street).edits


def sunk_to(scene: Any, factor: float) -> float:
    """How high the underside of the standing car is as recorded, lower by ``factor`` times half its height."""
    actor = source_of(scene).drive.actors["car-12"]
    return float(actor.world_from_actor.positions[0, 2] - (1 + factor) * actor.size_m[2] / 2)


def test_what_was_scaled_about_its_middle_in_an_earlier_file_stays_where_it_is(street: Any) -> None:
    one = standing(street)
    one.scale, one.unisim.rest_scale = (1.5, 1.5, 1.5), (0.0, 0.0, 0.0)
    bpy.context.view_layer.update()
    following.look_again()
    assert read(street).edits == (Scale("car-12", (1.5, 1.5, 1.5)),)
    assert underside(street, "car-12")[2] == pytest.approx(sunk_to(street, 0.5), abs=1e-4)
    (line,) = read_now(street)
    for _ in range(2):  # muted and counted again, it is the same
        bpy.ops.unisim.mute_edit(kind="ACTOR", name="car-12", part="SCALE", muted=read_now(street)[0].muted)
    assert read(street).edits == (Scale("car-12", (1.5, 1.5, 1.5)),)
    assert bpy.ops.unisim.revert_edit(kind="ACTOR", name=line.key[1], part="SCALE", muted=-1) == {"FINISHED"}
    let_go(one, (1.0, 1.0, 1.0))
    assert not read(street).edits


@pytest.mark.parametrize("of", [standing, driving])
def test_a_scale_that_was_exported_and_imported_can_be_reverted(street: Any, of: Any, tmp_path: Path) -> None:
    uid = of(street).unisim.uid
    following.look_again()
    let_go(of(street), (1.5, 1.5, 1.5))
    stood, path = underside(street, uid), tmp_path / "scaled.json"
    assert bpy.ops.unisim.export_scenario(filepath=str(path)) == {"FINISHED"}
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert bpy.ops.unisim.import_scenario(filepath=str(path)) == {"FINISHED"}
    scene = bpy.context.scene
    bpy.context.view_layer.update()
    following.look_again()
    np.testing.assert_allclose(underside(scene, uid), stood, atol=1e-3)
    (line,) = read_now(scene)
    assert line.part == "SCALE"
    kind, name, part = line.key
    assert bpy.ops.unisim.revert_edit(kind=kind, name=name, part=part, muted=-1) == {"FINISHED"}
    bpy.context.view_layer.update()
    assert not read(scene).edits


def test_another_appearance_of_a_scaled_actor_stays_on_its_wheels(street: Any) -> None:
    one = standing(street)
    following.look_again()
    let_go(one, (1.0, 1.0, 2.0))
    select(one)
    assert bpy.ops.unisim.replace_appearance(appearance="car-09") == {"FINISHED"}
    assert underside(street, "car-12")[2] == pytest.approx(sunk_to(street, 0.0), abs=1e-4)
    let_go(one, (1.0, 1.0, 1.0))
    assert underside(street, "car-12")[2] == pytest.approx(sunk_to(street, 0.0), abs=1e-4)
    (swap,) = read(street).edits
    assert isinstance(swap, Swap)


def test_a_scaled_mesh_stays_on_its_underside(street: Any) -> None:
    bpy.ops.mesh.primitive_cube_add(size=2.0, location=(20.0, 3.0, 1.0))
    block = bpy.context.active_object
    assert bpy.ops.unisim.mesh_actor(label="Other") == {"FINISHED"}
    following.look_again()
    let_go(block, (1.0, 1.0, 2.0))
    assert block.location.z == pytest.approx(2.0, abs=1e-5)
    let_go(block, (1.0, 1.0, 3.0))
    assert block.location.z == pytest.approx(3.0, abs=1e-5)


def test_a_mirrored_actor_is_not_displaced(street: Any) -> None:
    one = standing(street)
    following.look_again()
    height = float(one.location.z)
    (said,) = let_go(one, (1.0, 1.0, -1.0))
    assert "mirrored" in said and float(one.location.z) == height


# keys of the scale


def test_scaling_without_a_key_what_has_one_is_kept(street: Any) -> None:
    one = driving(street)
    street.frame_set(4)
    following.note_frame(street)
    one.scale = (1.2, 1.2, 1.2)
    one.keyframe_insert("scale")
    street.frame_set(6)
    one.scale = (1.5, 1.2, 1.2)
    bpy.context.view_layer.update()
    following._changed.setdefault(street.name, set()).add(one.name)
    street.frame_set(8)
    assert tuple(one.scale) == pytest.approx((1.5, 1.2, 1.2))
    assert read(street).edits == (Scale("car-03", (1.5, 1.2, 1.2)),)
