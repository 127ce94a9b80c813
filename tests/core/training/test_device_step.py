"""A step whose shapes no value decides: it has the terms and gradients of the plain one, and never waits for a device."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import pytest
import torch
from no_host_decisions import HostDecision, NoHostDecisions
from small_log import write_small_log
from torch import Tensor

from unisim_blender.core import native
from unisim_blender.core.data.log import Log
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.ops import padding
from unisim_blender.core.ops.padding import Padding, drawn, masked_mean, masked_quantile, selected
from unisim_blender.core.training.config import TrainConfig
from unisim_blender.core.training.trainer import Trainer

EVERYTHING = TrainConfig(
    cameras=("front_camera",), lidars=("pandar64",), frames=(0, 1, 2, 3), preset="tiny", iterations=100, patches=4,
    patch_cells=8, lidar_rays=256, perceptual_from=0.0, poses_from=0.0, unobserved_from=0.0, settled_from=0.0, prune_from=0,
)  # fmt: skip


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Log:
    out = tmp_path_factory.mktemp("device") / "log"
    write_small_log(out)
    return open_log(out)


@pytest.mark.parametrize(
    "decision",
    [
        lambda x: float(x.sum()),
        lambda x: x[x > 0],
        lambda x: torch.nonzero(x),
        lambda x: bool((x > 0).any()),
        lambda x: x.unique(),
        lambda x: x.repeat_interleave(x.long()),
        lambda x: torch.where(x > 0, x, torch.tensor(1.0)),
        lambda x: x.index_put_((x > 0,), x.sum()),
    ],
)
def test_what_waits_is_refused(decision: Callable[[Tensor], Any]) -> None:
    x = torch.tensor([0.0, 1.0, 2.0])
    with NoHostDecisions(), pytest.raises(HostDecision):  # type: ignore[no-untyped-call]
        decision(x)


def test_rows_are_selected_in_tensors_of_a_fixed_length() -> None:
    mask = torch.tensor([False, True, True, False, True])
    for most, wanted in ((5, [1, 2, 4]), (3, [1, 2, 4]), (2, [1, 2])):
        index, there = selected(mask, most)
        assert len(index) == most and index[there].tolist() == wanted and int(index.max()) < 5
    assert not selected(torch.zeros(4, dtype=torch.bool), 3)[1].any()
    index, some = drawn(mask, 3000, torch.Generator().manual_seed(0))
    assert some and torch.bincount(index, minlength=5)[mask].tolist() == pytest.approx([1000] * 3, abs=120)
    assert set(index.tolist()) == {1, 2, 4} and not drawn(~mask & mask, 2, None)[1]
    values = torch.tensor([9.0, 1.0, 2.0, float("nan"), 6.0])
    assert float(masked_mean(values, mask)) == 3 and float(masked_mean(values, mask & ~mask)) == 0
    for share in (0.0, 0.3, 0.95, 1.0):
        assert torch.equal(masked_quantile(values, mask, share), torch.quantile(values[mask], share))


def test_rows_that_found_no_place_are_counted() -> None:
    lengths = Padding(0.5, torch.zeros((), dtype=torch.long))
    assert len(lengths.rows(torch.ones(7, dtype=torch.bool), 8)[0]) == 4 and int(lengths.missed) == 3


def terms_of(trainer: Trainer, lengths: Padding | None) -> tuple[dict[str, Tensor], list[Any], list[Tensor]]:
    """Every term of a step, what was traced, and the gradients of all leaves."""
    branches = trainer.branches
    deferred = trainer.deferred()
    trainer.shape.padded = lengths is not None
    for sink, _ in trainer._sinks_of(deferred["tables"]):
        sink.clear()
    start = dataclasses.replace(trainer._start(0, 0.5, deferred, Future()), padding=lengths)
    batches, draw = branches.draw_pixels(start.rng, 0)
    lidar = trainer.lidar.sample(start.rng, trainer.config.lidar_rays)
    weight = None if draw is None else torch.as_tensor(draw.weight).float()
    leaves = [*start.gradients.leaves, *(trainer.camera_poses.parameters())]

    def step() -> tuple[dict[str, Tensor], list[Any], list[Tensor]]:
        moved, seen = branches.seen(start, batches)
        terms = dict(branches.camera_terms(start, moved, seen, weight).terms)
        swept = branches.swept(start, lidar)
        terms |= swept.terms | branches.unobserved(start) | branches.slopes(start, swept, seen)
        gradients = torch.autograd.grad(torch.stack(list(terms.values())).sum(), leaves, allow_unused=True)
        branches.update_occupancy(start, seen, camera=True)
        branches.update_occupancy(start, swept.traced, camera=False)
        return terms, [seen, swept.traced], [torch.zeros(()) if g is None else g for g in gradients]

    if lengths is None:
        return step()
    with NoHostDecisions():  # type: ignore[no-untyped-call]
        return step()


@pytest.fixture
def even(monkeypatch: pytest.MonkeyPatch) -> None:
    """Random numbers that do not depend on how many are drawn, and plain torch."""
    monkeypatch.setattr(native, "library", lambda: None)

    def shape_of(sizes: tuple[Any, ...]) -> tuple[int, ...]:
        return tuple(sizes[0]) if len(sizes) == 1 and not isinstance(sizes[0], int) else sizes

    def picked(mask: Tensor, count: int, generator: object) -> tuple[Tensor, Tensor]:
        ends = mask.cumsum(0)
        place = (torch.linspace(0, 0.999, count) * ends[-1]).long() + 1
        return torch.searchsorted(ends, torch.minimum(place, ends[-1]).clamp_min(1)).clamp_max(len(mask) - 1), ends[
            -1
        ] > 0

    monkeypatch.setattr(torch, "rand", lambda *sizes, **_: torch.full(shape_of(sizes), 0.37))
    monkeypatch.setattr(torch, "randn", lambda *sizes, **_: torch.full(shape_of(sizes), 0.3).cumsum(-1) - 0.5)
    monkeypatch.setattr(torch, "randint", lambda n, size, **_: (torch.linspace(0, 0.999, size[0]) * n).long())
    for module in (padding, __import__("unisim_blender.core.training.losses.shape", fromlist=["drawn"])):
        monkeypatch.setattr(module, "drawn", picked)


@pytest.mark.parametrize("changes", [{}, {"preset": "ngp"}, {"preset": "nsg"}, {"density": "unisim"}], ids=str)
def test_padded_terms_and_gradients_are_the_plain_ones(log: Log, even: None, changes: dict[str, Any]) -> None:
    made = []
    for hits in (None, 2.0):
        trainer = Trainer(log, dataclasses.replace(EVERYTHING, **changes))
        torch.manual_seed(0)
        with torch.no_grad():
            for p in trainer.model.parameters():
                p.add_(0.05 * torch.sin(torch.arange(p.numel()).view(p.shape)))
        lengths = None if hits is None else Padding(hits, torch.zeros((), dtype=torch.long))
        made.append((*terms_of(trainer, lengths), trainer))
        assert lengths is None or not lengths.missed
    (terms, traced, gradients, plain), (padded_terms, padded, padded_gradients, other) = made
    assert terms.keys() == padded_terms.keys() and len(terms) >= 3
    for a, b in zip(traced, padded, strict=True):
        for name in ("feature", "depth_m", "opacity", "volume_depth_m"):
            torch.testing.assert_close(getattr(b, name), getattr(a, name), rtol=2e-4, atol=2e-5)
    for name, value in terms.items():
        torch.testing.assert_close(padded_terms[name], value, rtol=2e-4, atol=1e-6)
    for a, b in zip(gradients, padded_gradients, strict=True):
        torch.testing.assert_close(b, a, rtol=2e-3, atol=1e-7 + 1e-4 * float(a.abs().max()))
    assert sum(bool((a != 0).any()) for a in gradients) > 8, "most parameters learn something"
    for name, state in plain.occupancy.state().items():
        torch.testing.assert_close(other.occupancy.state()[name], state, rtol=1e-4, atol=1e-5)
