"""A step in branches at once: the gradients are those of its whole loss, and threads change no bit of it."""

from __future__ import annotations

import threading
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

import pytest
import torch
from small_training import EVERYTHING, small_log
from torch import Tensor

from unisim_blender.core import native
from unisim_blender.core.data.log import Log
from unisim_blender.core.errors import SceneError
from unisim_blender.core.model.networks import frozen, mlp, shallow
from unisim_blender.core.training import branches as module
from unisim_blender.core.training.branches import BranchGradients, run_branches
from unisim_blender.core.training.checkpoint import _state
from unisim_blender.core.training.trainer import Trainer


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    return small_log(tmp_path_factory.mktemp("branches") / "log")


def leaves_of(trainer: Trainer) -> list[Tensor]:
    groups = (*trainer.optimiser.param_groups, *trainer.slow.param_groups)
    return [*(p for group in groups for p in group["params"]), *trainer.deferred().values()]


@pytest.mark.parametrize("adversarial", (False, True))
def test_a_step_is_the_same_to_the_bit_at_once_and_one_after_the_other(log: Log, adversarial: bool) -> None:
    states = []
    for together in (True, True, False):
        trainer = Trainer(log, replace(EVERYTHING, adversarial=adversarial))
        metrics = [trainer._step(together) for _ in range(6)]
        states.append((metrics, _state(trainer)))
    terms = {"rgb", "sdf_band", "eikonal", "normal_smoothness", "unobserved", "latent"}
    assert terms | {"loss", "psnr", "lidar_m"} <= set(states[0][0][0]) | set(states[0][0][1])
    for metrics, state in states[1:]:
        assert metrics == states[0][0]
        assert state.keys() == states[0][1].keys()
        assert all(torch.equal(value, state[name]) for name, value in states[0][1].items())


def gradients_of_a_step(log: Log, patch: pytest.MonkeyPatch, in_branches: bool, before: int) -> list[Tensor]:
    """Of every leaf, after some steps; the plain way is one graph for everything, in which autograd alone adds up."""
    trainer = Trainer(log, EVERYTHING)
    for _ in range(before):
        trainer._step(together=False)
    leaves, got = leaves_of(trainer), []
    for leaf in leaves:
        leaf.grad = torch.zeros_like(leaf)

    def record() -> None:
        for leaf in leaves:
            assert leaf.grad is not None
            got.append(leaf.grad.clone())

    patch.setattr(trainer.optimiser, "step", record)
    if not in_branches:
        terms: list[Tensor] = []
        for field in (trainer.model.static.grid, trainer.model.background.grid, trainer.model.actors):
            field.sink = None

        def whole(starts: Any, tables: Any) -> None:
            torch.stack(terms).sum().backward()
            record()

        patch.setattr(trainer.branches, "_backward", lambda start, given: terms.extend(given.values()))
        patch.setattr(trainer, "_update", whole)
    trainer._step(together=in_branches)
    return got


@pytest.mark.parametrize("compiled, before", ((True, 2), (True, 3), (False, 2)))
def test_shares_have_the_gradients_of_the_whole_loss(
    log: Log, monkeypatch: pytest.MonkeyPatch, compiled: bool, before: int
) -> None:
    """Slopes are in even steps, unobserved places in odd ones."""
    if not compiled:
        monkeypatch.setattr(native, "library", lambda: None)
    branches, whole = (gradients_of_a_step(log, monkeypatch, in_branches, before) for in_branches in (True, False))
    for a, b in zip(branches, whole, strict=True):
        torch.testing.assert_close(a, b, rtol=2e-4, atol=1e-7 + 1e-5 * float(b.abs().max()))
    assert sum(bool((b != 0).any()) for b in whole) > 20, "most parameters learn something"


def test_a_share_waits_for_what_one_before_it_leaves() -> None:
    for together in (True, False):
        seen: Future[int] = Future()

        def first(seen: Future[int] = seen) -> tuple[int, int]:
            seen.set_result(3)
            return 1, threading.get_ident()

        def second(seen: Future[int] = seen) -> tuple[int, int]:
            return seen.result(), threading.get_ident()

        (one, here), (three, there) = run_branches([first, second], together)
        assert (one, three) == (1, 3) and here == threading.get_ident() and (there != here) is together


@pytest.mark.parametrize("together", (True, False))
def test_the_first_shares_error_is_raised_when_all_have_ended(together: bool) -> None:
    ended = []

    def fails(message: str) -> None:
        ended.append(message)
        raise SceneError(message)

    with pytest.raises(SceneError, match="the first"):
        run_branches([lambda: fails("the first"), lambda: fails("the second")], together)
    assert sorted(ended) == ["the first", "the second"]


@pytest.mark.parametrize("together", (True, False))
def test_a_step_that_fails_leaves_nothing_waiting(log: Log, monkeypatch: pytest.MonkeyPatch, together: bool) -> None:
    """The LiDAR's branch, which waits for what cameras see, ends too; the next step is what it would have been."""
    whole, broken = Trainer(log, EVERYTHING), Trainer(log, EVERYTHING)
    with monkeypatch.context() as patch:
        patch.setattr(broken.branches, "draw_pixels", lambda rng, iteration: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            broken._step(together)
    assert whole._step(together=False) == broken._step(together)
    kept = _state(broken)
    assert all(torch.equal(value, kept[name]) for name, value in _state(whole).items())
    with monkeypatch.context() as patch:
        patch.setattr(module, "distortion", lambda seen: torch.tensor(float("nan")))
        with pytest.raises(SceneError, match="training diverged at iteration 1: distortion is not a finite number"):
            broken._step(together)


def test_a_shares_threads_are_as_many_as_its_callers() -> None:
    before = torch.get_num_threads()
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            assert run_branches([torch.get_num_threads] * 3, together=True) == [threads] * 3
    finally:
        torch.set_num_threads(before)


def test_gradients_are_added_in_one_go() -> None:
    a, b, unused = (torch.tensor([float(i), 2.0], requires_grad=True) for i in range(3))
    a.grad = torch.ones(2)
    gradients = BranchGradients([a, b, unused])
    gradients.take((a * b).sum())
    gradients.take(a.square().sum())
    gradients.take(torch.zeros(()))
    assert torch.equal(a.grad, torch.ones(2)) and b.grad is None
    gradients.add()
    assert torch.equal(a.grad, 1 + b.detach() + 2 * a.detach())
    assert b.grad is not None and torch.equal(b.grad, a.detach()) and unused.grad is None


def test_a_frozen_module_gives_the_same_and_does_not_learn() -> None:
    torch.manual_seed(0)
    network = mlp(3, 8, 2, layers=3)
    x = torch.randn(5, 3, requires_grad=True)
    still = frozen(network)
    out = still(x)
    assert torch.equal(out, network(x))
    out.sum().backward()
    assert x.grad is not None and all(p.grad is None and p.requires_grad for p in network.parameters())
    with torch.no_grad():
        network[0].weight.add_(1)  # type: ignore[operator]
    assert torch.equal(still(x), network(x)), "they share their memory"
    twin = shallow(network)
    twin[0] = torch.nn.Linear(3, 8)
    assert twin[0] is not network[0] and twin[2] is network[2]
