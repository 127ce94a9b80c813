"""A log without a trained scene, from Rendered shading to the finished image: the recorded image, a preliminary one, Esc,
and resumed. Run by `run.py`; `UNISIM_UI_SCENE` names a folder whose scene.json names another log."""

from __future__ import annotations

import json
import os
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from compare import shown
from hands import key, middle, to
from session import MODULE, OUT, SCENE, area, inside, results, screenshot, start, until, view
from tasks import arrived, install, task

LOG = Path(os.path.normpath(SCENE.parent / json.loads(SCENE.read_text())["log"]["path"]))
FIRST_S = float(os.environ.get("UNISIM_UI_FIRST_S", "60"))
"""Longest time to a first image."""
FRAME = 5


def preparation() -> Any:
    """The preparation of surfels."""
    return sys.modules[f"{MODULE}.process.preparation"].PREPARATION


def log_imported() -> Iterator[float]:
    """Import the log alone, with an empty cache."""
    yield from install()
    with inside(area("VIEW_3D")):
        bpy.ops.unisim.import_log("INVOKE_DEFAULT", filepath=str(LOG))
    yield from arrived()
    bpy.context.scene.frame_set(FRAME)
    view()[2].view_perspective = "CAMERA"
    yield 1.0
    shutil.rmtree(Path(os.environ["UNISIM_CACHE"]) / "surfels", ignore_errors=True)


def first_image() -> Iterator[float]:
    """Z 8: the recorded image at once, a preliminary one a few seconds later."""
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z")
    yield 0.4
    yield from key("NUMPAD_8")
    begun = time.monotonic()
    yield from until(lambda: shown() is not None and shown().stands_in, "nothing stands in", 10)
    yield from until(lambda: shown().comparison.has_recorded, "the recorded image is not shown", 20)
    results["recorded_s"] = time.monotonic() - begun
    yield 0.5
    assert shown().stands_in and shown().comparison.mode == "RECORDED"
    screenshot("stands_in")
    yield from until(lambda: preparation().first or 0 > 0.3, "no progress", 60)
    yield 0.3
    screenshot("stands_in_later")
    yield from until(lambda: shown().preliminary and not shown().fresh, "no preliminary image", 240)
    results["first_s"] = time.monotonic() - begun
    yield from until(lambda: not shown().pending, "the preliminary image is not finished", 60)
    assert shown().srgb.std() > 10 and not shown().stands_in
    yield from until(lambda: "left" in preparation().text, "no time left is estimated", 120)
    yield 1.1
    assert preparation().active


def other_frame() -> Iterator[float]:
    """Another frame near: its preliminary image, although all is being prepared."""
    before = shown().srgb.copy()
    bpy.context.scene.frame_set(FRAME + 1)
    yield from until(lambda: not shown().pending and (shown().srgb != before).any(), "the view stays", 60)
    assert shown().preliminary and preparation().active


def stopped() -> Iterator[float]:
    """Esc over the view: the recorded image again, and nothing is prepared; then resumed."""
    yield from to(*middle(area("VIEW_3D")))
    yield from key("ESC")
    yield from until(lambda: shown().stands_in and not preparation().active, "Esc stops nothing", 10)
    yield from until(lambda: shown().comparison.has_recorded, "the recorded image is not shown", 20)
    yield 1.0
    share = preparation().share
    screenshot("stopped_by_esc")
    yield 2.0
    assert preparation().share == share and shown().comparison.mode == "RECORDED"
    bpy.ops.unisim.resume_preparation()
    yield from until(lambda: shown().preliminary and not shown().pending, "it does not go on", 60)
    yield from until(lambda: preparation().share > 0, "it does not go on", 60)
    results["shares"] = share, preparation().share
    assert preparation().share >= share, "it begins anew"


def finished() -> Iterator[float]:
    """Wait for the finished image: not labelled, and what F12 has."""
    begun = time.monotonic()
    yield from until(lambda: preparation().finished, "it does not end", 900)
    results["prepared_s"] = time.monotonic() - begun
    preliminary = shown().srgb.copy()
    yield from until(lambda: not shown().preliminary and not shown().pending, "the image is not refined", 60)
    assert (shown().srgb != preliminary).any() and not shown().stands_in and not preparation().active
    results["preliminary_apart"] = float(np.abs(shown().srgb.astype(float) - preliminary).mean())


def steps() -> Iterator[float]:
    """The tasks, one after the other."""
    for todo in (log_imported, first_image, other_frame, stopped, finished):
        yield from task(todo.__name__, todo)
    assert float(str(results["first_s"])) <= FIRST_S, results["first_s"]


os.environ["UNISIM_CACHE"] = str(OUT.parent / "first_image_cache")
start(steps(), "first_image")
