"""Ten tasks of a day's work on one drive, one after the other, with mouse and keys. Run by `run.py`.

The drive is that of the trained scene that `UNISIM_UI_SCENE` names, which is imported after the first task, and the car
to insert is one of the sample's scene. Without it the drive is that of `UNISIM_UI_LOG`, or eight seconds of the procedural
street, and the car is one of its own. Where results go, and how small they are, is set beforehand.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d

sys.path.insert(0, str(Path(__file__).parent))
import importing
import maneuvers
from browser import choose_path
from buttons import open_panel, press, redo_panel, typed
from edit_panel import module, picked
from first_drive import searched
from hands import click, drag, drop, edits, key, middle, place, to, write
from points import legend
from rollouts import at_work
from session import OUT, SCENE, area, inside, results, screenshot, start, until
from simulate import drive_on, prepared
from tasks import empty_file, install, task, told

IS_TRAINED = "UNISIM_UI_SCENE" in os.environ
LOG = OUT.parent / "log"
if IS_TRAINED:
    LOG = (SCENE.parent / json.loads(SCENE.read_text())["log"]["path"]).resolve()
ANOTHER = OUT.parent / "another" / "scene.json"
"""The trained scene that a car is inserted from."""
EARLIER_S, GAPS, CONES = 2.0, 10, 5


def frame_at(share: float) -> int:
    """The frame after a share of the first eight seconds, or of a shorter drive."""
    scene = bpy.context.scene
    return round(scene.frame_start + share * min(scene.frame_end - scene.frame_start, 80))


def to_frame(frame: int) -> Iterator[float]:
    """Click on a frame of the timeline."""
    region = next(r for r in area("DOPESHEET_EDITOR").regions if r.type == "WINDOW")
    x, _ = region.view2d.view_to_region(frame, 0, clip=False)
    yield from to(region.x + x, region.y + region.height - 10)
    yield from click()
    yield from until(lambda: bpy.context.scene.frame_current == frame, f"the timeline does not go to {frame}", 10)
    yield from to(*middle(area("VIEW_3D")))


def stated(kind: str) -> list[Any]:
    """The scenario's edits of a type."""
    return [edit for edit in maneuvers.named_edits() if edit["type"] == kind]


def imported() -> Iterator[float]:
    """File > Import, the folder of the drive."""
    importing.LOG = LOG
    yield from importing.by_menu()


def parked_row() -> list[bpy.types.Object]:
    """The vehicles that stand in a row beside the ego's lane, on the right, in view."""
    ego = next(o for o in bpy.context.scene.objects if o.unisim.kind == "EGO").matrix_world.inverted()
    row = []
    for obj in bpy.context.scene.objects:
        at = ego @ obj.matrix_world.translation
        if obj.unisim.kind == "ACTOR" and obj.parent is None and obj.visible_get() and obj.dimensions.x > 3:
            row += [obj] if 8 < at.x < 60 and -6 < at.y < -1.5 else []
    return row


def removed() -> Iterator[float]:
    """Bird's-Eye View, the wheel, B, a box over the parked row, X, Enter, and Bird's-Eye View again."""
    views = module("features.points.birds_eye").views
    uids = sorted(obj.unisim.uid for obj in parked_row())
    yield from press("unisim.birds_eye")
    yield from until(lambda: list(views(bpy.context.scene)), "no view from above opens", 10)
    yield 1.0
    ((found, space, _),) = list(views(bpy.context.scene))
    region = next(r for r in found.regions if r.type == "WINDOW")
    yield from to(region.x + region.width / 2, region.y + region.height / 2)
    for _ in range(5):  # the whole row
        yield from key("WHEELDOWNMOUSE")
        yield 0.1
    yield 0.5
    shown = [location_3d_to_region_2d(region, space.region_3d, o.matrix_world.translation) for o in parked_row()]
    corners = np.array(shown) + [region.x, region.y]
    (left, down), (right, up) = corners.min(0), corners.max(0)
    yield from to(left - 2, down)
    yield from key("B")
    yield 0.2
    yield from drag(left - 2, down, right + 2, up)
    screenshot("ten_row_selected")
    yield from key("X")
    yield 0.3
    yield from key("RET")
    yield from until(lambda: removals() == uids, f"{removals()} are removed and not {uids}", 20)
    results["removed"] = len(uids)
    yield from press("unisim.birds_eye")


