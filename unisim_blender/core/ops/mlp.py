"""Perceptrons of two layers."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

from .. import native
from .devices import kernel_threads
from .dispatch import Operation

_IN_BFLOAT16: ContextVar[bool] = ContextVar("in_bfloat16", default=False)


def two_layers(x: Tensor, w1: Tensor, w2: Tensor, bias: Tensor) -> Tensor:
    """Return ``w2 relu(w1 x) + bias`` (N, O) of x (N, I): weights w1 (H, I), w2 (O, H), bias (O,)."""
    return (two_layers_bfloat16 if _IN_BFLOAT16.get() else OPERATION)(x, w1, w2, bias)


@contextmanager
def in_bfloat16(wanted: bool) -> Iterator[None]:
    """Have `two_layers`, of this thread and inside of the context, multiply bfloat16 where that is ``wanted``."""
    token = _IN_BFLOAT16.set(wanted)
    try:
        yield
    finally:
        _IN_BFLOAT16.reset(token)


def two_layers_bfloat16(x: Tensor, w1: Tensor, w2: Tensor, bias: Tensor) -> Tensor:
    """`two_layers` by products in bfloat16, whose sums are float32; the bias, which a distance is near zero by, and the
    result are of the type of x."""
    x16, first, last = (value.bfloat16() for value in (x, w1, w2))
    return F.linear(F.relu(F.linear(x16, first), inplace=True), last).to(x.dtype) + bias


def two_layers_reference(x: Tensor, w1: Tensor, w2: Tensor, bias: Tensor) -> Tensor:
    """`two_layers` in plain torch."""
    return F.linear(F.relu(F.linear(x, w1), inplace=True), w2, bias)


def two_layers_compiled(x: Tensor, w1: Tensor, w2: Tensor, bias: Tensor) -> Tensor:
    """`two_layers` by the compiled kernels."""
    out: Tensor = _TwoLayers.apply(x, w1, w2, bias)  # type: ignore[no-untyped-call]
    return out


class _TwoLayers(torch.autograd.Function):
    """Forward and backward."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, w1: Tensor, w2: Tensor, bias: Tensor) -> Tensor:
        lib = native.library()
        assert lib is not None
        x, w1, w2, bias = x.contiguous(), w1.contiguous(), w2.contiguous(), bias.contiguous()
        out = torch.empty(len(x), len(w2))
        net = network_struct(w1, w2, bias)
        lib.unisim_mlp_forward(ctypes.byref(net), x.data_ptr(), len(x), out.data_ptr(), kernel_threads())
        ctx.save_for_backward(x, w1, w2, bias)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor | None, Tensor | None, Tensor | None]:
        lib = native.library()
        assert lib is not None
        x, w1, w2, bias = ctx.saved_tensors
        grad, grad_x = grads[0].contiguous(), torch.empty_like(x)
        learnt = [torch.zeros_like(w) for w in (w1, w2, bias)] if any(ctx.needs_input_grad[1:]) else [None] * 3
        lib.unisim_mlp_backward(
            ctypes.byref(network_struct(w1, w2, bias)), x.data_ptr(), len(x), grad.data_ptr(), grad_x.data_ptr(),
            *(None if w is None else w.data_ptr() for w in learnt), kernel_threads(),
        )  # fmt: skip
        return grad_x, *learnt


def network_struct(w1: Tensor, w2: Tensor, bias: Tensor) -> native.MlpStruct:
    """Return contiguous weights (H, I), (O, H) and bias (O,) in the form that the kernels read."""
    return native.MlpStruct(w1.shape[1], len(w1), len(w2), w1.data_ptr(), w2.data_ptr(), bias.data_ptr())


OPERATION = Operation(two_layers_reference, lambda x, w1, w2, bias: (x, w2), compiled=two_layers_compiled)
