"""What torch devices can do, and how things get there."""

from __future__ import annotations

from typing import TypeVar

import torch
from torch import Tensor, nn

M = TypeVar("M", bound=nn.Module)


def has_float64(device: torch.device | str) -> bool:
    """Whether a device knows float64. Without it times are float32: within 60 microseconds after a quarter of an hour, in
    which nothing on a street moves 3 mm."""
    return torch.device(device).type != "mps"


def tensor_to(value: Tensor, device: torch.device | str) -> Tensor:
    """A tensor on a device; float64 becomes float32 where the device has none."""
    if value.dtype == torch.float64 and not has_float64(device):
        value = value.float()
    return value.to(device)


def module_to(module: M, device: torch.device | str) -> M:
    """A module on a device; its float64 buffers become float32 where the device has none."""
    return (module if has_float64(device) else module.float()).to(device)