def removals() -> list[str]:
    """The ids of the actors that are removed."""
    return sorted(uid for kind, uid in edits() if kind == "Remove")


def inserted() -> Iterator[float]:
    """A car of another trained scene, by F3 and the file browser; Cut-In by the pie; 2 s earlier by F9."""
    yield from to_frame(frame_at(0.44))  # a cut-in takes four seconds
    yield from searched("actor of a trained" if IS_TRAINED else "actor of the drive")
    if IS_TRAINED:
        yield from choose_path(ANOTHER)
    yield 1.0
    screenshot("ten_thumbnails")
    yield from key("RET")
    yield from until(lambda: stated("insert") or stated("duplicate"), "no car is inserted", 20)
    yield from to(*place(bpy.context.view_layer.objects.active.matrix_world.translation))  # Blender hears of the view
    yield 0.3
    yield from maneuvers.from_pie("cut_in")
    (first,) = stated("cut_in")
    earlier = max(first["at_s"] - EARLIER_S, 0.0)
    yield from redo_panel(str(first["at_s"]), f"{earlier:g}")
    yield from until(lambda: abs(stated("cut_in")[0]["at_s"] - earlier) < 1e-3, "it cuts in when it did", 10)
    results["cut_in"] = stated("cut_in")


def braked() -> Iterator[float]:
    """3 s in the timeline, a click on the car ahead, Brake by the pie."""
    yield from to_frame(frame_at(0.375))
    yield from picked(car_ahead())
    yield from maneuvers.from_pie("brake")
    results["brake"] = stated("brake")


def car_ahead() -> str:
    """The name of the recorded car in view that drives ahead of the vehicle."""
    camera = bpy.context.scene.camera.matrix_world.inverted()
    edited = {uid for _, uid in edits()}

    def away(obj: bpy.types.Object) -> float:
        at = camera @ obj.matrix_world.translation
        return float(-at.z + 3 * abs(at.x)) if at.z < -5 else 1e9

    cars = [
        obj for obj in bpy.context.scene.objects
        if obj.unisim.kind == "ACTOR" and obj.parent is not None and "Car" in obj.name and obj.visible_get()
        and obj.unisim.uid not in edited and not obj.unisim.look_scene
    ]  # fmt: skip
    return min(cars, key=away).name


def cones() -> Iterator[float]:
    """Row of Cones by F3, its number by F9."""
    yield from searched("row of cones")
    yield from until(lambda: stated("row"), "no row", 20)
    yield from redo_panel(str(stated("row")[0]["count"]), str(CONES))
    yield from until(lambda: stated("row")[0]["count"] == CONES, f"not {CONES} cones: {stated('row')}", 10)
    results["cones"] = stated("row")


def pedestrian() -> Iterator[float]:
    """Crossing by the pie, with nothing selected: a new pedestrian, in front of the vehicle."""
    yield from maneuvers.deselected()
    yield from to_frame(frame_at(0.25))
    yield from maneuvers.from_pie("cross")
    results["cross"] = stated("cross")


def points() -> Iterator[float]:
    """Both sweeps with the view from above, the recorded points moved aside."""
    yield from press("unisim.show_points(recorded=True, simulated=True", columns=(0.8, 0.9, 0.7))
    yield from press("unisim.birds_eye")
    yield from typed("recorded_offset_m", "20")
    yield from until(
        lambda: abs(bpy.context.scene.unisim.recorded_offset_m - 20.0) < 1e-3, "no offset is taken over", 10
    )
    yield from until(lambda: any("drops agree" in line for line in legend()), "the sweeps are not compared", 900)
    results["points"] = legend()
    yield 1.0
    screenshot("ten_points_above")


