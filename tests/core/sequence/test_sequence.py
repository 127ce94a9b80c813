"""Sequences: the same bytes for any number of jobs, for killed and resumed runs, and nothing rendered twice."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest
import torch
from rendered_folder import contents
from tiny_drive import FakeMethod, FakeRenderer, recipe_of, tiny_drive, tiny_plan

from unisim_blender.core.errors import OutputError, UnisimError
from unisim_blender.core.prepare.selection import select_frames
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.scenes.recipe import RendererRecipe
from unisim_blender.core.sensors.frames import CameraFrame
from unisim_blender.core.sequence.records import STATE_FOLDER, read_records
from unisim_blender.core.sequence.run import render_sequence
from unisim_blender.core.world.replay import DriveStates


@pytest.fixture(scope="module")
def reference(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    out = tmp_path_factory.mktemp("reference") / "out"
    report = render_sequence(tiny_plan(), out)
    assert report.rendered == (0, 1, 2, 3, 4, 5) and report.kept == ()
    assert (out / "timings.json").is_file()
    return contents(out)


def test_files_of_a_sequence(reference: dict[str, bytes]) -> None:
    assert "manifest.json" in reference
    for frame in range(6):
        for name in (
            "camera/front/{:06d}.png",
            "camera/front/{:06d}.exr",
            "lidar/top/{:06d}.ply",
            "lidar/top/{:06d}.npz",
        ):
            assert name.format(frame) in reference
        assert f"labels/{frame:06d}.json" in reference
    assert not [name for name in reference if "partial" in name]


def test_manifest_says_what_was_spent_and_saved(reference: dict[str, bytes]) -> None:
    manifest = json.loads(reference["manifest.json"])
    assert manifest["samples"]["samples_spent"] == sum(10 + f for f in range(6)) + 6 * 7
    assert manifest["samples"]["samples_saved"] == 6 * (5 + 3)
    assert manifest["inputs"]["scenes"] == {"own": "1" * 64, "others": []}
    assert len(manifest["frames"]) == 6
    assert "seconds" not in reference["manifest.json"].decode(), "times belong to timings.json"


def test_two_jobs_give_the_same_bytes(reference: dict[str, bytes], tmp_path: Path) -> None:
    log = tmp_path / "log"
    render_sequence(tiny_plan(log, 0.05), tmp_path / "out", jobs=2)
    assert contents(tmp_path / "out") == reference
    processes = {line.split()[1] for line in log.read_text().splitlines()}
    assert str(os.getpid()) not in processes


def test_resume_renders_only_what_is_missing(reference: dict[str, bytes], tmp_path: Path) -> None:
    out = tmp_path / "out"
    render_sequence(tiny_plan(frames=4), out)
    (out / "camera/front/000001.png").write_bytes(b"damaged")
    (out / "lidar/top/000002.npz").unlink()
    (out / "labels" / ".000005.json.1.partial").write_bytes(b"left by a killed process")
    log = tmp_path / "log"
    report = render_sequence(tiny_plan(log), out, resume=True)
    assert report.kept == (0, 3) and report.rendered == (1, 2, 4, 5)
    images = sorted(int(line.split()[0]) for line in log.read_text().splitlines())
    assert images == [1, 4, 5], "of frame 2 only the sweep was missing"
    assert contents(out) == reference


def test_resume_with_nothing_to_do_makes_no_renderer(reference: dict[str, bytes], tmp_path: Path) -> None:
    out = tmp_path / "out"
    render_sequence(tiny_plan(), out)

    class NotAsked(FakeMethod):
        def load(self, recipe: RendererRecipe) -> Renderer:
            raise AssertionError("a renderer was made")

    plan = tiny_plan()
    report = render_sequence(replace(plan, recipe=recipe_of(NotAsked(plan.drive))), out, resume=True)
    assert report.rendered == () and contents(out) == reference


@pytest.mark.parametrize("change", ["width", "scene", "drive"])
def test_changed_inputs_are_rendered_again(change: str, tmp_path: Path) -> None:
    out = tmp_path / "out"
    render_sequence(tiny_plan(frames=2), out)
    plan = tiny_plan(frames=1)
    if change == "width":
        plan = tiny_plan(frames=1, width=16)
    elif change == "scene":
        plan = replace(plan, scenes={"": "2" * 64})
    else:
        drive = replace(plan.drive, actors={})
        captures = replace(plan.captures, states=DriveStates(drive, {}))
        plan = replace(plan, drive=drive, recipe=recipe_of(FakeMethod(drive)), captures=captures)
    report = render_sequence(plan, out, resume=True)
    assert report.rendered == (0,)
    assert not (out / "camera/front/000001.png").exists(), "a frame of other inputs must not stay beside"
    render_sequence(plan, tmp_path / "fresh")
    assert contents(out) == contents(tmp_path / "fresh")


def test_other_frames_asked_for_keep_those_that_are_there(tmp_path: Path) -> None:
    out = tmp_path / "out"
    render_sequence(tiny_plan(frames=2), out)
    report = render_sequence(replace(tiny_plan(), moments=(tiny_plan().moment_of_frame(4),)), out, resume=True)
    assert report.rendered == (4,)
    assert list(json.loads((out / "manifest.json").read_text())["frames"]) == ["000000", "000001", "000004"]


def test_a_folder_that_holds_something_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    (out / "mine.txt").write_text("keep")
    with pytest.raises(OutputError, match="is not empty.*--resume"):
        render_sequence(tiny_plan(), out)
    assert [p.name for p in out.iterdir()] == ["mine.txt"]


RUN = """
import signal
import sys
from pathlib import Path
sys.path.insert(0, {tests!r})
from tiny_drive import tiny_plan
from unisim_blender.core.sequence.run import render_sequence
if __name__ == "__main__":
    # a shell that runs tests in the background has its children ignore an interrupt
    signal.signal(signal.SIGINT, signal.default_int_handler)
    render_sequence(tiny_plan(delay_s=0.3), Path(sys.argv[1]), jobs=int(sys.argv[2]))
