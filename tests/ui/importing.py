"""From an empty window to a drive that is seen through its camera: by the menu, and by dropping what a person has at hand.
Run by `run.py`, which leaves a log at `log/`: `UNISIM_UI_LOG`'s, or the procedural street.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from bpy_extras.view3d_utils import location_3d_to_region_2d
from browser import choose_path, menu_entry
from buttons import press, reports
from hands import drop, edits, key, middle, sidebar, to
from session import OUT, area, inside, results, screenshot, start, until, view
from tasks import empty_file, install, task

LOG = OUT.parent / "log"


def arrived() -> Iterator[float]:
    """Let the window go on until the drive is imported and nothing is left to do of it."""
    windows = bpy.context.window_manager.windows

    def ended() -> bool:
        busy = any("import" in operator.bl_idname for window in windows for operator in window.modal_operators)
        return bool(bpy.context.scene.unisim.log) and not busy

    yield from until(ended, f"no import ends: {reports()[-3:]}", 240)
    yield 0.5


def camera_frame() -> tuple[float, float]:
    """Return which parts of the view's width and height, without the sidebar, the camera's frame takes."""
    found, _, looks = view()
    region, side = (next(r for r in found.regions if r.type == kind) for kind in ("WINDOW", "UI"))
    scene = bpy.context.scene
    corners = [scene.camera.matrix_world @ corner for corner in scene.camera.data.view_frame(scene=scene)]
    at = [location_3d_to_region_2d(region, looks, corner) for corner in corners]
    free = region.width - (side.width if side.width > 1 else 0)
    wide, high = (max(p[i] for p in at) - min(p[i] for p in at) for i in (0, 1))
    results["frame"] = [[round(p.x), round(p.y)] for p in at]
    return round(wide / free, 2), round(high / region.height, 2)


def seen(name: str) -> Iterator[float]:
    """What a person still has to do until the drive is seen through its camera, as large as the view, with the tab
    UniSim beside it."""
    screenshot(f"{name}_imported")
    results[f"frame_{name}"] = camera_frame()
    yield from to(*middle(area("VIEW_3D")))
    if max(camera_frame()) < 0.9:
        yield from key("HOME")
        yield 0.3
    tabs = next(r for r in area("VIEW_3D").regions if r.type == "UI")
    if not view()[1].show_region_ui or tabs.active_panel_category != "UniSim":
        yield from sidebar()
    results[f"frame_{name}_after"] = camera_frame()


def by_menu() -> Iterator[float]:
    """File, Import, the folder."""
    screenshot("import_empty")
    yield from menu_entry("scenario or roll" if hasattr(bpy.types, "UNISIM_OT_import_drive") else "driving log")
    yield from choose_path(LOG, folder=True)
    yield from arrived()
    yield from seen("menu")


def by_drop(path: Path, name: str) -> Iterator[float]:
    """Drop a file onto an empty window."""
    yield from to(*middle(area("VIEW_3D")))
    drop(path)
    yield from arrived()
    yield from seen(name)


def first_steps() -> Iterator[float]:
    """The buttons of the first steps, ticked one after the other; then they are gone."""
    panel, scene = bpy.types.UNISIM_PT_first_steps, bpy.context.scene
    tabs = next(r for r in area("VIEW_3D").regions if r.type == "UI")
    assert tabs.active_panel_category == "UniSim" and max(camera_frame()) > 0.9
    yield from press("view3d.toggle_shading(")
    yield from until(lambda: view()[1].shading.type == "RENDERED", "the first step does not change the shading", 10)
    yield from until(lambda: scene.unisim.done_steps == "VIEW", f"done: {scene.unisim.done_steps}", 10)
    yield from press("unisim.insert_actor(")
    yield 1.0
    screenshot("first_steps_insert")
    yield from key("RET")
    yield from until(lambda: "EDIT" in scene.unisim.done_steps, f"done: {scene.unisim.done_steps}", 30)
    screenshot("first_steps_ticked")
    with inside(area("VIEW_3D")):
        assert panel.poll(bpy.context)
    view()[1].shading.type = "SOLID"
    yield from press("render.render(")
    yield from until(lambda: not bpy.app.is_job_running("RENDER") and len(windows()) > 1, "nothing is rendered", 240)
    bpy.context.window_manager.windows[0].workspace.status_text_set(None)
    with bpy.context.temp_override(window=windows()[-1]):
        bpy.ops.wm.window_close()
    yield from until(lambda: not scene.unisim.first_steps, f"done: {scene.unisim.done_steps}", 30)
    with inside(area("VIEW_3D")):
        assert not panel.poll(bpy.context)


def windows() -> Any:
    """Return Blender's windows."""
    return bpy.context.window_manager.windows


def closed_stays_closed() -> Iterator[float]:
    """N closes the sidebar; the import into another scene of the file leaves it closed and shows no first steps."""
    yield from to(*middle(area("VIEW_3D")))
    yield from key("N")
    yield from until(lambda: not view()[1].show_region_ui, "N does not close the sidebar", 5)
    with inside(area("VIEW_3D")):
        bpy.ops.scene.new(type="EMPTY")
    yield 0.5
    drop(next(LOG.rglob("timestamps.json")))
    yield from arrived()
    assert not view()[1].show_region_ui and not bpy.context.scene.unisim.first_steps
    wide, high = camera_frame()
    assert max(wide, high) > 0.9, (wide, high)


def one_of_several() -> Iterator[float]:
    """A folder with two drives asks which; Enter takes the one under the mouse."""
    empty_file()
    yield 1.0
    for name in ("a", "b"):
        with suppress(FileExistsError):
            (OUT.parent / "several" / name).parent.mkdir(exist_ok=True)
            (OUT.parent / "several" / name).symlink_to(LOG)
    yield from to(*middle(area("VIEW_3D")))
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.import_drive("INVOKE_DEFAULT", filepath=str(OUT.parent / "several"))
    yield 0.5
    screenshot("import_choices")
    yield from key("DOWN_ARROW")
    yield from key("RET")
    yield from arrived()
    assert Path(bpy.context.scene.unisim.log).parent == OUT.parent / "several"


def fewer_sensors() -> Iterator[float]:
    """Imported Sensors: the dialog, and what it leaves."""
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.import_sensors("INVOKE_DEFAULT")
    yield 0.5
    screenshot("import_sensors_dialog")
    yield from key("ESC")
    yield 0.3
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.import_sensors("EXEC_DEFAULT", sensors={"front_camera"})
    yield from until(lambda: not any(o.unisim.kind == "LIDAR" for o in bpy.context.scene.objects), "sensors stay", 60)
    yield from arrived()
    scene = bpy.context.scene
    assert not edits()
    assert [o.unisim.uid for o in scene.objects if o.unisim.kind == "CAMERA"] == ["front_camera"]


def steps() -> Iterator[float]:
    """The session."""
    yield from install()
    yield from task("import_menu", by_menu)
    empty_file()
    yield 1.0
    yield from sidebar()
    screenshot("import_empty_tab")
    view()[1].show_region_ui = False
    yield 0.5
    yield from task("import_drop", partial(by_drop, next(LOG.rglob("timestamps.json")), "drop"))
    if hasattr(bpy.types, "UNISIM_OT_import_drive"):
        for todo in (first_steps, closed_stays_closed, one_of_several, fewer_sensors):
            yield from task(f"import_{todo.__name__}", todo)


if __name__ == "__main__":
    start(steps(), "importing")