def without_points() -> None:
    """Views as they were before."""
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.birds_eye()
        bpy.ops.unisim.show_points(recorded=False, simulated=False)


def gaps() -> Iterator[float]:
    """The gap as a batch's parameter, ten values of it, submitted."""
    scene = bpy.context.scene
    scene.unisim_batch.out, scene.unisim_batch.jobs = str(OUT.parent / "gaps"), 1
    scene.unisim.quality, scene.unisim.sequence_width, scene.unisim.sequence_sensors = "fast", 96, "CAMERA"
    last, scene.frame_end = scene.frame_end, scene.frame_start
    yield from open_panel("Batch", "unisim.add_parameter", 0.5)
    yield from press("unisim.add_parameter(")
    yield 1.0
    yield from write("gap")
    yield 1.0
    screenshot("ten_gap_search")
    yield from key("RET")
    yield from until(lambda: bpy.context.scene.unisim_batch.parameters, "no parameter is added", 10)
    yield from typed("parameters[0].count", str(GAPS))
    about = bpy.context.scene.unisim_batch.parameters[0]
    results["gap"] = [about.about, about.start, about.stop, about.count]
    yield from press("unisim.submit_batch()")
    yield from at_work(900)
    bpy.context.scene.frame_end = last
    manifest = json.loads((OUT.parent / "gaps" / "manifest.json").read_bytes())
    assert len(manifest["variants"]) == GAPS and manifest["unfinished"] == [], manifest["unfinished"]


def driven() -> Iterator[float]:
    """Simulate, read the scores, Open Rollout, move a car at a later frame, Drive On from Here."""
    yield from press("unisim.simulate()")
    yield from at_work(600)
    screenshot("ten_scores")
    yield from press("unisim.open_rollout(")
    yield from until(lambda: bpy.context.scene.unisim_simulation.rollout, f"the rollout is not opened: {told()}", 240)
    yield 1.0
    yield from to_frame(bpy.context.scene.frame_start + 4)
    yield from drive_on()


def filmed() -> Iterator[float]:
    """Render Sequence, Make Film."""
    yield from press("unisim.render_sequence()")
    yield from at_work(900)
    yield from press("unisim.make_film", columns=(0.3,))
    yield from at_work()
    results["film"] = told()
    assert module("features.output.operators").film_of(bpy.context.scene) is not None


def small_film() -> None:
    """Six frames of all sensors, in small images."""
    scene = bpy.context.scene
    about = scene.unisim
    about.out, about.quality, about.sequence_width, about.sequence_sensors = (
        str(OUT.parent / "film"),
        "fast",
        160,
        "ALL",
    )
    scene.frame_end = scene.frame_start + 5


def trained_scene() -> Iterator[float]:
    """The trained scene of the drive, dropped onto the window."""
    drop(SCENE)
    yield from until(lambda: bpy.context.scene.unisim.scene, "the trained scene is not imported", 240)
    yield from importing.arrived()
    assert all(kind == "Remove" for kind, _ in edits()), edits()


def steps() -> Iterator[float]:
    """The session."""
    yield from install()
    empty_file()
    yield 1.0
    yield from task("ten_imported", imported)
    yield from task("ten_removed", removed)
    if IS_TRAINED:
        yield from trained_scene()
    yield from task("ten_inserted", inserted)
    yield from task("ten_braked", braked)
    yield from task("ten_cones", cones)
    yield from task("ten_pedestrian", pedestrian)
    yield from task("ten_points", points)
    without_points()
    yield 1.0
    yield from task("ten_gaps", gaps)
    prepared(1.0)
    yield from task("ten_driven", driven)
    small_film()
    yield from task("ten_filmed", filmed)


if __name__ == "__main__":
    start(steps(), "ten_tasks")
