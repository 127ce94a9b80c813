"""Recall of detectors over visibility: one scenario's frames in fog, thicker each time, with the labels of clear air.

The least score is that of the best F1 in clear air. Labels are the vehicles that a detector has to find there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from unisim_blender.core.evaluation.autonomy.measure import all_matches, best_f1
from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario
from unisim_blender.core.render.captures import render_image, render_sweep, states_of
from unisim_blender.core.world.captures import Capture
from unisim_blender.core.world.weather import WeatherKeys

from .samples import Key, Sample, sample_of
from .testing import CLASS, detect, labels
from .training import Trained

LEAST_IOU = 0.3


def foggy_samples(
    scenario: Path, frames: str | None, camera: str, lidar: str, visibilities_m: Sequence[float | None]
) -> dict[float | None, dict[Key, Sample]]:
    """Render the frames of a scenario at each visibility, None without fog."""
    plan, _ = plan_scenario(scenario, RenderOptions(frames=frames))
    renderer = plan.recipe.load()
    chosen = sorted({c.frame for moment in plan.moments for c in moment.cameras if c.frame is not None})
    out: dict[float | None, dict[Key, Sample]] = {}
    for visibility_m in visibilities_m:
        keys = None if visibility_m is None else WeatherKeys({"visibility_m": ((0.0, visibility_m),)})
        states = states_of(renderer, replace(plan.drive, weather=keys))
        out[visibility_m] = {}
        for frame in tqdm(chosen, desc=f"visibility {visibility_m or 'clear'}", unit="frame", leave=False):
            image, sweep = (Capture.of_frame(s, frame) for s in (states.camera(camera), states.lidar(lidar)))
            rgb, beams = render_image(renderer, states, image).rgb, render_sweep(renderer, states, sweep, 0)
            out[visibility_m][Key(plan.drive.name, frame)] = sample_of(states.drive, frame, camera, rgb, beams)
    return out


def recalls(trained: Trained, samples: dict[float | None, dict[Key, Sample]]) -> dict[str, Any]:
    """Return recall and precision, 0 to 1, at each visibility, with the least score and the number of labels."""
    truth, threshold = labels(trained.detector, samples[None]), (LEAST_IOU,)
    _, least = best_f1(all_matches(detect(trained, samples[None]), truth, threshold, CLASS)[0])
    rows = []
    for visibility_m, frames in samples.items():
        found = all_matches(detect(trained, frames), truth, threshold, CLASS)[0]
        sure = found.scores >= least
        hits, count, named = int((found.hit & sure).sum()), float(np.sum(found.labels)), int(sure.sum())
        rows.append({
            "visibility_m": visibility_m, "recall": hits / count,
            "precision": hits / named if named else None,
        })  # fmt: skip
    return {"least_score": least, "labels": count, "iou": LEAST_IOU, "rows": rows}


def plot(results: dict[str, dict[str, Any]], path: Path) -> None:
    """Draw recall over visibility, a line for each detector; dashed: without fog."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(6, 4), layout="constrained")
    for name, result in results.items():
        rows = sorted((r for r in result["rows"] if r["visibility_m"]), key=lambda r: float(r["visibility_m"]))
        (line,) = axes.plot([r["visibility_m"] for r in rows], [r["recall"] for r in rows], "o-", label=name)
        clear = next(r["recall"] for r in result["rows"] if not r["visibility_m"])
        axes.axhline(clear, color=line.get_color(), linestyle="--", linewidth=0.8)
    axes.set(xscale="log", xlabel="visibility, m", ylabel="recall", ylim=(0, 1))
    ticks = sorted({r["visibility_m"] for result in results.values() for r in result["rows"] if r["visibility_m"]})
    axes.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.minorticks_off()
    axes.grid(alpha=0.3)
    axes.legend()
    figure.savefig(path, dpi=120)
    pyplot.close(figure)
