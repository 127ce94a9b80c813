"""The procedural street in every layout of logs that is read, dropped onto the window and looked at. Run by `run.py`.

`run.py` leaves beside this file `layouts/`, the logs and `truth.json` (see tests/support/street_layouts.py), and
`packages/`, what some layouts need that Blender's Python does not have.
"""

from __future__ import annotations

import importlib
import json
import shutil
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from buttons import reports
from hands import drop, key, middle, to
from session import MODULE, OUT, area, choose, results, screenshot, start, until, view, wait_for_image
from tasks import empty_file, install, task

LOGS, PACKAGES = OUT.parent / "layouts", OUT.parent / "packages"
TRUTH: dict[str, dict[str, Any]] = json.loads((LOGS / "truth.json").read_text())
NEEDS = {"argoverse2": "pyarrow", "waymo": "pyarrow", "ncore": "ncore"}
"""The package that a layout needs beside those of the extension."""
WITH = {"ncore": ("numcodecs", "scipy")}
"""Compiled packages that this one needs, where not every Python has them."""
IMPORT_S = 240.0


def dropped(name: str) -> None:
    """Drop one of a log's files onto the view."""
    drop(LOGS / TRUTH[name]["dropped"])


def said(words: str) -> list[str]:
    """What operators reported that has these words in it."""
    return [line for line in reports() if words in line and not line.startswith("bpy.")]


def refused(name: str) -> Iterator[float]:
    """A log whose package Blender's Python lacks: one sentence that says what to install, and nothing comes in."""
    empty_file()
    yield 0.5
    yield from to(*middle(area("VIEW_3D")))
    before = [obj.name for obj in bpy.data.objects]
    dropped(name)
    words = f"this needs {NEEDS[name]}, which Blender's Python does not have: install it in Preferences"
    yield from until(lambda: said(words), f"nobody says that {NEEDS[name]} is needed", 60)
    (sentence,) = said(words)[-1:]
    assert str(LOGS / name) in sentence, sentence
    assert [obj.name for obj in bpy.data.objects] == before and not bpy.context.scene.unisim.log
    results[f"refused_{name}"] = sentence
    yield 0.5
    yield from key("ESC")


def with_packages() -> Iterator[float]:
    """Put packages where the sentence says. Blender would look there when it starts again."""
    folder = sys.modules[f"{MODULE}.process.interpreters"].MODULES
    shutil.copytree(PACKAGES, folder, dirs_exist_ok=True)
    sys.path.append(str(folder))
    importlib.invalidate_caches()  # that there was no such folder is remembered
    yield 0.1


def imported(name: str) -> Iterator[float]:
    """Drop a log, wait until it is imported; everything is set, boxes are where the street's things are, frame by frame."""
    empty_file()
    yield 0.5
    yield from to(*middle(area("VIEW_3D")))
    dropped(name)
    scene, truth = bpy.context.scene, TRUTH[name]
    yield from until(
        lambda: scene.render.engine == "UNISIM" and scene.camera.unisim.kind == "CAMERA",
        f"the import does not end: {reports()[-3:]}",
        IMPORT_S,
    )
    yield 0.5
    told = said("Imported ")
    assert told, reports()[-5:]
    results[f"said_{name}"] = told[-1]
    counts = {kind: [o for o in scene.objects if o.unisim.kind == kind] for kind in ("CAMERA", "LIDAR", "ACTOR")}
    assert {o.unisim.uid for o in counts["CAMERA"]} == set(truth["cameras"])
    assert counts["LIDAR"] and len(counts["ACTOR"]) > 10
    assert f"{len(truth['boxes'])} frames" in told[-1] and f"{len(counts['ACTOR'])} actors" in told[-1], told[-1]
    assert (scene.frame_start, scene.frame_end) == (0, len(truth["boxes"]) - 1)
    size = [scene.render.resolution_x, scene.render.resolution_y]
    assert size == truth["cameras"][scene.camera.unisim.uid], size
    assert view()[2].view_perspective == "CAMERA"
    yield from to(*middle(area("VIEW_3D")))
    for frame, boxes in enumerate(truth["boxes"]):
        yield from until(partial(at_frame, frame), f"frame {frame} is not shown", 20)
        compare(name, frame, boxes)
        if frame < scene.frame_end:
            yield from key("RIGHT_ARROW")
            yield 0.2
    yield from key("LEFT_ARROW", shift=True)
    yield from until(partial(at_frame, scene.frame_start), "Shift-left does not go to the first frame", 20)
    yield from key("HOME")  # as large as the view
    yield 0.5
    screenshot(f"street_{name}_solid")


