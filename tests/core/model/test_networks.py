"""The compiled perceptrons against plain torch: values, gradients, odd sizes, every variant that
this processor runs."""

from __future__ import annotations

import pytest
import torch
from instruction_sets import run_other
from torch import Tensor

from unisim_bench.settings import VARIANTS
from unisim_blender.core import native
from unisim_blender.core.model.networks import mlp, run_mlp

needs_library = pytest.mark.skipif(native.library() is None, reason="the compiled kernels are not built")
SIZES = ((32, 64, 32), (24, 64, 33), (5, 7, 3), (1, 1, 1), (47, 33, 65))


def results(width: int, hidden: int, out: int, n: int, outputs: int | None, compiled: bool) -> list[Tensor]:
    """Values, then gradients of x, both layers and the bias: compiled in float32, or plain in float64."""
    torch.manual_seed(n)
    network, x = mlp(width, hidden, out), torch.randn(n, width)
    weight = torch.randn(n, outputs or out)
    if not compiled:
        network, x, weight = network.double(), x.double(), weight.double()
    x.requires_grad_()
    y = run_mlp(network, x, outputs)
    (y * weight).sum().backward()
    return [y.detach(), *(g.grad for g in (x, *network.parameters()) if g.grad is not None)]


@needs_library
@pytest.mark.parametrize("sizes", SIZES)
@pytest.mark.parametrize("n", (0, 1, 127, 129, 4500))
@pytest.mark.parametrize("outputs", (None, 1))
def test_values_and_gradients(sizes: tuple[int, int, int], n: int, outputs: int | None) -> None:
    fast, plain = (results(*sizes, n, outputs, compiled) for compiled in (True, False))
    assert len(fast) == len(plain) == 5
    for a, b in zip(fast, plain, strict=True):
        assert a.shape == b.shape
        torch.testing.assert_close(
            a.double(), b, rtol=1e-4, atol=1e-5 * max(1.0, float(b.abs().max()) if b.numel() else 1.0)
        )


@needs_library
def test_a_held_network_gets_no_gradient() -> None:
    network, x = mlp(8, 16, 4).requires_grad_(False), torch.randn(10, 8, requires_grad=True)
    run_mlp(network, x).sum().backward()
    assert x.grad is not None and all(p.grad is None for p in network.parameters())


@needs_library
def test_any_number_of_threads_gives_the_same_bits() -> None:
    threads, found = torch.get_num_threads(), []
    try:
        for count in (1, 3):
            torch.set_num_threads(count)
            found.append(results(32, 64, 32, 9000, None, True))
    finally:
        torch.set_num_threads(threads)
    for one, three in zip(*found, strict=True):
        assert torch.equal(one, three)


@needs_library
def test_second_derivatives_are_refused_not_wrong() -> None:
    x = torch.randn(4, 8, requires_grad=True)
    (slope,) = torch.autograd.grad(run_mlp(mlp(8, 16, 4), x).square().sum(), x, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        slope.sum().backward()


def test_more_layers_go_through_torch() -> None:
    network, x = mlp(8, 16, 4, layers=3), torch.randn(10, 8)
    torch.testing.assert_close(run_mlp(network, x), network(x))


VARIANT_SCRIPT = """
from model import test_networks as t
for sizes in t.SIZES:
    for outputs in (None, 1):
        t.test_values_and_gradients(sizes, 300, outputs)
"""


@needs_library
@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant(name: str) -> None:
    run_other(name, VARIANT_SCRIPT)
