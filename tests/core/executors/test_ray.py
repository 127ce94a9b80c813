"""Ray, started on this machine: units of lost workers are run again, and a batch has the bytes of one in this process."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
from halving import Halves
from written_street import write_street

from unisim_blender.core import native
from unisim_blender.core.cli.main import run
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.executors import EXECUTORS, RayCluster
from unisim_blender.core.executors.executor import MAX_LOSSES

pytest.importorskip("ray")
pytestmark = pytest.mark.slow  # a Ray starts in five seconds where nothing else runs

OPTIONS = ("--sensors", "front_camera", "--renderer", "surfel", "--quality", "fast", "--unit", "1", "--jobs", "2")
RUN = "import sys; from unisim_blender.core.cli.main import run; sys.exit(run(sys.argv[1:]))"


def children() -> set[int]:
    """Processes of Ray that this one started and that are still there."""
    listed = subprocess.run(["ps", "--ppid", str(os.getpid()), "-o", "pid=,args="], capture_output=True, text=True)
    return {int(line.split()[0]) for line in listed.stdout.splitlines() if "ray" in line and "<defunct>" not in line}


def test_units_of_lost_workers_are_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    monkeypatch.setenv("PYTHONPATH", str(Path(__file__).parents[2] / "support"))  # where workers find `halving`
    outcomes = {one.index: one for one in EXECUTORS["ray"].run(Halves(tmp_path), range(8), 2, list("aabbaabb"))}
    assert sorted(outcomes) == list(range(8))
    halved = {index: one.result for index, one in outcomes.items() if one.result is not None}
    assert {index: result[:2] for index, result in halved.items()} == {0: (0, "1"), 2: (1, "1"), 4: (2, "1")}
    assert len({pid for *_, pid in halved.values()} - {os.getpid()}) >= 1
    assert {str(outcomes[index].error) for index in (1, 3, 5, 7)} == {f"{index} is odd" for index in (1, 3, 5, 7)}
    assert f"ended from outside {MAX_LOSSES} times" in str(outcomes[6].error)
    assert not children(), "what was started is ended"
    assert "RAY_AUTH_TOKEN" not in os.environ


def test_a_cluster_that_does_not_answer_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UnisimError, match=r"127\.0\.0\.1:1: no Ray cluster answers there"):
        list(RayCluster("127.0.0.1:1").run(Halves(Path()), range(2), 1))
    monkeypatch.setenv("RAY_ADDRESS", "ray://127.0.0.1:1")
    with pytest.raises(UnisimError, match=r"ray://127\.0\.0\.1:1: no Ray cluster"):
        list(EXECUTORS["ray"].run(Halves(Path()), range(2), 1))


OWN_RAY = """
import json, os, sys
from functools import partial
import ray
from unisim_blender.core import native
from unisim_blender.core.executors import RayCluster
ray.init("local", num_cpus=4, num_gpus=1, include_dashboard=False, _temp_dir=sys.argv[1], log_to_driver=False)
# each makes `os.getenv` of a variable: a unit is what it returns where that is not set
seen, chosen = (partial(partial, os.getenv, name) for name in ("CUDA_VISIBLE_DEVICES", native.VARIANT_VARIABLE))
states = []
gpus = [one.get() for one in RayCluster("auto", 0.5).run(seen, ["none"] * 4, on_worker=states.append)]
without = [one.get() for one in RayCluster("auto").run(seen, ["none"], 1)]
sets = [one.get() for one in RayCluster("auto").run(chosen, ["none"], 1)]
print(json.dumps([gpus, without, sets, sorted({one.number for one in states})]))
"""


def test_workers_have_gpus_and_the_instruction_set_of_this_process() -> None:
    with pytest.raises(UnisimError, match="Ray finds 0 GPUs on this machine, and a worker is to have 99"):
        list(RayCluster(gpus=99.0).run(Halves(Path()), range(1), 1))
    kept = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    with tempfile.TemporaryDirectory(prefix="ray-") as folder:  # sockets' paths are short
        variables = kept | {"RAY_AUTH_MODE": "disabled", "RAY_USAGE_STATS_ENABLED": "0", "HOME": folder}
        done = subprocess.run(
            [sys.executable, "-c", OWN_RAY, folder], env=variables, stdout=subprocess.PIPE, text=True, check=True
        )
    gpus, without, sets, workers = json.loads(done.stdout.splitlines()[-1])
    assert gpus == ["0"] * 4 and workers == [0, 1], "as many as there are halves of GPUs"
    assert without in (["none"], [""]) and sets == [native.variant()]


def test_a_batch_whose_worker_and_command_are_killed_has_the_same_bytes(tmp_path: Path) -> None:
    write_street(tmp_path / "street", 3)
    second = {
        "type": "duplicate", "actor": "car-01", "id": "second", "pose": {"position": [14.0, 0.0, 0.8]},
        "present": {"start_s": 0.05},
    }  # fmt: skip
    base = {
        "format": "unisim-scenario", "version": 1, "name": "base", "log": "street", "edits": [second],
        "outputs": {"formats": ["png", "labels"]},
    }  # fmt: skip
    (tmp_path / "base.json").write_text(json.dumps(base))
    parameters = {"aside": {"at": "/edits/0/pose/position/1", "range": {"start": 0.1, "stop": 1.0, "count": 4}}}
    sweep = {"format": "unisim-sweep", "version": 1, "name": "cars", "scenario": "base.json", "parameters": parameters}
    (tmp_path / "sweep.json").write_text(json.dumps(sweep))
    arguments = ["batch", str(tmp_path / "sweep.json"), *OPTIONS]
    assert run([*arguments, "--out", str(tmp_path / "whole"), "--on", "this-process"]) == 0

    out = tmp_path / "killed"
    environment = {name: value for name, value in os.environ.items() if name != "RAY_ADDRESS"}
    process = subprocess.Popen(
        [sys.executable, "-c", RUN, *arguments, "--out", str(out), "--on", "ray"], env=environment
    )
    wait_for_records(process, out, 1)
    os.kill(next(pid for pid in descendants(process.pid) if b"_Actor.run" in title(pid)), signal.SIGKILL)
    wait_for_records(process, out, 2)
    started = {pid: begun(pid) for pid in descendants(process.pid)}
    process.kill()
    process.wait()
    assert "manifest.json" not in files(out), "killed halfway"
    assert run([*arguments, "--out", str(out), "--on", "ray", "--resume"]) == 0
    assert files(out) == files(tmp_path / "whole")
    deadline = time.monotonic() + 90
    while (left := [pid for pid in started if begun(pid) == started[pid]]) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not left, "the killed command's Ray ends, too"


def wait_for_records(process: subprocess.Popen[bytes], out: Path, count: int) -> None:
    """Wait until so many units have a record."""
    while process.poll() is None and len(list(out.glob("records/*.json"))) < count:
        time.sleep(0.002)


def title(pid: int) -> bytes:
    """What a process calls itself; Ray's workers name what they do."""
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return b""