"""


def start_run(tmp_path: Path, jobs: int) -> tuple[subprocess.Popen[bytes], Path]:
    script = tmp_path / "run.py"
    script.write_text(RUN.format(tests=str(Path(__file__).parents[2] / "support")))
    out = tmp_path / "out"
    root = Path(__file__).parents[3]
    environment = {**os.environ, "PYTHONPATH": str(root)}
    command = [sys.executable, str(script), str(out), str(jobs)]
    process = subprocess.Popen(command, env=environment, stderr=subprocess.PIPE)
    deadline = time.monotonic() + 60
    while not list((out / ".state").glob("*.json")):
        assert process.poll() is None and time.monotonic() < deadline, process.stderr and process.stderr.read()
        time.sleep(0.01)
    return process, out


@pytest.mark.parametrize("jobs", [1, 2])
def test_killed_and_resumed_gives_the_same_bytes(jobs: int, reference: dict[str, bytes], tmp_path: Path) -> None:
    process, out = start_run(tmp_path, jobs)
    process.kill()
    process.communicate(timeout=60)  # the pipe is closed when the last worker has ended
    assert not (out / "manifest.json").exists()
    # a moment can be killed between its last capture and its labels: its captures are kept, labels are written alone
    finished = sum(len(captures.keys() - {"labels"}) == 2 for captures in read_records(out).values())
    assert 0 < finished < 6, "a worker outlived its killed parent"
    report = render_sequence(tiny_plan(), out, resume=True)
    assert len(report.kept) == finished
    assert contents(out) == reference


def test_interrupt_ends_cleanly_and_keeps_what_is_finished(reference: dict[str, bytes], tmp_path: Path) -> None:
    process, out = start_run(tmp_path, 2)
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=20)
    assert process.returncode != 0 and b"KeyboardInterrupt" in stderr
    assert list((out / ".state").glob("*.json")) and not list(out.rglob("*.partial"))
    assert (out / "timings.json").is_file()
    render_sequence(tiny_plan(), out, resume=True)
    assert contents(out) == reference


@pytest.mark.parametrize("failing", [".exr", ".npz", ".json"])
def test_full_disk_keeps_finished_frames(
    failing: str, reference: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The third frame's file of each kind meets a full disk; the run ends with one sentence and can be continued."""
    real = os.replace
    state = {"full": True}

    def replace_until_full(source: Any, target: Any) -> None:
        if state["full"] and Path(target).name == f"000002{failing}":
            raise OSError(28, "No space left on device")
        real(source, target)

    monkeypatch.setattr(os, "replace", replace_until_full)
    out = tmp_path / "out"
    with pytest.raises(OutputError, match="No space left on device"):
        render_sequence(tiny_plan(), out)
    assert not list(out.rglob("*.partial"))
    state["full"] = False
    report = render_sequence(tiny_plan(), out, resume=True)
    # of the third frame only the labels are missing where these met the full disk
    assert report.kept == ((0, 1, 2) if failing == ".json" else (0, 1))
    assert contents(out) == reference


