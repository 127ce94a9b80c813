"""The small networks that every field is made of."""

from __future__ import annotations

import ctypes
from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable

from .. import native
from ..ops.devices import kernel_threads
from ..ops.kernel_choice import kernels_for


def mlp(width_in: int, hidden: int, width_out: int, layers: int = 2) -> nn.Sequential:
    """``layers`` linear layers with ReLU between them; only the last has a bias, as in Instant-NGP."""
    widths = [width_in] + [hidden] * (layers - 1) + [width_out]
    parts: list[nn.Module] = []
    for i in range(layers):
        last = i + 1 == layers
        parts.append(nn.Linear(widths[i], widths[i + 1], bias=last))
        if not last:
            parts.append(nn.ReLU(inplace=True))
    return nn.Sequential(*parts)


class _TwoLayers(torch.autograd.Function):
    """A perceptron of two layers through the compiled kernels, forward and backward."""

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
    """Contiguous weights (H, I), (O, H) and bias (O,) in the form that the kernels read."""
    return native.MlpStruct(w1.shape[1], len(w1), len(w2), w1.data_ptr(), w2.data_ptr(), bias.data_ptr())


def run_mlp(network: nn.Sequential, x: Tensor, outputs: int | None = None) -> Tensor:
    """``network``, as `mlp` makes it, at x (N, width); its first ``outputs`` columns alone, where that is given.

    Through the compiled kernels where it has two layers and the tensors are float32 on the CPU, else in plain torch.
    """
    first, last = network[0], network[-1]
    assert isinstance(first, nn.Linear) and isinstance(last, nn.Linear)
    w2, bias = last.weight[:outputs], last.bias[:outputs]
    if len(network) == 3 and kernels_for(x, w2) == "compiled":
        out: Tensor = _TwoLayers.apply(x, first.weight, w2, bias)  # type: ignore[no-untyped-call]
        return out
    return nn.functional.linear(network[:-1](x), w2, bias)


def spherical_harmonics(d: Tensor) -> Tensor:
    """Real spherical harmonics of degree 0 to 3 (N, 16) of unit directions (N, 3).

    Constants as in Sloan, "Stupid Spherical Harmonics Tricks", 2008, appendix A2.
    """
    x, y, z = d.unbind(-1)
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    return torch.stack(
        [
            torch.full_like(x, 0.28209479177387814),
            -0.48860251190291987 * y,
            0.48860251190291987 * z,
            -0.48860251190291987 * x,
            1.0925484305920792 * xy,
            -1.0925484305920792 * yz,
            0.94617469575755997 * zz - 0.31539156525251999,
            -1.0925484305920792 * xz,
            0.54627421529603959 * (xx - yy),
            0.59004358992664352 * y * (-3 * xx + yy),
            2.8906114426405538 * xy * z,
            0.45704579946446572 * y * (1 - 5 * zz),
            0.3731763325901154 * z * (5 * zz - 3),
            0.45704579946446572 * x * (1 - 5 * zz),
            1.4453057213202769 * z * (xx - yy),
            0.59004358992664352 * x * (-xx + 3 * yy),
        ],
        -1,
    )
