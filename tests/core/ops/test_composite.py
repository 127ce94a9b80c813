"""The compiled intervals, transmittances and sums along rays against plain torch: values, gradients, threads, every
variant (of the kernels that place samples and sort rays out as well)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
import torch
from instruction_sets import run_other
from torch import Tensor

from unisim_bench.settings import VARIANTS
from unisim_blender.core import native
from unisim_blender.core.ops.composite import composite
from unisim_blender.core.ops.density import logistic_intervals, logistic_intervals_reference
from unisim_blender.core.ops.field_values import SignedDistances
from unisim_blender.core.ops.gather import OPERATION as GATHER
from unisim_blender.core.ops.gather import gather, gather_reference
from unisim_blender.core.ops.ray_segments import ActorSegments, MeshSegments, RaySegments, rows_of
from unisim_blender.core.ops.transmittances import OPERATION as TRANSMITTANCES
from unisim_blender.core.ops.transmittances import transmittances, transmittances_padded, transmittances_reference
from unisim_blender.core.render.tracers.torch.trace import _without_foreign

pytestmark = pytest.mark.skipif(native.library() is None, reason="the compiled kernels are not built")
RAYS = 300


def generator(seed: int) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def distances(n: int, k: int, seed: int = 0) -> Tensor:
    """Walks in and out of surfaces, some far away, some deep inside, some that stand still."""
    size = torch.logspace(-3, 0.7, n)[torch.randperm(n, generator=generator(1))]
    s = torch.randn(n, k, generator=generator(seed)).cumsum(1) * size[:, None]
    s[::7] += 3.0
    s[3::7] -= 3.0
    s[5::11] = s[5::11, :1]
    return s


def given(function: Callable[[Tensor, Tensor], tuple[Tensor, Tensor]], s: Tensor, beta: float) -> list[Tensor]:
    """tau and stop_fraction, then the gradients of s and beta of a weighted sum of both."""
    s, sharp = s.clone().requires_grad_(), torch.tensor(beta, dtype=s.dtype, requires_grad=True)
    tau, stop_fraction = function(s, sharp)
    weights = (torch.randn(s.shape, generator=generator(seed)).to(s) for seed in (2, 3))
    (sum((w * x).sum() for w, x in zip(weights, (tau, stop_fraction), strict=True))).backward()  # type: ignore[union-attr]
    assert s.grad is not None and sharp.grad is not None
    return [tau.detach(), stop_fraction.detach(), s.grad, sharp.grad]


def errors(found: Tensor, wanted: Tensor) -> tuple[float, float]:
    """The largest and the mean difference, as shares of the size."""
    away = (found.double() - wanted).abs() / (1 + wanted.abs())
    return (float(away.max()), float(away.mean())) if wanted.numel() else (0.0, 0.0)


@pytest.mark.parametrize("beta", (1.0, 20.0, 300.0))
@pytest.mark.parametrize("shape", ((0, 12), (1, 1), (63, 2), (500, 12)))
def test_intervals(shape: tuple[int, int], beta: float) -> None:
    s = distances(*shape)
    fast, single = given(logistic_intervals, s, beta), given(logistic_intervals_reference, s, beta)
    exact = given(logistic_intervals_reference, s.double(), beta)
    for name, a, b, c in zip(("tau", "stop_fraction", "s", "beta"), fast, single, exact, strict=True):
        assert a.shape == c.shape
        # differences of two softplus cancel in single precision, for torch as well; beta's gradient is one sum of many
        slack = 2e-4 if name == "beta" else 2e-5
        (most, mean), (most_single, mean_single) = errors(a, c), errors(b, c)
        assert most <= 5 * most_single + slack and mean <= 1.5 * mean_single + slack, name
    assert errors(fast[0], exact[0])[0] < 1e-5 * max(1.0, beta / 20)


@pytest.mark.parametrize("at", (0, 4, 11))
def test_what_is_not_a_number_stays_so(at: int) -> None:
    """A training that diverges must show it."""
    s = distances(40, 12)
    s[17, at] = torch.nan
    for found, wanted in zip(logistic_intervals(s, 20.0), logistic_intervals_reference(s, 20.0), strict=True):
        assert torch.equal(found.isnan(), wanted.isnan())
    tau = logistic_intervals(s, 20.0)[0]
    assert tau[17].isnan().nonzero()[:, 0].tolist() == [at, at + 1][: 12 - at]


def ray_segments_of(seed: int, groups: tuple[tuple[int, int], ...], features: int = 5) -> list[RaySegments]:
    """Groups of (ray segments, samples) over RAYS rays; those of the first are on rays of their own each, so that rays
    with one ray segment, with several, and with several of one field are among them."""
    out = []
    for g, (n, k) in enumerate(groups):
        r = generator(seed + g)
        ray = (
            torch.randperm(RAYS, generator=r)[:n].sort()[0]
            if g == 0
            else torch.randint(RAYS // 2, (n,), generator=r).sort()[0]
        )
        t = 1 + 20 * torch.rand(n, k, generator=r).sort(1)[0]
        tau = torch.rand(n, k, generator=r) ** 4 * 2
        stop_fraction = -torch.expm1(-tau) * torch.rand(n, k, generator=r)
        stop_fraction[:, :1] = 0
        appearance = torch.randn(n, k, features + 1, generator=r)[..., 1:]
        out.append(RaySegments(ray, t, appearance, tau, stop_fraction))
    return out


GROUPS = ((200, 12), (90, 8), (40, 3), (0, 8))
KINDS: dict[str, tuple[Callable[..., list[Tensor]], Callable[..., tuple[Tensor, ...]]]] = {
    "compiled": (transmittances, gather),
    "plain": (transmittances_reference, gather_reference),
    "padded": (transmittances_padded, gather_reference),
}


def composited(kind: str, ray_segments: list[RaySegments], dtype: torch.dtype) -> list[Tensor]:
    """Transmittances, weights and sums of every group, then the gradients of tau, stop_fraction and features of a
    weighted sum of all."""
    own, leaves = [], []
    for s in ray_segments:
        tau, stop_fraction, appearance = (
            x.detach().to(dtype).requires_grad_() for x in (s.tau, s.stop_fraction, s.features)
        )
        leaves += [tau, stop_fraction, appearance]
        own.append(replace(s, t=s.t.to(dtype), tau=tau, stop_fraction=stop_fraction, features=appearance))
    order, sums = KINDS[kind]
    out: list[Tensor] = []
    for s, before in zip(own, order(RAYS, own), strict=True):
        out += [before, *sums(s, before)]
    total = sum((x * torch.randn(x.shape, generator=generator(i)).to(dtype)).sum() for i, x in enumerate(out))
    assert isinstance(total, Tensor)
    total.backward()
    return [x.detach() for x in out] + [x.grad for x in leaves if x.grad is not None]


@pytest.mark.parametrize("groups", (GROUPS, GROUPS[:1], ((0, 4),), ((5, 1), (7, 1))))
def test_values_and_gradients(groups: tuple[tuple[int, int], ...]) -> None:
    ray_segments = ray_segments_of(10, groups)
    if groups is GROUPS:
        counts = torch.bincount(torch.cat([s.ray for s in ray_segments]), minlength=RAYS)
        assert int((counts == 1).sum()) > 30 and int((counts == 2).sum()) > 30 and int((counts > 2).sum()) > 10
    plain = composited("plain", ray_segments, torch.float64)
    fast, padded = (composited(kind, ray_segments, torch.float32) for kind in ("compiled", "padded"))
    assert len(fast) == len(padded) == len(plain) == 7 * len(groups)
    for a, b in (*zip(fast, plain, strict=True), *zip(padded, plain, strict=True)):
        assert a.shape == b.shape
        torch.testing.assert_close(a.double(), b, rtol=1e-4, atol=1e-5)


def of_actor_set(number: int, segments: RaySegments) -> ActorSegments:
    """The same ray segments, through the boxes of an actor set."""
    one, size = torch.ones(len(segments)), torch.ones(len(segments), 3)
    return ActorSegments(
        **vars(segments), values=SignedDistances(segments.t), points=segments.t, density="logistic", beta=torch.ones(()),
        actor_set=number,
        actor=segments.ray, t_near=one, t_far=one, world_from_box=size, size_m=size,
        row=segments.ray,
    )  # fmt: skip


def test_a_whole_image_is_the_same() -> None:
    """Foreign actors and meshes apart; the reference takes over where a place is learnt."""
    own, foreign, more, nothing = ray_segments_of(20, GROUPS)
    mesh = MeshSegments(
        **vars(ray_segments_of(30, ((50, 1),), 1)[0]), actor=torch.zeros(50), normals=torch.zeros(50, 3)
    )
    ray_segments = [own, of_actor_set(1, foreign), of_actor_set(0, more), of_actor_set(1, nothing), mesh]
    found = composite(RAYS, ray_segments, [5, 5], own.t)
    learnt = [replace(s, t=s.t.clone().requires_grad_()) for s in ray_segments]
    assert TRANSMITTANCES.chosen(RAYS, learnt) == GATHER.chosen(learnt[0], own.tau) == "reference"
    plain = composite(RAYS, learnt, [5, 5], own.t)
    names = ("feature", "depth_m", "opacity", "transmittance_after", "mesh_opacity")
    for a, b in [
        *((getattr(found, name), getattr(plain, name)) for name in names),
        *zip(
            (*found.foreign_features, *found.foreign_opacity),
            (*plain.foreign_features, *plain.foreign_opacity),
            strict=True,
        ),
    ]:
        assert bool((a != 0).any())
        torch.testing.assert_close(a, b.detach(), rtol=1e-5, atol=1e-5)


def test_without_foreign_actors_rays_that_meet_none_are_not_composited_anew() -> None:
    """The same bits as everything of the scene's own alone."""
    own, foreign, more, _ = ray_segments_of(20, GROUPS)
    foreign = rows_of(foreign, foreign.ray % 3 == 0)
    mesh = MeshSegments(**vars(ray_segments_of(30, ((9, 1),), 1)[0]), actor=torch.zeros(9), normals=torch.zeros(9, 3))
    ray_segments = [own, of_actor_set(1, foreign), of_actor_set(0, more), mesh]
    everything = composite(RAYS, ray_segments, [5, 5], own.t)
    feature, after = _without_foreign(everything, ray_segments)
    alone = composite(RAYS, [own, of_actor_set(0, more)], [5], own.t)
    assert torch.equal(feature, alone.feature) and torch.equal(after, alone.transmittance_after)
    assert not torch.equal(feature, everything.feature)
    untouched = (feature == everything.feature).all(1) & (feature != 0).any(1)
    assert 50 < int(untouched.sum()) < RAYS - 10


