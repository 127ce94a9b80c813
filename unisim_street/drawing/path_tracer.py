"""The process that draws a street with Cycles: started here, followed, and ended with us. Blender's module
is its own affair."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path

from unisim_blender.core.errors import OutputError
from unisim_blender.core.progress import Bar

MODULE = "unisim_street.cycles"


def check_blender() -> None:
    """Raise `ModuleNotFoundError` where Blender's module is not installed."""
    if find_spec("bpy") is None:
        raise ModuleNotFoundError("No module named 'bpy'", name="bpy")


@dataclass(frozen=True)
class TruthRequest:
    """A scenario whose truth is to be drawn: of which frames, with which cameras."""

    scenario: Path
    frames: tuple[int, ...]
    cameras: tuple[str, ...]


@dataclass(frozen=True)
class Order:
    """Images to draw of the street at ``out``: truths, ``width`` pixels wide if not as the log; None:
    the log's images."""

    out: Path
    truths: tuple[TruthRequest, ...] | None = None
    width: int | None = None

    def text(self) -> str:
        """The order as a JSON document."""
        return json.dumps(asdict(self), default=str)

    @staticmethod
    def from_text(text: str) -> Order:
        """The order of `text`."""
        values = json.loads(text)
        truths = values["truths"]
        if truths is not None:
            truths = tuple(TruthRequest(Path(t["scenario"]), tuple(t["frames"]), tuple(t["cameras"])) for t in truths)
        return Order(Path(values["out"]), truths, values["width"])


def draw_log(out: Path, progress: bool) -> None:
    """Draw the images that the log at ``out`` still lacks. Raises `OutputError`."""
    _run(Order(out), "images", progress)


def draw_truths(out: Path, truths: tuple[TruthRequest, ...], width: int | None, progress: bool) -> None:
    """Draw the images of scenarios' edited drives, and of the unedited one, that the street at ``out`` still lacks.

    Raises `OutputError`.
    """
    _run(Order(out, truths, width), "truths", progress)


def _run(order: Order, what: str, progress: bool) -> None:
    """Have the process draw an order; its output is told in `unisim_street.cycles.__main__`."""
    check_blender()
    problem = ""
    command = [sys.executable, "-m", MODULE, order.text()]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stdout is not None
        with Bar(desc=what, unit="image", disable=not progress) as bar:
            try:
                for line in process.stdout:
                    event = json.loads(line)
                    problem = event.get("error", problem)
                    if "total" in event:
                        bar.reset(event["total"])
                    bar.update("done" in event)
            except BaseException:
                process.kill()  # images appear whole or not at all, so nothing is lost but the one in work
                raise
    if process.returncode != 0:
        raise OutputError(problem or f"{order.out}: Cycles ended with exit code {process.returncode}")
