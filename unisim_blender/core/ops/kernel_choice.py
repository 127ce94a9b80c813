"""Which kernels take the place of torch's own operations on given tensors."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from .. import native
from .triton.ready import ready


def kernels_for(*tensors: Tensor) -> Literal["compiled", "triton"] | None:
    """The kernels that take tensors like these, which lie on one device; None where torch works alone.

    All kernels are float32's: ``compiled`` ones where the library was built, on the CPU, ``triton``'s on a GPU where they run.
    """
    if any(tensor.dtype != torch.float32 for tensor in tensors):
        return None
    if ready(tensors[0]):
        return "triton"
    return "compiled" if tensors[0].device.type == "cpu" and native.library() is not None else None
