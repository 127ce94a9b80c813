"""Features in the form that the kernels read."""

from __future__ import annotations

from torch import Tensor


def with_even_rows(features: Tensor) -> Tensor:
    """Features (P, K, F) with even rows: they may be columns of what a network gave, so rows need not touch."""
    n, width, _ = features.shape
    if n * width and (features.stride(2) != 1 or features.stride(0) != width * features.stride(1)):
        return features.contiguous()
    return features
