"""How many inputs hypothesis draws: HYPOTHESIS_PROFILE is `few` (the default: fixed, for every run of the tests) or
`many`, whose inputs of each reader INPUTS names; without it there are 100 000 of all together."""

from __future__ import annotations

import os

from hypothesis import HealthCheck, Phase, settings

READERS = 40
"""So many properties there are, about: `many` runs 100 000 inputs of all together."""

_LARGE = (HealthCheck.too_slow, HealthCheck.data_too_large)
# the time of an input is bounded in processor time by promise.py: a deadline by the clock fails on a busy machine
_COMMON = settings(deadline=None, suppress_health_check=_LARGE, print_blob=True)
_FIXED = (Phase.explicit, Phase.generate, Phase.shrink)
settings.register_profile("few", _COMMON, max_examples=20, derandomize=True, database=None, phases=_FIXED)
settings.register_profile("many", _COMMON, max_examples=int(os.environ.get("INPUTS", 100_000 // READERS)))
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "few"))

COSTLY = settings(max_examples=settings().max_examples // 4)
"""For a reader whose files are large."""
