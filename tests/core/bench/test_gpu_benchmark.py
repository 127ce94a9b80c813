"""The command for a GPU: that its stages are there, that it tells what fails, and that kernels are held
to their bounds."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from driver_on_cpu import build_driver, loaded_driver, torch_on_driver

from benchmarks.gpu import Run, size_of, summary
from benchmarks.gpu_stages import cases, kernels, scenes, times
from benchmarks.gpu_stages.machine import machine
from benchmarks.gpu_stages.settings import Findings, Settings
from benchmarks.gpu_stages.street import make_street
from benchmarks.gpu_stages.times import interleaved

ROOT = Path(__file__).resolve().parents[3]


def settings(folder: Path, size: tuple[int, int] = (32, 18), limit_s: float = 600.0) -> Settings:
    return Settings("cpu", size, 4, 0.5, 40, 1, str(folder), str(folder), limit_s)


def test_settings_travel_to_a_stage(tmp_path: Path) -> None:
    told = settings(tmp_path, limit_s=7.0)
    assert Settings.from_json(told.to_json()) == told
    assert size_of(None, None, "1920x1080") == (1920, 1080)


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if shutil.which("g++") is None:
        pytest.skip("the driver is compiled by g++")
    return build_driver(tmp_path_factory.mktemp("driver"))


@pytest.fixture
def driver(built: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Kernels are launched by a driver whose GPU is the CPU."""
    with loaded_driver(built, monkeypatch), torch_on_driver(monkeypatch):
        yield


def test_every_kernel_is_compared(driver: None, tmp_path: Path) -> None:
    found = Findings(tmp_path / "kernels.json", 120.0)
    kernels.compare_kernels(settings(tmp_path), found)
    assert found.values["not_launched"] == [] and found.values["wrong"] == []
    assert set(found.values["launched"]) >= {"encode", "encode_table_gradient", "field", "gather_gradients"}
    written = json.loads((tmp_path / "kernels.json").read_text())
    assert {"value", "gradient of the table", "gradient of points"} == set(written["cases"]["small: encode, static"])


def test_a_kernel_that_is_wrong_is_told_of(driver: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cases, "cases", lambda device, samples: [("a", wrong), ("b", broken)])
    found = Findings(tmp_path / "kernels.json", 60.0)
    with pytest.raises(ValueError, match="a: value"):
        kernels.compare_kernels(settings(tmp_path), found)
    assert "ZeroDivisionError" in found.values["errors"]["b"] and "weigh" in found.values["not_launched"]


def wrong() -> dict[str, dict[str, Any]]:
    want = torch.ones(4, dtype=torch.float64)
    return {"value": kernels.held_against(want.float() + 1e-3, want, want.float())}


def broken() -> dict[str, dict[str, Any]]:
    raise ZeroDivisionError


def test_what_is_not_a_number_is_in_no_bound() -> None:
    want = torch.ones(3, dtype=torch.float64)
    assert kernels.held_against(want.float(), want, want.float())["pass"]
    assert not kernels.held_against(want.float() * torch.nan, want, want.float())["pass"]
    assert not kernels.apart(want * torch.nan, want, 1e-3)["pass"]


def test_without_a_gpu_kernels_are_left_out(tmp_path: Path) -> None:
    found = Findings(tmp_path / "kernels.json", 60.0)
    kernels.compare_kernels(settings(tmp_path), found)
    assert "no kernels for GPUs run on cpu" in found.values["skipped"]


def test_a_street_is_made_and_trained_on(tmp_path: Path) -> None:
    told = settings(tmp_path, size=(64, 36))
    make_street(told, Findings(tmp_path / "street.json", 60.0))
    found = Findings(tmp_path / "train.json", 60.0)
    scenes.train_scene(told, found, "tiny")
    assert found.values["steps"] > 0 and found.values["psnr_db"] > 3 and found.values["last"]["loss"] > 0
    assert "held out" in summary("train-tiny", found.values)
    timed = Findings(tmp_path / "tracer.json", 60.0)
    times.time_tracer(told, timed, "tiny")
    assert set(timed.values["images"]) == {1280, 1920} and timed.values["sweep"]["ms"] > 0
    assert "1920 wide" in summary("tracer-tiny", timed.values)


def test_a_time_that_is_up_leaves_one_round() -> None:
    calls: list[int] = []
    found = interleaved("cpu", lambda: calls.append(1), 5, float("inf"))
    assert len(calls) == 12 and found["kernels"]["rounds"] == 5 and "ratio" in found
    assert interleaved("cpu", lambda: None, 5, 0.0) == {}


def test_the_machine_is_told_of(tmp_path: Path) -> None:
    found = Findings(tmp_path / "machine.json", 60.0)
    machine(settings(tmp_path), found)
    assert found.values["torch"] == torch.__version__ and len(found.values["source_hash"]) == 16


def test_a_stage_that_fails_leaves_its_traceback(tmp_path: Path) -> None:
    run = Run(settings(tmp_path), 600.0)
    assert not run.stage("train-tiny")  # there is no street
    written = json.loads((tmp_path / "gpu.json").read_text())
    assert written["failed"] == ["train-tiny"] and "Traceback" in written["stages"]["train-tiny"]["error"]


def test_a_stage_whose_time_is_over_is_ended(tmp_path: Path) -> None:
    run = Run(settings(tmp_path), 0.1)
    assert not run.stage("machine")
    assert "its time was over" in run.values["stages"]["machine"]["error"]


def test_the_command_is_started_both_ways() -> None:
    for command in (["benchmarks/gpu.py"], ["-m", "benchmarks.gpu"]):
        told = subprocess.run(
            [sys.executable, *command, "--help"], cwd=ROOT, capture_output=True, text=True, check=True
        )
        assert "--budget-s" in told.stdout
