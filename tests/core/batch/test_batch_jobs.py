"""Jobs of a batch: sweeps fill fields by JSON pointer, and every fault names the file and the place."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from unisim_blender.core.batch.jobs import BatchJob, read_jobs
from unisim_blender.core.errors import UnisimError
from unisim_blender.core.scenario import scenario_to_json

BASE = {
    "format": "unisim-scenario", "version": 1, "name": "late car", "log": "street",
    "edits": [{"type": "retime", "actor": "car-01", "offset_s": 0.0}],
}  # fmt: skip
OFFSET = "/edits/0/offset_s"


def write(path: Path, document: Any) -> Path:
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def sweep(folder: Path, parameters: Any, **more: Any) -> Path:
    write(folder / "base.json", BASE)
    document = {
        "format": "unisim-sweep",
        "version": 1,
        "name": "late",
        "scenario": "base.json",
        "parameters": parameters,
    }
    return write(folder / "sweep.json", document | more)


def offsets(jobs: tuple[BatchJob, ...]) -> list[float]:
    return [scenario_to_json(job.scenario)["edits"][0]["offset_s"] for job in jobs]


def test_a_grid_has_every_combination(tmp_path: Path) -> None:
    parameters = {
        "offset": {"at": OFFSET, "range": {"start": 0.0, "stop": 1.0, "count": 3}},
        "who": {"at": "/edits/0/actor", "values": ["car-01", "car-02"]},
    }
    jobs = read_jobs([sweep(tmp_path, parameters, driver="idm")])
    assert [job.name for job in jobs] == [f"late-{number:04d}" for number in range(6)]
    assert offsets(jobs) == [0.0, 0.0, 0.5, 0.5, 1.0, 1.0]
    assert [job.parameters["who"] for job in jobs] == ["car-01", "car-02"] * 3
    assert {job.driver for job in jobs} == {"idm"}
    assert jobs[0].scenario.log_path == tmp_path / "street"


@pytest.mark.parametrize("method", ["random", "latin-hypercube"])
def test_draws_are_their_seeds(tmp_path: Path, method: str) -> None:
    parameters = {
        "offset": {"at": OFFSET, "uniform": [-2.0, 2.0]},
        "who": {"at": "/edits/0/actor", "values": ["car-01", "car-02", "car-03", "car-04"]},
        "frame": {"at": "/frames", "values": [[0], [1]]},
    }

    def drawn(seed: int) -> tuple[BatchJob, ...]:
        return read_jobs([sweep(tmp_path, parameters, sampling={"method": method, "count": 8, "seed": seed})])

    first = drawn(1)
    assert offsets(first) == offsets(drawn(1)) != offsets(drawn(2))
    assert len(set(offsets(first))) == 8 and all(-2 <= offset < 2 for offset in offsets(first))
    if method == "latin-hypercube":  # one draw in each eighth of a range, each choice equally often
        assert sorted(int((offset + 2) * 2) for offset in offsets(first)) == list(range(8))
        assert sorted(str(job.parameters["who"]) for job in first) == sorted(
            ["car-01", "car-02", "car-03", "car-04"] * 2
        )


def test_one_value_fills_several_fields(tmp_path: Path) -> None:
    parameters = {"offset": {"at": [OFFSET, "/edits/0/pivot_s"], "values": [0.5]}}
    with pytest.raises(UnisimError, match=r"sweep\.json: variant 0 \(offset = 0\.5\): .*base\.json: edits\[0\]"):
        read_jobs([sweep(tmp_path, parameters)])  # a pivot needs a speed: the scenario's own check
    parameters = {"offset": {"at": [OFFSET, "/description"], "values": ["no number"]}}
    with pytest.raises(UnisimError, match=r"base\.json: edits\[0\]\.offset_s: 'no number' is not of type"):
        read_jobs([sweep(tmp_path, parameters)])


@pytest.mark.parametrize(
    ("parameters", "more", "sentence"),
    [
        ({"a": {"at": "/edits/3/offset_s", "values": [1]}}, {}, r'parameters\.a\.at: "/edits/3/offset_s" leads nowhere'),
        ({"a": {"at": "edits", "values": [1]}}, {}, r"sweep\.json: parameters\.a\.at"),
        ({"a": {"at": OFFSET}}, {}, r"parameters\.a: must have one of values, range, uniform, integers"),
        ({"a": {"at": OFFSET, "uniform": [0, 1]}}, {}, r"parameters\.a\.uniform: a grid has no draws"),
        ({"a": {"at": OFFSET, "uniform": [1, 0]}}, {"sampling": {"method": "random", "count": 1}}, "lower end lies above"),
        ({"a": {"at": OFFSET, "values": [1]}}, {"sampling": {"method": "random"}}, r"sampling\.count: is missing"),
        ({"a": {"at": OFFSET, "values": [1]}}, {"nothing": 1}, r"sweep\.json.*nothing"),
        ({"a": {"at": OFFSET, "values": [1]}}, {"scenario": "none.json"}, r"none\.json: cannot be read"),
    ],
)  # fmt: skip
def test_faults_of_a_sweep_name_the_place(tmp_path: Path, parameters: Any, more: Any, sentence: str) -> None:
    with pytest.raises(UnisimError, match=sentence):
        read_jobs([sweep(tmp_path, parameters, **more)])


def test_json_lines_and_scenarios(tmp_path: Path) -> None:
    base = write(tmp_path / "base.json", BASE)
    lines = [
        {"scenario": "base.json", "set": {OFFSET: 0.25}, "driver": "idm", "seed": 7},
        {"scenario": BASE, "name": "my one/first"},
    ]
    path = tmp_path / "jobs.jsonl"
    path.write_text("\n".join(map(json.dumps, lines)) + "\n\n", encoding="utf-8")
    jobs = read_jobs([base, path], seed=3)
    assert [(job.name, job.driver, job.seed) for job in jobs] == [
        ("late-car", None, 3), ("late-car-2", "idm", 7), ("my-one-first", None, 3),
    ]  # fmt: skip
    assert offsets(jobs) == [0.0, 0.25, 0.0]


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("{", "line 1: is not valid JSON"),
        ("[]", 'line 1: must be an object with "scenario"'),
        ('{"scenario": "base.json", "sed": 1}', 'line 1: "sed" is not one of driver, name, scenario, seed, set'),
        ('{"scenario": "base.json", "seed": "x"}', 'line 1: seed: "x" is none'),
        ('{"scenario": "base.json", "set": {"/edits/0/actr": 1}}', r"line 1: .*edits\[0\].*actr"),
        ('{"scenario": "base.json", "set": {"/a/b": 1}}', 'line 1: set: "/a/b" leads nowhere'),
    ],
)
def test_faults_of_lines_name_the_line(tmp_path: Path, line: str, sentence: str) -> None:
    write(tmp_path / "base.json", BASE)
    path = tmp_path / "jobs.jsonl"
    path.write_text(line, encoding="utf-8")
    with pytest.raises(UnisimError, match=rf"jobs\.jsonl: {sentence}"):
        read_jobs([path])


def test_the_example_is_a_sweep_of_thirty() -> None:
    jobs = read_jobs([Path(__file__).parents[3] / "examples" / "cut_in.json"])
    assert len(jobs) == 30 and {job.driver for job in jobs} == {"idm"}
    document = scenario_to_json(jobs[-1].scenario)
    assert document["edits"][2]["pose"]["position"][0] == jobs[-1].parameters["ahead_m"] == 16.0
    assert document["simulation"]["actors"]["cutter"]["keys"][1]["speed_m_s"] == jobs[-1].parameters["speed_m_s"] == 8.0
