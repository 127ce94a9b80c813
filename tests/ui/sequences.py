"""Sequences rendered from the panel: another file opened meanwhile, and a log without a trained scene.
Run by `run.py`."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from browser import choose_path, menu_entry
from buttons import CROSS, Place, buttons, choose_task, place_of, press, scroll
from hands import key, middle, sidebar, to
from session import OUT, area, screenshot, start, until
from tasks import fresh, imported, task, told

KEPT = OUT.parent / "kept.blend"
SMALL_LOG = OUT.parent / "small"
"""A log of three small frames that no scene is trained on, which `run.py` makes."""


def frames_told() -> int:
    """The number of finished frames that the panel says."""
    found = re.search(r"(\d+) of \d+ frames", told())
    return int(found[1]) if found else -1


def finished(folder: Path) -> int:
    """How many frames a folder has a record of; each has to have every sensor's file. One that was being written when
    the sequence was cancelled has files and no record: it is rendered again."""
    folders = [one for kind in ("camera", "lidar") for one in (folder / kind).glob("*") if one.is_dir()]
    kinds = {"camera": ".png", "lidar": ".ply"}
    there = [{path.stem for path in one.glob(f"*{kinds[one.parent.name]}")} for one in folders]
    recorded = {f"{int(path.stem):02d}" for path in (folder / ".state").glob("*.json")}
    whole = {f"{int(stem):02d}" for stem in set.intersection(*there)} if len(there) == 2 else set()
    assert recorded <= whole, f"frames {sorted(recorded - whole)} are said to be finished and are not whole"
    return len(recorded)


def new_file() -> Iterator[float]:
    """Ctrl-N, General."""
    yield from key("N", ctrl=True)
    yield 0.5
    yield from key("RET")
    yield from until(lambda: not bpy.data.filepath, "no new file", 10)
    yield 1.0
    bpy.context.preferences.view.show_splash = False
    yield from to(*middle(area("VIEW_3D")))


def opened_file() -> Iterator[float]:
    """Another file is opened while a sequence runs: progress and Cancel stay, and the next sequence can begin."""
    yield from fresh()
    out = OUT.parent / "sequence"
    about = bpy.context.scene.unisim
    # slow enough to be cancelled, on a busy machine, too, where the window is slower than what renders
    about.out, about.quality, about.sequence_width = str(out), "fine", 1440
    yield from press("unisim.render_sequence()")
    yield from until(lambda: "frames" in told(), "no progress is shown")
    yield from to(*middle(area("VIEW_3D")))
    yield from key("S", ctrl=True, shift=True)
    yield from choose_path(KEPT)
    yield from until(lambda: Path(bpy.data.filepath) == KEPT, "not saved", 10)
    yield from new_file()
    yield from until(lambda: frames_told() >= 1, "the progress does not go on in another file", 240)
    yield from sidebar()
    screenshot("running_in_another_file")
    yield from press("unisim.cancel_task()", columns=(CROSS,))
    yield from until(lambda: told().startswith("Stopped at"), f"Cancel is not answered: {told()}", 60)
    yield 1.0
    assert frames_told() == finished(out), f"{told()}, but {finished(out)} frames are finished"
    yield from to(*middle(area("VIEW_3D")))
    yield from key("O", ctrl=True)
    yield from choose_path(KEPT)
    yield from until(lambda: Path(bpy.data.filepath) == KEPT, "not opened", 10)
    yield 1.0
    before = frames_told()
    yield from place_of("unisim.cancel_task()", columns=(CROSS,))  # to be found at once when it is needed
    yield from press("unisim.render_sequence()")
    yield from until(lambda: frames_told() > before, f"Render Sequence does not go on: {told()}", 240)
    yield from press("unisim.cancel_task()", columns=(CROSS,))
    yield from until(lambda: told().startswith("Stopped at"), f"Cancel is not answered: {told()}", 60)
    yield 1.0
    assert frames_told() == finished(out), f"{told()}, but {finished(out)} frames are finished"
    screenshot("stopped_sequence")


def log_alone() -> Iterator[float]:
    """File > Import of a log without a trained scene, and its sequence from the panel."""
    yield from new_file()
    yield from menu_entry("scenario or rollout")
    yield from choose_path(SMALL_LOG, folder=True)
    scene = bpy.context.scene
    yield from until(
        lambda: scene.camera is not None and scene.camera.unisim.kind == "CAMERA", "the import does not end"
    )
    yield 0.5
    yield from sidebar()
    assert not scene.unisim.scene
    out = OUT.parent / "surfels"
    scene.unisim.out = str(out)
    yield from press("unisim.render_sequence()")
    wanted = scene.frame_end - scene.frame_start + 1
    # what is told may be of the sequence before, until this one begins
    yield from until(lambda: finished(out) == wanted and told().startswith("Done"), "the sequence does not end", 300)
    assert frames_told() == wanted, f"{told()}, and {wanted} are there"
    screenshot("surfel_sequence")
    yield from to(*middle(area("VIEW_3D")))


def grey_buttons() -> Iterator[float]:
    """With nothing selected, every grey button among the edits says why, in its tooltip."""
    yield from choose_task(("EDIT",))
    found = area("VIEW_3D")
    panel = next(region for region in found.regions if region.type == "UI")
    yield from to(*middle(found))
    yield from key("A", alt=True)
    yield from to(panel.x + 0.04 * panel.width, panel.y + panel.height / 2)
    yield from scroll("HOME")
    grey: dict[str, Place] = {}
    for _ in range(3):
        here: dict[str, list[Place]] = {}
        yield from buttons(found, "UI", here)
        for name, places in here.items():
            if (
                not name.startswith("unisim.") or "(" not in name or name in grey or not places
            ):  # one at the edge has no place
                continue
            operator = getattr(bpy.ops.unisim, name.split("(")[0].removeprefix("unisim."))
            window = bpy.context.window_manager.windows[0]
            with bpy.context.temp_override(window=window, area=found, region=panel):
                if operator.poll():
                    continue
                try:
                    operator()
                except RuntimeError as fault:
                    why = str(fault).split("failed, ", 1)[-1].strip()
            assert "context is incorrect" not in why and len(why) > 10, f"{name} is grey and says {why!r}"
            grey[name] = places[0]
        yield from to(panel.x + panel.width / 2, panel.y + panel.height / 2)
        for _ in range(10):
            yield from key("WHEELDOWNMOUSE")
        yield 0.3
    assert len(grey) >= 4, f"only {list(grey)} are grey"
    yield from place_of("unisim.snap_to_ground()")
    yield 2.0
    screenshot("grey_button")


def steps() -> Iterator[float]:
    """The session."""
    yield from imported()
    yield from task("opened_file", opened_file)
    yield from task("log_alone", log_alone)
    yield from task("grey_buttons", grey_buttons)


if __name__ == "__main__":
    start(steps(), "sequences")
