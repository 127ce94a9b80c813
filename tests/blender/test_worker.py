"""The worker behind its pipe: started when asked, killed, restarted, closed."""

from __future__ import annotations

import os
import queue
import signal
import sys
import sysconfig
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from drive_frames import DriveFrames
from helpers import SAMPLE

from unisim_blender.core.model.scene_file import read_scene_header
from unisim_blender.core.prepare.capture_request import capture_request
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.scenes.recipe import load_backend
from unisim_blender.core.scenes.scene import open_scene
from unisim_blender.process import interpreters
from unisim_blender.process.client import Client, Request

LIMIT_S = 120


@pytest.fixture
def worker() -> Iterator[Client]:
    client = Client(sys.executable)
    yield client
    client.close()
    assert not client.folder.exists()


def last(request: Request) -> dict[str, object]:
    """The event that ends a request."""
    until = time.monotonic() + LIMIT_S
    while time.monotonic() < until:
        try:
            event = request.events.get(timeout=1)
        except queue.Empty:
            continue
        if event["event"] in ("done", "error", "cancelled"):
            return event
    raise AssertionError("no end")


def test_it_says_what_it_is(worker: Client) -> None:
    # fmt: off
    request = worker.ask("about")
    event = request.events.get(timeout=LIMIT_S)
    assert event["event"] == "about" and "cpu" in event["devices"]
    assert last(request)["event"] == "done"


def test_asking_returns_at_once(worker: Client) -> None:
    started = time.monotonic()
    # fmt: off
    request = worker.ask("about")
    assert time.monotonic() - started < 0.1
    last(request)


def test_a_killed_worker_is_a_sentence_and_comes_back(worker: Client) -> None:
    last(worker.ask("about"))
    assert worker.process is not None
    before = worker.process.pid
    os.kill(before, signal.SIGSTOP)
    # fmt: off
    request = worker.ask("about")
    os.kill(before, signal.SIGKILL)
    event = last(request)
    assert event["event"] == "error" and "killed" in str(event["text"])
    assert last(worker.ask("about"))["event"] == "done"
    assert worker.process.pid != before


def test_an_unknown_job_is_a_sentence(worker: Client) -> None:
    assert "another version" in str(last(worker.ask("sing"))["text"])


@pytest.mark.parametrize(
    ("changed", "sentence"),
    [
        ({"state": "no"}, "a state that was sent is no"),
        ({"state": None}, "the request has no state"),
        ({"sensor": ""}, "a sensor that was sent is no"),
        ({"time_s": 1.0}, "the request's time, 1.0, is not within its state"),
        ({"scene": "/tmp/nowhere"}, "/tmp/nowhere"),
    ],
)
def test_a_broken_request_is_a_sentence(worker: Client, changed: dict[str, Any], sentence: str) -> None:
    event = last(worker.ask("camera", **sample_request(**changed)))
    assert event["event"] == "error" and sentence in str(event["text"])


def test_an_image_of_a_lidar_is_a_sentence(worker: Client) -> None:
    drive = read_scene_header(SAMPLE / "scene").drive
    lidar = drive.lidars["pandar64"]
    asked = capture_request(drive, {}, lidar, 0.5, SAMPLE, SAMPLE / "scene")
    assert "an image is asked for of LiDAR 'pandar64'" in str(last(worker.ask("camera", **asked))["text"])


def test_warnings_are_the_first_events(worker: Client) -> None:
    request = worker.ask("about", warnings=["one", "two"])
    assert [request.events.get(timeout=LIMIT_S).get("text") for _ in range(2)] == ["one", "two"]
    assert last(request)["event"] == "done"


NOISY = """#!/bin/sh
shift
exec {python} -c '
import os, runpy, sys
class Noise:
    def find_spec(name, path=None, target=None):
        if name == "torch":
            os.write(1, b"1 ")
sys.meta_path.insert(0, Noise)
sys.argv.pop(0)
runpy.run_path(sys.argv[0], run_name="__main__")
' "$@"
"""
"""An interpreter whose torch prints while it is imported."""


def test_what_an_import_prints_is_no_part_of_the_answer(tmp_path: Path) -> None:
    path = tmp_path / "python"
    path.write_text(NOISY.format(python=sys.executable))
    path.chmod(0o755)
    found = interpreters.probe(str(path))
    assert not found.problem and "torch" in found.about


def test_an_interpreter_that_cannot_render_says_why() -> None:
    found = interpreters.probe("/bin/false")
    assert found.problem
    assert "/bin/false" in interpreters.how_to_mend([found])


def site_packages(folder: Path, *leave_out: str) -> Path:
    """A folder of wheels as Blender unpacks them: this interpreter's packages, less what trains and
    what is left out."""
    target = folder / f"python{sys.version_info.major}.{sys.version_info.minor}" / "site-packages"
    target.mkdir(parents=True)
    for path in Path(sysconfig.get_path("purelib")).iterdir():
        if path.suffix != ".pth" and path.stem not in ("torch", "scipy", "safetensors", "unisim_blender", *leave_out):
            (target / path.name).symlink_to(path)
    return target


