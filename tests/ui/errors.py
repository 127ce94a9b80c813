"""Errors as a person meets them: an import without its optional package, a folder above the drive, the preferences.
Run by `run.py`."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
import hands
from hands import click, import_dropped, key, middle, object_named, sidebar, to
from session import OUT, area, inside, redraw, results, screenshot, start, until, view, wait_for_image
from tasks import empty_file, install, seen

COPY, INSTALL = (455, 393), (592, 367)
"""Buttons of the dialog, in pixels of the window from its lower left corner."""
BEFORE = "UNISIM_UI_BEFORE" in os.environ


def import_log(path: Path) -> None:
    """What Blender does where a folder is chosen."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window, area=area("VIEW_3D")):
        bpy.ops.unisim.import_log("INVOKE_DEFAULT", filepath=str(path))


LOG = OUT.parent / "argoverse2" / "7fab2350-7eaf-3b7e-a39d-6937a4c1bede"
REAL = Path(os.environ.get("UNISIM_UI_LOG", LOG))
"""A whole log to import once the package is there."""


def without_package() -> Iterator[float]:
    """A log that needs pyarrow: the sentence stays, is copied, and its button asks before it installs."""
    LOG.mkdir(parents=True)
    (LOG / "city_SE3_egovehicle.feather").write_bytes(b"ARROW1")
    yield from to(*middle(area("VIEW_3D")))
    import_log(LOG)
    yield 2.0
    screenshot("no_package")
    yield from to(300, 300)
    yield 1.0
    screenshot("no_package_mouse_away")
    if BEFORE:
        return
    yield from to(*COPY)
    yield 0.3
    yield from click()
    yield 0.5
    results["copied"] = bpy.context.window_manager.clipboard
    assert "this needs pyarrow" in bpy.context.window_manager.clipboard
    yield from to(*INSTALL)
    yield 0.3
    yield from click()
    yield 1.0
    screenshot("consent_offline")


def installed() -> Iterator[float]:
    """The package is installed, and the log is opened then."""
    bpy.context.preferences.system.use_online_access = True
    yield 0.5
    screenshot("consent")
    yield from key("RET")
    yield 1.5
    screenshot("installing")
    packages = sys.modules["bl_ext.user_default.unisim_blender.process.packages"]
    background = sys.modules["bl_ext.user_default.unisim_blender.process.background"]
    yield from until(lambda: not background.running, "the installation does not end", 300)
    yield 1.0
    task = background.newest[packages.PackageTask]
    results["installation"] = task.text()
    screenshot("installed")
    import_log(REAL)
    yield 8.0
    screenshot("after_installation")
    yield from key("ESC")


def unreadable() -> Iterator[float]:
    """A car is mirrored: the view leaves it out and says so, Check names it; the rest is rendered."""
    empty_file()
    yield 0.5
    yield from import_dropped()
    car = seen(driving=False)
    object_named(car).scale.x = -1.0
    yield from sidebar()
    view()[1].shading.type = "RENDERED"
    redraw()
    yield 6.0
    screenshot("unreadable")
    if not BEFORE:
        yield from wait_for_image()
        screenshot("unreadable_rendered")
        with inside(area("VIEW_3D")):
            bpy.ops.unisim.check("INVOKE_DEFAULT")
        yield from until(lambda: bpy.context.scene.unisim_check.state, "the check does not end")
        texts = [item.text for item in bpy.context.scene.unisim_check.warnings if item.name == car]
        results["check"] = texts
        assert any("views leave it out" in text for text in texts), texts
    view()[2].view_perspective = "ORTHO"
    redraw()
    yield 3.0
    screenshot("orthographic")


def failed_task() -> Iterator[float]:
    """A training without torch: the status bar says that it failed, its button why, with a button for the interpreter."""
    background = sys.modules["bl_ext.user_default.unisim_blender.process.background"]
    yield from to(*middle(area("VIEW_3D")))
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.train("EXEC_DEFAULT", directory=str(OUT.parent / "trained"))
    yield from until(lambda: not background.running, "the task does not end", 120)
    yield 1.0
    screenshot("failed_task")
    (task,) = background.newest.values()
    assert task.remedy == "interpreter", task.words
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.show_problem("INVOKE_DEFAULT", title=task.title, text=task.problem, remedy=task.remedy)
    yield 1.0
    screenshot("failed_task_dialog")
    yield from key("ESC")


def preferences() -> Iterator[float]:
    """The add-on's preferences, to their end."""
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=area("VIEW_3D")):
        bpy.ops.screen.userpref_show("INVOKE_DEFAULT", section="ADDONS")
    yield 1.0
    bpy.ops.preferences.addon_show(module="bl_ext.user_default.unisim_blender")
    yield 2.0
    screenshot("preferences")
    hands.window[0] = 1
    yield from to(350, 200)
    for number in range(3):
        for _ in range(12):
            yield from key("WHEELDOWNMOUSE")
        yield 0.5
        screenshot(f"preferences_{number}")
    hands.window[0] = 0


def steps() -> Iterator[float]:
    """The session."""
    yield from install()
    empty_file()
    yield 0.5
    yield from without_package()
    if not BEFORE and "UNISIM_UI_LOG" in os.environ:
        yield from installed()
    else:
        yield from key("ESC")
    yield from unreadable()
    if not BEFORE:
        yield from failed_task()
    yield from preferences()


if __name__ == "__main__":
    start(steps(), "errors")
