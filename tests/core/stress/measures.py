"""What a case yields, and where it works."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Measure:
    """An error, and the bound that it must keep; the ``most`` or a quantile of it, as ``what`` says."""

    what: str
    error: float
    bound: float

    @property
    def kept(self) -> bool:
        """Whether the bound holds; NaN never does."""
        return bool(self.error <= self.bound)


@dataclass(frozen=True)
class Bench:
    """Where cases leave their scenes, and how large they are: ``full`` 1 for a test, more for a benchmark."""

    folder: Path
    full: int = 1


Case = Callable[[Bench], Iterator[Measure]]


def most(a: Any, b: Any, quantile: float = 1.0) -> float:
    """The largest difference of a row, or a quantile of them; NaN counts as infinite."""
    difference = np.abs(np.asarray(a, np.float64) - np.asarray(b, np.float64))
    if difference.size == 0:
        return 0.0
    rows = np.nan_to_num(difference, nan=np.inf).reshape(len(difference), -1).max(1)
    return float(np.quantile(rows, quantile, method="higher"))
