"""Two documents compared: the metrics of detections, forecasts and plans that both hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import BoolArray, FloatArray
from .average_precision import (
    BEV_IOUS,
    IMAGE_IOUS,
    Matches,
    average_precision,
    best_f1,
    collect,
    interval,
    match,
    resampled_weights,
    weighted_average_precision,
)
from .document import IOU, FrameOutput, MetricsError, ModelOutputs, check_pair

AGREEMENT_IOU = 0.3
"""The paper's threshold for detection agreement, and for whose forecasts are compared."""
RESAMPLES = 1000


def default_ious(kind: str) -> tuple[float, ...]:
    """The paper's thresholds for boxes of a kind."""
    return BEV_IOUS if kind == "bev" else IMAGE_IOUS


def confident(outputs: ModelOutputs, least_score: float) -> ModelOutputs:
    """Outputs as labels: their boxes of at least that score. Raises `MetricsError` where boxes have no scores."""
    if not outputs.scored:
        raise MetricsError(f"{outputs.path}: a box has no score, so agreement with its detections means nothing")
    frames = {key: _some(frame, frame.scores >= least_score) for key, frame in outputs.frames.items()}
    return ModelOutputs(outputs.kind, frames, False, outputs.path)


def _some(frame: FrameOutput, keep: BoolArray) -> FrameOutput:
    chosen = np.flatnonzero(keep)
    forecasts = tuple(frame.forecasts[i] for i in chosen) if frame.forecasts else ()
    classes = tuple(frame.classes[i] for i in chosen)
    return FrameOutput(frame.boxes[chosen], frame.scores[chosen], classes, frame.ignored[chosen], forecasts, frame.plan)


def all_matches(outputs: ModelOutputs, labels: ModelOutputs, ious: Sequence[float], name: str) -> list[Matches]:
    """Boxes of one class matched at each threshold. Units of resampling are sequences; frames where there
    is one sequence."""
    return [
        collect(
            [(frame.scores, matched, int((~truth.ignored).sum())) for frame, truth, matched in frames], units_of(labels)
        )
        for frames in (_matched(outputs, labels, threshold, name) for threshold in ious)
    ]


def units_of(labels: ModelOutputs) -> list[int]:
    """Each frame's unit of resampling: its sequence, or itself where there is one sequence alone."""
    numbers: dict[str, int] = {}
    sequences = [numbers.setdefault(sequence, len(numbers)) for sequence, _ in labels.frames]
    return sequences if len(numbers) > 1 else list(range(len(sequences)))


def _matched(
    outputs: ModelOutputs, labels: ModelOutputs, threshold: float, name: str
) -> list[tuple[FrameOutput, FrameOutput, NDArray[np.int64]]]:
    """For each frame its boxes and labels of one class, and what `match` says of them."""
    found = []
    for key, label in labels.frames.items():
        frame = _of_class(outputs.frames[key], name)
        truth = _of_class(label, name)
        iou = IOU[labels.kind](frame.boxes, truth.boxes)
        found.append((frame, truth, match(iou, frame.scores, truth.ignored, threshold)))
    return found


def _of_class(frame: FrameOutput, name: str) -> FrameOutput:
    return _some(frame, np.array([label == name for label in frame.classes], bool))


@dataclass(frozen=True)
class Precision:
    """AP at each threshold, and their mean, resampled: ``ap`` (T,), ``samples`` (R, T)."""

    ious: tuple[float, ...]
    ap: FloatArray
    samples: FloatArray
    labels: int
    detections: int

    def metrics(self) -> dict[str, Any]:
        """Values and intervals by name, as a JSON object; None where there is none."""
        names = [*(f"ap@{iou:g}" for iou in self.ious), "map"]
        values = [*self.ap, self.ap.mean()]
        samples = [*self.samples.T, self.samples.mean(1)]
        metrics: dict[str, Any] = {"labels": self.labels, "detections": self.detections}
        for name, value, sample in zip(names, values, samples, strict=True):
            metrics[name] = {"value": _finite(float(value)), "interval": [_finite(end) for end in interval(sample)]}
        return metrics


