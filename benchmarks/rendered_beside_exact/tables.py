"""Results of many seeds as metrics: means of both loops, paired differences and how far the vehicle's two trajectories are apart,
with intervals of 95 % over resampled seeds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from unisim_blender.core.evaluation.autonomy.measure import interval
from unisim_blender.core.geometry import FloatArray

AT_S = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0)
QUANTILES = (0.25, 0.5, 0.75, 0.9)
RESAMPLES = 10_000
NAMES = {
    "collides": "rollouts with a collision",
    "collides_at_fault": "rollouts with a collision at fault",
    "pdms": "PDMS",
    "hd_score": "HD-score",
    "minimum_ttc_s": "least TTC, s",
    "progress": "progress",
    "driven_m": "driven, m",
    "last_m_s": "speed at the end, m/s",
    "unsupported": "unsupported pixels",
}


Pair = Mapping[str, Mapping[str, Any]]
"""The two loops of a seed by the sensors of the driver: one, and the one that it is compared with."""


def metrics_of(results: Sequence[Pair]) -> dict[str, Any]:
    """Return the metrics of seeds, as a JSON object. A score that one of a seed's loops lacks is left out with its pair."""
    loops = list(results[0])
    return {
        "seeds": len(results),
        "loops": loops,
        "scores": {name: _paired(results, name) for name in NAMES},
        "apart_m": {f"{at_s:g}": _spread(apart) for at_s, apart in _apart(results)},
        "at_the_end_by_lead_m": {lead: _spread(apart) for lead, apart in _at_the_end(results).items()},
        "processor_s": {name: float(np.mean([one[name]["processor_s"] for one in results])) for name in loops},
    }


def apart_of(result: Pair) -> tuple[FloatArray, FloatArray]:
    """Return times (T,) since the start, and how far apart the vehicle is then in a seed's two loops (T,), metres."""
    one, other = result.values()
    distance = np.hypot(*(np.array(one[axis]) - np.array(other[axis]) for axis in ("x_m", "y_m")))
    return np.array(one["time_s"]) - one["time_s"][0], distance


def _apart(results: Sequence[Pair]) -> list[tuple[float, FloatArray]]:
    found = [apart_of(one) for one in results]
    last_s = min(times[-1] for times, _ in found)
    return [(at_s, np.array([np.interp(at_s, *one) for one in found])) for at_s in AT_S if at_s <= last_s + 1e-6]


def _at_the_end(results: Sequence[Pair]) -> dict[str, FloatArray]:
    """Return how far apart the vehicle is at the end (N,), by what the vehicle ahead does."""
    found: dict[str, list[float]] = {}
    for one in results:
        lead = next(iter(one.values()))["lead"]
        found.setdefault(lead, []).append(float(apart_of(one)[1][-1]))
    return {lead: np.array(apart) for lead, apart in sorted(found.items())}


def _spread(values: FloatArray) -> dict[str, Any]:
    low, high = bootstrap(values, lambda some: np.median(some, 1))
    quantiles = {f"{share:g}": float(np.quantile(values, share)) for share in QUANTILES}
    return {
        "seeds": len(values),
        "quantiles": quantiles,
        "median_interval": [low, high],
        "greatest": float(values.max()),
    }


def _paired(results: Sequence[Pair], name: str) -> dict[str, Any]:
    pairs = [[_value(loop, name) for loop in one.values()] for one in results]
    both = np.array([pair for pair in pairs if None not in pair], np.float64).reshape(-1, 2)
    if not len(both):
        return {"pairs": 0}
    difference = both[:, 0] - both[:, 1]
    low, high = bootstrap(difference, lambda some: some.mean(1))
    return {
        "pairs": len(both),
        **dict(zip(results[0], both.mean(0).tolist(), strict=True)),
        "difference": float(difference.mean()),
        "interval": [low, high],
    }


def _value(loop: Mapping[str, Any], name: str) -> float | None:
    scores = loop["scores"]
    if name == "collides":
        return None if scores["collisions"] is None else float(scores["collisions"] > 0)
    if name == "collides_at_fault":
        return None if scores["collisions_at_fault"] is None else float(scores["collisions_at_fault"] > 0)
    return loop["speed_m_s"][-1] if name == "last_m_s" else scores[name]


def bootstrap(values: FloatArray, of: Callable[[FloatArray], FloatArray]) -> tuple[float, float]:
    """Return the interval that 95 % of a statistic's resamples fall into; ``of`` takes resampled values (R, N)."""
    drawn = np.random.default_rng(0).integers(len(values), size=(RESAMPLES, len(values)))
    return interval(of(values[drawn]))


def lines(metrics: dict[str, Any]) -> list[str]:
    """Return metrics as tables to print."""
    one_loop, other_loop = metrics["loops"]
    head = f"| | {one_loop} | {other_loop} | difference | pairs |"
    found = [f"{metrics['seeds']} seeds", "", head, "|---|---|---|---|---|"]
    for name, one in metrics["scores"].items():
        if one["pairs"]:
            low, high = one["interval"]
            means = (
                f"{one[one_loop]:.3f} | {one[other_loop]:.3f} | {one['difference']:+.3f} ({low:+.3f} to {high:+.3f})"
            )
            found.append(f"| {NAMES[name]} | {means} | {one['pairs']} |")
    found += ["", "| after, s | median apart, m | quartiles | 90 % | most |", "|---|---|---|---|---|"]
    found += [f"| {at_s} | {_apart_cells(one)} |" for at_s, one in metrics["apart_m"].items()]
    found += [
        "",
        "| the vehicle ahead | seeds | median apart, m | quartiles | 90 % | most |",
        "|---|---|---|---|---|---|",
    ]
    for lead, one in metrics["at_the_end_by_lead_m"].items():
        found.append(f"| {lead} | {one['seeds']} | {_apart_cells(one)} |")
    return found


def _apart_cells(one: Mapping[str, Any]) -> str:
    (low, high), q = one["median_interval"], one["quantiles"]
    return f"{q['0.5']:.2f} ({low:.2f} to {high:.2f}) | {q['0.25']:.2f}, {q['0.75']:.2f} | {q['0.9']:.2f} | {one['greatest']:.2f}"
