"""Average precision of detections: matching to labels frame by frame, the area under precision over recall,
and its intervals.

Of each frame's detections the best comes first, and takes the label, not taken yet, that it overlaps most, if by the
threshold or more: a true positive. All others are false positives, duplicates among them. Labels may be marked as
ignored: they need not be found, and a detection that takes nothing but overlaps one is left out. AP is the area under
the precision that some recall or a higher one reaches (Everingham et al., PASCAL VOC 2010, all points). Detections of
one score enter together, so that their order means nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...geometry import BoolArray, FloatArray

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


def interval(values: FloatArray, share: float = 0.95) -> tuple[float, float]:
    """The middle ``share`` of resampled values (R,), NaN left out; NaN where there are no others."""
    finite = values[np.isfinite(values)]
    if not len(finite):
        return float("nan"), float("nan")
    low, high = np.quantile(finite, [(1 - share) / 2, (1 + share) / 2])
    return float(low), float(high)
