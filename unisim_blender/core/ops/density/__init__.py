"""From what fields say along a ray to optical depths of intervals between samples.

Signed distances have two densities: the logistic one here, which is the default and has kernels, and UniSim's in
``unisim.py``. Fields of log densities are in ``volume.py``.
"""

from __future__ import annotations

from torch import Tensor

from ..dispatch import Operation, on_cpu
from . import reference

OPERATION = Operation(reference.logistic_intervals, lambda s, beta: (s,), {"compiled": on_cpu})


def logistic_intervals(s: Tensor, beta: Tensor | float) -> tuple[Tensor, Tensor]:
    """Optical depths tau (N, K) and stop fractions (N, K) of intervals between samples with signed distances s (N,
    K), metres, and the sharpness ``beta``, 1 / metres.

    Interval k > 0 lies between samples k - 1 and k; interval 0 has no length and stands at sample 0: what a ray that
    starts behind a surface has already hit. ``stop_fraction`` times alpha is the expected place of stopping inside
    the interval, from 0 at its near end to 1 at its far one.
    """
    return OPERATION(s, beta)