def test_compositing_changes_nothing_that_it_is_given() -> None:
    """So it may be done again, and gives the same."""
    ray_segments = ray_segments_of(20, GROUPS)
    kept = [{name: value.clone() for name, value in vars(s).items()} for s in ray_segments]
    one, other = (composite(RAYS, ray_segments, [5], ray_segments[0].t) for _ in range(2))
    for before, after in zip(kept, ray_segments, strict=True):
        assert before.keys() == vars(after).keys()
        assert all(torch.equal(value, getattr(after, name)) for name, value in before.items())
    for a, b in zip(one.weights, other.weights, strict=True):
        assert all(torch.equal(x, getattr(b, name)) for name, x in vars(a).items())
    assert torch.equal(one.feature, other.feature)


def everything() -> list[Tensor]:
    return given(logistic_intervals, distances(500, 12), 20.0) + composited(
        "compiled", ray_segments_of(10, GROUPS), torch.float32
    )


def test_any_number_of_threads_gives_the_same_bits() -> None:
    threads, found = torch.get_num_threads(), []
    try:
        for count in (1, 2, 3):
            torch.set_num_threads(count)
            found.append(everything())
    finally:
        torch.set_num_threads(threads)
    for one, two, three in zip(*found, strict=True):
        assert torch.equal(one, two) and torch.equal(one, three)


VARIANT_SCRIPT = """
from ops import test_composite as t
from ops.test_march import test_compiled_proposals
from world.test_tracklets import test_compiled_spheres
for beta in (1.0, 20.0, 300.0):
    t.test_intervals((500, 12), beta)
t.test_values_and_gradients(t.GROUPS)
test_compiled_proposals(0.3)
test_compiled_spheres(37)
"""


@pytest.mark.parametrize("name", VARIANTS)
def test_every_variant(name: str) -> None:
    run_other(name, VARIANT_SCRIPT)
