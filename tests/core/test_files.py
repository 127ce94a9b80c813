"""Output folders are held by one process, digests follow the content of files, and the command says what the system refuses."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from small_log import small_drive, write_small_log

from unisim_blender.core import files
from unisim_blender.core.cli.main import run
from unisim_blender.core.convert import unfinished_folder
from unisim_blender.core.errors import OutputError
from unisim_blender.core.files import content_digests, hold_folder

HOLDS = """
import sys, time
from pathlib import Path
from unisim_blender.core.files import hold_folder
with hold_folder(Path(sys.argv[1])):
    print("held", flush=True)
    time.sleep(60)
"""
posix = pytest.mark.skipif(sys.platform == "win32", reason="signals and permissions of POSIX")


def other_process(folder: Path) -> subprocess.Popen[str]:
    """A process that holds a folder until it is killed."""
    process = subprocess.Popen([sys.executable, "-c", HOLDS, str(folder)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "held\n"
    return process


@posix
def test_a_folder_is_held_by_one_process_until_that_is_killed(tmp_path: Path) -> None:
    out, link = tmp_path / "out", tmp_path / "link"
    process = other_process(out)
    link.symlink_to(out)
    try:
        for name in (out, tmp_path / "there" / ".." / "out", link):
            (tmp_path / "there").mkdir(exist_ok=True)
            with pytest.raises(OutputError, match="another process is writing into this folder"), hold_folder(name):
                raise AssertionError("held twice")
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
    with hold_folder(out), hold_folder(link):  # this process may hold it several times
        assert not list(out.iterdir()), "a lock leaves no file in the folder"


@posix
@pytest.mark.parametrize("command", ["render", "convert", "train", "drive", "eval", "synth"])
def test_commands_leave_a_held_folder_alone(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    log, out = tmp_path / "log", tmp_path / "out"
    write_small_log(log, small_drive())
    surfels = ["--renderer", "surfel", "--quality", "fast", "--sensors", "front_camera"]
    arguments = {
        "render": [str(log), "--jobs", "1", *surfels],
        "convert": [str(log), "--to", "ncore"],
        "train": [str(log), "--preset", "tiny", "--iterations", "1", "--lidars", "all"],
        "drive": [str(log), "--driver", "log", *surfels],
        "eval": [str(log), str(log)],
        "synth": ["--frames", "2", "--width", "32"],
    }[command]
    process = other_process(unfinished_folder(out) if command == "convert" else out)
    try:
        where = [str(out)] if command == "synth" else ["--out", str(out)]
        assert run([command, *arguments, *where]) == 1
    finally:
        process.kill()
        process.wait()
    assert "another process is writing into this folder" in capsys.readouterr().err
    assert not out.exists() or not list(out.iterdir())


def test_a_folder_that_stays_empty_is_removed_and_one_that_was_there_is_not(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    for name in ("there", "new"):
        with hold_folder(tmp_path / name):
            pass
    assert [path.name for path in tmp_path.iterdir()] == ["there"]
    with hold_folder(tmp_path / "new"):
        (tmp_path / "new" / "file").touch()
    assert (tmp_path / "new" / "file").exists()


@pytest.fixture
def settled(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A cache of the test's own, and a clock by which files were written long ago."""
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(files, "FRESH_NS", -(10**18))


