"""Shards: every unit lies in one, and what is written for each scheduler runs every shard with the words that were given."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from unisim_blender.core.batch.plan import Shard
from unisim_blender.core.batch.schedulers import SCHEDULERS, ShardedBatch
from unisim_blender.core.cli.main import run
from unisim_blender.core.errors import UnisimError

WORDS = ["unisim", "batch", '/a b/it\'s $HOME "x" {1}.json', "--out", "s3://bucket/ü😀", "--jobs", "2"]
BATCH = ShardedBatch("unisim-cut-in", WORDS, 3, 2)
WITH_GPU = replace(BATCH, gpus=1)


@pytest.mark.parametrize("count", [1, 3, 7, 20])
def test_every_unit_lies_in_one_shard(count: int) -> None:
    units: Any = [SimpleNamespace(name=f"{i}", scene="ab"[i % 2]) for i in range(11)]
    parts = [Shard(number, count).of(units) for number in range(count)]
    assert sorted(unit.name for part in parts for unit in part) == sorted(unit.name for unit in units)
    assert max(map(len, parts)) - min(map(len, parts)) <= 1
    assert sum(len({unit.scene for unit in part}) for part in parts if part) <= min(count, 11) + 1, "one part has both"


@pytest.fixture
def called(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder in which each call of `unisim` leaves its arguments, as JSON."""
    program = tmp_path / "bin" / "unisim"
    program.parent.mkdir()
    code = "import json, os, sys; json.dump(sys.argv[1:], open(f'{sys.path[0]}/../called-{os.getpid()}', 'w'))"
    program.write_text(f"#!{sys.executable}\n{code}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}:{os.environ['PATH']}")
    return tmp_path


def calls(folder: Path) -> list[list[str]]:
    return sorted(json.loads(path.read_text()) for path in folder.glob("called-*"))


EXPECTED = [[*WORDS[1:], "--units", f"{number}/3"] for number in range(3)]


def test_slurm(called: Path) -> None:
    script = called / "array.sh"
    script.write_text(SCHEDULERS["slurm"](BATCH))
    assert "#SBATCH --array=0-2\n#SBATCH --cpus-per-task=2\n" in script.read_text()
    for number in range(3):
        subprocess.run(["bash", str(script)], check=True, env=os.environ | {"SLURM_ARRAY_TASK_ID": str(number)})
    assert calls(called) == EXPECTED


def test_kubernetes() -> None:
    yaml = pytest.importorskip("yaml")
    job = yaml.safe_load(SCHEDULERS["kubernetes"](BATCH))
    assert (job["apiVersion"], job["kind"], job["spec"]["completionMode"]) == ("batch/v1", "Job", "Indexed")
    assert job["spec"]["completions"] == 3
    (container,) = job["spec"]["template"]["spec"]["containers"]
    # Kubernetes' own rule: $(NAME) is a variable of the container, $$ a dollar
    words = [
        word.replace("$(JOB_COMPLETION_INDEX)", "2") if "$(" in word else word.replace("$$", "$")
        for word in container["command"]
    ]
    assert words[1:] == EXPECTED[2]


def test_kubernetes_schemas_take_it() -> None:
    validate = pytest.importorskip(
        "kubernetes_validate", reason="kubernetes-validate is not installed: make test-schemas"
    )
    yaml = pytest.importorskip("yaml")
    for batch in (BATCH, WITH_GPU):
        job = yaml.safe_load(SCHEDULERS["kubernetes"](batch))
        validate.validate(job, "1.30", strict=True)
    job["spec"]["completionmode"] = "Indexed"
    with pytest.raises(validate.ValidationError):
        validate.validate(job, "1.30", strict=True)


def test_a_device_asks_for_a_gpu() -> None:
    yaml = pytest.importorskip("yaml")
    assert "\n#SBATCH --gpus=1\n" in SCHEDULERS["slurm"](WITH_GPU) and "gpus" not in SCHEDULERS["slurm"](BATCH)
    for batch, limits in ((BATCH, None), (WITH_GPU, {"nvidia.com/gpu": 1})):
        job = yaml.safe_load(SCHEDULERS["kubernetes"](batch))
        resources = job["spec"]["template"]["spec"]["containers"][0]["resources"]
        assert resources.get("limits") == limits and resources["requests"] == {"cpu": 2}
        (step,) = json.loads(SCHEDULERS["openjd"](batch))["steps"]
        amounts = {one["name"]: one["min"] for one in step["hostRequirements"]["amounts"]}
        assert amounts == {"amount.worker.vcpu": 2, **({"amount.worker.gpu": 1} if limits else {})}


def test_open_job_description(called: Path) -> None:
    program = shutil.which("openjd", path=f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    if program is None:
        pytest.skip("openjd-cli is not installed")
    (called / "template.json").write_text(SCHEDULERS["openjd"](BATCH), encoding="utf-8")
    command = [program, "run", str(called / "template.json")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stdout + done.stderr
    assert calls(called) == EXPECTED
    with pytest.raises(UnisimError, match=r"x\{\{y: has \{\{"):
        SCHEDULERS["openjd"](ShardedBatch("a", ["unisim", "x{{y"], 1))


FARM = """
const tasks = [];
const author = {
  Task: (name, type) => ({ name, type, commands: [], addCommand(command) { this.commands.push(command); } }),
  Command: (name, parameters) => ({ name, parameters }),
};
const job = { settings: { shards: 3 }, addTask: (task) => tasks.push(task) };
"""


def test_flamenco_with_a_stub_of_its_manager(tmp_path: Path) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("node is not installed")
    after = "compileJob(job);\nconsole.log(JSON.stringify({ tasks, settings: JOB_TYPE.settings }));\n"
    (tmp_path / "job.js").write_text(FARM + SCHEDULERS["flamenco"](BATCH) + after, encoding="utf-8")
    done = json.loads(subprocess.run([node, str(tmp_path / "job.js")], check=True, capture_output=True).stdout)
    assert Counter(task["type"] for task in done["tasks"]) == {"misc": 3}
    assert [command["name"] for task in done["tasks"] for command in task["commands"]] == ["exec"] * 3
    parameters = [command["parameters"] for task in done["tasks"] for command in task["commands"]]
    assert [(one["exe"], one["args"]) for one in parameters] == [("unisim", words) for words in EXPECTED]
    assert [(one["key"], one["default"]) for one in done["settings"]] == [("shards", 3)]


@pytest.mark.parametrize("part", ["3/3", "1", "-1/2", "a/b"])
def test_no_part_is_a_sentence(part: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["batch", "x.json", "--out", "y", "--units", part]) == 2
    assert f"'{part}' is no part of a batch" in capsys.readouterr().err
