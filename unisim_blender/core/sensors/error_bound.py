"""Bounds on a frame's error, and checks of them by a sample of the frame."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..errors import UnisimError
from ..geometry import FloatArray, spread_indices

BOUND_PATTERN = re.compile(r"(?:p(\d+(?:\.\d+)?):)?(\d+(?:\.\d+)?)\s*(mm|dB|dE)", re.IGNORECASE)
UNITS = {"mm": "mm", "db": "dB", "de": "dE"}
QUANTILE_ERROR_RATE = 0.002
"""Probability that a bound on a quantile is wrong."""
MAX_SAMPLE_FRAMES = 16
"""Largest number of frames of a drive from which a camera's settings are chosen."""


@dataclass(frozen=True)
class ErrorBound:
    """Bound on a frame's error: ``limit`` in ``unit``. mm: the ``quantile`` of the absolute depth error of a sweep's
    beams is at most that; beams that hit something in the truth or in the render count, infinitely wrong where they do
    in one alone. dB: an image's PSNR is at least that. dE: the mean colour difference (CIE 1976) of its pixels is at
    most that."""

    unit: str
    limit: float
    quantile: float = 0.5

    @property
    def most(self) -> float:
        """The largest error that keeps the bound: in mm, as a mean squared error of colours in 0..1, or as a colour
        difference."""
        return 10 ** (-self.limit / 10) if self.unit == "dB" else self.limit

    def shown(self, error: float) -> float | None:
        """Return an error, as `most` counts it, in the bound's unit, to four digits; None where it is infinite."""
        value = -10 * math.log10(max(error, 1e-20)) if self.unit == "dB" else error
        return float(f"{value:.4g}") if math.isfinite(value) else None

    def __str__(self) -> str:
        """Return the text that `parse_bounds` reads, with the limit to the bit."""
        limit = np.format_float_positional(self.limit, trim="-")
        return f"{'' if self.quantile == 0.5 else f'p{100 * self.quantile:.12g}:'}{limit}{self.unit}"


@dataclass(frozen=True)
class BoundCheck:
    """A bound checked by a sample: ``estimate`` of the error and its upper bound ``most``, both as `ErrorBound.most`
    counts."""

    bound: ErrorBound
    estimate: float
    most: float

    @property
    def holds(self) -> bool:
        """Whether the error's upper bound keeps the bound."""
        return self.most <= self.bound.most


@dataclass(frozen=True)
class ErrorBoundResult:
    """Checks of a frame's bounds: the name of its ``settings`` in `quality.ERROR_BOUND_QUALITIES`, the number of rays or patches
    in the ``sample``, and one check for each bound."""

    settings: str
    sample: int
    checks: tuple[BoundCheck, ...] = field(default=())

    @property
    def holds(self) -> bool:
        """Whether all bounds are kept."""
        return all(check.holds for check in self.checks)

    def to_json(self) -> dict[str, object]:
        """Return the JSON form of a manifest; errors in their bounds' units, null where they are infinite."""
        errors = {
            str(c.bound): {"estimate": c.bound.shown(c.estimate), "at_worst": c.bound.shown(c.most), "kept": c.holds}
            for c in self.checks
        }
        return {"settings": self.settings, "sample": self.sample, "errors": errors, "kept": self.holds}


def sample_frames(time_s: Collection[int]) -> list[int]:
    """Return the frames, of those that a camera has, by whose pixels its settings are chosen."""
    there = sorted(time_s)
    return [there[i] for i in spread_indices(len(there), MAX_SAMPLE_FRAMES)]


def parse_bounds(texts: Sequence[str]) -> tuple[ErrorBound, ...]:
    """Return the bounds of texts of the command line: "1mm", "p90:20mm", "40dB", "1.5dE". Raises `UnisimError`."""
    bounds = []
    for text in texts:
        match = BOUND_PATTERN.fullmatch(text.strip())
        if (
            not match
            or float(match[2]) == 0
            or (match[1] and (match[3].lower() != "mm" or not 0 < float(match[1]) < 100))
        ):
            raise UnisimError(
                f'--max-error "{text}": must be a median depth error like 1mm, another percentile of it like p90:20mm, '
                "a PSNR like 40dB, or a mean colour difference like 1.5dE, above 0"
            )
        bounds.append(ErrorBound(UNITS[match[3].lower()], float(match[2]), float(match[1]) / 100 if match[1] else 0.5))
    return tuple(sorted(set(bounds), key=str))


def depth_errors(depth_m: NDArray[np.float32], truth_m: NDArray[np.float32]) -> FloatArray:
    """Return absolute errors (M,), mm, of depths (...), metres, 0 where a ray hits nothing: of the rays that hit
    something in either, infinite where they do in one alone."""
    assert depth_m.shape == truth_m.shape, (depth_m.shape, truth_m.shape)
    a, b = (np.asarray(x, np.float64).reshape(-1) for x in (depth_m, truth_m))
    both, either = (a > 0) & (b > 0), (a > 0) | (b > 0)
    return np.where(both, np.abs(a - b) * 1e3, np.inf)[either]


def quantile_check(bound: ErrorBound, errors: FloatArray) -> BoundCheck:
    """Check a bound on a quantile by a stratified or simple random sample of errors (M,). The estimate is the sample's
    quantile, the upper bound the order statistic that the frame's quantile exceeds with a probability of at most
    `QUANTILE_ERROR_RATE`, whatever the errors' distribution (David & Nagaraja, "Order Statistics", 7.1; Hoeffding 1956
    for strata). An empty sample has no error."""
    n = len(errors)
    if n == 0:
        return BoundCheck(bound, 0.0, 0.0)
    ordered = np.sort(errors)
    estimate = ordered[max(0, math.ceil(n * bound.quantile) - 1)]
    rank = quantile_rank(n, bound.quantile)
    return BoundCheck(bound, float(estimate), float(ordered[rank - 1]) if rank <= n else math.inf)


def quantile_rank(n: int, quantile: float) -> int:
    """Return the smallest k with P(B >= k) <= `QUANTILE_ERROR_RATE`, B binomial (n, quantile); n + 1 where there is
    none."""
    k = np.arange(n + 1)
    steps = np.log(np.arange(1, n + 1))
    factorial = np.concatenate([[0.0], np.cumsum(steps)])
    log = factorial[n] - factorial - factorial[::-1] + k * math.log(quantile) + (n - k) * math.log1p(-quantile)
    above = np.cumsum(np.exp(log)[::-1])[::-1]
    return int(np.argmax(above <= QUANTILE_ERROR_RATE)) if above[-1] <= QUANTILE_ERROR_RATE else n + 1


def mean_at_most(terms: FloatArray, deviations: float) -> float:
    """Return an upper bound on the mean of terms (N,): ``deviations`` standard errors above the sample's mean."""
    return float(terms.mean() + deviations * terms.std(ddof=1) / math.sqrt(len(terms)))


def drawn(weights: FloatArray, count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Draw the numbers (count,) of units in proportion to their weights (N,): one in each of ``count`` equal parts of
    the weights' sum."""
    sums = np.cumsum(weights)
    places = (np.arange(count) + rng.random(count)) / count * sums[-1]
    return np.minimum(np.searchsorted(sums, places, side="right"), len(sums) - 1)
