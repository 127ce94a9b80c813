"""What each kernel is given: the sizes of presets `small` and `paper`."""

from __future__ import annotations

import copy
from collections.abc import Callable
from functools import partial
from typing import Any

import torch
from torch import Tensor

from unisim_blender.core.model.config import ModelConfig
from unisim_blender.core.model.fields import query
from unisim_blender.core.model.networks import mlp, run_mlp
from unisim_blender.core.ops.density import logistic_intervals, logistic_intervals_reference
from unisim_blender.core.ops.encode import encode, encode_reference
from unisim_blender.core.ops.gather import gather, gather_reference
from unisim_blender.core.ops.grid_shape import GridArrays, GridShape
from unisim_blender.core.ops.propose import RaySpans, Voxels, propose, propose_reference
from unisim_blender.core.ops.ray_segments import RaySegments
from unisim_blender.core.presets import preset

from .kernels import apart, held_against

Errors = dict[str, dict[str, Any]]
EXTENT_M = (240.0, 120.0, 40.0)
FEW = 10_000
"""With fewer samples than these, as a CPU takes them, tables are small too."""
EDGE = 1e-3
"""Slopes jump at cells' edges: points within this of one, in cells, do not count."""
MOST_ROWS = 12
"""Power of two of a table's rows where samples are few."""


