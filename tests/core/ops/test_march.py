"""Where samples are placed: the compiled proposals against the plain ones, and what both must keep to."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from unisim_blender.core import native
from unisim_blender.core.ops.propose import RaySpans, Voxels, propose, propose_reference
from unisim_blender.core.ops.quantiles import (
    refine_quantiles,
    refine_quantiles_compiled,
    refine_quantiles_reference,
    stratified,
)

needs_library = pytest.mark.skipif(native.library() is None, reason="the compiled kernels are not built")
VOXEL_M = 0.5
STEP_M = VOXEL_M / 2


def random_voxels(seed: int, full: float = 0.15) -> Voxels:
    rng = np.random.default_rng(seed)
    values = (rng.random((40, 24, 12)) < full) * rng.integers(1, 256, (40, 24, 12))
    return Voxels(torch.tensor(values.astype(np.uint8)), torch.tensor([-3.0, 1.0, 0.5]), VOXEL_M)


def random_rays(n: int, seed: int) -> RaySpans:
    """Rays of all kinds through a grid of 20 x 12 x 6 m: from outside and inside, that miss, along the
    axes, of no length."""
    rng = np.random.default_rng(seed)
    o = rng.uniform([-12, -6, -4], [26, 20, 11], (n, 3))
    aim = rng.uniform([-3, 1, 0.5], [17, 13, 6.5], (n, 3))
    d = aim - o
    d[: n // 4] = rng.normal(size=(n // 4, 3))
    d[n // 4 : 2 * (n // 4)] = np.eye(3)[rng.integers(0, 3, n // 4)] * rng.choice([-1, 1], (n // 4, 1))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    near = rng.uniform(0, 3, n)
    far = near + rng.uniform(0, 40, n)
    far[::17] = near[::17]
    origins, directions, starts, ends = (torch.tensor(a, dtype=torch.float32) for a in (o, d, near, far))
    return RaySpans(origins, directions, starts, ends)


def steps_of(voxels: Voxels, spans: RaySpans, ray: int) -> list[float]:
    """Values p of each step of one ray, by a plain loop in double precision."""
    out = []
    span = float(spans.t_far[ray] - spans.t_near[ray])
    lower, shape = voxels.lower.double(), voxels.values.shape
    for i in range(int(np.ceil(np.float32(span) / np.float32(STEP_M)))):
        x = (
            spans.origins[ray].double()
            + (float(spans.t_near[ray]) + (i + 0.5) * STEP_M) * spans.directions[ray].double()
        )
        cell = [int(c) for c in torch.floor((x - lower) / VOXEL_M)]
        inside = all(0 <= c < n for c, n in zip(cell, shape, strict=True))
        out.append(int(voxels.values[cell[0], cell[1], cell[2]]) / 255 if inside else 0.0)
    return out


def quantile_error(voxels: Voxels, spans: RaySpans, ray: int, u: Tensor, t: Tensor, mass: float) -> float:
    """How far the places t (K,) of one ray are from the quantiles u (K,) of its distribution, worked out
    by a plain loop."""
    total, seen, edges = 0.0, 0.0, [0.0]
    for p in steps_of(voxels, spans, ray):
        total += p * np.exp(-0.15 * STEP_M * seen)
        seen += p
        edges.append(total)
    assert mass == pytest.approx(total, rel=1e-4, abs=1e-5)
    if total == 0:
        return 0.0
    place = (t.double().numpy() - float(spans.t_near[ray])) / STEP_M
    got = np.interp(place, np.arange(len(edges)), np.array(edges) / total)
    return float(np.abs(got - u.double().numpy()).max())


@pytest.mark.parametrize("function", (propose_reference, pytest.param(propose, marks=needs_library)))
def test_places_are_the_quantiles_of_the_occupied_voxels(function: object) -> None:
    voxels, spans = random_voxels(1), random_rays(60, 2)
    u = stratified(60, 7, True, spans.origins, torch.Generator().manual_seed(3))
    t, mass = function(voxels, spans, u)  # type: ignore[operator]
    assert t.shape == (60, 7) and mass.shape == (60,)
    assert bool((t.diff(dim=1) >= 0).all()), "rising along each ray"
    hit = 0
    for ray in range(60):
        assert quantile_error(voxels, spans, ray, u[ray], t[ray], float(mass[ray])) < 1e-4, ray
        hit += float(mass[ray]) > 0
    assert 20 < hit < 58, "some rays meet voxels, some miss"


@needs_library
@pytest.mark.parametrize("full", (0.0, 0.01, 0.3, 1.0))
def test_compiled_proposals(full: float) -> None:
    voxels, spans = random_voxels(4, full), random_rays(3000, 5)
    u = stratified(3000, 12, True, spans.origins, torch.Generator().manual_seed(6))
    t, mass = propose(voxels, spans, u)
    t_plain, mass_plain = propose_reference(voxels, spans, u)
    torch.testing.assert_close(mass, mass_plain, rtol=1e-5, atol=1e-5)
    # rounding sends a quantile between two runs of voxels to the end of one or the start of the next
    differ = (t - t_plain).abs() > 1e-3
    assert differ.float().mean() < 1e-3
    for ray, k in differ.nonzero().tolist()[:20]:
        assert quantile_error(voxels, spans, ray, u[ray, k : k + 1], t[ray, k : k + 1], float(mass[ray])) < 1e-4


def test_a_ray_that_meets_nothing() -> None:
    voxels = random_voxels(7, 0.0)
    spans = random_rays(50, 8)
    u = stratified(50, 5, False, spans.origins)
    for function in (propose, propose_reference):
        t, mass = function(voxels, spans, u)
        assert bool((mass == 0).all())
        torch.testing.assert_close(t, spans.t_near[:, None] + u * (spans.t_far - spans.t_near)[:, None])


def test_free_space_takes_no_sample() -> None:
    values = torch.zeros(40, 24, 12, dtype=torch.uint8)
    values[20:22] = 255
    voxels = Voxels(values, torch.zeros(3), VOXEL_M)
    one = torch.ones(1)
    spans = RaySpans(torch.tensor([[-2.0, 6.0, 3.0]]), torch.tensor([[1.0, 0.0, 0.0]]), 0 * one, 30 * one)
    u = torch.linspace(0, 1, 101)[None]
    for function in (propose, propose_reference):
        t, _ = function(voxels, spans, u)
        assert 11.99 <= float(t.min()) and float(t.max()) <= 13.01, "the slab lies from 12 to 13 m"


def test_no_rays_at_all() -> None:
    empty = RaySpans(torch.zeros(0, 3), torch.zeros(0, 3), torch.zeros(0), torch.zeros(0))
    for function in (propose, propose_reference):
        t, mass = function(random_voxels(9), empty, torch.zeros(0, 4))
        assert t.shape == (0, 4) and mass.shape == (0,)


@pytest.mark.parametrize("jitter", (False, True))
def test_strata(jitter: bool) -> None:
    u = stratified(200, 9, jitter, torch.zeros(1), torch.Generator().manual_seed(1))
    edges = torch.arange(9) / 9
    assert bool((u >= edges).all()) and bool((u <= edges + 1 / 9 + 1e-6).all())
    assert bool((u.std(0) > 0.02).all()) == jitter


def test_refined_samples_gather_at_a_crossing() -> None:
    generator = torch.Generator().manual_seed(2)
    u = stratified(500, 16, True, torch.zeros(1), generator)
    t = 1 + 40 * u
    crossing = torch.linspace(6, 35, 500)[:, None]
    jitter = stratified(500, 12, True, torch.zeros(1), generator)
    fine = refine_quantiles(u, t, 0.3 * (crossing - t), 40.0, jitter)
    assert fine.shape == (500, 12)
    assert bool((fine.diff(dim=1) >= 0).all()) and float(fine.min()) >= 0 and float(fine.max()) <= 1
    near = ((1 + 40 * fine - crossing).abs() < 4.0).float().sum(1)
    before = ((t - crossing).abs() < 4.0).float().sum(1)
    assert float(near.min()) >= 5 and float(near.mean()) > 2 * float(before.mean())


def test_refined_samples_spread_where_there_is_no_surface() -> None:
    u = stratified(10, 16, False, torch.zeros(1))
    jitter = stratified(10, 12, False, torch.zeros(1))
    fine = refine_quantiles(u, 5 + 10 * u, torch.full_like(u, 9.0), 100.0, jitter)
    assert float(fine.diff(dim=1).max()) < 0.2 and float(fine.min()) < 0.1 and float(fine.max()) > 0.9


def test_a_ray_that_starts_inside_something_samples_its_start() -> None:
    u = stratified(1, 8, False, torch.zeros(1))
    fine = refine_quantiles(u, 5 + 10 * u, torch.full_like(u, -0.5), 50.0, stratified(1, 12, False, torch.zeros(1)))
    assert float(fine.median()) < float(u[0, 0])


@needs_library
@pytest.mark.parametrize("beta", (20.0, 400.0))
@pytest.mark.parametrize(("places", "count"), ((1, 5), (2, 1), (16, 12), (37, 30)))
def test_refined_quantiles_of_the_compiled_kernel(places: int, count: int, beta: float) -> None:
    generator = torch.Generator().manual_seed(3)
    u = stratified(300, places, True, torch.zeros(1), generator)
    t = 1 + 60 * u
    # surfaces in front of, between and behind the samples, more than one, and samples that are masked to empty space
    s = 4 * torch.rand(300, 1, generator=generator) * torch.cos(5 * u + 6 * torch.rand(300, 1, generator=generator)) - 1
    s[::7] = s[::7].abs() + 1
    s[3::7] = -s[3::7].abs() - 0.5
    t[5::7, places // 2 :] = t[5::7, places // 2, None]
    s[6::7, places // 3] = torch.inf
    jitter = stratified(300, count, True, torch.zeros(1), generator)
    jitter[0, 0], jitter[0, -1] = 0.0, 1.0
    wanted = refine_quantiles_reference(u.double(), t.double(), s.double(), beta, jitter.double())
    assert bool(wanted.isfinite().all())
    plain, compiled = (
        (refine(u, t, s, beta, jitter).double() - wanted).abs()
        for refine in (refine_quantiles_reference, refine_quantiles_compiled)
    )
    assert float(compiled.mean()) <= 1.5 * float(plain.mean())
    # where no surface is, the weights are differences of numbers near 1
    assert float(compiled.max()) < 1e-4