def descendants(pid: int) -> list[int]:
    listed = subprocess.run(["ps", "-eo", "pid=,ppid="], capture_output=True, text=True).stdout.split()
    parents = dict(zip(map(int, listed[::2]), map(int, listed[1::2]), strict=True))
    found = [pid]
    for one in found:
        found += [child for child, parent in parents.items() if parent == one]
    return found[1:]


def begun(pid: int) -> str | None:
    """When a process began, in the kernel's ticks: ids are used again. None where it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return None
    return None if fields[0] == "Z" else fields[19]


def files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


SLEEPS = """
import sys, time
from functools import partial
from unisim_blender.core.executors import RayCluster
list(RayCluster().run(partial(partial, time.sleep), [3.0] * 40, 1))
"""


def test_a_lost_raylet_is_told() -> None:
    """Ray ends the process that has lost its raylet, without a word of its own."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    process = subprocess.Popen([sys.executable, "-c", SLEEPS], env=kept, stderr=subprocess.PIPE, text=True)
    deadline = time.monotonic() + 120
    while not any(b"_Actor.run" in title(pid) for pid in descendants(process.pid)) and time.monotonic() < deadline:
        time.sleep(0.1)
    os.kill(
        next(pid for pid in descendants(process.pid) if title(pid).split(b"\0")[0].endswith(b"/raylet")), signal.SIGKILL
    )
    _, told = process.communicate(timeout=120)
    assert process.returncode == 1
    (sentence,) = [line for line in told.splitlines() if line.endswith("continue with --resume")]
    assert "Ray's raylet was ended from outside (out of memory?)" in sentence
