"""What `run.py` says of sessions' results."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest

TOOK = {"presses": 1, "seconds": 1.0, "longest_block_s": 0.1, "redraw_s": 0.1, "ours_s": 0.0}


def judge(out: Path, sessions: dict[str, dict[str, Any]]) -> int:
    """What `run.judge` returns for sessions with these tasks."""
    spec = importlib.util.spec_from_file_location("ui_run", Path(__file__).with_name("run.py"))
    assert spec is not None and spec.loader is not None
    run = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(run)
    for name, tasks in sessions.items():
        (out / f"{name}.json").write_text(json.dumps({"done": True, "tasks": tasks}))
    return int(run.judge(out, list(sessions)))


def test_passed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert judge(tmp_path, {"person": {"one": TOOK}, "motion": {"two": TOOK}}) == 0
    assert set(json.loads((tmp_path / "tasks.json").read_text())) == {"one", "two"}
    assert "Error" not in capsys.readouterr().out


def test_same_name(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A task's name that two sessions use is refused, and the failure of the first one is told."""
    failed = {**TOOK, "failed": "the import does not end"}
    assert judge(tmp_path, {"person": {"one": failed}, "motion": {"one": TOOK}}) == 1
    said = capsys.readouterr().out
    assert "Error: one: is a task of person and of motion" in said
    assert "Error: one: the import does not end" in said


def test_same_name_of_passed_tasks(tmp_path: Path) -> None:
    assert judge(tmp_path, {"person": {"one": TOOK}, "motion": {"one": TOOK}}) == 1
