"""Optical depths of the logistic density of signed distances, by the compiled kernels."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ... import native
from ..devices import kernel_threads


def logistic_intervals(s: Tensor, beta: Tensor | float) -> tuple[Tensor, Tensor]:
    """See `density.logistic_intervals`."""
    tau, stop_fraction = _LogisticIntervals.apply(s, torch.as_tensor(beta))  # type: ignore[no-untyped-call]
    return tau, stop_fraction


class _LogisticIntervals(torch.autograd.Function):
    """Forward and backward."""

    @staticmethod
    def forward(ctx: Any, s: Tensor, beta: Tensor) -> tuple[Tensor, Tensor]:
        lib = native.library()
        assert lib is not None
        s, sharp = s.contiguous(), float(beta)
        tau, stop_fraction = torch.empty_like(s), torch.empty_like(s)
        lib.unisim_intervals_forward(
            s.data_ptr(), *s.shape, sharp, tau.data_ptr(), stop_fraction.data_ptr(), kernel_threads()
        )  # fmt: skip
        ctx.sharp = sharp
        ctx.save_for_backward(s)
        return tau, stop_fraction

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor]:
        lib = native.library()
        assert lib is not None
        (s,) = ctx.saved_tensors
        of_tau, of_stop_fraction = (g.contiguous() for g in grads)
        of_s, of_beta = torch.empty_like(s), torch.empty(())
        lib.unisim_intervals_backward(
            s.data_ptr(), *s.shape, ctx.sharp, of_tau.data_ptr(), of_stop_fraction.data_ptr(), of_s.data_ptr(),
            of_beta.data_ptr(), kernel_threads(),
        )  # fmt: skip
        return of_s, of_beta
