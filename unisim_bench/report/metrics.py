"""Takes to metrics: medians of rounds, errors of images and depths against the truth. What was not measured is left out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.evaluation.metrics import psnr
from unisim_blender.core.geometry import BoolArray

from ..cases import BenchmarkCase, CaseEntry

NEAR_ENOUGH_MM = 20.0
Pieces = Sequence[NDArray[np.float32]]


def image_error(rendered: Pieces, truth: Pieces) -> dict[str, float]:
    """Return the errors of pieces of an image (h, w, 3), sRGB in 0..1, over all their pixels: PSNR in dB, inf where they
    are equal, and the mean colour difference of CIE 1976 (L*a*b*, D65)."""
    from skimage.color import rgb2lab

    a, b = (np.concatenate([np.clip(piece, 0, 1).reshape(-1, 3) for piece in pieces]) for pieces in (rendered, truth))
    untyped: Any = rgb2lab
    lab = [untyped(np.asarray(x, np.float64)) for x in (a, b)]
    return {"psnr_db": psnr(a, b), "delta_e": float(np.linalg.norm(lab[0] - lab[1], axis=-1).mean())}


def depth_error(depth_m: NDArray[np.float32], truth_m: NDArray[np.float32]) -> dict[str, float]:
    """Return the errors of depths (...), 0 where a ray hits nothing: absolute errors in mm over rays that hit something in
    both, the share of the truth's rays that hit something which are within 2 cm, and the share of all rays of which it is the
    same whether they hit something. NaN where there are none."""
    a, b = np.asarray(depth_m, np.float64).reshape(-1), np.asarray(truth_m, np.float64).reshape(-1)
    there = b > 0
    both = there & (a > 0)
    error = np.abs(a - b)[both] * 1e3
    nan = float("nan")
    median, p90, p99 = np.percentile(error, (50, 90, 99)) if len(error) else (nan, nan, nan)
    return {
        "median_mm": float(median),
        "p90_mm": float(p90),
        "p99_mm": float(p99),
        "within_2cm": float((error <= NEAR_ENOUGH_MM).sum() / there.sum()) if there.any() else nan,
        "hits_agree": float(((a > 0) == there).mean()) if len(a) else nan,
    }


FRONT = {"camera": "delta_e", "lidar": "p90_mm"}
"""The error that stands against run time."""


def metrics_of(cases: Sequence[BenchmarkCase]) -> dict[str, list[dict[str, Any]]]:
    """By kind, each case that has begun: what it is about, and its entries."""
    metrics: dict[str, list[dict[str, Any]]] = {}
    for case in cases:
        if any(entry.measurements for entry in case.entries):
            metrics.setdefault(case.kind, []).append({**case.about, **SUMMARIES.get(case.kind, _plain)(case)})
    for loop in metrics.get("loop", []):
        of_width = [sensor for sensor in metrics.get("camera", []) if sensor["width"] == loop["width"]]
        for row in loop["entries"]:
            for beside in (*of_width, *metrics.get("lidar", [])):
                row |= next((_errors(entry) for entry in beside["entries"] if entry["method"] == row["method"]), {})
    return metrics


def _errors(row: dict[str, Any]) -> dict[str, Any]:
    return {name: row[name] for name in ("delta_e", "p90_mm") if name in row}


def _median(entry: CaseEntry) -> dict[str, Any]:
    seconds = [measurement.seconds for measurement in entry.measurements]
    measurement = entry.measurements[0]
    return {
        **entry.about,
        "seconds": float(np.median(seconds)),
        "rounds_s": seconds,
        "rays": measurement.rays,
        "samples_per_ray": measurement.samples / max(measurement.rays, 1),
        "actors_skipped": measurement.actors_skipped,
    }


def _plain(case: BenchmarkCase) -> dict[str, Any]:
    return {"entries": [_median(entry) for entry in case.entries if entry.measurements]}


def _state(case: BenchmarkCase) -> dict[str, Any]:
    """Milliseconds of processor time of each step, and their sum."""
    rows = []
    for entry in case.entries:
        cost = entry.measurements[0].state if entry.measurements else None
        if cost is not None:
            steps = {f"{name}_ms": 1e3 * seconds for name, seconds in cost.steps_s.items()}
            counts = {
                "actors": cost.actors,
                "keys": cost.keys,
                "seen": cost.seen,
                "in_reach": cost.in_reach,
                "rays": cost.rays,
            }
            rows.append({**entry.about, **counts, **steps, "sum_ms": sum(steps.values())})
    return {"entries": rows}


def _loop(case: BenchmarkCase) -> dict[str, Any]:
    """Return for each quality: a step, its frames alone, and processor time before they are rendered."""
    rows = []
    for entry in case.entries:
        cost = entry.measurements[0].step if entry.measurements else None
        if cost is not None:
            times = {"step_s": cost.step_s, "alone_s": cost.alone_s, "of_alone": cost.step_s / cost.alone_s}
            rows.append(
                {**entry.about, "actors": cost.actors, "steps": cost.steps, **times, "world_ms": 1e3 * cost.world_s}
            )
    return {"entries": rows}


def _memory(case: BenchmarkCase) -> dict[str, Any]:
    entries = [
        _median(entry)
        | {"peak_mb": entry.measurements[0].peak_bytes / 1e6, "gpu_mb": entry.measurements[0].gpu_bytes / 1e6}
        for entry in case.entries
        if entry.measurements
    ]
    return {"entries": entries}


def _region(case: BenchmarkCase) -> dict[str, Any]:
    """Beside each share of the image: its time beside the whole's, and whether its pixels are the
    whole's to the bit."""
    whole, *parts = case.entries
    rows = []
    for i, entry in enumerate(parts):
        if entry.measurements and whole.measurements:
            row = _median(entry)
            row["of_whole"] = row["seconds"] / _median(whole)["seconds"]
            row["same_bits"] = all(
                np.array_equal(measurement.pieces[0], whole.measurements[0].pieces[i])
                for measurement in entry.measurements
            )
            rows.append(row)
    return {"whole_s": _median(whole)["seconds"] if whole.measurements else None, "entries": rows}


