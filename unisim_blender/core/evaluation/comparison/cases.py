"""The cases of a comparison: the replay of frames that nobody trained on, and edits whose truth is known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from unisim_street.street import RECIPE_FILE, Street, load_street
from unisim_street.usual_edits import FOLDER, spread_frames, write_scenarios

from ...data.log import Log
from ...errors import UnisimError
from ...prepare.scenario import prepare_scenario
from ...scenario.edits import Ego
from ...world.drive import Drive
from .methods import CompareOptions

REPLAY = "replay"


@dataclass(frozen=True)
class Case:
    """``scenario`` is its file, of the replay the log's folder; ``frames`` are compared; ``moves_view`` says that it edits
    nothing but where the vehicle drives."""

    name: str
    scenario: Path
    frames: tuple[int, ...]
    moves_view: bool = False


def street_at(log: Path) -> Street | None:
    """The street that a log was made of; None of a real one. Raises `UnisimError`."""
    return load_street(log) if (log / RECIPE_FILE).is_file() else None


def cases_of(log: Log, street: Street | None, out: Path, options: CompareOptions) -> list[Case]:
    """The replay, and on a street the wished scenarios, or the usual edits, which are written to ``out`` where the log has none
    of its own. Raises `UnisimError`."""
    training_frames = options.training_frames(log.drive)
    held_out = tuple(frame for frame in log.drive.frames if frame not in training_frames)
    if not held_out:
        raise UnisimError(f"{log.path}: --frames {options.frames} leaves no frame to compare")
    cases = [Case(REPLAY, log.path, held_out)]
    for scenario in _scenarios(log.path, street, out, options):
        prepared = prepare_scenario(scenario, refined=False)
        edits, name = prepared.scenario.edits, prepared.scenario.name
        if any(case.name == name for case in cases):
            raise UnisimError(f"{scenario}: is a second case named {name!r}")
        frames = _spread(prepared.edited, training_frames, options.truth_frames)
        cases.append(Case(name, scenario, frames, all(isinstance(edit, Ego) for edit in edits)))
    return cases


def _scenarios(log: Path, street: Street | None, out: Path, options: CompareOptions) -> tuple[Path, ...]:
    if street is None:
        if options.scenarios:
            raise UnisimError(f"{log}: is no street, so {options.scenarios[0]} has no truth to compare with")
        return ()
    if options.scenarios is not None:
        return options.scenarios
    return tuple(sorted((log / FOLDER).glob("*.json"))) or write_scenarios(street, out, log)


def _spread(edited: Drive, training_frames: tuple[int, ...], count: int) -> tuple[int, ...]:
    """Return at most ``count`` numbers of frames, evenly spread over an edited drive, that were not trained on. Where
    every frame was, they are chosen among all."""
    return spread_frames(edited, count, [frame for frame in edited.frames if frame not in training_frames])
