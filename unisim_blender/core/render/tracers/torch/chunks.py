"""Rays taken in chunks, as large as the device's memory allows."""

from __future__ import annotations

from collections.abc import Callable

import torch

LEAST_RAYS = 1 << 12
"""A device without memory for so few has none for the scene."""


def in_chunks(count: int, rays: int, take: Callable[[int, int], None]) -> None:
    """Call ``take`` with the first and the end of each chunk of ``count`` rays, of ``rays`` at most.

    Where the device has no memory for a chunk, it and those that follow are halved. Raises torch.cuda.OutOfMemoryError
    where there is none for `LEAST_RAYS`. What ``take`` keeps, it keeps last.
    """
    begin = 0
    while begin < count:
        try:
            take(begin, min(begin + rays, count))
        except torch.cuda.OutOfMemoryError:
            if rays <= LEAST_RAYS:
                raise
            rays //= 2
        else:
            begin += rays
            continue
        # here no frame of the failed attempt holds its tensors any more
        torch.cuda.empty_cache()
