"""The command line's frame: which commands there are, and what becomes of what they raise."""

from __future__ import annotations

import importlib.metadata
import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path

import click
import pytest

from unisim_blender.core.cli import commands
from unisim_blender.core.cli.main import GROUP, run, unisim
from unisim_blender.core.registry import HERE, NAME

AddCommand = Callable[[str, str], None]


@pytest.fixture
def add_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[AddCommand]:
    """Adds a command module of a given name and body to the ones that ship."""
    monkeypatch.setattr(commands, "__path__", [*commands.__path__, str(tmp_path)])
    before = set(sys.modules)

    def add(name: str, body: str) -> None:
        head = 'import click\n\n@click.command()\ndef command():\n    """Try something."""\n'
        (tmp_path / f"{name}.py").write_text(head + textwrap.indent(textwrap.dedent(body), "    "))

    yield add
    for name in set(sys.modules) - before:
        if name.startswith(f"{commands.__name__}."):
            del sys.modules[name]


def test_a_module_is_a_command(add_command: AddCommand, capsys: pytest.CaptureFixture[str]) -> None:
    add_command("two_words", "click.echo('said')")
    assert run(["two-words"]) == 0
    assert capsys.readouterr().out == "said\n"
    assert run(["--help"]) == 0
    assert "two-words" in capsys.readouterr().out


def test_another_package_brings_a_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = """
import click


@click.command()
def fly():
    click.echo("flown")
"""
    (tmp_path / "flying.py").write_text(module)
    about = tmp_path / "flying-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: flying\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(f"[{GROUP}]\nfly = flying:fly\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert run(["fly"]) == 0 and run(["--help"]) == 0
    assert {"flown", "fly", "bench"} <= set(capsys.readouterr().out.split())


def test_the_package_knows_the_name_that_it_has_here() -> None:
    assert HERE == NAME


def test_version_is_the_distributions(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--version"]) == 0
    assert capsys.readouterr().out == f"unisim {importlib.metadata.version('unisim_blender')}\n"


def test_an_unknown_command_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["fly"]) == 2
    assert "No such command 'fly'" in capsys.readouterr().err


def test_bad_input_is_one_sentence(add_command: AddCommand, capsys: pytest.CaptureFixture[str]) -> None:
    add_command("bad", "from unisim_blender.core.errors import LogError\nraise LogError('log/meta: no poses')")
    assert run(["bad"]) == 1
    assert capsys.readouterr() == ("", "Error: log/meta: no poses\n")


def test_the_unexpected_keeps_its_traceback(add_command: AddCommand) -> None:
    add_command("broken", "return 1 / 0")
    with pytest.raises(ZeroDivisionError):
        run(["broken"])


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="this system has no /dev/full")
def test_a_full_disk_is_one_sentence(add_command: AddCommand, capsys: pytest.CaptureFixture[str]) -> None:
    add_command("fill", "with open('/dev/full', 'w', buffering=1) as file:\n    file.write('x\\n')")
    assert run(["fill"]) == 1
    assert capsys.readouterr().err == "Error: no space is left on the disk\n"


def test_a_file_that_the_system_refuses_is_one_sentence(
    add_command: AddCommand, capsys: pytest.CaptureFixture[str]
) -> None:
    add_command("missing", "open('/nonexistent/file')")
    assert run(["missing"]) == 1
    assert capsys.readouterr().err == "Error: /nonexistent/file: no such file or directory\n"


def test_other_system_errors_keep_their_traceback(add_command: AddCommand) -> None:
    add_command("odd", "raise OSError(5, 'odd')")
    with pytest.raises(OSError, match="odd"):
        run(["odd"])


def test_absent_torch_is_named(
    add_command: AddCommand, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    add_command("learn", "import torch")
    assert run(["learn"]) == 1
    assert "pip install '.[torch]' in the folder of unisim_blender's sources" in capsys.readouterr().err


@pytest.mark.skipif(os.name == "nt", reason="SIGINT is sent as POSIX does")
def test_ctrl_c_ends_with_130(tmp_path: Path) -> None:
    (tmp_path / "wait.py").write_text(
        'import click, time\n\n@click.command()\ndef command():\n    """Wait."""\n'
        "    click.echo('waiting')\n    time.sleep(60)\n"
    )
    # a shell that runs tests in the background has its children ignore the signal
    program = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "
        f"from unisim_blender.core.cli import commands, main; commands.__path__.append({str(tmp_path)!r}); "
        "import sys; sys.argv = ['unisim', 'wait']; main.main()"
    )
    command = [sys.executable, "-u", "-c", program]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"waiting\n"
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=20)
    assert process.returncode == 130
    assert b"Interrupted." in errors
    assert b"Traceback" not in errors


def _shipped() -> list[str]:
    return unisim.list_commands(click.Context(unisim))


@pytest.mark.parametrize("name", _shipped())
def test_every_command_and_option_explains_itself(name: str) -> None:
    command = unisim.get_command(click.Context(unisim), name)
    assert command is not None
    assert command.get_short_help_str()
    mute = [option.name for option in command.params if isinstance(option, click.Option) and not option.help]
    assert not mute, f"unisim {name}: options without help: {mute}"
