"""Lines of the edits list from a sampled scene, from plain data; names of variants and of their files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from imported_scene import (
    added,
    beside,
    changed,
    displaced,
    driving,
    imported,
    one_of,
    sampled_object,
    standing,
    without,
)

from unisim_blender.core.errors import ScenarioError, UnisimError
from unisim_blender.core.geometry import Trajectory, quaternion_from_yaw
from unisim_blender.editing.edits.lines import EditLine, nearest_frame, problem_line
from unisim_blender.editing.edits.variants import checked_name, compared, differences, file_names, free_variant_name
from unisim_blender.editing.reading.scenario import group_lines
from unisim_blender.editing.sampled.scene import Sampled, Scaling
from unisim_blender.editing.sampled.source import DriveSource


def lines_of(sampled: Sampled, source: DriveSource) -> list[EditLine]:
    """All lines of a sampled scene."""
    found = [*group_lines("RIG", "", sampled, source.drive), *group_lines("STATIC", "", sampled, source.drive)]
    for uid in sorted({one.uid for one in sampled.of("ACTOR")} | set(source.drive.actors)):
        found += group_lines("ACTOR", uid, sampled, source.drive)
    return found


def test_an_import_has_no_lines(source: DriveSource) -> None:
    assert lines_of(imported(source.drive), source) == []


def test_what_became_of_actors(source: DriveSource) -> None:
    still, car = standing(source.drive).uid, driving(source.drive).uid
    sampled = imported(source.drive)
    moved = changed(sampled, still, poses=displaced(one_of(sampled, still).poses, z=0.5))
    (line,) = lines_of(moved, source)
    assert (line.kind, line.uid, line.part, line.what) == ("ACTOR", still, "MOVE", "Moved 0.5 m up")
    assert line.frames == tuple(range(20)) and line.object_name == still and line.key == ("ACTOR", still, "MOVE")
    late = one_of(sampled, car).poses.copy()
    late[14:] = beside(late[14:], left=2.0)
    (line,) = lines_of(changed(sampled, car, poses=late), source)
    assert line.frames == tuple(range(14, 20)) and line.start_s == pytest.approx(sampled.clock.times_s[14])
    (line,) = lines_of(without(sampled, car), source)
    assert (line.part, line.what, line.object_name, line.icon) == ("REMOVE", "Removed", "", "TRASH")
    (line,) = lines_of(changed(sampled, still, scaling=Scaling((1.3, 1.3, 1.3))), source)
    assert (line.part, line.what) == ("SCALE", "Scaled by 1.3")


def test_copies_and_inserted_ones_have_lines_of_their_own(source: DriveSource) -> None:
    car = driving(source.drive).uid
    sampled = imported(source.drive)
    copy = sampled_object("Copy", "ACTOR", beside(one_of(sampled, car).poses, left=3.5), uid=car, original_name=car)
    box = sampled_object("Box", "ACTOR", one_of(sampled, car).poses, uid="", mesh="box", label="Other")
    lines = lines_of(added(sampled, copy, box), source)
    assert {(line.part, line.who) for line in lines} == {("COPY", "Copy"), ("MESH", "Box")}
    (own,) = [line for line in lines if line.part == "COPY"]
    assert own.what == "Copied: 3.5 m left" and own.key == ("ACTOR", "Copy", "COPY")


def test_the_vehicle_and_its_sensors(source: DriveSource) -> None:
    sampled = imported(source.drive)
    ego = one_of(sampled, "Ego vehicle").poses
    lines = lines_of(changed(sampled, "Ego vehicle", poses=beside(ego, left=2.0)), source)
    assert lines[0].what == "Moved 2.0 m left" and {line.kind for line in lines} == {"EGO", "CAMERA", "LIDAR"}
    camera = one_of(sampled, "front_camera")
    (line,) = lines_of(changed(sampled, "front_camera", poses=displaced(camera.poses, z=0.3)), source)
    assert line.part == "SENSOR" and line.what.startswith("Camera: ") and "up" in line.what
    (line,) = lines_of(without(sampled, "pandar64"), source)
    assert (line.part, line.what, line.who) == ("REMOVE", "LiDAR removed", "pandar64")
    (line,) = lines_of(added(sampled, replace(camera, name="second")), source)
    assert (line.part, line.what) == ("INSERT", "Camera copied")


def test_a_problem_names_its_object(source: DriveSource) -> None:
    sampled = imported(source.drive)
    fault = ScenarioError('object "car-01": is sheared')
    line = problem_line("ACTOR", "car-01", fault, sampled.objects)
    assert (line.part, line.what, line.object_name) == ("PROBLEM", "Is sheared", "car-01")


def test_the_same_edits_are_no_difference(source: DriveSource) -> None:
    uid = standing(source.drive).uid
    sampled = imported(source.drive)
    poses = one_of(sampled, uid).poses
    one, other, far = (
        tuple(lines_of(changed(sampled, uid, poses=displaced(poses, x=x)), source)) for x in (1.0, 1.00001, 1.5)
    )
    assert list(differences(one, other)) == []
    (found,) = compared(one, far)
    assert found.here is one[0] and found.there is far[0] and compared(one, far) is compared(one, far)
    (missing,) = differences((), far)
    assert missing.here is None and missing.line is far[0]
    assert list(differences((), (replace(far[0], muted=0),))) == [], "muted edits do not count"


def test_names_of_variants() -> None:
    assert (
        free_variant_name("Variant 2", ["A"]) == "Variant 2" and free_variant_name("Cut-in", ["Cut-in"]) == "Cut-in 1"
    )
    assert free_variant_name("Variant 2", ["Variant 2", "Variant 3"]) == "Variant 4"
    checked_name("Schneefall", ["A"])
    for name, text in (("  ", "needs a name"), ("A", "another scene"), ("ü" * 32, "longer than the 63 bytes")):
        with pytest.raises(UnisimError, match=text):
            checked_name(name, ["A"])


def test_names_of_files_are_all_different() -> None:
    assert list(file_names(["a/b", "a:b", "A_B", ".."]).values()) == ["a_b", "a_b 2", "A_B 3", "variant"]


def test_lines_of_static_items(source: DriveSource) -> None:
    import json

    sampled = imported(source.drive)
    home = np.tile(np.eye(4), (20, 1, 1))
    model = json.dumps({"world_from_box": home[0].tolist(), "size_m": [1.0, 1.0, 1.0]})
    item = sampled_object("bin", "STATIC", home, model=model)
    marked = replace(sampled, items={"bin": model})
    assert lines_of(added(marked, item), source) == []
    (line,) = lines_of(added(marked, replace(item, poses=displaced(home, x=4.0))), source)
    assert (line.part, line.what) == ("MOVE", "Moved 4.0 m away")
    (line,) = lines_of(marked, source)
    assert (line.part, line.what, line.who) == ("REMOVE", "Removed", "bin")


def test_the_nearest_of_an_edits_frames() -> None:
    assert nearest_frame((3, 9), 7) == 9 and nearest_frame((3, 9), 6) == 3, "the earlier one of two as near"
    assert nearest_frame((), 5) == 5


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_a_cone_is_moved_as_the_ego_sees_it_whatever_its_own_axes(source: DriveSource, yaw: float) -> None:
    cone = standing(source.drive, "Cone")
    track = cone.world_from_actor
    track = Trajectory(
        track.times_s, track.positions, np.tile(quaternion_from_yaw(np.array(yaw)), (len(track.times_s), 1))
    )
    drive = replace(source.drive, actors={cone.uid: replace(cone, world_from_actor=track)})
    sampled, ego = imported(drive), drive.world_from_ego
    nearest = np.linalg.norm((ego.positions - track.positions[0])[:, :2], axis=1).argmin()
    x, y, _ = ego.at(ego.times_s[nearest])[:3, 1] * 3.0
    moved = changed(sampled, cone.uid, poses=displaced(one_of(sampled, cone.uid).poses, x, y))
    (line,) = lines_of(moved, replace(source, drive=drive))
    assert line.what == "Moved 3.0 m left"
