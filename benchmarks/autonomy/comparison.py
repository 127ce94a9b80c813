"""What the stack answers on some sensors beside the truth, and beside what it answers on others."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.detection.testing import CLASS
from unisim_blender.core.evaluation.autonomy.document import ModelOutputs
from unisim_blender.core.evaluation.autonomy.measure import (
    AGREEMENT_IOU,
    all_matches,
    best_f1,
    confident,
    end_point_error,
    forecasts,
    interval,
    measure,
    precision,
)
from unisim_blender.core.geometry import FloatArray

NEAR_M = 1.0
"""Plans that end nearer together are counted as the same."""
RESAMPLES = 10_000


def beside_truth(outputs: ModelOutputs, labels: ModelOutputs) -> dict[str, Any]:
    """Return AP and minADE of outputs beside labels, see `measure`."""
    found = measure(outputs, labels)
    found.pop("plans", None)  # labels have none of their own
    return found


def beside_others(outputs: ModelOutputs, reference: ModelOutputs, labels: ModelOutputs) -> dict[str, Any]:
    """Return how far outputs agree with those on other sensors: AP of their detections with the others' as labels, the minADE
    between both's forecasts, and how far apart plans end after 5 s.

    The others' detections are those of the least score of their best F1 beside ``labels`` (supplementary 3.3).
    """
    _, least = best_f1(all_matches(reference, labels, (AGREEMENT_IOU,), CLASS)[0])
    seen = confident(reference, least if np.isfinite(least) else 0.0)
    ends = end_points(outputs, reference)
    drawn = np.random.default_rng(0).integers(len(ends), size=(RESAMPLES, len(ends)))
    return {
        "agreement": precision(outputs, seen, (AGREEMENT_IOU,), CLASS).metrics(),
        "forecasts": forecasts(outputs, seen, CLASS),
        "plans": {
            "frames": len(ends),
            "end_point_error_m": float(ends.mean()),
            "interval": interval(ends[drawn].mean(1)),
            "median_m": float(np.median(ends)),
            "greatest_m": float(ends.max()),
            "near": float((ends < NEAR_M).mean()),
            "by_frame_m": [round(end, 3) for end in ends.tolist()],
        },
    }


def end_points(outputs: ModelOutputs, reference: ModelOutputs) -> FloatArray:
    """Return how far apart the plans of each frame end (F,), metres."""
    pairs = [(outputs.frames[key].plan, other.plan) for key, other in reference.frames.items()]
    return np.array([end_point_error(one, other) for one, other in pairs if one is not None and other is not None])


def lines(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Return the metrics of rows, which have ``truth`` and, where they are compared, ``reference`` and ``others``, as tables."""
    found = ["| | detections | AP at IoU 0.3 | AP at IoU 0.7 | minADE, m |", "|---|---|---|---|---|"]
    for name, row in rows.items():
        one = row["truth"]["classes"][CLASS]
        ade = one.get("forecasts", {}).get("min_ade_m")
        cells = [one["detections"], _ap(one["ap@0.3"]), _ap(one["ap@0.7"]), "-" if ade is None else f"{ade:.3f}"]
        found.append(f"| {name} | {' | '.join(map(str, cells))} |")
    found += [
        "",
        "| | beside | agreement | minADE, m | plans after 5 s: mean, m | median | most | within 1 m |",
        "|---" * 8 + "|",
    ]
    for name, row in rows.items():
        if "others" not in row:
            continue
        one, plans = row["others"], row["others"]["plans"]
        low, high = plans["interval"]
        cells = [
            row["reference"], _ap(one["agreement"]["ap@0.3"]), f"{one['forecasts']['min_ade_m']:.3f}",
            f"{plans['end_point_error_m']:.2f} ({low:.2f} to {high:.2f})", f"{plans['median_m']:.2f}",
            f"{plans['greatest_m']:.1f}", f"{round(plans['near'] * plans['frames'])} of {plans['frames']}",
        ]  # fmt: skip
        found.append(f"| {name} | {' | '.join(cells)} |")
    return found


def _ap(score: Mapping[str, Any]) -> str:
    if score["value"] is None:
        return "-"
    low, high = (100 * end for end in score["interval"])
    return f"{100 * score['value']:.1f} ({low:.1f} to {high:.1f})"
