"""Progress into a file or a pipe is lines, few of them; in a terminal a bar is redrawn."""

from __future__ import annotations

import io
import subprocess
import sys
from pathlib import Path

import pytest
from small_log import write_small_log

from unisim_blender.core import progress
from unisim_blender.core.progress import Bar

RUN = "import sys; from unisim_blender.core.cli.main import run; sys.exit(run(sys.argv[1:]))"


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_many_steps_are_few_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr("unisim_blender.core.progress.time.monotonic", lambda: clock[0])
    file = io.StringIO()
    with Bar(
        total=1000, unit="frame", file=file, dynamic_ncols=True, bar_format="{percentage:5.1f}% |{bar}| {postfix}"
    ) as bar:
        for step in range(1000):
            clock[0] += 0.1
            bar.update()
            bar.set_postfix_str(f"step {step}")
    lines = file.getvalue().splitlines()
    assert 3 <= len(lines) <= 100 / progress.LINE_INTERVAL_S + 1, lines
    assert lines[-1].startswith("100.0%") and "step 999" in lines[-1]
    assert "\r" not in file.getvalue() and "|" not in file.getvalue()


def test_a_terminal_is_redrawn() -> None:
    file = Terminal()
    for _ in Bar(range(3), file=file, mininterval=0):
        pass
    assert "\r" in file.getvalue() and "3/3" in file.getvalue()


def test_what_is_over_at_once_says_one_line_and_what_never_began_none() -> None:
    file = io.StringIO()
    assert list(Bar(range(3), desc="drawing", file=file)) == [0, 1, 2]
    assert file.getvalue().count("\n") == 1 and file.getvalue().startswith("drawing: 100% 3/3")
    with Bar(total=1.0, file=file) as bar:
        bar.refresh()
    assert file.getvalue().count("\n") == 1
    with Bar(total=1.0, file=file, disable=True) as bar:
        bar.update()
    assert file.getvalue().count("\n") == 1


def test_a_training_into_a_file_is_a_few_lines(tmp_path: Path) -> None:
    write_small_log(tmp_path / "log")
    arguments = [
        "train",
        str(tmp_path / "log"),
        "--out",
        str(tmp_path / "scene"),
        "--preset",
        "tiny",
        "--iterations",
        "30",
    ]
    done = subprocess.run([sys.executable, "-c", RUN, *arguments], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert "\r" not in done.stderr and 1 <= len(done.stderr.splitlines()) < 20
    assert "step 30" in done.stderr
