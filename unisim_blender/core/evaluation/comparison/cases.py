"""The cases of a comparison: the replay of frames that nobody trained on, and edits whose truth is known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...data.log import Log
from ...errors import UnisimError
from ...prepare.scenario import prepare_scenario
from ...prepare.selection import spread_frames
from ...scenario.edits import Ego
from ..ground_truth import KnownLog
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


def cases_of(log: Log, known: KnownLog | None, out: Path, options: CompareOptions) -> list[Case]:
    """Return the replay, and of a log with known ground truth the named scenarios, else the usual edits, which are written
    to ``out`` where the log has none of its own. Raises `UnisimError`."""
    training_frames = options.training_frames(log.drive)
    held_out = tuple(frame for frame in log.drive.frames if frame not in training_frames)
    if not held_out:
        raise UnisimError(f"{log.path}: --frames {options.frames} leaves no frame to compare")
    cases = [Case(REPLAY, log.path, held_out)]
    for scenario in _scenarios(log.path, known, out, options):
        prepared = prepare_scenario(scenario, refined=False)
        edits, name = prepared.scenario.edits, prepared.scenario.name
        if any(case.name == name for case in cases):
            raise UnisimError(f"{scenario}: is a second case named {name!r}")
        among = [frame for frame in prepared.edited.frames if frame not in training_frames]
        frames = spread_frames(prepared.edited, options.truth_frames, among)
        cases.append(Case(name, scenario, frames, all(isinstance(edit, Ego) for edit in edits)))
    return cases


def _scenarios(log: Path, known: KnownLog | None, out: Path, options: CompareOptions) -> tuple[Path, ...]:
    if known is None:
        if options.scenarios:
            raise UnisimError(f"{log}: has no known ground truth, so {options.scenarios[0]} cannot be compared")
        return ()
    if options.scenarios is not None:
        return options.scenarios
    return known.usual_edits(out)
