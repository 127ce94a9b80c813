"""Which captures an edit makes stale: those alone that can see it, before or after."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rendered_folder import contents
from tiny_drive import IDENTITY, FakeMethod, recipe_of, tiny_drive, tiny_plan, world_pose

from unisim_blender.core.geometry import Trajectory
from unisim_blender.core.render.visibility import Reach
from unisim_blender.core.sequence.plan import CaptureIdentities, RenderPlan
from unisim_blender.core.sequence.run import render_sequence
from unisim_blender.core.world.drive import Actor, Appearance, Box, Drive, StaticCopy
from unisim_blender.core.world.replay import DriveStates

FRAMES = range(6)


def standing(uid: str, x: float, y: float, **changes: Any) -> Actor:
    """A box of 2 m edges that stands throughout; the camera looks along x from x = 1 to 3.5 m, 28
    degrees to either side."""
    trajectory = Trajectory(np.zeros(1), np.array([[x, y, 1.0]]), IDENTITY[None])
    return replace(Actor(uid, "Car", np.full(3, 2.0), trajectory, 0.0, 0.5, False, Appearance(uid)), **changes)


def plan_of(drive: Drive, **changes: Any) -> RenderPlan:
    """The tiny plan with another drive."""
    plan = tiny_plan()
    captures = replace(plan.captures, states=DriveStates(drive, {}), **changes)
    return replace(plan, drive=drive, recipe=recipe_of(FakeMethod(drive)), captures=captures)


def stale(before: Drive, after: Drive, **changes: Any) -> dict[str, list[int]]:
    """The frames of which a capture has another identity, by its name."""
    a, b = (CaptureIdentities(plan_of(drive, **changes)) for drive in (before, after))
    names = a.of_frame(0)
    return {name: [f for f in FRAMES if a.of_frame(f)[name][0] != b.of_frame(f)[name][0]] for name in names}


def with_actors(*actors: Actor) -> Drive:
    """The tiny drive with more actors."""
    drive = tiny_drive()
    return replace(drive, actors={**drive.actors, **{actor.uid: actor for actor in actors}})


def test_an_actor_behind_the_camera_is_seen_by_lidar_alone() -> None:
    assert stale(tiny_drive(), with_actors(standing("new", -8.0, 0.0))) == {
        "camera/front": [],
        "lidar/top": list(FRAMES),
    }


def test_an_actor_beyond_the_lidars_range_is_seen_by_nobody_who_looks_away() -> None:
    assert stale(tiny_drive(), with_actors(standing("new", -260.0, 0.0))) == {"camera/front": [], "lidar/top": []}


def test_an_actor_in_view_is_seen_in_every_frame_in_which_it_is_there() -> None:
    late = standing("new", 20.0, 2.0, start_s=0.3)
    assert stale(tiny_drive(), with_actors(late)) == {"camera/front": [3, 4, 5], "lidar/top": [3, 4, 5]}


def test_an_actor_that_leaves_the_view_is_stale_where_it_was_in_view() -> None:
    """Beside the way, the frustum passes it: no frame but those in which its box is in view, and at most one more."""
    near = standing("new", 5.0, 3.5)
    found = stale(tiny_drive(), with_actors(near))["camera/front"]
    # the frustum's side goes through y = 0.533 (x - x_camera); the box's farthest corner is at x = 6, y = 2.5
    met = [f for f in FRAMES if 0.533 * (6.0 - (1.0 + 0.5 * f)) >= 2.5]
    assert set(met) <= set(found) and len(found) <= len(met) + 2 and len(found) < len(FRAMES), (met, found)


def moved(actor: Actor) -> Actor:
    trajectory = actor.world_from_actor
    return replace(actor, world_from_actor=replace(trajectory, positions=trajectory.positions + [0.0, 1e-6, 0.0]))


@pytest.mark.parametrize(
    "edit",
    [
        moved,
        lambda a: replace(a, size_m=a.size_m * 1.01, scale=(1.01, 1.01, 1.01)),
        lambda a: replace(a, appearance=Appearance("other")),
        lambda a: replace(a, uid="renamed"),
    ],
)
def test_every_change_of_an_actor_counts(edit: Callable[[Actor], Actor]) -> None:
    one = standing("one", 20.0, 2.0)
    assert stale(with_actors(one), with_actors(edit(one))) == {"camera/front": list(FRAMES), "lidar/top": list(FRAMES)}


def test_a_retimed_actor_is_stale_where_its_trajectory_changed() -> None:
    """A key that is displaced changes the frames whose exposure lies beside it, and no other."""
    drive = tiny_drive()
    car = drive.actors["car"]
    trajectory = car.world_from_actor
    bent = replace(trajectory, positions=trajectory.positions + 0.3 * (np.arange(6) == 4)[:, None])
    found = stale(drive, replace(drive, actors={**drive.actors, "car": replace(car, world_from_actor=bent)}))
    # frames at the neighbouring keys hang on this one with a weight of 0
    assert found == {"camera/front": [3, 4, 5], "lidar/top": [3, 4, 5]}


def test_removed_boxes_and_copies_count_where_they_are_in_view() -> None:
    drive = tiny_drive()
    for x, cameras in ((20.0, list(FRAMES)), (-20.0, [])):
        removed = replace(drive, static_removals=(Box(world_pose(x, 0.0, 1.0), np.full(3, 1.0)),))
        assert stale(drive, removed) == {"camera/front": cameras, "lidar/top": list(FRAMES)}
        copy = StaticCopy("copy", Box(world_pose(30.0, 0.0, 1.0), np.full(3, 1.0)), world_pose(x, 0.0, 1.0))
        assert stale(drive, replace(drive, static_copies=(copy,))) == {
            "camera/front": cameras,
            "lidar/top": list(FRAMES),
        }


def test_contact_shadows_reach_into_view() -> None:
    """An inserted actor just out of view counts with shadows, one that was recorded there does not."""
    beside = standing("new", 9.0, 7.2, inserted=True)
    reach = {"reach": Reach(shadow_m=1.75)}
    assert stale(tiny_drive(), with_actors(beside))["camera/front"] == []
    assert stale(tiny_drive(), with_actors(beside), **reach)["camera/front"]
    assert stale(tiny_drive(), with_actors(replace(beside, inserted=False)), **reach)["camera/front"] == []


@pytest.mark.parametrize("width", [None, 8])
def test_a_capture_sees_what_its_renderer_sees(width: int | None) -> None:
    """Also at another width, at which more or less lies beside the image; for actors all about its edges."""
    drive = with_actors(*(standing(f"a{i:02d}", 12.0, 4.0 + 0.2 * i) for i in range(40)))
    plan = plan_of(drive)
    plan = replace(plan, settings=replace(plan.settings, width=width))
    seen = CaptureIdentities(plan).of_frame(2)["camera/front"][1]
    camera = drive.cameras["front"] if width is None else drive.cameras["front"].resized(width)
    state = plan.captures.state(camera, camera.time_s[2])
    assert seen == tuple(actor.uid for actor in state.actors) and len(seen) > 2


def test_renderers_that_see_all_depend_on_the_whole_drive() -> None:
    found = stale(tiny_drive(), with_actors(standing("new", -260.0, 0.0)), sees_all=True)
    assert found == {"camera/front": list(FRAMES), "lidar/top": list(FRAMES)}


def test_an_edit_renders_again_what_can_see_it(tmp_path: Path) -> None:
    """And leaves the rest, to the bytes of a fresh render; labels alone are written anew where nothing else changed."""
    out = tmp_path / "out"
    render_sequence(tiny_plan(), out)
    edited = with_actors(standing("new", -8.0, 0.0, start_s=0.2, end_s=0.3))
    log = tmp_path / "log"
    plan = replace(plan_of(edited), recipe=recipe_of(FakeMethod(edited, log)))
    report = render_sequence(plan, out, resume=True)
    assert report.rendered == (2, 3) and report.captures == 2 and report.captures_kept == 10
    assert not log.exists(), "an image was rendered though the actor is behind the camera"
    render_sequence(plan, tmp_path / "fresh")
    assert contents(out) == contents(tmp_path / "fresh")


def test_labels_are_written_alone(tmp_path: Path) -> None:
    """An actor that nobody sees is in the labels."""
    out = tmp_path / "out"
    render_sequence(tiny_plan(), out)
    plan = plan_of(with_actors(standing("new", -260.0, 0.0)))
    report = render_sequence(plan, out, resume=True)
    assert report.rendered == () and report.captures == 0
    assert b"-260.0" in (out / "labels" / "000003.json").read_bytes()
    render_sequence(plan, tmp_path / "fresh")
    assert contents(out) == contents(tmp_path / "fresh")