def test_wheels_make_a_bare_interpreter_render(bare: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interpreters, "WHEELS", tmp_path / "nothing")
    assert "No module named" in interpreters.probe(str(bare)).problem
    monkeypatch.setattr(interpreters, "WHEELS", site_packages(tmp_path / "whole"))
    found = interpreters.probe(str(bare))
    assert not found.problem and found.about["devices"] == ["cpu"] and found.about["torch"] == ""
    assert found.about["training_lacks"] == ["torch", "scipy", "safetensors"]
    other = site_packages(tmp_path / "other").parent.rename(tmp_path / "other" / "python3.9") / "site-packages"
    monkeypatch.setattr(interpreters, "WHEELS", other)
    assert "No module named" in interpreters.probe(str(bare)).problem, "wheels of another Python are not its own"
    monkeypatch.setattr(interpreters, "WHEELS", site_packages(tmp_path / "less", "plyfile"))
    assert "plyfile" in interpreters.probe(str(bare)).problem


def test_training_passes_over_what_has_no_torch(bare: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Rendering takes the first that can; training the first that has torch, and says what the others lack."""
    monkeypatch.setattr(interpreters, "WHEELS", site_packages(tmp_path))
    found, failed = interpreters.find(str(bare))
    assert found is not None and found.path == str(bare) and not failed
    found, failed = interpreters.find(str(bare), training=True)
    assert found is not None and found.path == sys.executable and found.about["torch"]
    assert [one.path for one in failed] == [str(bare)]
    sentence = interpreters.how_to_mend(failed, training=True)
    assert "needs torch" in sentence and f"{bare}: has no torch and no scipy" in sentence


def test_a_gpu_that_is_not_there_is_a_sentence(bare: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(interpreters, "WHEELS", site_packages(tmp_path))
    header = read_scene_header(SAMPLE / "scene")
    request = capture_request(
        header.drive, header.parked, header.drive.lidars["pandar64"], 0.5, SAMPLE, SAMPLE / "scene"
    )
    client = Client(str(bare))
    try:
        assert last(client.ask("lidar", **request, device="auto"))["event"] == "done"
        cuda, mps = (last(client.ask("lidar", **request, device=device)) for device in ("cuda", "mps"))
    finally:
        client.close()
    assert "no NVIDIA GPU is usable here" in str(cuda["text"]) and not cuda.get("remedy")
    # torch would help
    assert "Metal needs macOS, and torch" in str(mps["text"]) and mps["remedy"] == "interpreter"


def sample_request(**more: Any) -> dict[str, Any]:
    """A request for an image of the sample's camera at twice its own width."""
    header = read_scene_header(SAMPLE / "scene")
    camera = header.drive.cameras["front_camera"]
    twice = camera.resized(2 * camera.model.width)
    asked = capture_request(header.drive, header.parked, twice, camera.time_s[0], SAMPLE / "none", SAMPLE / "scene")
    return {**asked, "passes": ["rgb"], "quality": "balanced", "device": "cpu", **more}


def test_arrays_are_prepared_in_a_thread(worker: Client) -> None:
    """What the thread makes of an image's arrays is what can be made of them here, and their file is gone."""
    rows, columns, threads = [256, 320], [400, 560], []

    def prepare(event: dict[str, Any], arrays: dict[str, Any]) -> float:
        threads.append(threading.get_ident())
        return float(arrays["rgb"].sum())

    asked = sample_request(rows=rows, columns=columns)
    plain = worker.ask("camera", **asked)
    event = plain.events.get(timeout=LIMIT_S)
    total = float(worker.arrays(event)["rgb"].sum())
    last(plain)
    made = worker.ask("camera", prepare=prepare, **asked)
    event = made.events.get(timeout=LIMIT_S)
    assert event["prepared"] == total and threads and threads[0] != threading.get_ident()
    assert not list(worker.folder.iterdir())
    assert last(made)["event"] == "done"


def test_a_fault_while_preparing_ends_that_request_alone(worker: Client) -> None:
    def prepare(event: dict[str, Any], arrays: dict[str, Any]) -> object:
        raise ValueError("no such pass")

    ended = last(worker.ask("camera", prepare=prepare, **sample_request(rows=[256, 320], columns=[400, 560])))
    assert ended["event"] == "error" and "no such pass" in str(ended["text"])
    assert last(worker.ask("about"))["event"] == "done"


def test_an_image_of_another_size_is_that_of_the_command_line(worker: Client) -> None:
    """The view and F12 at twice a camera's own width: pixels are traced as far apart as `unisim render --width`
    traces them."""
    scene = SAMPLE / "scene"
    drive = read_scene_header(scene).drive
    rows, columns = [256, 320], [400, 560]
    request = worker.ask("camera", **sample_request(rows=rows, columns=columns))
    event = request.events.get(timeout=LIMIT_S)
    assert event["event"] == "arrays", event
    made = worker.arrays(event)["rgb"]
    last(request)
    renderer = DriveFrames(Renderer(load_backend(open_scene(scene))), drive)
    region = Region(columns[0], rows[0], columns[1], rows[1])
    wanted = renderer.camera("front_camera", 0, width=2 * drive.cameras["front_camera"].model.width, region=region).rgb
    assert np.abs(made - wanted).max() < 0.004