def at_frame(frame: int) -> bool:
    """Whether a frame is shown."""
    return bool(bpy.context.scene.frame_current == frame)


def compare(name: str, frame: int, boxes: dict[str, list[float]]) -> None:
    """Fail where a box that is shown is none of the street's things."""
    true = np.array(list(boxes.values()))
    shown = [o for o in bpy.context.scene.objects if o.unisim.kind == "ACTOR" and o.visible_get()]
    away = [np.linalg.norm(true - np.array(o.matrix_world.translation), axis=1).min() for o in shown]
    furthest = results.setdefault("boxes_off_m", {})
    assert isinstance(furthest, dict)
    furthest[name] = round(max(furthest.get(name, 0.0), *map(float, away)), 4)
    assert furthest[name] < TRUTH[name]["box_m"], (name, frame, furthest)


def rendered(name: str) -> Iterator[float]:
    """Z, 8: what the sweeps show, without a trained scene."""
    yield from to(*middle(area("VIEW_3D")))
    yield from key("Z")
    yield 0.4
    yield from key("NUMPAD_8")
    yield from until(lambda: view()[1].shading.type == "RENDERED", "Z 8 does not change the shading", 5)
    yield from wait_for_image(400.0)
    yield 0.5
    screenshot(f"street_{name}_rendered")
    view()[1].shading.type = "SOLID"
    yield 0.3


def bent(name: str, camera: str) -> Iterator[float]:
    """Look through a camera whose lens bends lines (Ctrl-Numpad 0): outlines lie on the recorded image, and it is said that
    Blender's boxes do not; then what is rendered through it."""
    choose(next(o for o in bpy.context.scene.objects if o.unisim.uid == camera))
    yield 0.2
    yield from to(*middle(area("VIEW_3D")))
    yield from key("NUMPAD_0", ctrl=True)
    yield from until(lambda: bpy.context.scene.camera.unisim.uid == camera, "Ctrl-Numpad 0 does nothing", 20)
    car = next(o for o in bpy.context.scene.objects if o.unisim.kind == "ACTOR" and o.visible_get())
    choose(car)
    yield 1.0
    notices = sys.modules[f"{MODULE}.viewport.notice_text"].notices
    source = sys.modules[f"{MODULE}.bridge.objects.imported"].source_of(bpy.context.scene)
    lines = [str(line) for line in notices(bpy.context.scene, source, bpy.context.scene.camera)]
    assert len(lines) == 1 and "outlines and images follow it" in lines[0], lines
    assert view()[1].show_object_viewport_camera, "the recorded image is hidden"
    outlines = sys.modules[f"{MODULE}.viewport.overlays"].outlines(bpy.context.scene, bpy.context.view_layer)
    assert sum(len(segments) for segments, _ in outlines) > 100
    screenshot(f"lens_{name}_solid")
    yield from rendered(f"{name}_{camera}")


def steps() -> Iterator[float]:
    """The session."""
    yield from install()
    todo: list[tuple[str, Callable[[], Iterator[float]]]] = [
        ("layout_refused_argoverse2", partial(refused, "argoverse2")),
        ("layout_refused_ncore", partial(refused, "ncore")),
        ("layout_packages", with_packages),
    ]
    for name, truth in TRUTH.items():
        needed = (NEEDS[name], *WITH.get(name, ())) if name in NEEDS else ()
        if lacking := [package for package in needed if not (PACKAGES / package).is_dir()]:
            results[f"lacks_{name}"] = lacking  # there is none for this Python
            continue
        todo.append((f"layout_{name}", partial(imported, name)))
        todo.append((f"layout_{name}_rendered", partial(rendered, name)))
        todo += [(f"layout_{name}_{camera}", partial(bent, name, camera)) for camera in truth["bends"][:1]]
    for name, one in todo:
        yield from task(name, one)


if __name__ == "__main__":
    start(steps(), "layouts")
