"""How long the way through the code is: files and functions that one image, a batch's unit and a short drive enter.

python tools/trips.py [SCENARIO] [--sensor NAME] [--list]

Three commands of `unisim` run in this process, each twice: the second time all modules are imported, the package's caches are
empty, and every call is counted by `sys.setprofile`, in all threads.

image    `unisim render` of one image
unit     the unit alone of `unisim batch` with one image: `Worker.run`
drive    `unisim drive` of two steps

Bodies of modules and classes, comprehensions, and what `dataclass` writes are not counted. "header" counts how often the
scene's `scene.json` is opened. "modules" are those of the package that a process of its own has imported after the command.
Prints one JSON object; `--list` adds the files by name.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import inspect
import io
import json
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import CodeType, FrameType
from typing import Any

import click

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from unisim_blender.core.cli import main  # noqa: E402

PACKAGE = f"{Path(main.__file__).parents[2]}/"
HEADER = "scene.json"
UNIT = "Worker.run"
WIDTH = "64"
COMPREHENSIONS = ("<listcomp>", "<setcomp>", "<dictcomp>", "<genexpr>")
MODULES = """
import sys
from unisim_blender.core.cli import main
main.run(sys.argv[1:])
print(sum(name.split(".")[0] == "unisim_blender" for name in sys.modules))
"""


class Trip:
    """The functions of the package that are entered, while they are counted: all, or those that functions named ``within``
    call."""

    def __init__(self, within: str | None = None) -> None:
        self.within, self.depth, self.entered, self.headers, self.modules = within, 0, set[CodeType](), 0, 0

    def profile(self, frame: FrameType, event: str, arg: object) -> None:
        """Note a call, as `sys.setprofile` tells it."""
        del arg
        code = frame.f_code
        if event not in ("call", "return") or not code.co_filename.startswith(PACKAGE):
            return
        if code.co_qualname == self.within:
            self.depth += 1 if event == "call" else -1
        is_function = code.co_flags & inspect.CO_OPTIMIZED and code.co_name not in COMPREHENSIONS
        if event == "call" and is_function and (self.within is None or self.depth):
            self.entered.add(code)

    def opened(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Note that the header is opened, as `sys.addaudithook` tells it."""
        if event == "open" and Path(str(arguments[0])).name == HEADER and (self.within is None or self.depth):
            self.headers += 1

    def files(self) -> list[str]:
        """Return the files of the functions, by the package's folder."""
        return sorted({code.co_filename.removeprefix(PACKAGE) for code in self.entered})

    def counts(self) -> dict[str, int]:
        """Return the numbers of files, functions, openings of the header, and modules."""
        files, functions = len(self.files()), len(self.entered)
        return {"files": files, "functions": functions, "header": self.headers, "modules": self.modules}


_trip: Trip | None = None
"""The trip that is counted now: a hook for audits cannot be removed."""


def _audit(event: str, arguments: tuple[Any, ...]) -> None:
    if _trip is not None:
        _trip.opened(event, arguments)


@contextlib.contextmanager
def counted(trip: Trip) -> Iterator[None]:
    """Count what is entered within it."""
    global _trip
    _trip = trip
    threading.setprofile(trip.profile)
    sys.setprofile(trip.profile)
    try:
        yield
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
        _trip = None


def clear_caches() -> None:
    """Empty the caches of the package's functions."""
    for function in gc.get_objects():
        if isinstance(function, functools._lru_cache_wrapper) and function.__module__.startswith("unisim_blender"):
            function.cache_clear()


def trip_of(arguments: Callable[[Path], Sequence[object]], within: str | None = None) -> Trip:
    """Return the trip of a command of `unisim`, whose arguments are for a folder to write."""
    trip = Trip(within)
    for context in (contextlib.nullcontext(), counted(trip)):
        clear_caches()
        with tempfile.TemporaryDirectory(prefix="unisim-trip-") as folder:
            text = [str(one) for one in arguments(Path(folder) / "out")]
            output = io.StringIO()
            with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output), context:
                code = main.run(text)
            if code:
                raise click.ClickException(f"unisim {' '.join(text)}: {output.getvalue()}")
    trip.modules = modules_of(arguments)
    return trip


def modules_of(arguments: Callable[[Path], Sequence[object]]) -> int:
    """Return the number of the package's modules that a command has imported at its end."""
    with tempfile.TemporaryDirectory(prefix="unisim-trip-") as folder:
        text = [str(one) for one in arguments(Path(folder) / "out")]
        done = subprocess.run(
            [sys.executable, "-c", MODULES, *text], cwd=ROOT, capture_output=True, text=True, check=True
        )
    return int(done.stdout.split()[-1])


@click.command()
@click.argument("scenario", default=ROOT / "sample/scenario.json", type=click.Path(exists=True, path_type=Path))
@click.option("--sensor", default="front_camera", show_default=True, help="The camera that is rendered.")
@click.option("--list", "listed", is_flag=True, help="Add the files by name.")
def command(scenario: Path, sensor: str, listed: bool) -> None:
    """Count the trips of a SCENARIO with a trained scene."""
    sys.addaudithook(_audit)
    common = (scenario, "--sensors", sensor, "--width", WIDTH, "--quality", "fast")
    trips = {
        "image": trip_of(lambda out: ("render", *common, "--frames", 5, "--jobs", 1, "--out", out)),
        "unit": trip_of(
            lambda out: ("batch", *common, "--frames", 5, "--jobs", 1, "--on", "this-process", "--out", out), UNIT
        ),
        "drive": trip_of(lambda out: ("drive", *common, "--driver", "constant", "--duration", 0.2, "--out", out)),
    }
    print(
        json.dumps(
            {name: {**trip.counts(), **({"list": trip.files()} if listed else {})} for name, trip in trips.items()},
            indent=1,
        )
    )


if __name__ == "__main__":
    command()
