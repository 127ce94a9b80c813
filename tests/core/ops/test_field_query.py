"""A field asked as one kernel says what its grid and its network say one after the other."""

from __future__ import annotations

import pytest
import torch

from unisim_blender.core import native
from unisim_blender.core.model import fields
from unisim_blender.core.model.networks import mlp, run_mlp
from unisim_blender.core.ops.encode import encode, encode_reference
from unisim_blender.core.ops.grid_shape import GridArrays, GridShape

SHAPE = GridShape.unit(4, 64, 5, 4, 10)


@pytest.mark.skipif(native.library() is None, reason="the compiled kernels are not there")
@pytest.mark.parametrize("points", [0, 1, 511, 512, 5000])
@pytest.mark.parametrize("outputs", [None, 1, 7])
def test_the_same_bits_as_grid_and_network(points: int, outputs: int | None) -> None:
    torch.manual_seed(points)
    grid, network = GridArrays(SHAPE), mlp(SHAPE.width, 32, 16)
    table, x = torch.randn(3, SHAPE.rows, 4), torch.rand(points, 3) * 1.2 - 0.1
    index = torch.randint(0, 3, (points,))
    with torch.no_grad():
        for tables, which in ((table, index), (table[0], None)):
            found = fields.query(grid, tables, network, x, which, outputs)
            assert torch.equal(found, run_mlp(network, encode(grid, tables, x, which), outputs))
            last = network[-1]
            assert isinstance(last, torch.nn.Linear)
            plain = torch.nn.functional.linear(
                network[:-1](encode_reference(grid, tables.double(), x.double(), which).float()),
                last.weight[:outputs], last.bias[:outputs],
            )  # fmt: skip
            torch.testing.assert_close(found, plain, rtol=1e-5, atol=1e-5)


def test_gradients_are_those_of_grid_and_network() -> None:
    torch.manual_seed(0)
    grid, network = GridArrays(SHAPE), mlp(SHAPE.width, 32, 16)
    found = []
    for one in (True, False):
        table = torch.randn(SHAPE.rows, 4, generator=torch.Generator().manual_seed(1)).requires_grad_()
        x = torch.rand(100, 3, generator=torch.Generator().manual_seed(2)).requires_grad_()
        network.zero_grad()
        out = fields.query(grid, table, network, x) if one else run_mlp(network, encode(grid, table, x))
        out.square().sum().backward()
        grads = [table.grad, x.grad, *(p.grad for p in network.parameters())]
        found.append([grad.clone() for grad in grads if grad is not None])
    assert len(found[0]) == 5 and all(torch.equal(a, b) for a, b in zip(*found, strict=True))


def test_other_types_take_the_plain_way() -> None:
    grid, network = GridArrays(SHAPE), mlp(SHAPE.width, 32, 16).double()
    table, x = torch.randn(SHAPE.rows, 4).double(), torch.rand(10, 3).double()
    with torch.no_grad():
        assert fields.query(grid, table, network, x).dtype == torch.float64
