"""Detections of a trained detector, and what they tell of simulated frames beside real ones.

Real2Sim: trained on real frames, tested on simulated ones; Sim2Real: the other way round; agreement: AP of the
detections on simulated frames with those on real ones as labels (supplementary 3.2, 3.3). Labels are always those of
the real frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from tqdm import tqdm

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.evaluation.autonomy.document import FrameKey, FrameOutput, ModelOutputs
from unisim_blender.core.evaluation.autonomy.measure import (
    AGREEMENT_IOU,
    Precision,
    all_matches,
    best_f1,
    confident,
    default_ious,
    interval,
    precision,
    units_of,
)
from unisim_blender.core.geometry import FloatArray

from .detector import Detector, decode
from .samples import Key, Sample
from .training import Trained

CLASS = "vehicle"
Samples = Mapping[Key, Sample]


@torch.no_grad()
def detect_in(trained: Trained, sample: Sample) -> tuple[FloatArray, FloatArray]:
    """Return the boxes (N, 5 or 4) that a detector finds in a sample, the best first, and their scores (N,)."""
    image = torch.from_numpy(trained.detector.example(sample, None).input)[None]
    maps = trained.network(image.contiguous(memory_format=torch.channels_last))[0].numpy()
    return decode(trained.detector, maps)


def detect(trained: Trained, samples: Samples) -> ModelOutputs:
    """All frames' detections."""
    frames = {}
    for key, sample in tqdm(samples.items(), desc=f"{trained.detector.name} detections", unit="frame", leave=False):
        boxes, scores = detect_in(trained, sample)
        frames[(key.sequence, key.frame)] = FrameOutput(
            boxes, scores, (CLASS,) * len(boxes), np.zeros(len(boxes), bool)
        )
    return ModelOutputs(trained.detector.kind, frames)


def labels(detector: Detector, samples: Samples) -> ModelOutputs:
    """All frames' labels."""
    frames: dict[FrameKey, FrameOutput] = {}
    for key, sample in samples.items():
        boxes, ignored = detector.labels(sample)
        named = (CLASS,) * len(boxes)
        frames[(key.sequence, key.frame)] = FrameOutput(boxes.astype(np.float64), np.ones(len(boxes)), named, ignored)
    return ModelOutputs(detector.kind, frames, False)


def trained_on(trained: Trained, samples: Samples) -> list[str]:
    """Sequences of the samples that the detector has seen in training, in whatever rendering."""
    return sorted({key.sequence for key in samples} & set(trained.settings["sequences"]))


def common(real: Samples, simulated: Samples) -> tuple[Samples, Samples]:
    """The frames that both have. Raises `UnisimError` where there are none."""
    keys = [key for key in real if key in simulated]
    if not keys:
        raise UnisimError(f"the two sets share no frame: one has {next(iter(real))}, the other {next(iter(simulated))}")
    return {key: real[key] for key in keys}, {key: simulated[key] for key in keys}


def gaps(
    on_real: Trained, on_simulated: Trained | None, real: Samples, simulated: Samples, resamples: int = 1000
) -> dict[str, Any]:
    """AP of real to real, Real2Sim and, with a detector trained on simulated frames, Sim2Real; what each
    loses; agreement."""
    real, simulated = common(real, simulated)
    truth, ious = labels(on_real.detector, real), default_ious(on_real.detector.kind)
    seen, replayed = detect(on_real, real), detect(on_real, simulated)
    rows = {"real": seen, "real2sim": replayed}
    if on_simulated is not None:
        rows["sim2real"] = detect(on_simulated, real)
    measured = {name: precision(outputs, truth, ious, CLASS, resamples) for name, outputs in rows.items()}
    metrics: dict[str, Any] = {"frames": len(real), "resampled": len(set(units_of(truth)))}
    metrics.update({name: one.metrics() for name, one in measured.items()})
    metrics["lost"] = {name: lost(measured["real"], one) for name, one in measured.items() if name != "real"}
    _, least = best_f1(all_matches(seen, truth, (AGREEMENT_IOU,), CLASS)[0])
    agreed = precision(replayed, confident(seen, least), (AGREEMENT_IOU,), CLASS, resamples)
    metrics["agreement"] = {"label_score": least if np.isfinite(least) else None, **agreed.metrics()}
    return metrics


def lost(before: Precision, after: Precision) -> dict[str, Any]:
    """How much lower each AP and the mean are, with intervals from the same resamples."""
    values, samples = before.ap - after.ap, before.samples - after.samples
    names = [*(f"ap@{iou:g}" for iou in before.ious), "map"]
    pairs = zip([*values, values.mean()], [*samples.T, samples.mean(1)], strict=True)
    return {
        name: {"value": float(value), "interval": list(interval(sample))}
        for name, (value, sample) in zip(names, pairs, strict=True)
    }


def markdown(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Rows of metrics as a Markdown table, in percent, each with the interval that 95 % of resamples fall into."""
    first = next(iter(rows.values()))
    columns = [name for name, value in first.items() if isinstance(value, dict)]
    aps = [name for name in columns if name != "map"]
    columns = ["map", *aps] if len(aps) > 1 else aps  # the mean of one is that one
    shown = {name: "mAP" if name == "map" else name.upper() for name in columns}
    lines = ["| | " + " | ".join(shown.values()) + " |", "|---" * (len(columns) + 1) + "|"]
    for title, values in rows.items():
        cells = [_cell(values[name]) for name in columns]
        lines.append(f"| {title} | " + " | ".join(cells) + " |")
    return lines


def _cell(score: Mapping[str, Any]) -> str:
    if score["value"] is None:
        return "-"
    low, high = (100 * end for end in score["interval"])
    return f"{100 * score['value']:.1f} ({low:.1f} … {high:.1f})"


def without_scores_below(outputs: ModelOutputs, least: float) -> ModelOutputs:
    """The detections that are drawn."""
    return replace(confident(outputs, least), scored=True)
