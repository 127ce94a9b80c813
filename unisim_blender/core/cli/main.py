"""The command line: finds the commands, and turns what core raises into one sentence and an exit code."""

from __future__ import annotations

import errno
import pkgutil
import sys
from collections.abc import Sequence
from importlib import import_module

import click

from ..errors import UnisimError, what_is_missing
from ..processes import wait_briefly
from . import commands

DISTRIBUTION = "unisim_blender"
EXIT_ERROR = 1
EXIT_INTERRUPTED = 130
"""128 + SIGINT, as shells report it."""

NAME_OF_MODULE = {"evaluate": "eval"}
"""Commands whose name would hide one of Python's own as a module's."""


class LazyGroup(click.Group):
    """A group whose commands are the modules of ``cli.commands``, each imported when it is asked for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of all commands, sorted."""
        return sorted(_modules())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of this name, or None where there is none."""
        module = _modules().get(cmd_name)
        if module is None:
            return None
        command = import_module(f"{commands.__name__}.{module}").command
        assert isinstance(command, click.Command), module
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
        return _fail(str(error))
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (KeyboardInterrupt, click.Abort):
        click.echo("Interrupted.", err=True)
        return EXIT_INTERRUPTED
    except OSError as error:
        if error.errno not in (errno.ENOSPC, errno.EDQUOT):
            raise
        where = f" for {error.filename}" if error.filename else ""
        return _fail(f"no space is left on the disk{where}")
    except ImportError as error:
        sentence = what_is_missing(error)
        if not sentence:
            raise
        return _fail(sentence)
    return result if isinstance(result, int) else 0


def _fail(sentence: str) -> int:
    click.echo(f"Error: {sentence}", err=True)
    return EXIT_ERROR


def main() -> None:
    """Entry point of the console script."""
    wait_briefly()
    sys.exit(run())
