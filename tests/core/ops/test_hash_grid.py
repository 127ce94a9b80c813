"""The compiled hash grid against the plain one: values, gradients, odd points, every variant that
this processor runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from instruction_sets import run_other
from torch import Tensor

from unisim_bench.settings import VARIANTS
from unisim_blender.core import native
from unisim_blender.core.ops.encode import GradientSink, add_to_table, as_branch, encode, encode_reference
from unisim_blender.core.ops.grid_shape import GridArrays, GridShape

needs_library = pytest.mark.skipif(native.library() is None, reason="the compiled kernels are not built")
SHAPES = {
    "dense": GridShape.unit(2, 9, 3, 2, 14),
    "hashed": GridShape.unit(20, 200, 4, 4, 10),
    "mixed, uneven cells": GridShape.cubic((37.0, 12.5, 4.1), 3.2, 0.11, 5, 4, 12),
}


def points(n: int, seed: int = 0) -> Tensor:
    """Points in the cube, on its faces, outside it, and not numbers."""
    rng = np.random.default_rng(seed)
    x = rng.random((n, 3))
    odd = [0.0, 1.0, -0.3, 1.4, np.nan, np.inf, -np.inf, 0.5, np.nextafter(np.float32(1), np.float32(0)), 1e-30]
    x[: n // 3] = rng.choice(odd, (n // 3, 3))
    return torch.tensor(x, dtype=torch.float32)


def table(grid: GridArrays, grids: int = 0, seed: int = 1) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    shape = (grid.rows, grid.shape.features)
    return torch.randn(*((grids, *shape) if grids else shape), generator=generator)


@needs_library
@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("count", (0, 1, 63, 64, 65, 1500))
def test_values(name: str, count: int) -> None:
    grid = GridArrays(SHAPES[name])
    x, rows = points(max(count, 3))[:count], table(grid)
    out = encode(grid, rows, x)
    assert out.shape == (count, grid.shape.width) and bool(torch.isfinite(out).all())
    torch.testing.assert_close(out, encode_reference(grid, rows, x), rtol=1e-4, atol=2e-4)


@needs_library
@pytest.mark.parametrize("features", (1, 2, 4, 8))
def test_gradients_of_every_width(features: int) -> None:
    grid = GridArrays(GridShape.unit(3, 60, 4, features, 11))
    x, rows = points(700), table(grid)
    weight = torch.randn(700, grid.shape.width, generator=torch.Generator().manual_seed(2))
    results = []
    for function in (encode, encode_reference):
        own_x, own_rows = x.clone().requires_grad_(), rows.clone().requires_grad_()
        (function(grid, own_rows, own_x) * weight).sum().backward()
        assert own_x.grad is not None and own_rows.grad is not None
        results.append((own_rows.grad, own_x.grad))
    torch.testing.assert_close(results[0][0], results[1][0], rtol=1e-4, atol=1e-3)
    torch.testing.assert_close(results[0][1], results[1][1], rtol=1e-4, atol=1e-2)
    # what was clamped to a face does not move with x
    outside = ~((x > 0) & (x < 1))
    assert bool((results[0][1][outside] == 0).all()) and bool((results[0][1][~outside] != 0).all())


@needs_library
def test_many_grids_in_one_table() -> None:
    grid = GridArrays(SHAPES["mixed, uneven cells"])
    x, rows = points(400), table(grid, grids=5)
    index = torch.randint(5, (400,), generator=torch.Generator().manual_seed(3))
    out = encode(grid, rows, x, index)
    torch.testing.assert_close(out, encode_reference(grid, rows, x, index), rtol=1e-4, atol=2e-4)
    for number in range(5):
        mine = index == number
        torch.testing.assert_close(out[mine], encode(grid, rows[number], x[mine]), rtol=0, atol=0)


@needs_library
@pytest.mark.parametrize("grids", (0, 3))
def test_a_sink_takes_the_tables_gradient(grids: int) -> None:
    grid = GridArrays(SHAPES["hashed"])
    x = points(300)
    index = torch.arange(300) % 3 if grids else None
    plain, sunk, sink = table(grid, grids).requires_grad_(), table(grid, grids).requires_grad_(), GradientSink()
    encode(grid, plain, x, index).square().sum().backward()
    assert plain.grad is not None
    before = torch.randn(plain.shape, generator=torch.Generator().manual_seed(4))
    for cleared in (True, False):
        encode(grid, sunk, x, index, sink=sink).square().sum().backward()
        assert sunk.grad is None, "autograd gets nothing to add up again"
        if cleared:
            sink.clear()
    into = before.clone()
    sink.pour(into)
    torch.testing.assert_close(into - before, plain.grad, rtol=1e-4, atol=1e-4)
    poured = into.clone()
    sink.pour(into)
    assert torch.equal(into, poured), "what was poured is gone"


@needs_library
def test_a_sink_adds_up_by_shares_whichever_comes_first() -> None:
    grid, x = GridArrays(SHAPES["hashed"]), points(3000)
    parts = [torch.randn(len(x), grid.shape.width, generator=torch.Generator().manual_seed(seed)) for seed in range(3)]
    sums = []
    for order in ((0, 1, 2), (2, 0, 1), (1, 2, 0)):
        sink, into = GradientSink(), torch.zeros_like(table(grid, 0))
        for branch in order:
            with as_branch(branch):
                sink.put(grid, x, None, parts[branch])
        sink.pour(into)
        sums.append(into)
    assert torch.equal(sums[0], sums[1]) and torch.equal(sums[0], sums[2])
    swapped = torch.zeros_like(sums[0])
    for part in reversed(parts):
        add_to_table(grid, x, None, part, swapped)
    assert not torch.equal(swapped, sums[0]), "the order would show"


@needs_library
def test_sum_of_gradients_is_the_same_for_any_number_of_threads() -> None:
    grid = GridArrays(SHAPES["mixed, uneven cells"])
    x = points(5000)
    threads, results = torch.get_num_threads(), []
    try:
        for count in (1, 3):
            torch.set_num_threads(count)
            rows, own = table(grid).requires_grad_(), x.clone().requires_grad_()
            out = encode(grid, rows, own)
            out.square().sum().backward()
            assert rows.grad is not None and own.grad is not None
            results.append((out.detach(), rows.grad, own.grad))
    finally:
        torch.set_num_threads(threads)
    for one, three in zip(*results, strict=True):
        assert torch.equal(one, three)


@needs_library
def test_second_derivatives_are_refused_not_wrong() -> None:
    grid = GridArrays(SHAPES["dense"])
    x = torch.full((4, 3), 0.3, requires_grad=True)
    (slope,) = torch.autograd.grad(encode(grid, table(grid), x).square().sum(), x, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        slope.sum().backward()


def test_shapes_that_do_not_fit() -> None:
    grid = GridArrays(SHAPES["dense"])
    with pytest.raises(AssertionError):
        encode(grid, table(grid), torch.zeros(4, 2))
    with pytest.raises(AssertionError):
        encode(grid, table(grid)[:-1], torch.zeros(4, 3))


def test_the_reference_against_finite_differences() -> None:
    grid = GridArrays(GridShape.unit(2, 5, 2, 2, 5))
    rng = np.random.default_rng(8)
    # away from the cells' faces, where the slope jumps
    cell = rng.integers(0, 10, (12, 3)) / 10
    x = torch.tensor(cell + rng.uniform(0.02, 0.08, (12, 3)), requires_grad=True)
    rows = table(grid).double().requires_grad_()
    assert torch.autograd.gradcheck(lambda r, p: encode_reference(grid, r, p), (rows, x), eps=1e-7, atol=1e-5)


def test_the_reference_is_a_trilinear_interpolation() -> None:
    """One dense level whose rows hold the vertex's own place: the encoding of x is x."""
    grid = GridArrays(GridShape(((4.0, 3.0, 2.0),), 4, 10))
    assert grid.rows == 5 * 4 * 3
    i, j, k = (a.ravel("F") for a in np.meshgrid(range(5), range(4), range(3), indexing="ij"))
    rows = torch.tensor(np.stack([i / 4, j / 3, k / 2, np.ones(60)], -1))
    x = torch.tensor(np.random.default_rng(9).random((200, 3)))
    torch.testing.assert_close(encode_reference(grid, rows, x)[:, :3], x)
    torch.testing.assert_close(encode_reference(grid, rows, x)[:, 3], torch.ones(200, dtype=torch.float64))


