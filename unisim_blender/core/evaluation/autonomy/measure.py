"""Two documents compared: the metrics of detections, forecasts and plans that both hold."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import BoolArray, FloatArray
from .document import IOU, FrameOutput, MetricsError, ModelOutputs, check_pair

BEV_IOUS = (0.1, 0.3, 0.5, 0.7, 0.8)
"""Thresholds of the paper's table for LiDAR; mAP is the mean over them."""
IMAGE_IOUS = (0.1, 0.3, 0.5, 0.7)
"""Thresholds of the paper's tables for the camera; mAP is the mean over them."""
_AT_ONCE = 2**22


@dataclass(frozen=True)
class Matches:
    """All frames' detections at one threshold, those left out not among them, the best first.

    scores (N,); hit (N,), whether a detection is a true positive; unit (N,), which of U units of resampling it belongs
    to; labels (U,), how many labels each unit has.
    """

    scores: FloatArray
    hit: BoolArray
    unit: NDArray[np.int64]
    labels: FloatArray


def match(iou: FloatArray, scores: FloatArray, ignored: BoolArray, threshold: float) -> NDArray[np.int64]:
    """One frame's detections (D,) matched to its labels: a label's number, -1 for a false positive, -2 where left out.

    iou (D, L), scores (D,), ignored (L,). Of equal scores the one that overlaps a label most comes first.
    """
    out = np.full(len(scores), -1)
    if not len(ignored):
        return out
    free = np.where(ignored, -1.0, iou)
    for index in np.lexsort((-free.max(1), -scores)):
        best = int(free[index].argmax())
        if free[index, best] >= threshold:
            out[index] = best
            free[:, best] = -1.0
        elif (iou[index, ignored] >= threshold).any():
            out[index] = -2
    return out


def collect(frames: Sequence[tuple[FloatArray, NDArray[np.int64], int]], units: Sequence[int]) -> Matches:
    """Frames' scores (D,), what `match` gave (D,), and numbers of labels, together; ``units``: each frame's
    unit, 0 to U - 1."""
    scores = np.concatenate([np.zeros(0), *(frame[0] for frame in frames)])
    matched = np.concatenate([np.zeros(0, np.int64), *(frame[1] for frame in frames)])
    unit = np.repeat(np.asarray(units, np.int64), [len(frame[0]) for frame in frames])
    labels = np.bincount(np.asarray(units, np.int64), [frame[2] for frame in frames], max(units, default=-1) + 1)
    counted = np.flatnonzero(matched != -2)
    order = counted[np.argsort(-scores[counted], kind="stable")]
    return Matches(scores[order], matched[order] >= 0, unit[order], labels.astype(np.float64))


def precision_recall(matches: Matches) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Score, precision and recall (S,) of taking all detections of each score and better; recall is
    NaN without labels."""
    ends = _ends(matches.scores)
    true = np.cumsum(matches.hit)[ends]
    total = matches.labels.sum()
    recall = true / total if total else np.full(len(ends), np.nan)
    return matches.scores[ends], true / (ends + 1), recall


def average_precision(matches: Matches) -> float:
    """AP in 0..1; 0 without detections, NaN without labels."""
    return float(weighted_average_precision(matches, np.ones((1, len(matches.labels))))[0])


def weighted_average_precision(matches: Matches, weights: FloatArray) -> FloatArray:
    """AP (R,) with every unit counted ``weights`` (R, U) times."""
    ends = _ends(matches.scores)
    rows = max(1, _AT_ONCE // max(len(matches.scores), 1))
    parts = [_area(matches, ends, weights[start : start + rows]) for start in range(0, len(weights), rows)]
    return np.concatenate(parts)


def _area(matches: Matches, ends: NDArray[np.int64], weights: FloatArray) -> FloatArray:
    each = weights[:, matches.unit]
    taken = np.cumsum(each, 1)[:, ends]
    true = np.cumsum(each * matches.hit, 1)[:, ends]
    total = weights @ matches.labels
    precision = np.divide(true, taken, out=np.zeros_like(true), where=taken > 0)
    reached = np.maximum.accumulate(precision[:, ::-1], 1)[:, ::-1]
    gained = np.diff(true, axis=1, prepend=0.0)
    return np.divide((gained * reached).sum(1), total, out=np.full(len(total), np.nan), where=total > 0)


def _ends(scores: FloatArray) -> NDArray[np.int64]:
    """Positions of the last detection of each score, in scores that fall."""
    return np.flatnonzero(np.append(scores[1:] != scores[:-1], [True] * (len(scores) > 0)))


def best_f1(matches: Matches) -> tuple[float, float]:
    """The highest F1 = 2 P R / (P + R) that a least score reaches, and that score; 0 and inf where nothing is found."""
    score, precision, recall = precision_recall(matches)
    f1 = np.divide(2 * precision * recall, precision + recall, out=np.zeros(len(score)), where=precision + recall > 0)
    if not len(f1) or not f1.max() > 0:
        return 0.0, float("inf")
    best = int(f1.argmax())
    return float(f1[best]), float(score[best])


def resampled_weights(units: int, resamples: int, seed: int) -> FloatArray:
    """How often each of U units is drawn when U are drawn with replacement, ``resamples`` times: (R, U).
    Efron (1979)."""
    return np.random.default_rng(seed).multinomial(units, np.full(units, 1 / units), resamples).astype(np.float64)


INTERVAL = 0.95


def interval(values: FloatArray) -> tuple[float, float]:
    """The middle 95 % of resampled values (R,), NaN left out; NaN where there are no others."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return float("nan"), float("nan")
    low, high = np.quantile(finite, [(1 - INTERVAL) / 2, (1 + INTERVAL) / 2])
    return float(low), float(high)


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
    matches = []
    for key, label in labels.frames.items():
        frame = _of_class(outputs.frames[key], name)
        truth = _of_class(label, name)
        iou = IOU[labels.kind](frame.boxes, truth.boxes)
        matches.append((frame, truth, match(iou, frame.scores, truth.ignored, threshold)))
    return matches


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
        of_class = precision(outputs, labels, chosen, name, resamples, seed).metrics()
        forecast = forecasts(outputs, labels, name)
        metrics["classes"][name] = of_class if forecast is None else {**of_class, "forecasts": forecast}
    plan = plans(outputs, labels)
    return metrics if plan is None else {**metrics, "plans": plan}


def metrics_table(metrics: dict[str, Any]) -> list[str]:
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
