"""The sample, from its recipe to images: a street's log, a scenario of edits rendered, measured against the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from unisim_blender.core.errors import ScenarioError
from unisim_blender.core.evaluation.recorded_runs import EvaluationOptions, Progress, trained_frames
from unisim_blender.core.evaluation.truth_runs import evaluate_scenario
from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario
from unisim_blender.core.scenario import load_scenario
from unisim_blender.core.scenario.types import StreetLog
from unisim_blender.core.sequence.plan import RenderPlan
from unisim_blender.core.sequence.run import render_sequence

MakeLog = Callable[[Path, dict[str, float | str]], object]
"""Writes a street's log to a folder, with the options of `unisim synth`."""


@dataclass(frozen=True)
class DemoResult:
    """The metrics against the truth, and where things were written."""

    metrics: dict[str, Any]
    frames: tuple[int, ...]
    rendered: Path
    contact_sheet: Path
    page: Path


def run_demo(
    scenario: Path,
    out: Path,
    count: int,
    jobs: int,
    make_log: MakeLog,
    say: Callable[[str], object],
    progress: Progress,
) -> DemoResult:
    """Render ``count`` frames of a scenario on a street and compare them with the truth; ``say`` is told each step.

    The street's log is made with ``make_log`` where it is missing, and frames that are there already are kept.
    Raises `UnisimError`.
    """
    log = ensure_street_log(scenario, make_log, say)
    plan, prepared = plan_scenario(scenario, RenderOptions())
    assert prepared.scene is not None
    frames = demo_frames(plan, trained_frames(prepared.scene.header), count)
    text = ",".join(map(str, frames))
    plan, _ = plan_scenario(scenario, RenderOptions(frames=text))
    say(f"Rendering the edited drive, frames {text}")
    render_sequence(plan, out / "frames", jobs, resume=True)
    say("Comparing with the truth of the edit")
    metrics = evaluate_scenario(log, scenario, out / "truth", EvaluationOptions(frames=text), progress)
    return DemoResult(
        metrics, frames, out / "frames", out / "truth" / "contact_sheet.png", out / "truth" / "index.html"
    )


def ensure_street_log(scenario: Path, make_log: MakeLog, say: Callable[[str], object]) -> Path:
    """The folder of the scenario's street log, made from the scenario's recipe where it is missing.
    Raises `UnisimError`."""
    document = load_scenario(scenario)
    if not isinstance(document.log, StreetLog):
        raise ScenarioError(f"{scenario}: log: is no street, so there is no truth to compare with")
    path = document.log_path
    if not (path / "meta" / "timestamps.json").is_file():
        say(f"Making the street's log: {path}")
        make_log(path, document.log.street)
    return path


def demo_frames(plan: RenderPlan, trained: tuple[int, ...], count: int) -> tuple[int, ...]:
    """``count`` of the plan's frames, evenly spread, of those that were not trained on where there are any."""
    frames = [frame for frame in plan.frames if frame not in trained] or list(plan.frames)
    step = max(1, (len(frames) - 1) // max(1, count - 1)) if count > 1 else 1
    return tuple(frames[::step][:count])