def _against_truth(case: BenchmarkCase, error: Callable[[Pieces, Pieces], dict[str, float]]) -> dict[str, Any]:
    truths = {
        entry.about["truth"]: entry.measurements[0].pieces
        for entry in case.entries
        if "truth" in entry.about and entry.measurements
    }
    rows = []
    for entry in case.entries:
        if not entry.measurements or "truth" in entry.about:
            continue
        row, measurement = _median(entry), entry.measurements[0]
        if row["scaled"]:
            row["seconds"] *= measurement.sensor_rays / measurement.rays
        else:
            row["traced"] = measurement.rays / measurement.sensor_rays
        row["per_second"] = 1 / row["seconds"]
        row["rays_per_second"] = row["rays"] / float(np.median(row["rounds_s"]))
        if "truth" in truths:
            row |= error(measurement.pieces, truths["truth"])
        if case.recorded is not None:
            row["recorded_psnr_db"] = image_error(measurement.pieces, case.recorded)["psnr_db"]
        rows.append(row)
    metrics: dict[str, Any] = {"entries": rows}
    if len(truths) == 2:
        metrics["truth"] = error(truths["truth"], truths["doubled"])
    for row, front in zip(rows, front_of(metrics, FRONT[case.kind]), strict=True):
        row["front"] = bool(front)
    return metrics


def front_of(case: dict[str, Any], error: str) -> BoolArray:
    """Which of a case's entries nothing else beats in time and in an error; what is nearer than the truth's own
    uncertainty is alike."""
    rows = case["entries"]
    tolerance = case.get("truth", {}).get(error, 0.0)
    return pareto_front([row["seconds"] for row in rows], [row.get(error, np.nan) for row in rows], tolerance)


def _lidar(case: BenchmarkCase) -> dict[str, Any]:
    return _against_truth(case, lambda a, b: depth_error(a[0], b[0]))


SUMMARIES: dict[str, Callable[[BenchmarkCase], dict[str, Any]]] = {
    "camera": lambda case: _against_truth(case, image_error),
    "lidar": _lidar,
    "region": _region,
    "memory": _memory,
    "state": _state,
    "loop": _loop,
}


def pareto_front(seconds: Sequence[float], errors: Sequence[float], tolerance: float = 0.0) -> BoolArray:
    """Which of N points no other beats: one that is faster and whose error is larger by ``tolerance`` at most, or one
    that is as fast and whose error is smaller by more than that. Points whose error is not finite are
    not on the front."""
    t, e = np.array(seconds, float), np.array(errors, float)
    with np.errstate(invalid="ignore"):
        sooner = (t[:, None] < t) & (e[:, None] <= e + tolerance)
        better = (t[:, None] <= t) & (e[:, None] < e - tolerance)
    return np.asarray(np.isfinite(e) & ~(sooner | better).any(0))
