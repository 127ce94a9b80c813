"""Values of fields at points: signed distances, or logarithms of densities. Either has its own type, so that no number
is metres in one place and a logarithm in another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from .constants import EMPTY_LOG_DENSITY, EMPTY_M, GROUND_CLEARANCE_M


@dataclass(frozen=True)
class SignedDistances:
    """Signed distances (...) in metres, positive in free space."""

    metres: Tensor

    def view(self, shape: Sequence[int]) -> SignedDistances:
        """Return the values in another shape."""
        return SignedDistances(self.metres.view(*shape))

    def rows(self, which: Tensor) -> SignedDistances:
        """Return the values of some rows."""
        return SignedDistances(self.metres[which])

    def outward(self) -> Tensor:
        """Return the values that increase towards free space: the distances."""
        return self.metres

    def where(self, solid: Tensor) -> SignedDistances:
        """Return the values where ``solid`` (...) is true, and empty space elsewhere."""
        return SignedDistances(torch.where(solid, self.metres, EMPTY_M))

    def cleared(self, height_m: Tensor) -> SignedDistances:
        """Return the values with nothing but the ground near entries that are ``height_m`` (...) above it; -inf for those
        that stay."""
        free = torch.maximum(self.metres, height_m)
        return SignedDistances(torch.where(height_m > GROUND_CLEARANCE_M, free, self.metres))


@dataclass(frozen=True)
class LogDensities:
    """Natural logarithms (...) of densities in 1 / metres."""

    logs: Tensor

    def view(self, shape: Sequence[int]) -> LogDensities:
        """Return the values in another shape."""
        return LogDensities(self.logs.view(*shape))

    def rows(self, which: Tensor) -> LogDensities:
        """Return the values of some rows."""
        return LogDensities(self.logs[which])

    def outward(self) -> Tensor:
        """Return the values that increase towards free space: minus the logarithms."""
        return -self.logs

    def where(self, solid: Tensor) -> LogDensities:
        """Return the values where ``solid`` (...) is true, and empty space elsewhere."""
        return LogDensities(torch.where(solid, self.logs, EMPTY_LOG_DENSITY))

    def cleared(self, height_m: Tensor) -> LogDensities:
        """Return the values with nothing but the ground at entries that are ``height_m`` (...) above it: those above the
        ground are empty; -inf for those that stay."""
        return LogDensities(torch.where(height_m > GROUND_CLEARANCE_M, EMPTY_LOG_DENSITY, self.logs))


FieldValues = SignedDistances | LogDensities


def signed_distances(values: FieldValues) -> Tensor:
    """Return signed distances in metres. Raises TypeError for densities."""
    if not isinstance(values, SignedDistances):
        raise TypeError("this field says densities, and no signed distances")
    return values.metres


def log_densities(values: FieldValues) -> Tensor:
    """Return logarithms of densities in 1 / metres. Raises TypeError for signed distances."""
    if not isinstance(values, LogDensities):
        raise TypeError("this field says signed distances, and no densities")
    return values.logs
