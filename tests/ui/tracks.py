"""Boxes of a log without boxes: actors found, a parked row corrected beside drawing each from nothing, a moving car tracked from
one box, doubtful places stepped through, and the result saved. Run by `run.py`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from shutil import copytree
from typing import Any

import bpy
import numpy as np
from mathutils import Euler, Vector

sys.path.insert(0, str(Path(__file__).parent))
from buttons import CROSS, found_at, open_panel, place_of, press, raised, region_of
from hands import click, key, middle, place, sidebar, to
from session import MODULE, OUT, area, choose, inside, results, screenshot, start, until, view
from tasks import arrived, install, task

LOG, PACKAGES = OUT.parent / "log", OUT.parent / "packages"
FRAME = 9


def module(name: str) -> Any:
    """A module of the extension."""
    return sys.modules[f"{MODULE}.{name}"]


def boxes() -> list[Any]:
    """The boxes that are corrected."""
    return [obj for obj in bpy.context.scene.objects if obj.unisim.kind == "TRACK"]


def noted(obj: Any) -> dict[str, Any]:
    """A box as in a file of boxes."""
    about: dict[str, Any] = json.loads(obj.unisim_track.track)
    return about


def cars(moves: bool) -> list[tuple[str, Vector, float, list[float]]]:
    """Cars of the street's truth at `FRAME`: id, place, heading, size; nearest first."""
    rows = json.loads((OUT.parent / "truth_boxes.json").read_text())
    return [(uid, Vector(at), yaw, size) for uid, is_moving, at, yaw, size in rows if is_moving == moves]


def imported() -> Iterator[float]:
    """The log alone, with its points, seen from above."""
    copytree(PACKAGES, Path(bpy.utils.user_resource("SCRIPTS"), "addons", "modules"), dirs_exist_ok=True)
    yield from to(*middle(area("VIEW_3D")))
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.import_log("INVOKE_DEFAULT", filepath=str(LOG))
    yield from arrived(4)
    yield from sidebar()
    scene = bpy.context.scene
    assert not [obj for obj in scene.objects if obj.unisim.kind == "ACTOR"]
    scene.frame_set(FRAME)
    yield from open_panel("Show", "show_ways")
    yield from press("unisim.show_points(recorded=True, simulated=False", columns=(0.3, 0.45, 0.62, 0.8))
    yield from until(
        lambda: any(o.unisim.kind == "POINTS" and len(o.data.vertices) for o in scene.objects), "no points"
    )
    from_above(cars(False)[0][1], 60.0)
    yield 0.5
    screenshot("points_from_above")


def from_above(at: Vector, wide_m: float) -> None:
    """Look straight down."""
    looks = view()[2]
    looks.view_perspective = "ORTHO"
    looks.view_rotation = Euler((0.0, 0.0, -np.pi / 2)).to_quaternion()
    looks.view_location, looks.view_distance = at, wide_m


def found() -> Iterator[float]:
    """Find Actors."""
    background = module("process.background")
    yield from press("unisim.find_actors", columns=(0.3,))
    yield from until(lambda: background.running, "nothing runs", 10)
    yield 2.0
    screenshot("finding")
    yield from until(lambda: not background.running, "the search does not end", 300)
    task_now = next((t for kind, t in background.newest.items() if kind.__name__ == "FindTask"), None)
    assert task_now is not None
    assert task_now.code == 0, task_now.problem
    yield from until(boxes, "no boxes came", 20)
    results["found"] = [[o.name, round(o.unisim_track.certainty, 2), noted(o)["class"]] for o in boxes()]
    yield 0.5
    screenshot("found_boxes")


def nearest_box(at: Vector) -> Any:
    """The box nearest to a place, within 3 m."""
    near = min(boxes(), key=lambda obj: (obj.matrix_world.translation.xy - at.xy).length, default=None)
    return near if near is not None and (near.matrix_world.translation.xy - at.xy).length < 3.0 else None


def dragged_to(at: Vector) -> Iterator[float]:
    """G moves the active box, and the mouse where it is to be."""
    begin = place(bpy.context.active_object.matrix_world.translation)
    yield from to(*begin)
    yield from key("G")
    yield 0.1
    end = place(at)
    for share in np.linspace(0.2, 1.0, 6):
        yield from to(*(np.array(begin) + share * (np.array(end) - begin)))
        yield 0.03
    yield from click()
    yield 0.1


def turned_to(yaw: float) -> Iterator[float]:
    """R turns the active box by degrees that are typed."""
    now = bpy.context.active_object.matrix_world.to_euler().z
    away = float(np.degrees((yaw - now + np.pi / 2) % np.pi - np.pi / 2))
    if abs(away) < 4.0:
        return
    yield from key("R")
    yield from key("Z")
    for letter in f"{away:.0f}":
        yield from key(
            "NUMPAD_MINUS"
            if letter == "-"
            else "ZERO ONE TWO THREE FOUR FIVE SIX SEVEN EIGHT NINE".split()[int(letter)],
            letter,
        )
    yield from key("RET")
    yield 0.1


