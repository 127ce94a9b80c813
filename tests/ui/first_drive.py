"""From an empty Blender to an edited, rendered sequence, with every press counted. Run by `run.py`.

`UNISIM_UI_SCENE` names another trained scene than the sample's, `UNISIM_UI_FRAMES` how many frames are
rendered at most.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from buttons import press
from hands import click, edits, import_dropped, key, middle, mouse, object_named, place, sidebar, to, write
from session import ARCHIVE, OUT, area, inside, results, screenshot, start, until, view, wait_for_image
from tasks import begin, seen, task, told

FRAMES = int(os.environ.get("UNISIM_UI_FRAMES", "3"))
SEQUENCE_S = 540.0
"""How long the sequence may take, in seconds."""


def imported() -> Iterator[float]:
    """Drop a trained scene onto Blender's default file."""
    yield from import_dropped(names=False)
    yield 1.0


def clicked(name: str) -> Iterator[float]:
    """Click an object in the view."""
    yield from to(*place(object_named(name).matrix_world.translation))
    yield from click()
    yield from until(lambda: bpy.context.view_layer.objects.active == object_named(name), f"{name} is not selected", 10)


def removed() -> Iterator[float]:
    """Click a standing car, X, Enter."""
    car = seen(driving=False)
    uid = object_named(car).unisim.uid
    yield from clicked(car)
    yield from key("X")
    yield 0.3
    yield from key("RET")
    yield from until(lambda: car not in bpy.context.scene.objects, "not removed")
    assert edits() == [("Remove", uid)]


def moved() -> Iterator[float]:
    """Click a driving car, G Y 1 Enter."""
    car = seen(driving=True)
    yield from clicked(car)
    for pressed in (("G",), ("Y",), ("ONE", "1"), ("RET",)):
        yield from key(*pressed)
    yield from until(lambda: ("Move", object_named(car).unisim.uid) in edits(), "not moved")


def copied() -> Iterator[float]:
    """Click a standing car, Shift-D, the mouse, Enter."""
    car = seen(driving=False)
    yield from clicked(car)
    x, y = mouse
    yield from key("D", shift=True)
    yield from to(x + 20, y)
    yield from to(x + 60, y)
    yield from key("RET")
    yield from until(lambda: any(name == "Duplicate" for name, _ in edits()), "not copied")


def searched(words: str) -> Iterator[float]:
    """F3, some letters, Enter."""
    yield from to(*middle(area("VIEW_3D")))
    yield from key("F3")
    yield 0.5
    yield from write(words)
    yield 0.5
    yield from key("RET")


def shifted() -> Iterator[float]:
    """Shift Ego Lane, found by F3."""
    yield from searched("shift ego")
    yield from until(lambda: any(name == "Ego" for name, _ in edits()), "the ego vehicle is not shifted", 10)
    yield 1.0


def rendered() -> Iterator[float]:
    """Z, 8: Rendered shading."""
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z")
    yield 0.4
    yield from key("NUMPAD_8")
    yield from until(lambda: view()[1].shading.type == "RENDERED", "Z 8 does not change the shading", 5)
    yield from wait_for_image()


def settings() -> Iterator[float]:
    """The sidebar's Output: a click into the folder, its path typed; the active camera alone, from the list."""
    about = bpy.context.scene.unisim
    yield from sidebar()
    yield from press("unisim.out", columns=(0.6,))
    yield from key("A", ctrl=True)
    yield from write(str(OUT.parent / "first_drive"))
    yield from key("RET")
    yield from until(lambda: about.out == str(OUT.parent / "first_drive"), f"the folder is {about.out!r}", 5)
    yield from press("sequence_sensors", columns=(0.6,))
    yield 0.6
    screenshot("list_of_sensors")
    for name in ("DOWN_ARROW", "DOWN_ARROW", "RET"):
        yield from key(name)
        yield 0.2
    screenshot("list_of_sensors_after")
    yield from until(lambda: about.sequence_sensors == "CAMERA", f"sensors: {about.sequence_sensors}", 5)
    screenshot("settings")


def sequence() -> Iterator[float]:
    """Render the active camera's frames in the background, to the end."""
    scene = bpy.context.scene
    scene.frame_end = min(scene.frame_end, scene.frame_start + FRAMES - 1)
    yield from searched("render sequence of")
    yield from until(lambda: "frames" in told(), "no sequence begins", 20)
    screenshot("sequence_runs")
    # with simulated events Blender never sleeps between them: it would take a core from what renders
    os.setpriority(os.PRIO_PROCESS, 0, 19)
    yield from until(lambda: told().startswith("Done"), "the sequence does not end", SEQUENCE_S)
    os.setpriority(os.PRIO_PROCESS, 0, 0)
    results["sequence"] = told()
    written = sorted((OUT.parent / "first_drive" / "camera").glob("*/*.png"))
    assert len(written) == scene.frame_end - scene.frame_start + 1, written


def points() -> Iterator[float]:
    """Recorded points of four frames; what Blender takes to go to a frame without them is measured before."""
    yield from to(*middle(area("VIEW_3D")))
    yield from key("LEFT_ARROW", shift=True)
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.show_points("INVOKE_DEFAULT", recorded=True, simulated=False)
    shown = lambda: any(o.unisim.kind == "POINTS" and len(o.data.vertices) for o in bpy.context.scene.objects)  # noqa: E731
    yield from until(shown, "no recorded points are shown")
    yield from frames()
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.show_points("INVOKE_DEFAULT", recorded=False, simulated=False)


def frames() -> Iterator[float]:
    """Three frames further, by the arrow key."""
    yield from to(*middle(area("VIEW_3D")))
    for _ in range(3):
        yield from key("RIGHT_ARROW")
        yield 0.6


def solid() -> Iterator[float]:
    """Z, 6: Solid shading."""
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z")
    yield 0.4
    yield from key("NUMPAD_6")
    yield from until(lambda: view()[1].shading.type == "SOLID", "Z 6 does not change the shading", 5)


def steps() -> Iterator[float]:
    """The session."""
    bpy.ops.extensions.package_install_files(
        filepath=str(ARCHIVE), repo="user_default", enable_on_install=True, overwrite=True
    )
    yield 1.0
    begin()
    for name, todo in (
        ("drive_imported", imported),
        ("drive_frames", frames),
        ("drive_points", points),
        ("drive_removed", removed),
        ("drive_moved", moved),
        ("drive_copied", copied),
        ("drive_shifted", shifted),
        ("drive_rendered", rendered),
        ("drive_settings", settings),
        ("drive_sequence", sequence),
        ("drive_solid", solid),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "first_drive")
