"""The formats of runs. Another is a module beside `mcap`, a line here, and its name among a scenario's formats."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import OutputError
from ..formats.coco.write import COCO
from ..formats.common.run_format import RunFormat
from ..formats.mcap.write import MCAP
from ..formats.rosbag.write import ROSBAG
from ..prepare.scenario_plan import sequence_formats
from ..sequence.plan import SequenceSettings
from .finished_run import FinishedRun

if TYPE_CHECKING:  # a sequence's formats need no simulation
    from ..simulation.rollout.opening import OpenedScenario

RUN_FORMATS: dict[str, RunFormat] = {one.name: one for one in (MCAP, ROSBAG, COCO)}

SENSORS = {"png": "cameras", "npz": "lidars"}
"""Formats of frames that runs without such sensors do without."""


def check_run_formats(names: Iterable[str], settings: SequenceSettings, place: Path | str) -> None:
    """Check that formats can be written of what is going to be rendered of the scenario at ``place``; names of other formats are
    passed over. Raises `OutputError` where files of frames would be missing, ModuleNotFoundError where a package is."""
    for name in names:
        if name not in RUN_FORMATS:
            continue
        for module in RUN_FORMATS[name].modules:
            import_module(module)
        for need in RUN_FORMATS[name].needs:
            if need not in settings.formats and (need not in SENSORS or getattr(settings, SENSORS[need])):
                raise OutputError(
                    f"{place}: the format {name} is made of {need} files, and the scenario's formats lack them"
                )


def write_run(name: str, folder: Path, images: Mapping[str, str] | None = None) -> Path:
    """Write the run in a finished folder in a format of `RUN_FORMATS`, into that folder; the path. ``images``: see `FinishedRun`.
    Raises `UnisimError`."""
    form = RUN_FORMATS[name]
    form.write(FinishedRun(folder, images), folder / form.output)
    return folder / form.output


def write_runs(names: Iterable[str], folder: Path) -> None:
    """Write the run in a finished folder in several formats; names of other formats are passed over. Raises `UnisimError`."""
    for name in names:
        if name in RUN_FORMATS:
            write_run(name, folder)


@dataclass(frozen=True)
class RolloutFormats:
    """The formats that rollouts are written in: those ``asked`` for, and their scenario's. It pickles."""

    asked: tuple[str, ...] = ()

    def __call__(self, opened: OpenedScenario) -> Callable[[Path], None]:
        """Return what writes a finished rollout of a scenario in them. Raises as `check_run_formats` does."""
        names = tuple(name for name in RUN_FORMATS if name in {*sequence_formats(opened.scenario), *self.asked})
        check_run_formats(names, opened.plan.settings, opened.scenario.path)
        return partial(write_runs, names)
