"""A case of functions: those of vectors over every magnitude that float32 has, and every half."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator

import numpy as np
from instruction_sets import sets_here

from unisim_blender.core.geometry import (
    FloatArray,
)
from unisim_blender.core.render.tracers.compiled.structs import address

from .measures import Bench, Measure, most
from .probe import Array, ask, probed

LEAST_NORMAL, HUGE = 1.1754944e-38, float(np.finfo(np.float32).max)


def ulps(got: Array, exact: FloatArray) -> float:
    """The largest error in units in the last place of what is exact, or of the least normal number."""
    unit = np.spacing(np.clip(np.abs(exact), LEAST_NORMAL, HUGE / 2).astype(np.float32)).astype(np.float64)
    return most(got / unit, exact / unit) if len(got) else 0.0


def functions(bench: Bench) -> Iterator[Measure]:
    """Functions of vectors over every magnitude that float32 has, and every half."""
    step = 65537 if bench.full == 1 else 257
    every = np.arange(0, 2**32, step, dtype=np.uint64).astype(np.uint32).view(np.float32)
    every = every[np.isfinite(every)]
    special = np.array([np.inf, -np.inf, np.nan, 0.0, -0.0, 1e-45, -1e-45, 3e38, -3e38], np.float32)

    def over(low: float, high: float) -> Array:
        dense = np.linspace(low, min(high, 200.0), 100_001 * bench.full).astype(np.float32)
        x = np.concatenate([every, dense])
        return x[(x >= low) & (x <= high)]

    for variant in sets_here():
        library = probed(variant)
        assert library is not None
        for name, low, high, exact, bound in (
            ("exp", -87.3, 88.3, np.exp, 2),
            ("opacity", 0.0, HUGE, lambda x: -np.expm1(-x), 6),
            ("log1p", 0.0, 1.0, np.log1p, 4),
            ("softplus", -87.0, HUGE, lambda x: np.logaddexp(0, x), 4),
        ):
            x = over(low, high)
            yield Measure(
                f"{variant}: {name}, units in the last place",
                ulps(ask(library, name, x), exact(x.astype(np.float64))),
                bound,
            )
        below = ask(library, "exp", over(-HUGE, -87.3))
        yield Measure(f"{variant}: exp below its range", float(np.abs(below).max()), 1.3e-38)
        above = ask(library, "exp", over(88.3, HUGE))
        yield Measure(
            f"{variant}: exp above its range, not in 2e38 to infinity",
            float((~((above >= 2e38) & (above < np.inf))).sum()),
            0,
        )
        below = ask(library, "softplus", over(-HUGE, -87.0))
        yield Measure(f"{variant}: softplus below its range", float(np.abs(below).max()), 2e-38)
        nan = np.isnan(special)
        # NaN stays NaN, so that a training that diverges is seen
        for name in ("softplus", "exp"):
            yield Measure(
                f"{variant}: {name} of NaN, that became a number",
                float(np.isfinite(ask(library, name, special)[nan]).sum()),
                0,
            )
        yield Measure(f"{variant}: softplus of -infinity", float(ask(library, "softplus", special)[1]), 2e-38)
        yield Measure(
            f"{variant}: 1 - exp of -infinity, beside 1", abs(float(ask(library, "opacity", special)[0]) - 1), 0
        )
        halves = np.arange(65536, dtype=np.uint16).view(np.float16)
        finite, exact_halves = np.isfinite(halves), halves.astype(np.float32).view(np.uint32)
        for name in ("halves", "halves_in_rows"):
            out = np.empty(65536, np.float32)
            getattr(library, f"probe_{name}")(ctypes.c_void_p(address(out)))
            wrong = (out.view(np.uint32) != exact_halves)[finite].sum()
            yield Measure(f"{variant}: {name} of 63 488 finite ones with other bits", float(wrong), 0)
