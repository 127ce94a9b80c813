"""Rows that a mask selects, in tensors whose length is fixed before the mask is known: no decision waits for a device."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


def selected(mask: Tensor, most: int) -> tuple[Tensor, Tensor]:
    """Return the numbers (most,) of the first rows that a mask (N,) marks, ascending, and which of them there are (most,)
    bool; those that are not are spread over all rows."""
    index = torch.searchsorted(mask.cumsum(0), torch.arange(1, most + 1, device=mask.device))
    there = index < len(mask)
    return torch.where(there, index, torch.arange(most, device=mask.device) % len(mask)), there


def compact(padded: bool, mask: Tensor, *values: Tensor) -> tuple[Tensor, ...]:
    """Return the rows of a mask (N,) and of values (N, ...) that it marks; all of them, the mask as it is, where they are
    ``padded``."""
    if padded:
        return mask, *values
    index = torch.nonzero(mask)[:, 0]
    return mask[index], *(value[index] for value in values)


def drawn(mask: Tensor, count: int, generator: torch.Generator | None) -> tuple[Tensor, Tensor]:
    """Return the numbers (count,) of random rows of those that a mask (N,) marks, and whether there are any, () bool."""
    ends = mask.cumsum(0)
    place = torch.rand(count, generator=generator, device=mask.device) * ends[-1]
    # float32 may round the last place up to the end
    index = torch.searchsorted(ends, torch.minimum(place.long() + 1, ends[-1]).clamp_min(1))
    return index.clamp_max(len(mask) - 1), ends[-1] > 0


def masked_mean(values: Tensor, mask: Tensor) -> Tensor:
    """Return the mean of the values (N,) that a mask (N,) marks, 0 where it marks none."""
    return torch.where(mask, values, 0.0).sum() / mask.sum().clamp_min(1)


def masked_quantile(values: Tensor, mask: Tensor, share: float) -> Tensor:
    """Return the quantile, linear between neighbours, of the values (N,) that a mask (N,) marks; no number where it marks
    none."""
    ordered = torch.where(mask, values, torch.inf).sort().values
    place = share * (mask.sum() - 1).clamp_min(0).to(values.dtype)
    below, above = (ordered.index_select(0, at.long()[None])[0] for at in (place.floor(), place.ceil()))
    return torch.lerp(below, above, place - place.floor())


@dataclass
class Padding:
    """Fixed numbers of rows for what rays hit: ``hits_per_ray`` on average. ``missed`` () int64 counts on the device what
    found no row."""

    hits_per_ray: float
    missed: Tensor

    def rows(self, mask: Tensor, rays: int) -> tuple[Tensor, Tensor]:
        """Return `selected` of a mask (N,) with the rows of so many rays."""
        most = max(1, round(rays * self.hits_per_ray))
        self.missed += (mask.sum() - most).clamp_min(0)
        return selected(mask, most)
