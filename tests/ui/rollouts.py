"""Rollouts opened, opened again and compared, and a task that runs while another file is open. Run by `run.py`."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from buttons import open_panel, press
from hands import middle, to
from heart import heart
from session import area, results, start, until, view, wait_for_image
from simulate import prepared, told
from tasks import imported, task

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


def steps() -> Iterator[float]:
    """The session."""
    yield from imported()
    for name, todo in (
        ("rollouts_simulated", simulated),
        ("rollouts_opened", opened),
        ("rollouts_opened_again", opened_again),
    ):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "rollouts")
