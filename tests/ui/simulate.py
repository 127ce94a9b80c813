"""The panel Simulate with mouse and keys: settings, a rollout, its scores, opened, and driven on from. Run by `run.py`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from buttons import CROSS, open_panel, place_of, press, typed
from edit_panel import module, picked
from hands import key, middle, object_named, to
from session import OUT, area, from_behind, redraw, screenshot, start, until, view
from tasks import imported, seen, task, told

FOLDER = OUT.parent / "rollouts"
names: dict[str, str] = {}
"""Names of the scenes and of the car that is moved."""


def settings() -> Iterator[float]:
    """The panel is opened, seed and delay are typed, and undone once."""
    about = bpy.context.scene.unisim_simulation
    yield from open_panel("Simulate", "unisim_simulation.seed", 0.75)
    yield from typed("unisim_simulation.seed", "3")
    yield from until(lambda: bpy.context.scene.unisim_simulation.seed == 3, "the seed is not taken over", 10)
    yield from typed("unisim_simulation.delay_s", "0.1")
    about = bpy.context.scene.unisim_simulation
    assert abs(about.delay_s - 0.1) < 1e-6, about.delay_s
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z", ctrl=True)
    yield from until(
        lambda: abs(bpy.context.scene.unisim_simulation.delay_s) < 1e-6, "Ctrl-Z does not take the delay back", 10
    )
    assert bpy.context.scene.unisim_simulation.seed == 3
    screenshot("simulate_panel")


def prepared(seconds: float) -> None:
    """A short rollout of small images."""
    scene = bpy.context.scene
    about = scene.unisim_simulation
    about.out, about.choice, about.others.kind_of_others = str(FOLDER), "idm", "idm"
    about.ends, about.duration_s = True, seconds
    scene.unisim.quality, scene.unisim.sequence_width, scene.unisim.sequence_sensors = "fast", 96, "CAMERA"


def run() -> Iterator[float]:
    """Simulate, cancelled and pressed again; the scores are in the panel."""
    prepared(1.0)
    yield from press("unisim.simulate()")
    yield from until(lambda: "steps" in told(), f"no progress is shown: {told()}", 60)
    screenshot("simulate_running")
    yield from press("unisim.cancel_task()", columns=(CROSS,))
    yield from until(lambda: told().startswith(("Stopped at", "Done")), f"Cancel is not answered: {told()}", 60)
    yield 1.0
    yield from press("unisim.simulate()")
    yield from until(lambda: told().startswith("Done"), f"the rollout does not end: {told()}", 300)
    yield 1.0
    scene = bpy.context.scene
    folder = Path(scene.unisim_simulation.scored)
    assert [path.name for path in FOLDER.iterdir() if path.is_dir()] == [folder.name], "it was not resumed"
    rows = module("features.simulation.panel").rows_of(scene, folder)
    assert rows, "the panel has no scores"
    yield from place_of("unisim.open_rollout(")
    screenshot("simulate_scores")


def open_it() -> Iterator[float]:
    """Open Rollout beside the drive: a variant, in which everything is as driven, seen from behind."""
    names["first"] = bpy.context.scene.name
    yield from press("unisim.open_rollout(")
    yield from until(lambda: bpy.context.scene.unisim_simulation.rollout, "the rollout is not opened", 120)
    yield 1.0
    scene = bpy.context.scene
    names["opened"] = scene.name
    assert scene.name != names["first"] and scene.unisim_simulation.seed == 3
    scene.frame_set(5)
    found, space, looks = view()
    space.shading.type = "SOLID"
    from_behind(looks)
    redraw()
    yield 1.0
    lines = module("features.simulation.overlay").lines_now(scene)
    assert lines is not None and len(lines.points) > 24, "neither plan nor ghost is drawn"
    screenshot("simulate_opened")
    space.shading.type = "SOLID"
    del found


def drive_on() -> Iterator[float]:
    """A car is moved at a frame, and the simulation goes on from there: as driven before."""
    view()[2].view_perspective = "CAMERA"
    yield 0.5
    names["moved"] = seen(driving=True)
    yield from picked(names["moved"])
    yield from to(*middle(area("VIEW_3D")))
    for pressed in (("G",), ("Y",), ("TWO", "2"), ("RET",)):
        yield from key(*pressed)
    yield from until(lambda: abs(object_named(names["moved"]).location.length - 2.0) < 1e-2, "the car is not moved", 10)
    before = Path(bpy.context.scene.unisim_simulation.scored)
    yield from press("unisim.drive_on()")
    yield from until(
        lambda: (
            Path(bpy.context.scene.unisim_simulation.scored) != before
            and (Path(bpy.context.scene.unisim_simulation.scored) / "scores.json").is_file()
        ),
        f"the simulation does not go on: {told()}",
        300,
    )
    about = bpy.context.scene.unisim_simulation
    folder = Path(about.scored)
    assert about.starts, (about.document, str(before), str(folder))
    first, then = (json.loads((one / "scenario.json").read_text()) for one in (before, folder))
    start_s = then["simulation"]["start_s"]
    tracks = [
        [key for edit in one["edits"] if edit["type"] == "ego" for key in edit["trajectory"] if key["time_s"] < start_s]
        for one in (first, then)
    ]
    assert tracks[0] and tracks[0] == tracks[1], "the vehicle's past is another one"
    screenshot("simulate_drove_on")


def steps() -> Iterator[float]:
    """The session."""
    yield from imported()
    for name, todo in (
        ("simulate_settings", settings),
        ("simulate_run", run),
        ("simulate_open", open_it),
        ("simulate_drive_on", drive_on),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "simulate")
