"""What users expect of a finished extension: F1, results of a sequence, progress in the status bar, saved
warnings, German.

Run by `run.py`.
"""

from __future__ import annotations

import sys
import webbrowser
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlparse
from urllib.request import url2pathname

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from buttons import found_at, place_of, reports
from hands import click, import_dropped, key, middle, object_named, sidebar, to
from heart import uncounted
from numpy.typing import NDArray
from pixels import grab, part, region_rectangle
from session import ARCHIVE, MODULE, OUT, area, inside, results, screenshot, start, until
from tasks import begin, empty_file, open_file, save_file, task, told

OPENINGS = 20
"""How often a file is opened while a task runs."""
GERMAN = {
    "Check Edits": "Änderungen prüfen",
    "Render Sequence": "Sequenz rendern",
    "Shift Actor": "Akteur verschieben",
}
"""Texts of buttons and menus."""
looked_up: list[str] = []
"""What F1 asked the manual for."""
opened: list[str] = []
"""Addresses that a browser was to open."""


def intercept() -> None:
    """Note what F1 looks up and what a browser is to open; nothing is opened."""
    import bl_operators.wm as wm

    find = wm.WM_OT_doc_view_manual._find_reference

    def noted(rna_id: str, *rest: Any, **more: Any) -> Any:
        if not looked_up or looked_up[-1] != rna_id.lower():
            looked_up.append(rna_id.lower())
        return find(rna_id, *rest, **more)

    wm.WM_OT_doc_view_manual._find_reference = staticmethod(noted)
    webbrowser.open = lambda url, *_, **__: bool(opened.append(url)) or True  # type: ignore[func-returns-value]


def point(operator: str, across: float = 0.5) -> Iterator[float]:
    """Move the mouse onto an operator's button in the sidebar; ``across``: how far to the right it is looked for."""
    yield from place_of(f"unisim.{operator}(", columns=(across,))
    yield from to(*found_at[0])
    yield 0.1


def first_import() -> Iterator[float]:
    """The sample's drive, and the tab UniSim."""
    yield from import_dropped()
    yield 0.5
    yield from sidebar()
    yield 0.3


def manual() -> Iterator[float]:
    """F1 on a button opens the section that describes it, from the disk."""
    yield from point("render_sequence")
    yield from key("F1")
    yield from until(lambda: opened, "F1 opens nothing", 10)
    assert opened, "F1 opens nothing"
    path = Path(url2pathname(urlparse(opened[-1]).path))
    assert opened[-1].startswith("file:///") and path.is_file(), opened[-1]
    assert 'id="sequences"' in path.with_name("index.html").read_text() and "#sequences" in path.read_text()
    results["manual"] = opened[-1]


def checked() -> Iterator[float]:
    """Warnings of Check Edits are saved with the file, are marked after an edit, and lead to the place."""
    scene = bpy.context.scene
    car = next(o for o in scene.objects if o.unisim.kind == "ACTOR" and o.parent is None and "Car" in o.name).name
    object_named(car).location.z += 2.0
    bpy.ops.ed.undo_push(message="A car in the air")
    yield 0.3
    yield from point("check")
    yield from click()
    yield from until(lambda: any(w.name == car for w in bpy.context.scene.unisim_check.warnings), "nothing is found")
    yield 0.8
    screenshot("checked_now")
    file = OUT.parent / "checked.blend"
    save_file(file)
    empty_file()
    yield 0.5
    open_file(file)
    yield 1.5
    assert any(w.name == car for w in bpy.context.scene.unisim_check.warnings), "warnings are lost with the file"
    outdated = sys.modules[f"{MODULE}.features.check"].is_outdated
    assert not outdated(bpy.context.scene), "warnings count as outdated though nothing was edited"
    yield from sidebar()
    scene = bpy.context.scene
    scene.frame_set(5)
    yield from point("go_to")
    for other in bpy.context.selected_objects:
        other.select_set(False)
    yield from click()
    yield from until(lambda: object_named(car).select_get(), "a click on the warning does not select the car")
    warning = next(w for w in bpy.context.scene.unisim_check.warnings if w.name == car)
    assert bpy.context.scene.frame_current == warning.frame
    object_named(car).location.x += 1.0
    bpy.ops.ed.undo_push(message="Moved on")
    yield from until(lambda: outdated(bpy.context.scene), "an edit does not mark the warnings", 5)
    yield 0.5
    screenshot("checked_outdated")
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z", ctrl=True)
    yield from until(lambda: not outdated(bpy.context.scene), "undo does not take the mark away", 5)
    object_named(car).location.z -= 2.0


def begin_sequence(name: str, last: int, quality: str, sensors: str, width: int) -> None:
    """Start a sequence into a folder."""
    scene = bpy.context.scene
    scene.unisim.out, scene.frame_start, scene.frame_end = str(OUT.parent / name), 0, last
    scene.unisim.quality, scene.unisim.sequence_sensors, scene.unisim.sequence_width = quality, sensors, width
    with inside(area("VIEW_3D")):
        assert bpy.ops.unisim.render_sequence() == {"FINISHED"}


