"""LiDAR points: the window goes on while they are shown; their colours, legends and dropped beams, and the view from above.
Run by `run.py`. With `UNISIM_UI_LOG` they are that log's, in place of the sample's."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from buttons import open_panel, press
from hands import key, middle, sidebar, to
from heart import heart
from pixels import apart, grab, part, region_rectangle
from session import MODULE, OUT, area, from_behind, inside, redraw, results, screenshot, start, until, view
from tasks import IMPORTED, arrived, fresh, imported, install, redraw_alone, save_file, task

BEYOND_S = 0.1
"""How long the window may stand still beyond what drawing it takes."""
TIMES = 3
"""How often it is tried: other programs of the machine may take the processor once."""


def shown() -> bool:
    """Whether recorded points are there."""
    return any(one.unisim.kind == "POINTS" and len(one.data.vertices) for one in bpy.context.scene.objects)


def stamp() -> str:
    """What tells the points of one frame from those of the next."""
    return next(str(one.unisim.stamp) for one in bpy.context.scene.objects if one.unisim.kind == "POINTS")


def first_points() -> Iterator[float]:
    """Drive > Show > Recorded, measured beside redrawing the window with and without points."""
    measured = []
    for _ in range(TIMES):
        yield from fresh()
        yield from open_panel("Show", "show_ways")
        before = part(grab(), region_rectangle("WINDOW")).copy()
        yield from redraw_alone()
        without = heart.longest
        yield from to(*middle(area("VIEW_3D")))
        yield from press("unisim.show_points(recorded=True, simulated=False", columns=(0.3, 0.45, 0.62, 0.8))
        heart.begin()
        yield from until(shown, "no recorded points are shown", 30)
        yield 1.0
        block = heart.longest
        screenshot("first_points")
        changed = int((apart(before, part(grab(), region_rectangle("WINDOW"))) > 8).sum())
        assert changed > 500, f"{changed} pixels are points"
        yield from redraw_alone()
        measured.append({"block_s": block, "redraw_without_s": without, "redraw_with_s": heart.longest})
        results["first_points"] = measured
        if block <= max(without, heart.longest) + BEYOND_S:
            break
    beyond = [one["block_s"] - max(one["redraw_without_s"], one["redraw_with_s"]) for one in measured]
    assert min(beyond) <= BEYOND_S, f"the window stands still {min(beyond):.2f} s beyond drawing"


def next_points() -> Iterator[float]:
    """The arrow key: the points of the next frames, with the window going on."""
    yield from to(*middle(area("VIEW_3D")))
    before = stamp()
    yield from key("RIGHT_ARROW")
    yield from until(lambda: stamp() != before, "the points stay those of the frame before", 10)


def legend() -> tuple[str, ...]:
    """The lines of the legend."""
    shown_now = sys.modules[f"{MODULE}.features.points.clouds"].shown_points(bpy.context.scene)
    return tuple(str(line) for line in shown_now.legend.lines) if shown_now is not None else ()


def frames() -> set[float]:
    """The frames of the points that are shown."""
    shown_now = sys.modules[f"{MODULE}.features.points.clouds"].shown_points(bpy.context.scene)
    return {sweep.frame for sweep in shown_now.sweeps if len(sweep.points)}


def compared_points() -> Iterator[float]:
    """Both sweeps with dropped beams: the legend compares them, for each colour and from behind."""
    scene = bpy.context.scene
    yield from open_panel("Show", "show_ways")
    yield from press("unisim.show_points(recorded=True, simulated=True", columns=(0.8, 0.9, 0.7))
    yield from until(lambda: any("drops agree" in line for line in legend()), "the sweeps are not compared", 900)
    results["compared"] = legend()
    for by in ("INTENSITY", "DEPTH", "RING", "INSTANCE", "DIFFERENCE"):
        scene.unisim.points_colour = by
        redraw()
        yield 1.0
        screenshot(f"points_{by.lower()}")
    view()[2].view_perspective = "PERSP"
    from_behind(view()[2])
    yield 1.0
    screenshot("points_behind")
    before = part(grab(), region_rectangle("WINDOW")).copy()
    yield from press("drops=True")
    yield from until(lambda: scene.unisim.show_drops, "the button Dropped Beams does nothing", 10)
    yield from until(lambda: any("drops agree" in line for line in legend()), "the sweeps are not compared", 120)
    yield 1.0
    screenshot("points_drops")
    changed = int((apart(before, part(grab(), region_rectangle("WINDOW"))) > 8).sum())
    assert changed > 200, f"{changed} pixels are dropped beams"
    scene.unisim.recorded_offset_m = 20.0
    redraw()
    yield 1.0
    screenshot("points_beside")
    scene.unisim.recorded_offset_m = 0.0
    view()[2].view_perspective = "CAMERA"


def seen_from_above() -> Iterator[float]:
    """The view from above opens with one press, follows the vehicle's direction, and closes with another."""
    birds_eye = sys.modules[f"{MODULE}.features.points.birds_eye"]

    def views() -> list[tuple[Any, Any, Any]]:
        return list(birds_eye.views(bpy.context.scene))

    yield from press("unisim.birds_eye")
    yield from until(lambda: len(views()) == 1, "no view from above opens", 10)
    yield 1.0
    screenshot("points_above")
    for _ in range(3):
        bpy.context.scene.frame_set(bpy.context.scene.frame_current + 4)
        yield 1.0
        ((_, space, ego),) = views()
        up = space.region_3d.view_rotation.to_matrix().col[1]
        assert up.xy.normalized().dot(ego.matrix_world.to_3x3().col[0].xy.normalized()) > 0.9999
    yield from until(
        lambda: frames() == {bpy.context.scene.frame_current}, "the points stay those of a frame before", 200
    )
    yield 1.0
    screenshot("points_above_later")
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.birds_eye()
    yield from until(lambda: not views(), "the view from above does not close", 10)


def steps() -> Iterator[float]:
    """The session."""
    if os.environ.get("UNISIM_UI_LOG"):
        yield from install()
        with inside(area("VIEW_3D")):
            bpy.ops.unisim.import_log("INVOKE_DEFAULT", filepath=str(OUT.parent / "log"))
        yield from arrived()
        yield from sidebar()
        save_file(IMPORTED)
    else:
        yield from imported()
    yield from task("first_points", first_points)
    yield from task("next_points", next_points)
    yield from task("compared_points", compared_points)
    yield from task("seen_from_above", seen_from_above)


if __name__ == "__main__":
    start(steps(), "points")