def test_levels_are_dense_where_they_fit() -> None:
    shape = GridShape.unit(4, 64, 3, 2, 12)
    offsets, sizes, strides_y, strides_z = shape.layout()
    assert [s[0] for s in shape.scale] == [4, 16, 64]
    assert sizes == [125, 4096, 4096] and offsets == [0, 125, 4221] and shape.rows == 8317
    assert strides_y == [5, 0, 0] and strides_z == [25, 0, 0]


VARIANT_SCRIPT = """
import numpy as np
from ops import test_hash_grid as t
grid = t.GridArrays(t.SHAPES["mixed, uneven cells"])
x, rows = t.points(1000).requires_grad_(), t.table(grid).requires_grad_()
out = t.encode(grid, rows, x)
out.square().sum().backward()
np.savez(sys.argv[1], out=out.detach().numpy(), rows=rows.grad.numpy(), x=x.grad.numpy())
"""


@needs_library
@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant(name: str, tmp_path: Path) -> None:
    file = tmp_path / "out.npz"
    run_other(name, VARIANT_SCRIPT, file)
    grid = GridArrays(SHAPES["mixed, uneven cells"])
    x, rows = points(1000).requires_grad_(), table(grid).requires_grad_()
    expected = encode_reference(grid, rows, x)
    expected.square().sum().backward()
    assert x.grad is not None and rows.grad is not None
    with np.load(file) as got:
        np.testing.assert_allclose(got["out"], expected.detach().numpy(), rtol=1e-4, atol=2e-4)
        np.testing.assert_allclose(got["rows"], rows.grad.numpy(), rtol=1e-3, atol=2e-3)
        np.testing.assert_allclose(got["x"], x.grad.numpy(), rtol=1e-3, atol=0.1)
