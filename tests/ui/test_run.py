"""What `run.py` says of sessions' results."""

from __future__ import annotations

import ast
import importlib.util
import json
import re
from pathlib import Path
from typing import Any

import pytest

HERE = Path(__file__).parent
PACKAGE = HERE.parents[1] / "unisim_blender"
NAMED = re.compile(
    r'(?:(?<!, )\b(\w+)(?:: Any)? = )?sys\.modules(?:\.get\(|\[)f"\{MODULE\}\.([a-z_.]+)"[\])](?:\.(\w+))?'
)
"""A module of the extension as the sessions take it: the variable that it becomes, its name, an attribute of it."""
TOOK = {
    "steps": 1, "presses": 1, "seconds": 1.0, "without_waiting_s": 1.0, "longest_block_s": 0.1, "redraw_s": 0.1,
    "ours_s": 0.0,
}  # fmt: skip


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


def defined(module: str) -> set[str] | None:
    """Return the names that a module of the package defines or imports; None where there is no such module."""
    path = PACKAGE.joinpath(*module.split("."))
    file = next((p for p in (path.with_suffix(".py"), path / "__init__.py") if p.is_file()), None)
    if file is None:
        return None
    names = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names |= {alias.asname or alias.name for alias in node.names}
    return names


def missing(text: str) -> list[str]:
    """Return the modules, and the attributes of modules, that a session names and the package lacks."""
    lacks = []
    for variable, module, attribute in NAMED.findall(text):
        names = defined(module)
        attributes = (
            {attribute} if attribute else set(re.findall(rf"(?<![\w.]){variable}\.(\w+)", text) if variable else ())
        )
        lacks += [module] if names is None else [f"{module}.{name}" for name in attributes - names]
    return lacks


@pytest.mark.parametrize("session", sorted(set(HERE.glob("*.py")) - {Path(__file__)}), ids=lambda path: path.stem)
def test_sessions_name_what_is_there(session: Path) -> None:
    assert missing(session.read_text()) == []


def test_a_module_that_went_is_missing() -> None:
    text = 'views = sys.modules[f"{MODULE}.viewport.views"]\nviews.Gone, views.VIEWS\nsys.modules[f"{MODULE}.gone"].a\n'
    assert missing(text) == ["viewport.views.Gone", "gone"]
