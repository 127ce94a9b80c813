"""A log without a trained scene, rendered as a sequence by its LiDAR's surfels: to the end, cancelled, and resumed."""

from __future__ import annotations

import json
import threading
import time
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from PIL import Image

from unisim_blender.bridge.objects.imported import imported_objects
from unisim_blender.features.output import operators as results
from unisim_blender.process import background
from unisim_blender.process.tasks import SequenceTask


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache for the log's surfels."""
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def logged(scene: Any, street_log: Path, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """A scene with a log imported, and an output folder."""
    monkeypatch.setenv("UNISIM_CACHE", str(cache))
    assert bpy.ops.unisim.import_log(filepath=str(street_log)) == {"FINISHED"}
    assert not scene.unisim.scene
    scene.unisim.out = str(tmp_path / "out")
    return scene


def cancel_after(frames: int) -> threading.Thread:
    """Press Cancel as soon as so many frames are finished."""

    def wait() -> None:
        until = time.monotonic() + 120
        while time.monotonic() < until:
            if (
                background.running
                and background.running[0].process is not None
                and background.running[0].done >= frames
            ):
                background.running[0].cancel()
                return
            time.sleep(0.005)

    thread = threading.Thread(target=wait, daemon=True)
    thread.start()
    return thread


@pytest.mark.slow
def test_a_log_is_rendered_cancelled_and_resumed(logged: Any, tmp_path: Path) -> None:
    out = tmp_path / "out"
    for number in range(4):  # more to do, so that Cancel comes before the end
        bpy.ops.unisim.add_camera(width=1280, height=720, yaw_deg=90.0 * number)
    pressed = cancel_after(1)
    assert bpy.ops.unisim.render_sequence() == {"FINISHED"}
    pressed.join(10)
    task = background.newest[SequenceTask]
    assert task.line.startswith("Stopped at ") and task.problem == ""
    done = sorted((out / ".state").glob("*.json"))
    assert 1 <= len(done) < 3, "the sequence was at its end before it was cancelled: give it more to do"
    camera = next(imported_objects(logged, "CAMERA")).unisim.uid
    first = out / "camera" / camera / f"{done[0].stem}.png"
    stamp, content = first.stat().st_mtime_ns, first.read_bytes()

    assert bpy.ops.unisim.render_sequence() == {"FINISHED"}
    assert background.newest[SequenceTask].line == "Done: 3 of 3 frames"
    assert first.stat().st_mtime_ns == stamp and first.read_bytes() == content, "a finished frame was rendered again"
    assert json.loads((out / "manifest.json").read_text())["settings"]["renderer"] == "surfel"
    found = results.results_of(logged)
    assert len(found) == 5 and all((frames.first, frames.last, frames.count) == (0, 2, 3) for frames in found.values())
    assert len(list((out / "lidar").glob("*/*.ply"))) == 3
    with Image.open(first) as image:
        assert np.asarray(image.convert("RGB")).std() > 10, "an empty image"


@pytest.mark.slow
def test_an_edit_is_in_the_images(logged: Any, tmp_path: Path) -> None:
    logged.frame_start = logged.frame_end = 1
    logged.unisim.sequence_sensors, logged.unisim.sequence_width = "CAMERA", 96
    shots = []
    for name in ("recorded", "emptied"):
        logged.unisim.out = str(tmp_path / name)
        assert bpy.ops.unisim.render_sequence() == {"FINISHED"}
        (path,) = (tmp_path / name / "camera").glob("*/000001.png")
        with Image.open(path) as image:
            shots.append(np.asarray(image.convert("RGB"), float))
        for actor in list(imported_objects(logged, "ACTOR")):
            bpy.data.objects.remove(actor)
    assert (np.abs(shots[0] - shots[1]).max(-1) > 20).mean() > 0.01
