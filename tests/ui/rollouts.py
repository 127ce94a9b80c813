"""Rollouts opened, opened again and compared, and a task that runs while another file is open. Run by `run.py`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from buttons import found_at, open_panel, place_of, press
from edit_panel import module
from hands import click, key, middle, mouse, sidebar, to
from heart import heart
from session import OUT, area, inside, results, screenshot, start, until, view, wait_for_image
from simulate import prepared
from tasks import empty_file, imported, open_file, save_file, task, told

names: dict[str, str] = {}
"""Names of the scenes."""


def simulated() -> Iterator[float]:
    """A short rollout, from the panel."""
    names["first"] = bpy.context.scene.name
    yield from open_panel("Simulate", "unisim_simulation.seed", 0.75)
    prepared(0.6)
    yield from press("unisim.simulate()")
    yield from until(lambda: told().startswith("Done"), f"the rollout does not end: {told()}", 300)


def opened() -> Iterator[float]:
    """Open Rollout beside the drive, for the first time, in a view with Rendered shading."""
    view()[1].shading.type = "RENDERED"
    yield from wait_for_image()
    heart.begin()
    yield from press("unisim.open_rollout(")
    yield from until(lambda: bpy.context.scene.unisim_simulation.rollout, "the rollout is not opened", 120)
    yield 3.0
    names["opened"] = bpy.context.scene.name


def opened_again() -> Iterator[float]:
    """Open Rollout in the scene that it was opened from: the scene that is there is shown."""
    yield from to(*middle(area("VIEW_3D")))
    bpy.context.window.scene = bpy.data.scenes[names["first"]]
    yield 1.0
    yield from press("unisim.open_rollout(")
    yield from until(lambda: bpy.context.scene.unisim_simulation.rollout, "the rollout is not opened", 120)
    yield 3.0
    results["scenes"] = [scene.name for scene in bpy.data.scenes]
    assert results["scenes"] == [names["first"], names["opened"]]


def at_work(limit_s: float = 300.0) -> Iterator[float]:
    """Wait until the task that was just begun has ended well."""
    running = module("process.background").running
    yield from until(lambda: running, "no task begins", 60)
    yield from until(lambda: not running, f"the task does not end: {told()}", limit_s)
    assert told().startswith("Done"), told()
    yield 1.0


def compared() -> Iterator[float]:
    """A second rollout, of the first one's scene, and Compare Rollouts: a tooltip, an order, a cross, one opened."""
    bpy.context.scene.unisim_simulation.choice = "constant"
    yield from press("unisim.simulate()")
    yield from at_work()
    folders = sorted(path.name for path in (OUT.parent / "rollouts").iterdir() if path.is_dir())
    assert folders == ["Scene constant 1", "Scene idm 1"], folders
    yield from press("unisim.compare_rollouts")
    yield 2.0
    x, y = mouse
    for aside in (-90, -100):
        yield from to(x + aside, y - 9)
        yield 2.0
    screenshot("rollouts_compared_tooltip")
    yield from click()
    yield 2.0
    screenshot("rollouts_compared_sorted")
    yield from to(x - 690, y - 61)  # the name of the second row
    yield 1.0
    yield from click()
    yield from until(
        lambda: bpy.context.scene.unisim_simulation.rollout.endswith("Scene idm 1"),
        "a click on a rollout does not open it",
        120,
    )
    yield from key("ESC")
    yield 1.0


def filmed() -> Iterator[float]:
    """A short sequence, then Make Film."""
    scene = bpy.context.scene
    about = scene.unisim
    about.out, about.quality, about.sequence_width, about.sequence_sensors = (
        str(OUT.parent / "filmed"),
        "fast",
        240,
        "ALL",
    )
    scene.frame_start, scene.frame_end = 0, 5
    bpy.context.window_manager.unisim_panels = "RENDER"
    yield 0.5
    yield from place_of("unisim.export_scenario()")
    yield from to(found_at[0][0] - 40, found_at[0][1] - 58)  # the header of Formats
    yield from click()
    yield 2.0
    screenshot("formats")
    yield from press("unisim.render_sequence()")
    yield from at_work()
    yield from press("unisim.make_film", columns=(0.3,))
    yield from at_work()
    results["film"] = told()
    assert module("features.output.operators").film_of(scene) is not None
    screenshot("film_done")


def other_file() -> Iterator[float]:
    """A sequence runs: other panels, another scene and another file say whose it is."""
    about = bpy.context.scene.unisim
    about.out, about.quality, about.sequence_width, about.sequence_sensors = (
        str(OUT.parent / "long"),
        "fine",
        1440,
        "ALL",
    )
    bpy.context.scene.frame_end = 19
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.render_sequence("INVOKE_DEFAULT")
    yield from until(lambda: "frames" in told(), f"no progress is shown: {told()}", 60)
    yield 3.0
    screenshot("task_own")
    save_file(OUT.parent / "street by night.blend")
    empty_file()
    yield 1.0
    yield from sidebar()
    yield 1.0
    screenshot("task_other_file")
    open_file(OUT.parent / "street by night.blend")
    yield 1.0
    yield from press("unisim.render_sequence()")
    yield 1.5
    screenshot("task_grey_button")
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.cancel_task()
    yield from until(lambda: told().startswith("Stopped at"), f"Cancel is not answered: {told()}", 60)


def steps() -> Iterator[float]:
    """The session."""
    yield from imported()
    for name, todo in (
        ("rollouts_simulated", simulated),
        ("rollouts_opened", opened),
        ("rollouts_opened_again", opened_again),
        ("rollouts_compared", compared),
        ("rollouts_filmed", filmed),
        ("rollouts_other_file", other_file),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "rollouts")