def test_digests_follow_content_of_equal_size_and_time(tmp_path: Path, settled: None) -> None:
    file = tmp_path / "sweep.bin"
    np.zeros(9).tofile(file)
    before, times = content_digests([file]), file.stat()
    np.ones(9).tofile(file)
    os.utime(file, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert content_digests([file]) != before
    np.zeros(9).tofile(file)
    assert content_digests([file]) == before


def test_a_file_is_read_again_only_after_it_was_written(
    tmp_path: Path, settled: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths, read = [tmp_path / "a", tmp_path / "b"], []
    for path in paths:
        path.write_text(path.name)
    whole = files.sha256_of_file

    def counted(path: Path) -> str:
        read.append(path)
        return whole(path)

    monkeypatch.setattr(files, "sha256_of_file", counted)
    first = content_digests(paths)
    paths[1].write_text("c")
    assert content_digests(paths) != first and read == [*paths, paths[1]]


def test_what_was_just_written_is_read_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two writes within a tick of the file system's clock leave the same times."""
    monkeypatch.setenv("UNISIM_CACHE", str(tmp_path / "cache"))
    file = tmp_path / "a"
    file.write_text("a")
    monkeypatch.setattr(
        files, "file_stamp", lambda path: (1, 1, path.stat().st_mtime_ns, path.stat().st_mtime_ns // 10**12)
    )
    content_digests([file])
    stored = list((tmp_path / "cache" / "digests").glob("*.json"))
    assert all(path.read_text() == "{}" for path in stored)


LONG = "x" * 300


REFUSED: tuple[tuple[str, ...], ...] = (
    ("info", "closed/log"),
    ("info", LONG),
    ("info", "loop"),
    ("render", "closed/log", "--out", "a"),
    ("render", "log", "--renderer", "surfel", "--out", "closed/a"),
    ("render", "log", "--renderer", "surfel", "--out", "file/a"),
    ("render", "log", "--renderer", "surfel", "--out", LONG),
    ("convert", "log", "--to", "ncore", "--out", "closed/a"),
    ("convert", "log", "--to", "ncore", "--out", "file/a"),
    ("train", "log", "--out", "readonly/a", "--preset", "tiny", "--iterations", "1"),
    ("eval", "closed/scene", "log", "--out", "a"),
    ("drive", "log", "--driver", "log", "--renderer", "surfel", "--out", "closed/a"),
    ("synth", "closed/a", "--frames", "2", "--width", "64"),
    ("metrics", "closed/a.json", "log"),
    ("serve", "closed/a"),
    ("batch", "closed/a.json", "--out", "a"),
    ("compare", "log", "--out", "file/a"),
    ("bench", "--scene", "closed/a", "--out", "b"),
)
RUNS = """
import contextlib, io, json, sys, traceback
from unisim_blender.core.cli.main import run
for arguments in json.loads(sys.argv[1]):
    output, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(errors):
        try:
            status = run(arguments)
        except Exception:
            status = traceback.print_exc()
    print(json.dumps([status, errors.getvalue()]))
"""


@pytest.fixture(scope="module")
def refusals(tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[str, ...], tuple[int | None, str]]:
    """Exit status and errors of each of `REFUSED`, all in one process that keeps to permissions; None for a traceback."""
    folder = tmp_path_factory.mktemp("refused")
    write_small_log(folder / "log", small_drive())
    for name in ("closed", "readonly"):
        (folder / name).mkdir()
    (folder / "file").touch()
    (folder / "loop").symlink_to("loop")
    (folder / "closed").chmod(0o000)
    (folder / "readonly").chmod(0o555)
    # root passes every permission, unless it gives that up
    caps = "-dac_override,-dac_read_search"
    unprivileged = ["setpriv", f"--bounding-set={caps}", f"--inh-caps={caps}"] if os.geteuid() == 0 else []
    command = [*unprivileged, sys.executable, "-c", RUNS, json.dumps(REFUSED)]
    try:
        done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    finally:
        (folder / "closed").chmod(0o755)
    assert done.returncode == 0, done.stderr
    return dict(zip(REFUSED, (tuple(json.loads(line)) for line in done.stdout.splitlines()), strict=True))


@posix
@pytest.mark.parametrize("arguments", REFUSED, ids=lambda arguments: " ".join(arguments)[:40])
def test_paths_that_the_system_refuses_are_one_sentence(
    arguments: tuple[str, ...], refusals: dict[tuple[str, ...], tuple[int | None, str]]
) -> None:
    status, errors = refusals[arguments]
    assert status in (1, 2) and "Traceback" not in errors, errors
    assert errors.splitlines()[-1].startswith("Error: "), errors


@posix
@pytest.mark.parametrize("closed", ["2>&-", ">&- 2>&-", "<&-", "<&- >&- 2>&-"])
def test_commands_work_without_standard_streams(closed: str, tmp_path: Path) -> None:
    write_small_log(tmp_path / "log", small_drive())
    command = f"{sys.executable} -m unisim_blender convert log --to ncore --out out {closed}"
    assert subprocess.run(["/bin/sh", "-c", command], cwd=tmp_path, check=False).returncode == 0
    written = [path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert written and not any(b"images and sweeps" in data for data in written)


@posix
def test_a_reader_that_goes_ends_a_command_quietly(tmp_path: Path) -> None:
    write_small_log(tmp_path / "log", small_drive())
    command = f"{sys.executable} -m unisim_blender info log | true"
    done = subprocess.run(["/bin/sh", "-c", command], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.stderr == ""