def test_a_worker_that_dies_is_one_sentence(tmp_path: Path) -> None:
    plan = tiny_plan()
    with pytest.raises(OutputError, match="ended from outside.*--resume"):
        render_sequence(replace(plan, recipe=recipe_of(DyingMethod(plan.drive))), tmp_path / "out", jobs=2)


class DyingRenderer(FakeRenderer):
    def camera(self, *arguments: Any) -> CameraFrame:
        os.kill(os.getpid(), signal.SIGKILL)
        raise AssertionError


class DyingMethod(FakeMethod):
    """A renderer that ends its process, as the kernel does where memory runs out."""

    def load(self, recipe: RendererRecipe) -> Renderer:
        return cast(Renderer, DyingRenderer(self.drive))


class OneThreadMethod(FakeMethod):
    """A renderer that finds out how many threads torch would use."""

    def load(self, recipe: RendererRecipe) -> Renderer:
        import torch

        assert torch.get_num_threads() == 1
        return super().load(recipe)


@pytest.mark.parametrize("jobs", [1, 2])
def test_torch_renders_with_one_thread(jobs: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "2")  # what the workers would inherit
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    try:
        plan = tiny_plan(frames=2)
        render_sequence(replace(plan, recipe=recipe_of(OneThreadMethod(plan.drive))), tmp_path / "out", jobs)
        assert torch.get_num_threads() == 2, "the caller gets its own number back"
    finally:
        torch.set_num_threads(before)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (None, (0, 1, 2, 4, 5)),
        ("1:5:2", (1,)),
        ("::2", (0, 2, 4)),
        ("4", (4,)),
        ("2:", (2, 4, 5)),
        ("1:5", (1, 2, 4)),
        ("5,0:2", (0, 1, 5)),
    ],
)
def test_frames_are_named_by_number(text: str | None, expected: tuple[int, ...]) -> None:
    assert select_frames(text, (0, 1, 2, 4, 5)) == expected


@pytest.mark.parametrize("text", ["3", "7:9", "a", "1:2:0", "1:2:3:4", "::-1", "1,,2", ""])
def test_frames_that_are_not_there_are_refused(text: str | None) -> None:
    with pytest.raises(UnisimError, match="--frames"):
        select_frames(text, (0, 1, 2, 4, 5))


def test_the_drive_used_here_is_what_it_says() -> None:
    assert tiny_drive().frames == (0, 1, 2, 3, 4, 5)


@pytest.mark.parametrize("name", ("../precious", "/precious", "a/../../precious", "..\\precious"))
def test_a_record_removes_no_file_beside_its_folder(name: str, tmp_path: Path) -> None:
    out, precious = tmp_path / "out", tmp_path / "precious"
    render_sequence(tiny_plan(), out)
    precious.write_text("mine")
    record = out / STATE_FOLDER / "000000.json"
    document = json.loads(record.read_bytes())
    document["captures"]["camera/front"]["files"][name if name != "/precious" else str(precious)] = "0"
    record.write_text(json.dumps(document))
    report = render_sequence(tiny_plan(), out, resume=True)
    assert precious.read_text() == "mine" and report.rendered == (0,)


@pytest.mark.parametrize("text", ("[" * 100000, '{"x": 1}', '{"0": []}', "\x00", "9" * 5000))
def test_records_and_timings_that_are_broken_count_as_none(
    text: str, reference: dict[str, bytes], tmp_path: Path
) -> None:
    out = tmp_path / "out"
    render_sequence(tiny_plan(), out)
    for file in (out / "timings.json", out / STATE_FOLDER / "000003.json"):
        file.write_text(text)
    assert render_sequence(tiny_plan(), out, resume=True).rendered == (3,)
    assert contents(out) == reference
