"""From an empty window to a drive that is seen through its camera: by the menu, and by dropping what a person has at hand.
Run by `run.py`, which leaves a log at `log/`: `UNISIM_UI_LOG`'s, or the procedural street.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from bpy_extras.view3d_utils import location_3d_to_region_2d
from browser import choose_path, menu_entry
from buttons import reports
from hands import drop, key, middle, sidebar, to
from session import OUT, area, results, screenshot, start, until, view
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


def steps() -> Iterator[float]:
    """The session."""
    yield from install()
    yield from task("import_menu", by_menu)
    empty_file()
    yield 1.0
    yield from task("import_drop", partial(by_drop, LOG / "meta" / "gps.json", "drop"))


if __name__ == "__main__":
    start(steps(), "importing")