def played() -> Iterator[float]:
    """A short sequence: progress in the status bar; then its folder is opened and its images are played, by mouse."""
    running: Callable[[], int] = sys.modules[f"{MODULE}.process.background"].running.__len__
    assert not bpy.ops.unisim.play_result.poll(), "Play Result is not grey before there are results"
    begin_sequence("short", 5, "fast", "CAMERA", 240)
    yield from until(lambda: "frames" in told(), "no progress is told")
    yield 0.7
    screenshot("status_bar_begun")
    yield from until(lambda: "left" in told(), "no progress is told", 300)
    screenshot("status_bar")
    yield from until(lambda: not running(), "the sequence does not end", 300)
    yield 1.2
    assert "Done" in told(), told()
    with inside(area("VIEW_3D")):
        assert bpy.ops.unisim.play_result.poll(), "Play Result stays grey"
    results_module = sys.modules[f"{MODULE}.features.output.operators"]
    player, started = results_module.subprocess.Popen, []
    import bl_operators.wm as wm

    folders: list[str] = []
    execute = wm.WM_OT_path_open.execute

    def noted_folder(self: Any, _: Any) -> set[str]:
        folders.append(self.filepath)
        return {"FINISHED"}

    wm.WM_OT_path_open.execute = noted_folder

    def noted(command: list[str], **more: Any) -> Any:
        process = player(command, **more)
        if command[0] == bpy.app.binary_path:  # and no screenshot
            started.append(process)
        return process

    results_module.subprocess.Popen = noted
    try:
        yield from point("open_output", 0.3)
        screenshot("results")
        yield from click()
        yield from until(lambda: folders == [str(OUT.parent / "short")], "the folder is not opened")
        yield from point("play_result", 0.7)
        yield from click()
        yield from until(lambda: started, "nothing is played", 10)
        yield 4.0
        screenshot("playing")
        assert started[0].poll() is None, "the player ended at once"
    finally:
        results_module.subprocess.Popen = player
        wm.WM_OT_path_open.execute = execute
        for process in started:
            process.kill()


def opened_often() -> Iterator[float]:
    """Files are opened again and again while a sequence runs; its progress stays, with what it belongs to."""
    files = [OUT.parent / name for name in ("often_a.blend", "often_b.blend")]
    for file in files:
        save_file(file)
    begin_sequence("often", 19, "fine", "ALL", 0)
    running = sys.modules[f"{MODULE}.process.background"].running
    yield from until(lambda: "of 20" in told(), "no progress is told")
    for number in range(OPENINGS):
        open_file(files[number % 2])
        yield 0.6
        assert running or "Done" in told()
        results["openings"] = number + 1
    assert running, "the sequence ended before all files were opened: give it more frames"
    empty_file()
    yield 1.0
    screenshot("other_file")
    assert "often_b.blend" in sys.modules[f"{MODULE}.process.background"].what_runs()
    open_file(files[0])
    yield 1.0
    looked_up.clear()
    yield from to(
        bpy.context.window_manager.windows[0].width - 17, 11
    )  # the cross beside the progress, in the status bar
    yield from key("F1")
    yield from until(lambda: "bpy.ops.unisim.cancel_task" in looked_up, "no cross in the status bar", 5)
    screenshot("running")
    yield from click()
    yield from until(lambda: "Stopped at" in told(), "Cancel is not answered", 60)


def german() -> Iterator[float]:
    """Panels and menus in German, and what an operator reports; English again afterwards."""
    yield from point("check")
    x, y = found_at[0]
    yield from to(*middle(area("VIEW_3D")))
    yield 0.5
    view_, text = bpy.context.preferences.view, bpy.app.translations.pgettext_iface
    english = button_pixels(x, y, "english")
    assert text("Check Edits") == "Check Edits"
    view_.language = "de_DE"
    view_.use_translate_interface = view_.use_translate_tooltips = view_.use_translate_reports = True
    yield 1.0
    screenshot("german")
    told = {english_text: (text(english_text), text(english_text, "Operator")) for english_text in GERMAN}
    assert told == {english_text: (german_text,) * 2 for english_text, german_text in GERMAN.items()}, told
    results["german_button"] = float((np.abs(button_pixels(x, y, "german_button") - english) > 0.1).mean())
    assert results["german_button"] > 0.01, "the button Check Edits looks as in English"  # type: ignore[operator]
    yield from point("check")  # the panels are drawn to their end
    yield from click()
    yield from until(lambda: any("Warnungen" in line for line in reports()), "no report in German", 60)
    yield from to(*middle(area("VIEW_3D")))
    with inside(area("VIEW_3D")):
        bpy.ops.wm.call_menu(name="UNISIM_MT_object")
    yield 0.7
    screenshot("german_menu")
    yield from key("ESC")
    view_.language = "en_US"
    yield 0.5
    assert text("Check Edits") == "Check Edits"


@uncounted
def button_pixels(x: float, y: float, name: str) -> NDArray[np.float32]:
    """What the window shows of the button in the sidebar at a place, (H, W, 3) from 0 to 1."""
    left, bottom, width, height = region_rectangle("UI")
    screen = grab()
    return np.asarray(part(screen, (left + 20, int(y) - 8, width - 60, 16)), np.float32) / 255


def steps() -> Iterator[float]:
    """The session."""
    intercept()
    bpy.ops.extensions.package_install_files(
        filepath=str(ARCHIVE), repo="user_default", enable_on_install=True, overwrite=True
    )
    yield 1.0
    begin()
    for name, todo in (
        ("finish_import", first_import),
        ("manual", manual),
        ("checked", checked),
        ("played", played),
        ("opened_often", opened_often),
        ("german", german),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "finish")