def cases(device: str, samples: int) -> list[tuple[str, Callable[[], Errors]]]:
    """Return what is compared, by name; each is drawn when it is called."""
    found: list[tuple[str, Callable[[], Errors]]] = []
    for name in ("small", "paper"):
        config = preset(name).model
        for field, shape, grids in (("static", _static(config, samples), 1), ("actors", _actors(config, samples), 6)):
            grid = GridArrays(shape)
            found.append((f"{name}: encode, {field}", partial(_encode, device, grid, grids, samples)))
            for outputs in (None, 1):
                label = f"{name}: query, {field}, {outputs or 'all'} outputs"
                found.append((label, partial(_query, device, grid, grids, samples, config, outputs)))
        rays = max(samples // config.samples.static, 40)
        found.append((f"{name}: gather", partial(_gather, device, rays, config.samples.static, config.features)))
        found.append((f"{name}: intervals", partial(_intervals, device, rays, config.samples.static)))
        found.append((f"{name}: propose", partial(_propose, device, rays, config.samples.static_proposals)))
    return found


def _static(config: ModelConfig, samples: int) -> GridShape:
    g = config.static_grid
    rows = g.log2_table if samples >= FEW else MOST_ROWS
    return GridShape.cubic(EXTENT_M, g.coarsest, g.finest, g.levels, g.features, rows)


def _actors(config: ModelConfig, samples: int) -> GridShape:
    g = config.actor_grid
    rows = g.log2_table if samples >= FEW else MOST_ROWS
    return GridShape.unit(int(g.coarsest), int(g.finest), g.levels, g.features, rows)


def _drawn(
    device: str, grid: GridArrays, grids: int, samples: int
) -> tuple[Tensor, Tensor, Tensor | None, torch.Generator]:
    """Return a table, points in and a little outside of the unit cube, and the number of each point's grid."""
    generator = torch.Generator(device).manual_seed(1)
    shape = (grid.rows, grid.shape.features) if grids == 1 else (grids, grid.rows, grid.shape.features)
    table = torch.randn(shape, generator=generator, device=device)
    x = torch.rand(samples, 3, generator=generator, device=device) * 1.02 - 0.01
    index = None if grids == 1 else torch.randint(grids, (samples,), generator=generator, device=device)
    return table, x, index, generator


def _encode(device: str, grid: GridArrays, grids: int, samples: int) -> Errors:
    table, x, index, generator = _drawn(device, grid, grids, samples)
    given = torch.randn(samples, grid.shape.width, generator=generator, device=device)
    scale = torch.tensor(grid.scale, dtype=torch.float64, device=device)
    near = (x.double()[:, None] * scale).frac().abs()
    inside = ((near > EDGE) & (near < 1 - EDGE)).flatten(1).all(1) & (x > 0).all(1) & (x < 1).all(1)
    sets = []
    for kind, dtype in ((encode, torch.float32), (encode_reference, torch.float64), (encode_reference, torch.float32)):
        t, p = (value.to(dtype, copy=True).requires_grad_() for value in (table, x))
        out = kind(grid, t, p, index)
        out.backward(given.to(dtype))
        assert t.grad is not None and p.grad is not None
        sets.append((out.detach(), t.grad, p.grad[inside]))
    names = ("value", "gradient of the table", "gradient of points")
    return {name: held_against(*three) for name, three in zip(names, zip(*sets, strict=True), strict=True)}


@torch.no_grad()
def _query(device: str, grid: GridArrays, grids: int, samples: int, config: ModelConfig, outputs: int | None) -> Errors:
    """Compare fields asked in one go, which have no gradient: they serve where nothing is learnt."""
    table, x, index, _ = _drawn(device, grid, grids, samples)
    torch.manual_seed(2)
    network = mlp(grid.shape.width, config.hidden, 1 + config.features).to(device)
    got = query(grid, table, network, x, index, outputs)
    code = encode_reference(grid, table.double(), x.double(), index)
    want = run_mlp(copy.deepcopy(network).double(), code, outputs)
    plain = network(encode_reference(grid, table, x, index))[:, :outputs]
    return {"value": held_against(got, want, plain)}


def _gather(device: str, rays: int, count: int, width: int) -> Errors:
    generator = torch.Generator(device).manual_seed(3)

    def drawn(*shape: int, normal: bool = False) -> Tensor:
        return (torch.randn if normal else torch.rand)(*shape, generator=generator, device=device)

    t = drawn(rays, count).cumsum(1)
    tau = drawn(rays, count) ** 6 * 4
    tau[:5] = 0
    share = drawn(rays, count) * -torch.expm1(-tau)
    front = torch.exp(-(tau.cumsum(1) - tau))
    # columns of a wider tensor, as a network leaves them
    features = drawn(rays, count, width + 1, normal=True)
    given = [drawn(rays, count, normal=True) for _ in range(2)] + [drawn(rays, width + 3, normal=True)]
    ray = torch.arange(rays, device=device)
    sets = []
    for kind, dtype in ((gather, torch.float32), (gather_reference, torch.float64), (gather_reference, torch.float32)):
        a, b, c, f = (x.to(dtype, copy=True).requires_grad_() for x in (tau, share, front, features))
        ray_segment = RaySegments(ray, t.to(dtype), f[..., 1:], a, b)
        out = kind(ray_segment, c)
        torch.autograd.backward(out, [g.to(dtype) for g in given])
        grads = [x.grad for x in (a, b, c, f)]
        sets.append([*(x.detach() for x in out), *(g for g in grads if g is not None)])
    gradients = ("optical depths", "shares", "transmittances", "features")
    names = ("weights of intervals", "weights of samples", "sums", *(f"gradient of {name}" for name in gradients))
    return {name: held_against(*three) for name, three in zip(names, zip(*sets, strict=True), strict=True)}


def _intervals(device: str, rays: int, count: int) -> Errors:
    generator = torch.Generator(device).manual_seed(5)
    steps = torch.randn(rays, count, generator=generator, device=device)
    s = steps.cumsum(1) * torch.logspace(-2, 0.5, rays, device=device)[:, None]
    given = [torch.randn(rays, count, generator=generator, device=device) for _ in range(2)]
    sets = []
    kinds = (
        (logistic_intervals, torch.float32),
        *((logistic_intervals_reference, d) for d in (torch.float64, torch.float32)),
    )
    for kind, dtype in kinds:
        x, beta = s.to(dtype, copy=True).requires_grad_(), torch.tensor(20.0, dtype=dtype, device=device)
        beta.requires_grad_()
        out = kind(x, beta)
        torch.autograd.backward(out, [g.to(dtype) for g in given])
        assert x.grad is not None and beta.grad is not None
        sets.append([*(part.detach() for part in out), x.grad, beta.grad])
    names = ("optical depths", "stop fractions", "gradient of distances", "gradient of the sharpness")
    return {name: held_against(*three) for name, three in zip(names, zip(*sets, strict=True), strict=True)}


@torch.no_grad()
def _propose(device: str, rays: int, count: int) -> Errors:
    """Compare places of samples, which have no gradient."""
    generator = torch.Generator(device).manual_seed(4)

    def drawn(*shape: int) -> Tensor:
        return torch.rand(*shape, generator=generator, device=device)

    cells = (480, 240, 80) if rays * count >= FEW else (40, 32, 16)
    size = torch.tensor(cells, device=device) * 0.5
    values = ((drawn(*cells) < 0.15) * (drawn(*cells) * 215 + 40)).to(torch.uint8)
    voxels = Voxels(values, -size / 2, 0.5)
    o = drawn(rays, 3) * size + voxels.lower
    d = torch.nn.functional.normalize(torch.randn(rays, 3, generator=generator, device=device), dim=-1)
    far = drawn(rays) * float(size[1]) + 0.2
    o[-2:] += 1e12  # far outside
    far[-4:-2] = 0  # and nothing to walk through
    spans = RaySpans(o, d, torch.full_like(far, 0.1), far)
    u = ((torch.arange(count, device=device) + drawn(rays, count)) / count).contiguous()
    (t, mass), (want_t, want_mass) = propose(voxels, spans, u), propose_reference(voxels, spans, u)
    walked = far > 0.1
    # a quantile at the end of a voxel may stand at the next one's beginning, behind free space
    near = 1e-4 * float(want_mass.max().clamp_min(1e-3))
    return {"mass": apart(mass, want_mass, near), "places": apart(t[walked], want_t[walked], 1e-3)}