def precision(
    outputs: ModelOutputs,
    labels: ModelOutputs,
    ious: Sequence[float],
    name: str,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> Precision:
    """AP of one class. The same frames, number of resamples and seed draw the same resamples:
    differences may be paired."""
    matches = all_matches(outputs, labels, ious, name)
    weights = resampled_weights(len(matches[0].labels), resamples, seed)
    return Precision(
        tuple(ious),
        np.array([average_precision(m) for m in matches]),
        np.stack([weighted_average_precision(m, weights) for m in matches], 1),
        int(matches[0].labels.sum()),
        sum(frame.classes.count(name) for frame in outputs.frames.values()),
    )


def classes_of(labels: ModelOutputs) -> list[str]:
    """The classes that labels have, sorted; those only of ignored ones, too."""
    return sorted({name for frame in labels.frames.values() for name in frame.classes})


def forecasts(outputs: ModelOutputs, labels: ModelOutputs, name: str) -> dict[str, Any] | None:
    """minADE of the actors found at the least score of the best F1, at IoU 0.3; None where no label has a forecast.

    A label's most probable mode is its truth (supplementary 3.3). Raises `MetricsError` where a label
    looks further ahead.
    """
    if not any(forecast for frame in labels.frames.values() for forecast in frame.forecasts):
        return None
    frames = _matched(outputs, labels, AGREEMENT_IOU, name)
    f1, least = best_f1(all_matches(outputs, labels, (AGREEMENT_IOU,), name)[0])
    errors = []
    for key, (frame, truth, matched) in zip(labels.frames, frames, strict=True):
        for index in np.flatnonzero((matched >= 0) & (frame.scores >= least)):
            given = frame.forecasts[index] if frame.forecasts else None
            wanted = truth.forecasts[matched[index]] if truth.forecasts else None
            if given is None or wanted is None:
                continue
            trajectory = wanted.modes[wanted.probabilities.argmax()]
            if len(trajectory) > given.modes.shape[1]:
                steps = f"{given.modes.shape[1]} of its label's {len(trajectory)} positions"
                raise MetricsError(f"{outputs.path}: frame {key[1]}: a forecast has {steps}")
            errors.append(min_ade(given.modes, given.probabilities, trajectory))
    mean = _finite(float(np.mean(errors))) if errors else None
    return {"min_ade_m": mean, "actors": len(errors), "f1": f1, "least_score": _finite(least)}


def plans(outputs: ModelOutputs, labels: ModelOutputs) -> dict[str, Any] | None:
    """Mean end-point error of plans in frames where both have one; None where there is no such frame."""
    errors = []
    for key, label in labels.frames.items():
        plan = outputs.frames[key].plan
        if plan is None or label.plan is None:
            continue
        if len(plan) != len(label.plan):
            raise MetricsError(
                f"{outputs.path}: frame {key[1]}: its plan has {len(plan)} positions, that of {labels.path} {len(label.plan)}"
            )
        errors.append(end_point_error(plan, label.plan))
    return {"end_point_error_m": float(np.mean(errors)), "frames": len(errors)} if errors else None


def measure(
    outputs: ModelOutputs,
    labels: ModelOutputs,
    ious: Sequence[float] | None = None,
    resamples: int = RESAMPLES,
    seed: int = 0,
) -> dict[str, Any]:
    """All metrics of outputs beside labels, by class, as a JSON object. Raises `MetricsError`."""
    check_pair(outputs, labels)
    if not outputs.scored:
        raise MetricsError(f"{outputs.path}: a detection has no score")
    chosen = tuple(ious or default_ious(labels.kind))
    metrics: dict[str, Any] = {"frames": len(labels.frames), "resampled": len(set(units_of(labels))), "classes": {}}
    for name in classes_of(labels):
        one = precision(outputs, labels, chosen, name, resamples, seed).metrics()
        forecast = forecasts(outputs, labels, name)
        metrics["classes"][name] = one if forecast is None else {**one, "forecasts": forecast}
    plan = plans(outputs, labels)
    return metrics if plan is None else {**metrics, "plans": plan}


def table(metrics: dict[str, Any]) -> list[str]:
    """Return the result of `measure` as lines to print: percent, with the interval that 95 % of resamples fall into."""
    lines = [f"{metrics['frames']} frames"]
    for name, values in metrics["classes"].items():
        lines.append(f"{name}: {values['labels']} labels, {values['detections']} detections")
        for key, value in values.items():
            if isinstance(value, dict) and "interval" in value:
                shown = "mAP" if key == "map" else key.upper()
                lines.append(
                    f"  {shown:8} {_percent(value['value']):>6}   {' … '.join(map(_percent, value['interval']))}"
                )
        if "forecasts" in values:
            forecast = values["forecasts"]
            error = "-" if forecast["min_ade_m"] is None else f"{forecast['min_ade_m']:.3f} m"
            lines.append(f"  minADE   {error} over {forecast['actors']} actors, at F1 {_percent(forecast['f1'])}")
    if "plans" in metrics:
        lines.append(
            f"plans: end-point error {metrics['plans']['end_point_error_m']:.3f} m over {metrics['plans']['frames']} frames"
        )
    return lines


def _percent(value: float | None) -> str:
    return "-" if value is None else f"{100 * value:.1f}"


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


MODES = 6
"""Forecasts of an actor that are compared: its most probable ones."""


def min_ade(modes: FloatArray, probabilities: FloatArray, truth: FloatArray) -> float:
    """Least average displacement error, m: the mean distance (T,) of the best of the `MODES` most probable modes.

    modes (K, T, 2), probabilities (K,), truth (T', 2) with T' <= T: where the truth ends, the comparison does.
    """
    chosen = modes[np.argsort(-probabilities, kind="stable")[:MODES], : len(truth)]
    return float(np.linalg.norm(chosen - truth, axis=-1).mean(-1).min())


def end_point_error(plan: FloatArray, other: FloatArray) -> float:
    """Distance, m, of the last positions of two plans (T, 2) over the same time."""
    return float(np.linalg.norm(plan[-1] - other[-1]))
