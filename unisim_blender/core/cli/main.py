"""The command line: finds the commands, and turns what core raises into one sentence and an exit code."""

from __future__ import annotations

import errno
import io
import os
import pkgutil
import sys
from collections.abc import Sequence
from importlib import import_module

import click

from ..errors import MAX_LETTERS, UnisimError, remedy_of, what_is_missing
from ..processes import wait_briefly
from ..registry import entries
from . import commands

DISTRIBUTION = "unisim_blender"
EXIT_ERROR = 1
EXIT_PIPE = 141
"""128 + SIGPIPE."""
EXIT_INTERRUPTED = 130
"""128 + SIGINT, as shells report it."""

GROUP = "unisim_blender.commands"
"""Entry points of packages that bring commands: a name each, and its click command."""

NAME_OF_MODULE = {"evaluate": "eval"}
"""Commands whose name would hide one of Python's own as a module's."""


class LazyGroup(click.Group):
    """A group of the modules of ``cli.commands`` and of other packages' entry points, each imported when it is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return sorted({*_modules(), *(entry.name for entry in entries(GROUP))})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of this name, or None where there is none."""
        module = _modules().get(cmd_name)
        if module is not None:
            command = import_module(f"{commands.__name__}.{module}").command
        else:
            command = next((entry.load() for entry in entries(GROUP) if entry.name == cmd_name), None)
        assert command is None or isinstance(command, click.Command), cmd_name
        return command


def _modules() -> dict[str, str]:
    """Module name of each command name."""
    modules = [info.name for info in pkgutil.iter_modules(commands.__path__) if not info.name.startswith("_")]
    return {NAME_OF_MODULE.get(module, module.replace("_", "-")): module for module in modules}


@click.command(cls=LazyGroup, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120})
@click.version_option(package_name=DISTRIBUTION, prog_name="unisim", message="%(prog)s %(version)s")
def unisim() -> None:
    """Recorded drives in, edited camera and LiDAR frames out."""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run one command and give its exit code; bad input is one sentence on stderr, the unexpected
    keeps its traceback."""
    try:
        result = unisim.main(arguments, prog_name="unisim", standalone_mode=False)
    except UnisimError as error:
        return _fail(str(error), error.remedy)
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (KeyboardInterrupt, click.Abort):
        click.echo("Interrupted.", err=True)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        return _pipe_closed()
    except OSError as error:
        sentence = _of_system(error)
        if not sentence:
            raise
        return _fail(sentence)
    except ImportError as error:
        sentence = what_is_missing(error)
        if not sentence:
            raise
        return _fail(sentence, remedy_of(error))
    return result if isinstance(result, int) else 0


def _of_system(error: OSError) -> str:
    """Return a sentence on a file that the system refuses; "" where the error names none and is none of the disk's."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return "no space is left on the disk" + (f" for {error.filename}" if error.filename else "")
    if error.errno in (errno.EMFILE, errno.ENFILE):
        return f"{error.filename or 'files'}: too many files are open; `ulimit -n` raises the limit"
    if not isinstance(error.filename, str | bytes | os.PathLike) or error.errno is None:
        return ""
    name, reason = os.fsdecode(error.filename), error.strerror or "cannot be used"
    shown = name if len(name) <= MAX_LETTERS else f"{name[:MAX_LETTERS]} …"
    return f"{shown}: {reason[0].lower()}{reason[1:]}"


def _pipe_closed() -> int:
    """Return the code of a command whose reader has gone, as `head` does; nothing more is written to it."""
    sys.stdout = open(os.devnull, "w")  # noqa: SIM115, PTH123  which the interpreter flushes at its end
    return EXIT_PIPE


def open_standard_streams() -> None:
    """Give a process that was started without standard streams, or with closed ones, streams that lead nowhere.

    Otherwise the first file that is opened has the number of stderr, and whatever a library prints goes into it. Text that
    a stream's encoding lacks is escaped.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
    if sys.stdin is None:
        sys.stdin = open(os.devnull)  # noqa: SIM115, PTH123
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115, PTH123
        elif isinstance(stream := getattr(sys, name), io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _fail(sentence: str, remedy: str = "") -> int:
    """Print why a command fails, and for Blender what mends it. Return the exit code."""
    click.echo(f"Error: {sentence}" + (f"\nRemedy: {remedy}" if remedy else ""), err=True)
    return EXIT_ERROR


def main() -> None:
    """Entry point of the console script."""
    open_standard_streams()
    wait_briefly()
    code = run()
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        code = _pipe_closed()
    except OSError as error:
        _pipe_closed()
        code = code or _fail(f"standard output cannot be written: {error.strerror}")
    sys.exit(code)
