"""Batches from end to end on a street of three frames: shared captures, killed processes, failures, rollouts."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import shlex
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import fsspec
import pytest
from written_street import write_street

from unisim_bench.settings import VARIANTS
from unisim_blender.core import native
from unisim_blender.core.batch.records import Store
from unisim_blender.core.batch.work import UnitRunning
from unisim_blender.core.cli.main import run
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.render.code_identity import code_identity
from unisim_blender.core.scenario import load_scenario
from unisim_blender.core.scenes.recipe import environment

OPTIONS = ("--sensors", "front_camera", "--renderer", "surfel", "--quality", "fast")
HERE = ("--on", "this-process")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A street, and a sweep of a second car that is there in its last frame alone."""
    folder = tmp_path_factory.mktemp("batch")
    write_street(folder / "street", 3, columns=180)
    second = {
        "type": "duplicate",
        "actor": "car-01",
        "id": "second",
        "pose": {"position": [14.0, 0.0, 0.8]},
        "present": {"start_s": 0.12},
    }
    base = {
        "format": "unisim-scenario", "version": 1, "name": "base", "log": "street", "edits": [second],
        "outputs": {"formats": ["png", "labels"]}, "simulation": {"duration_s": 0.1},
    }  # fmt: skip
    (folder / "base.json").write_text(json.dumps(base))
    parameters = {"aside": {"at": "/edits/0/pose/position/1", "range": {"start": 1.0, "stop": 2.0, "count": 3}}}
    sweep = {"format": "unisim-sweep", "version": 1, "name": "cars", "scenario": "base.json", "parameters": parameters}
    (folder / "sweep.json").write_text(json.dumps(sweep))
    return folder


def batch(folder: Path, out: Path | str, *more: str, jobs: str = "sweep.json") -> int:
    return run(["batch", str(folder / jobs), "--out", str(out), "--unit", "1", *OPTIONS, *more])


@pytest.fixture(scope="module")
def whole(folder: Path) -> Path:
    """The sweep, run without interruption."""
    assert batch(folder, folder / "whole", *HERE) == 0
    return folder / "whole"


def files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def manifest_of(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "manifest.json").read_bytes())
    return document


def test_shared_captures_are_rendered_once(folder: Path, whole: Path, tmp_path: Path) -> None:
    manifest = manifest_of(whole)
    assert manifest["unfinished"] == []
    assert manifest["counts"] == {"asked": 9, "rendered": 5, "shared": 4, "units": 5}
    assert len(list((whole / "captures").rglob("*.png"))) == 5
    seen = [manifest["variants"][f"cars-000{n}"]["moments"] for n in range(3)]
    for frame, different in (("000000", 1), ("000001", 1), ("000002", 3)):
        assert len({moments[frame]["camera/front_camera"] for moments in seen}) == different
    # what a variant refers to is what rendering it alone gives
    scenario = whole / "variants" / "cars-0001" / "scenario.json"
    assert run(["render", str(scenario), "--out", str(tmp_path / "alone"), "--jobs", "1", *OPTIONS]) == 0
    for frame, captures in seen[1].items():
        for name, identity in captures.items():
            for file in manifest["captures"][identity]["files"]:
                inside = f"labels/{frame}.json" if name == "labels" else f"{name}/{frame}.png"
                assert file.endswith(inside)
                assert (whole / file).read_bytes() == (tmp_path / "alone" / inside).read_bytes(), file


def test_a_killed_batch_resumes_to_the_same_bytes(folder: Path, whole: Path) -> None:
    out = folder / "killed"
    code = "import sys; from unisim_blender.core.cli.main import run; sys.exit(run(sys.argv[1:]))"
    command = [
        sys.executable,
        "-c",
        code,
        "batch",
        str(folder / "sweep.json"),
        "--out",
        str(out),
        "--unit",
        "1",
        *OPTIONS,
        "--jobs",
        "1",
    ]
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(command, stderr=quiet, stdout=quiet, start_new_session=True)
    while process.poll() is None and not list(out.glob("records/*.json")):
        time.sleep(0.002)
    os.killpg(process.pid, signal.SIGKILL)  # its workers, too, in the middle of what they write
    process.wait()
    there = files(out)
    assert any(name.startswith("records/") for name in there) and "manifest.json" not in there, "killed halfway"
    assert batch(folder, out, *HERE) == 1, "it is not empty"
    assert batch(folder, out, *HERE, "--resume") == 0
    assert files(out) == files(whole)