def tracked(obj: Any) -> Iterator[float]:
    """Track This, to its end."""
    uid, following = obj.unisim.uid, module("features.tracks.following")
    yield from press("unisim.track_this")
    yield from until(lambda: following.following, "nothing is followed", 10)
    yield from until(lambda: not following.following, "following does not end", 120)
    told = bpy.context.window_manager.unisim_following
    assert not told, told
    assert noted(next(o for o in boxes() if o.unisim.uid == uid))["sweeps"], "nothing came of it"
    yield 0.3


def drawn(at: Vector, yaw: float) -> Iterator[float]:
    """A box from nothing: the cursor there, Draw Box > Car, turned and moved, Track This."""
    from_above(at, 25.0)
    yield 0.2
    yield from to(*place(at))
    yield from key("RIGHTMOUSE", shift=True)
    yield 0.2
    before = {obj.name for obj in boxes()}
    yield from place_of("unisim.edit_boxes")
    x, y = found_at[0]
    y = yield from raised(y, region_of(view()[0], "UI").y + 60)
    yield from to(x, y - 20)
    yield from click()
    yield 0.4
    yield from key("C")  # Car, where the menu opens upwards, too
    yield 0.2
    yield from until(lambda: {obj.name for obj in boxes()} - before, "no box came", 10)
    yield from turned_to(yaw)
    yield from dragged_to(at + Vector((0.1, -0.1, 0.0)))
    yield 0.3
    yield from tracked(bpy.context.active_object)


def error_of(obj: Any, at: Vector) -> float:
    """Distance of a box from a place, seen from above, metres."""
    return round((obj.matrix_world.translation.xy - at.xy).length, 3)


def parked_row(corrects: bool) -> Iterator[float]:
    """A parked row of three: what was found of it is corrected and accepted; else each is drawn."""
    errors = []
    for _, at, yaw, _ in cars(False)[:3]:
        obj = nearest_box(at) if corrects else None
        if obj is None:
            yield from drawn(at, yaw)
            obj = bpy.context.active_object
        else:
            from_above(at, 25.0)
            yield 0.2
            yield from to(*place(obj.matrix_world.translation))
            yield from click()
            yield 0.2
            if bpy.context.active_object is not obj:
                choose(obj)
            if error_of(obj, at) > 0.3:
                yield from dragged_to(at)
                yield from tracked(obj)
            else:
                yield from press("unisim.accept_boxes", columns=(0.3,))
        errors.append(error_of(obj, at))
        screenshot(f"row_{'corrected' if corrects else 'drawn'}_{len(errors)}")
    results["row_corrected_m" if corrects else "row_drawn_m"] = errors


def moving_car() -> Iterator[float]:
    """One box of a moving car, tracked; then two frames looked at."""
    _, at, yaw, _ = cars(True)[0]
    yield from drawn(at, yaw)
    obj = bpy.context.active_object
    results["moving_m"] = error_of(obj, at)
    yield 1.0
    screenshot("tracked_car")
    bpy.context.scene.frame_set(FRAME + 6)
    yield 1.5
    from_above(obj.matrix_world.translation, 25.0)
    yield 1.0
    screenshot("tracked_car_later")
    view()[2].view_perspective = "CAMERA"
    yield 2.0
    screenshot("tracked_car_in_camera")


def doubtful() -> Iterator[float]:
    """The next doubtful place, which is then dismissed."""
    about = bpy.context.scene.unisim_tracks
    yield from press("unisim.next_doubtful")
    yield 1.5
    results["place"] = about.place
    screenshot("doubtful")
    if before := json.loads(about.place or "null"):
        yield from press("unisim.dismiss_doubtful", columns=(CROSS, 0.82))
        yield from until(lambda: json.loads(about.place or "{}").get("key") != before["key"], "it is not dismissed", 5)
        screenshot("dismissed")


def undone() -> Iterator[float]:
    """Ctrl-Z takes back the deletion of a box."""
    before = len(boxes())
    choose(next(obj for obj in boxes() if obj.visible_get()))
    yield from press("unisim.delete_boxes")
    yield from until(lambda: len(boxes()) == before - 1, "it is not deleted", 5)
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z", ctrl=True)
    yield from until(lambda: len(boxes()) == before, "it does not come back", 5)


def saved() -> Iterator[float]:
    """Save Boxes: they are the log's actors."""
    scene = bpy.context.scene
    yield from press("unisim.save_boxes")
    yield from until(lambda: not boxes(), "the boxes are not saved", 20)
    assert scene.unisim.log.endswith(".boxes.json")
    results["actors"] = sum(obj.unisim.kind == "ACTOR" for obj in scene.objects)
    yield 1.0
    screenshot("saved")


def emptied() -> Iterator[float]:
    """All boxes are discarded."""
    if boxes():
        yield from press("unisim.discard_boxes", columns=(0.83, 0.85, 0.81))
        yield from until(lambda: not boxes(), "boxes are left", 5)


def steps() -> Iterator[float]:
    """The session."""
    yield from install()
    yield from task("boxes_import", imported)
    yield from task("boxes_drawn_row", lambda: parked_row(False))
    yield from task("boxes_discarded", emptied)
    yield from task("boxes_found", found)
    yield from task("boxes_corrected_row", lambda: parked_row(True))
    yield from task("boxes_moving_car", moving_car)
    yield from task("boxes_doubtful", doubtful)
    yield from task("boxes_undone", undone)
    yield from task("boxes_saved", saved)


if __name__ == "__main__":
    start(steps(), "tracks")
