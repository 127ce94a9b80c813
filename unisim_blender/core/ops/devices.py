"""Capabilities of torch devices, transfers to them, and the number of threads that work on them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor, nn

M = TypeVar("M", bound=nn.Module)

_kernels: int | None = None


def has_float64(device: torch.device | str) -> bool:
    """Return whether a device has float64. Without it times are float32: within 60 microseconds after a quarter of an
    hour, in which nothing on a street moves 3 mm."""
    return torch.device(device).type != "mps"


def tensor_to(value: Tensor, device: torch.device | str) -> Tensor:
    """Return a tensor on a device; float64 becomes float32 where the device has none."""
    if value.dtype == torch.float64 and not has_float64(device):
        value = value.float()
    return value.to(device)


def module_to(module: M, device: torch.device | str) -> M:
    """Return a module on a device; its float64 buffers become float32 where the device has none."""
    return (module if has_float64(device) else module.float()).to(device)


def zeros_on_demand(
    shape: Sequence[int], dtype: torch.dtype = torch.float32, device: torch.device | str = "cpu"
) -> Tensor:
    """Return zeros whose memory is allocated as it is written to, where the device is a CPU: a long drive writes to
    few."""
    if torch.device(device).type != "cpu":
        return torch.zeros(tuple(shape), dtype=dtype, device=device)
    return torch.from_numpy(np.zeros(tuple(shape), torch.empty(0, dtype=dtype).numpy().dtype))


def kernel_threads() -> int:
    """Return the number of threads of a compiled kernel: torch's number, or that outside of `torch_threads`."""
    return _kernels or torch.get_num_threads()


@contextmanager
def torch_threads(count: int | None) -> Iterator[None]:
    """Let torch's own operations take ``count`` threads, and the compiled kernels as many as torch had before; None,
    inside of another such block, gives torch those back."""
    global _kernels
    torch_had, kernels_had = torch.get_num_threads(), _kernels
    _kernels = kernel_threads()
    torch.set_num_threads(count or _kernels)
    try:
        yield
    finally:
        torch.set_num_threads(torch_had)
        _kernels = kernels_had
