"""Gradients of fields by differences on a tetrahedron: four queries a point, and no second derivatives in training."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

CORNERS = 4
_TETRAHEDRON = torch.tensor([[1.0, -1, -1], [-1, -1, 1], [-1, 1, -1], [1, 1, 1]])


def outward_gradient(
    outward: Callable[[Tensor], Tensor], x: Tensor, step_m: float, size_m: Tensor | None = None
) -> Tensor:
    """Gradients (N, 3), a metre, at points x (N, 3), of what rises towards free space: of signed distances, metres
    per metre.

    ``outward`` gets points (N * CORNERS, 3), each point's one after the other. ``size_m`` (N, 3) is what a unit of x
    measures along its axes, for points in an actor's unit cube.
    """
    corners = _TETRAHEDRON.to(x)
    offsets = step_m * corners if size_m is None else step_m * corners / size_m[:, None]
    values = outward((x[:, None] + offsets).reshape(-1, 3)).view(-1, CORNERS)
    return torch.einsum("nk,kj->nj", values, corners) / (CORNERS * step_m)