def test_another_batch_is_refused(folder: Path, whole: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = files(whole)
    assert batch(folder, whole, *HERE, "--resume", jobs="base.json") == 1
    assert "is another batch" in capsys.readouterr().err
    assert files(whole) == before


def test_workers_with_other_code_or_another_folder_refuse_the_batch(whole: Path, tmp_path: Path) -> None:
    plan, code = hashlib.sha256((whole / "batch.json").read_bytes()).hexdigest(), code_identity()["sha256"]
    machine = "cpu", environment("cpu")
    assert callable(UnitRunning(Store(str(whole)), plan, code, *machine)())
    with pytest.raises(UnisimError, match="its unisim_blender is another one than that of the machine that planned"):
        UnitRunning(Store(str(whole)), plan, "another", *machine)()
    for store, digest in ((Store(str(tmp_path)), plan), (Store(str(whole)), "another")):
        with pytest.raises(UnisimError, match=r"batch\.json is not this batch's; write to a folder that all"):
            UnitRunning(store, digest, code, *machine)()


OTHER_MACHINE = """
import pickle, sys
from pathlib import Path
from unisim_blender.core.cli.main import run
from unisim_blender.core.errors import UnisimError
try:
    pickle.loads(Path(sys.argv[1]).read_bytes())()
except UnisimError as error:
    print(error, file=sys.stderr)
sys.exit(run(sys.argv[2:]))
"""


def test_machines_that_render_other_bytes_are_refused(folder: Path, whole: Path, tmp_path: Path) -> None:
    if native.variant() not in VARIANTS[1:]:
        pytest.skip("this machine has one instruction set")
    before, here = files(whole), environment("cpu")
    digest = hashlib.sha256((whole / "batch.json").read_bytes()).hexdigest()
    running = UnitRunning(Store(str(whole)), digest, code_identity()["sha256"], "cpu", here)
    (tmp_path / "running").write_bytes(pickle.dumps(running))
    arguments = ["batch", str(folder / "sweep.json"), "--out", str(whole), "--unit", "1", *OPTIONS, "--units", "0/2"]
    command = [sys.executable, "-c", OTHER_MACHINE, str(tmp_path / "running"), *arguments]
    done = subprocess.run(
        command, env={**os.environ, native.VARIANT_VARIABLE: "portable"}, capture_output=True, text=True
    )
    worker, shard = [line for line in done.stderr.splitlines() if "instruction_set" in line]
    told = f"instruction_set is portable, not {here['instruction_set']}"
    assert f"renders other bytes than the machine that planned this: its {told}; install" in worker
    assert done.returncode == 1 and f"batch.json: is another batch: here {told}; name another place" in shard
    assert files(whole) == before


def test_a_failure_is_listed_with_its_command_and_repeated(
    folder: Path, whole: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = folder / "failed"
    shutil.copytree(whole, out)
    record = out / "records" / "000002.json"
    (capture,) = [name for name in json.loads(record.read_bytes())["captures"] if list(out.rglob(f"{name}/camera"))]
    record.unlink()
    blocked = next(out.rglob(capture))
    shutil.rmtree(blocked)
    blocked.write_bytes(b"in the way")
    assert batch(folder, out, *HERE, "--resume", "--json") == 1
    told = capsys.readouterr()
    events = [json.loads(line) for line in told.out.splitlines()]
    doing = [(event["state"], event["unit"]) for event in events if event["event"] == "worker"]
    assert doing == [("starting", None), ("unit", "000002"), ("idle", None)]
    events = [event for event in events if event["event"] != "worker"]
    assert [event["event"] for event in events] == ["start", "unit", "report"]
    assert (events[0]["units"], events[0]["kept"]) == (5, 4)
    (failure,) = events[-1]["failures"]
    assert "cannot be written" in failure["reason"] and "1 of 5 units failed" in told.err
    assert events[-1]["units_kept"] == 4
    assert run(["batch", "status", str(out), "--json"]) == 0
    status = json.loads(capsys.readouterr().out)
    assert (status["units"], status["finished"]) == (5, 4)
    assert [one["command"] for one in status["failures"]] == [failure["command"]]
    assert manifest_of(out)["unfinished"] == ["000002"]
    monkeypatch.chdir(tmp_path)
    program, *arguments = shlex.split(failure["command"])
    assert program == "unisim" and run([*arguments, "--jobs", "1"]) == 0
    assert [path.stem for path in (tmp_path / "repeat-000002" / "camera").rglob("*.png")] == ["000002"]
    blocked.unlink()
    assert batch(folder, out, *HERE, "--resume") == 0
    assert files(out) == files(whole)


def test_a_store_in_memory_holds_the_same_objects(folder: Path, whole: Path) -> None:
    out = f"memory://{folder.name}"
    assert batch(folder, out, "--on", "processes") == 1, "other processes would not see it"
    assert batch(folder, out, *HERE) == 0
    fs = fsspec.filesystem("memory")
    found = {path.removeprefix(f"/{folder.name}/"): fs.cat_file(path) for path in fs.find(f"/{folder.name}")}
    places = ("variants/", "report.html")  # they name others by where they lie
    mine = {name: data for name, data in files(whole).items() if not name.startswith(places)}
    assert {name: data for name, data in found.items() if not name.startswith(places)} == mine
    assert f"memory://{folder.name}/variants/cars-0001/scenario.json" in found["report.html"].decode()


def test_rollouts_are_what_drive_makes(folder: Path, tmp_path: Path) -> None:
    line = {"name": "driven", "scenario": "base.json", "driver": "constant", "seed": 4}
    (folder / "rollouts.jsonl").write_text(json.dumps(line))
    assert batch(folder, folder / "rollouts", *HERE, jobs="rollouts.jsonl") == 0
    out = folder / "rollouts" / "rollouts" / "driven"
    scenario = folder / "rollouts" / "variants" / "driven" / "scenario.json"
    alone = tmp_path / "alone"
    assert run(["drive", str(scenario), "--driver", "constant", "--seed", "4", "--out", str(alone), *OPTIONS]) == 0
    theirs = {name: data for name, data in files(alone).items() if name.split("/")[0] in ("camera", "steps.jsonl")}
    assert len(theirs) >= 2 and theirs.items() <= files(out).items()
    rollout = manifest_of(folder / "rollouts")["variants"]["driven"]["rollout"]
    assert rollout["scores"] == json.loads((alone / "scores.json").read_bytes())
    assert sorted(rollout["files"]) == sorted(f"rollouts/driven/{name}" for name in files(out))
    assert load_scenario(out / "scenario.json").log_path == folder / "street"


def test_shards_make_what_one_run_makes(
    folder: Path, whole: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    out = folder / "sharded"
    monkeypatch.chdir(folder)
    arguments = ["batch", "sweep.json", "--out", "sharded", "--unit", "1", *OPTIONS]
    assert run([*arguments, "--on", "shards", "--device", "cuda"]) == 0
    assert "\n#SBATCH --gpus=1\n" in capsys.readouterr().out
    assert run([*arguments, "--on", "shards", "--shards", "2", "--scheduler", "openjd"]) == 0
    assert not out.exists(), "nothing is run"
    action = json.loads(capsys.readouterr().out)["steps"][0]["script"]["actions"]["onRun"]
    words = [str(folder / "sweep.json"), "--out", str(out), "--unit", "1", *OPTIONS]
    assert sorted(action["args"]) == sorted(["batch", *words, "--units", "{{Task.Param.Shard}}/2"])
    monkeypatch.chdir("/")
    for number in (1, 0):
        assert not (out / "manifest.json").exists()
        parts = [word.replace("{{Task.Param.Shard}}", str(number)) for word in action["args"]]
        assert run([*parts, *HERE]) == 0
    assert files(out) == files(whole)
    assert batch(folder, out, *HERE, "--units", "0/2") == 0, "one that is finished can be run again"
    assert files(out) == files(whole)
