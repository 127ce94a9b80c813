"""Weights along a ray: against dense integration, plain loops and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from unisim_blender.core.ops.density import logistic_intervals, unisim_intervals
from unisim_blender.core.ops.transmittances import weights_from_tau

BETAS = (1.0, 20.0, 300.0, 1e4)


def weights(t: Tensor, s: Tensor, beta: float) -> tuple[Tensor, Tensor]:
    """Mean stopping distance (N,) times the opacity, and the opacity (N,), as `trace` sums them up."""
    tau, stop_fraction = logistic_intervals(s, beta)
    before, after = weights_from_tau(tau)
    total, far = before * -torch.expm1(-tau), before * stop_fraction
    near = total - far
    place = total[:, 0] * t[:, 0] + (near[:, 1:] * t[:, :-1] + far[:, 1:] * t[:, 1:]).sum(-1)
    return place, 1 - after


def walk(n: int, k: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """Random places (n, k) and smooth random distances (n, k), float64."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(1, 20, (n, k)), 1)
    s = rng.uniform(0.1, 1.0, (n, 1)) * np.cos(rng.uniform(0.2, 1.5, (n, 1)) * t + rng.uniform(0, 6, (n, 1)))
    return torch.tensor(t), torch.tensor(s)


@pytest.mark.parametrize("beta", BETAS)
def test_opacity_of_an_approach_does_not_depend_on_the_steps(beta: float) -> None:
    ends = torch.tensor([[2.0, -0.5], [0.4, 0.01], [0.1, 0.05], [-0.2, -0.6]], dtype=torch.float64) / min(beta, 20) * 20
    opacities = []
    for count in (2, 3, 17, 400):
        u = torch.linspace(0, 1, count, dtype=torch.float64) ** 1.7
        s = ends[:, :1] + u * (ends[:, 1:] - ends[:, :1])
        opacities.append(weights(u.expand_as(s), s, beta)[1])
    expected = 1 - torch.sigmoid(beta * ends[:, 1])
    for opacity in opacities:
        torch.testing.assert_close(opacity, expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("beta", BETAS[1:])
@pytest.mark.parametrize("angle_deg", (90.0, 30.0, 5.0, 1.0))
def test_mean_depth_on_a_plane_at_every_angle(beta: float, angle_deg: float) -> None:
    slope = np.sin(np.radians(angle_deg))
    start = 40 / beta
    t_surface = start / slope
    t = np.linspace(0, 2.5 * t_surface, 2_000_001)
    phi = 1 / (1 + np.exp(-beta * (start - slope * t)))
    dense = float(np.trapezoid(phi, t) if hasattr(np, "trapezoid") else np.trapz(phi, t))
    assert abs(dense - t_surface) < 1e-4 * t_surface, "the density's mean is where s = 0"
    rng = np.random.default_rng(1)
    for count in (4, 12, 60):
        places = torch.tensor(np.sort(np.r_[0, rng.uniform(0, 2.5 * t_surface, count - 2), 2.5 * t_surface]))[None]
        place, opacity = weights(places, start - slope * places, beta)
        assert opacity.item() == pytest.approx(1, abs=1e-9)
        assert place.item() == pytest.approx(dense, rel=1e-4), "linear distances: exact however few the samples"


def test_weights_converge_as_steps_shrink() -> None:
    def curve(t: Tensor) -> Tensor:
        return 0.6 * torch.cos(0.9 * t) + 0.3

    def mean(count: int) -> float:
        t = torch.linspace(0, 9, count, dtype=torch.float64)[None]
        place, opacity = weights(t, curve(t), 15.0)
        return float(place / opacity)

    exact = mean(200_001)
    errors = [abs(mean(count) - exact) for count in (10, 40, 160, 640)]
    assert errors[1] < errors[0] / 4 and errors[2] < errors[1] / 4 and errors[3] < 1e-4, errors


@pytest.mark.parametrize("beta", BETAS)
@pytest.mark.parametrize("dtype", (torch.float32, torch.float64))
def test_shares_lie_between_nothing_and_alpha(beta: float, dtype: torch.dtype) -> None:
    _, s = walk(500, 24)
    s = torch.cat([s, 30 * s, 1e-4 * s, s.sign() * 100]).to(dtype)
    tau, stop_fraction = logistic_intervals(s, beta)
    alpha = -torch.expm1(-tau)
    assert bool(torch.isfinite(tau).all()) and bool((tau >= 0).all())
    # two ways to round alpha
    assert bool((stop_fraction >= 0).all()) and bool((stop_fraction <= alpha * (1 + 4 * torch.finfo(dtype).eps)).all())
    assert bool((stop_fraction[:, 0] == 0).all())


@pytest.mark.parametrize("beta", BETAS)
def test_single_precision_agrees_with_double(beta: float) -> None:
    t, s = walk(400, 20)
    s = s * min(1.0, 50 / beta) if beta > 1 else s * 10
    for exact, rough in zip(weights(t, s, beta), weights(t.float(), s.float(), beta), strict=True):
        torch.testing.assert_close(rough.double(), exact, rtol=2e-4, atol=2e-4)


def test_transmittance_keeps_its_digits_behind_something_dense() -> None:
    tau = torch.tensor([[0.3, 3.0e6, 1.0]])
    before, after = weights_from_tau(tau)
    torch.testing.assert_close(before, torch.tensor([[1.0, np.exp(-0.3), 0.0]], dtype=torch.float32))
    assert after.item() == 0


@pytest.mark.parametrize("beta", BETAS)
def test_gradients_are_finite_far_inside_and_far_outside(beta: float) -> None:
    s = torch.tensor([[50.0, 30.0, 1e-6, 0.0, -1e-6, -40.0, -100.0, 80.0, 0.2, 0.2, 0.2]], requires_grad=True)
    sharpness = torch.tensor(beta, requires_grad=True)
    tau, stop_fraction = logistic_intervals(s, sharpness)
    before, _ = weights_from_tau(tau)
    (before * (stop_fraction - torch.expm1(-tau))).sum().backward()
    assert s.grad is not None and sharpness.grad is not None
    assert bool(torch.isfinite(s.grad).all()) and bool(torch.isfinite(sharpness.grad))


def test_gradients_against_finite_differences() -> None:
    _, s = walk(6, 9, seed=3)
    # kept away from where an interval turns round, and from the change of formula, which have no derivative
    s = s[(s.diff(dim=1).abs() > 1e-2).all(1)].requires_grad_()
    assert len(s) >= 3
    beta = torch.tensor(7.0, dtype=torch.float64, requires_grad=True)

    def both(s: Tensor, beta: Tensor) -> Tensor:
        tau, stop_fraction = logistic_intervals(s, beta)
        before, _ = weights_from_tau(tau)
        return torch.stack([before * stop_fraction, -torch.expm1(-tau)])

    assert torch.autograd.gradcheck(both, (s, beta), eps=1e-6, atol=1e-6)


def test_share_is_the_integral_inside_the_interval() -> None:
    for a, b, beta in (
        (0.3, -0.2, 20.0),
        (0.05, 0.02, 20.0),
        (-0.3, -0.9, 30.0),
        (0.201, 0.2, 5.0),
        (-3.0, -3.2, 80.0),
    ):
        x = np.linspace(0, 1, 400_001)
        s = torch.tensor(a + (b - a) * x)
        survival = torch.exp(
            torch.nn.functional.softplus(torch.tensor(-beta * a)) - torch.nn.functional.softplus(-beta * s)
        ).numpy()
        stop = -np.diff(survival)
        expected = float((stop * (x[1:] + x[:-1]) / 2).sum())
        stop_fraction = logistic_intervals(torch.tensor([[a, b]], dtype=torch.float64), beta)[1][0, 1].item()
        assert stop_fraction == pytest.approx(expected, rel=0.02, abs=1e-5), (a, b, beta)


def test_unisim_density_is_the_papers_at_its_own_step() -> None:
    rng = np.random.default_rng(5)
    s = torch.tensor(rng.uniform(-0.3, 0.5, (30, 12)))
    t = 3.0 + 0.2 * torch.arange(12, dtype=torch.float64).expand(30, 12)
    tau, stop_fraction = unisim_intervals(s, t, 20.0, 0.2)
    alpha = torch.sigmoid(-20.0 * s)
    torch.testing.assert_close(-torch.expm1(-tau), alpha)
    # all of an interval's weight stands at its far sample; interval 0 has no other
    torch.testing.assert_close(stop_fraction[:, 1:], alpha[:, 1:])
    assert bool((stop_fraction[:, 0] == 0).all())


def test_unisim_density_of_other_steps_adds_up() -> None:
    """Two half steps through even density stop as much as a whole one."""
    opacities = []
    for count in (11, 21, 81):
        t = torch.linspace(1.0, 3.0, count, dtype=torch.float64)[None]
        tau, _ = unisim_intervals(torch.full_like(t, 0.07), t, 20.0, 0.2)
        opacities.append(float(tau[:, 1:].sum()))
    assert opacities == pytest.approx([10 * np.log1p(np.exp(-1.4))] * 3)


def loop(alpha: NDArray[np.float64]) -> NDArray[np.float64]:
    """w_i = alpha_i * prod_{j < i} (1 - alpha_j), one ray."""
    out, left = [], 1.0
    for a in alpha:
        out.append(a * left)
        left *= 1 - a
    return np.array([*out, left])


def test_weights_against_a_plain_loop() -> None:
    tau = torch.tensor(np.random.default_rng(6).exponential(0.5, (20, 15)))
    before, after = weights_from_tau(tau)
    w = torch.cat([before * -torch.expm1(-tau), after[:, None]], -1).numpy()
    for row, alpha in zip(w, -np.expm1(-tau.numpy()), strict=True):
        np.testing.assert_allclose(row, loop(alpha), rtol=1e-10)
    np.testing.assert_allclose(w.sum(1), 1, rtol=1e-12)
