"""Actors of another class, rows of cones and parked rows: where they stand, and that they are plausible at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import driving_car, edited, read, select

from unisim_blender.bridge.objects.imported import imported_objects, mark_static, source_of
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.core.actor_images.names import group_of
from unisim_blender.core.scenario import rebased, save_scenario, scenario_to_json
from unisim_blender.core.scenario.edits import CopyStatic, Duplicate, Row, Swap
from unisim_blender.editing.motion.kinematics import motion_of
from unisim_blender.editing.motion.plausibility import warnings_of
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.simulation.sweeps import fields_of
from unisim_blender.features.actors.appearances import slow_down


def warned(scene: Any) -> list[str]:
    """What Check Edits says."""
    drive = source_of(scene).drive
    return [f"{found.name} {found.text}" for found in warnings_of(sample_all(scene, Clock.of(drive)), drive)]


def test_a_swapped_car_is_the_most_similar_of_its_new_class_on_the_same_ground(street: Any) -> None:
    drive = source_of(street).drive
    one = driving_car(street)
    before = drive.actors[one.unisim.uid]
    assert bpy.ops.unisim.swap_class(group="TRUCK") == {"FINISHED"}
    (swap,) = read(street).edits
    assert isinstance(swap, Swap) and swap.actor == before.uid
    trucks = [uid for uid, actor in drive.actors.items() if group_of(actor.label) == "TRUCK"]
    assert swap.appearance == min(trucks, key=lambda uid: np.linalg.norm(drive.actors[uid].size_m - before.size_m))
    now = edited(street).actors[before.uid]
    for time_s in sorted(drive.time_s.values()):
        low, high = (a.world_from_actor.at(time_s)[2, 3] - a.size_m[2] / 2 for a in (now, before))
        assert low == pytest.approx(high, abs=1e-4)
    assert warned(street) == []
    with pytest.raises(RuntimeError, match="there are no People here"):
        bpy.ops.unisim.swap_class(group="PERSON")


def test_who_is_slowed_down_walks_the_same_path(street: Any) -> None:
    one, clock = driving_car(street), Clock.of(source_of(street).drive)
    actor = source_of(street).drive.actors[one.unisim.uid]
    slow_down(one, 1.4, clock)
    now = edited(street).actors[actor.uid].world_from_actor.at(clock.times_s)[:, :3, 3]
    speeds = motion_of(now, clock.times_s).speed_m_s
    assert speeds.max() == pytest.approx(1.4, abs=0.02)
    start = actor.world_from_actor.at(clock.times_s[:1])[0, :3, 3]
    assert now[0] == pytest.approx(start, abs=0.02)
    slow_down(one, 20.0, clock)
    again = edited(street).actors[actor.uid].world_from_actor.at(clock.times_s)[:, :3, 3]
    assert again == pytest.approx(now, abs=1e-6), "what is slow enough stays"


def rows(scene: Any) -> list[Any]:
    """The names of what stands in rows."""
    return sorted((obj for obj in scene.objects if obj.unisim.row), key=lambda obj: obj.name)


@pytest.mark.parametrize("operator", ["row_of_cones", "parked_row"])
def test_a_row_is_one_edit_until_one_of_it_is_moved(street: Any, operator: str) -> None:
    standing = next(o for o in imported_objects(street, "ACTOR") if o.parent is None and "Car" in o.name)
    select(standing)
    assert getattr(bpy.ops.unisim, operator)() == {"FINISHED"}
    (row,), there = read(street).edits, rows(street)
    assert isinstance(row, Row) and len(there) >= 3
    assert warned(street) == []
    now, recorded = edited(street).actors, source_of(street).drive.actors
    assert sorted(now.keys() - recorded.keys()) == [obj.name for obj in there]
    for obj in there:
        place = now[obj.name].world_from_actor.positions[0]
        assert np.array(obj.matrix_world.translation) == pytest.approx(place, abs=1e-4)
    labels = {member.pointer.rpartition("/")[2] for member in fields_of(scenario_to_json(read(street)), {})}
    by = "count" if operator == "row_of_cones" else "spacing_m"
    assert labels == {"start_m", "end_m", "left_m", "end_left_m", "variation_m", by}
    there[0].location.y += 0.5
    bpy.context.view_layer.update()
    assert [type(edit) for edit in read(street).edits] == [Duplicate] * len(there)
    there[0].location.y -= 0.5
    bpy.context.view_layer.update()
    assert len(read(street).edits) == 1
    bpy.data.objects.remove(there[-1])
    assert [type(edit) for edit in read(street).edits] == [Duplicate] * (len(there) - 1)


def test_the_ends_of_a_row_are_dragged(street: Any) -> None:
    assert bpy.ops.unisim.row_of_cones(count=5, left_m=-1.5, end_left_m=-1.5) == {"FINISHED"}
    (row,) = read(street).edits
    assert isinstance(row, Row)
    assert bpy.ops.unisim.drag_row(is_end=True, at_m=(row.end_m + 6.0, 1.0)) == {"FINISHED"}
    (longer,) = read(street).edits
    assert isinstance(longer, Row)
    assert (longer.start_m, longer.end_m, longer.left_m) == pytest.approx((row.start_m, row.end_m + 6.0, -1.5))
    assert longer.end_left_m == pytest.approx(1.0) and len(rows(street)) <= 5
    assert bpy.ops.unisim.drag_row(at_m=(row.start_m + 2.0, -3.0)) == {"FINISHED"}
    (shorter,) = read(street).edits
    assert isinstance(shorter, Row) and (shorter.start_m, shorter.left_m) == pytest.approx((row.start_m + 2.0, -3.0))


def test_an_imported_row_is_a_row_again(street: Any, tmp_path: Path) -> None:
    bpy.ops.unisim.row_of_cones(count=5)
    before = read(street)
    save_scenario(rebased(before, tmp_path / "row.json"), tmp_path / "row.json")
    bpy.ops.wm.read_homefile(use_empty=True)
    assert bpy.ops.unisim.import_scenario(filepath=str(tmp_path / "row.json")) == {"FINISHED"}
    assert read(bpy.context.scene).edits == before.edits


def test_a_marked_cone_is_copied_and_without_one_it_says_what_is_needed(street: Any, capfd: Any) -> None:
    for obj in [obj for obj in imported_objects(street, "ACTOR") if "Cone" in obj.name]:
        bpy.data.objects.remove(obj)
    assert bpy.ops.unisim.row_of_cones() == {"CANCELLED"}
    assert (
        "This drive has no cone: mark one that it shows, use a mesh, or insert one of a scene" in capfd.readouterr().out
    )
    mark_static(street, np.eye(4), np.array([0.4, 0.4, 0.8]), "cone")
    assert bpy.ops.unisim.row_of_cones(count=3) == {"FINISHED"}
    copies = [edit for edit in read(street).edits if isinstance(edit, CopyStatic)]
    assert len(copies) >= 2 and {edit.box for edit in copies} == {"cone"}
